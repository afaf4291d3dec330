"""Tables for readers: numbers with their intervals as texts.

A table has one row a quantity and a variant, with columns of numbers: a value and the two ends of
its interval. What a notebook shows has them in one cell: "34.6 [32.3, 37.0]".
"""

import re

import pandas as pd


def with_minus(text):
    """A text whose numbers and differences have a minus; dates and words keep their hyphens."""
    return re.sub(r"(?<!\w)-(?=[\d.])|(?<=\de)-(?=\d)|(?<= )-(?= )", "−", text)


def three_digits(value):
    """A number with three significant digits, large ones to the unit; nothing for a missing one."""
    if pd.isna(value):
        return ""
    if value == 0:
        return "0"
    return with_minus(f"{value:.0f}" if abs(value) >= 99.95 else f"{value:#.3g}")


def signed(value):
    """As `three_digits`, of a change: a positive one has a plus."""
    return f"+{three_digits(value)}" if value > 0 else three_digits(value)


def interval_text(value, low, high, number=three_digits):
    """A number and its interval as people read them: "34.6 [32.3, 37.0]".

    Args:
        value: The number; nothing is said of a missing one.
        low: Lower end of its interval.
        high: Upper end. An interval without a width is left out.
        number: Function that writes a number, for example `three_digits` or `signed`.

    Returns:
        The text.
    """
    interval = f" [{number(low)}, {number(high)}]" if low < high else ""
    return number(value) + interval


def interval_texts(table, value="mean", low="low", high="high", number=three_digits):
    """A column of texts, `interval_text` of each row of a table.

    Args:
        table: DataFrame.
        value: Column of the numbers.
        low: Column of the lower ends of their intervals.
        high: Column of the upper ends.
        number: As for `interval_text`.

    Returns:
        Series with the table's index.
    """
    rows = zip(table[value], table[low], table[high])
    return pd.Series([interval_text(*row, number) for row in rows], table.index, dtype=object)


def readable(table, transposed=False):
    """A table of intervals as people read it: "34.6 [32.3, 37.0]" in each cell.

    Args:
        table: DataFrame with the columns quantity, mean, low, high, and, if it has them, paper and
            verdict. The columns before `quantity` name the variant.
        transposed: One row a variant, for tables with more variants than quantities.

    Returns:
        DataFrame of texts, one row a quantity, one column a variant, the paper's values after them.
    """
    labels = list(table.columns[: table.columns.get_loc("quantity")])
    variants = table[labels].astype(str).agg(", ".join, axis=1)
    texts = interval_texts(table)
    if "verdict" in table:
        texts += table["verdict"].map(_in_brackets)
    cells = table.assign(cell=texts, variant=variants)
    shown = cells.pivot_table("cell", "quantity", "variant", aggfunc="first", sort=False)
    if "paper" in table:
        shown = shown.join(_papers(table, labels))
    shown = shown.reindex(table["quantity"].unique()).fillna("").rename_axis(None, axis=1)
    shown = shown.rename(index=with_minus, columns=with_minus)
    return shown.T if transposed else shown


def _in_brackets(verdict):
    """A verdict behind its number; nothing for a missing one."""
    return "" if pd.isna(verdict) or verdict == "" else f" ({verdict})"


def _papers(table, labels):
    """The paper's values, a column of texts for each variant that has some; "paper" if one has."""
    reported = table[pd.to_numeric(table["paper"], errors="coerce").notna()]
    values = reported["paper"].map(lambda value: f"{float(value):g}")
    variants = reported[labels[-1]] if len(labels) else pd.Series("", reported.index)
    cells = reported.assign(value=values, variant="paper, " + variants.astype(str))
    columns = cells.pivot_table("value", "quantity", "variant", aggfunc="first", sort=False)
    return columns.set_axis(["paper"], axis=1) if columns.shape[1] == 1 else columns


def to_markdown(frame):
    """A DataFrame as a Markdown table without index."""
    rows = [list(frame), ["---"] * len(frame.columns), *frame.to_numpy()]
    # A vertical line would end the cell.
    cells = [[with_minus(str(cell)).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)
