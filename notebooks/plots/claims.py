"""The claims ledger as a figure."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from notebooks.claims.summary import DEPARTURE, PRINTED, class_of
from notebooks.studies.statistics import FAILS, HOLDS, LOST, UNDECIDED, UNTESTABLE
from notebooks.studies.tables import interval_text
from rhec import style

_PARTLY = "holds as printed or with a departure"
# {kind of verdict: its colour and its sign}
LOOKS = {
    HOLDS: (style.GREEN, "✓"),
    _PARTLY: (style.BLUE, "±"),
    FAILS: (style.VERMILLION, "×"),
    LOST: (style.PURPLE, "∅"),
    UNDECIDED: (style.ORANGE, "?"),
    UNTESTABLE: (style.GREY, "–"),
}
LABELS = {_PARTLY: "by reading", LOST: "rival lost", UNTESTABLE: "untestable"}
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


def _paper_text(paper):
    """The paper's number as it is printed, or its word; nothing where it has neither."""
    if isinstance(paper, str):
        return paper
    return "" if pd.isna(paper) else f"{paper:g}"


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


def _draw_sign(axes, x, y, kind, derived=False):
    """A verdict's sign, with a d to its right where it follows by derivation."""
    colour, sign = LOOKS[kind]
    box = dict(boxstyle="round,pad=0.08", facecolor=colour, edgecolor="none")
    look = dict(fontsize=6.5, color="white", weight="bold", family="DejaVu Sans", bbox=box)
    axes.text(x, y, sign, ha="center", va="center", **look)
    axes.text(x + 1.6, y, "d" * derived, color="0.35", **_FONT)


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
    decided = HOLDS if row.verdict.startswith(HOLDS) else row.verdict
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
def verdicts(table):
    """Draw the ledger: verdicts, intervals relative to bounds, numbers, and shares of worlds.

    A claim holds to the right of the line and fails to the left. Each row is scaled to its farthest
    end. A claim that a number of the paper is met has no interval.

    Args:
        table: Table of `notebooks.claims.ledger.ledger`.
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
        if not np.isnan(row.posterior):
            _draw_share(axes, place, row.posterior, row.posterior_low, row.posterior_high)
    _draw_heads(axes, table)
    return figure


def _draw_heads(axes, table):
    """The columns' heads, and the signs with the number of claims that each has."""
    bold = _FONT | dict(weight="bold")
    for x, label, align in [
        (4.0, "claim  (d: by derivation)", "left"),
        (_BOUND - 0.7, "fails", "right"),
        (_BOUND + 0.7, "holds", "left"),
        (_PAPER, "paper", "right"),
        (_PAPER + 1, "ours [95 %]", "left"),
    ]:
        axes.text(x, -1.2, label, ha=align, **bold)
    axes.text(_BOUND, -2.2, "each row to its own scale", ha="center", **_FONT)
    axes.text(_SHARE[1] + 0.5, -2.2, "share of posterior worlds", ha="right", **bold)
    for x, number in zip(_SHARE, "01"):
        axes.text(x, -1.2, number, ha="center", **_FONT)
    kinds = table["verdict"].map(kind_of)
    for x, kind in zip((1.0, 14.0, 32.0, 51.0, 67.0, 81.0), LOOKS):
        _draw_sign(axes, x, -3.8, kind)
        count = f"{LABELS.get(kind, kind)}: {(kinds == kind).sum()}"
        axes.text(x + 1.5, -3.8, count, **_FONT)


def _draw_row(axes, place, row):
    kind = kind_of(row.verdict)
    colour, _ = LOOKS[kind]
    axes.text(0, place, row.id, weight="bold", **_FONT)
    axes.text(4.0, place, row.claim, **_FONT)
    _draw_sign(axes, _SIGN, place, kind, row.derived)
    _draw_intervals(axes, place, row, colour)
    axes.text(_PAPER, place, _paper_text(row.paper), ha="right", **_FONT)
    number = interval_text(row.value, row.low, row.high)
    # Shares and ratios need no unit.
    has_unit = number and not row.unit.startswith(("share", "ratio", "-"))
    axes.text(_PAPER + 1, place, f"{number} {row.unit}" if has_unit else number, **_FONT)
