"""Two filters to be compared with the RHE on a log: EKFs of (μ, κ), and of centres of rotation.

The second has five parameters of a skid-steering robot: instantaneous centres of rotation (ICR)
and slip. It is not in the paper; Martínez, Mandow, Morales, Pedraza and García-Cerezo (2005), and
Pentzer, Brennan and Reichard (2014), who estimate them with an EKF. Over ground the left track
rolls about a centre y_l to the left of the antenna, the right one about y_r (below 0), and the
robot turns about a centre x_v ahead; α_l and α_r are the shares of the tracks' speeds that reach
the ground.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper
from rhec.core.estimator.base import noise_of
from rhec.core.model.base import Model, MotionNoise
from rhec.logs.recording import with_ages
from rhec.logs.replay import Replay, build_model_replay, innovations, most_likely_heading
from rhec.simulation.columns import ESTIMATE, INNOVATION, MEASUREMENTS, SIGMA
from rhec.tracked_robot.kinematics import SPEED_MODELS

_SIGMA_FIRST_M = 1.0  # of the first position
_DELTA = "delta_mps"  # half the difference of the tracks' speeds


def f(xi, u, p):
    """ξ̇ = f(ξ, u, p) of the antenna's place and the yaw (x, y, θ).

    u are the mean of the tracks' speeds ν and half their difference δ = bω/2 [m/s], p the centres
    y_l, y_r, x_v [m] and shares α_l, α_r.
    """
    y_l = p[0]
    y_r = p[1]
    x_v = p[2]
    left = p[3] * (u[0] - u[1])
    right = p[4] * (u[0] + u[1])
    turning = (right - left) / (y_l - y_r)
    ahead = (right * y_l - left * y_r) / (y_l - y_r)
    side = -x_v * turning
    cos = ca.cos(xi[2])
    sin = ca.sin(xi[2])
    return ca.vertcat(ahead * cos - side * sin, ahead * sin + side * cos, turning)


# Noise of the inputs in proportion to them, too.
_OF_INPUTS = MotionNoise(
    constants=dict(share_nu=0.1, share_turning=0.1),
    inputs=lambda v, R, c: (v, R + (c * v) ** 2),
    process=lambda v, W, dt_s, c: W,
)
ICR = Model(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("nu_mps", _DELTA),
    parameters=dict.fromkeys(("y_left_m", "y_right_m", "x_turning_m", "left", "right")),
    outputs=("x_m", "y_m", "nu_mps", _DELTA),
    f=f,
    max_measurement=(1e8, 1e8, 100.0, 100.0),
    motion_noise=_OF_INPUTS,
)
TRACTION = dataclasses.replace(SPEED_MODELS["input"].model, motion_noise=_OF_INPUTS)


def _traction_of_icr(p, half_m):
    """(μ, κ) of ICR parameters p (n, 5): speed ahead by ν, and turning by ω, both without other."""
    y_l, y_r, _, left, right = p.T
    return (right * y_l - left * y_r) / (y_l - y_r), half_m * (left + right) / (y_l - y_r)


class Rival(NamedTuple):
    """An EKF that a log is given to."""

    model: Model
    first: Callable  # (half the track width [m]) -> the parameters' first guess, its deviations
    walks: Callable  # (walks of μ and κ, half the track width) -> those of the parameters
    traction: Callable  # (parameters (n, p), half the track width) -> (μ, κ)

    @property
    def measured(self):
        """Columns of what its model measures."""
        return [*MEASUREMENTS[:3], _DELTA if self.model is ICR else MEASUREMENTS[3]]

    @property
    def hats(self):
        """Columns of the estimates of its model."""
        return [f"hat_{name}" for name in self.model.names]


RIVALS = {
    "EKF of (μ, κ)": Rival(
        TRACTION,
        first=lambda half: ([1.0, 1.0], [0.25, 0.25]),
        walks=lambda walks, half: walks,
        traction=lambda p, half: tuple(p.T),
    ),
    "EKF of ICR": Rival(
        ICR,
        first=lambda half: ([half, -half, 0.0, 1.0, 1.0], [half, half, 0.1, 0.25, 0.25]),
        walks=lambda walks, half: (half * walks[1], half * walks[1], 0.0, walks[0], walks[0]),
        traction=_traction_of_icr,
    ),
}


def parts_of(recording):
    """Samples of each segment of a Recording, with half the difference of the tracks' speeds."""
    half_m = recording.track_width_m / 2
    return [part.assign(**{_DELTA: half_m * part[MEASUREMENTS[3]]}) for part in recording.samples()]


