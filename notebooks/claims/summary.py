"""The ledger for readers: its verdicts in numbers, and its tables."""

from pathlib import Path

import pandas as pd

from notebooks.studies.statistics import (
    AS_PRINTED,
    FAILS,
    HOLDS,
    LOST,
    LOST_ITSELF,
    MET,
    NOT_MET,
    POSSIBLE,
    UNDECIDED,
    UNTESTABLE,
)
from notebooks.studies.tables import interval_texts

PRINTED = f"{HOLDS} {AS_PRINTED}, not with every departure"
DEPARTURE = f"{HOLDS} with a departure, not {AS_PRINTED}"
# A condition of a claim about a number has words of its own.
_OF_NUMBERS = {MET: HOLDS, NOT_MET: FAILS, LOST_ITSELF: LOST}
# The verdicts of commit 67f3b9c4, when the path turned to the left alone, W by likelihood had the
# paper's V, and README and ledger had rules of their own: columns of its data/results/claims.csv.
_BEFORE = Path(__file__).with_name("before.csv")
_OLD_RULE = "W by likelihood"
_NEW_RULE = "W by prediction"
_SAME_RULE = "The rule is as it was; the path turns to both sides now, and W is tuned again."
_FALSE_DISCOVERY_RATE = 0.05  # over the whole ledger


def class_of(verdict):
    """The class of a verdict; its conditions are left out.

    DEPARTURE: with the text as printed the claim does not hold, is undecided, or has a lost rival.
    """
    if verdict.endswith(AS_PRINTED):
        return PRINTED
    if verdict.startswith(f"{HOLDS} "):
        return DEPARTURE
    return _OF_NUMBERS.get(verdict, verdict)


def verdict_counts(table):
    """Count the claims by class of verdict.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.

    Returns:
        DataFrame of counts, one row a class (holds, PRINTED, DEPARTURE, possible, does not hold,
        its rival is lost, undecided, cannot be tested here), with columns "claims" and, of those,
        "by derivation". Classes without a claim have 0.
    """
    order = [HOLDS, PRINTED, DEPARTURE, POSSIBLE, FAILS, LOST, UNDECIDED, UNTESTABLE]
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


def readable_ledger(table, columns=("claim", "verdict", "value", "unit", "posterior")):
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


def changes(table, claims):
    """The claims whose verdict is another one than in `before.csv`, and what changed it.

    Args:
        table: The ledger, of `ledger.ledger` or from claims.csv.
        claims: {id: Claim}, which say what was mended of their rules.

    Returns:
        DataFrame of texts: id, the paper's sentence, verdict before and now, and the reason, which
        is the change of the rule, if there is one, and the conditions that say otherwise.
    """
    before, now = (
        part[["id", "claim", "verdict", "conditions"]].fillna("").set_index("id")
        for part in (pd.read_csv(_BEFORE), table)
    )
    ids = [*now.index, *before.index.difference(now.index)]
    # A claim that one of them does not have has empty texts there.
    before, now = (part.reindex(ids, fill_value="") for part in (before, now))
    rows = []
    for id_, old, new in zip(ids, before.itertuples(), now.itertuples()):
        if old.verdict.replace(_OLD_RULE, _NEW_RULE) == new.verdict:
            continue
        row = {"id": id_, "the paper": new.claim or old.claim}
        row |= {"before": old.verdict or "–", "now": new.verdict or "–"}
        rows.append(row | {"reason": _reason(id_, old, new, claims)})
    return pd.DataFrame(rows)


def _reason(id_, old, new, claims):
    """Why a verdict changed: the change of the rule, then the conditions that say otherwise.

    Of a claim that is no more: what the claim that mentions it says of its own rule.
    """
    if not new.verdict:
        heirs = (f"{heir}: {of.mended}" for heir, of in claims.items() if id_ in of.mended.split())
        return "; ".join(heirs) or "It is left out."
    rule = claims[id_].mended or _SAME_RULE
    if not old.verdict:
        return rule
    before, now = by_condition(old.conditions), by_condition(new.conditions)
    said = [
        f"{condition or 'in all cases'}: {before[condition]} → {verdict}"
        for condition, verdict in now.items()
        if before.get(condition, verdict) != verdict
    ]
    said += [
        f"{condition}, which is new: {verdict}"
        for condition, verdict in now.items()
        if condition not in before
    ]
    return f"{rule} {'; '.join(said)}." if said else rule


def by_condition(conditions):
    """{condition: verdict} of "as printed: holds; W by likelihood: holds", in today's words."""
    parts = (part.rpartition(": ") for part in conditions.split("; ") if part)
    return {name.replace(_OLD_RULE, _NEW_RULE): verdict for name, _, verdict in parts}
