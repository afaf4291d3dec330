"""The claims ledger as CSV, LaTeX and Markdown, and as a figure."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots import style
from rhec.workbench.studies.claims.summary import (
    BY_DERIVATION,
    DEPARTURE,
    PRINTED,
    SAME,
    WHERE,
    class_of,
)
from rhec.workbench.studies.statistics import FAILS, HOLDS, UNDECIDED, UNTESTABLE

_PARTLY = "holds as printed or with a departure"
# {kind of verdict: its colour and its sign}
LOOKS = {
    HOLDS: (style.GREEN, "✓"),
    WHERE: (style.PURPLE, "◐"),
    _PARTLY: (style.BLUE, "±"),
    FAILS: (style.VERMILLION, "×"),
    UNDECIDED: (style.ORANGE, "?"),
    UNTESTABLE: (style.GREY, "–"),
}
LABELS = {WHERE: "in some worlds", _PARTLY: "by reading", UNTESTABLE: "untestable"}
_BASES = {BY_DERIVATION: "d", SAME: "="}  # beside the sign
# Columns of the printed table; the CSV has all columns.
_PRINTED = ["id", "claim", "paper", "value", "low", "high", "n", "unit", "verdict", "basis"]
_RULES = ["id", "section", "quote", "test", "bound", "conditions", "reached", "beside"]
_RULES += ["where", "p_adjusted"]
# Horizontal places in the figure [% of its width]: sign, bound, end of intervals, paper's numbers,
# and the two ends of the scale of shares.
_SIGN = 46.0
_BOUND = 55.0
_END = 60.0
_PAPER = 67.0
_SHARE = 87.5, 99.0
_ROW_IN = 0.15  # height of a row [in]
_WIDTH_IN = 7.2  # fits the longest claim, its interval and its share of worlds
_FONT = dict(fontsize=6.5, va="center_baseline")


def kind_of(verdict):
    """The kind of a verdict, a key of LOOKS: its class, with both classes of readings as one."""
    found = class_of(verdict)
    return _PARTLY if found in (PRINTED, DEPARTURE) else found


def _number(value):
    """A number with three digits; a string unchanged; an empty string for a missing value."""
    if isinstance(value, str):
        return value
    return "" if np.isnan(value) else f"{value:.3g}"


def save_ledger(table, name="claims", folder=style.FOLDER):
    """Write the ledger as CSV (all columns), LaTeX (a longtable) and Markdown.

    Args:
        table: Table of `rhec.workbench.studies.claims.ledger.ledger`.
        name: Name of the files, without a suffix.
        folder: As in `rhec.workbench.plots.style.save`.

    Returns:
        The path of the CSV. The LaTeX needs the packages booktabs and longtable.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    metadata = style.provenance(name, None)
    csv = Path(folder) / f"{name}.csv"
    table.to_csv(csv, index=False)
    numbers = ("paper", "value", "low", "high")
    printed = table[_PRINTED].assign(**{column: table[column].map(_number) for column in numbers})
    look = dict(index=False, longtable=True, escape=True, label=f"tab:{name}")
    look["caption"] = (
        "The paper's claims, what the runs say with 95\\,\\% intervals, and the verdicts"
    )
    look["column_format"] = "lp{0.34\\linewidth}llllllp{0.14\\linewidth}"
    latex = printed.to_latex(**look)
    csv.with_suffix(".tex").write_text(style.as_comments(metadata) + latex, encoding="utf-8")
    rules = table[_RULES].assign(p_adjusted=table["p_adjusted"].map(_number))
    pages = [f"<!-- {metadata['Creator']} -->", _markdown(printed), _markdown(rules)]
    csv.with_suffix(".md").write_text("\n".join(pages), encoding="utf-8")
    return csv


def _markdown(frame):
    rows = [frame.columns, ["---"] * len(frame.columns), *frame.astype(str).to_numpy()]
    cells = [[str(entry).replace("|", "\\|") for entry in row] for row in rows]
    return "\n".join([*(f"| {' | '.join(row)} |" for row in cells), ""])


def _relative_to_bound(value, low, high, above, below, verdict):
    """(value, low, high) relative to the bound, scaled to 1, positive on the side of the claim.

    None if the claim has no side, such as a number that must be met.
    """
    if not np.isfinite(value) or (np.isinf(above) and np.isinf(below)) or above == below:
        return None
    # If all cases or none agree, the share is exact and has no interval.
    if value == above:
        return np.ones(3) * (1 if verdict == HOLDS else -1)
    bound = above if abs(value - above) <= abs(value - below) else below
    side = 1 if bound == above else -1
    places = side * (np.array([value, low, high], dtype=float) - bound)
    return places / (np.nanmax(np.abs(places)) or 1)


def _draw_sign(axes, x, y, kind, basis=""):
    """A verdict's sign, and the letter of what it rests on to its right."""
    colour, sign = LOOKS[kind]
    box = dict(boxstyle="round,pad=0.08", facecolor=colour, edgecolor="none")
    look = dict(fontsize=6.5, color="white", weight="bold", family="DejaVu Sans", bbox=box)
    axes.text(x, y, sign, ha="center", va="center", **look)
    axes.text(x + 1.6, y, _BASES.get(basis, ""), color="0.35", **_FONT)


