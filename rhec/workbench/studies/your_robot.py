"""A robot of two tracks that slip: its simulation, its path, and a closed loop for any estimator.

The equations of motion are those of a rigid body between two tracks, each of which moves over
ground at (1 - slip) of its commanded speed.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

__all__ = [
    "DT_S",
    "HORIZON",
    "SIGMA_V",
    "START",
    "Drive",
    "TwoTracks",
    "drive",
    "errors",
    "iterate",
    "tracks",
]

DT_S = 0.2
HORIZON = 15
SIGMA_V = (0.03, 0.03, 0.02, 0.02)  # of x, y [m] and of both tracks' speeds [m/s]
START = (0.0, 0.5, 0.0)  # half a metre beside the path
_STEPS = 40  # of the simulation in a sample, 5 ms each
_PERIOD_S = 20.0  # of the path's bends
_SPEED_MPS = 0.5
_TURNING_MPS = 0.12  # by which each track is slower or faster in a bend


class TwoTracks:
    """The simulated robot, its soil and its path.

    Args:
        track_width_m: Distance of the tracks [m].
        duration_s: Of the drive [s].
        slip_left, slip_right: True slips in the first and the second half of the drive.
    """

    def __init__(self, track_width_m, duration_s, slip_left, slip_right):
        self.track_width_m = track_width_m
        samples = round(duration_s / DT_S)
        self.time_s = DT_S * np.arange(samples)
        halves = np.array([[slip_left[0], slip_right[0]], [slip_left[-1], slip_right[-1]]])
        self.slips = halves[(self.time_s >= duration_s / 2).astype(int)]
        turning = _TURNING_MPS * np.cos(2 * np.pi * DT_S * np.arange(samples + HORIZON) / _PERIOD_S)
        self.u_ref = np.column_stack([_SPEED_MPS - turning, _SPEED_MPS + turning])
        self.x_ref = self._path()

    def _path(self):
        """What a robot without slip drives under u_ref, poses (n + 1, 3)."""
        poses = [np.zeros(3)]
        for u in self.u_ref:
            poses.append(self.move(poses[-1], u, (0, 0)))
        return np.array(poses)

    def move(self, x, u, slips):
        """The pose (x, y, θ) after a sample, by Euler's steps of 5 ms."""
        left, right = (1 - np.asarray(slips)) * u
        for _ in range(_STEPS):
            speed = (left + right) / 2
            yaw_rate = (right - left) / self.track_width_m
            velocity = np.array([speed * np.cos(x[2]), speed * np.sin(x[2]), yaw_rate])
            x = x + DT_S / _STEPS * velocity
        return x

    def references(self, k):
        """Arguments of `rhec.RHC.feedback` with the path from sample k on."""
        states = self.x_ref[k : k + HORIZON + 1].T
        return dict(x_ref=states, u_ref=self.u_ref[k : k + HORIZON].T)


class Drive(NamedTuple):
    """The log of a drive, arrays with a row a sample."""

    x: np.ndarray  # true poses (n, 3)
    z: np.ndarray  # measurements (n, 4)
    u: np.ndarray  # commands (n, 2)
    x_hat: np.ndarray  # estimates (n, 3)
    p_hat: np.ndarray  # estimated slips (n, 2)
    sigma: np.ndarray  # standard deviations of the estimates (n, 5)
    rhe_kkt: np.ndarray  # KKT tolerances (n,)
    rhc_kkt: np.ndarray

    @property
    def tolerances(self):
        """{"RHE": its KKT tolerances, "RHC": its}."""
        return dict(RHE=self.rhe_kkt, RHC=self.rhc_kkt)


def drive(rhe, rhc, robot, seed=0):
    """Drive a robot in closed loop.

    Args:
        rhe: A `rhec.RHE` of a model whose outputs are x, y and both tracks' speeds.
        rhc: A `rhec.RHC` of that model, which commands both tracks.
        robot: A TwoTracks.
        seed: Of the measurement noise.

    Returns:
        Drive.
    """
    rng = np.random.default_rng(seed)
    x = np.array(START)
    u = np.zeros(2)
    rows = []
    for k, slips in enumerate(robot.slips):
        z = np.array([*x[:2], *u]) + SIGMA_V * rng.normal(size=4)
        rhe.prepare()
        estimate = rhe.feedback(z)
        rhc.prepare()
        u = rhc.feedback(x=estimate.x, p=estimate.p, **robot.references(k))
        sigma = np.sqrt(np.diag(estimate.covariance))
        rows.append((x, z, u, estimate.x, estimate.p, sigma, rhe.kkt, rhc.kkt))
        x = robot.move(x, u, slips)
    return Drive(*(np.array(column) for column in zip(*rows)))


def tracks(log, robot):
    """{name: (n, 2) positions [m]} of a drive: measured, reference, truth and RHE."""
    poses = dict(measured=log.z, reference=robot.x_ref[: len(log.x)], truth=log.x, RHE=log.x_hat)
    return {name: values[:, :2] for name, values in poses.items()}


def iterate(rhe, rhc, robot, log, iterations=15):
    """KKT tolerances as the last sample's problems are solved step by step.

    Args:
        rhe, rhc, robot: As of `drive`, after it.
        log: Of `drive`.
        iterations: How many steps.

    Returns:
        {"RHE": tolerances, "RHC": tolerances}.
    """
    tolerances = {"RHE": [], "RHC": []}
    last = len(log.z) - 1
    for _ in range(iterations):
        estimate = rhe.solve(log.z[last], iterations=1)
        tolerances["RHE"].append(rhe.kkt)
        rhc.solve(x=estimate.x, p=estimate.p, **robot.references(last), iterations=1)
        tolerances["RHC"].append(rhc.kkt)
    return tolerances


def errors(log, robot, v_max_mps):
    """Errors of a drive in the second half of each of its halves, after the slips have converged.

    Args:
        log: Of `drive`.
        robot: Its TwoTracks.
        v_max_mps: Bound on the commanded speeds [m/s].

    Returns:
        DataFrame with columns quantity, value.
    """
    samples = len(log.x)
    late = (np.arange(samples) % (samples // 2)) >= samples // 4
    to_path = log.x[:, None, :2] - robot.x_ref[None, :, :2]
    distance_m = np.linalg.norm(to_path, axis=2).min(axis=1)
    slip_error = np.abs(log.p_hat - robot.slips)
    position_error_m = np.linalg.norm((log.x - log.x_hat)[late, :2], axis=1)
    at_bound = np.isin(log.u, [0.0, v_max_mps]).any(axis=1)
    values = {
        "mean distance from the path [m]": distance_m[late].mean(),
        "mean error of the estimated position [m]": position_error_m.mean(),
        "mean error of slip_left": slip_error[late, 0].mean(),
        "mean error of slip_right": slip_error[late, 1].mean(),
        "share of commands at a bound": at_bound.mean(),
    }
    return pd.DataFrame(dict(quantity=[*values], value=[*values.values()]))
