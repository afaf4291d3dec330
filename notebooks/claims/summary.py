"""The ledger for readers: its verdicts in numbers, and its tables."""

import pandas as pd

from notebooks.studies.statistics import AS_PRINTED, FAILS, HOLDS, LOST, UNDECIDED, UNTESTABLE
from notebooks.studies.tables import interval_texts

PRINTED = f"{HOLDS} {AS_PRINTED}, not with every departure"
DEPARTURE = f"{HOLDS} with a departure, not {AS_PRINTED}"
_FALSE_DISCOVERY_RATE = 0.05  # over the whole ledger


def class_of(verdict):
    """The class of a verdict; its conditions are left out.

    DEPARTURE: with the text as printed the claim does not hold, is undecided, or has a lost rival.
    """
    if verdict.endswith(AS_PRINTED):
        return PRINTED
    return DEPARTURE if verdict.startswith(f"{HOLDS} ") else verdict


def verdict_counts(table):
    """Count the claims by class of verdict.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        DataFrame of counts, one row a class (holds, PRINTED, DEPARTURE, does not hold, its rival is
        lost, undecided, cannot be tested here), with columns "claims" and, of those, "by
        derivation". Classes without a claim have 0.
    """
    order = [HOLDS, PRINTED, DEPARTURE, FAILS, LOST, UNDECIDED, UNTESTABLE]
    by_class = table["derived"].groupby(table["verdict"].map(class_of))
    counts = pd.DataFrame({"claims": by_class.size(), "by derivation": by_class.sum()})
    return counts.reindex(order, fill_value=0).astype(int).rename_axis("verdict")


def survivors(table):
    """The verdicts that remain when the false discovery rate of the whole ledger is held at 5 %.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        How many verdicts rest on an interval, and the ids of those that do not remain.
    """
    decided = ~table["verdict"].isin([UNDECIDED, UNTESTABLE])
    at_risk = table[table["p"].notna() & decided & ~table["derived"]]
    lost = at_risk["p_adjusted"] >= _FALSE_DISCOVERY_RATE
    return len(at_risk), list(at_risk.loc[lost, "id"])


# Parts of the ledger for readers


def left_aligned(table):
    """A table whose texts and heads begin at the left of their cells, as a pandas Styler."""
    heads = {"selector": "th", "props": "text-align: left"}
    shown = table.style.format(precision=4).set_properties(**{"text-align": "left"})
    return shown.set_table_styles([heads])


def readable_ledger(table, columns=("claim", "verdict", "value", "unit")):
    """Columns of the ledger, with values and shares of worlds as "34.6 [32.3, 37.0]", by id."""
    shown = table.assign(
        value=interval_texts(table, "value"),
        posterior=interval_texts(table, "posterior", "posterior_low", "posterior_high"),
        p_adjusted=table["p_adjusted"].round(4),
    )
    return shown.set_index("id")[list(columns)].fillna("")


def lost(table):
    """The claims whose verdict does not remain, see `survivors`."""
    _, ids = survivors(table)
    rows = table[table["id"].isin(ids)]
    return readable_ledger(rows, ["claim", "value", "verdict", "p_adjusted"])


def failing(table):
    """The claims that hold under no condition, with the rule and the reason."""
    rows = table[table["verdict"] == FAILS]
    return readable_ledger(rows, ["claim", "test", "paper", "value", "n", "beside", "why"])


def depending(table):
    """The claims that hold under some conditions only."""
    rows = table[table["verdict"].map(class_of).isin([PRINTED, DEPARTURE])]
    return readable_ledger(rows, ["claim", "test", "value", "verdict", "conditions"])


def in_worlds(table):
    """The claims about driving with the share of the posterior's worlds in which each holds."""
    rows = table[table["posterior"].notna()]
    return readable_ledger(rows, ["claim", "verdict", "posterior"])
