"""Errors, violations, settling time: what is reported of a run."""

import html
from typing import Any

import numpy as np

from rhec import paper
from rhec.tracked_robot.path import ahead_and_left

# A robot that stays within the tolerance for so long has settled.
SETTLING_SAMPLES = round(5 / paper.DT_S)


# Unit and definition of each metric, in the order of `metrics`. "Settled" samples are those from
# the end of the 5 s that make the robot settled; of a run that never settles, all samples.
METRICS = {
    "settling_time_s": ("s", "when the true error begins to stay below 0.12 m for 5 s; or NaN"),
    "mean_error_m": ("m", "mean of `error_m` where there is a position, as in the paper (G11)"),
    "mean_error_true_m": ("m", "mean of `error_true_m`"),
    "max_error_true_m": ("m", "largest `error_true_m`"),
    # The reference is the corner of a robot that stands in the middle of its row, not turned.
    "max_corner_error_true_m": ("m", "on straights: how much nearer to the crop a corner is"),
    "mean_speed_mps": ("m/s", "mean of the tracks' speed, as an absolute value"),
    "violations": ("samples", "samples on straights with `error_m` above 0.12 m (G14)"),
    "violations_true": ("samples", "samples on straights with `error_true_m` above 0.12 m"),
    "rms_mu": ("-", "RMS error of the estimated μ"),
    "rms_kappa": ("-", "RMS error of the estimated κ"),
    "rms_yaw_rad": ("rad", "RMS error of the estimated yaw"),
    "mean_error_from_start_m": ("m", "mean of `error_m` over the whole run (G14)"),
    "overshoot_m": ("m", "on the first row: the largest distance beyond the path from the start"),
    "omega_peak_radps": ("rad/s", "largest absolute commanded yaw rate of the whole run"),
    "kkt_rhe_median": ("", "median of `kkt_rhe` (G12) over the samples that were not rejected"),
    "kkt_rhc_median": ("", "median of `kkt_rhc` (G12)"),
    "solver_ok": ("", "whether every QP was solved; it says nothing of the errors"),
}


class Metrics(dict[str, Any]):
    """The metrics of a run, {name: value}; a notebook shows their units, too."""

    def _repr_html_(self) -> str:
        """A table, with the units and, as tooltips, the definitions."""
        rows = []
        for name, value in self.items():
            unit, text = METRICS[name]
            shown = f"{value:.4g}" if isinstance(value, float) else value
            cells = f"<td>{name}</td><td>{shown}</td><td>{unit}</td>"
            rows.append(f'<tr title="{html.escape(text)}">{cells}</tr>')
        return f"<table>{''.join(rows)}</table>"


def metrics(columns, poses):
    """The Metrics of a run.

    `columns` has the log's columns (n,) by name, `poses` (n, 3) the poses of the path at its points
    closest to the robot.
    """
    settled = settled_samples(columns["error_true_m"])
    counted = _counted(settled, len(columns["t_s"]))
    left = _left_of_path(columns, poses)
    values = dict(
        settling_time_s=columns["t_s"][settled[0]] if len(settled) else np.float64(np.nan)
    )
    values |= _of_settled_samples(
        {name: column[counted] for name, column in columns.items()}, poses[counted], left[counted]
    )
    values |= dict(
        mean_error_from_start_m=_of_finite(np.mean, columns["error_m"]),
        overshoot_m=_overshoot(left, columns["on_straight"]),
        omega_peak_radps=np.abs(columns["omega_cmd_radps"]).max(),
        kkt_rhe_median=_of_finite(np.median, columns["kkt_rhe"][counted]),
        kkt_rhc_median=_of_finite(np.median, columns["kkt_rhc"][counted]),
    )
    values["solver_ok"] = columns["ok"].all()
    return Metrics({name: value.item() for name, value in values.items()})


def first_violation_s(columns):
    """When the true error on a straight first exceeds the tolerance [s]; NaN if never.

    As in `metrics`, samples count from the end of the 5 s that make the robot settled.
    """
    t_s = columns["t_s"]
    counted = _counted(settled_samples(columns["error_true_m"]), len(t_s))
    outside = (columns["error_true_m"] > paper.TOLERANCE_M) & columns["on_straight"]
    times_s = t_s[counted][outside[counted]]
    return times_s[0] if len(times_s) else np.nan


def _counted(settled, n):
    """The slice of the n samples that count as settled.

    It is the whole run where that never settles, or where fewer samples are left than the 5 s.
    """
    begin = settled[0] + SETTLING_SAMPLES if len(settled) else 0
    return slice(begin if begin < n else 0, None)


def _of_settled_samples(columns, poses, left):
    """The metrics that count settled samples alone."""
    error_m = columns["error_m"]
    error_true_m = columns["error_true_m"]
    on_straight = columns["on_straight"]
    corner_m = _corner_error(columns["theta_rad"] - poses[:, 2], left)
    return dict(
        mean_error_m=_of_finite(np.mean, error_m),
        mean_error_true_m=np.mean(error_true_m),
        max_error_true_m=np.max(error_true_m),
        max_corner_error_true_m=np.max(corner_m * on_straight),
        mean_speed_mps=np.mean(np.abs(columns["nu_mps"])),
        violations=np.sum((error_m > paper.TOLERANCE_M) * on_straight),
        violations_true=np.sum((error_true_m > paper.TOLERANCE_M) * on_straight),
        rms_mu=rms(columns["mu_hat"] - columns["mu"]),
        rms_kappa=rms(columns["kappa_hat"] - columns["kappa"]),
        rms_yaw_rad=rms(columns["theta_hat_rad"] - columns["theta_rad"]),
    )


def _left_of_path(columns, poses):
    """Distance (n,) of the robot to the left of the path [m]."""
    x, y, theta = poses.T
    _, left = ahead_and_left(columns["x_m"] - x, columns["y_m"] - y, theta, np)
    return left


def _corner_error(turned, left):
    """How much nearer to the crop a corner is than that of a robot in place [m].

    |sin Δθ| L/2 - (1 - |cos Δθ|) W/2 + |left|, for a robot of length L and width W, turned by Δθ
    against the path.
    """
    across = np.abs(np.sin(turned))
    along = np.abs(np.cos(turned))
    reach = across * paper.ROBOT_LENGTH_M - (1 - along) * paper.ROBOT_WIDTH_M
    return reach / 2 + np.abs(left)


def _overshoot(left, on_straight):
    """How far the robot gets beyond the path on the first row, seen from where it starts [m]."""
    # argmin is the first sample in a curve; it is 0, too, where there is none: then all count.
    first_row = left[: np.argmin(on_straight) or None]
    return np.maximum((-np.sign(left[0]) * first_row).max(), 0.0)


def settled_samples(error, within=paper.TOLERANCE_M):
    """Numbers of the samples from which on errors (n,) [m] stay within the tolerance for 5 s."""
    inside = np.convolve(error < within, np.ones(SETTLING_SAMPLES), "valid")
    return np.flatnonzero(inside == SETTLING_SAMPLES)


def _of_finite(statistic, values):
    """A statistic of the values that are not NaN; NaN where all are."""
    finite = values[~np.isnan(values)]
    return statistic(finite) if len(finite) else np.float64(np.nan)


def rms(values):
    """Root mean square."""
    return np.sqrt(np.mean(np.square(values)))
