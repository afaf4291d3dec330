"""What README.md says of the results, from the tables in data/results/.

    python -m docs.site.results

Each block stands between `<!-- results NAME -->` and `<!-- end -->`.
"""

import re
from pathlib import Path

import pandas as pd

from notebooks.further import traction_map
from notebooks.studies import answer

__all__ = ["BLOCKS", "rewrite"]

ROOT = Path(__file__).resolve().parents[2]
BLOCKS = {
    "answer": lambda: answer.in_words(),
    "beside": lambda: answer.to_markdown(answer.paper_beside_ours()),
    "bar": lambda: answer.bar(),
    "worth": lambda: traction_map.rule_in_words(_map()),
}


def _map():
    return pd.read_csv(answer.RESULTS / "table_traction_map.csv", dtype=dict(told=str))


_BLOCK = re.compile(r"(<!-- results (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def rewrite(text):
    """A page with these results as they are now."""
    return _BLOCK.sub(lambda block: f"{block[1]}{BLOCKS[block[2]]()}\n", text)


if __name__ == "__main__":
    page = ROOT / "README.md"
    page.write_text(rewrite(page.read_text(encoding="utf-8")), encoding="utf-8")
