"""The report: every link and picture is there, nothing is loaded from a network, formulas are
typeset, and it says where results came from.
"""

import json
import re
from pathlib import Path
from urllib.parse import unquote

import nbformat
import numpy as np
import pandas as pd
import pytest
from bs4 import BeautifulSoup
from matplotlib.figure import Figure
from nbformat import v4

import rhec
from rhec.workbench import report
from rhec.workbench.plots import style

ROOT = Path(__file__).parents[2]
PNG = (
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGA"
    "WjR9awAAAABJRU5ErkJggg=="
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A report of two small notebooks, a figure and a table."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "figures").mkdir()
    drawing = Figure()
    drawing.subplots().plot([0, 1])
    style.save(drawing, "fig99_line", rhec.Scenario(), folder / "figures", "one.ipynb")
    claims = pd.DataFrame(
        {
            "quantity": ["error <m>", "yaw"],
            "mean": [0.1, np.nan],
            "claim": ["below 1", ""],
            "verdict": ["holds", ""],
        }
    )
    style.save_table(claims, "table_claims", "Claims", folder / "figures", notebook="one.ipynb")

    timed = {
        "papermill": {
            "duration": 1.25,
            "start_time": "2026-01-02T03:04:05+00:00",
            "parameters": {"seed": 7},
        }
    }
    outputs = [
        v4.new_output(
            "display_data",
            {"image/png": PNG, "text/plain": "a picture"},
            metadata={"image/png": {"width": 340, "height": 200}},
        ),
        v4.new_output("execute_result", {"text/html": claims.to_html(), "text/plain": "a table"}),
        v4.new_output(
            "display_data",
            {"application/vnd.jupyter.widget-view+json": {"model_id": "x"}, "text/plain": "VBox()"},
        ),
        v4.new_output("display_data", {"application/javascript": "alert(1)", "text/plain": "js"}),
        v4.new_output(
            "display_data",
            {
                "application/vnd.jupyter.widget-view+json": {"model_id": "y"},
                "text/plain": "  0%|          | 0/9 [00:00<?]",
            },
        ),
        v4.new_output("stream", name="stderr", text="a warning"),
    ]
    one = v4.new_notebook(
        metadata=timed,
        cells=[
            v4.new_markdown_cell(
                "# One: the $Q^3$ story\n\nWhat it *shows*, see [the other](06_claims.ipynb).\n\n"
                "## First & last\n\n"
                "Here $\\dot x = \\mu\\nu$ and $$\\frac{1}{2}$$"
            ),
            v4.new_code_cell(
                "1 < 2",
                metadata={"tags": ["solution"], "jupyter": {"source_hidden": True}},
                outputs=outputs,
                execution_count=1,
            ),
        ],
    )
    two = v4.new_notebook(cells=[v4.new_markdown_cell("# Two")])
    for name, notebook in [("one", one), ("claims", two)]:
        nbformat.write(notebook, folder / f"{name}.ipynb")
    report.build(
        [folder / "one.ipynb", folder / "06_claims.ipynb"], folder / "figures", folder / "report"
    )
    return folder / "report"


def pages(site):
    return {
        file.name: BeautifulSoup(file.read_text(encoding="utf-8"), "html.parser")
        for file in site.glob("*.html")
    }


def test_every_link_and_picture_is_there(site):
    found = pages(site)
    assert {
        "index.html",
        "one.html",
        "06_claims.html",
        "results-figures.html",
        "results-tables.html",
        "results-06_claims.html",
        "results-provenance.html",
        "reference.html",
        *(f"docs-{file.stem}.html" for file in (ROOT / "docs").glob("*.md")),
    } == set(found)
    for name, soup in found.items():
        for tag in soup.select("[href], [src]"):
            target = unquote(tag.get("href") or tag.get("src"))
            if target.startswith("data:"):
                continue
            file, _, fragment = target.partition("#")
            assert not re.match("[a-z]+:|/", target), f"{name} leaves the report: {target}"
            assert not file or (site / file).is_file(), f"{name}: {target}"
            if fragment:
                assert found[file or name].find(id=fragment), f"{name}: {target}"


def test_nothing_is_loaded_from_a_network_and_nothing_runs(site):
    for name, soup in pages(site).items():
        assert not soup.select("script, iframe, object, embed"), name
        assert not soup.find_all(
            lambda tag: any(attribute.startswith("on") for attribute in tag.attrs)
        ), name
    assert not re.search(r"url\(|@import", (site / "report.css").read_text(encoding="utf-8"))


def test_formulas_are_typeset_and_can_be_read_aloud(site):
    story = pages(site)["one.html"]
    assert [svg["aria-label"] for svg in story.select("article svg.formula")] == [
        "Q^3",
        r"\dot x = \mu\nu",
        r"\frac{1}{2}",
    ]
    assert "$" not in story.select_one("article .markdown").get_text()


def test_the_formula_stands_on_the_line():
    def depth(tex):
        return float(re.search(r"vertical-align: (-?[\d.]+)em", report.formula(tex))[1])

    assert depth("x") == pytest.approx(0, abs=0.02)
    assert depth(r"\frac{1}{2}") < -0.2
    assert report.formula(r"a \ge b").count("<path") == 1
    with pytest.raises(
        ValueError,
        match=r"formula was '\\\\nonsense'; it must be TeX that matplotlib's mathtext knows",
    ):
        report.formula(r"\nonsense")


@pytest.mark.parametrize(
    "file", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda file: file.stem
)
def test_every_formula_in_the_notebooks_can_be_typeset(file):
    notebook = nbformat.read(file, as_version=4)
    html, _ = report.Cells().from_notebook_node(notebook)
    prose = BeautifulSoup(html, "html.parser")
    assert not re.search(
        r"\$[^$]+\$|\\begin", " ".join(section.get_text() for section in prose.select(".markdown"))
    )


def test_widgets_and_scripts_say_where_they_live(site):
    text = pages(site)["one.html"].select_one("article").get_text()
    assert text.count("make lab") == 2 and "VBox" not in text and "alert" not in text


def test_pictures_have_a_description_and_a_size(site):
    for name, soup in pages(site).items():
        assert all("alt" in picture.attrs for picture in soup.select("img")), name
    picture = pages(site)["one.html"].select_one("article img")
    assert "Here" in picture["alt"] and picture["style"] == "--w: 340"


def test_tables_stay_text(site):
    table = pages(site)["results-06_claims.html"].select_one("table")
    assert table.select_one("td").get_text() == "error <m>"
    assert table.select_one(".verdict.good").get_text() == "holds"
    assert len(table.select("tbody tr")) == 1  # the row without a claim is none
    assert [
        report.tone(verdict)
        for verdict in ("holds", "holds under printed", "does not hold", "undecided")
    ] == ["good", "part", "bad", "open"]
    assert "1 hold" in pages(site)["index.html"].select_one(".counts").get_text()


def test_it_says_where_the_results_came_from(site):
    text = pages(site)["results-provenance.html"].get_text()
    for said in [
        "2026-01-02 03:04:05",
        "1.2 s",
        "{'seed': 7}",
        f"rhec {rhec.__version__}, source ",
        "Commit",
        "Machine",
        "numpy",
    ]:
        assert said in text
    assert (
        json.loads(pages(site)["results-figures.html"].select_one("#fig99_line code").get_text())[
            "seed"
        ]
        == 0
    )
    assert (site / "notebooks/one.ipynb").is_file()


def test_the_reference_shows_the_public_face(site):
    article = pages(site)["reference.html"].select_one("article")
    for name in (*(name for name in rhec.__all__ if name != "logs"), "logs.read"):
        shown = article.find(id=name)
        assert name.split(".")[-1] in shown.select_one(".attr").get_text(), name
        assert shown.select_one(".docstring").get_text().strip(), name
    assert "duration_s" in article.find(id="Scenario").get_text()
    assert "FieldInfo" not in article.get_text()
    assert pages(site)["index.html"].select_one("nav a[href='reference.html']")


def test_a_report_that_fails_leaves_the_old_one(site, tmp_path):
    old = tmp_path / "report"
    old.mkdir()
    (old / "index.html").write_text("old")
    nbformat.write(
        v4.new_notebook(cells=[v4.new_markdown_cell(r"$\nonsense$")]), tmp_path / "bad.ipynb"
    )
    with pytest.raises(ValueError, match="bad.ipynb: formula was .*nonsense"):
        report.build([tmp_path / "bad.ipynb"], site / "figures", old)
    assert (old / "index.html").read_text() == "old"
