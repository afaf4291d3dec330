"""Errors, violations, settling time: what is reported of a run."""

from types import SimpleNamespace

import numpy as np

from rhec import paper
from rhec._casadi.renamed import Renamed

__all__ = ["SETTLING_SAMPLES", "metrics", "rms", "settled_samples"]

SETTLING_SAMPLES = round(5 / paper.DT_S)  # who stays within the tolerance so long has settled


def metrics(columns, poses):
    """Metrics of a run from its log columns and closest path points `poses` (n, 3); m and s.

    The robot has settled when its true error stays within the tolerance for 5 s; errors and
    violations count from the end of these 5 s, or on the whole run if it never settles.
    `mean_error_m` is the paper's: raw GNSS to the path (interpretation R11), where there is a
    position. Corner error: how much nearer to the crop a corner is on straights than that of a
    robot in place. Overshoot: how far on the first row it is beyond the path, from the start.
    """
    c = SimpleNamespace(**columns)
    stays = settled_samples(c.error_true_m)
    begin = stays[0] + SETTLING_SAMPLES if len(stays) else 0
    after = slice(begin if begin < len(c.t_s) else 0, None)
    straight = c.on_straight[after]
    left = (c.y_m - poses[:, 1]) * np.cos(poses[:, 2]) - (c.x_m - poses[:, 0]) * np.sin(poses[:, 2])
    across, along = (np.abs(part(c.theta_rad - poses[:, 2])) for part in (np.sin, np.cos))
    corner = (across * paper.ROBOT_LENGTH_M - (1 - along) * paper.ROBOT_WIDTH_M) / 2 + np.abs(left)
    first_row = left[: np.argmin(c.on_straight) or None]
    values = dict(
        settling_time_s=c.t_s[stays[0]] if len(stays) else np.float64(np.nan),
        mean_error_m=_mean_of_known(c.error_m[after]),
        mean_error_true_m=c.error_true_m[after].mean(),
        max_error_true_m=c.error_true_m[after].max(),
        max_corner_error_true_m=corner[after][straight].max(initial=0.0),
        mean_speed_mps=np.abs(c.nu_mps[after]).mean(),
        mean_error_from_start_m=_mean_of_known(c.error_m),
        violations=np.sum(c.error_m[after][straight] > paper.TOLERANCE_M),
        violations_true=np.sum(c.error_true_m[after][straight] > paper.TOLERANCE_M),
        overshoot_m=np.maximum((-np.sign(left[0]) * first_row).max(), 0.0),
        rms_mu=rms((c.mu_hat - c.mu)[after]), rms_kappa=rms((c.kappa_hat - c.kappa)[after]),
        rms_yaw_rad=rms((c.theta_hat_rad - c.theta_rad)[after]),
        omega_peak_radps=np.abs(c.omega_cmd_radps).max(),
        kkt_rhe_median=np.median(c.kkt_rhe[after]), kkt_rhc_median=np.median(c.kkt_rhc[after]),
    )  # fmt: skip
    known = values | dict(settling_time_s=0.0, kkt_rhe_median=0.0)  # NaN if there is none
    values["all_ok"] = c.ok.all() & np.isfinite([*known.values()]).all()
    return Renamed({name: value.item() for name, value in values.items()})  # plain numbers


def settled_samples(error, within=paper.TOLERANCE_M):
    """The samples from which on the error (n,) [m] stays within so much for 5 s."""
    if len(error) <= SETTLING_SAMPLES:
        return np.array([], dtype=int)
    inside = np.convolve(error < within, np.ones(SETTLING_SAMPLES), "valid")
    return np.flatnonzero(inside == SETTLING_SAMPLES)


def _mean_of_known(values):
    """Mean of the values that are no NaN; NaN of none."""
    known = values[~np.isnan(values)]
    return known.mean() if len(known) else np.float64(np.nan)


def rms(values):
    """Root mean square."""
    return np.sqrt(np.mean(np.square(values)))
