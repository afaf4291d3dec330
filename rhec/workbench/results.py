"""Write the results in README.md, docs/results.md and docs/claims.md from the tables in figures/.

A result stands between `<!-- results NAME -->` and `<!-- end -->`. Where a table that it needs was
not made, the text that stands there stays.
"""

import re
import textwrap
from pathlib import Path

import pandas as pd

from rhec.workbench.studies.claims.summary import ONE_WAY, survivors, verdict_counts

__all__ = ["main", "rewrite"]

_ROOT = Path(__file__).resolve().parents[2]
_BLOCK = re.compile(r"(<!-- results (\w+) -->\n).*?(?=<!-- end -->)", re.DOTALL)
_FAULTS = ["gating", "cases", "within the aim", "all runs recovered", "longest recovery [s]"]


def rewrite(text, tables):
    """A page's text with its results written anew from tables, {name: DataFrame}."""

    def block(match):
        needed, result = _RESULTS[match[2]]
        there = all(name in tables for name in needed)
        return match[1] + result(*map(tables.get, needed)) + "\n" if there else match[0]

    return _BLOCK.sub(block, text)


def main(root=_ROOT):
    """Write every page whose results changed, in the project's folder `root`."""
    files = [*(root / "figures").glob("*.csv"), root / "data/claims_before.csv"]
    tables = {path.stem: pd.read_csv(path) for path in files if path.exists()}
    for page in (root / "README.md", root / "docs/results.md", root / "docs/claims.md"):
        old = page.read_text(encoding="utf-8")
        new = rewrite(old, tables)
        if new != old:
            page.write_text(new, encoding="utf-8")
            print(f"results: {page.name} written anew")


def _number(value):
    """Three digits of a number, large ones to the unit; nothing where there is none."""
    return "" if pd.isna(value) else f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _intervals(table, value="mean"):
    """Each row's value [low, high], and its verdict if it has one."""
    low, high, value = (table[name].map(_number) for name in ("low", "high", value))
    verdicts = table.get("verdict", table["low"])  # no text where there is none
    verdict = [f": {entry}" if isinstance(entry, str) else "" for entry in verdicts]
    return value + " [" + low + ", " + high + "]" + verdict


def _list(values):
    """A Series of values by name, as one paragraph."""
    return textwrap.fill("; ".join(f"{name}: {value}" for name, value in values.items()) + ".", 100)


def _table(frame):
    rows = [list(frame), ["---"] * len(frame.columns), *frame.fillna("").to_numpy()]
    return "\n".join("| " + " | ".join(map(str, row)) + " |" for row in rows)


def _summary(a, b):
    """What the paper reports of Scenarios A and B, and what came out under either process noise."""
    ours = (b["estimator"] == "RHE") & (b["quantity"] == "violations on straights, true")
    a = a[a["claim"].notna()].assign(process_noise="calibrated", estimator=a["weight"])
    rows = pd.concat([b[ours | b["paper"].notna()], a])
    quantity = rows["quantity"].replace("mean |, raw GNSS| on straights", "", regex=True)
    rows[""] = rows["estimator"] + " " + quantity
    rows["here"] = _intervals(rows)
    paper = rows["paper"].where(rows["estimator"] != "RHE - EKF").groupby(rows[""]).first()
    here = rows.pivot(index="", columns="process_noise", values="here")[["printed", "calibrated"]]
    here = here.reindex(rows[""].unique()).rename(
        columns=lambda name: f"{name}, n = {rows['n'].max()}"
    )
    return _table(here.assign(paper=paper.map(_number)).reset_index())


def _verdicts(claims):
    counts = verdict_counts(claims)
    return _list(counts[counts > 0])


def _failed(claims):
    failed = claims[claims["verdict"] == "does not hold"]
    once = failed["kind"].eq(ONE_WAY).map({True: "*", False: ""})
    return _list(failed.set_index(failed["id"] + once)["claim"])


def _departures(claims):
    """Claims that the text as printed and departures from it decide differently."""
    some = claims[claims["kind"].str.startswith("holds ")]
    return _list(pd.Series(some["verdict"].values, some["id"] + " " + some["claim"]))


def _multiplicity(claims):
    n, lost = survivors(claims)
    text = (
        f"{n} verdicts rest on an interval. With the false discovery rate held at 5 % over the "
        f"whole ledger (Benjamini and Yekutieli), {n - len(lost)} remain"
    )
    return textwrap.fill(text + (f"; not {', '.join(lost)}." if lost else "."), 100)


def _changes(claims, before):
    """Claims whose verdict is another than in the last ledger, and why."""
    old = before.set_index("id")
    new = claims.set_index("id")
    both = new.join(old, how="outer").reindex([*dict.fromkeys([*new.index, *old.index])])
    both[["before", "verdict", "kind"]] = both[["before", "verdict", "kind"]].fillna("–")
    rows = both[both["before"] != both["verdict"]].reset_index()
    rows["now"] = rows["verdict"].mask(rows["kind"] == ONE_WAY, rows["verdict"] + "*")
    return _table(rows[["id", "before", "now", "reason"]])


def _multiverse(table):
    return _list(_intervals(table.set_index(table["id"] + " " + table["claim"]), "holds"))


def _faults(table):
    table = table.assign(aim=table["verdict"] == "holds", back=table["back"] == table["n"])
    reported = {"n": "size", "aim": "sum", "back": "sum", "recovery_s_largest": "max"}
    frame = table.groupby("handling").agg(reported).round(1).reset_index()
    return _table(frame.set_axis(_FAULTS, axis=1))


def _means(of, quantity):
    """A function of a table: this quantity of each `of`."""
    return lambda table: _list(_intervals(table[table["quantity"] == quantity].set_index(of)))


_RESULTS = {  # the tables that a result needs, and the function of them that writes it
    "summary": (["table_scenario_a", "table_scenario_b"], _summary),
    "settling": (["table_scenario_a"], _means("weight", "settling time [s]")),
    "verdicts": (["claims"], _verdicts),
    "failed": (["claims"], _failed),
    "departures": (["claims"], _departures),
    "multiplicity": (["claims"], _multiplicity),
    "changes": (["claims", "claims_before"], _changes),
    "multiverse": (["multiverse"], _multiverse),
    "faults": (["table_faults"], _faults),
    "beyond": (["table_beyond"], _means("contestant", "true error, ratio to RHE, W printed")),
    "consistency": (["table_consistency"], _means("estimator", "NEES, mean")),
    "replay": (["table_replay"], _means("estimator", "RMS error of yaw [rad]")),
}

if __name__ == "__main__":
    main()
