"""Transfer: an estimator tuned on some recorded robots, tried on one that it has not seen.

Each log is taken at 5 Hz, with white noise on its positions and a wrong first yaw, once for every
noise seed; the first metres do not count (`notebooks.further.recorded.scores`). All estimators are
tuned without truth, with a noise seed that no trial has: on the same log, or on the others, in the
geometric mean of their results. The RHE's numbers are those of `rhec.calibrate` or those shipped
(`tuning.SLIP`). Its rivals are the EKFs of `notebooks.further.recorded.rivals`, with (μ, κ) and
with five parameters of centres of rotation, whose noise has the form of the RHE's. They are tuned
by the likelihood of their innovations, with the same number of evaluations for each unknown.

    python -m notebooks.further.transfer [SEEDS]

makes the table of docs/recorded_robots.md on all cores, from the logs in data/recordings, which
`python data/fetch_recordings.py` fetches.
"""

import contextlib
import itertools
import operator
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import minimize

from notebooks.further.recorded import page, rivals, scores
from notebooks.studies.calibration import LEAST, sigma_of
from notebooks.studies.parallel import parallel_map
from notebooks.studies.statistics import over_seeds
from rhec import paper
from rhec.logs.calibration import calibrate
from rhec.logs.recording import prepare
from rhec.simulation.columns import RECORDED_SENSORS

NOISE_M = 0.02  # on recorded positions
YAW_ERROR_RAD = 0.3  # of the first yaw
_TUNING_SEED = 1000  # no trial has it
_SENSORS = [*RECORDED_SENSORS.values()]  # no rival uses a gyro or a heading
# The search of a rival's standard deviations: between these, from here, for each unknown.
_MOST = 10.0
_FIRST = 0.01
_EVALUATIONS = 40
_UNUSABLE = 1e12  # the objective where a filter diverges
_SHARES = ("inside_95", "bad_unsure", "good_unsure")
_SCORES = ("yaw_rms_rad", *_SHARES)  # of `scores.score`


def _noisy(log, seed):
    """A log at the estimators' rate, with noise on its positions."""
    # Recordings are faster than 5 Hz; every n-th sample is taken, as a 5 Hz receiver gives it.
    every = max(round(paper.DT_S / log["t_s"].diff().median()), 1)
    log = log.iloc[::every].reset_index(drop=True)
    x, y = NOISE_M * np.random.default_rng(seed).standard_normal((2, len(log)))
    return log.assign(x_m=log["x_m"] + x, y_m=log["y_m"] + y)


def _rhe(log, fields, smooth):
    """Samples of a noisy log's replay."""
    options = dict(noise_m=0.0, yaw_error_rad=YAW_ERROR_RAD, trust_log=True, smooth=smooth)
    return scores.perturbed_replay(log, 0, **options, **fields)


# What is searched of each rival: its sigma_v, the walks of its parameters and its slip, without the
# side slip; for each unknown the places that it sets.
_SEARCHED = {
    "EKF of (μ, κ)": [(0, 1), (2,), (3,), (6,), (7,), (8,), (9,), (10,), (11,)],
    "EKF of ICR": [(0, 1), (2,), (3,), (4, 5), (6,), (7, 8), (10,), (11,), (12,), (13,)],
}
_NOT_SEARCHED = {"EKF of (μ, κ)": [4, 5], "EKF of ICR": [9]}


def _settings(title, half_m, sigma):
    """Noises V, W and c of a rival. What it knows does not walk."""
    sigma = np.array(sigma)
    sigma[_NOT_SEARCHED[title]] = 0.0
    W = np.square([0.0, 0.0, 0.0, *sigma[4:-4]])
    return dict(V=np.square(sigma[:4]), W=W, c=[*sigma[-4:], 0.0, 2 * half_m, paper.DT_S])


def _filtered(run, title, half_m, part, sigma):
    """What a function of `rivals` gives of a rival on one segment."""
    yaw_rad = part["theta_rad"].iloc[0] + YAW_ERROR_RAD
    settings = _settings(title, half_m, sigma)
    return run(rivals.RIVALS[title], settings, part, half_m, yaw_rad)


def _rival(title, half_m, parts, sigma):
    """Samples of a rival."""
    samples = [_filtered(rivals.run, title, half_m, part, sigma) for part in parts]
    return pd.concat(samples, ignore_index=True).assign(ok=True)


def _tuned(title, log):
    """The rival's sigma that makes a log's measurements likeliest, from where scores count."""
    recording = prepare(log)
    half_m = recording.track_width_m / 2
    parts = recording.samples()
    counted = [scores.distance_driven(part) >= scores.FROM_M for part in parts]

    def objective(sigma):
        deviances = (_filtered(rivals.deviances, title, half_m, part, sigma) for part in parts)
        value = sum(deviance[rows].sum() for deviance, rows in zip(deviances, counted))
        return value if np.isfinite(value) else _UNUSABLE

    return _search(objective, _SEARCHED[title])


def _search(objective, unknowns):
    """The standard deviations (σ …), to two digits, that minimise an objective.

    Args:
        objective: Function of them.
        unknowns: For each unknown the places in them that it sets.
    """
    tried = {}

    def evaluate(logarithms):
        if len(tried) == _EVALUATIONS * len(unknowns):
            raise _Exhausted
        sigma = sigma_of(logarithms, unknowns)
        tried[sigma] = objective(sigma)
        return tried[sigma]

    # Powell's own limit counts whole lines only; the exception stops at the exact number.
    with contextlib.suppress(_Exhausted):
        minimize(
            evaluate,
            np.full(len(unknowns), np.log(_FIRST)),
            method="Powell",
            bounds=[np.log((LEAST, _MOST))] * len(unknowns),
            options=dict(xtol=0.01, ftol=1e-6),
        )
    return tuple(float(f"{value:.2g}") for value in min(tried, key=tried.get))


