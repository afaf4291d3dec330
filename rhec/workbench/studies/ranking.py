"""Beyond the paper: estimators compared in the closed loop, from the paper's to one that knows the
truth, and how the pose filter's noise matters.

Each estimator appears with the process noise W as printed, by likelihood, and by tracking
(`rhec.workbench.studies.calibration`: one procedure and one budget for all), where there is one.
The RHE also appears with a consistent W, whose NEES is close to 1
(`rhec.workbench.studies.consistency`).
"""

import itertools
import time
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.core._casadi import scan
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.metrics import SETTLING_SAMPLES, settled_samples
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import tuning
from rhec.workbench.studies import calibration
from rhec.workbench.studies.statistics import (
    interval_text,
    over_seeds,
    ratio_of_means,
    readable,
    verdict,
)

__all__ = [
    "CONTESTANTS",
    "LEAST_GAIN",
    "MOST_ABOVE",
    "PAPERS",
    "PROPOSAL",
    "QUANTITIES",
    "SIGMA_THETA",
    "by_pose_noise",
    "drive",
    "overview",
    "ranking_table",
    "scenarios",
    "step_times",
    "targets",
    "time_table",
]

# Aims of the proposal: so much less true error than the paper's RHE, and at most so much more than
# an oracle's.
LEAST_GAIN = 0.30
MOST_ABOVE = 0.10
_MEANS = ["contestant", "quantity", "mean", "low", "high"]
SIGMA_THETA = tuning.SIGMA_W_TRACKING["dual"][8]
_SIGMAS_RAD = SIGMA_THETA * 2.0 ** np.arange(-4, 3)
QUANTITIES = {
    "mean_error_true_m": "mean true error [m]",
    "mean_error_m": "mean error, raw GNSS [m]",
    "violations_true": "violations on straights, true",
    "violations": "violations on straights, raw GNSS",
}


class _Contestant(NamedTuple):
    """An estimator with its process noise: its label in tables and figures, fields of Scenario."""

    label: str
    fields: dict


def _with(label, estimator, **fields):
    """A contestant by the name of its estimator."""
    return _Contestant(label, dict(estimator=estimator, **fields))


def _tracking(label, estimator, **fields):
    """A contestant with the W that tracks best."""
    sigma_w = tuning.SIGMA_W_TRACKING[estimator]
    return _with(f"{label}, W by tracking", estimator, sigma_w=sigma_w, **fields)


_PRINTED = dict(process_noise="printed")
_LIKELIHOOD = dict(process_noise="calibrated")
CONTESTANTS = {  # from the paper's own to the truth
    "ekf_printed": _with("EKF, W printed", "ekf", **_PRINTED),
    "ekf_likelihood": _with("EKF, W by likelihood", "ekf", **_LIKELIHOOD),
    "ekf_tracking": _tracking("EKF", "ekf"),
    "augmented_printed": _with("augmented EKF, W printed", "augmented_ekf", **_PRINTED),
    "augmented_likelihood": _with("augmented EKF, W by likelihood", "augmented_ekf", **_LIKELIHOOD),
    "augmented_tracking": _tracking("augmented EKF", "augmented_ekf"),
    "bounded_likelihood": _with("bounded EKF, W by likelihood", "bounded_ekf", **_LIKELIHOOD),
    "bounded_tracking": _tracking("bounded EKF", "bounded_ekf"),
    "rhe_printed": _with("RHE, W printed", "rhe", **_PRINTED),
    "rhe_likelihood": _with("RHE, W by likelihood", "rhe", **_LIKELIHOOD),
    "rhe_consistent": _with("RHE, consistent", "rhe", process_noise="consistent"),
    "rhe_tracking": _tracking("RHE", "rhe"),
    "rhe_no_slip": _tracking("RHE without slip", "rhe_no_slip"),
    "rhe_fixed_printed": _with("RHE, fixed traction, W printed", "rhe_fixed_traction", **_PRINTED),
    "rhe_fixed_likelihood": _with(
        "RHE, fixed traction, W by likelihood", "rhe_fixed_traction", **_LIKELIHOOD
    ),
    "rhe_fixed_tracking": _tracking("RHE, fixed traction", "rhe_fixed_traction"),
    "fixed_likelihood": _with("fixed traction, W by likelihood", "fixed_traction"),
    "fixed_tracking": _tracking("fixed traction", "fixed_traction"),
    "dual": _tracking("dual", "dual", **calibration.DUAL),
    "traction_likelihood": _with("traction oracle, W by likelihood", "traction_oracle"),
    "traction_tracking": _tracking("traction oracle", "traction_oracle"),
    "oracle": _with("full oracle", "oracle"),
}
PROPOSAL = CONTESTANTS["dual"].label
PAPERS = CONTESTANTS["rhe_printed"].label
_ORACLES = [CONTESTANTS[id_].label for id_ in ("traction_likelihood", "traction_tracking")]
# The value of estimating the traction, and of a window: ratios to these two are shown as well.
_RIVALS = [CONTESTANTS[id_].label for id_ in ("rhe_fixed_tracking", "bounded_tracking")]


def drive(seeds, folder=None):
    """Drive every contestant on every seed.

    Args:
        seeds: Of the fields.
        folder: Of the campaign's rows, as in `rhec.campaign`.

    Returns:
        The campaign's DataFrame with the column contestant.
    """
    labels, of_labels = zip(*scenarios(seeds))
    return campaign(of_labels, folder).assign(contestant=labels)


