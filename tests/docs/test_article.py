"""The article: every number is a cell of a result or a number of the paper, and bytes repeat."""

import functools
import re
import shutil

import pandas as pd
import pytest

from docs.article import article
from notebooks.further import unknowns
from rhec import paper

SOURCE = (article.ROOT / "docs/article/article.typ").read_text(encoding="utf-8")
PROSE = SOURCE[SOURCE.index("#align(center)") :]
# Digits that are no results: the confidence, names of claims, and units of layout.
ALLOWED = re.compile(
    r"95 %|`[^`]*`|\$[^$]*\$|@\w+|#picture\([^)]*\)|widths?: \([^)]*\)|widths?: \d+%|size: \d+pt"
    r'|#(?:cell|paper)\((?:"[^"]*"(?:,\s*)?)+\)|#result\("\w+"|inset: \([^)]*\)'
)


def test_no_number_of_the_prose_is_written_by_hand():
    left = ALLOWED.sub("", PROSE)
    assert not re.findall(r"[^\n]*\d[^\n]*", left)


@functools.cache
def tables():
    return {name: table.set_index(table.columns[0]) for name, table in article.tables().items()}


def test_a_case_that_one_drive_does_not_come_back_from_is_not_recovered(tmp_path, monkeypatch):
    cases = dict(estimator="RHE", verdict="fails", back=[20, 19, 0], n=20)
    pd.DataFrame(cases).to_csv(tmp_path / "table_faults.csv", index=False)
    monkeypatch.setattr(article.answer, "RESULTS", tmp_path)
    assert article._faults()["recovered"].tolist() == ["1"]


def test_the_same_inputs_give_the_same_bytes_and_a_missing_figure_is_named(tmp_path):
    from matplotlib.figure import Figure

    project = tmp_path
    shutil.copytree(article.ROOT / "docs/article", project / "docs/article")
    (project / "figures").mkdir()
    with pytest.raises(SystemExit, match=r"^article: figures/fig01_robot_in_row\.pdf is missing: "):
        article.main(project)
    for name in re.findall(r'#picture\("(\w+)"', SOURCE):
        Figure(figsize=(2, 1)).savefig(project / f"figures/{name}.pdf")
    first = article.write(project).read_bytes()
    assert first.startswith(b"%PDF") and article.write(project).read_bytes() == first


def result(name):
    return pd.read_csv(article.answer.RESULTS / f"{name}.csv")


def numbers_of_results():
    """{table: {(row, column): the number of the result}}"""
    shares = result("inverse_statements").set_index("statement")
    worth = result("table_unknowns")
    worth = worth[(worth["world"] == unknowns.DEFAULT) & (worth["quantity"] == unknowns.RATIO)]
    means = result("table_scenario_a").query("weight in ('Q1', 'Q2', 'Q3')")
    faults = result("table_faults").assign(cases=True)
    faults["recovered"] = faults["back"] / faults["n"] == 1
    faults["within the aim"] = faults["verdict"] == "holds"
    counts = faults.groupby("estimator")[["cases", "recovered", "within the aim"]].sum()
    return dict(
        statements={
            (row, f"share of the {when}"): share
            for when in ("prior", "posterior")
            for row, share in shares[f"{when} drives"].items()
        },
        ledger={(row.id, "here"): row.value for row in result("claims").itertuples()},
        worth={(row.robot, row.weights): row.mean for row in worth.itertuples()},
        faults=counts.stack().to_dict(),
        scenario_a={(row.quantity, row.weight): row.mean for row in means.itertuples()},
        times={
            (", ".join(of), column): time
            for of, times in paper.TABLE_1_MS.items()
            for column, time in zip(("minimum", "average", "maximum"), times)
        },
    )


@pytest.mark.parametrize("name", numbers_of_results())
def test_each_cell_of_a_table_begins_with_the_number_of_its_result(name):
    """Ratios near 1 to three decimals, others to three digits."""
    table = tables()[name]
    numbers = numbers_of_results()[name]
    assert {*table.index} == {row for row, _ in numbers}
    for (row, column), number in numbers.items():
        shown = re.match(r"[−\d.e]*", table.loc[row, column])[0].replace("−", "-")
        precision = dict(abs=6e-4) if name == "worth" else dict(rel=6e-3)
        assert float(shown or "nan") == pytest.approx(number, nan_ok=True, **precision)


def test_a_number_of_the_ledger_has_its_unit_if_it_has_one():
    here = tables()["ledger"]["here"]
    claims = result("claims").dropna(subset=["value", "unit"]).set_index("id")
    for id_, unit in claims["unit"].items():
        assert here[id_].endswith(f" {unit}") == (unit not in ("-", "ratio")), id_
    assert {"-", "ratio", "m"} <= {*claims["unit"]}
