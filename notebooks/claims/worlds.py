"""In which share of the posterior's worlds each claim about driving holds.

A world is a dict of Scenario's fields. It may also say which W the RHE has (w_rhe) and which the
EKF (w_ekf, see `which_worlds.noise_of`); all others are those by prediction. In each, a few fields
are driven, and the rule of a claim is applied to the value itself: few fields have no useful
interval, but the share of worlds has one.

With μ and v the soil's mean and the speed, a drive lasts for two rows, two headlands and a quarter
of the third row at the pace μv, so that it turns to both sides, or for the first row alone. A world
that says how long its drive lasts is taken at its word where the RHE, the EKF and the oracle alone
are compared, because numbers of violations grow with the length.
"""

import dataclasses

import numpy as np
import pandas as pd

import rhec
from notebooks.claims import evidence as looks
from notebooks.claims import run_sets
from notebooks.studies import which_worlds
from notebooks.studies.statistics import (
    FAILS,
    HOLDS,
    LOST,
    LOST_ITSELF,
    PREDICTION,
    UNDECIDED,
    share,
)
from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning

FIRST_SEED = 20_000  # beyond those of ledger, calibration and posterior
_WHOLE_DRIVES = {"rhe", "ekf", "oracle"}  # claims on these alone are judged on a world's own drive


# Drives


def _usable(world):
    """A world's fields of Scenario without those that a claim decides."""
    names = {field.name for field in dataclasses.fields(Scenario)}
    decided = {"process_noise", "sigma_w", "arrival_mean", "estimator", "seed", "q", "r"}
    return {name: of for name, of in world.items() if of is not None and name in names - decided}


def _noise(world, estimator):
    """The fields of Scenario that give an estimator the W that it has in a world."""
    w = world.get("w_ekf" if estimator == "ekf" else "w_rhe", "prediction")
    if estimator in ("rhe", "ekf"):
        return dict(process_noise=None) | which_worlds.noise_of(estimator, w, world)
    has_noises = isinstance(estimator, str | rhec.Estimator)
    noises = tuning.noises_of(estimator) if has_noises else {}
    return dict(process_noise=w if w in noises else "prediction")


def _drive_s(fields, on_row):
    """How long a drive lasts in a world [s]: the first row, or turns to both sides [s]."""
    usual = Scenario(**{name: value for name, value in fields.items() if name != "duration_s"})
    row_m = usual.row_length_m
    both_ways_m = 2.25 * row_m + 2 * np.pi * usual.headland_radius_m
    length_m = row_m if on_row else both_ways_m
    pace_mps = usual.mu_mean * usual.speed_mps
    return float(np.clip(length_m / pace_mps, 2 * paper.DT_S, 600.0))


def _scenarios(table, world, seeds, whole):
    """The scenarios of a table (kind, id) in a world."""
    kind, id_ = table
    fields = _usable(world)
    of_id = (run_sets.RUNS if kind == "runs" else run_sets.LOGS)[id_]
    noise = _noise(world, of_id.get("estimator", "rhe"))
    process_noise = noise.pop("process_noise")
    on_row = id_ in run_sets.ON_ROW
    duration_s = fields.pop("duration_s", None)
    if duration_s is None or on_row or not whole:
        duration_s = _drive_s(fields | run_sets.fields_of(of_id, process_noise, noise), on_row)
    of_id = {name: value for name, value in of_id.items() if name != "duration_s"}
    world = fields | noise | dict(duration_s=duration_s)
    return run_sets.scenarios(of_id, process_noise, seeds, world)


def _is_driven(claim):
    """Whether a claim rests on drives that another world may change."""
    conditions = claim.rule.by_condition.values()
    kinds = {kind for _, kind, _ in looks.tables_of(conditions)}
    return claim.rule.other_worlds and "experiments" not in kinds


def _tables_of(claim):
    """The tables (kind, id) of a claim, and whether it is judged on whole drives."""
    tables = claim.rule.by_condition[PREDICTION].tables
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
        ("prediction", kind, id_): found[kind, id_, whole][rows]
        for kind, id_, whole in _tables_of(claim)
    }
    return claim.rule.by_condition[PREDICTION](evidence)


# Verdicts in worlds


def by_value(finding):
    """The verdict of a rule's value, without an interval; UNDECIDED if there is no value.

    To beat a rival that is lost is LOST here, too. A number that the paper reports holds if it is
    met, which few drives can say of a mean, but not of the middle 90 % of drives.
    """
    if not np.isfinite(finding.value):
        return UNDECIDED
    if finding.verdict == LOST:
        return LOST
    if finding.verdict == LOST_ITSELF:
        return FAILS
    # "Every case" is kept at its bound, as an interval's verdict says.
    is_between = finding.above < finding.value < finding.below
    return HOLDS if finding.verdict == HOLDS or is_between else FAILS


def judge(claims, worlds, fields, folder=None):
    """Judge claims in worlds.

    Args:
        claims: {id: Claim}; those that another world cannot change are left out.
        worlds: A list of dicts, fields of Scenario.
        fields: How many fields are driven in each world, all different.
        folder: Where the campaign keeps its rows.

    Returns:
        DataFrame (worlds, claims) of verdicts by value.
    """
    claims = {id_: claim for id_, claim in claims.items() if _is_driven(claim)}
    firsts = range(FIRST_SEED, FIRST_SEED + fields * len(worlds), fields)
    seeds = [range(first, first + fields) for first in firsts]
    found = run_sets.measure(_drives(claims, worlds, seeds), folder)
    verdicts = {
        id_: [by_value(_in_world(claim, found, place, fields)) for place, _ in enumerate(worlds)]
        for id_, claim in claims.items()
    }
    return pd.DataFrame(verdicts)


def shares(claims, worlds, fields, folder=None):
    """The share of worlds in which each claim holds, with Clopper and Pearson's interval.

    Args:
        claims, worlds, fields, folder: As for `judge`.

    Returns:
        {id: Finding}; worlds without a value do not count as holding.
    """
    verdicts = judge(claims, worlds, fields, folder)
    return {id_: share(verdicts[id_] == HOLDS) for id_ in verdicts}
