"""The count of the ledger's verdicts, which README, the report and the documentation show."""

__all__ = ["verdict_counts"]

_LABELS = {
    "holds": "holds",
    "holds with": "holds, but not as printed (for example only with W calibrated)",
    "holds as printed": "holds only as printed",
    "does not hold": "does not hold",
    "only one outcome found, so not tested": "not tested, because only one outcome was found",
    "cannot be tested here": "cannot be tested here",
}


def verdict_counts(table):
    """Count the verdicts of a ledger.

    Args:
        table: the ledger as a DataFrame, one row a claim, with the column `kind`.

    Returns:
        A Series of counts by label, in the order of `_LABELS`, and others after them.
    """
    kinds = table["kind"].str.replace(r"^holds (only )?with .*", "holds with", regex=True)
    kinds = kinds.str.replace("only as printed", "as printed")
    labels = kinds.map(_LABELS).fillna(kinds)
    counts = labels.value_counts()
    order = [label for label in _LABELS.values() if label in counts]
    others = [label for label in counts.index if label not in order]
    return counts.reindex([*order, *others])
