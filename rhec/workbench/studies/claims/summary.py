"""The ledger's verdicts in numbers: one count for README, report and pages."""

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
    "DEPARTURE",
    "ONE_WAY",
    "PRINTED",
    "depending",
    "failing",
    "lost",
    "readable_ledger",
    "survivors",
    "verdict_counts",
]

ONE_WAY = "only one outcome found, so not tested"
PRINTED = f"{HOLDS} only {AS_PRINTED}"
DEPARTURE = f"{HOLDS}, but not as printed (for example only with W calibrated)"
_FALSE_DISCOVERY_RATE = 0.05  # over the whole ledger


def _class_of(kind):
    """The class of an entry of the ledger's column `kind`; conditions are left out.

    PRINTED: the claim holds as printed, but not under every departure. DEPARTURE: it does not hold
    as printed, or is undecided, and holds with a departure.
    """
    if kind.endswith(AS_PRINTED):
        return PRINTED
    return DEPARTURE if kind.startswith(f"{HOLDS} ") else kind


def verdict_counts(table):
    """Count the claims by kind of verdict.

    Only claims whose rule was seen to come out both ways count as tested, so the column `kind`
    decides and not `verdict`: a claim that always comes out one way is ONE_WAY.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        Series of counts, named "claims", by kind: holds, PRINTED, DEPARTURE, does not hold,
        undecided, ONE_WAY, cannot be tested here. Kinds without a claim have 0.
    """
    order = [HOLDS, PRINTED, DEPARTURE, FAILS, UNDECIDED, ONE_WAY, UNTESTABLE]
    kinds = pd.Categorical(table["kind"].map(_class_of), order)
    return pd.Series(kinds).value_counts(sort=False).rename("claims").rename_axis("verdict")


def survivors(table):
    """The verdicts that remain when the false discovery rate of the whole ledger is held at 5 %.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        How many verdicts rest on an interval, and the ids of those that do not remain.
    """
    tested = ~table["kind"].isin([UNDECIDED, ONE_WAY, UNTESTABLE])
    at_risk = table[table["p"].notna() & tested]
    lost = at_risk["p_adjusted"] >= _FALSE_DISCOVERY_RATE
    return len(at_risk), list(at_risk.loc[lost, "id"])


# Parts of the ledger for readers

_ALL = ["section", "claim", "test", "bound", "paper", "value", "n", "unit", "verdict"]
_ALL += ["conditions", "reached", "p_adjusted", "why"]


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
    columns = ["claim", "test", "paper", "value", "n", "reached", "why"]
    return readable_ledger(rows, columns)


def depending(table):
    """The claims that hold under some conditions only."""
    rows = table[table["kind"].str.startswith(f"{HOLDS} ")]
    return readable_ledger(rows, ["claim", "test", "value", "verdict", "conditions"])
