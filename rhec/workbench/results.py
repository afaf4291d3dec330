"""Write the results in README.md, docs/results.md and docs/claims.md from the tables in figures/.

A result stands between `<!-- results NAME -->` and `<!-- end -->`. If a table that it needs does
not exist, the text that stands there stays.
"""

import re
import textwrap
from pathlib import Path

import pandas as pd

from rhec.workbench.studies.claims.summary import ONE_WAY, survivors, verdict_counts

__all__ = ["format_intervals", "format_number", "main", "readable", "rewrite", "to_markdown"]

_ROOT = Path(__file__).resolve().parents[2]
_PAGES = ("README.md", "docs/results.md", "docs/claims.md")
_BLOCK = re.compile(r"(<!-- results (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def rewrite(text, tables):
    """Write the results in a page's text anew.

    Args:
        text: the page, as Markdown.
        tables: {name: DataFrame}.

    Returns:
        The page with its results.

    Raises:
        KeyError: if the page names a result that does not exist.
    """

    def block(match):
        needed, result = _RESULTS[match[2]]
        if not all(name in tables for name in needed):
            return match[0]
        return match[1] + result(*map(tables.get, needed)) + "\n"

    return _BLOCK.sub(block, text)


def main(root=_ROOT):
    """Write every page whose results changed, in the project's folder `root`."""
    # Other tables in the folder are a person's own, and may be anything.
    names = {name for needed, _ in _RESULTS.values() for name in needed}
    files = [root / f"figures/{name}.csv" for name in names - {"claims_before"}]
    files += [root / "data/claims_before.csv"]
    tables = {path.stem: pd.read_csv(path) for path in files if path.exists()}
    for page in (root / name for name in _PAGES):
        old = page.read_text(encoding="utf-8")
        new = rewrite(old, tables)
        if new != old:
            page.write_text(new, encoding="utf-8")
            print(f"results: {page.name} written anew")


def to_markdown(frame):
    """A DataFrame as a Markdown table, without its index and with nothing for a missing value."""
    rows = [list(frame), ["---"] * len(frame.columns), *frame.fillna("").to_numpy()]
    # A vertical line would end the cell.
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def format_intervals(table, value="mean", low="low", high="high"):
    """The values of a column with the interval of two others, as "value [low, high]"."""
    low, high, value = (table[name].map(format_number) for name in (low, high, value))
    return (value + " [" + low + ", " + high + "]").where(value != "", "")


def format_number(value):
    """Three digits of a number, large ones to the unit; nothing if it is missing."""
    if pd.isna(value):
        return ""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def readable(table):
    """A table as a person reads it: each interval beside its value, one column for each variant.

    Args:
        table: a DataFrame. A column `low` or `..._low` and the next one bound the column before.

    Returns:
        A DataFrame; if the table has a column `quantity`, its entries become rows or columns,
        whichever makes the table longer than wide.
    """
    table = table.dropna(axis="columns", how="all")
    joined = []
    for low in [name for name in table if re.search("(^|_)low$", name)]:
        at = table.columns.get_loc(low)
        value, low, high = table.columns[at - 1 : at + 2]
        table = table.assign(**{value: format_intervals(table, value, low, high)})
        table = table.drop(columns=[low, high])
        joined.append(value)
    if "quantity" not in table or len(joined) != 1:
        return table
    return _spread(table, joined[0])


def _spread(table, value):
    """One row for each variant and one column for each quantity, or the other way round."""
    table = table.fillna("")
    if "paper" in table:
        paper = table["paper"].map(lambda number: f" (paper: {number:.3g})" if number != "" else "")
        table[value] += paper
    if "verdict" in table:
        table[value] += table["verdict"].map(lambda verdict: f": {verdict}" if verdict else "")
    variant = [*table.columns[: table.columns.get_loc("quantity")]]
    name = ", ".join(variant)
    table[name] = table[variant].agg(", ".join, axis=1)
    order = {key: table[key].unique() for key in (name, "quantity")}
    rows, columns = sorted(order, key=lambda key: -len(order[key]))
    wide = table.pivot(index=rows, columns=columns, values=value)
    wide = wide.reindex(index=order[rows], columns=order[columns]).fillna("").reset_index()
    return wide.rename_axis(columns=None)


_ROWS = {  # the README's rows: (estimator or weight, quantity) and what a person calls them
    ("RHE", "mean error, raw GNSS [m]"): "Mean error with the RHE [m]",
    ("EKF", "mean error, raw GNSS [m]"): "Mean error with the EKF [m]",
    ("RHE - EKF", "mean error, raw GNSS [m]"): "Error of the RHE minus that of the EKF [m]",
    ("RHE", "violations on straights, raw GNSS"): "Violations with the RHE",
    ("EKF", "violations on straights, raw GNSS"): "Violations with the EKF",
    ("RHE - EKF", "violations on straights, raw GNSS"): "Violations: RHE minus EKF",
    ("RHE", "violations on straights, true"): "Violations with the RHE, true position",
    ("Q1 / Q3", "settling time, ratio"): "Settling time with Q¹ over that with Q³",
    ("Q2 / Q3", "overshoot, ratio"): "Overshoot with Q² over that with Q³",
}


def _summary(a, b):
    """What the paper reports of Scenarios A and B, and the results under either process noise."""
    a = a.assign(process_noise="calibrated", estimator=a["weight"], paper=float("nan"))
    rows = pd.concat([b, a])
    rows["here"] = format_intervals(rows)
    rows = rows.set_index(["estimator", "quantity"])
    lines = []
    for key, label in _ROWS.items():
        if key not in rows.index:
            continue
        of_key = rows.loc[[key]].set_index("process_noise")
        here = of_key["here"].reindex(["printed", "calibrated"]).fillna("")
        # The paper prints no differences; they follow from its numbers.
        paper = "" if " - " in key[0] else format_number(of_key["paper"].iloc[0])
        lines.append([label, *here, paper, _judged(of_key)])
    heads = ["quantity", "W as printed", "W calibrated", "the paper", "the paper's claim"]
    n = f"Means over {rows['n'].max()} fields, with 95 % intervals:"
    return f"{n}\n\n{to_markdown(pd.DataFrame(lines, columns=heads))}"


def _judged(rows):
    """A claim and its verdict, once if it is the same for either process noise."""
    verdicts = rows["verdict"].dropna()
    if verdicts.empty:
        return ""
    each = "; ".join(f"{noise}: {verdict}" for noise, verdict in verdicts.items())
    verdict = verdicts.iloc[0] if verdicts.nunique() == 1 else each
    claim = rows["claim"].dropna() if "claim" in rows else []
    return f"{claim.iloc[0]}: {verdict}" if len(claim) else verdict


def _verdicts(claims):
    counts = verdict_counts(claims)
    table = pd.DataFrame(dict(verdict=counts.keys(), claims=list(counts.values)))
    return to_markdown(table)


def _failed(claims):
    failed = claims[claims["verdict"] == "does not hold"]
    once = failed["kind"].eq(ONE_WAY).map({True: "*", False: ""})
    return to_markdown(pd.DataFrame({"id": failed["id"] + once, "claim": failed["claim"]}))


def _departures(claims):
    """Claims that the text as printed and departures from it decide differently."""
    some = claims[claims["kind"].str.startswith("holds ")]
    return to_markdown(some[["id", "claim", "verdict"]])


def _multiplicity(claims):
    n, lost = survivors(claims)
    text = (
        f"{n} verdicts rest on an interval. With the false discovery rate held at 5 % over the "
        f"whole ledger (Benjamini and Yekutieli), {n - len(lost)} remain."
    )
    return textwrap.fill(text + (f" Those lost are {', '.join(lost)}." if lost else ""), 100)


def _changes(claims, before):
    """Claims whose verdict differs from that in the previous ledger, and why."""
    old = before.set_index("id")
    new = claims.set_index("id")
    both = new.join(old, how="outer").reindex([*dict.fromkeys([*new.index, *old.index])])
    both[["before", "verdict", "kind"]] = both[["before", "verdict", "kind"]].fillna("–")
    rows = both[both["before"] != both["verdict"]].reset_index()
    rows["now"] = rows["verdict"].mask(rows["kind"] == ONE_WAY, rows["verdict"] + "*")
    return to_markdown(rows[["id", "before", "now", "reason"]])


def _multiverse(table):
    noise = table["id"].str.extract(r" ([pc])$")[0].map({"p": "printed", "c": "calibrated"})
    shown = {
        "id": table["id"].str.replace(r" [pc]$", "", regex=True),
        "W": noise,
        "claim": table["claim"],
        "share of worlds [95 % interval]": format_intervals(table, "holds"),
    }
    return to_markdown(pd.DataFrame(shown))


def _faults(table):
    table = table.assign(aim=table["verdict"] == "holds", back=table["back"] == table["n"])
    reported = {"n": "size", "aim": "sum", "back": "sum", "recovery_s_largest": "max"}
    frame = table.groupby("handling").agg(reported).round(1).reset_index()
    heads = ["robust handling", "cases", "within the aim", "all runs recovered"]
    return to_markdown(frame.set_axis([*heads, "longest recovery [s]"], axis=1))


def _means(by, quantity, heading):
    """A function of a table: the means of a quantity, one row for each entry of the column `by`."""

    def result(table):
        rows = table[table["quantity"] == quantity]
        shown = pd.DataFrame({by.replace("contestant", "estimator"): rows[by]})
        shown[f"{heading} [95 % interval]"] = format_intervals(rows)
        if "verdict" in rows and rows["verdict"].notna().any():
            shown["claim"] = rows["verdict"]
        return to_markdown(shown)

    return result


_RESULTS = {  # the tables that a result needs, and the function of them that writes it
    "summary": (["table_scenario_a", "table_scenario_b"], _summary),
    "settling": (["table_scenario_a"], _means("weight", "settling time [s]", "settling time [s]")),
    "verdicts": (["claims"], _verdicts),
    "failed": (["claims"], _failed),
    "departures": (["claims"], _departures),
    "multiplicity": (["claims"], _multiplicity),
    "changes": (["claims", "claims_before"], _changes),
    "multiverse": (["multiverse"], _multiverse),
    "faults": (["table_faults"], _faults),
    "beyond": (
        ["table_beyond"],
        _means("contestant", "true error, ratio to RHE, W printed", "error over the RHE's"),
    ),
    "consistency": (["table_consistency"], _means("estimator", "NEES, mean", "NEES")),
    "replay": (
        ["table_replay"],
        _means("estimator", "RMS error of yaw [rad]", "RMS error of the yaw [rad]"),
    ),
}

if __name__ == "__main__":
    main()
