"""The claims as cards of the report: each sentence with its verdict, its numbers and its rule.

`page` writes the report's page `claims.html` as Markdown. All that a card says is in the ledger,
`claims.csv`; nothing is computed here. `cards.html.j2` orders the parts of a card,
`docs/_static/claims.js` filters and searches the cards, which are all readable without it.
"""

from pathlib import Path

import jinja2
import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, MaxNLocator

from notebooks.claims.summary import by_condition, verdict_counts
from notebooks.plots.claims import LOOKS, kind_of
from notebooks.studies.tables import interval_text, three_digits, to_markdown, with_minus

# {address of the live page, after "#": ids of the claims that it shows}
LIVE = {
    "a": "A1 A2 A10 A9 A3 A4 A5",
    "b": "S4 H2 M1 M2 B1 B2 B3 B4 B5 B7 B8 B9 B10 B12 B13 B14 B18 B19 B20 C2 C3",
}
_INTRODUCTION = """A claim *holds* if the whole 95 % interval lies on its side of the bound, and
*does not hold* if none of it does; otherwise it is undecided. A number of the paper is *met*,
*possible* for a single drive, or *not met* ([how claims are judged](docs/claims.md)). Where the
verdict names a departure, the text as printed gives the other. A verdict *by derivation* follows
from equations or from the paper's own numbers. The ledger takes 40 fields, and more only as long as
a claim is undecided; README and the notebooks have more of them, so that their numbers are closer.
A click on a card shows the paper's words, the rule, the reason and the command that judges the
claim again."""
_ENVIRONMENT = jinja2.Environment(
    trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined, autoescape=True
)
_TEMPLATE = Path(__file__).with_name("cards.html.j2").read_text(encoding="utf-8")
_UNITLESS = ("", "-", "ratio")
# The picture of an interval [px]: its scale from left to right, and the heights of its parts.
_LEFT = 14.0
_RIGHT = 346.0
_MARGIN = 0.07  # on both sides of what is shown, as a share of it
_ROWS = {"here": 26.0, "other": 37.0}
_TICKS = 4
_FAR = 4.0  # the other finding is beyond the scale if it would make that this many times as long


def page(claims, live=False):
    """The report's page of all claims, with an address for each, such as `claims.html#B5`.

    Args:
        claims: The ledger from claims.csv, one row a claim.
        live: Whether the report has a live page to link.

    Returns:
        The page as Markdown with HTML.
    """
    claims = claims.assign(kind=claims["verdict"].map(kind_of))
    template = _ENVIRONMENT.from_string(_TEMPLATE).module
    counts = to_markdown(verdict_counts(claims).reset_index())
    sections = {
        section: [_card(row, live) for row in rows.to_dict("records")]
        for section, rows in claims.groupby("section", sort=False)
    }
    kinds = [(kind, *LOOKS[kind], (claims["kind"] == kind).sum()) for kind in LOOKS]
    overview = _raw(template.overview(sections, [each for each in kinds if each[3]]))
    parts = ["# Verdicts on the paper", counts, _INTRODUCTION, overview]
    parts += [f"## {section}\n\n{_raw(template.cards(all_))}" for section, all_ in sections.items()]
    return "---\nhide-toc: true\n---\n\n" + "\n\n".join(parts) + "\n"


def _raw(html):
    return f"```{{raw}} html\n{html}\n```"


# One card


def _card(row, live):
    """What the template needs of a row of the ledger."""
    share = interval_text(row["posterior"], row["posterior_low"], row["posterior_high"])
    row = {name: "" if pd.isna(value) else value for name, value in row.items()}
    row |= {name: with_minus(row[name]) for name in ("claim", "test", "why", "beside")}
    colour, sign = LOOKS[row["kind"]]
    return row | dict(
        colour=colour,
        sign=sign,
        numbers=_numbers(row),
        conditions=_conditions(row["conditions"]),
        share=share,
        picture=interval(row),
        scene=next((at for at, ids in LIVE.items() if live and row["id"] in ids.split()), ""),
    )


def _numbers(row):
    """[(whose, number with its unit, n)]: ours, that of the other condition, and the paper's."""
    unit = "" if row["unit"] in _UNITLESS else row["unit"]
    lines = []
    for prefix, condition in (("", row["condition"]), ("other_", row["other_condition"])):
        n = row[f"{prefix}n"] or 0
        if n:
            number = interval_text(*(row[f"{prefix}{name}"] for name in ("value", "low", "high")))
            lines.append(
                (f"here, {condition}" if condition else "here", f"{number} {unit}", int(n))
            )
    if row["paper"] != "":
        number = pd.to_numeric(row["paper"], errors="coerce")  # NaN for a word
        paper = with_minus(row["paper"])
        has_unit = not np.isnan(number) and not unit.startswith("share")
        lines.append(("the paper", f"{paper} {unit}" if has_unit else paper, 0))
    return lines


