"""The claims in other worlds: in which share of them each holds, and on what that depends.

A world is a dict of Scenario's fields. It may also say which W the RHE has (process_noise) and
which the EKF (process_noise_ekf); otherwise both are calibrated. In each, a few fields are driven,
and the rule of a claim is applied to the value itself: few fields have no useful interval, but the
share of worlds has one.

With μ and v the soil's mean and the speed, a drive lasts for a row, a headland and a quarter of the
next row at the pace μv, or for the first row alone, as in the multiverse. A world that says how
long its drive lasts is taken at its word where the RHE, the EKF and the oracle alone are compared,
because numbers of violations grow with the length.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.workbench.studies.claims import evidence as looks
from rhec.workbench.studies.claims import experiments, run_sets
from rhec.workbench.studies.claims.rules import CALIBRATED
from rhec.workbench.studies.statistics import FAILS, HOLDS, UNDECIDED, share

__all__ = [
    "FIRST_SEED",
    "Split",
    "by_value",
    "columns_of",
    "confirmed",
    "corner",
    "judge",
    "margin",
    "shares",
    "split_of",
    "usable",
]

FIRST_SEED = 20_000  # beyond those of ledger, calibration, multiverse and inverse problem
_CONFIRMING_SEED = 40_000  # fields on which a rare outcome is confirmed
_WHOLE_DRIVES = {"rhe", "ekf", "oracle"}  # claims on these alone are judged on a world's own drive
_FOLDS = 10
_ACCURATE = 0.85  # a condition is said only if it predicts so many of the held-out worlds
_HALF = 0.5  # … and leaves at most so much of the errors of always saying the same


# Drives


def usable(world):
    """A world's fields of Scenario without those that a claim decides."""
    decided = {"process_noise", "process_noise_ekf", "sigma_w", "estimator", "seed", "q", "r"}
    return {name: of for name, of in world.items() if of is not None and name not in decided}


def _process_noise(world, estimator):
    """Which W an estimator has in a world."""
    if estimator == "ekf":
        return world.get("process_noise_ekf", "calibrated")
    named = world.get("process_noise", "calibrated")
    return named if named in tuning.SIGMA_W.get(estimator, {}) else "calibrated"


def _drive_s(fields, on_row):
    """How long a drive lasts in a world [s]: the first row, or a headland and more [s]."""
    usual = Scenario(**{name: value for name, value in fields.items() if name != "duration_s"})
    row_m = usual.row_length_m
    length_m = row_m if on_row else 1.25 * row_m + np.pi * usual.headland_radius_m
    pace_mps = usual.mu_mean * usual.speed_mps
    return float(np.clip(length_m / pace_mps, 2 * paper.DT_S, 600.0))


def _scenarios(table, world, seeds, whole):
    """The scenarios of a table (kind, id) in a world."""
    kind, id_ = table
    fields = usable(world)
    of_id = (run_sets.RUNS if kind == "runs" else run_sets.LOGS)[id_]
    process_noise = _process_noise(world, of_id.get("estimator", "rhe"))
    on_row = id_ in run_sets.ON_ROW
    duration_s = fields.pop("duration_s", None)
    if duration_s is None or on_row or not whole:
        duration_s = _drive_s(fields | run_sets.fields_of(of_id, process_noise), on_row)
    of_id = {name: value for name, value in of_id.items() if name != "duration_s"}
    world = fields | dict(duration_s=duration_s)
    return run_sets.scenarios(of_id, process_noise, seeds, world)


def _is_driven(claim):
    """Whether a claim rests on drives that another world may change."""
    conditions = claim.rule.by_condition.values()
    kinds = {kind for _, kind, _ in looks.tables_of(conditions)}
    return claim.rule.other_worlds and "experiments" not in kinds


def _tables_of(claim):
    """The tables (kind, id) of a claim, and whether it is judged on whole drives."""
    tables = claim.rule.by_condition[CALIBRATED].tables
    whole = all(kind == "runs" and id_ in _WHOLE_DRIVES for _, kind, id_ in tables)
    return [(kind, id_, whole) for _, kind, id_ in tables]


def _drives(claims, worlds, seeds):
    """The drives that claims need: {kind: {(kind, id, whole): scenarios}}, for each world in turn.

    `seeds` has the seeds of each world.
    """
    every = dict.fromkeys(table for claim in claims.values() for table in _tables_of(claim))
    return {
        kind: {
            (kind_, id_, whole): [
                scenario
                for world, of_world in zip(worlds, seeds)
                for scenario in _scenarios((kind_, id_), world, of_world, whole)
            ]
            for kind_, id_, whole in every
            if kind_ == kind
        }
        for kind in ("runs", "logs")
    }


