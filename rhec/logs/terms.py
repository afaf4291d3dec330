"""What a log says of a robot in the terms of its ROS drivers, with 95 % intervals.

The parameters belong to diff_drive_controller (multipliers of wheel radius and separation), to
static_transform_publisher (the antenna) and to the driver of an IMU (bias and scale of its gyro).
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.simulation.columns import ESTIMATE, LEVER_ARM, MEASUREMENTS

_STEP = 5  # samples between the estimates that are compared
_BLOCK_S = 10.0  # length of the blocks that the jackknife leaves out
_LEAST_BLOCKS = 5
_Z = 1.96


class Slope(NamedTuple):
    """Motion over ground over motion by the encoders, and its standard deviation."""

    value: float
    sigma: float


def _jackknife(x, y, block):
    """The _Slope Σ xy / Σ x², whose standard deviation leaves out one block after the other."""
    sums = pd.DataFrame(dict(xy=x * y, xx=x * x)).groupby(block).sum()
    total = sums.sum()
    n = len(sums)
    if n < _LEAST_BLOCKS or total["xx"] <= 0:
        return Slope(np.nan, np.nan)
    without = (total["xy"] - sums["xy"]) / (total["xx"] - sums["xx"])
    sigma = np.sqrt((n - 1) / n * ((without - without.mean()) ** 2).sum())
    return Slope(float(total["xy"] / total["xx"]), float(sigma))


def slopes(samples):
    """(μ, κ) of a whole log as Slopes, from smoothed estimates.

    μ compares the distances of the centre of turning along its heading with those of the encoders,
    and κ the turns.

    Args:
        samples: DataFrame of smoothed samples of a replay.
    """
    parts = []
    for segment, part in samples.groupby("segment"):
        part = part[part[ESTIMATE[0]].notna()]
        x, y, yaw = part[ESTIMATE[:3]].to_numpy().T
        ahead, left = part[LEVER_ARM].fillna(0).to_numpy().T
        centre = x + 1j * y - (ahead + 1j * left) * np.exp(1j * yaw)
        step = np.diff(centre) * np.exp(-0.5j * (yaw[1:] + yaw[:-1]))
        speeds = paper.DT_S * part[MEASUREMENTS[2:]].fillna(0).to_numpy()[1:]
        moves = np.column_stack([speeds, step.real, np.diff(yaw)])
        moves = moves[: len(moves) // _STEP * _STEP].reshape(-1, _STEP, 4).sum(axis=1)
        block = np.arange(len(moves)) * _STEP * paper.DT_S // _BLOCK_S
        parts.append(np.column_stack([moves, block + 1e6 * segment]))
    n, w, d, turn, block = np.concatenate(parts).T
    return _jackknife(n, d, block), _jackknife(w, turn, block)


def _row(value, sigma, unit):
    return dict(value=value, low=value - _Z * sigma, high=value + _Z * sigma, unit=unit)


def _inverse(slope, factor, unit):
    """A row of factor / slope."""
    low = factor / (slope.value + _Z * slope.sigma)
    high = factor / max(slope.value - _Z * slope.sigma, 1e-6)
    return dict(value=factor / slope.value, low=low, high=high, unit=unit)


def table(mu, kappa, width_m, others):
    """The parameters as a DataFrame with columns value, low, high, unit.

    Args:
        mu, kappa: Slopes.
        width_m: The stated track width [m].
        others: {parameter: (value, standard deviation, unit)}.
    """
    ratio = np.hypot(mu.sigma / mu.value, kappa.sigma / kappa.value)
    multiplier = mu.value / kappa.value
    rows = {
        "wheel_separation_multiplier (1/κ)": _inverse(kappa, 1.0, "-"),
        "effective track width": _inverse(kappa, width_m, "m"),
        "wheel_radius_multiplier (μ)": _row(*mu, "-"),
        "wheel_separation_multiplier with it (μ/κ)": _row(multiplier, multiplier * ratio, "-"),
    }
    rows |= {name: _row(*value) for name, value in others.items()}
    return pd.DataFrame(rows).T


def as_yaml(terms, width_m, sigma_v):
    """The parameters as YAML for diff_drive_controller and robot_localization.

    Args:
        terms: What `table` returns.
        width_m: The stated track width [m].
        sigma_v: Standard deviations of (x, y, ν, ω).
    """

    def line(indent, key, name):
        row = terms.loc[name]
        value = f"{row['value']:.5g}  # 95 %: {row['low']:.4g} to {row['high']:.4g}"
        return f"{' ' * indent}{key}: {value}"

    radius = "wheel_radius_multiplier (μ)"
    lines = [
        "# Found by rhec.calibrate in one log, on one ground. The two multipliers belong together:",
        "# with a wheel_radius_multiplier of 1 the wheel_separation_multiplier is",
        line(0, "# 1/κ", "wheel_separation_multiplier (1/κ)"),
        "diff_drive_controller:",
        "  ros__parameters:",
        f"    wheel_separation: {width_m:.5g}",
        line(4, "wheel_separation_multiplier", "wheel_separation_multiplier with it (μ/κ)"),
        line(4, "left_wheel_radius_multiplier", radius),
        line(4, "right_wheel_radius_multiplier", radius),
        "    twist_covariance_diagonal: "
        f"[{sigma_v[2] ** 2:.3g}, 1.0e-3, 0.0, 0.0, 0.0, {sigma_v[3] ** 2:.3g}]",
        "",
        "# robot_localization takes these from messages and TF, not as parameters of its own:",
        "base_link_to_gnss:  # static_transform_publisher, from the centre of turning",
        line(2, "x", "antenna ahead"),
        line(2, "y", "antenna left"),
        "gnss:",
        line(
            2, "position_sigma_m  # square it for NavSatFix.position_covariance", "GNSS noise"
        ).replace("  # square it for NavSatFix.position_covariance", "", 1),
        line(2, "delay_s", "delay of the positions"),
    ]
    if "gyro bias" in terms.index:
        lines += [
            "imu:",
            line(2, "gyro_bias_radps", "gyro bias"),
            line(2, "gyro_scale", "gyro scale"),
        ]
    return "\n".join(lines) + "\n"
