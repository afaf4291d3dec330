"""The claims ledger: what the evidence says of every checkable sentence of the paper.

The sentences and their rules are in claims.toml (`rules.load`). A field is one seed: its soil and
its noise together. A bound on the true error is judged relative to the oracle, a robot that knows
its true pose and soil: fields where the oracle fails too are left out.

Each verdict has one of three labels. It follows *by derivation* from equations or from the paper's
own numbers, which no world could change. It was *tested* if some world or some reading of the text
gave the other verdict, too. Or it was *the same in every world tried*. `outcomes` looks for the
other verdict under the conditions of the ledger, then in worlds of the multiverse and of the
posterior, then in the corners of `run_sets.WORLDS`.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from rhec.workbench.studies.claims import run_sets, worlds
from rhec.workbench.studies.claims.rules import CLAIMS
from rhec.workbench.studies.claims.summary import BY_DERIVATION, SAME, TESTED
from rhec.workbench.studies.statistics import (
    FAILS,
    HOLDS,
    UNDECIDED,
    UNTESTABLE,
    coverage,
    difference_of_means,
    interval_text,
    ratio_of_means,
)

__all__ = ["CLAIMS", "Judged", "coverages", "in_worlds", "ledger", "outcomes"]

_PAIRS = ("rhe", "ekf"), ("rhe", "no_slip"), ("fixed_traction", "rhe"), ("q3", "q2")
_COLUMNS = (
    "id section claim quote test bound paper value low high n unit verdict here basis condition "
    "confidence above below p p_adjusted conditions other_condition other_value other_low "
    "other_high other_n other_verdict other_above other_below reached beside where where_accuracy"
).split()
_WORDS = {  # of fields of a world, in a condition
    "mu_mean": "the mean of μ",
    "mu_deviation": "the deviation of μ",
    "kappa_mean": "the mean of κ",
    "kappa_deviation": "the deviation of κ",
    "correlation_length_m": "the soil's correlation length [m]",
    "speed_mps": "the speed [m/s]",
    "gnss_sigma_m": "σ of GNSS [m]",
    "gnss_slow_share": "the slow share of GNSS errors",
    "gnss_slow_time_s": "the time of slow GNSS errors [s]",
    "bump_sigma_radps": "σ of the bumps [rad/s]",
    "encoder_sigma_mps": "σ of the encoders [m/s]",
    "speed_sigma_mps": "σ of the speed common to both encoders [m/s]",
    "command_delay": "the delay of the command [samples]",
    "rut_length_m": "the length of the ruts [m]",
    "slip_difference": "the slip difference of the tracks",
    "rotation_centre_m": "the offset of the centre of rotation [m]",
    "start_offset_m": "the offset of the start [m]",
    "row_length_m": "the length of a row [m]",
    "headland_radius_m": "the radius of the headland [m]",
    "duration_s": "the length of the drive [s]",
}


class Judged(NamedTuple):
    """Claims judged in worlds.

    Args:
        worlds: A list of dicts, fields of Scenario.
        verdicts: DataFrame (worlds, claims), by value.
        margins: DataFrame (worlds, claims).
    """

    worlds: list
    verdicts: pd.DataFrame
    margins: pd.DataFrame


# Worlds


def in_worlds(sets, fields, claims=CLAIMS, folder=None):
    """Judge the claims about driving in sets of worlds.

    Args:
        sets: {name: list of dicts}, each a world of fields of Scenario.
        fields: How many fields are driven in each world.
        claims: {id: Claim}.
        folder: Where the campaign keeps its rows.

    Returns:
        {name: Judged}.
    """
    return {
        name: Judged(list(part), *worlds.judge(claims, list(part), fields, folder))
        for name, part in sets.items()
    }


def outcomes(findings, judged, fields, claims=CLAIMS, corners=run_sets.WORLDS, folder=None):
    """Where each claim holds and where it does not.

    The conditions of the ledger come first, then the worlds, in which an outcome is confirmed on
    fresh fields, then the corners. Only claims that still lack a verdict are looked at again.

    Args:
        findings: {id: {condition: Finding}}, of `evidence.collect`.
        judged: Of `in_worlds`.
        fields: The number of fields in each of these worlds.
        claims: {id: Claim}.
        corners: {name: fields of Scenario}.
        folder: Where the campaign keeps its rows.

    Returns:
        {id: {verdict: the first condition or world that gave it}}, HOLDS before FAILS.
    """
    places = {id_: {} for id_ in claims}
    for id_, found in findings.items():
        for condition, finding in found.items():
            places[id_].setdefault(finding.verdict, condition or "everywhere")
    for name, (drawn, verdicts, margins) in judged.items():
        for outcome in (HOLDS, FAILS):
            one_sided = _one_sided(claims, places)
            missing = {id_: outcome for id_ in one_sided if outcome not in places[id_]}
            told = worlds.confirmed(claims, missing, drawn, verdicts, margins, fields, folder)
            for id_, place in told.items():
                places[id_].setdefault(outcome, f"{name} world {place}")
    for name, world in corners.items():
        rest = _one_sided(claims, places)
        if not rest:
            break
        # One evidence for all claims that are still one-sided: a corner's drives are made once.
        for id_, verdict in worlds.corner(rest, world, fields, folder).items():
            places[id_].setdefault(verdict, name)
    return {
        id_: {verdict: where[verdict] for verdict in (HOLDS, FAILS) if verdict in where}
        for id_, where in places.items()
    }


def _one_sided(claims, places):
    """The claims that lack one of the two verdicts and that another world may change."""
    return {
        id_: claim
        for id_, claim in claims.items()
        if claim.rule.other_worlds and not {HOLDS, FAILS} <= {*places[id_]}
    }


# The table


def _largest_p(findings, verdict):
    """The largest p of the conditions; undecided ones count only where they decide. -1 if none."""
    ps = [
        finding.p
        for finding in findings.values()
        if verdict == UNDECIDED or finding.verdict != UNDECIDED
    ]
    return np.nanmax([*ps, -1])


def _other(findings, deciding):
    """Columns of the Finding to show beside the deciding one: the first whose verdict differs."""
    others = {name: finding for name, finding in findings.items() if name != deciding}
    if not others:
        return dict(other_condition="", other_verdict="")
    differs = [name for name in others if others[name].verdict != findings[deciding].verdict]
    name = next(iter(differs or others))
    columns = {f"other_{field}": value for field, value in others[name]._asdict().items()}
    return dict(other_condition=name) | columns


def _basis(claim, verdict, reached):
    """What a verdict rests on: derivation, both outcomes, or one outcome in every world."""
    if verdict == UNTESTABLE:
        return ""
    if claim.derived:
        return BY_DERIVATION
    return TESTED if {HOLDS, FAILS} <= {*reached} else SAME


def _words_of(split):
    """A Split in words."""
    if split.field == "printed_w":
        return "W is not as printed" if split.below else "W is as printed"
    name = _WORDS.get(split.field, split.field)
    return f"{name} is {'below' if split.below else 'above'} {split.threshold:.2g}"


def _varied(sets):
    """The fields that vary within each set of worlds: DataFrame, one row a world of all sets.

    A field that is constant in one set would tell the sets apart, not what a verdict depends on.
    """
    every = worlds.columns_of([world for part in sets for world in part])
    names = [{*worlds.columns_of(part)} for part in sets]
    return every[[name for name in every if all(name in of_set for of_set in names)]]


def _where(id_, judged):
    """Columns on the worlds: the share of each set where a claim holds, and the condition."""
    columns = {"where": "", "where_accuracy": np.nan}
    here = {name: part for name, part in judged.items() if id_ in part.verdicts}
    for name, part in here.items():
        found = worlds.shares(part.verdicts)[id_]
        columns |= {name: found.value, f"{name}_low": found.low, f"{name}_high": found.high}
        columns |= {f"{name}_n": found.n}
    if here:
        holds = np.concatenate([part.verdicts[id_] == HOLDS for part in here.values()])
        split = worlds.split_of(_varied([part.worlds for part in here.values()]), holds)
        if split:
            columns |= {"where": _words_of(split), "where_accuracy": split.accuracy}
    return columns


def _row(id_, claim, findings, looks, beside, reached, judged):
    """The ledger's row on one claim, but for p_adjusted, which depends on all rows."""
    verdict, deciding = claim.rule.combined(findings)
    row = claim._asdict() | findings[deciding]._asdict() | claim.rule._asdict()
    row |= dict(id=id_, condition=deciding, p=_largest_p(findings, verdict))
    row |= dict(basis=_basis(claim, verdict, reached), confidence=looks[deciding])
    row["conditions"] = "; ".join(f"{name}: {each.verdict}" for name, each in findings.items())
    row["reached"] = "; ".join(f"{outcome}: {place}" for outcome, place in reached.items())
    row["beside"] = "; ".join(
        f"{what}: {interval_text(number.value, number.low, number.high)}"
        for what, number in beside.items()
    )
    row |= _where(id_, judged) | dict(here=verdict)
    # Where the readings of the text agree, and the world decides, the verdict says which worlds.
    if row["where"] and verdict in (HOLDS, FAILS, UNDECIDED):
        verdict = f"{HOLDS} where {row['where']}"
    return row | dict(verdict=verdict) | _other(findings, deciding)