def _in_world(claim, found, place, fields):
    """The Finding of a claim in the world at `place`, where W is the world's."""
    rows = slice(place * fields, (place + 1) * fields)
    evidence = {
        ("calibrated", kind, id_): found[kind, id_, whole][rows]
        for kind, id_, whole in _tables_of(claim)
    }
    return claim.rule.by_condition[CALIBRATED](evidence)


# Verdicts in worlds


def by_value(finding):
    """The verdict of a rule's value, without an interval; UNDECIDED if there is no value.

    A number that the paper reports must lie in the interval of single runs and near their mean.
    """
    value, low, high, above, below = (
        getattr(finding, name) for name in ("value", "low", "high", "above", "below")
    )
    if not np.isfinite(value):
        return UNDECIDED
    if above == below:
        near = abs(value - above) < 0.25 * abs(above)
        return HOLDS if near and low <= above <= high else FAILS
    # "Every case" is kept at its bound, as an interval's verdict says.
    return HOLDS if finding.verdict == HOLDS or above < value < below else FAILS


def margin(finding):
    """How far a value is on its side of the nearer bound; negative on the other side."""
    if finding.above == finding.below:
        return -abs(finding.value - finding.above)
    return min(finding.value - finding.above, finding.below - finding.value)


def judge(claims, worlds, fields, folder=None):
    """Judge claims in worlds.

    Args:
        claims: {id: Claim}.
        worlds: A list of dicts, fields of Scenario.
        fields: How many fields are driven in each world, all different.
        folder: Where the campaign keeps its rows.

    Returns:
        DataFrames (worlds, claims) of verdicts by value, and of margins.
    """
    claims = {id_: claim for id_, claim in claims.items() if _is_driven(claim)}
    firsts = range(FIRST_SEED, FIRST_SEED + fields * len(worlds), fields)
    seeds = [range(first, first + fields) for first in firsts]
    found = run_sets.measure(_drives(claims, worlds, seeds), folder)
    verdicts = {}
    margins = {}
    for id_, claim in claims.items():
        findings = [_in_world(claim, found, place, fields) for place, _ in enumerate(worlds)]
        verdicts[id_] = [by_value(finding) for finding in findings]
        margins[id_] = [margin(finding) for finding in findings]
    return pd.DataFrame(verdicts), pd.DataFrame(margins)


def shares(verdicts):
    """The share of worlds in which each claim holds, with Clopper and Pearson's interval.

    Returns:
        {id: Finding}; worlds without a value do not count as holding.
    """
    return {id_: share(verdicts[id_] == HOLDS) for id_ in verdicts}


def confirmed(claims, missing, worlds, verdicts, margins, fields, folder=None):
    """Confirm outcomes that the ledger's conditions lack, on fresh fields.

    Of the worlds where a claim comes out so by value, the one farthest from the bound is driven on
    new fields, and the rule with its 95 % interval decides. One world is tried for each claim, so
    that no number of tries makes an outcome out of chance.

    Args:
        claims: {id: Claim}.
        missing: {id: verdict that is looked for}.
        worlds, verdicts, margins: Of `judge`.
        fields: New fields.
        folder: Where the campaign keeps its rows.

    Returns:
        {id: place of the world} of the outcomes that are confirmed.
    """
    places = {}
    for id_, outcome in missing.items():
        candidates = margins.loc[verdicts[id_] == outcome, id_] if id_ in verdicts else []
        if len(candidates):
            places[id_] = (candidates if outcome == HOLDS else -candidates).idxmax()
    seeds = range(_CONFIRMING_SEED, _CONFIRMING_SEED + fields)
    drives = {"runs": {}, "logs": {}}  # of all these worlds, so that they are driven together
    for place in set(places.values()):
        here = {id_: claims[id_] for id_ in places if places[id_] == place}
        for kind, of_kind in _drives(here, [worlds[place]], [seeds]).items():
            drives[kind] |= {(place, *table): part for table, part in of_kind.items()}
    tables = run_sets.measure(drives, folder)
    found = {}
    for id_, place in places.items():
        here = {tuple(table): part for (at, *table), part in tables.items() if at == place}
        if _in_world(claims[id_], here, 0, fields).verdict == missing[id_]:
            found[id_] = place
    return found


