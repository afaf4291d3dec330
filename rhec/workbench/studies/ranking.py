"""Beyond the paper: estimators and controllers compared in the closed loop, each at its own best.

R = 10, the paper's, leaves so slow a controller that the estimate must lead it. So controller and
estimator of each contestant are tuned together (`rhec.workbench.studies.fair_tuning`: one search,
one budget and the same training seeds for all), once for each world. The paper's own stand beside
them as they are printed.

Two looks, as in the claims ledger (`rhec.workbench.studies.claims.evidence`). All contestants drive
a first look of few fields. The second look has all fields, and only

- the loops that a page or a target names (REFERENCES),
- those that may still be the best: successive elimination (Even-Dar, Mannor and Mansour, Journal of
  Machine Learning Research 7, 2006). A loop is excluded once the interval of its error minus that
  of the leader, at equal seeds, is above zero: at 99.9 % in the first look. In the second, with k
  rivals, it is one of 1 - 5 %/k. The best loop is excluded only if the interval of one of its k
  differences is wrong to that side, with a probability of at most k 0.05 % + 2.5 %,
- both loops of each part of WORTH of which the first look cannot say, at 99.9 %, whether it pays.
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
    CONFIDENCE,
    FIRST_CONFIDENCE,
    UNDECIDED,
    difference_of_means,
    interval_text,
    over_seeds,
    ratio_of_means,
    readable,
    verdict,
)

__all__ = [
    "BEST",
    "COSTS",
    "EXCLUDED",
    "GAINS",
    "LABELS",
    "LEAST_GAIN",
    "LIMIT",
    "MOST_ABOVE",
    "MAY_BE_BEST",
    "PAPERS",
    "PAYS",
    "PROPOSAL",
    "QUANTITIES",
    "REFERENCES",
    "WORTH",
    "by_gain",
    "contestants",
    "drive",
    "error_rate",
    "goes_on",
    "in_two_looks",
    "overview",
    "ranking_table",
    "readable_worth",
    "scenarios",
    "standings",
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
_NO_RIVALS = (*_ORACLES, LABELS["oracle"])  # they know what no robot knows
REFERENCES = (PAPERS, PROPOSAL, *_NO_RIVALS)
# What is said of a rival in the ranking, and of a part of a loop.
BEST = "the best"
MAY_BE_BEST = "may be the best"
EXCLUDED = "excluded"
PAYS = "pays"
COSTS = "costs"
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


def scenarios(seeds, labels=None):
    """(world, label, Scenario) of contestants on every seed.

    Args:
        seeds: Of the fields.
        labels: {world: labels of the contestants}; by default all of every world.
    """
    rows = []
    for world in TUNED if labels is None else labels:
        chosen = [
            (label, fields)
            for label, fields in contestants(world).values()
            if labels is None or label in labels[world]
        ]
        for (label, fields), seed in itertools.product(chosen, seeds):
            rows.append((world, label, Scenario(**WORLDS[world] | fields, seed=seed)))
    return rows


def drive(seeds, folder=None, labels=None):
    """Drive contestants on every seed.

    Args:
        seeds: Of the fields.
        folder: Of the campaign's rows, as in `rhec.campaign`.
        labels: {world: labels of the contestants}; by default all of every world.

    Returns:
        The campaign's DataFrame with the columns world and contestant.
    """
    of_worlds, names, drives = zip(*scenarios(seeds, labels))
    return campaign(drives, folder).assign(world=of_worlds, contestant=names)


def in_two_looks(first, seeds, folder=None):
    """Drive every contestant on the first seeds, and on all seeds those that go on.

    Args:
        first: Fields of the first look, seeds 0 to first - 1.
        seeds: Fields of the second. With no more than in the first there is one look.
        folder: Of the campaign's rows.

    Returns:
        The rows of `drive`; which contestant has how many of them says which look decided.
    """
    sweep = drive(range(min(first, seeds)), folder)
    if first >= seeds:
        return sweep
    more = drive(range(first, seeds), folder, goes_on(sweep))
    return pd.concat([sweep, more], ignore_index=True)


def goes_on(sweep):
    """The contestants that have a second look: {world: set of labels}.

    Args:
        sweep: Rows of `drive` of the first look.
    """
    chosen = {}
    for world, errors in _errors_by_world(sweep):
        leader, differences = _behind_leader(errors, FIRST_CONFIDENCE)
        may_be_best = {name for name, found in differences.items() if not found.low > 0}
        unclear = [
            pair
            for _, *pair in _pairs_of(errors)
            if _says(
                over_seeds(ratio_of_means, *_paired(errors, *pair), confidence=FIRST_CONFIDENCE)
            )
            == UNDECIDED
        ]
        named = {name for name in REFERENCES if name in errors}
        chosen[world] = {leader} | may_be_best | named | {*itertools.chain(*unclear)}
    return chosen


def standings(errors):
    """What the fields say of each rival: BEST, MAY_BE_BEST or EXCLUDED.

    Args:
        errors: {label: Series of mean true errors by seed}. Those of fewer seeds than the leader's
            were excluded by the first look, or the first look is the only one.

    Returns:
        {label: standing}, without the oracles.
    """
    rivals = [name for name in errors if name not in _NO_RIVALS]
    most = max(len(errors[name]) for name in rivals)
    seen = {name: errors[name] for name in rivals if len(errors[name]) == most}
    confidence = 1 - (1 - CONFIDENCE) / max(1, len(rivals) - 1)
    leader, differences = _behind_leader(seen, confidence)
    left = [leader, *(name for name, found in differences.items() if not found.low > 0)]
    of_those_left = BEST if len(left) == 1 else MAY_BE_BEST
    return {name: of_those_left if name in left else EXCLUDED for name in rivals}


def error_rate(rivals):
    """The probability, at most, with which two looks exclude the best of so many rivals and one."""
    return rivals * (1 - FIRST_CONFIDENCE) / 2 + (1 - CONFIDENCE) / 2


def _errors_by_world(sweep):
    """(world, {label: Series of mean true errors by seed}) of a sweep."""
    for world, of_world in sweep.groupby("world", sort=False):
        by_seed = of_world.set_index("seed")["mean_error_true_m"]
        of_label = by_seed.groupby(of_world["contestant"].to_numpy(), sort=False)
        yield world, dict(list(of_label))


def _behind_leader(errors, confidence):
    """The rival of least mean error, and the Intervals of how far each other is behind it."""
    rivals = [name for name in errors if name not in _NO_RIVALS]
    leader = min(rivals, key=lambda name: errors[name].mean())
    differences = {
        name: over_seeds(difference_of_means, *_paired(errors, name, leader), confidence=confidence)
        for name in rivals
        if name != leader
    }
    return leader, differences


def _paired(errors, one, other):
    """The errors of two contestants at the seeds that both have: arrays (n,)."""
    both = pd.concat([errors[one], errors[other]], axis=1, join="inner")
    return both.to_numpy().T


def _pairs_of(errors):
    """(what, with it, without it) of WORTH, by labels, where both loops were driven."""
    by_label = [(what, LABELS[one], LABELS[other]) for what, one, other in WORTH]
    return [row for row in by_label if row[1] in errors and row[2] in errors]


def _says(interval):
    """What the interval of a ratio of errors says of a part of a loop."""
    if interval.high < 1:
        return PAYS
    return COSTS if interval.low > 1 else UNDECIDED


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


def overview(table, text=interval_text):
    """The mean true errors of `ranking_table` for readers: a row a contestant, a column a world.

    A contestant that the first look excluded has no number: its mean of a few fields would stand
    beside means of others.

    Args:
        table: Of `ranking_table`.
        text: Function of mean, low and high that returns a text.
    """
    rows = table[table["quantity"] == QUANTITIES["mean_error_true_m"]]
    n_fields = rows["n"].max()
    values = [
        text(row.mean, row.low, row.high)
        if row.n == n_fields
        else f"{EXCLUDED} after {row.n} fields"
        for row in rows[[*_MEANS, "n"]].itertuples(index=False)
    ]
    order = rows["contestant"].unique()
    wide = rows.assign(value=values).pivot(index="contestant", columns="world", values="value")
    return wide.reindex(order)[rows["world"].unique()].rename_axis(None, axis=1)


def ranking_table(sweep):
    """Means over seeds of every contestant, and ratios of mean true errors at equal seeds.

    The ratios are to the paper's RHE and to both oracles that estimate their pose. The claims are
    the aims of the proposal. The verdict on a mean true error is its standing.

    Args:
        sweep: Rows of `drive` or `in_two_looks`.

    Returns:
        DataFrame with columns world, contestant, quantity, mean, low, high, n, claim, verdict; the
        worlds in their order, the best first: by the ratio to one of them at equal seeds.
    """
    rows = []
    for world, errors in _errors_by_world(sweep):
        of_world = sweep[sweep["world"] == world]
        runs = dict(list(of_world.groupby("contestant", sort=False)))
        standing = standings(errors)
        longest = max(errors, key=lambda name: len(errors[name]))
        ratios = {name: ratio_of_means(*_paired(errors, name, longest), axis=-1) for name in runs}
        for name in sorted(runs, key=ratios.get):
            about = dict(world=world, contestant=name)
            rows += [about | row for row in _means_of(runs[name], standing.get(name, ""))]
            rows += [about | row for row in _ratios_of(name, errors)]
    columns = "world contestant quantity mean low high n claim verdict".split()
    return pd.DataFrame(rows, columns=columns).fillna({"claim": "", "verdict": ""})


def _means_of(runs, standing):
    """Rows of `ranking_table`: the means of a contestant's runs."""
    rows = [
        dict(quantity=quantity) | over_seeds(np.mean, runs[column])._asdict()
        for column, quantity in QUANTITIES.items()
    ]
    for row in rows:
        if row["quantity"] == QUANTITIES["mean_error_true_m"]:
            row["verdict"] = standing
    return rows


