"""The claims ledger as files and as one picture: each claim's numbers beside its bound, and its
verdict by colour and by sign.
"""

import matplotlib.pyplot as plt
import numpy as np

from rhec.plots.style import (
    BLACK,
    BLUE,
    DOUBLE_IN,
    FOLDER,
    GREEN,
    GREY,
    ORANGE,
    VERMILLION,
    _in,
    provenance,
    styled,
)
from rhec.studies.statistics import FAILS, HOLDS, UNDECIDED, UNTESTABLE

LOOKS = {
    HOLDS: (GREEN, "✓"),
    "one reading": (BLUE, "±"),
    FAILS: (VERMILLION, "×"),
    UNDECIDED: (ORANGE, "?"),
    UNTESTABLE: (GREY, "–"),
}
MEANINGS = {"one reading": "holds under one reading only", UNTESTABLE: "cannot be tested here"}
SHOWN = [
    "id",
    "claim",
    "paper",
    "value",
    "low",
    "high",
    "n",
    "unit",
    "verdict",
]  # in print; the CSV has everything


def _kind(verdict):
    return "one reading" if verdict.startswith(f"{HOLDS} under") else verdict


def number(value):
    """A number in three digits, words as they are, nothing for what is missing."""
    if isinstance(value, str):
        return value
    return "" if np.isnan(value) else f"{value:.3g}"


def _in_words(table):
    return table[SHOWN].assign(
        **{column: table[column].map(number) for column in ("paper", "value", "low", "high")}
    )


def save_ledger(table, name="claims", folder=FOLDER, notebook=None):
    """Write the ledger to folder/name.csv (all columns), name.tex (a longtable; packages booktabs,
    longtable) and name.md; returns the CSV's path.
    """
    about = provenance(name, None, notebook)
    csv, words = _in(folder, f"{name}.csv"), _in_words(table)
    table.to_csv(csv, index=False)
    caption = "The paper's claims, what the runs say with 95\\,\\% intervals, and the verdicts"
    latex = words.to_latex(
        index=False,
        escape=True,
        longtable=True,
        caption=caption,
        label=f"tab:{name}",
        column_format="lp{0.34\\linewidth}llllllp{0.14\\linewidth}",
    )
    csv.with_suffix(".tex").write_text(
        "".join(f"% {key}: {value}\n" for key, value in about.items()) + latex, encoding="utf-8"
    )
    rows = [words.columns, ["---"] * len(words.columns), *words.astype(str).to_numpy()]
    lines = [
        "| " + " | ".join(str(entry).replace("|", "\\|") for entry in row) + " |" for row in rows
    ]
    csv.with_suffix(".md").write_text(
        "\n".join([f"<!-- {about['Creator']} -->", *lines, ""]), encoding="utf-8"
    )
    return csv


def _against_the_bound(ours, low, high, above, below, verdict):
    """(ours, low, high) relative to the bound, to the right where the claim wants them, so that the
    farthest end is at 1; None without a bound.
    """
    if np.isnan(ours) or (np.isinf(above) and np.isinf(below)):
        return None
    if ours == above:  # all cases, or none: exact, and decided whatever the interval
        return np.ones(3) * (1 if verdict == HOLDS else -1)
    if (
        above == below
        # a reported number: its own place is the bound; an interval without it lies left, on whichever
        # side it was
    ):
        bound, side = above, 1 if verdict == HOLDS or ours < above else -1
    else:
        bound = above if abs(ours - above) <= abs(ours - below) else below
        side = 1 if bound == above else -1
    places = side * (np.array([ours, low, high], dtype=float) - bound)
    return places / (np.nanmax(np.abs(places)) or 1)


SIGN, LINE, RIGHT, PAPER = (
    44.5,
    54.5,
    62.0,
    72.0,
    # across the figure, in hundredths: the verdict's sign, the bound, the end of the intervals' panel
)


