"""How good a replay is, where the log has the truth: yaw error, traction against regression, consistency; and the trial that all logs are put to."""

import numpy as np
import pandas as pd

from rhec import recordings, replays

FROM_M = 8.0             # scored from here on, driven in each segment: before, a wrong first yaw is still being found
FASTEST_RADPS = 0.8      # spins faster than this are also left out, for comparison
WINDOW_S = 5.0           # of the sliding regressions


def slope(x, y):
    """Least-squares slope of y on x through the origin; pairs with a missing entry are left out."""
    known = np.isfinite(x) & np.isfinite(y)
    return np.sum((x * y)[known]) / np.sum((x * x)[known]) if np.any(x[known]) else np.nan


def regression(samples):
    """Apparent (μ, κ) of a whole log: true speed and yaw rate over ground, regressed on what the encoders read."""
    return (slope(samples["nu_meas_mps"].to_numpy(), samples["v_true_mps"].to_numpy()),
            slope(samples["omega_meas_radps"].to_numpy(), samples["yaw_rate_true_radps"].to_numpy()))


def sliding_regression(samples, window_s=WINDOW_S, least=(0.1, 0.1)):
    """The same over the last window_s before each sample: (n, 2), not a number where the mean square of the readings is below `least` [m/s, rad/s]²."""
    columns = []
    for reading, truth, low in (("nu_meas_mps", "v_true_mps", least[0]), ("omega_meas_radps", "yaw_rate_true_radps", least[1])):
        products = pd.DataFrame(dict(xy=samples[reading] * samples[truth], xx=samples[reading] ** 2))
        means = products.groupby(samples["segment"]).rolling(round(window_s / replays.paper.DT_S)).mean().reset_index(drop=True)
        columns.append((means["xy"] / means["xx"]).where(means["xx"] >= low**2))
    return np.stack(columns, axis=1)


def yaw_error(samples):
    """Estimated less true yaw [rad], by the shorter way."""
    return (samples["theta_hat_rad"] - samples["theta_rad"] + np.pi) % (2 * np.pi) - np.pi


def driven(samples):
    """Distance driven in its segment [m] at each sample: by the true positions."""
    step = samples.groupby("segment")[["x_m", "y_m"]].diff()
    return np.hypot(step["x_m"], step["y_m"]).fillna(0).groupby(samples["segment"]).cumsum()


def score(samples, from_m=FROM_M):
    """What a replay's samples are worth against the truth, from `from_m` driven in each segment; rates of [0, 1] and ok count all samples.

    nees_yaw: mean squared yaw error by its own variance, 1 for an estimator that knows how wrong it is; inside_95: share within 1.96 σ.
    """
    counted = samples[driven(samples) >= from_m]
    error, sigma = yaw_error(counted), counted["sigma_theta_rad"]
    slow = counted["omega_meas_radps"].abs() <= FASTEST_RADPS
    mu, kappa = regression(samples)
    traction = samples[["mu_hat", "kappa_hat"]]
    return dict(
        yaw_rms_rad=rms(error), yaw_rms_slow_rad=rms(error[slow]), yaw_worst_rad=error.abs().max(),
        mu_median=counted["mu_hat"].median(), mu_regression=mu, kappa_median=counted["kappa_hat"].median(), kappa_regression=kappa,
        mu_difference=counted["mu_hat"].median() - mu, kappa_difference=counted["kappa_hat"].median() - kappa,
        position_rms_m=rms(np.hypot(counted["x_hat_m"] - counted["x_m"], counted["y_hat_m"] - counted["y_m"])),
        nees_yaw=(error**2 / sigma**2).mean(), inside_95=(error.abs() <= 1.96 * sigma).mean(),
        outside=int((~traction.apply(lambda column: column.between(0, 1))).any(axis=1).sum()), not_ok=int((~samples["ok"]).sum()), samples=len(counted))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def trial(log, seed, noise_m=0.02, yaw_error_rad=0.3, track_width_m=None, from_m=FROM_M, estimator="rhe", **fields):
    """The trial: white noise on the position, a first yaw that is wrong by yaw_error_rad in each segment. Returns the samples and their score.

    seed: of the noise. fields: as `replay`.
    """
    rng = np.random.default_rng(seed)
    recording = recordings.prepare(log, track_width_m)
    noisy = recording.rows.copy()
    noisy[["x_meas_m", "y_meas_m"]] += noise_m * rng.standard_normal((len(noisy), 2))
    first = [rows["theta_rad"].dropna().iloc[0] + yaw_error_rad for _, rows in noisy.groupby("segment")]
    samples = replays.estimate_samples(recording._replace(rows=noisy), replays.settings(estimator, fields), first)
    return samples, score(samples, from_m)
