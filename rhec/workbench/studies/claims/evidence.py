"""The evidence behind the claims, made in two looks.

A look at few fields decides most claims: their intervals are far from the bounds. It asks for
99.9 % confidence, and only what is still undecided is driven on all fields, where 95 % suffices.
That is the group-sequential design of Haybittle (British Journal of Radiology 44, 1971) and Peto
et al. (British Journal of Cancer 34, 1976). A verdict is wrong with a probability of at most
0.1 % at the first look and 5 % at the second, 5.1 % in all.
"""

import numpy as np
import pandas as pd

from rhec.workbench.studies.claims import experiments, run_sets
from rhec.workbench.studies.statistics import CONFIDENCE, FIRST_CONFIDENCE, UNDECIDED

__all__ = ["ERROR_RATE", "FIRST_CONFIDENCE", "collect", "findings_of", "make", "tables_of"]

ERROR_RATE = (1 - FIRST_CONFIDENCE) + (1 - CONFIDENCE)  # of a verdict over both looks, at most
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
    has_two = first < seeds
    evidence = make(driven, range(min(first, seeds)), folder) | make(fixed, range(seeds))
    confidence = FIRST_CONFIDENCE if has_two else CONFIDENCE
    findings = findings_of(claims, evidence, confidence)
    looks = {id_: dict.fromkeys(found, confidence) for id_, found in findings.items()}
    beside = {
        id_: {what: number(evidence) for what, number in claim.beside.items()}
        for id_, claim in claims.items()
    }
    again = {
        (id_, name): claims[id_].rule.by_condition[name]
        for id_, found in findings.items()
        for name, finding in found.items()
        if has_two and finding.verdict == UNDECIDED
    }
    longer = [table for table in tables_of(again.values()) if table in driven]
    for table, more in make(longer, range(first, seeds), folder).items():
        evidence[table] = pd.concat([evidence[table], more], ignore_index=True)
    for (id_, name), judge in again.items():
        finding = judge(evidence)
        # What the first look spent of the error rate is part of the second's p.
        spent = finding.p + 1 - FIRST_CONFIDENCE
        findings[id_][name] = finding._replace(p=float(np.minimum(spent, 1.0)))  # NaN stays NaN
        looks[id_][name] = CONFIDENCE
    return evidence, findings, beside, looks


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
