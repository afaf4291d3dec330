"""What not every simulated robot has: gyro and heading. Not in the paper.

Each is a block of the loop, with its own noise and memory; a robot without it does without them.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function
from rhec.tracked_robot.plant import MEMORY, Normal

_ONE = (1, 1)
# Random streams of a seed; others belong to the plant and the faults.
GYRO_NOISE = Normal(5)
HEADING_NOISE = Normal(6)


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
