"""Beyond the paper: estimators and controllers compared in the closed loop, each at its own best.

R = 10, the paper's, leaves so slow a controller that the estimate must lead it. So controller and
estimator of each contestant are tuned together (`rhec.workbench.studies.fair_tuning`: one search,
one budget and the same training seeds for all), once for each world. The paper's own stand beside
them as they are printed.
"""

import itertools
import time
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.core._casadi import scan
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.simulation.worlds import WORLDS
from rhec.tracked_robot import tuning
from rhec.tracked_robot.tuned_loops import TUNED
from rhec.workbench.studies import calibration, fair_tuning
from rhec.workbench.studies.statistics import (
    interval_text,
    over_seeds,
    ratio_of_means,
    readable,
    verdict,
)

__all__ = [
    "GAINS",
    "LABELS",
    "LEAST_GAIN",
    "LIMIT",
    "MOST_ABOVE",
    "PAPERS",
    "PROPOSAL",
    "QUANTITIES",
    "WORTH",
    "by_gain",
    "contestants",
    "drive",
    "overview",
    "ranking_table",
    "readable_worth",
    "scenarios",
    "step_times",
    "targets",
    "time_table",
    "worth_table",
]

# Aims of the proposal: so much less true error than the paper's RHE, and at most so much more than
# an oracle's.
LEAST_GAIN = 0.30
MOST_ABOVE = 0.10
_MEANS = ["world", "contestant", "quantity", "mean", "low", "high"]
QUANTITIES = {
    "mean_error_true_m": "mean true error [m]",
    "mean_error_m": "mean error, raw GNSS [m]",
    "violations_true": "violations on straights, true",
    "violations": "violations on straights, raw GNSS",
}


class _Contestant(NamedTuple):
    """A loop: its label in tables and figures, and its fields of Scenario."""

    label: str
    fields: dict


_AS_PRINTED = {
    "ekf_printed": _Contestant("EKF, as printed", dict(estimator="ekf")),
    "rhe_printed": _Contestant("RHE, as printed", dict(estimator="rhe")),
    "rhe_consistent": _Contestant(
        "RHE, consistent, R as printed", dict(process_noise="consistent")
    ),
}
LABELS = {id_: one.label for id_, one in (_AS_PRINTED | fair_tuning.CONTESTANTS).items()}
PAPERS = LABELS["rhe_printed"]
PROPOSAL = LABELS["yaw_drift_ekf"]
LIMIT = LABELS["drift_oracle"]
_ORACLES = [LABELS[id_] for id_ in ("traction_oracle", "drift_oracle")]
# What a part of a loop is worth: (what, the loop with it, the loop without it).
WORTH = [
    ("the weights R and q_θ, and W: RHE", "rhe", "rhe_printed"),
    ("estimating the traction: EKF", "bounded_ekf", "fixed_traction"),
    ("estimating the traction: RHE", "rhe", "rhe_fixed"),
    ("a window", "rhe", "bounded_ekf"),
    ("the filter's arrival mean", "rhe", "rhe_smoothed"),
    ("yaw drift as a state: EKF", "yaw_drift_ekf", "bounded_ekf"),
    ("yaw drift as a state: RHE", "yaw_drift_rhe", "rhe"),
    ("a disturbance observer", "observer", "bounded_ekf"),
    ("linear time-varying MPC in place of the RHC", "ltv_mpc", "bounded_ekf"),
    ("pure pursuit in place of the RHC", "pure_pursuit", "bounded_ekf"),
    ("the same, with yaw drift", "pure_pursuit_drift", "yaw_drift_ekf"),
    ("knowing the traction", "traction_oracle", "bounded_ekf"),
    ("knowing traction and yaw drift", "drift_oracle", "yaw_drift_ekf"),
]
# Loops whose error is shown over the controller's weight R, all else fixed.
GAINS = {
    "RHE, W printed": dict(),
    "RHE, consistent": dict(process_noise="consistent"),
    "bounded EKF, W by likelihood": dict(estimator="bounded_ekf", process_noise="calibrated"),
    "bounded EKF, W by tracking at R = 10": dict(
        estimator="bounded_ekf", sigma_w=tuning.SIGMA_W_TRACKING["bounded_ekf"]
    ),
    "yaw-drift EKF, W by likelihood": dict(estimator="yaw_drift_ekf"),
    "traction oracle, W by likelihood": dict(estimator="traction_oracle"),
}
_R = 10.0 ** np.arange(-3, 1.5, 0.5)


def contestants(world):
    """{id: _Contestant} of a world of WORLDS: the paper's as printed, and all that are tuned."""
    tuned = TUNED[world]
    labels = {id_: one.label for id_, one in fair_tuning.CONTESTANTS.items() if id_ in tuned}
    return _AS_PRINTED | {id_: _Contestant(labels[id_], tuned[id_]) for id_ in labels}


def scenarios(seeds, worlds=tuple(TUNED)):
    """(world, label, Scenario) of every contestant of every world on every seed."""
    rows = []
    for world in worlds:
        for (label, fields), seed in itertools.product(contestants(world).values(), seeds):
            rows.append((world, label, Scenario(**WORLDS[world] | fields, seed=seed)))
    return rows


