"""What not every simulated robot has: gyro, heading, and side slip that lasts. Not in the paper.

A robot without them does without their code, their noise and their memory (`plant`).
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function
from rhec.tracked_robot.plant import MEMORY, gauss_markov
from rhec.tracked_robot.sensors import OUTPUTS

# Settings by the names of Scenario's fields.
_SETTINGS = dict(
    gyro=("gyro_sigma_radps", "gyro_bias_radps", "gyro_scale"),
    heading=("heading_sigma_rad",),
    side_slip=("side_slip_rad", "side_slip_time_s"),
)


def options_of(sensors, side_slip):
    """The options of a robot with these sensors, and with `side_slip` or without, in order."""
    return (*(name for name in OUTPUTS if name in sensors), *("side_slip",) * bool(side_slip))


def settings_of(options):
    """Shapes of the settings of these options, by the names of Scenario's fields."""
    return {name: (1, 1) for option in options for name in _SETTINGS[option]}


def memory_of(options):
    """Shapes of what one sample of a robot with these options hands to the next, by name."""
    shapes = dict(last_yaw=(1, 1)) if "gyro" in options else {}
    return shapes | (dict(slip_angle=(1, 1)) if "side_slip" in options else {})


def init(options, pose):
    """The memory before the first sample of a robot that starts at this pose."""
    values = dict(last_yaw=pose[2], slip_angle=0.0)
    return {name: values[name] for name in memory_of(options)}


def sense(options, dt_s):
    """Gyro and heading as a Function that lengthens z = (x, y, ν, ω), or None without either.

    The gyro measures s (θ_k - θ_{k-1})/Δt + β + σ w, the mean yaw rate over ground since the last
    sample, with the scale s = gyro_scale and the bias β = gyro_bias_radps. In the first sample
    θ_{k-1} = θ_k. The heading, as of two antennas, is θ_k + σ w; `wrapped` takes its turns off.

    Args:
        options: Names of the robot's options.
        dt_s: Length of a sample Δt [s].

    Returns:
        The Function (z, pose, memory, noise, settings) -> (z, memory).
    """
    sensors = [name for name in OUTPUTS if name in options]
    if not sensors:
        return None
    shapes = memory_of(sensors) | settings_of(sensors)
    shapes |= {f"{name}_noise": (1, 1) for name in sensors}

    @casadi_function("sense", z=(4, 1), pose=MEMORY["pose"], **shapes)
    def sense(z, pose, **signals):
        yaw = pose[2]
        result = dict(z=z)
        if "gyro" in sensors:
            rate = (yaw - signals["last_yaw"]) / dt_s
            error = signals["gyro_bias_radps"] + signals["gyro_sigma_radps"] * signals["gyro_noise"]
            gyro = signals["gyro_scale"] * rate + error
            result = dict(z=ca.vertcat(z, gyro), last_yaw=yaw)
        if "heading" in sensors:
            heading = yaw + signals["heading_sigma_rad"] * signals["heading_noise"]
            result["z"] = ca.vertcat(result["z"], heading)
        return result

    return sense


def wrapped(z, options):
    """The measurement z with its heading between -π and π, where the robot measures one.

    Faults come before: a late measurement lies between two others, not across a full turn.
    """
    if "heading" not in options:
        return z
    heading = z[-1]
    turns = ca.floor(heading / (2 * np.pi) + 0.5)
    return ca.vertcat(z[:-1], heading - 2 * np.pi * turns)


def slip_sideways(dt_s):
    """Side slip that lasts, as on ice, as a Function (pose, driven, …) -> (pose, slip_angle).

    The robot's course differs from its yaw by an angle, a first-order Gauss-Markov process of the
    standard deviation side_slip_rad and the time constant side_slip_time_s. The way of a sample,
    from `pose` to `driven`, is turned by it; the yaw is not.
    """
    one = (1, 1)
    shapes = memory_of(["side_slip"]) | settings_of(["side_slip"])
    poses = dict(pose=MEMORY["pose"], driven=MEMORY["pose"])

    @casadi_function("slip_sideways", running=one, side_slip_noise=one, **poses, **shapes)
    def slip(pose, driven, running, side_slip_noise, slip_angle, side_slip_rad, side_slip_time_s):
        keep = running * ca.exp(-dt_s / side_slip_time_s)
        slip_angle = gauss_markov(keep, slip_angle, side_slip_noise)
        way = driven[:2] - pose[:2]
        cosine = ca.cos(side_slip_rad * slip_angle)
        sine = ca.sin(side_slip_rad * slip_angle)
        turned = ca.vertcat(cosine * way[0] - sine * way[1], sine * way[0] + cosine * way[1])
        return dict(pose=ca.vertcat(pose[:2] + turned, driven[2]), slip_angle=slip_angle)

    return slip
