"""Two filters to be compared with the RHE on a log: EKFs of (μ, κ), and of centres of rotation.

Both have the noise of the RHE's speed model "slipping". The first one is that model without a lever
arm of the antenna. The second one has five parameters of a skid-steering robot: instantaneous
centres of rotation (ICR) and slip. It is not in the paper; Martínez, Mandow, Morales, Pedraza and
García-Cerezo (2005), and Pentzer, Brennan and Reichard (2014), who estimate them with an EKF. Over
ground the left track rolls about a centre y_l to the left of the antenna, the right one about y_r
(below 0), and the robot turns about a centre x_v ahead; α_l and α_r are the shares of the tracks'
speeds that reach the ground.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper
from rhec.core.model.robot_model import Model
from rhec.logs.recording import with_ages
from rhec.logs.replay import POSITION_AND_ENCODERS, Replay, estimated
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, SIGMA
from rhec.tracked_robot.slipping import SLIPPING

_SIGMA_FIRST_M = 1.0  # of the first position
_SIGMA_FIRST_YAW_RAD = 0.3


def f(xi, v, p):
    """ξ̇ = f(ξ, v, p) of the antenna's place and the yaw (x, y, θ).

    v (5,) are speed ν [m/s] and yaw rate ω [rad/s] of the tracks and slip, as of `slipping.f`; p
    the centres y_l, y_r, x_v [m], the shares α_l, α_r, and half the track width b/2 [m], which is
    known.
    """
    y_l, y_r, x_v, alpha_l, alpha_r, half_m = (p[i] for i in range(6))
    left = alpha_l * (v[0] - half_m * v[1])
    right = alpha_r * (v[0] + half_m * v[1])
    turning = (right - left) / (y_l - y_r) + v[4]
    ahead = (right * y_l - left * y_r) / (y_l - y_r) + v[2]
    side = v[3] - x_v * turning
    cos = ca.cos(xi[2])
    sin = ca.sin(xi[2])
    return ca.vertcat(ahead * cos - side * sin, ahead * sin + side * cos, turning)


class Rival(NamedTuple):
    """An EKF that a log is given to."""

    model: Model
    first: Callable  # (half the track width [m]) -> the parameters' first guess, its deviations
    traction: Callable  # (parameters (n, p)) -> (μ, κ)


def _traction_of_icr(p):
    """(μ, κ) of ICR parameters p (n, 6): speed ahead by ν, and turning by ω, both without other."""
    y_l, y_r, _, left, right, half_m = p.T
    return (right * y_l - left * y_r) / (y_l - y_r), half_m * (left + right) / (y_l - y_r)


_OF_ICR = ("y_left_m", "y_right_m", "x_turning_m", "left", "right", "half_width_m")
RIVALS = {
    "EKF of (μ, κ)": Rival(
        SLIPPING.model,
        first=lambda half: ([0.0, 0.0, 1.0, 1.0], [0.0, 0.0, 0.25, 0.25]),
        traction=lambda p: tuple(p.T[2:]),
    ),
    "EKF of ICR": Rival(
        dataclasses.replace(SLIPPING.model, parameters=dict.fromkeys(_OF_ICR), f=f),
        first=lambda half: ([half, -half, 0.0, 1.0, 1.0, half], [half, half, 0.1, 0.25, 0.25, 0.0]),
        traction=_traction_of_icr,
    ),
}


def replay_of(rival, settings):
    """The Replay of a rival with this noise."""
    names = rival.model.names
    return Replay(
        model=rival.model,
        dt_s=paper.DT_S,
        quantities=names,
        hats=[f"hat_{name}" for name in names],
        sigmas=[*SIGMA[:3], *(f"sigma_{name}" for name in names[3:])],
        measured=MEASUREMENTS,
        structure=(POSITION_AND_ENCODERS, "ekf", rival.model, paper.DT_S),
        settings=settings,
    )


def _first_memory(rival, half_m, place, yaw_rad, sigma_yaw_rad):
    """The memory of a rival's scan before the first sample."""
    guess, spread = rival.first(half_m)
    mean = np.array([*place, yaw_rad, *guess])
    P = np.diag(np.square([_SIGMA_FIRST_M, _SIGMA_FIRST_M, sigma_yaw_rad, *spread]))
    values = dict(zip(rival.model.joint_names, mean))
    first = [values.get(name, 0.0) for name in rival.model.names]
    return np.concatenate([mean, P.ravel(), np.zeros(len(rival.model.inputs) + 1), first])


def deviances(rival, settings, part, half_m, yaw_rad):
    """-2 log likelihood of each sample of a segment (n,); the arguments are those of `run`."""
    how = replay_of(rival, settings)
    place = part[MEASUREMENTS[:2]].dropna().iloc[0]
    memory = _first_memory(rival, half_m, place, yaw_rad, _SIGMA_FIRST_YAW_RAD)
    return how.scanned(memory, with_ages(part, how.measured))["deviance"].to_numpy()


def run(rival, settings, part, half_m, yaw_rad):
    """Samples of a rival on one segment, with the columns of a replay.

    Args:
        rival: The Rival.
        settings: Its noise V, W and c.
        part: A segment's samples, as of `Recording.samples`.
        half_m: Half the track width [m].
        yaw_rad: First yaw [rad].
    """
    how = replay_of(rival, settings)
    first_memory = partial(_first_memory, rival, half_m)
    stream = with_ages(part, how.measured)
    found = estimated(how, stream, first_memory, yaw_rad, _SIGMA_FIRST_YAW_RAD)
    hats = found[how.hats].to_numpy()
    traction = rival.traction(hats[:, -len(rival.model.parameters) :])
    values = dict(zip(ESTIMATE, [*hats[:, :4].T, *traction]))
    return pd.concat([part.reset_index(drop=True), found], axis=1).assign(**values)
