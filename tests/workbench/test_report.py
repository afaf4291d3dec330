"""The report: every link, anchor and picture is there, nothing is loaded from a network, formulas
need no script, counts of verdicts agree, and it says where results came from.
"""

import hashlib
import importlib.util
import re
from base64 import b64encode
from pathlib import Path
from urllib.parse import unquote

import nbformat
import pandas as pd
import pytest
from bs4 import BeautifulSoup
from matplotlib.figure import Figure
from nbformat import v4

import rhec
from rhec.workbench import report, results
from rhec.workbench.content_policy import with_policy
from rhec.workbench.plots import style
from rhec.workbench.studies.claims.summary import BY_DERIVATION, TESTED, verdict_counts

ROOT = Path(__file__).parents[2]
PNG = (
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGA"
    "WjR9awAAAABJRU5ErkJggg=="
)
WIDGET = "application/vnd.jupyter.widget-view+json"


ROW = pd.read_csv(ROOT / "data/results/claims.csv").iloc[0].to_dict()


def claim(name, verdict, basis=TESTED, value=0.1):
    """A row of the ledger."""
    of_rule = dict(claim=f"error <{name}>", test="rule", section="Scenario B", unit="m")
    numbers = dict(value=value, low=value - 0.01, high=value + 0.01, n=7, paper=0.2, why="so")
    return ROW | dict(id=name, verdict=verdict, basis=basis) | of_rule | numbers


LEDGER = pd.DataFrame(
    [
        claim("B5", "holds"),
        claim("B6", "holds", BY_DERIVATION),
        claim("B7", "does not hold"),
        claim("B8", "holds only with W calibrated"),
        claim("B9", "does not hold", BY_DERIVATION),
    ]
)


