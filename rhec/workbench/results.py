"""Update the results in README.md and in pages of docs/ from the tables in figures/ and data/.

A result is the text between `<!-- results NAME -->` and `<!-- end -->`. It stays unchanged if one
of its tables does not exist.
"""

import re
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd

from rhec.workbench.studies import ranking, seven_worlds
from rhec.workbench.studies.claims.summary import (
    DEPARTURE,
    PRINTED,
    WHERE,
    changes,
    class_of,
    survivors,
    verdict_counts,
)

_ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "docs/results.md", "docs/claims.md", "docs/closer_to_the_limit.md")
_IN_DATA = ("claims_before.csv", "seven_worlds.parquet")  # tables that no notebook makes
_BLOCK = re.compile(r"(<!-- results (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)


def rewrite(text, tables):
    """Update the results in a page.

    Args:
        text: The page as Markdown.
        tables: {name: DataFrame}.

    Returns:
        The page with its results.

    Raises:
        KeyError: If the page names a result that does not exist.
    """

    def block(match):
        names, result = _RESULTS[match[2]]
        if not all(name in tables for name in names):
            return match[0]
        return match[1] + result(*map(tables.get, names)) + "\n"

    return _BLOCK.sub(block, text)


def main(root=_ROOT):
    """Write every page whose results changed, in the project's folder `root`."""
    # Other tables in the folder are a person's own, and may be anything.
    names = {name for needed, _ in _RESULTS.values() for name in needed}
    kept = [root / "data" / name for name in _IN_DATA]
    files = [root / f"figures/{name}.csv" for name in names - {path.stem for path in kept}]
    tables = {path.stem: _read(path) for path in [*files, *kept] if path.exists()}
    for page in (root / name for name in PAGES):
        old = page.read_text(encoding="utf-8")
        new = rewrite(old, tables)
        if new != old:
            page.write_text(new, encoding="utf-8")
            print(f"results: {page.name} updated")


def _read(path):
    return pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path)


