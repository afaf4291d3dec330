"""The evidence behind the claims, made in several looks.

Few fields decide most claims, whose intervals are far from the bounds. A look before the last asks
for 99.8 % confidence, and only what it leaves open is driven on more fields. The last look asks for
95 %. That is the group-sequential design of Haybittle (British Journal of Radiology 44, 1971) and
Peto et al. (British Journal of Cancer 34, 1976). With k looks a verdict is wrong with a probability
of at most (k - 1) 0.2 % + 5 %. An experiment is made once, so it has one look, at 95 %.
"""

import itertools

import numpy as np
import pandas as pd

from notebooks.claims import experiments, run_sets
from notebooks.studies.statistics import CONFIDENCE, EARLY_CONFIDENCE, HOLDS, UNDECIDED

_SETS = {"runs": run_sets.RUNS, "logs": run_sets.LOGS}


def tables_of(conditions):
    """The tables (process noise, kind, id) that Conditions read, each once."""
    return list(dict.fromkeys(table for condition in conditions for table in condition.tables))


def driven_tables_of(conditions):
    """Those of `tables_of` that have one row a field; an experiment has its own cases."""
    return [table for table in tables_of(conditions) if table[1] in _SETS]


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


def collect(claims, fields, folder=None):
    """Make the evidence in several looks, and judge by it.

    The last look is for claims that nothing decides before. Where one condition of a claim holds,
    others that are still open stay undecided.

    Args:
        claims: {id: Claim}.
        fields: How many of each look, rising; a look at n fields has the seeds 0 to n - 1.
        folder: Where the campaign of runs keeps its rows.

    Returns:
        evidence: {(process noise, kind, id): DataFrame}, all that was made.
        findings: {id: {condition: Finding}}, by the look that decided.
        beside: {id: {what: Finding}} of the numbers that decide nothing, by all that was made.
        looks: {id: {condition: confidence of the look that decided}}.

    Raises:
        ValueError: If the numbers of fields do not rise.
    """
    if not fields or list(fields) != sorted(set(fields)):
        raise ValueError(f"fields was {fields}; it should have a number for each look, rising")
    conditions = {
        (id_, name): judge
        for id_, claim in claims.items()
        for name, judge in claim.rule.by_condition.items()
    }
    numbers = [number for claim in claims.values() for number in claim.beside.values()]
    every = tables_of([*conditions.values(), *numbers])
    driven = driven_tables_of([*conditions.values(), *numbers])
    made_once = [table for table in every if table not in driven]
    evidence = {}
    findings = {id_: {} for id_ in claims}
    looks = {id_: {} for id_ in claims}
    left = {key: judge for key, judge in conditions.items() if driven_tables_of([judge])}
    for place, (before, n) in enumerate(itertools.pairwise([0, *fields])):
        for table, rows in make(driven, range(before, n), folder).items():
            parts = [evidence[table], rows] if before else [rows]
            evidence[table] = pd.concat(parts, ignore_index=True)
        confidence = CONFIDENCE if n == fields[-1] else EARLY_CONFIDENCE
        for (id_, name), judge in left.items():
            finding = judge(evidence, confidence)
            # What the looks before have spent of the error rate is part of p; NaN stays NaN.
            spent = finding.p + place * (1 - EARLY_CONFIDENCE)
            findings[id_][name] = finding._replace(p=float(np.minimum(spent, 1.0)))
            looks[id_][name] = confidence
        left = {
            (id_, name): judge
            for (id_, name), judge in left.items()
            if _is_open(findings[id_][name])
        }
        is_last_next = place == len(fields) - 2
        if is_last_next:
            left = _of_undecided_claims(left, findings)
        driven = driven_tables_of(left.values())
    # Experiments come last, because they use loops that the campaigns have compiled.
    evidence |= make(made_once, range(fields[-1]))
    for (id_, name), judge in conditions.items():
        if name not in findings[id_]:
            findings[id_][name] = judge(evidence, CONFIDENCE)
            looks[id_][name] = CONFIDENCE
    beside = {
        id_: {what: number(evidence) for what, number in claim.beside.items()}
        for id_, claim in claims.items()
    }
    return evidence, findings, beside, looks


def _is_open(finding):
    """Whether an early look leaves a condition open.

    It does where the verdict is undecided, and where all fields that were driven are equal: their
    interval has no length, yet the next field may differ.
    """
    return finding.verdict == UNDECIDED or finding.low == finding.high


def _of_undecided_claims(left, findings):
    """The open conditions in `left`, without undecided ones of a claim that holds under another."""
    settled = {
        id_
        for id_, found in findings.items()
        for name, finding in found.items()
        if finding.verdict == HOLDS and (id_, name) not in left
    }
    return {
        (id_, name): judge
        for (id_, name), judge in left.items()
        if id_ not in settled or findings[id_][name].verdict != UNDECIDED
    }
