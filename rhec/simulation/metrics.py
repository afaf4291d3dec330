"""Errors, violations, settling time: what is reported of a run."""

from types import SimpleNamespace

import numpy as np

from rhec import paper

__all__ = ["SETTLING_SAMPLES", "metrics", "per_sample", "rms", "settled_samples"]

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
    left, gathered = per_sample(c, poses.T, np)
    stays = settled_samples(c.error_true_m)
    begin = stays[0] + SETTLING_SAMPLES if len(stays) else 0
    after = slice(begin if begin < len(c.t_s) else 0, None)
    first_row = left[: np.argmin(c.on_straight) or None]
    values = dict(settling_time_s=c.t_s[stays[0]] if len(stays) else np.float64(np.nan))
    values |= {name: _GATHER[how](value[after]) for name, (how, value) in gathered.items()}
    values |= dict(
        mean_error_from_start_m=_mean_of_known(c.error_m),
        overshoot_m=np.maximum((-np.sign(left[0]) * first_row).max(), 0.0),
        omega_peak_radps=np.abs(c.omega_cmd_radps).max(),
        kkt_rhe_median=np.median(c.kkt_rhe[after]),
        kkt_rhc_median=np.median(c.kkt_rhc[after]),
    )
    known = values | dict(settling_time_s=0.0, kkt_rhe_median=0.0)  # NaN if there is none
    values["all_ok"] = c.ok.all() & np.isfinite([*known.values()]).all()
    return {name: value.item() for name, value in values.items()}  # plain numbers


def per_sample(c, pose, xp):
    """What is gathered of each sample: the distance to the left of the path [m]; and of the samples
    that count, by metric, (how, value). c: columns; pose: the closest path point (x, y, θ); both
    arrays, with xp = numpy, or expressions, with xp = casadi.
    """
    left = (c.y_m - pose[1]) * xp.cos(pose[2]) - (c.x_m - pose[0]) * xp.sin(pose[2])
    turned = c.theta_rad - pose[2]
    across = xp.fabs(xp.sin(turned))
    along = xp.fabs(xp.cos(turned))
    corner = (across * paper.ROBOT_LENGTH_M - (1 - along) * paper.ROBOT_WIDTH_M) / 2 + xp.fabs(left)
    return left, dict(
        mean_error_m=("mean of known", c.error_m),
        mean_error_true_m=("mean", c.error_true_m),
        max_error_true_m=("max", c.error_true_m),
        max_corner_error_true_m=("max", corner * c.on_straight),
        mean_speed_mps=("mean", xp.fabs(c.nu_mps)),
        violations=("sum", (c.error_m > paper.TOLERANCE_M) * c.on_straight),
        violations_true=("sum", (c.error_true_m > paper.TOLERANCE_M) * c.on_straight),
        rms_mu=("rms", c.mu_hat - c.mu),
        rms_kappa=("rms", c.kappa_hat - c.kappa),
        rms_yaw_rad=("rms", c.theta_hat_rad - c.theta_rad),
    )


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


_GATHER = {"mean": np.mean, "mean of known": _mean_of_known, "max": np.max}
_GATHER |= {"sum": np.sum, "rms": rms}
