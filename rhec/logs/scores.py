"""How good a replay is: against the truth where the log has it, by its innovations where not; and
the trial that every log can be put to.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs import recording as recordings
from rhec.logs import replay as replays

# scores count from here on, driven in each segment: before, a wrong first yaw is still being found
FROM_M = 8.0
FAST_RADPS = 0.8  # without the spins that are faster than this, yaw errors are given, too
WINDOW_S = 5.0  # of the sliding regressions,
LEAST_RMS = 0.1  # which need readings of this size in their window [m/s, rad/s]
REGRESSIONS = (
    ("nu_meas_mps", "v_true_mps"),
    ("omega_meas_radps", "yaw_rate_true_radps"),
)  # of μ, of κ


def regression(samples):
    """Apparent (μ, κ) of the whole log: true speed and yaw rate over ground on what the encoders
    read, least squares through the origin.
    """
    products = [
        (samples[reading] * samples[truth], samples[reading] ** 2) for reading, truth in REGRESSIONS
    ]
    totals = [(xy.sum(), xx[xy.notna()].sum()) for xy, xx in products]
    return tuple(
        xy / xx if xx > 0 else np.nan for xy, xx in totals
    )  # a robot that never moves tells nothing


def sliding_regression(samples):
    """The same over the WINDOW_S around each sample, (n, 2); not a number where the readings are
    too small to tell.
    """
    columns = []
    for reading, truth in REGRESSIONS:
        products = pd.DataFrame(
            dict(xy=samples[reading] * samples[truth], xx=samples[reading] ** 2)
        )
        means = (
            products.groupby(samples["segment"])
            .rolling(round(WINDOW_S / paper.DT_S), center=True)
            .mean()
            .reset_index(drop=True)
        )
        columns.append((means["xy"] / means["xx"]).where(means["xx"] >= LEAST_RMS**2))
    return np.stack(columns, axis=1)


def yaw_error(samples):
    """Estimated less true yaw [rad], by the shorter way."""
    return (samples["theta_hat_rad"] - samples["theta_rad"] + np.pi) % (2 * np.pi) - np.pi


def driven(samples):
    """Distance driven in its segment [m] at each sample, forwards or backwards, as the tracks have
    it.
    """
    return (
        (paper.DT_S * samples["nu_meas_mps"].abs().fillna(0)).groupby(samples["segment"]).cumsum()
    )


def score(samples):
    """A replay's samples in numbers, as a dict. All but `outside` and `not_ok` count from FROM_M
    driven in each segment.

    innovation_rms_m; outside: samples with an estimate of μ or κ that is not in [0, 1]; not_ok:
    samples whose step failed. With the truth in the log: yaw_rms_rad, yaw_rms_slow_rad (without
    fast spins), position_rms_m, medians of μ and κ beside their regressions, and how well the
    estimator knows its yaw error: nees_yaw, the mean of its square by its variance (1 if it knows),
    and inside_95, the share within 1.96 standard deviations.
    """
    counted = samples[driven(samples) >= FROM_M]
    values = dict(
        samples=len(counted),
        innovation_rms_m=rms(counted["innovation_x_m"], counted["innovation_y_m"]),
        mu_median=counted["mu_hat"].median(),
        kappa_median=counted["kappa_hat"].median(),
        outside=int(
            (~(samples["mu_hat"].between(0, 1) & samples["kappa_hat"].between(0, 1))).sum()
        ),
        not_ok=int((~samples["ok"]).sum()),
    )
    if "theta_rad" in samples:
        error, sigma = yaw_error(counted), counted["sigma_theta_rad"]
        slow = counted["omega_meas_radps"].abs() <= FAST_RADPS
        values |= dict(
            yaw_rms_rad=rms(error),
            yaw_rms_slow_rad=rms(error[slow]),
            nees_yaw=(error**2 / sigma**2).mean(),
            inside_95=(error.abs() <= 1.96 * sigma)[error.notna()].mean(),
        )
    if {"x_m", "y_m"} <= set(samples):
        values["position_rms_m"] = rms(
            counted["x_hat_m"] - counted["x_m"], counted["y_hat_m"] - counted["y_m"]
        )
    if {truth for _, truth in REGRESSIONS} <= set(samples):
        mu, kappa = regression(samples)
        values |= dict(
            mu_regression=mu,
            kappa_regression=kappa,
            mu_difference=values["mu_median"] - mu,
            kappa_difference=values["kappa_median"] - kappa,
        )
    return values


def rms(*components):
    """Root mean square of a vector's length; where a component is missing the vector does not
    count.
    """
    return (
        float(np.sqrt(np.nanmean(sum(np.square(each) for each in components))))
        if len(components[0])
        else np.nan
    )


def trial(
    log,
    seed,
    noise_m=0.02,
    yaw_error_rad=0.3,
    estimator="rhe",
    *,
    track_width_m=None,
    lever_arm_m=None,
    faults=(),
    **fields,
):
    """A harder replay: with white noise of noise_m on the position and a first yaw that is wrong by
    yaw_error_rad in each segment. Returns the samples.

    seed: of the noise; faults: (rhec.Fault, …) on top; the rest: as `replay`. Where the log has no
    true yaw the first one is found as `replay` does.
    """
    recording = recordings.prepare(log, track_width_m)
    rows = recording.rows.copy()
    rows[["x_meas_m", "y_meas_m"]] += noise_m * np.random.default_rng(seed).standard_normal(
        (len(rows), 2)
    )
    known = "theta_rad" in rows and rows["theta_rad"].groupby(rows["segment"]).count().all()
    yaws = (
        tuple(
            each["theta_rad"].dropna().iloc[0] + yaw_error_rad
            for _, each in rows.groupby("segment")
        )
        if known
        else None
    )
    first = replays.InitialGuess(yaws, lever_arm_m=lever_arm_m)
    return replays.estimate_samples(
        recording._replace(rows=rows),
        replays.settings(estimator, recording, fields),
        first,
        faults,
        seed,
    )


def trials(log, seeds, **given):
    """Scores of the trial over noise seeds: one row a seed, as a DataFrame."""
    return pd.DataFrame([dict(seed=seed) | score(trial(log, seed, **given)) for seed in seeds])


def fault_trials(log, cases, seeds, handling=(False, True), **given):
    """The trial with each fault of cases {name: rhec.Fault} on top, robust or not: one row a case,
    handling and noise seed, as a DataFrame.

    worst_position_m, worst_yaw_rad: from the beginning of the fault to the end of its segment;
    last_yaw_rad: error at the end of the segment; outside, not_ok: as `score`. Only for a log with
    the true pose.
    """
    rows = []
    for name, fault in cases.items():
        for robust in handling:
            for seed in seeds:
                samples = trial(log, seed, faults=(fault,), robust=robust, **given)
                segment = samples.loc[(samples["t_s"] - fault.start_s).abs().idxmin(), "segment"]
                after = samples[(samples["segment"] == segment) & (samples["t_s"] >= fault.start_s)]
                position, yaw = (
                    np.hypot(after["x_hat_m"] - after["x_m"], after["y_hat_m"] - after["y_m"]),
                    yaw_error(after).abs(),
                )
                whole = score(samples)
                rows.append(
                    dict(
                        fault=name,
                        robust=robust,
                        seed=seed,
                        worst_position_m=position.max(),
                        worst_yaw_rad=yaw.max(),
                        last_yaw_rad=yaw.iloc[-1],
                        outside=whole["outside"],
                        not_ok=whole["not_ok"],
                    )
                )
    return pd.DataFrame(rows)