def _conditions(text):
    """[(condition, verdict, sign)] of "as printed: holds; W by prediction: undecided"."""
    verdicts = by_condition(text).items()
    return [(name, verdict, LOOKS[kind_of(verdict)][1]) for name, verdict in verdicts if name]


# The picture of an interval


def _value_and_interval(row, prefix):
    """Value, low and high end of a finding; one run has no interval, and is its own ends."""
    value, low, high = (row[f"{prefix}{name}"] for name in ("value", "low", "high"))
    return [value, value if low == "" else low, value if high == "" else high]


def interval(row):
    """The places [px] of a claim's interval, its rule's limits and the paper's number on one scale.

    Shares are drawn from 0 to 1, positive ratios on a logarithmic scale. What was found under the
    other condition, that of a lost rival for example, may lie so far away that all else would fall
    on one point. Then it is an arrow at the edge, with its number.

    Args:
        row: A row of the ledger, with "" for what is missing.

    Returns:
        dict: `rows` [(kind, y, value, low, high)], `beyond` (None, or y, the edge, its side, -1 or
        1, and the number), `limits`, `paper` (or None), `inside` (left end and width of where the
        rule says "holds"), `ticks` [(place, text)], `words`. None if there is no number to draw.
    """
    findings = {
        kind: _value_and_interval(row, prefix)
        for kind, prefix in (("here", ""), ("other", "other_"))
        if row[f"{prefix}n"] and row[f"{prefix}value"] != ""
    }
    if not findings:
        return None
    paper = pd.to_numeric(row["paper"], errors="coerce")
    bounds = np.array([row["above"], row["below"]], dtype=float)
    words = _in_words(findings, row["bound"], paper)
    near = _finite([*findings.get("here", ()), *bounds, paper])
    beyond = None
    if _is_far(findings.get("other"), near, row["unit"]):
        value = findings.pop("other")[0]
        side = int(np.sign(value - near.mean()))
        beyond = _ROWS["other"], _RIGHT if side > 0 else _LEFT, side, three_digits(value)
    place, ticks = _scale(_finite([*np.ravel([*findings.values()]), *near]), row["unit"])
    begin, end = (place(bound) for bound in bounds)
    return dict(
        rows=[(kind, _ROWS[kind], *map(place, found)) for kind, found in findings.items()],
        beyond=beyond,
        limits=sorted({place(bound) for bound in bounds if np.isfinite(bound)}),
        paper=None if np.isnan(paper) else place(paper),
        inside=(begin, end - begin),
        ticks=ticks,
        words=words,
    )


def _finite(values):
    return np.array([each for each in values if np.isfinite(each)])


def _is_far(other, near, unit):
    """Whether a finding would make a linear scale around the others much too long."""
    if other is None or len(near) < 2 or unit.startswith("share") or unit == "ratio":
        return False
    return np.ptp([other[0], *near]) > _FAR * np.ptp(near) > 0


def _in_words(findings, bound, paper):
    ours, *others = [interval_text(*found) for found in findings.values()]
    words = f"Interval: {ours}"
    words += f"; under the other condition {others[0]}" if others else ""
    words += f"; the rule: {bound}" if bound else ""
    return words + ("" if np.isnan(paper) else with_minus(f"; the paper: {paper:g}"))


def _scale(values, unit):
    """A function from numbers to places [px], and the ticks [(place, text)].

    Args:
        values: All finite numbers that are drawn.
        unit: Theirs.
    """
    if unit.startswith("share"):
        axis = np.asarray
        least = 0.0
        most = 1.0
    else:
        axis = np.log if unit == "ratio" and values.min() > 0 else np.asarray
        least = axis(values.min())
        most = axis(values.max())
        margin = _MARGIN * (most - least) or 0.1 * abs(most) or 1.0
        least -= margin
        most += margin

    def place(value):
        if np.isinf(value):
            return _RIGHT if value > 0 else _LEFT
        share = (axis(value) - least) / (most - least)
        return float(np.round(_LEFT + (_RIGHT - _LEFT) * share, 1))

    numbers = _ticks(least, most) if axis is np.asarray else _log_ticks(np.exp([least, most]))
    return place, [(place(number), with_minus(f"{number:g}")) for number in numbers]


def _ticks(least, most):
    ticks = MaxNLocator(_TICKS).tick_values(least, most)
    ticks = np.round(ticks, 12) + 0.0  # without the sign of zero
    return ticks[(least <= ticks) & (ticks <= most)]


def _log_ticks(ends):
    """Ticks at 1, 2 and 5 times the powers of ten; plain ones where these are fewer than two."""
    least, most = ends
    steps = (1.0, 2.0, 5.0) if most / least < 30 else (1.0,)
    ticks = LogLocator(subs=steps).tick_values(least, most)
    ticks = ticks[(least <= ticks) & (ticks <= most)]
    return ticks if len(ticks) > 1 else _ticks(least, most)