def to_markdown(frame):
    """A DataFrame as a Markdown table without index; missing values are empty."""
    rows = [list(frame), ["---"] * len(frame.columns), *frame.fillna("").to_numpy()]
    # A vertical line would end the cell.
    cells = [[str(cell).replace("|", "\\|") for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def format_intervals(table, value="mean", low="low", high="high"):
    """Strings "value [low, high]" from three columns."""
    low, high, value = (table[name].map(format_number) for name in (low, high, value))
    return (value + " [" + low + ", " + high + "]").where(value != "", "")


def format_number(value):
    """A number with three digits, or as an integer from 100; "" for a missing one."""
    if pd.isna(value):
        return ""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def readable(table):
    """Join values with their intervals, and spread quantities over rows and columns.

    Args:
        table: A DataFrame. A column `low` or `..._low` and the next one are the interval of the
            previous column.

    Returns:
        A DataFrame. The entries of a column `quantity` become rows or columns, so that the table
        has more rows than columns.
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
    """A table with rows for variants and columns for quantities, or the transpose."""
    table = table.fillna("")
    if "paper" in table:
        paper = table["paper"].map(lambda number: f" (paper: {number:.3g})" if number != "" else "")
        table[value] += paper
    if "verdict" in table:
        table[value] += table["verdict"].map(lambda verdict: f": {verdict}" if verdict else "")
    variant = [*table.columns[: table.columns.get_loc("quantity")]]
    name = ", ".join(variant)
    table[name] = table[variant].astype(str).agg(", ".join, axis=1)
    order = {key: table[key].unique() for key in (name, "quantity")}
    rows, columns = sorted(order, key=lambda key: -len(order[key]))
    wide = table.pivot(index=rows, columns=columns, values=value)
    wide = wide.reindex(index=order[rows], columns=order[columns]).fillna("").reset_index()
    return wide.rename_axis(columns=None)


_ROWS = {  # rows of the README: {(estimator or weight, quantity): label}
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
    """Results of Scenarios A and B for both process noises, and the numbers of the paper."""
    a = a.assign(process_noise="calibrated", estimator=a["weight"], paper=float("nan"))
    rows = pd.concat([b, a])
    rows["here"] = format_intervals(rows)
    rows = rows.set_index(["estimator", "quantity"])
    lines = []
    for key, label in _ROWS.items():
        if key not in rows.index:
            continue
        results = rows.loc[[key]].set_index("process_noise")
        here = results["here"].reindex(["printed", "calibrated"]).fillna("")
        # The paper does not print differences.
        paper = "" if " - " in key[0] else format_number(results["paper"].iloc[0])
        lines.append([label, *here, paper, _judged(results)])
    heads = ["quantity", "W as printed", "W calibrated", "the paper", "the paper's claim"]
    n = f"Means over {rows['n'].max()} fields, with 95 % intervals:"
    return f"{n}\n\n{to_markdown(pd.DataFrame(lines, columns=heads))}"


def _judged(rows):
    """A claim and its verdict, or two verdicts if they differ between process noises."""
    verdicts = rows["verdict"].dropna()
    if verdicts.empty:
        return ""
    both = "; ".join(f"{noise}: {verdict}" for noise, verdict in verdicts.items())
    verdict = verdicts.iloc[0] if verdicts.nunique() == 1 else both
    claim = rows["claim"].dropna() if "claim" in rows else []
    return f"{claim.iloc[0]}: {verdict}" if len(claim) else verdict


def _verdicts(claims):
    return to_markdown(verdict_counts(claims).reset_index())


def _failed(claims):
    failed = claims[claims["verdict"] == "does not hold"]
    return to_markdown(failed[["id", "claim", "basis"]])


def _departures(claims):
    """Claims with different verdicts for the text as printed and for departures from it."""
    some = claims[claims["verdict"].map(class_of).isin([PRINTED, DEPARTURE])]
    return to_markdown(some[["id", "claim", "verdict"]])


def _worlds(claims):
    """Claims whose verdict depends on the world: the condition, and in how many worlds it holds."""
    some = claims[claims["verdict"].map(class_of) == WHERE]
    columns = {"id": some["id"], "claim": some["claim"], "verdict": some["verdict"]}
    columns["predicts"] = some["where_accuracy"].map(format_number)
    for name in ("posterior", "multiverse"):
        if name in some:
            columns[f"share of {name} worlds"] = format_intervals(
                some, name, f"{name}_low", f"{name}_high"
            )
    return to_markdown(pd.DataFrame(columns))


def _multiplicity(claims):
    n, lost = survivors(claims)
    text = (
        f"{n} verdicts rest on an interval. With the false discovery rate held at 5 % over the "
        f"whole ledger (Benjamini and Yekutieli), {n - len(lost)} remain."
    )
    return textwrap.fill(text + (f" Those lost are {', '.join(lost)}." if lost else ""), 100)


def _changes(claims, before):
    """Claims with another verdict than in the previous ledger, and the reasons."""
    return to_markdown(changes(claims, before))


def _multiverse(table):
    noise = table["id"].str.extract(r" ([pc])$")[0].map({"p": "printed", "c": "calibrated"})
    columns = {
        "id": table["id"].str.replace(r" [pc]$", "", regex=True),
        "W": noise,
        "claim": table["claim"],
        "share of worlds [95 % interval]": format_intervals(table, "holds"),
    }
    return to_markdown(pd.DataFrame(columns))


def _inverse(table):
    """Shares of single drives that meet what the paper states, before and after it is known."""
    columns = {"what the paper states": table["statement"]}
    for when, heading in (("prior", "share of the prior"), ("posterior", "share of the posterior")):
        names = [f"{when} drives{end}" for end in ("", "_low", "_high")]
        columns[heading] = format_intervals(table, *names)
    return to_markdown(pd.DataFrame(columns))


def _faults(table):
    table = table.assign(aim=table["verdict"] == "holds", back=table["back"] == table["n"])
    reported = {"n": "size", "aim": "sum", "back": "sum", "recovery_s_largest": "max"}
    frame = table.groupby("handling").agg(reported).round(1).reset_index()
    heads = ["robust handling", "cases", "within the aim", "all runs recovered"]
    return to_markdown(frame.set_axis([*heads, "longest recovery [s]"], axis=1))


def _means(by, quantity, heading):
    """A function that writes the means of a quantity of a table, one row per entry of `by`."""

    def result(table):
        rows = table[table["quantity"] == quantity]
        columns = pd.DataFrame({by.replace("contestant", "estimator"): rows[by]})
        columns[f"{heading} [95 % interval]"] = format_intervals(rows)
        if "verdict" in rows and rows["verdict"].notna().any():
            columns["claim"] = rows["verdict"]
        return to_markdown(columns)

    return result


def _format_ratios(table):
    """Strings "value [low, high]" with three decimals: ratios near 1 differ in the third."""
    rows = zip(table["mean"], table["low"], table["high"])
    return [f"{mean:.3f} [{low:.3f}, {high:.3f}]" for mean, low, high in rows]


def _ranking(table):
    """Mean true errors of contestants: one row a contestant, one column a world."""
    wide = ranking.overview(table, _interval_text).fillna("").reset_index()
    heads = ["mean true error [m]", *(f"{world} world" for world in wide.columns[1:])]
    return to_markdown(wide.set_axis(heads, axis=1))


def _interval_text(mean, low, high):
    """A string "mean [low, high]"."""
    return f"{format_number(mean)} [{format_number(low)}, {format_number(high)}]"


def _worth(table):
    """Ratios of errors, one row a part of the loop, one column a world.

    A part that the first look decided has its verdict in place of a number of few fields.
    """
    decided = table["n"] < table["n"].max()
    after = table.get("verdict", "") + " after " + table["n"].astype(str) + " fields"
    rows = table.assign(value=np.where(decided, after, _format_ratios(table)))
    return _by_world(rows, "quantity", "part of the loop")


def _by_world(rows, row, heading):
    """The column `value` as a table: one row an entry of the column `row`, one column a world."""
    worlds = list(rows["world"].unique())
    wide = rows.pivot(index=row, columns="world", values="value").reindex(rows[row].unique())
    wide = wide[worlds].fillna("").reset_index()
    return to_markdown(wide.set_axis([heading, *(f"{world} world" for world in worlds)], axis=1))


def _targets(table):
    rows = table[table["claim"].fillna("") != ""]
    columns = rows.assign(value=_format_ratios(rows))[
        ["world", "contestant", "quantity", "value", "claim", "verdict"]
    ]
    heads = ["world", "contestant", "quantity", "ratio [95 % interval]", "claim", "verdict"]
    return to_markdown(columns.set_axis(heads, axis=1))


def _seven_worlds(laps):
    """Shares of fields in which the tuned loops keep each promise, and their speeds."""
    loops = seven_worlds.TUNED_HERE
    laps = laps[laps["loop"].isin(loops)]
    return _shares_by_loop(laps, [loop.partition(",")[0] for loop in loops])


def _seven_worlds_others(laps):
    """The same of the other loops."""
    laps = laps[~laps["loop"].isin(seven_worlds.TUNED_HERE)]
    return _shares_by_loop(laps, list(laps["loop"].unique()))


def _shares_by_loop(laps, names):
    """Shares of fields with promises kept, and mean speeds: a row a world, three columns a loop."""
    table = seven_worlds.counted(laps)
    table["share"] = format_intervals(table, "share")
    table["world"] = [*map(_world, table["base"], table["world"])]
    columns = {"world": table["world"].unique()}
    for loop, name in zip(laps["loop"].unique(), names, strict=True):
        rows = table[table["loop"] == loop]
        for promise in ("whole path", "corners on rows"):
            columns[f"{name}: {promise}"] = rows.loc[rows["promise"] == promise, "share"].to_numpy()
        speeds = rows.loc[rows["promise"] == "whole path", "speed_mps"]
        columns[f"{name}: m/s"] = speeds.map(format_number).to_numpy()
    return f"{_fields(laps)}\n\n{to_markdown(pd.DataFrame(columns))}"


def _world(base, world):
    """A world's name for readers; that of its base alone where nothing is changed."""
    if world == "as it is":
        return base
    return (world if base == "default" else f"{base}, {world}").replace(" x ", " × ")


def _fields(laps):
    """How many fields there are, and the seeds of those."""
    seeds = laps["seed"]
    return f"Of {seeds.nunique()} fields each, seeds {seeds.min()} to {seeds.max()}:"


def _seven_worlds_paired(laps):
    """The fields in which only one of the tuned loops keeps a promise."""
    one, other = seven_worlds.TUNED_HERE
    table = seven_worlds.paired(laps, one, other)
    table = table[table["promise"] != "rows"]
    names = [one, other.partition(",")[0]]
    worlds = [*map(_world, table["base"], table["world"])]
    columns = {"world": worlds, "promise": table["promise"]}
    columns |= {f"only {name}": table[f"only {loop}"] for name, loop in zip(names, (one, other))}
    columns |= {"p": table["p"].map(format_number), "n": table["n"]}
    return to_markdown(pd.DataFrame(columns))


_RESULTS = {  # {result: (its tables, the function that writes it)}
    "summary": (["table_scenario_a", "table_scenario_b"], _summary),
    "inverse": (["inverse_statements"], _inverse),
    "settling": (["table_scenario_a"], _means("weight", "settling time [s]", "settling time [s]")),
    "verdicts": (["claims"], _verdicts),
    "failed": (["claims"], _failed),
    "departures": (["claims"], _departures),
    "worlds": (["claims"], _worlds),
    "multiplicity": (["claims"], _multiplicity),
    "changes": (["claims", "claims_before"], _changes),
    "multiverse": (["multiverse"], _multiverse),
    "faults": (["table_faults"], _faults),
    "beyond": (["table_beyond"], _ranking),
    "targets": (["table_beyond"], _targets),
    "worth": (["table_worth"], _worth),
    "seven_worlds": (["seven_worlds"], _seven_worlds),
    "seven_worlds_paired": (["seven_worlds"], _seven_worlds_paired),
    "seven_worlds_others": (["seven_worlds"], _seven_worlds_others),
    "consistency": (["table_consistency"], _means("estimator", "NEES, mean", "NEES")),
    "replay": (
        ["table_replay"],
        _means("estimator", "RMS error of yaw [rad]", "RMS error of the yaw [rad]"),
    ),
}

if __name__ == "__main__":
    main()