def notebook_with_all_outputs():
    """A notebook whose one cell left everything that a cell can leave."""
    outputs = [
        v4.new_output(
            "display_data",
            {"image/png": PNG, "text/plain": "a picture"},
            metadata={"image/png": {"width": 340, "height": 200}},
        ),
        v4.new_output("execute_result", {"text/html": LEDGER.to_html(), "text/plain": "a table"}),
        v4.new_output("display_data", {WIDGET: {"model_id": "x"}, "text/plain": "VBox()"}),
        v4.new_output("display_data", {WIDGET: {"model_id": "y"}, "text/plain": "  0%|     | 0/9"}),
        v4.new_output("stream", name="stderr", text=f"{ROOT}/x.py:1: RuntimeWarning: invalid"),
    ]
    story = '# One: the $Q^3$ story\n\n## "First" & $W$ last\n\nHere $\\dot x = \\mu\\nu$ and'
    timed = dict(duration=1.25, start_time="2026-01-02T03:04:05+00:00", parameters={"seed": 7})
    return v4.new_notebook(
        metadata={"papermill": timed},
        cells=[
            v4.new_markdown_cell(
                f"{story}\n\n$$\\frac{{1}}{{2}}$$\n\n**Figure 99.** A line, [named](claims.ipynb)."
            ),
            v4.new_code_cell(
                'save(figure, "fig99_line")',
                metadata={"tags": ["solution"]},
                outputs=outputs,
                execution_count=1,
            ),
        ],
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A report of two small notebooks, a figure and two tables."""
    folder = tmp_path_factory.mktemp("site")
    figures = folder / "figures"
    drawing = Figure()
    drawing.subplots().plot([0, 1])
    for name in ("fig99_line", "fig08_errors", "fig01_robot_in_row"):
        style.save(drawing, name, rhec.Scenario(), figures, "one.ipynb")
    style.save_table(LEDGER, "claims", "Claims", figures, notebook="one.ipynb")
    means = [dict(estimator="RHE", quantity="yaw", mean=0.123456, low=0.1, high=0.2)]
    style.save_table(pd.DataFrame(means), "table_means", "Means", figures, notebook="one.ipynb")
    two = v4.new_notebook(cells=[v4.new_markdown_cell("# Two")])
    nbformat.write(notebook_with_all_outputs(), folder / "one.ipynb")
    nbformat.write(two, folder / "claims.ipynb")
    report.build([folder / "one.ipynb", folder / "claims.ipynb"], figures, folder / "report")
    return folder / "report"


@pytest.fixture(scope="module")
def pages(site):
    files = sorted(site.rglob("*.html"))
    return {
        file.relative_to(site).as_posix(): BeautifulSoup(file.read_text("utf-8"), "html.parser")
        for file in files
    }


def test_the_pages_are_these(pages):
    own = ("index", "figures", "tables", "claims", "provenance", "search", "README", "CONTRIBUTING")
    expected = {f"{name}.html" for name in own} | {"CHANGELOG.html", "SECURITY.html"}
    expected |= {"notebooks/one.html", "notebooks/claims.html"}
    docs = {file.stem for file in (ROOT / "docs").glob("*.md")} - {"index"}
    assert set(pages) == expected | {f"docs/{name}.html" for name in docs}


def test_every_link_anchor_and_picture_is_there(site, pages):
    for name, soup in pages.items():
        for tag in soup.select("[href], [src]"):
            target = unquote(tag.get("href") or tag.get("src"))
            if target.startswith(("data:", "https://", "mailto:")):
                assert tag.name == "a" or target.startswith("data:"), f"{name} loads {target}"
                continue
            file, _, fragment = target.partition("#")
            place = (
                ((site / name).parent / file.partition("?")[0]).resolve() if file else site / name
            )
            assert place.is_file(), f"{name}: {target}"
            if fragment and place.suffix == ".html":
                linked = pages[place.relative_to(site.resolve()).as_posix()] if file else soup
                assert linked.find(id=fragment), f"{name}: {target}"


def test_nothing_is_loaded_from_a_network(site):
    for file in [*site.rglob("*.css"), *site.rglob("*.html")]:
        text = file.read_text("utf-8")
        assert not re.search(
            r"url\(['\"]?(https?:)?//|@import|(src|action)=\"(https?:)?//", text
        ), file


def test_the_paper_and_the_licence_are_linked(pages):
    links = [link["href"] for link in pages["index.html"].select("article a")]
    assert "https://doi.org/10.1002/rob.21794" in links
    assert any(link.endswith("/LICENSE") for link in links)
    assert any(link.endswith("/CITATION.cff") for link in links)


def test_headings_claims_and_figures_have_anchors(pages):
    for name, soup in pages.items():
        for heading in soup.select("article h2, article h3"):
            assert heading.find_parent("section").get("id"), name
    assert all(pages["claims.html"].find(id=each) for each in LEDGER["id"])
    caption = pages["figures.html"].select_one("figure#fig99-line figcaption").get_text()
    assert caption.strip().startswith("Figure 99. A line, named.")
    assert pages["notebooks/one.html"].find(id="fig99_line")


def test_the_figures_of_the_paper_come_first_and_in_its_order(pages):
    figures = [figure["id"] for figure in pages["figures.html"].select("figure")]
    assert figures == ["fig01-robot-in-row", "fig08-errors", "fig99-line"]


def counts_of(soup):
    """The table of verdicts of a page."""
    (table,) = [t for t in soup.select("table") if t.select_one("th").get_text() == "verdict"]
    rows = [[cell.get_text() for cell in row.select("td")] for row in table.select("tbody tr")]
    return {label: list(map(int, counts)) for label, *counts in rows}


def test_every_page_has_the_counts_of_the_ledger(pages):
    assert counts_of(pages["claims.html"]) == verdict_counts(LEDGER).T.to_dict("list")
    text = (ROOT / "README.md").read_text("utf-8")
    readme = dict(re.findall(r"<!-- results (\w+) -->\n(.*?)<!-- end -->", text, re.DOTALL))
    rows = [row.strip("| ").split(" | ") for row in readme["verdicts"].splitlines()[2:]]
    counts = {label: list(map(int, counts)) for label, *counts in rows}
    assert counts_of(pages["index.html"]) == counts_of(pages["README.html"]) == counts


def test_a_claim_says_what_its_verdict_rests_on(pages):
    cards = {card["id"]: card for card in pages["claims.html"].select("section.claim")}
    said = {name: card.select_one(".claim-verdict").get_text() for name, card in cards.items()}
    assert [*cards] == [*LEDGER["id"]]
    assert "holds" in said["B5"] and TESTED in said["B5"] and BY_DERIVATION in said["B6"]
    assert "does not hold" in said["B9"] and BY_DERIVATION in said["B9"]
    assert "fixed before the run" not in pages["claims.html"].get_text()
    assert "error <B5>" in cards["B5"].h3.get_text()
    assert "0.100 [0.0900, 0.110] m" in cards["B5"].get_text()


def test_formulas_need_no_script(pages):
    story = pages["notebooks/one.html"]
    formulas = [math.get_text() for math in story.select("article math")]
    assert len(formulas) == 4 and not any("\\" in formula for formula in formulas)
    assert story.select_one("article math mfrac")
    assert "$" not in story.select_one("article").get_text().replace("$Q^3$", "")


@pytest.mark.parametrize(
    "file", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda file: file.stem
)
def test_every_formula_in_the_notebooks_can_be_typeset(file):
    convert = importlib.import_module("latex2mathml.converter").convert
    for cell in nbformat.read(file, as_version=4).cells:
        if cell.cell_type == "markdown":
            for tex in re.findall(r"\$\$?([^$]+)\$", cell.source):
                assert "\\" not in BeautifulSoup(convert(tex), "html.parser").get_text(), tex


def test_no_page_shows_a_path_a_warning_or_what_only_a_kernel_can_show(pages):
    story = pages["notebooks/one.html"].select_one("article").get_text()
    assert "VBox" not in story and "0/9" not in story and "make lab" in story
    for name, soup in pages.items():
        text = soup.select_one("body").get_text()
        assert not re.search(r"Warning: |site-packages|Traceback \(most|/home/\w|/tmp/\w", text), (
            name
        )
        assert not soup.select(".stderr"), name


def test_pictures_have_a_description(pages):
    for name, soup in pages.items():
        assert all(picture.get("alt") for picture in soup.select("article img")), name
    picture = pages["notebooks/one.html"].select_one("article img")
    assert picture["alt"] == "Figure 99. A line, named." and "340" in str(picture)


def test_tables_are_read_by_people(pages):
    shown = results.readable(pd.DataFrame([dict(a="x", mean=0.123456, low=0.1, high=0.2, b=None)]))
    assert shown.to_dict("records") == [dict(a="x", mean="0.123 [0.1, 0.2]")]
    table = pages["tables.html"].find(id="table-means").select_one("table.dataframe")
    assert [cell.get_text() for cell in table.select("th, td")] == [
        "estimator",
        "yaw",
        "RHE",
        "0.123 [0.1, 0.2]",
    ]
    for name in ("tables", "provenance", "docs/results"):
        heads = pages[f"{name}.html"].select("article thead th")
        assert heads and all(head.get_text().strip() for head in heads), name


def test_it_says_where_the_results_came_from(pages):
    text = pages["provenance.html"].get_text()
    version = f"rhec {rhec.__version__}"
    run = ["2026-01-02 03:04:05", "1.25", "seed = 7"]
    for word in [*run, version, style.source(), "Commit", "Machine", "numpy"]:
        assert word in text


def test_the_reference_shows_the_public_face_with_plain_types(pages):
    reference = pages["docs/reference.html"]
    for name in set(rhec.__all__) - {"WORLDS"}:
        anchor = "rhec.logs.read" if name == "logs" else f"rhec.{name}"
        shown = reference.find(id=anchor)
        assert shown and shown.find_next("dd").get_text().strip(), name
    assert "rhec.WORLDS" in reference.get_text()  # data, explained in the page on the world
    assert "duration_s" in reference.find(id="rhec.Scenario").get_text()
    assert "FieldInfo" not in reference.get_text() and "Annotated" not in reference.get_text()


def test_a_report_that_fails_leaves_the_old_one(site, tmp_path):
    old = tmp_path / "report"
    old.mkdir()
    (old / "index.html").write_text("old")
    (tmp_path / "bad.ipynb").write_text("no notebook")
    with pytest.raises(nbformat.reader.NotJSONError):
        report.build([tmp_path / "bad.ipynb"], site.parent / "figures", old)
    assert (old / "index.html").read_text() == "old"
    assert not list(tmp_path.glob("unfinished-*"))


def test_a_page_runs_its_own_scripts_alone_and_loads_nothing_from_elsewhere():
    own = "document.body.dataset.theme = 'auto';"
    page = with_policy(f"<html><head><title>t</title></head><body><script>{own}</script></body>")
    assert page.index("Content-Security-Policy") < page.index("<title>")
    policy = BeautifulSoup(page, "html.parser").find("meta")["content"]
    directives = dict(directive.split(" ", 1) for directive in policy.split("; "))
    assert directives["default-src"] == "'none'"
    digest = b64encode(hashlib.sha256(own.encode()).digest()).decode()
    assert directives["script-src"].split() == ["'self'", "file:", f"'sha256-{digest}'"]
    assert not re.search("http|unsafe-eval|[*]", policy)
