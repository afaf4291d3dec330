"""`make article`: the article "[Re] …" as build/article.pdf, by Typst.

All its numbers come from the tables in data/results/ and from `rhec.paper`, its figures from
figures/.
"""

import json
import re
import sys

import pandas as pd
import typst

from notebooks.claims.summary import verdict_counts
from notebooks.declared import ROOT
from notebooks.further import unknowns
from notebooks.studies import answer
from notebooks.studies.tables import interval_texts
from rhec import paper

_SOURCE = "docs/article/article.typ"


def tables():
    """The article's tables: {name: DataFrame of texts}; the first column names the rows."""
    table = pd.read_csv(answer.RESULTS / "table_scenario_b.csv")
    return dict(
        answer=pd.DataFrame({"": ["Scenario B"], "in short": [answer.in_short(table)]}),
        summary=answer.paper_beside_ours(),
        scenario_b=answer.scenario_b_numbers(table),
        turns=answer.by_turns(table).loc[:, :"in fields"],
        weights=_weights(),
        scenario_a=_scenario_a(),
        times=_times(),
        ledger=_ledger(),
        verdicts=_verdicts(),
        statements=_statements(),
        worth=_worth(),
        faults=_faults(),
    )


def _verdicts():
    """How many claims of the ledger have each verdict."""
    return verdict_counts(pd.read_csv(answer.RESULTS / "claims.csv")).reset_index().astype(str)


def _weights():
    """The two ratios behind the paper's words on the weights of Scenario A."""
    rows = pd.read_csv(answer.RESULTS / "table_scenario_a.csv").dropna(subset="verdict")
    names = rows["weight"] + ", " + rows["quantity"]
    return pd.DataFrame({"ratio": names, "here": interval_texts(rows), "verdict": rows["verdict"]})


def _scenario_a():
    """Means of Scenario A for each weight."""
    rows = pd.read_csv(answer.RESULTS / "table_scenario_a.csv")
    rows = rows[rows["weight"].isin(["Q1", "Q2", "Q3"])]
    cells = rows.assign(text=interval_texts(rows))
    quantities = rows["quantity"].unique()
    shown = cells.pivot(index="quantity", columns="weight", values="text").loc[quantities]
    return shown.reset_index()


def _times():
    """Table 1 of the paper, in its milliseconds."""
    rows = {
        f"{problem}, {phase}": dict(zip(("minimum", "average", "maximum"), map(str, times)))
        for (problem, phase), times in paper.TABLE_1_MS.items()
    }
    return pd.DataFrame(rows).T.rename_axis("phase [ms]").reset_index()


def _ledger():
    """Every claim with its number and its verdict."""
    claims = pd.read_csv(answer.RESULTS / "claims.csv")
    unit = claims["unit"].where(~claims["unit"].isin(["-", "ratio"]), "").fillna("")
    here = (interval_texts(claims, "value") + " " + unit).str.strip()
    columns = dict(id=claims["id"], sentence=claims["claim"], here=here.fillna(""))
    return pd.DataFrame(columns | dict(verdict=claims["verdict"]))


def _statements():
    """Shares of single drives that meet what the paper states, before and after it is known."""
    shares = pd.read_csv(answer.RESULTS / "inverse_statements.csv")
    columns = {"what the paper states": shares["statement"]}
    for when in ("prior", "posterior"):
        numbers = [f"{when} drives{end}" for end in ("", "_low", "_high")]
        columns[f"share of the {when}"] = interval_texts(shares, *numbers)
    return pd.DataFrame(columns)


def _worth():
    """Ratios of the true error with an unknown to that without it, in the default world."""
    rows = pd.read_csv(answer.RESULTS / "table_unknowns.csv")
    rows = rows[(rows["world"] == unknowns.DEFAULT) & (rows["quantity"] == unknowns.RATIO)]
    # Near 1 they differ in the third decimal.
    cells = rows.assign(text=interval_texts(rows, number="{:.3f}".format))
    shown = cells.pivot_table("text", "robot", "weights", aggfunc="first", sort=False)
    return shown.rename_axis("unknown").reset_index()


def _faults():
    """Cases of faults with the RHE and with the EKF."""
    cases = pd.read_csv(answer.RESULTS / "table_faults.csv")
    cases["recovered"] = cases["back"] == cases["n"]
    cases["within the aim"] = cases["verdict"] == "holds"
    by_estimator = cases.groupby("estimator")
    counts = by_estimator[["recovered", "within the aim"]].sum().assign(cases=by_estimator.size())
    return counts.reset_index().astype(str)


def _for_typst(table):
    """A table with its header, and its cells by the first of their row and by their column."""
    rows = {row.iloc[0]: row.to_dict() for _, row in table.iterrows()}
    return dict(table=[list(table), *table.to_numpy().tolist()], rows=rows)


def write(root=ROOT):
    """Write build/article.pdf; the same inputs give the same bytes.

    Args:
        root: Folder with the article, and with the figures of `make figures studies`.

    Returns:
        The path of the PDF.

    Raises:
        FileNotFoundError: If a figure is missing.
    """
    source = (root / _SOURCE).read_text(encoding="utf-8")
    for name in re.findall(r'#picture\("(\w+)"', source):
        if not (root / f"figures/{name}.pdf").exists():
            raise FileNotFoundError(f"figures/{name}.pdf is missing: make figures studies makes it")
    cells = {name: _for_typst(table) for name, table in tables().items()}
    numbers = {name: value for name, value in vars(paper).items() if isinstance(value, int | float)}
    output = root / "build/article.pdf"
    output.parent.mkdir(exist_ok=True)
    inputs = dict(results=json.dumps(cells), constants=json.dumps(numbers))
    typst.compile(root / _SOURCE, output=output, root=root, sys_inputs=inputs)
    return output


def main(root=ROOT):
    """Write the article and say where it is, or end with what is missing."""
    try:
        print(f"article: {write(root).relative_to(root)}")
    except FileNotFoundError as error:
        sys.exit(f"article: {error}")


if __name__ == "__main__":
    main()
