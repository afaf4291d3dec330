"""What README.md and docs/ say of the results, from the tables in data/results/.

    python -m docs.site.results

Each block stands between `<!-- results NAME -->` and `<!-- end -->`.
"""

import re
import textwrap

import pandas as pd

from benchmark import tables as benchmark
from notebooks.claims import summary
from notebooks.claims.rules import CLAIMS
from notebooks.declared import ROOT
from notebooks.further import consistency, unknowns
from notebooks.further.recorded import page as recorded
from notebooks.studies import answer, calibration
from notebooks.studies.tables import to_markdown

PAGES = (
    "README.md",
    "docs/results.md",
    "docs/worth.md",
    "docs/claims.md",
    "docs/interpretations.md",
    "docs/performance.md",
    "docs/recorded_robots.md",
    "docs/systems.md",
)


def _table(name, **options):
    return pd.read_csv(answer.RESULTS / f"{name}.csv", **options)


def _n_claims():
    return (
        f"The ledger lists {len(CLAIMS)} sentences of the paper that can be checked, each quoted "
        "with its section."
    )


def _consistency():
    table = _table("table_consistency")
    verdicts = to_markdown(consistency.readable_verdicts(table))
    return f"{verdicts}\n\n{consistency.in_words(table)}"


def _unknowns():
    names = ("table_unknowns", "table_unknowns_by_rule", "table_traction_map")
    return [_table(name, dtype=dict(told=str)) for name in names]


BLOCKS = {
    "answer": lambda: answer.first_screen(),
    "bar": lambda: answer.bar(),
    "sentence": lambda: f"**{answer.in_short(_table('table_scenario_b'))}**",
    "numbers": lambda: to_markdown(answer.scenario_b_numbers(_table("table_scenario_b"))),
    "turns": lambda: to_markdown(answer.by_turns(_table("table_scenario_b"))),
    "sentences": lambda: to_markdown(answer.sentences()),
    "changes": lambda: to_markdown(summary.changes(_table("claims"), CLAIMS)),
    "counted": _n_claims,
    "noises": lambda: to_markdown(calibration.readable_noises()),
    "consistency": _consistency,
    "worth": lambda: unknowns.in_words(*_unknowns()),
    "take": lambda: unknowns.in_short(_unknowns()[0], _unknowns()[-1]),
    **{f"recorded_{name}": block for name, block in recorded.BLOCKS.items()},
} | benchmark.BLOCKS
_COLUMNS = 100
_BLOCK = re.compile(r"(<!-- results (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def rewrite(text):
    """A page with these results as they are now."""
    return _BLOCK.sub(lambda block: f"{block[1]}{_wrapped(BLOCKS[block[2]]())}\n", text)


def _wrapped(text):
    """Markdown whose lines have at most 100 columns, but for rows of tables."""
    look = dict(width=_COLUMNS, break_long_words=False, break_on_hyphens=False)
    return "\n".join(
        line
        if line.startswith("|")
        else textwrap.fill(line, **look, subsequent_indent="  " * line.startswith("- "))
        for line in text.splitlines()
    )


def write(root=ROOT):
    """Write the results into the pages below a folder."""
    for name in PAGES:
        page = root / name
        page.write_text(rewrite(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    write()
