"""A robot of two tracks that slip: its simulation, its path, and a closed loop for any estimator.

The equations of motion are those of a rigid body between two tracks, each of which moves over
ground at (1 - slip) of its commanded speed.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.tracked_robot.path import Path
from rhec.tracked_robot.references import PathTracker

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
_SPEED_MPS = 0.5  # desired on the path
_BEND_M = 5.0  # length of the path's bends
_BEND_PER_M = 0.5  # their curvature


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
        n_bends = round(samples * DT_S * _SPEED_MPS / _BEND_M) + 1
        bends = [(_BEND_M, -_BEND_PER_M * (-1) ** k) for k in range(n_bends)]
        self.path = Path.from_segments([(_BEND_M / 2, _BEND_PER_M), *bends])

    def move(self, x, u, slips):
        """The pose (x, y, θ) after a sample, by Euler's steps of 5 ms."""
        left, right = (1 - np.asarray(slips)) * u
        for _ in range(_STEPS):
            speed = (left + right) / 2
            yaw_rate = (right - left) / self.track_width_m
            velocity = np.array([speed * np.cos(x[2]), speed * np.sin(x[2]), yaw_rate])
            x = x + DT_S / _STEPS * velocity
        return x

    def tracker(self):
        """A PathTracker of the path at the desired speed."""
        names = dict(position=("x_m", "y_m"), heading="theta_rad")
        return PathTracker(self.path, HORIZON, DT_S, speed=_SPEED_MPS, **names)

    def references(self, tracker, estimate):
        """Arguments of `rhec.RHC.feedback`: desired poses, and track speeds that turn with them."""
        x_ref, yaw_rates = tracker.references(estimate)
        turning = yaw_rates * self.track_width_m / 2
        return dict(x_ref=x_ref, u_ref=np.array([_SPEED_MPS - turning, _SPEED_MPS + turning]))


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
    references: dict  # of the last sample, {"x_ref": (3, N+1), "u_ref": (2, N)}

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
    tracker = robot.tracker()
    for slips in robot.slips:
        z = np.array([*x[:2], *u]) + SIGMA_V * rng.normal(size=4)
        rhe.prepare()
        estimate = rhe.feedback(z)
        rhc.prepare()
        references = robot.references(tracker, estimate)
        u = rhc.feedback(x=estimate.x, p=estimate.p, **references)
        sigma = np.sqrt(np.diag(estimate.covariance))
        rows.append((x, z, u, estimate.x, estimate.p, sigma, rhe.kkt, rhc.kkt))
        x = robot.move(x, u, slips)
    return Drive(*(np.array(column) for column in zip(*rows)), references)


def tracks(log, robot):
    """{name: (n, 2) positions [m]} of a drive: measured, reference, truth and RHE."""
    _, s_m = robot.path.project(log.x[:, :2])
    reference, _ = robot.path.poses(np.linspace(0, s_m.max(), len(log.x)))
    poses = dict(measured=log.z, reference=reference, truth=log.x, RHE=log.x_hat)
    return {name: values[:, :2] for name, values in poses.items()}


def iterate(rhe, rhc, log, iterations=15):
    """KKT tolerances as the last sample's problems are solved step by step.

    Args:
        rhe, rhc: As of `drive`, after it.
        log: Of `drive`.
        iterations: How many steps.

    Returns:
        {"RHE": tolerances, "RHC": tolerances}.
    """
    tolerances = {"RHE": [], "RHC": []}
    for _ in range(iterations):
        estimate = rhe.solve(log.z[-1], iterations=1)
        tolerances["RHE"].append(rhe.kkt)
        rhc.solve(x=estimate.x, p=estimate.p, **log.references, iterations=1)
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
    left_m, _ = robot.path.project(log.x[:, :2])
    distance_m = np.abs(left_m)
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