def _ratios_of(name, errors):
    """Rows of `ranking_table`: ratios of a contestant's errors, with the aims of the proposal."""
    targets = {PAPERS: 1 - LEAST_GAIN} | {oracle: 1 + MOST_ABOVE for oracle in _ORACLES}
    rows = []
    for other, most in targets.items():
        if other not in errors or name == other:
            continue
        ratio = over_seeds(ratio_of_means, *_paired(errors, name, other))
        row = dict(quantity=f"true error, ratio to {other}") | ratio._asdict()
        if name == PROPOSAL:
            judged = verdict(ratio.low, ratio.high, below=most)
            row |= dict(claim=f"at most {most:.2f}", verdict=judged)
        rows.append(row)
    return rows


def worth_table(sweep):
    """What each part of WORTH is worth: the error with it over the error without it.

    Args:
        sweep: Rows of `drive` or `in_two_looks`.

    Returns:
        DataFrame with columns world, quantity, mean, low, high (95 %, at equal seeds), n, verdict:
        PAYS, COSTS or UNDECIDED, at 99.9 % where the first look decided.
    """
    n_fields = sweep["seed"].nunique()
    rows = []
    for world, errors in _errors_by_world(sweep):
        for what, *pair in _pairs_of(errors):
            both = _paired(errors, *pair)
            confidence = CONFIDENCE if len(both[0]) == n_fields else FIRST_CONFIDENCE
            says = _says(over_seeds(ratio_of_means, *both, confidence=confidence))
            ratio = over_seeds(ratio_of_means, *both)._asdict()
            rows.append(dict(world=world, quantity=what) | ratio | dict(verdict=says))
    columns = ["world", "quantity", "mean", "low", "high", "n", "verdict"]
    return pd.DataFrame(rows, columns=columns)


def readable_worth(table):
    """The table of `worth_table` for readers: one row a part, one column a world."""
    return readable(table)
