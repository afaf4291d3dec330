"""The two tables in README.md, from the tables in data/results/.

    python -m docs.site.results

Each stands between `<!-- results NAME -->` and `<!-- end -->`.
"""

import re
from pathlib import Path

import pandas as pd

from notebooks.claims.summary import verdict_counts
from notebooks.studies.tables import interval_text

__all__ = ["EXPECTED", "rewrite", "summary", "to_markdown", "verdicts"]

ROOT = Path(__file__).resolve().parents[2]
EXPECTED = ROOT / "data/results"
_ERROR = "mean error, raw GNSS [m]"
_VIOLATIONS = "violations on straights, raw GNSS"
_ROWS = [  # label, whose, quantity; the sentence that is judged, and on whose numbers
    ("Mean error with the RHE [m]", "RHE", _ERROR, "", "RHE"),
    ("Mean error with the EKF [m]", "EKF", _ERROR, "the RHE's is smaller", "RHE - EKF"),
    ("Violations with the RHE", "RHE", _VIOLATIONS, "none", "RHE"),
    ("Violations with the EKF", "EKF", _VIOLATIONS, "the RHE has fewer", "RHE - EKF"),
    ("Settling time, Q¹ over Q³", "Q1 / Q3", "settling time, ratio", "at least 2", "Q1 / Q3"),
    ("Overshoot, Q² over Q³", "Q2 / Q3", "overshoot, ratio", "at least 2", "Q2 / Q3"),
]
_NOISES = {"printed": "W as printed", "likelihood": "W by likelihood"}
_BLOCK = re.compile(r"(<!-- results (summary|verdicts) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def summary():
    """Scenarios A and B beside the paper: one row a quantity, one column a process noise W."""
    a = pd.read_csv(EXPECTED / "table_scenario_a.csv").rename(columns={"weight": "estimator"})
    b = pd.read_csv(EXPECTED / "table_scenario_b.csv")
    numbers = pd.concat([b, a.assign(process_noise="likelihood")])
    numbers = numbers.set_index(["estimator", "quantity", "process_noise"]).sort_index()
    rows = []
    for label, whose, quantity, sentence, judged in _ROWS:
        here = numbers.loc[whose, quantity]
        row = {f"mean of {here['n'].max()} fields [95 % interval]": label}
        row["the paper"] = "".join(f"{number:g}" for number in here["paper"].dropna().unique())
        row |= dict.fromkeys(_NOISES.values(), "")
        for noise, found in here.iterrows():
            row[_NOISES[noise]] = interval_text(found["mean"], found["low"], found["high"])
        row["verdict"] = _verdict(sentence, numbers.loc[judged, quantity]["verdict"].dropna())
        rows.append(row)
    return pd.DataFrame(rows)


def _verdict(sentence, verdicts):
    """A sentence with its verdict, or with both where they differ between process noises."""
    if not sentence:
        return ""
    both = [f"{verdict} ({_NOISES[noise]})" for noise, verdict in verdicts[::-1].items()]
    return f"{sentence}: {verdicts.iloc[0] if verdicts.nunique() == 1 else ', '.join(both)}"


def verdicts():
    """How many claims of the ledger have each verdict."""
    return verdict_counts(pd.read_csv(EXPECTED / "claims.csv")).reset_index()


_RESULTS = {"summary": summary, "verdicts": verdicts}


def to_markdown(frame):
    """A DataFrame as a Markdown table without index."""
    rows = [list(frame), ["---"] * len(frame.columns), *frame.to_numpy()]
    # A vertical line would end the cell.
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def rewrite(text):
    """A page with these tables as they are now."""
    return _BLOCK.sub(lambda block: f"{block[1]}{to_markdown(_RESULTS[block[2]]())}\n", text)


if __name__ == "__main__":
    page = ROOT / "README.md"
    page.write_text(rewrite(page.read_text(encoding="utf-8")), encoding="utf-8")
