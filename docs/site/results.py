"""What README.md and docs/ say of the results, from the tables in data/results/.

    python -m docs.site.results

Each block stands between `<!-- results NAME -->` and `<!-- end -->`.
"""

import re
from pathlib import Path

import pandas as pd

from benchmark import tables as benchmark
from notebooks.claims import summary
from notebooks.claims.rules import CLAIMS
from notebooks.further import consistency, unknowns
from notebooks.further.recorded import page as recorded
from notebooks.studies import answer, calibration

__all__ = ["BLOCKS", "PAGES", "rewrite"]

ROOT = Path(__file__).resolve().parents[2]
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
    verdicts = answer.to_markdown(consistency.readable_verdicts(table))
    return f"{verdicts}\n\n{consistency.in_words(table)}"


BLOCKS = {
    "answer": lambda: answer.first_screen(),
    "bar": lambda: answer.bar(),
    "sentence": lambda: f"**{answer.in_short(_table('table_scenario_b'))}**",
    "words": lambda: answer.in_words(),
    "numbers": lambda: answer.to_markdown(answer.scenario_b_numbers()),
    "turns": lambda: answer.to_markdown(answer.by_turns()),
    "sentences": lambda: answer.to_markdown(answer.sentences()),
    "changes": lambda: answer.to_markdown(summary.changes(_table("claims"), CLAIMS)),
    "counted": _n_claims,
    "noises": lambda: answer.to_markdown(calibration.readable_noises()),
    "consistency": _consistency,
    "worth": unknowns.in_words,
    "take": unknowns.in_short,
    **{f"recorded_{name}": block for name, block in recorded.BLOCKS.items()},
} | benchmark.BLOCKS
_BLOCK = re.compile(r"(<!-- results (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def rewrite(text):
    """A page with these results as they are now."""
    return _BLOCK.sub(lambda block: f"{block[1]}{BLOCKS[block[2]]()}\n", text)


if __name__ == "__main__":
    for name in PAGES:
        page = ROOT / name
        page.write_text(rewrite(page.read_text(encoding="utf-8")), encoding="utf-8")