def ledger(findings, looks, beside, reached, judged, claims=CLAIMS):
    """Judge claims: what the paper says, what the evidence says, and the verdict.

    Args:
        findings, looks, beside: Of `evidence.collect`.
        reached: Of `outcomes`.
        judged: Of `in_worlds`.
        claims: {id: Claim}.

    Returns:
        DataFrame, one row a claim: id, section, claim, quote, test, bound, paper, the Finding under
        the condition that decides (value, low, high, n, unit, condition, above, below), the
        verdict, the one of the default world (here), and the confidence of the look that decided;
        basis, the label; the verdict under each
        condition; the Finding under the first that says otherwise, or else the next
        (other_condition, other_value, …); where either verdict was reached; the numbers beside;
        where, the condition on the world, and the share of held-out worlds that it predicts; for
        each set of worlds the share where the claim holds (NAME, NAME_low, NAME_high, NAME_n); and
        why. p is the largest of the conditions', p_adjusted the same with the false discovery rate
        held over the whole ledger (Benjamini and Yekutieli); NaN where nothing is left to chance.
    """
    rows = [
        _row(id_, claim, findings[id_], looks[id_], beside[id_], reached[id_], judged)
        for id_, claim in claims.items()
    ]
    of_sets = [f"{name}{end}" for name in judged for end in ("", "_low", "_high", "_n")]
    table = pd.DataFrame(rows, columns=[*_COLUMNS, *of_sets, "why"]).replace({"p": {-1.0: np.nan}})
    chance = table["p"].notna()
    adjusted = stats.false_discovery_control(table.loc[chance, "p"], method="by")
    # Claims share runs, so their tests are dependent; Benjamini and Yekutieli allow for that.
    table.loc[chance, "p_adjusted"] = adjusted
    return table


def coverages(tables, trials=2000):
    """How often the intervals behind the ledger cover the truth, by resampling.

    Args:
        tables: The evidence, of `evidence.collect`.
        trials: Of each statistic.

    Returns:
        DataFrame, one row a process noise and a statistic of RUNS' metrics.
    """
    cases = [
        (np.mean, ["rhe"], metric)
        for metric in ("mean_error_m", "mean_error_true_m", "violations", "rms_kappa")
    ]
    cases += [(difference_of_means, [one, other], "mean_error_true_m") for one, other in _PAIRS]
    cases += [(ratio_of_means, ["rhe", "oracle"], "mean_error_true_m")]
    rows = []
    for process_noise in run_sets.PROCESS_NOISES:
        for statistic, ids, metric in cases:
            # Unequal tables are cut to the seeds that both have.
            found = [tables[process_noise, "runs", id_][metric] for id_ in ids]
            n = min(map(len, found))
            share = coverage(statistic, *(values[:n] for values in found), trials=trials)
            about = dict(statistic=statistic.__name__, runs=" ".join(ids), metric=metric)
            rows.append(about | dict(process_noise=process_noise, n=n, coverage=share))
    return pd.DataFrame(rows)