def _sign(axes, x, y, kind):
    colour, sign = LOOKS[kind]
    axes.text(
        x,
        y,
        sign,
        fontsize=6.5,
        ha="center",
        va="center",
        color="white",
        weight="bold",
        family="DejaVu Sans",
        bbox=dict(boxstyle="round,pad=0.08", facecolor=colour, edgecolor="none"),
    )


def _intervals(axes, place, row, colour):
    """One line a reading: filled where the numbers beside it are its own."""
    own = HOLDS if row.verdict.startswith(HOLDS) else row.verdict
    readings = [((row.value, row.low, row.high, row.above, row.below, own), colour)]
    if row.other_condition:
        readings.append(
            (
                (
                    row.other_value,
                    row.other_low,
                    row.other_high,
                    row.other_above,
                    row.other_below,
                    row.other_verdict,
                ),
                "white",
            )
        )
    for offset, (numbers, face) in zip((-0.13, 0.17) if len(readings) > 1 else (0,), readings):
        places = _against_the_bound(*numbers)
        if places is not None:
            ours, *ends = LINE + (RIGHT - LINE) * places
            axes.plot(
                ends, [place + offset] * 2, color=colour, linewidth=1.0, solid_capstyle="butt"
            )
            axes.plot(
                ours,
                place + offset,
                "o",
                markersize=2.4,
                color=colour,
                markeredgewidth=0.5,
                markerfacecolor=face,
            )


@styled
def verdicts(table):
    """The ledger at a glance: each claim with its verdict, the paper's number, ours with its
    interval, and both readings' intervals against the bound.

    table: what `rhec.studies.claims.ledger.ledger` returns. Right of the line a claim holds, left
    it does not; each row is scaled to its own farthest end.
    """
    rows = len(table)
    height = 0.75 + 0.128 * rows
    figure = plt.figure(figsize=(DOUBLE_IN, height), layout="none")
    axes = figure.add_axes((0.003, 0.002, 0.994, 0.996))
    axes.set(xlim=(0, 100), ylim=(rows - 0.4, rows - 0.4 - height / 0.128))
    axes.axis("off")
    axes.plot([LINE, LINE], [-0.5, rows - 0.5], color=BLACK, linewidth=0.6)
    text, section = dict(fontsize=5.4, va="center_baseline"), None
    for place, row in enumerate(table.itertuples()):
        kind = _kind(row.verdict)
        colour, _ = LOOKS[kind]
        if row.section != section:
            section = row.section
            axes.axhline(place - 0.5, color="0.6", linewidth=0.4)
        axes.text(0, place, row.id, **text, weight="bold")
        axes.text(4.0, place, row.claim, **text)
        _sign(axes, SIGN, place, kind)
        _intervals(axes, place, row, colour)
        axes.text(PAPER, place, number(row.paper), **text, ha="right")
        interval = (
            ""
            if np.isnan(row.low) or row.low == row.high
            else f" [{number(row.low)}, {number(row.high)}]"
        )
        unit = row.unit.removeprefix("share ").strip("-") if number(row.value) else ""
        axes.text(PAPER + 1, place, f"{number(row.value)}{interval} {unit}", **text)
        if kind == "one reading":
            axes.text(100, place, row.condition, **text, ha="right", color=colour)
    for x, label, align in [
        (4.0, "claim", "left"),
        (LINE - 0.7, "fails", "right"),
        (LINE + 0.7, "holds", "left"),
        (PAPER, "paper", "right"),
        (PAPER + 1, "ours [95 %]", "left"),
        (100, "holds under", "right"),
    ]:
        axes.text(x, -1.2, label, fontsize=6.5, ha=align, va="center_baseline", weight="bold")
    kinds = table["verdict"].map(_kind)
    for x, kind in zip((1.0, 12.5, 43.0, 60.5, 74.5), LOOKS):
        _sign(axes, x, -3.4, kind)
        axes.text(
            x + 1.5,
            -3.4,
            f"{MEANINGS.get(kind, kind)}: {(kinds == kind).sum()}",
            fontsize=7,
            va="center_baseline",
        )
    return figure
