"""The evidence behind the claims, made in two looks (`notebooks.studies.two_looks`)."""

from functools import partial

from notebooks.claims import experiments, run_sets
from notebooks.studies import two_looks
from notebooks.studies.statistics import CONFIDENCE, UNDECIDED

__all__ = ["collect", "findings_of", "make", "tables_of"]

_SETS = {"runs": run_sets.RUNS, "logs": run_sets.LOGS}


def tables_of(conditions):
    """The tables (process noise, kind, id) that Conditions read, each once."""
    return list(dict.fromkeys(table for condition in conditions for table in condition.tables))


def make(tables, seeds, folder=None):
    """Make tables of evidence in the default world.

    Args:
        tables: (process noise, kind, id) of each.
        seeds: Range of the fields. Experiments take a part of as many, from seed 0 on.
        folder: Where the campaign of runs keeps its rows.

    Returns:
        {(process noise, kind, id): DataFrame}.
    """
    scenarios = {
        kind: {
            table: run_sets.scenarios(fields[table[2]], table[0], seeds)
            for table in tables
            if table[1] == kind
        }
        for kind, fields in _SETS.items()
    }
    evidence = run_sets.measure(scenarios, folder)
    named = {(noise, name) for noise, kind, name in tables if kind == "experiments"}
    made = experiments.make(sorted(named), len(seeds))
    return evidence | {(noise, "experiments", name): made[noise, name] for noise, name in made}


def findings_of(claims, evidence, confidence):
    """{id: {condition: Finding}} of claims at one confidence."""
    return {
        id_: {name: judge(evidence, confidence) for name, judge in claim.rule.by_condition.items()}
        for id_, claim in claims.items()
    }


def collect(claims, first, seeds, folder=None):
    """Make the evidence in two looks, and judge by it.

    Args:
        claims: {id: Claim}.
        first: Fields of the first look.
        seeds: Fields of the second. With no more than in the first there is one look, at 95 %.
        folder: Where the campaign of runs keeps its rows.

    Returns:
        evidence: {(process noise, kind, id): DataFrame}, the larger tables where there are two.
        findings: {id: {condition: Finding}}.
        beside: {id: {what: Finding}} of the numbers that decide nothing.
        looks: {id: {condition: confidence of the look that decided}}.
    """
    driven, fixed = _driven_and_fixed(claims)
    exact = make(fixed, range(seeds))

    def undecided(tables, confidence):
        found = findings_of(claims, tables | exact, confidence)
        return tables_of(claims[id_].rule.by_condition[name] for id_, name in _open(found))

    driving = partial(make, folder=folder)
    drives = two_looks.drive(driven, first, seeds, driving, undecided)
    evidence = drives.first | exact
    findings = findings_of(claims, evidence, drives.confidence)
    looks = {id_: dict.fromkeys(found, drives.confidence) for id_, found in findings.items()}
    beside = {
        id_: {what: number(evidence) for what, number in claim.beside.items()}
        for id_, claim in claims.items()
    }
    evidence = drives.tables | exact
    if drives.confidence != CONFIDENCE:
        for id_, name in _open(findings):
            second = claims[id_].rule.by_condition[name](evidence)
            findings[id_][name] = two_looks.with_first_look(second)
            looks[id_][name] = CONFIDENCE
    return evidence, findings, beside, looks


def _open(findings):
    """(id, condition) of each Finding that is undecided."""
    return [
        (id_, name)
        for id_, found in findings.items()
        for name, finding in found.items()
        if finding.verdict == UNDECIDED
    ]


def _driven_and_fixed(claims):
    """The tables of claims that have two looks, and those of experiments, which have one."""
    every = [
        judge
        for claim in claims.values()
        for judge in (*claim.rule.by_condition.values(), *claim.beside.values())
    ]
    tables = tables_of(every)
    fixed = [table for table in tables if table[1] == "experiments"]
    return [table for table in tables if table not in fixed], fixed
