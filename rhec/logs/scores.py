"""Scores of a replay: against the truth where the log has it, else by its innovations; and harder
replays, with noise, a wrong first yaw and sensor faults on top of a log.
"""

import itertools

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs.log_checks import refuse_implausible
from rhec.logs.recording import prepare
from rhec.logs.replay import InitialGuess, estimate_samples, replay_scenario
from rhec.simulation.columns import MEASUREMENTS, TRUE_SPEEDS

__all__ = [
    "FROM_M",
    "REGRESSIONS",
    "WINDOW_S",
    "ahead_rms_m",
    "distance_driven",
    "fault_scores",
    "perturbed_replay",
    "perturbed_scores",
    "regression",
    "rms",
    "score",
    "sliding_regression",
    "while_moving",
    "yaw_error",
]

# Scores count from here on, driven in each segment: before, a wrong first yaw is still being found.
FROM_M = 8.0
_FAST_RADPS = 0.8  # yaw errors are also given without the spins that are faster
_AHEAD_S = 2.0  # how far a prediction by the encoders goes
WINDOW_S = 5.0  # of the sliding regressions,
_MOVES = 0.05  # [m/s, rad/s] by the encoders
_LEAST_RMS = 0.1  # which need measurements of this size in their window [m/s, rad/s]
REGRESSIONS = tuple(zip(MEASUREMENTS[2:], TRUE_SPEEDS))  # of μ, of κ


def regression(samples):
    """Apparent (μ, κ) of the whole log: true speed and yaw rate over ground on those measured by
    the encoders, least squares through the origin.
    """
    coefficients = []
    for measured, truth in REGRESSIONS:
        xy = samples[measured] * samples[truth]
        xx = samples[measured] ** 2
        total = xx[xy.notna()].sum()
        coefficients.append(xy.sum() / total if total > 0 else np.nan)  # a robot that never moves
    return tuple(coefficients)


def sliding_regression(samples):
    """Apparent (μ, κ) over the WINDOW_S around each sample, (n, 2); NaN where the measurements are
    too small to tell.
    """
    columns = []
    for measured, truth in REGRESSIONS:
        xy = samples[measured] * samples[truth]
        xx = samples[measured] ** 2
        windows = pd.DataFrame(dict(xy=xy, xx=xx)).groupby(samples["segment"])
        means = windows.rolling(round(WINDOW_S / paper.DT_S), center=True).mean()
        means = means.reset_index(drop=True)
        columns.append((means["xy"] / means["xx"]).where(means["xx"] >= _LEAST_RMS**2))
    return np.stack(columns, axis=1)


def yaw_error(samples):
    """Estimated less true yaw [rad], by the shorter way."""
    return (samples["theta_hat_rad"] - samples["theta_rad"] + np.pi) % (2 * np.pi) - np.pi


def _position_error(samples):
    """Estimated less true position [m], (x, y)."""
    return samples["x_hat_m"] - samples["x_m"], samples["y_hat_m"] - samples["y_m"]


def distance_driven(samples):
    """Distance driven in its segment at each sample [m], forwards or backwards, by the encoders."""
    steps = paper.DT_S * samples["nu_meas_mps"].abs().fillna(0)
    return steps.groupby(samples["segment"]).cumsum()


def while_moving(samples, from_s, duration_s):
    """When a robot begins to move for duration_s, from from_s on [s], or moves most of that time;
    from the log's beginning on if it ends before.
    """
    moves = (samples[MEASUREMENTS[2:]].abs() > _MOVES).any(axis=1)
    ahead = moves[::-1].groupby(samples["segment"]).rolling(round(duration_s / paper.DT_S) + 1)
    share = ahead.mean().droplevel(0).reindex(samples.index).fillna(0)
    later = share[samples["t_s"] >= from_s]
    return float(samples["t_s"][(later if later.any() else share).idxmax()])


def rms(*components):
    """Root mean square of a vector's length; a vector that lacks a component does not count."""
    if not len(components[0]):
        return np.nan
    return float(np.sqrt(np.nanmean(sum(np.square(component) for component in components))))


def score(samples):
    """Scores of a replay's samples, as a dict. All but `outside` and `not_ok` count from FROM_M
    driven in each segment.

    innovation_rms_m; outside: samples with an estimate of μ or κ that is not in [0, 1]; not_ok:
    samples whose step failed. With the truth in the log: yaw_rms_rad, yaw_rms_slow_rad (without
    fast spins), position_rms_m, medians of μ and κ beside their regressions, and how well the
    estimator knows its yaw error: nees_yaw, the mean of its square by its variance (1 if it knows),
    and inside_95, the share within 1.96 standard deviations.
    """
    counted = samples[distance_driven(samples) >= FROM_M]
    told = samples[samples["theta_hat_rad"].notna()]
    traction = told[["mu_hat", "kappa_hat"]]
    values = dict(
        samples=len(counted),
        innovation_rms_m=rms(counted["innovation_x_m"], counted["innovation_y_m"]),
        mu_median=counted["mu_hat"].median(),
        kappa_median=counted["kappa_hat"].median(),
        outside=int((~((traction >= 0) & (traction <= 1)).all(axis=1)).sum()),
        not_ok=int((~told["ok"]).sum()),
    )
    if "theta_rad" in samples:
        error = yaw_error(counted)
        sigma = counted["sigma_theta_rad"]
        slow = counted["omega_meas_radps"].abs() <= _FAST_RADPS
        values |= dict(
            yaw_rms_rad=rms(error),
            yaw_rms_slow_rad=rms(error[slow]),
            nees_yaw=(error**2 / sigma**2).mean(),
            inside_95=(error.abs() <= 1.96 * sigma)[error.notna()].mean(),
        )
    if {"x_m", "y_m"} <= set(samples):
        values["position_rms_m"] = rms(*_position_error(counted))
    if {truth for _, truth in REGRESSIONS} <= set(samples):
        mu, kappa = regression(samples)
        values |= dict(
            mu_regression=mu,
            kappa_regression=kappa,
            mu_difference=values["mu_median"] - mu,
            kappa_difference=values["kappa_median"] - kappa,
        )
    return values