def drive(seeds, folder=None, worlds=tuple(TUNED)):
    """Drive every contestant on every seed.

    Args:
        seeds: Of the fields.
        folder: Of the campaign's rows, as in `rhec.campaign`.
        worlds: Of WORLDS.

    Returns:
        The campaign's DataFrame with the columns world and contestant.
    """
    of_worlds, labels, drives = zip(*scenarios(seeds, worlds))
    return campaign(drives, folder).assign(world=of_worlds, contestant=labels)


def by_gain(seeds, world="default", folder=None, weights=_R):
    """Mean true errors of GAINS over the weight R of the yaw rate.

    Args:
        seeds: Of the fields.
        world: Of WORLDS.
        folder: Of the campaign's rows.
        weights: R.

    Returns:
        DataFrame with columns contestant, r, seed, mean_error_true_m, one row a drive.
    """
    every = [*itertools.product(GAINS.items(), weights, seeds)]
    drives = [
        Scenario(**WORLDS[world] | fields, r=float(r), seed=seed) for (_, fields), r, seed in every
    ]
    labels = [label for (label, _), _, _ in every]
    columns = ["contestant", "r", "seed", "mean_error_true_m"]
    return campaign(drives, folder).assign(contestant=labels)[columns]


def step_times(ids, rounds=40, world="default"):
    """Time of one estimator step of these contestants on the same measurements.

    Contestants take turns in each round, so that a change of the machine's speed hits all alike.
    Compiled code alone is timed.

    Args:
        ids: Of `contestants`.
        rounds: How many.
        world: Of WORLDS.

    Returns:
        DataFrame of times per step [µs], one row a round, one column a contestant.
    """
    run = simulate(Scenario(**WORLDS[world], estimator="oracle"))
    calls = {}
    taken = []
    for label, fields in (contestants(world)[id_] for id_ in ids):
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
    shown = rows.assign(ratio=values).set_index(["world", "quantity"])
    return shown[["ratio", "n", "claim", "verdict"]]


def overview(table, quantity=QUANTITIES["mean_error_true_m"]):
    """One quantity of `ranking_table` for readers: a row a contestant, a column a world."""
    rows = table[table["quantity"] == quantity][_MEANS]
    values = [interval_text(*interval) for interval in zip(rows["mean"], rows["low"], rows["high"])]
    order = rows["contestant"].unique()
    wide = rows.assign(value=values).pivot(index="contestant", columns="world", values="value")
    return wide.reindex(order)[rows["world"].unique()].rename_axis(None, axis=1)


def ranking_table(sweep):
    """Means over seeds of every contestant, and ratios of mean true errors at equal seeds.

    The ratios are to the paper's RHE and to both oracles that estimate their pose. The claims are
    the aims of the proposal.

    Args:
        sweep: Rows of `drive`, the same seeds in the same order for each contestant.

    Returns:
        DataFrame with columns world, contestant, quantity, mean, low, high, n, claim, verdict; the
        worlds in their order, the best first.
    """
    rows = []
    for world, of_world in sweep.groupby("world", sort=False):
        runs = dict(list(of_world.groupby("contestant", sort=False)))
        errors = {name: table["mean_error_true_m"] for name, table in runs.items()}
        for name in sorted(runs, key=lambda name: errors[name].mean()):
            about = dict(world=world, contestant=name)
            rows += [about | row for row in _means_of(runs[name])]
            rows += [about | row for row in _ratios_of(name, errors)]
    columns = "world contestant quantity mean low high n claim verdict".split()
    return pd.DataFrame(rows, columns=columns).fillna({"claim": "", "verdict": ""})


def _means_of(runs):
    """Rows of `ranking_table`: the means of a contestant's runs."""
    return [
        dict(quantity=quantity) | over_seeds(np.mean, runs[column])._asdict()
        for column, quantity in QUANTITIES.items()
    ]


def _ratios_of(name, errors):
    """Rows of `ranking_table`: ratios of a contestant's errors, with the aims of the proposal."""
    targets = {PAPERS: 1 - LEAST_GAIN} | {oracle: 1 + MOST_ABOVE for oracle in _ORACLES}
    rows = []
    for other, most in targets.items():
        if other not in errors or name == other:
            continue
        ratio = over_seeds(ratio_of_means, errors[name], errors[other])
        row = dict(quantity=f"true error, ratio to {other}") | ratio._asdict()
        if name == PROPOSAL:
            judged = verdict(ratio.low, ratio.high, below=most)
            row |= dict(claim=f"at most {most:.2f}", verdict=judged)
        rows.append(row)
    return rows


def worth_table(sweep):
    """What each part of WORTH is worth: the error with it over the error without it.

    Args:
        sweep: Rows of `drive`.

    Returns:
        DataFrame with columns world, quantity, mean, low, high (95 %, at equal seeds), n.
    """
    rows = []
    for world, of_world in sweep.groupby("world", sort=False):
        errors = dict(list(of_world.groupby("contestant")["mean_error_true_m"]))
        for what, one, other in WORTH:
            pair = [errors.get(LABELS[id_]) for id_ in (one, other)]
            if any(part is None for part in pair):
                continue
            ratio = over_seeds(ratio_of_means, *pair)
            rows.append(dict(world=world, quantity=what) | ratio._asdict())
    return pd.DataFrame(rows, columns=["world", "quantity", "mean", "low", "high", "n"])


def readable_worth(table):
    """The table of `worth_table` for readers: one row a part, one column a world."""
    return readable(table)