class _Exhausted(Exception):
    """All evaluations are used up."""


def _middle(calibrations):
    """Geometric mean of several calibrations, without the lever arm, which belongs to one robot.

    Those that kept the defaults have no values. The side slip may be 0, so its mean is the
    arithmetic one.
    """
    calibrations = [each for each in calibrations if "sigma_v" in each]
    fields = {
        name: _geometric_mean([calibration[name] for calibration in calibrations])
        for name in ("sigma_v", "sigma_w")
    }
    *others, side = zip(*(calibration["slip"] for calibration in calibrations))
    return fields | dict(slip=(*_geometric_mean(np.transpose(others)), np.mean(side).item()))


def _geometric_mean(rows):
    """The geometric mean of each column, a tuple."""
    return tuple(np.exp(np.log(rows).mean(axis=0)).tolist())


def _row(log, estimator, tuned, seed, samples):
    """A row of `trials`: who was tried on what, and its scores."""
    values = scores.score(samples)
    about = dict(log=log, estimator=estimator, tuned=tuned, seed=seed)
    return about | {name: values.get(name, np.nan) for name in _SCORES}


def _calibrated(log):
    return dict(calibrate(_noisy(log, _TUNING_SEED)))


def _tried(log, noise_free, title, fields, sigmas, seed):
    """Rows of `trials` of a log with the noise of a seed.

    Args:
        log: Name of the log.
        noise_free: The log.
        title: Of the RHE.
        fields: {way of tuning: numbers of the RHE}.
        sigmas: {rival: {way of tuning: its sigma}}.
        seed: Of the noise.
    """
    noisy = _noisy(noise_free, seed)
    rows = [
        _row(log, f"{title}{words}", tuned, seed, _rhe(noisy, numbers, smooth))
        for words, smooth in (("", False), (", smoothed", True))
        for tuned, numbers in fields.items()
    ]
    recording = prepare(noisy)
    half_m = recording.track_width_m / 2
    parts = recording.samples()
    for rival, of_rival in sigmas.items():
        for tuned, sigma in of_rival.items():
            rows.append(_row(log, rival, tuned, seed, _rival(rival, half_m, parts, sigma)))
    return rows


def trials(logs, seeds):
    """Scores of every estimator on two or more recordings with their truth, {name: DataFrame}.

    The table has one row for each log, estimator, way of tuning and noise seed. Where a log has a
    gyro, the RHE comes a second time, with it.
    """
    logs = {name: page.aligned(log) for name, log in logs.items()}
    plain = {name: log.drop(columns=_SENSORS, errors="ignore") for name, log in logs.items()}
    with_gyro = {name: log for name, log in logs.items() if {*_SENSORS} & {*log}}
    tunings = [partial(_calibrated, log) for log in (*plain.values(), *with_gyro.values())]
    tunings += [
        partial(_tuned, title, _noisy(log, _TUNING_SEED))
        for title in _SEARCHED
        for log in plain.values()
    ]
    found = iter(parallel_map(operator.call, tunings))
    numbers = dict(zip(plain, found))
    numbers_with_gyro = dict(zip(with_gyro, found))
    sigmas = {title: dict(zip(plain, found)) for title in _SEARCHED}
    tasks = []
    for name, log in plain.items():
        rest = [other for other in plain if other != name]
        of_others = _middle([numbers[other] for other in rest])
        fields = dict(itself=numbers[name], others=of_others, shipped={})
        of_rivals = {
            title: dict(itself=of[name], others=_geometric_mean([of[other] for other in rest]))
            for title, of in sigmas.items()
        }
        tasks += [partial(_tried, name, log, "RHE", fields, of_rivals, seed) for seed in seeds]
    for name, log in with_gyro.items():
        fields = dict(itself=numbers_with_gyro[name], shipped={})
        tasks += [partial(_tried, name, log, "RHE, gyro", fields, {}, seed) for seed in seeds]
    return pd.DataFrame(itertools.chain.from_iterable(parallel_map(operator.call, tasks)))


def of_the_page(rows):
    """Means of `trials` over noise seeds that docs/recorded_robots.md shows.

    Where a calibration kept the defaults, its row says nothing and is left out.
    """
    groups = rows.groupby(["log", "estimator", "tuned"], sort=False)
    mean = partial(over_seeds, np.mean, least=0.0)
    means = groups.agg(dict.fromkeys(_SCORES, mean))
    lines = []
    for (log, estimator, tuned), cells in means.iterrows():
        error = cells["yaw_rms_rad"]
        shipped = (log, estimator, "shipped")
        is_compared = tuned == "itself" and shipped in means.index
        if is_compared and means.loc[shipped, "yaw_rms_rad"] == error:
            continue
        about = dict(log=log, estimator=estimator, tuned=tuned)
        about |= dict(yaw_rms_rad=error.mean, low=error.low, high=error.high)
        lines.append(about | {name: cells[name].mean for name in _SHARES})
    return pd.DataFrame(lines)


if __name__ == "__main__":
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    logs = page.read_logs()
    if len(logs) < len(page.LOGS):
        sys.exit(
            f"{len(logs)} of {len(page.LOGS)} logs: python data/fetch_recordings.py fetches them"
        )
    result = trials(logs, range(n))
    out = Path("build/replay")
    out.mkdir(parents=True, exist_ok=True)
    result.to_csv(out / "transfer.csv", index=False)
    scores.save("yaw", of_the_page(result), "Errors of the yaw on recorded robots")
    print(f"n = {n} noise seeds; all trials: {out / 'transfer.csv'}\n")
    print(of_the_page(result).to_string())