def ahead_rms_m(samples, predict, hats, measured=MEASUREMENTS):
    """RMS error [m] of the position _AHEAD_S after each sample that counts, as its estimate and the
    encoders' later measurements predict it.

    predict: a `replay.predictor`; hats, measured: columns of what it takes.
    """
    n = round(_AHEAD_S / paper.DT_S)
    errors = []
    for _, part in samples.groupby("segment"):
        estimate = part[hats].to_numpy()[:-n]
        z = part[measured].to_numpy()
        for step in range(1, n + 1):
            then = z[step : step + len(estimate)]
            estimate, _ = predict(estimate, then, np.full(len(estimate), paper.DT_S))
        error = estimate[:, :2] - part[["x_m", "y_m"]].to_numpy()[n:]
        errors.append(error[distance_driven(part)[:-n] >= FROM_M])
    return rms(*np.concatenate(errors).T)


def perturbed_replay(log, seed, **arguments):
    """Samples of a replay with white noise of noise_m [m], 0.02 if not told, on the position and a
    first yaw that is wrong by yaw_error_rad [rad], 0.3, in each segment.

    The noise joins a sigma_v that is given, which is of the log.
    seed: of the noise; faults: (rhec.Fault, …) on top; other arguments: as in `rhec.replay`. Where
    the log has no true yaw the first one is found as `rhec.replay` does.
    """
    recording, others = _prepared(log, **arguments)
    return _perturbed(recording, seed, **others)


def _prepared(log, track_width_m=None, position_delay_s=0.0, trust_log=False, **others):
    """The Recording of a log, refused if it is implausible, and the other arguments."""
    recording = prepare(log, track_width_m, position_delay_s)
    if not trust_log:
        refuse_implausible(recording)
    return recording, others


def _perturbed(
    recording,
    seed,
    noise_m=0.02,
    yaw_error_rad=0.3,
    estimator="rhe",
    *,
    lever_arm_m=None,
    faults=(),
    **fields,
):
    """`perturbed_replay` of a Recording."""
    rows = recording.rows.copy()
    noise = np.random.default_rng(seed).standard_normal((len(rows), 2))
    if fields.get("sigma_v"):
        own_x, own_y, *encoders = fields["sigma_v"]
        fields["sigma_v"] = (np.hypot(own_x, noise_m), np.hypot(own_y, noise_m), *encoders)
    rows[MEASUREMENTS[:2]] += noise_m * noise
    yaws = None
    if "theta_rad" in rows:
        first = rows.groupby("segment")["theta_rad"].first()
        yaws = tuple(first + yaw_error_rad) if first.notna().all() else None
    return estimate_samples(
        recording._replace(rows=rows),
        replay_scenario(estimator, recording, fields),
        InitialGuess(yaws, lever_arm_m=lever_arm_m),
        faults,
        seed,
    )


def perturbed_scores(log, seeds, **arguments):
    """Scores of perturbed replays: one row for each noise seed, as a DataFrame."""
    recording, others = _prepared(log, **arguments)
    replays = (_perturbed(recording, seed, **others) for seed in seeds)
    return pd.DataFrame([dict(seed=seed) | score(each) for seed, each in zip(seeds, replays)])


def fault_scores(log, cases, seeds, handling=(False, True), **arguments):
    """Perturbed replays with each fault of cases {name: rhec.Fault} on top, robust or not: one row
    for each case, handling and noise seed, as a DataFrame.

    worst_position_m, worst_yaw_rad: from the beginning of the fault to the end of its segment;
    last_yaw_rad: error at the end of the segment; outside, not_ok: as `score`. Only for a log with
    the true pose.
    """
    (recording, others) = _prepared(log, **arguments)
    rows = []
    for name, robust, seed in itertools.product(cases, handling, seeds):
        start_s = cases[name].start_s
        samples = _perturbed(recording, seed, faults=(cases[name],), robust=robust, **others)
        segment = samples.loc[(samples["t_s"] - start_s).abs().idxmin(), "segment"]
        after = samples[(samples["segment"] == segment) & (samples["t_s"] >= start_s)]
        yaw = yaw_error(after).abs()
        whole = score(samples)
        rows.append(
            dict(
                fault=name,
                robust=robust,
                seed=seed,
                worst_position_m=np.hypot(*_position_error(after)).max(),
                worst_yaw_rad=yaw.max(),
                last_yaw_rad=yaw.iloc[-1],
                outside=whole["outside"],
                not_ok=whole["not_ok"],
            )
        )
    return pd.DataFrame(rows)
