"""The claims ledger: what the evidence says of every checkable sentence of the paper.

The sentences and their rules are in claims.toml (`rules.load`). A field is one seed: its soil and
its noise together. A bound on the true error is judged relative to the oracle, a robot that knows
its true pose and soil: fields where the oracle fails too are left out.

A claim counts as tested only if its rule can come out either way: `outcomes` looks for both
verdicts under the conditions of the ledger and, where one is missing, in the other worlds of
`run_sets.WORLDS`. What comes out one way everywhere follows from equations, or from nothing that
was varied here. It is reported, and not counted.
"""

from functools import partial

import numpy as np
import pandas as pd
from scipy import stats

from rhec.workbench.studies.claims import experiments, run_sets
from rhec.workbench.studies.claims.rules import CALIBRATED, CLAIMS
from rhec.workbench.studies.claims.summary import ONE_WAY
from rhec.workbench.studies.statistics import (
    FAILS,
    HOLDS,
    UNDECIDED,
    UNTESTABLE,
    combined,
    coverage,
    difference_of_means,
    ratio_of_means,
)

__all__ = ["CLAIMS", "ONE_WAY", "collect_evidence", "coverages", "ledger", "outcomes"]

_PAIRS = ("rhe", "ekf"), ("rhe", "no_slip"), ("fixed_traction", "rhe"), ("q3", "q2")
_COLUMNS = (
    "id section claim test bound paper value low high n unit verdict kind condition above below p "
    "p_adjusted conditions other_condition other_value other_low other_high other_n other_verdict "
    "other_above other_below reached why"
).split()


def collect_evidence(seeds, folder=None):
    """Make all the evidence.

    Args:
        seeds: The largest number of fields behind a table.
        folder: Where the campaign keeps its rows.

    Returns:
        {process noise: {"runs", "logs", "experiments"}}, each of the three {id: DataFrame}.
    """
    runs = run_sets.runs(seeds, folder=folder)
    logs = run_sets.logs(seeds)
    parts = dict(runs=runs, logs=logs, experiments=experiments.all_of(seeds))
    return {
        process_noise: {name: part[process_noise] for name, part in parts.items()}
        for process_noise in run_sets.PROCESS_NOISES
    }


# Both outcomes


def _in_world(tables, world, seeds):
    """Evidence of the tables {kind: ids} in a world of WORLDS, with W calibrated."""
    noise = "calibrated"
    evidence = {kind: {} for kind in ("runs", "logs", "experiments")}
    for kind, drive in {"runs": run_sets.runs, "logs": partial(run_sets.logs, part=1.0)}.items():
        if kind in tables:
            evidence[kind] = drive(seeds, tables[kind], [noise], world)[noise]
    if "experiments" in tables:
        evidence["experiments"] = experiments.of_estimators(seeds, noise, world)
    return {noise: evidence}


def _tables_of(rules):
    """The tables {kind: ids} that these rules need, each id once."""
    tables = {}
    for rule in rules:
        for kind, ids in rule.tables.items():
            tables[kind] = [*dict.fromkeys([*tables.get(kind, []), *ids])]
    return tables


def outcomes(evidence, seeds, claims=CLAIMS, worlds=run_sets.WORLDS):
    """Where each claim holds and where it does not.

    The conditions of the ledger come first. While one of the two verdicts is missing, the claim is
    judged in one other world after the next.

    Args:
        evidence: Of `collect_evidence`.
        seeds: The number of fields in each other world.
        claims: {id: Claim}.
        worlds: {name: fields of Scenario}.

    Returns:
        {id: {verdict: the first condition or world that gave it}}, HOLDS before FAILS.
    """
    places = {id_: {} for id_ in claims}
    for id_, claim in claims.items():
        for condition, rule in claim.rule.by_condition.items():
            places[id_].setdefault(rule(evidence).verdict, condition or "everywhere")
    for name, world in worlds.items():
        one_sided = {
            id_: claim.rule
            for id_, claim in claims.items()
            if claim.rule.tables and not {HOLDS, FAILS} <= {*places[id_]}
        }
        if not one_sided:
            break
        # One evidence for all claims that are still one-sided: a world's drives are made once.
        elsewhere = _in_world(_tables_of(one_sided.values()), world, seeds)
        for id_, rule in one_sided.items():
            places[id_].setdefault(rule.by_condition[CALIBRATED](elsewhere).verdict, name)
    return {
        id_: {verdict: where[verdict] for verdict in (HOLDS, FAILS) if verdict in where}
        for id_, where in places.items()
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


def _row(id_, claim, evidence, reached):
    """The ledger's row on one claim, but for p_adjusted, which depends on all rows."""
    findings = {name: rule(evidence) for name, rule in claim.rule.by_condition.items()}
    verdict, deciding = combined(findings)
    is_tested = {HOLDS, FAILS} <= {*reached} or verdict == UNTESTABLE
    row = claim._asdict() | findings[deciding]._asdict() | claim.rule._asdict()
    row |= dict(id=id_, verdict=verdict, condition=deciding, p=_largest_p(findings, verdict))
    row["kind"] = verdict if is_tested else ONE_WAY
    row["conditions"] = "; ".join(f"{name}: {each.verdict}" for name, each in findings.items())
    row["reached"] = "; ".join(f"{verdict}: {place}" for verdict, place in reached.items())
    return row | _other(findings, deciding)


def ledger(evidence, reached, claims=CLAIMS):
    """Judge claims: what the paper says, what the evidence says, and the verdict.

    Args:
        evidence: Of `collect_evidence`.
        reached: Of `outcomes`.
        claims: {id: Claim}.

    Returns:
        DataFrame, one row a claim: id, section, claim, test, bound, paper, the Finding under the
        condition that decides (value, low, high, n, unit, verdict, condition, above, below); kind,
        the verdict or ONE_WAY; the verdict under each condition; the Finding under the first that
        says otherwise, or else the next (other_condition, other_value, …); where either verdict was
        reached; and why. p is the largest of the conditions', p_adjusted the same with the false
        discovery rate held over the whole ledger (Benjamini and Yekutieli); NaN where nothing is
        left to chance.
    """
    rows = [_row(id_, claim, evidence, reached[id_]) for id_, claim in claims.items()]
    table = pd.DataFrame(rows, columns=_COLUMNS).replace({"p": {-1.0: np.nan}})
    chance = table["p"].notna()
    adjusted = stats.false_discovery_control(table.loc[chance, "p"], method="by")
    # Claims share runs, so their tests are dependent; Benjamini and Yekutieli allow for that.
    table.loc[chance, "p_adjusted"] = adjusted
    return table


def coverages(evidence, trials=2000):
    """How often the intervals behind the ledger cover the truth, by resampling.

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
    for process_noise, tables in evidence.items():
        for statistic, ids, metric in cases:
            # Unequal tables are cut to the seeds that both have.
            n = min(len(tables["runs"][id_]) for id_ in ids)
            samples = [tables["runs"][id_][metric][:n] for id_ in ids]
            share = coverage(statistic, *samples, trials=trials)
            about = dict(statistic=statistic.__name__, runs=" ".join(ids), metric=metric)
            rows.append(about | dict(process_noise=process_noise, n=n, coverage=share))
    return pd.DataFrame(rows)
