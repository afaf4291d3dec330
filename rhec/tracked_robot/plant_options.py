"""What not every simulated robot has: gyro, heading, and side slip that lasts. Not in the paper.

Each is a block of the loop, with its own noise and memory; a robot without it does without them.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function
from rhec.tracked_robot.plant import MEMORY, gauss_markov

_ONE = (1, 1)
# Settings, by the names of Scenario's parameters.
SETTINGS = (
    "gyro_sigma_radps",
    "gyro_bias_radps",
    "gyro_scale",
    "heading_sigma_rad",
    "side_slip_rad",
    "side_slip_time_s",
)
# The random streams of a seed for their noise, (samples, 1), by the names of the signals; others
# belong to the plant and the faults.
STREAMS = dict(gyro_noise=5, heading_noise=6, side_slip_noise=7)


def gyro(dt_s):
    """A gyro as a Function that appends its measurement to z = (x, y, ν, ω).

    It measures s (θ_k - θ_{k-1})/Δt + β + σ w, the mean yaw rate over ground since the last sample,
    with the scale s = gyro_scale and the bias β = gyro_bias_radps. In the first sample
    θ_{k-1} = θ_k.

    Args:
        dt_s: Length of a sample Δt [s].
    """

    @casadi_function(
        "gyro",
        z=(4, 1),
        pose=MEMORY["pose"],
        last_yaw=_ONE,
        gyro_bias_radps=_ONE,
        gyro_sigma_radps=_ONE,
        gyro_scale=_ONE,
        gyro_noise=_ONE,
    )
    def gyro(z, pose, last_yaw, gyro_bias_radps, gyro_sigma_radps, gyro_scale, gyro_noise):
        yaw = pose[2]
        rate = (yaw - last_yaw) / dt_s
        error = gyro_bias_radps + gyro_sigma_radps * gyro_noise
        return dict(z=ca.vertcat(z, gyro_scale * rate + error), last_yaw=yaw)

    return gyro


def heading(n_z):
    """A heading, as of two antennas, as a Function that appends θ_k + σ w to the n_z entries of z.

    `within_a_turn` takes its turns off.
    """

    @casadi_function(
        "heading", z=(n_z, 1), pose=MEMORY["pose"], heading_sigma_rad=_ONE, heading_noise=_ONE
    )
    def heading(z, pose, heading_sigma_rad, heading_noise):
        return dict(z=ca.vertcat(z, pose[2] + heading_sigma_rad * heading_noise))

    return heading


def within_a_turn(n_z):
    """The measurement z (n_z,) with its last entry, the heading, between -π and π, as a Function.

    Faults come before: a late measurement lies between two others, not across a full turn.
    """

    @casadi_function("within_a_turn", z=(n_z, 1))
    def within_a_turn(z):
        heading = z[-1]
        turns = ca.floor(heading / (2 * np.pi) + 0.5)
        return dict(z=ca.vertcat(z[:-1], heading - 2 * np.pi * turns))

    return within_a_turn


def slip_sideways(dt_s):
    """Side slip that lasts, as on ice, as a Function (pose, driven, …) -> (pose, slip_angle).

    The robot's course differs from its yaw by an angle, a first-order Gauss-Markov process of the
    standard deviation side_slip_rad and the time constant side_slip_time_s. The way of a sample,
    from `pose` to `driven`, is turned by it; the yaw is not.
    """

    @casadi_function(
        "slip_sideways",
        pose=MEMORY["pose"],
        driven=MEMORY["pose"],
        running=MEMORY["running"],
        side_slip_noise=_ONE,
        slip_angle=_ONE,
        side_slip_rad=_ONE,
        side_slip_time_s=_ONE,
    )
    def slip(pose, driven, running, side_slip_noise, slip_angle, side_slip_rad, side_slip_time_s):
        keep = running * ca.exp(-dt_s / side_slip_time_s)
        slip_angle = gauss_markov(keep, slip_angle, side_slip_noise)
        way = driven[:2] - pose[:2]
        cosine = ca.cos(side_slip_rad * slip_angle)
        sine = ca.sin(side_slip_rad * slip_angle)
        turned = ca.vertcat(cosine * way[0] - sine * way[1], sine * way[0] + cosine * way[1])
        return dict(pose=ca.vertcat(pose[:2] + turned, driven[2]), slip_angle=slip_angle)

    return slip