def same_noise(rival, settings, parts, half_m):
    """The noise of a rival that is that of the RHE's speed model "slipping", in the mean of a log.

    Slip in proportion to the motion is noise of the inputs. Slip to the side, bumps, and the walks
    of μ and κ, which grow with the distance, become noise per sample.

    Args:
        rival: The Rival.
        settings: V, W and c of the RHE (`tuning.SLIP`).
        parts: As of `parts_of`.
        half_m: Half the track width [m].
    """
    moves = pd.concat(parts)[MEASUREMENTS[2:]].fillna(0.0).to_numpy()
    share_nu, share_omega, share_side, sigma_bumps, *_ = settings["c"]
    tracks = np.abs(moves @ [[1.0, 1.0], [-half_m, half_m]])
    driven_m = paper.DT_S * tracks.mean()  # in a sample, by the mean of the tracks
    side_m = paper.DT_S * share_side * 2 * half_m * np.sqrt(np.mean(moves[:, 1] ** 2))
    bumps_rad = sigma_bumps * np.sqrt(paper.DT_S * np.abs(moves[:, 0]).mean())
    walks = rival.walks(np.sqrt(driven_m * settings["W"][-2:]), half_m)
    sigma_v = np.sqrt(settings["V"][:4])
    if rival.model is ICR:
        sigma_v[3] *= half_m
    noise = noise_of(rival.model, sigma_v, (side_m, side_m, bumps_rad, *walks))
    return noise | dict(c=np.array([share_nu, share_omega]))


def _replay_of(rival, settings):
    """The Replay of a rival."""
    parameters = [f"sigma_{name}" for name in rival.model.parameters]
    return Replay(
        dt_s=paper.DT_S,
        model=rival.model,
        quantities=rival.model.names,
        measured=rival.measured,
        means=rival.measured[2:],
        recorded=dict(estimate=rival.hats, sigma=[*SIGMA[:3], *parameters], deviance=["deviance"]),
        build=build_model_replay,
        structure=(False, rival.model, paper.DT_S),
        settings=settings,
    )


def run(rival, settings, part, half_m, yaw_rad=None, sigma_yaw_rad=0.3):
    """Samples of a rival on one segment, with the columns of a replay.

    Args:
        rival: The Rival.
        settings: Its noise V, W and c.
        part: A segment's samples, as of `parts_of`.
        half_m: Half the track width [m].
        yaw_rad: First yaw [rad]. If it is None, several directions are tried, as in a replay.
        sigma_yaw_rad: Its standard deviation [rad].
    """
    how = _replay_of(rival, settings)
    stream = with_ages(part, rival.measured)
    known = np.isfinite(stream[:, :2]).all(axis=1)
    place = stream[np.argmax(known), :2] if known.any() else (0.0, 0.0)
    guess, spread = rival.first(half_m)

    def run_from(yaw_rad, sigma_yaw_rad):
        mean = np.array([*place, yaw_rad, *guess])
        values = dict(zip(rival.model.joint_names, mean))
        first = [values.get(name, 0.0) for name in how.quantities]
        P = np.diag(np.square([_SIGMA_FIRST_M, _SIGMA_FIRST_M, sigma_yaw_rad, *spread]))
        last_inputs = np.zeros(len(rival.model.inputs))
        return how.scanned(np.concatenate([mean, P.ravel(), last_inputs, [0.0], first]), stream)

    if yaw_rad is None:
        found = most_likely_heading(how, run_from, stream)
    else:
        found = run_from(yaw_rad, sigma_yaw_rad)
    found[INNOVATION] = innovations(how, found, stream)
    found[: len(part) if not known.any() else np.argmax(known)] = np.nan
    hats = found[rival.hats].to_numpy()
    traction = rival.traction(hats[:, -len(rival.model.parameters) :], half_m)
    values = dict(zip(ESTIMATE, [*hats[:, :4].T, *traction]))
    samples = pd.concat([part.reset_index(drop=True), found], axis=1)
    return samples.assign(**values, position_accepted=known)
