"""What a log says of a robot in the terms of its ROS drivers, with 95 % intervals.

The parameters belong to diff_drive_controller (multipliers of wheel radius and separation), to
robot_localization (noise), to static_transform_publisher (the antenna) and to the driver of an IMU
(bias and scale of its gyro).
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs.likelihood import Z_95, normal_interval
from rhec.simulation.columns import ESTIMATE, LEVER_ARM, MEASUREMENTS, SIGMA
from rhec.tracked_robot.sensors import UNKNOWNS

_STEP = 5  # samples between the estimates that are compared
_BLOCK_S = 10.0  # length of the blocks that the jackknife leaves out
_LEAST_BLOCKS = 5
# The process noise that robot_localization has by default.
_PROCESS = (0.05, 0.05, 0.06, 0.03, 0.03, 0.06, 0.025, 0.025, 0.04, 0.01, 0.01, 0.02)
_PROCESS += (0.01, 0.01, 0.015)
_NONE = 1e-6  # of what moves by its velocity alone, or does not move
# Columns of estimate and standard deviation, and unit, of what a replay estimates of a robot.
_CONSTANTS = {
    "antenna ahead": (LEVER_ARM[0], SIGMA[6], "m"),
    "antenna left": (LEVER_ARM[1], SIGMA[7], "m"),
    **{of.label: (of.hat, of.sigma_column, of.unit) for of in UNKNOWNS},
}
# What only a calibration tells.
_CALIBRATED = ("noise of the position", "delay of the positions")


class Slope(NamedTuple):
    """Motion over ground over motion by the encoders, and its standard deviation."""

    value: float
    sigma: float


def _jackknife(X, y, block):
    """The Slopes b of the least-squares fit y = X b, whose σ leave out one block after the other.

    They are NaN for few blocks, and where a column of X is 0.
    """
    n = X.shape[1]
    blocks = [X[block == each] for each in np.unique(block)]
    answers = [y[block == each] for each in np.unique(block)]
    grams = np.array([x.T @ x for x in blocks])
    rights = np.array([x.T @ each for x, each in zip(blocks, answers)])
    gram = grams.sum(axis=0)
    if len(blocks) < _LEAST_BLOCKS or not np.diag(gram).all():
        return [Slope(np.nan, np.nan)] * n
    right = rights.sum(axis=0)
    without = np.array([np.linalg.pinv(gram - g) @ (right - r) for g, r in zip(grams, rights)])
    scatter = np.square(without - without.mean(axis=0)).sum(axis=0)
    sigma = np.sqrt((len(blocks) - 1) / len(blocks) * scatter)
    return [Slope(*map(float, each)) for each in zip(np.linalg.pinv(gram) @ right, sigma)]


class _Moves(NamedTuple):
    """What the tracks and the robot moved in each interval of _STEP samples, (n,) each."""

    driven_m: np.ndarray  # by the encoders
    turned_rad: np.ndarray
    ahead_m: np.ndarray  # of the centre of turning, over ground
    left_m: np.ndarray
    yaw_rad: np.ndarray
    block: np.ndarray  # number of the block that the interval belongs to


def _moves(samples):
    """The _Moves of smoothed samples."""
    parts = []
    for segment, part in samples.groupby("segment"):
        part = part[part[ESTIMATE[0]].notna()]
        x, y, yaw = part[ESTIMATE[:3]].to_numpy().T
        ahead, left = part[LEVER_ARM].to_numpy().T
        centre = x + 1j * y - (ahead + 1j * left) * np.exp(1j * yaw)
        step = np.diff(centre) * np.exp(-0.5j * (yaw[1:] + yaw[:-1]))
        speeds = paper.DT_S * part[MEASUREMENTS[2:]].fillna(0).to_numpy()[1:]
        moves = np.column_stack([speeds, step.real, step.imag, np.diff(yaw)])
        moves = moves[: len(moves) // _STEP * _STEP].reshape(-1, _STEP, 5).sum(axis=1)
        block = np.arange(len(moves)) * _STEP * paper.DT_S // _BLOCK_S
        parts.append(np.column_stack([moves, block + 1e6 * segment]))
    return _Moves(*np.concatenate(parts).T)


def slopes(samples):
    """(μ, κ, drift) of a whole log as Slopes, from smoothed estimates.

    μ compares the distances of the centre of turning along its heading with those of the encoders.
    The turns are κ times those of the encoders and the drift [rad/m] times the distance, by which
    a robot turns whose tracks are unlike each other.

    Args:
        samples: DataFrame of smoothed samples of a replay.
    """
    moves = _moves(samples)
    (mu,) = _jackknife(moves.driven_m[:, None], moves.ahead_m, moves.block)
    motion = np.column_stack([moves.turned_rad, moves.driven_m])
    return (mu, *_jackknife(motion, moves.yaw_rad, moves.block))


class Noise(NamedTuple):
    """Noise of an odometry that has been corrected by μ and κ: ahead, to the left, in turning.

    `drift` are the variances by which dead reckoning drifts in a second [m²/s, m²/s, rad²/s];
    `changes` those by which the velocities change in a second [(m/s)²/s, (m/s)²/s, (rad/s)²/s].
    """

    drift: tuple
    changes: tuple


def noise(samples):
    """The Noise of a log, from smoothed estimates.

    With the errors e of the distances and turns in intervals T of 1 s, the drift is E[e²] / T. A
    velocity that is measured f times a second with white noise of variance σ² drifts by σ² / f.

    Args:
        samples: DataFrame of smoothed samples of a replay.
    """
    moves = _moves(samples)
    mu, kappa, drift = slopes(samples)
    seconds = _STEP * paper.DT_S
    errors = (
        moves.ahead_m - mu.value * moves.driven_m,
        moves.left_m,
        moves.yaw_rad - kappa.value * moves.turned_rad - drift.value * moves.driven_m,
    )
    velocities = np.array([moves.ahead_m, moves.left_m, moves.yaw_rad]) / seconds
    goes_on = np.diff(moves.block) <= 1
    changes = np.diff(velocities, axis=1)[:, goes_on]
    return Noise(
        tuple(float(np.mean(error**2)) / seconds for error in errors),
        tuple((np.mean(changes**2, axis=1) / seconds).tolist()),
    )


def of_log(slopes, samples, width_m, calibration=None):
    """The parameters of a log as a DataFrame with columns value, low, high (95 %), unit.

    Args:
        slopes: μ, κ and the drift, as of `slopes`.
        samples: DataFrame of smoothed samples.
        width_m: The stated track width [m].
        calibration: The Calibration of the log, if there is one.
    """
    mu, kappa, drift = slopes
    least = max(kappa.value - Z_95 * kappa.sigma, 1e-6)  # above 0
    inverse = 1 / np.array([kappa.value, kappa.value + Z_95 * kappa.sigma, least])
    ratio = mu.value / kappa.value
    sigma = ratio * np.hypot(mu.sigma / mu.value, kappa.sigma / kappa.value)
    rows = {
        "wheel_separation_multiplier (1/κ)": (*inverse, "-"),
        "effective track width": (*(width_m * inverse), "m"),
        "wheel_radius_multiplier (μ)": row(*mu),
        "wheel_separation_multiplier with it (μ/κ)": row(ratio, sigma),
        "drift in turning": row(*drift, "rad/m"),
    }
    last = samples.dropna(subset=ESTIMATE[0]).iloc[-1]
    for name, (hat, of_hat, unit) in _CONSTANTS.items():
        if hat in samples and np.isfinite(last[hat]):
            rows[name] = row(float(last[hat]), float(last[of_hat]), unit)
    if calibration is not None:
        columns = ["value", "low", "high", "unit"]
        rows |= {name: tuple(calibration.report.loc[name, columns]) for name in _CALIBRATED}
    return pd.DataFrame(rows, index=["value", "low", "high", "unit"]).T


def row(value, sigma, unit="-"):
    """Value, 95 % interval and unit of what has this standard deviation."""
    return *normal_interval(value, sigma), unit


def as_yaml(terms, width_m, noise, rate_hz):
    """The parameters as a file of ROS 2 for diff_drive_controller and robot_localization.

    ROS takes a number without a point for an integer, and refuses a file with anything but nodes:
    what belongs to no node stands in comments.

    Args:
        terms: What `of_log` returns.
        width_m: The stated track width [m].
        noise: The Noise of the odometry.
        rate_hz: Rate of the encoders' messages [Hz].
    """
    comments = ["# Found by rhec in one log, on one ground, with 95 % intervals:"]
    comments += [
        f"# {name}: {value:.4g} {unit} ({low:.4g} to {high:.4g})"
        for name, value, low, high, unit in terms.itertuples()
    ]
    of_nodes = ["wheel_radius_multiplier (μ)", "wheel_separation_multiplier with it (μ/κ)"]
    if not np.isfinite(terms.loc[of_nodes, "value"].astype(float)).all():
        return "\n".join([*comments, "# The log is too short for the parameters of a node.", ""])
    radius, separation = (_numbers([value]) for value in terms.loc[of_nodes, "value"])
    ahead, left, turning = (rate_hz * drift for drift in noise.drift)
    twist = _numbers((ahead, left, _NONE, _NONE, _NONE, turning))
    process = np.array(_PROCESS)
    process[[0, 1, 5]] = _NONE  # x, y, yaw
    process[[6, 7, 11]] = noise.changes  # vx, vy, vyaw
    return "\n".join(
        [
            *comments,
            "diff_drive_controller:",
            "  ros__parameters:",
            f"    wheel_separation: {_numbers([width_m])}",
            "    # The multipliers belong together: with radius multipliers of 1 that of the",
            "    # separation is 1/κ.",
            f"    wheel_separation_multiplier: {separation}",
            f"    left_wheel_radius_multiplier: {radius}",
            f"    right_wheel_radius_multiplier: {radius}",
            f"    # By slip, of messages at {rate_hz:.3g} Hz, and in proportion to this rate:",
            f"    twist_covariance_diagonal: [{twist}]",
            "",
            "ekf_filter_node:  # of robot_localization, with vx, vy and vyaw of that odometry",
            "  ros__parameters:",
            "    two_d_mode: true",
            "    # Per second, of x y z roll pitch yaw vx vy vz vroll vpitch vyaw ax ay az.",
            "    # By the log: vx, vy and vyaw, by which alone x, y and yaw move. The others are",
            "    # robot_localization's own.",
            "    process_noise_covariance: [",
            *(f"      {_numbers(entries)}," for entries in np.diag(process)),
            "    ]",
            "",
        ]
    )


def _numbers(values):
    """Numbers as YAML of any version reads them: with a point, and without an exponent."""
    shown = (np.format_float_positional(v, 5, fractional=False, trim="0") for v in values)
    return ", ".join(shown)