def corner(claims, world, seeds, folder=None):
    """{id: verdict} of claims in one of `run_sets.WORLDS`, with W calibrated."""
    judges = {id_: claim.rule.by_condition[CALIBRATED] for id_, claim in claims.items()}
    tables = looks.tables_of(judges.values())
    scenarios = {
        kind: {
            table: run_sets.scenarios(sets[table[2]], table[0], range(seeds), world)
            for table in tables
            if table[1] == kind
        }
        for kind, sets in {"runs": run_sets.RUNS, "logs": run_sets.LOGS}.items()
    }
    evidence = run_sets.measure(scenarios, folder)
    names = [(noise, name) for noise, kind, name in tables if kind == "experiments"]
    for (noise, name), table in experiments.make(names, seeds, world).items():
        evidence[noise, "experiments", name] = table
    return {id_: judge(evidence).verdict for id_, judge in judges.items()}


# On what a verdict depends


def columns_of(worlds):
    """The numbers in which worlds differ: DataFrame (worlds, fields).

    A field that a world does not name has its usual value there. `printed_w` is 1 where the RHE has
    the printed W.
    """
    usual = Scenario()
    named = dict.fromkeys(name for world in worlds for name in usable(world))
    table = pd.DataFrame(
        {name: [world.get(name, getattr(usual, name)) for world in worlds] for name in named}
    )
    table["printed_w"] = [float(_process_noise(world, "rhe") == "printed") for world in worlds]
    # A bool is a number to pandas, but has no threshold.
    numbers = table.select_dtypes("number").astype(float)
    return numbers.loc[:, numbers.nunique() > 1]


class Split(NamedTuple):
    """A claim holds where a field of the world is on one side of a threshold.

    Args:
        field: Of the world.
        threshold: Half-way between two worlds.
        below: Whether the claim holds below it.
        accuracy: Share of held-out worlds whose verdict it predicts.
        usual: That of always saying the more frequent verdict.
    """

    field: str
    threshold: float
    below: bool
    accuracy: float
    usual: float


def _best_split(values, holds):
    """(column, threshold, below) of the single threshold with the fewest errors.

    Args:
        values: (worlds, fields).
        holds: Flags (worlds,).
    """
    best = (len(holds) + 1, 0, 0.0, True)
    for column in range(values.shape[1]):
        order = np.argsort(values[:, column], kind="stable")
        ordered = values[order, column]
        flags = holds[order]
        n_held = np.concatenate([[0], np.cumsum(flags)])
        # Saying "holds" for the first k: errors are the k that fail and the others that hold.
        k = np.arange(len(flags) + 1)
        errors_below = k - n_held + n_held[-1] - n_held
        middle = np.concatenate([[-np.inf], (ordered[1:] + ordered[:-1]) / 2, [np.inf]])
        # Equal values cannot be told apart by a threshold.
        apart = np.concatenate([[True], ordered[1:] > ordered[:-1], [True]])
        for below, errors in ((True, errors_below), (False, len(flags) - errors_below)):
            at = np.flatnonzero(apart)[np.argmin(errors[apart])]
            best = min(best, (int(errors[at]), column, float(middle[at]), below))
    return best[1:]


def split_of(worlds, holds):
    """The condition under which a claim holds, if a single threshold tells it.

    The accuracy is by cross-validation over ten parts: field and threshold are chosen without the
    part that they are tested on.

    Args:
        worlds: DataFrame (worlds, fields) of numbers.
        holds: Flags (worlds,), whether the claim holds.

    Returns:
        Split; None where it predicts less than 85 % of held-out worlds, or makes more than half
        of the errors of always saying the more frequent verdict.
    """
    values = worlds.to_numpy(float)
    holds = np.asarray(holds, dtype=bool)
    usual = max(holds.mean(), 1 - holds.mean())
    if usual == 1:
        return None
    parts = np.random.default_rng(0).permutation(len(holds)) % _FOLDS
    right = np.zeros(len(holds), dtype=bool)
    for part in range(_FOLDS):
        out = parts == part
        column, threshold, below = _best_split(values[~out], holds[~out])
        right[out] = ((values[out, column] < threshold) == below) == holds[out]
    accuracy = right.mean()
    if accuracy < _ACCURATE or 1 - accuracy > _HALF * (1 - usual):
        return None
    column, threshold, below = _best_split(values, holds)
    return Split(worlds.columns[column], threshold, below, float(accuracy), float(usual))
