"""The ledger's verdicts in numbers and in words: one count for README, report and pages."""

from pathlib import Path

import pandas as pd

from rhec.workbench.studies.statistics import (
    AS_PRINTED,
    FAILS,
    HOLDS,
    UNDECIDED,
    UNTESTABLE,
    interval_text,
)

__all__ = [
    "BASES",
    "BY_DERIVATION",
    "DEPARTURE",
    "PRINTED",
    "SAME",
    "TESTED",
    "WHERE",
    "before",
    "by_world",
    "changes",
    "class_of",
    "depending",
    "failing",
    "lost",
    "readable_ledger",
    "survivors",
    "verdict_counts",
]

BY_DERIVATION = "by derivation"
TESTED = "tested"
SAME = "the same in every world tried"
BASES = (BY_DERIVATION, TESTED, SAME)
PRINTED = f"{HOLDS} only {AS_PRINTED}"
DEPARTURE = f"{HOLDS}, but not as printed (for example only with W calibrated)"
WHERE = f"{HOLDS} in some worlds, and the ledger says in which"
_FALSE_DISCOVERY_RATE = 0.05  # over the whole ledger
_BEFORE = Path(__file__).resolve().parents[4] / "data/claims_before.csv"


def class_of(verdict):
    """The class of a verdict; its conditions are left out.

    PRINTED: the claim holds as printed, but not under every departure. DEPARTURE: it does not hold
    as printed, or is undecided, and holds with a departure. WHERE: a field of the world decides.
    """
    if verdict.startswith(f"{HOLDS} where"):
        return WHERE
    if verdict.endswith(AS_PRINTED):
        return PRINTED
    return DEPARTURE if verdict.startswith(f"{HOLDS} ") else verdict


def verdict_counts(table):
    """Count the claims by class of verdict and by what the verdict rests on.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        DataFrame of counts: one row a class (holds, WHERE, PRINTED, DEPARTURE, does not hold,
        undecided, cannot be tested here), one column a label of BASES, and "claims", their sum
        with those that cannot be tested. Classes without a claim have 0.
    """
    order = [HOLDS, WHERE, PRINTED, DEPARTURE, FAILS, UNDECIDED, UNTESTABLE]
    classes = table["verdict"].map(class_of)
    counts = pd.crosstab(classes, table["basis"].fillna("")).reindex(order, fill_value=0)
    counts = counts.reindex(columns=[*BASES, ""], fill_value=0)
    counts = counts.assign(claims=counts.sum(axis=1))[[*BASES, "claims"]]
    return counts.rename_axis(index="verdict", columns=None)


def survivors(table):
    """The verdicts that remain when the false discovery rate of the whole ledger is held at 5 %.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        How many verdicts rest on an interval, and the ids of those that do not remain.
    """
    decided = ~table["verdict"].isin([UNDECIDED, UNTESTABLE])
    by_chance = table["basis"].isin([TESTED, SAME])
    at_risk = table[table["p"].notna() & decided & by_chance]
    lost = at_risk["p_adjusted"] >= _FALSE_DISCOVERY_RATE
    return len(at_risk), list(at_risk.loc[lost, "id"])


# Parts of the ledger for readers

_ALL = ["section", "claim", "quote", "test", "bound", "paper", "value", "n", "unit", "verdict"]
_ALL += ["basis", "conditions", "reached", "beside", "p_adjusted", "why"]


def readable_ledger(table, columns=_ALL):
    """Columns of the ledger for readers, with values as "34.6 [32.3, 37.0]".

    Args:
        table: The ledger, or some of its rows.
        columns: Which.

    Returns:
        DataFrame with the claims' ids as its index.
    """
    values = zip(table["value"], table["low"], table["high"])
    texts = [interval_text(*numbers) for numbers in values]
    shown = table.assign(value=texts, p_adjusted=table["p_adjusted"].round(4))
    return shown.set_index("id")[list(columns)].fillna("")


def lost(table):
    """The claims whose verdict does not remain, see `survivors`."""
    _, ids = survivors(table)
    rows = table[table["id"].isin(ids)]
    return readable_ledger(rows, ["claim", "value", "verdict", "p_adjusted"])


def failing(table):
    """The claims that hold under no condition, with the rule and the reason."""
    rows = table[table["verdict"] == FAILS]
    columns = ["claim", "test", "paper", "value", "n", "basis", "reached", "beside", "why"]
    return readable_ledger(rows, columns)


def depending(table):
    """The claims that hold under some conditions only."""
    rows = table[table["verdict"].map(class_of).isin([PRINTED, DEPARTURE])]
    return readable_ledger(rows, ["claim", "test", "value", "verdict", "conditions"])


def by_world(table, sets):
    """The claims about driving with the share of worlds in which each holds.

    Args:
        table: The ledger.
        sets: Names of the sets of worlds.

    Returns:
        DataFrame of texts, one row a claim that was judged in worlds.
    """
    shown = table.set_index("id")
    shares = {
        f"share of {name} worlds": [
            interval_text(row[name], row[f"{name}_low"], row[f"{name}_high"])
            for _, row in shown.iterrows()
        ]
        for name in sets
    }
    accuracy = shown["where_accuracy"].map(lambda share: "" if pd.isna(share) else f"{share:.2f}")
    frame = shown[["claim", "verdict"]].assign(**shares, where=shown["where"], predicts=accuracy)
    judged = shown[list(sets)].notna().any(axis=1)
    return frame[judged].fillna("")


def before():
    """The previous ledger's verdicts with the reason where a rule was changed, by claim's id."""
    return pd.read_csv(_BEFORE, keep_default_na=False)


def changes(table, before):
    """The claims with another verdict than in the previous ledger.

    Args:
        table: The ledger.
        before: Of `before`.

    Returns:
        DataFrame: id, before, now, reason. A verdict that changed without a change of its rule
        changed with the worlds, reason "world".
    """
    old = before.set_index("id")
    new = table.set_index("id")
    both = new[["verdict"]].join(old, how="outer")
    both = both.reindex([*dict.fromkeys([*new.index, *old.index])]).rename_axis("id")
    both[["before", "verdict"]] = both[["before", "verdict"]].fillna("–")
    rows = both[both["before"] != both["verdict"]].reset_index()
    rows["reason"] = rows["reason"].fillna("").replace("", "world")
    return rows[["id", "before", "verdict", "reason"]].rename(columns={"verdict": "now"})