def _draw_share(axes, place, share, low, high):
    """The share of worlds on a scale from 0 to 1, with its interval."""
    least, most = _SHARE
    axes.plot(_SHARE, [place] * 2, color="0.85", linewidth=0.5)
    at, *ends = least + (most - least) * np.array([share, low, high])
    axes.plot(ends, [place] * 2, color=style.PURPLE, linewidth=1.0, solid_capstyle="butt")
    axes.plot(at, place, "o", color=style.PURPLE, markersize=2.4)


def _draw_intervals(axes, place, row, colour):
    """Draw a line for each condition, with a filled marker for the condition in the text."""
    columns = ("value", "low", "high", "above", "below")
    decided = HOLDS if row.here.startswith(HOLDS) else row.here
    findings = [((*(getattr(row, name) for name in columns), decided), colour)]
    if row.other_condition:
        other = (getattr(row, f"other_{name}") for name in (*columns, "verdict"))
        findings.append((tuple(other), "white"))
    offsets = (-0.13, 0.17) if len(findings) > 1 else (0,)
    for offset, (finding, face) in zip(offsets, findings):
        places = _relative_to_bound(*finding)
        if places is not None:
            value, *ends = _BOUND + (_END - _BOUND) * places
            y = [place + offset] * 2
            look = dict(markersize=2.4, markeredgewidth=0.5)
            axes.plot(ends, y, color=colour, linewidth=1.0, solid_capstyle="butt")
            axes.plot(value, y[0], "o", color=colour, markerfacecolor=face, **look)


@style.styled
def verdicts(table, worlds=""):
    """Draw the ledger: verdicts, intervals relative to bounds, numbers, and shares of worlds.

    A claim holds to the right of the line and fails to the left. Each row is scaled to its farthest
    end. A claim that a number of the paper is met has no interval.

    Args:
        table: Table of `rhec.workbench.studies.claims.ledger.ledger`.
        worlds: Name of the set of worlds whose shares are drawn; none by default.
    """
    rows = len(table)
    height_in = 0.9 + _ROW_IN * rows
    figure = plt.figure(figsize=(_WIDTH_IN, height_in), layout="none")
    axes = figure.add_axes((0.003, 0.002, 0.994, 0.996))
    axes.set(xlim=(0, 100), ylim=(rows - 0.4, rows - 0.4 - height_in / _ROW_IN))
    axes.axis("off")
    axes.plot([_BOUND, _BOUND], [-0.5, rows - 0.5], color=style.BLACK, linewidth=0.6)
    section = None
    for place, row in enumerate(table.itertuples()):
        if row.section != section:
            section = row.section
            axes.axhline(place - 0.5, color="0.6", linewidth=0.4)
        _draw_row(axes, place, row)
        if worlds and not np.isnan(getattr(row, worlds)):
            ends = (getattr(row, f"{worlds}_{end}") for end in ("low", "high"))
            _draw_share(axes, place, getattr(row, worlds), *ends)
    _draw_heads(axes, table, worlds)
    return figure


def _draw_heads(axes, table, worlds):
    """The columns' heads, and the signs with the number of claims that each has."""
    bold = _FONT | dict(weight="bold")
    for x, label, align in [
        (4.0, "claim  (d: by derivation, =: the same in every world tried)", "left"),
        (_BOUND - 0.7, "fails", "right"),
        (_BOUND + 0.7, "holds", "left"),
        (_PAPER, "paper", "right"),
        (_PAPER + 1, "ours [95 %]", "left"),
    ]:
        axes.text(x, -1.2, label, ha=align, **bold)
    axes.text(_BOUND, -2.2, "each row to its own scale", ha="center", **_FONT)
    if worlds:
        axes.text(_SHARE[1] + 0.5, -2.2, f"share of {worlds} worlds", ha="right", **bold)
        for x, number in zip(_SHARE, "01"):
            axes.text(x, -1.2, number, ha="center", **_FONT)
    kinds = table["verdict"].map(kind_of)
    for x, kind in zip((1.0, 13.0, 32.0, 48.0, 68.0, 84.0), LOOKS):
        _draw_sign(axes, x, -3.8, kind)
        count = f"{LABELS.get(kind, kind)}: {(kinds == kind).sum()}"
        axes.text(x + 1.5, -3.8, count, **_FONT)


def _draw_row(axes, place, row):
    kind = kind_of(row.verdict)
    colour, _ = LOOKS[kind]
    axes.text(0, place, row.id, weight="bold", **_FONT)
    axes.text(4.0, place, row.claim, **_FONT)
    _draw_sign(axes, _SIGN, place, kind, row.basis)
    _draw_intervals(axes, place, row, colour)
    axes.text(_PAPER, place, _number(row.paper), ha="right", **_FONT)
    exact = np.isnan(row.low) or row.low == row.high
    interval = "" if exact else f" [{_number(row.low)}, {_number(row.high)}]"
    # Shares and ratios need no unit.
    has_unit = _number(row.value) and not row.unit.startswith(("share", "ratio", "-"))
    unit = f" {row.unit}" if has_unit else ""
    axes.text(_PAPER + 1, place, f"{_number(row.value)}{interval}{unit}", **_FONT)
