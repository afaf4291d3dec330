"""What the built report cannot show: failures, a person's own files, and a page's policy.

tests/browser/test_report.py looks at the report that `make report` has built.
"""

import hashlib
import inspect
import re
from base64 import b64encode
from pathlib import Path

import nbformat
import numpy as np
import pandas as pd
import pytest
from bs4 import BeautifulSoup
from matplotlib.figure import Figure
from nbformat import v4
from PIL import Image
from sphinx.application import Sphinx

import rhec
from docs.site import report
from docs.site.content_policy import with_policy
from notebooks.studies import answer
from rhec import style

ROOT = Path(__file__).parents[2]
DRAWN = ("fig99_line", "fig05_dot", "square", "alone")
TABLES = {"a_table.csv", "table1_times.csv"}


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """A notebook that saved a figure, as the runner leaves it."""
    saved = 'style.save(figure, "fig99_line")\nstyle.save_table(table, "a_table", "One")'
    dots = {"image/png": b64encode(b"dots").decode(), "text/html": "<img>", "text/plain": "Figure"}
    drawn = v4.new_output("display_data", dots)
    save = 'style.save(figure, "fig05_dot")\nstyle.save(figure, "square")'
    more = v4.new_code_cell(save, outputs=[drawn])
    alone = 'style.save(figure, "alone")\nstyle.save_table(table, "table1_times", "Times")'
    claim = v4.new_output("display_data", {"text/html": "<td>B6</td><td>B66</td>"})
    last = v4.new_code_cell(alone, outputs=[drawn, claim])
    widget = {"application/vnd.jupyter.widget-view+json": {"model_id": "x"}, "text/plain": "VBox()"}
    cell = v4.new_code_cell(saved, outputs=[v4.new_output("display_data", widget)])
    words = "# One\n\nFirst.\n\n**Figure 99.** A line, [named](04_scenario_b.ipynb)."
    file = tmp_path_factory.mktemp("executed") / "03_scenario_a.ipynb"
    cells = [v4.new_markdown_cell(words), cell, v4.new_markdown_cell("Made twice."), more, last]
    record = dict(start_time="2026-11-28T09:15:00.123", duration=12.345, parameters=dict(seeds=3))
    metadata = dict(widgets={"application/vnd.jupyter.widget-state+json": {}}, papermill=record)
    nbformat.write(v4.new_notebook(cells=cells, metadata=metadata), file)
    return file


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """A folder with what that notebook saved, and with a person's own files."""
    folder = tmp_path_factory.mktemp("figures")
    for name in DRAWN:
        width_in = style.COLUMN_IN if name == "square" else style.DOUBLE_IN
        style.save(Figure(figsize=(width_in, 2)), name, folder=folder)
    for name in (*TABLES, "mine.csv", "private.txt", "broken.png"):
        (folder / name).write_bytes("ä".encode("latin-1"))
    return folder


@pytest.fixture(scope="module")
def source(executed, figures, tmp_path_factory):
    """What the pages are made of: that notebook, and one which saved nothing."""
    other = executed.with_name("00_start.ipynb")
    nbformat.write(v4.new_notebook(cells=[v4.new_markdown_cell("# Two")]), other)
    source = tmp_path_factory.mktemp("site") / "source"
    report._lay_out(source, [executed, other], figures, live=False)
    return source


def test_what_a_notebook_saved_is_published_alone_in_the_order_of_the_paper(source):
    published = {file.name for file in (source / "figures").iterdir()}
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    of_pages = {*re.findall(r"figures/(\w+\.png)", " ".join(page.read_text() for page in pages))}
    drawn = {f"{name}.{kind}" for name in DRAWN for kind in ("png", "pdf")}
    assert published == {*drawn, *TABLES} | of_pages
    page = (source / "figures.md").read_text()
    assert page.count("**Figure 99.** A line, named.") == 1
    # A picture of the paper that has another caption is numbered by its name, others are not.
    assert "\n**Figure 5.** Made twice." in page and "\nMade twice." in page
    # One as wide as a column stands beside others.
    order = ["## The paper", "fig05_dot.png", "fig99_line.png", "## One", "square.png", "alone.png"]
    places = [page.index(each) for each in (*order, "table1_times.csv", "a_table.csv")]
    assert places == sorted(places)
    assert page.count(":figclass: wide") == 3 and page.count("\n## ") == 3