def scenarios(seeds):
    """(label, Scenario) of every contestant on every seed."""
    every = itertools.product(CONTESTANTS.values(), seeds)
    return [(label, Scenario(seed=seed, **fields)) for (label, fields), seed in every]


def by_pose_noise(seeds, sigmas_rad=_SIGMAS_RAD):
    """The proposal with other process noises of the yaw in its pose filter.

    Args:
        seeds: Of the fields.
        sigmas_rad: Standard deviations of the yaw in W.

    Returns:
        DataFrame, one row a seed and sigma_theta_rad: mean true errors [m] on straights, in curves
        and overall, counted from the arrival, and the RMS error of the estimated yaw [rad].
    """
    tuned = tuning.SIGMA_W_TRACKING["dual"]
    rows = []
    for sigma in sigmas_rad:
        sigma_w = (*tuned[:8], float(sigma), tuned[9])
        for seed in seeds:
            fields = CONTESTANTS["dual"].fields | dict(seed=seed, sigma_w=sigma_w)
            run = simulate(Scenario(**fields))
            # A robot that never settles is counted from its start.
            stays = settled_samples(run.columns["error_true_m"])
            log = run.log[stays[0] + SETTLING_SAMPLES :] if len(stays) else run.log
            errors = log.groupby("on_straight")["error_true_m"].mean()
            straights_m = errors.get(True, np.nan)
            curves_m = errors.get(False, np.nan)
            row = dict(sigma_theta_rad=sigma, seed=seed, straights_m=straights_m, curves_m=curves_m)
            row |= dict(all_m=run.metrics["mean_error_true_m"])
            rows.append(row | dict(rms_yaw_rad=run.metrics["rms_yaw_rad"]))
    return pd.DataFrame(rows)


def step_times(ids, rounds=40):
    """Time of one estimator step of these contestants on the same measurements.

    Contestants take turns in each round, so that a change of the machine's speed hits all alike.
    Compiled code alone is timed.

    Args:
        ids: Of CONTESTANTS.
        rounds: How many.

    Returns:
        DataFrame (rounds, ids) of times [µs], mean over a run of 1200 samples, with their labels.
    """
    run = simulate(Scenario(estimator="oracle"))
    calls = {}
    taken = []
    for label, fields in (CONTESTANTS[id_] for id_ in ids):
        calls[label] = calibration.scan_arguments(Scenario(**fields), run, "estimate")
    for _ in range(rounds + 1):
        row = {}
        for name, call in calls.items():
            begin = time.perf_counter_ns()
            scan.scan(*call)
            row[name] = (time.perf_counter_ns() - begin) / 1e3 / len(run.log)
        taken.append(row)
    return pd.DataFrame(taken[1:])  # the first round warms up


def time_table(times):
    """Median and quartiles of the times of `step_times` [µs], and of their ratio round by round."""
    one, other = times.columns
    ratios = times[other] / times[one]
    rows = times.assign(**{f"ratio, {other} / {one}": ratios}).quantile([0.5, 0.25, 0.75]).T
    return rows.set_axis(["median", "lower quartile", "upper quartile"], axis=1).round(2)


def targets(table):
    """The targets in `ranking_table` for readers: value, claim and verdict of each."""
    rows = table[table["claim"] != ""]
    values = [interval_text(*interval) for interval in zip(rows["mean"], rows["low"], rows["high"])]
    return rows.assign(ratio=values).set_index("quantity")[["ratio", "n", "claim", "verdict"]]


def overview(table):
    """The means of `ranking_table` for readers, one row a contestant, the best first."""
    return readable(table[table["quantity"].isin(QUANTITIES.values())][_MEANS], transposed=True)


def ranking_table(sweep):
    """Means over seeds of every contestant, and ratios of mean true errors at equal seeds.

    The ratios are to the paper's RHE, both traction oracles, the RHE that estimates no traction and
    the bounded EKF. The claims are the aims of the proposal.

    Args:
        sweep: Rows of `rhec.campaign` with the column `contestant`, labels as in CONTESTANTS, the
            same seeds in the same order for each.

    Returns:
        DataFrame with columns contestant, quantity, mean, low, high, n, claim, verdict; best first.
    """
    runs = dict(list(sweep.groupby("contestant", sort=False)))
    targets = {PAPERS: 1 - LEAST_GAIN} | {oracle: 1 + MOST_ABOVE for oracle in _ORACLES}
    targets |= dict.fromkeys(_RIVALS)
    errors = {name: table["mean_error_true_m"] for name, table in runs.items()}
    rows = []
    for name in sorted(runs, key=lambda name: errors[name].mean()):
        for column, quantity in QUANTITIES.items():
            interval = over_seeds(np.mean, runs[name][column])._asdict()
            rows.append(dict(contestant=name, quantity=quantity) | interval)
        for other, most in targets.items():
            if other in errors and name != other:
                ratio = over_seeds(ratio_of_means, errors[name], errors[other])
                row = dict(contestant=name, quantity=f"true error, ratio to {other}")
                rows.append(row | ratio._asdict())
                if name == PROPOSAL and most:
                    judged = verdict(ratio.low, ratio.high, below=most)
                    rows[-1] |= dict(claim=f"at most {most:.2f}", verdict=judged)
    columns = "contestant quantity mean low high n claim verdict".split()
    return pd.DataFrame(rows, columns=columns).fillna({"claim": "", "verdict": ""})