def test_pages_say_where_results_and_scripts_come_from_and_stand_in_the_menu(source):
    provenance = (source / "provenance.md").read_text()
    for fact in ("Project", "Source", "Commit", "Figures made by", "Machine", "System"):
        assert re.search(rf"^\| {fact} \| [^b'].*[0-9a-f]", provenance, re.M), fact
    run = "[03_scenario_a](notebooks/03_scenario_a.ipynb) | 2026-11-28 09:15:00 | 12.3 | seeds = 3"
    assert f"| {run} |" in provenance
    for package in report.SHOWN:
        assert f"licences/{package}.txt" in provenance
        assert (source / f"licences/{package}.txt").read_text() == report.licence(package)
    parameters = (source / "parameters.md").read_text()
    assert "-p world soft" in parameters and "## [One](notebooks/03_scenario_a.ipynb)" in parameters
    menu = re.search(r"(?s)```{toctree}\n(.*)```", (source / "docs/extending.md").read_text())[1]
    assert "/docs/campaigns\n/docs/performance\n" in menu
    assert len(re.findall("(?m)^<section class=.claim.", (source / "claims.md").read_text())) > 80


def test_a_notebook_shows_its_pictures_once_and_links_its_claims(source):
    laid_out = nbformat.read(source / "notebooks/03_scenario_a.ipynb", 4)
    assert "widgets" not in laid_out.metadata  # their state, which needs a kernel
    _, cell, _, more, last = laid_out.cells
    assert {*more.outputs[0].data} == {"image/png", "text/plain"}
    picture, table = (output.data for output in last.outputs)
    assert re.fullmatch(r"!\[.*\]\(../figures/alone.png\)", picture["text/markdown"])
    assert table["text/html"] == '<td><a href="../claims.html#B6">B6</a></td><td>B66</td>'
    assert "VBox" not in str(cell) and "rhec lab" in str(cell)
    assert cell.metadata["mystnb"]["image"]["alt"] == "Figure 99. A line, named."
    assert cell.metadata["tags"] == ["hide-input"]
    laid_out.metadata["rhec"] = dict(code="open")
    del cell.metadata["tags"]
    report._prepare(laid_out)
    assert "tags" not in cell.metadata


def test_the_cards_are_of_the_ledger_that_was_made_last(executed, figures, tmp_path):
    claims = pd.read_csv(answer.RESULTS / "claims.csv")
    claims.head(3).to_csv(figures / "claims.csv", index=False)
    report._lay_out(tmp_path / "source", [executed], figures, live=False)
    page = (tmp_path / "source/claims.md").read_text()
    assert re.findall('section class="claim" id="(.*?)"', page) == [*claims["id"].head(3)]


def test_on_the_site_verdicts_have_colours_and_lead_to_their_cards(tmp_path):
    readme = tmp_path / "README.md"
    table = "| error | 0.04 | met: 0.04 | EKF lost | does not hold: 8 % | possible: 1 (0 to 2) |"
    bar = "Of 5: [holds: 3](data/results/claims.csv) · [possible: 2](data/results/claims.csv)"
    readme.write_text(f"{table}\n\nIt was met | elsewhere.\n\n{bar}\n")
    report._link_cards(readme)
    page = BeautifulSoup(readme.read_text(), "html.parser")
    words = page.select("span.verdict")
    said = ["met", "EKF lost", "does not hold", "possible", "holds", "possible"]
    assert [word.text for word in words] == said
    colours = [word["style"] for word in words]
    assert colours[0] == colours[4] and colours[3] == colours[5] and len(set(colours)) == 4
    assert [link["href"] for link in page.select("a")] == [
        "claims.html?verdict=holds",
        "claims.html?verdict=possible",
    ]
    # A reader of the text alone misses nothing.
    assert page.get_text().splitlines()[0] == table


@pytest.mark.parametrize("live", [False, True])
def test_a_report_replaces_the_old_one_when_it_is_whole(live, tmp_path, monkeypatch, capsys):
    """Its pictures are smaller ones, its pages have their policy, and it says what it does."""
    old = tmp_path / "far/below/report"
    made = []

    class Builder:
        def __init__(self, source, configuration, site, doctrees, kind, status, tags):
            made.append((source.name, configuration, kind, tags))
            self.site = site

        def build(self):
            assert (old / "old.html").exists() == live
            (self.site / "_images").mkdir(parents=True)
            Image.new("RGB", (4, 4)).save(self.site / "_images/one.png")
            (self.site / "one.html").write_text('<head></head><img src="_images/one.png">')
            (self.site / "theme.css.map").touch()

    monkeypatch.setattr(report, "Sphinx", Builder)
    monkeypatch.setattr(report, "_lay_out", lambda *given: made.append(given[1:]))
    monkeypatch.setattr(report.page, "write", lambda site: (site / "live.html").touch())
    if live:
        old.mkdir(parents=True)
        (old / "old.html").touch()
    report.build(["notebook"], "figures", old, live=live)
    said = capsys.readouterr().out
    (took_s,) = re.findall(rf"report: {1 + live} pages, 0.0 MB, in (\d+) s", said)
    assert int(took_s) < 60
    assert said.count("\n") == 4 + live and ("WebAssembly" in said) == live
    files = {file.relative_to(old).as_posix() for file in old.rglob("*") if file.is_file()}
    assert files == {"one.html", "_images/one.webp"} | ({"live.html"} if live else set())
    page = (old / "one.html").read_text()
    assert "_images/one.webp" in page and "Content-Security-Policy" in page
    tags = ["live"] * live
    assert made == [(["notebook"], "figures", live), ("source", ROOT / "docs", "html", tags)]
    monkeypatch.setattr(Builder, "build", lambda self: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        report.build(["notebook"], "figures", old, live=live)
    assert (old / "one.html").read_text() == page  # one that fails leaves the old one
    assert [file.name for file in old.parent.iterdir()] == ["report"]


def test_the_reference_has_all_public_names():
    text = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"(?m)^   (\w+)$", text))
    assert listed == set(rhec.__all__) - {"WORLDS", "logs"}
    assert "   logs.read\n" in text and "`rhec.WORLDS`" in text


PAGE = r"""# One

$\mu$

$$\kappa = 1$$

| a |
|---|
| 1 |

```{toctree}
two
```

```{eval-rst}
.. autoclass:: rhec.Fault

.. automethod:: rhec.Path.racetrack
```
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A site of a page, of which the reference is a part, and of a notebook."""
    source = tmp_path_factory.mktemp("source")
    (source / "index.md").write_text(PAGE)
    streams = [("stdout", "said\n"), ("stderr", "warned\n"), ("stdout", "more\n")]
    said = [v4.new_output("stream", name=name, text=text) for name, text in streams]
    cells = [v4.new_markdown_cell("# Two"), v4.new_code_cell("print(1)", outputs=said)]
    python = dict(language_info=dict(name="python", pygments_lexer="python"))
    nbformat.write(v4.new_notebook(cells=cells, metadata=python), source / "two.ipynb")
    site = source.parent / "site"
    Sphinx(source, ROOT / "docs", site, source.parent / "doctrees", "html", status=None).build()
    return site


def test_a_page_has_formulas_types_and_outputs_that_all_can_read(site):
    page, notebook = (
        BeautifulSoup((site / name).read_text(), "html.parser")
        for name in ("index.html", "two.html")
    )
    assert [formula["display"] for formula in page.select("math")] == ["inline", "block"]
    one, other = (" ".join(part.get_text().split()) for part in page.select("dt.sig"))
    assert "start_s: float = 0.0, duration_s: float = 1" in one  # without Annotated
    assert "racetrack(row_length_m: float, radius_m: float)" in other
    assert len(page.select("dl[role=list] > dd[role=listitem]")) == 1 + len(
        inspect.signature(rhec.Fault).parameters
    )
    scrolled = [
        part.select("pre, .table-wrapper, .cell_output, div.math") for part in (page, notebook)
    ]
    assert all(part["tabindex"] == "0" for part in sum(scrolled, [])) and all(scrolled)
    assert [part.get_text() for part in notebook.select("pre")] == ["print(1)\n", "said\nmore\n"]
    # A page from the disk can read no other.
    assert "SHOW_SEARCH_SUMMARY: false" in (site / "_static/documentation_options.js").read_text()


def test_a_page_runs_the_scripts_of_its_theme_alone_and_loads_nothing_from_elsewhere(site):
    built = (site / "index.html").read_text()
    assert not list(site.glob("_sources/index*")) and not (site / "genindex.html").exists()
    assert "_sources" not in built
    injected = "document.title = 'RAN'"
    page = with_policy(built.replace("</body>", f"<script>{injected}</script></body>"))
    assert page.index("Content-Security-Policy") < page.index("<title>")
    parsed = BeautifulSoup(page, "html.parser")
    policy = parsed.find("meta", {"http-equiv": "Content-Security-Policy"})["content"]
    directives = dict(directive.split(" ", 1) for directive in policy.split("; "))
    assert directives["default-src"] == "'none'"
    scripts = [script.string for script in parsed.find_all("script", src=False)]
    digests = [b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts]
    assert len(scripts) == 2 and scripts[1] == injected
    assert directives["script-src"].split() == ["'self'", "file:", f"'sha256-{digests[0]}'"]
    assert not re.search("http|unsafe-eval|[*]", policy)


def test_a_picture_of_a_page_keeps_its_colours_over_white(tmp_path):
    colours = np.zeros((16, 16, 4), np.uint8)
    colours[:8] = 0, 114, 178, 255  # below that it is transparent
    Image.fromarray(colours).save(tmp_path / "one.png")
    report._shrink(tmp_path / "one.png")
    (file,) = tmp_path.iterdir()
    with Image.open(file) as picture:
        assert picture.format == "WEBP"
        shown = np.array(picture.convert("RGB"))
    assert (shown[:8] == [0, 114, 178]).all() and (shown[8:] == 255).all()
