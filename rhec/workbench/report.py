"""The report: executed notebooks, figures, tables, claims, documentation, the reference of the
public face and where all of it came from, as one site that needs no network.

    python -m rhec.workbench.report build/notebooks/03_scenario_a.ipynb …

nbconvert turns the notebooks' cells into HTML and pdoc the docstrings, Jinja puts every page into
one frame, matplotlib typesets the formulas (as SVG, in the figures' fonts), so that no page needs a
script. The templates stand in `templates/`.
"""

import argparse
import base64
import contextlib
import importlib.metadata
import itertools
import os
import platform
import re
import shutil
import subprocess
import tempfile
import tomllib
from collections import Counter
from datetime import datetime
from html import escape
from pathlib import Path

import jinja2
import nbformat
import pandas as pd
from bs4 import BeautifulSoup
from markupsafe import Markup
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath, text_to_path
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath
from PIL import Image
from pygments.formatters import HtmlFormatter

from rhec import __version__
from rhec.workbench import reference
from rhec.workbench.plots import style
from rhec.workbench.studies import timing

__all__ = ["Cells", "build", "formula", "tone"]

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = Path(__file__).parent / "templates"
REPORT = ROOT / "build/report"
LONG = 40  # characters: a text in a table that wants room
SCENES = Path(__file__).parent / "live/scenes.toml"  # of the live page, which comes afterwards
LIVE = '<p class="live">Sliders: run <code>make lab</code> and open this notebook.</p>'
# A notebook may be called claims, too.
RESULTS = [f"results-{name}" for name in ("claims", "figures", "tables", "provenance")]
LETTERS = {1: "M", 2: "L", 3: "Q", 4: "C", 79: "Z"}  # of SVG for matplotlib's path codes
FONT = FontProperties(math_fontfamily="stix", size=100)  # a hundredth of it is an em


def formula(tex, display=False):
    """The SVG of a formula, as high as the text around it (1 em), in the text's colour.

    Args:
        tex: TeX, without the dollar signs.
        display: whether it stands on a line of its own.

    Raises:
        ValueError: if mathtext does not know what is in it.
    """
    text = f"${' '.join(tex.split())}$"
    # mathtext has \geq, \leq and \neq by their long names alone
    text = re.sub(r"\\([gln]e)\b", r"\\\1q", text)
    try:
        width, height, depth = text_to_path.get_text_width_height_descent(text, FONT, ismath=True)
        outline = TextPath((0, 0), text, prop=FONT)
    except ValueError as error:
        said = f"it must be TeX that matplotlib's mathtext knows: {str(error).splitlines()[-1]}"
        raise ValueError(f"formula was {tex!r}; {said}") from None
    curves = ""
    for vertices, code in outline.iter_segments(simplify=False, curves=True):
        points = [] if code == 79 else vertices.reshape(-1, 2)
        curves += LETTERS[code] + " ".join(f"{x:.1f},{-y:.1f}" for x, y in points)
    size = f"width: {width / 100:.3f}em; height: {height / 100:.3f}em"
    svg = (
        f'<svg class="formula" role="img" aria-label="{escape(tex.strip())}" '
        f'viewBox="0 {depth - height:.1f} {width:.1f} {height:.1f}" '
        f'style="{size}; vertical-align: {-depth / 100:.3f}em">'
        f'<path fill="currentColor" d="{curves}"/></svg>'
    )
    return f'<span class="display">{svg}</span>' if display else svg


class _Renderer(IPythonRenderer):
    """Markdown as in nbconvert, with its formulas typeset."""

    def inline_math(self, body):
        return formula(body)

    def block_math(self, body):
        return formula(body, display=True)


class Cells(HTMLExporter):
    """A notebook's cells as HTML, without the page around them."""

    def __init__(self):
        super().__init__(template_name="cells", extra_template_basedirs=[str(TEMPLATES)])

    @jinja2.pass_context
    def markdown2html(self, context, source):
        return _markdown(source)


def _markdown(source):
    """Markdown as HTML."""
    return MarkdownWithMath(renderer=_Renderer(escape=False, anchor_link_text="#")).render(source)


def _notebook_page(file, pages):
    """An executed notebook as `_page`, with its first picture (PNG) and its run (times)."""
    notebook = nbformat.read(file, as_version=4)
    _prepare_outputs(notebook)
    try:
        body, _ = Cells().from_notebook_node(notebook)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from None
    run = dict(picture=_first_picture(notebook), run=_run_of(notebook))
    return _page(file.stem, body, pages) | run


def _page(name, body, pages):
    """What a page shows: name, title, lead, contents, body (HTML).

    Links to the notebooks and documents named in `pages` become links to their pages.
    """
    soup = BeautifulSoup(body, "html.parser")
    for link in soup.select("a[href$='.ipynb'], a[href$='.md']"):
        kind = "docs-" if link["href"].endswith(".md") else ""
        target = kind + Path(link["href"]).stem
        if target in pages:
            link["href"] = f"{target}.html"
    for table in soup.select("table"):
        table.attrs.pop("border", None)
        table.wrap(soup.new_tag("div", attrs={"class": "scroll"}))
    for cell in soup.select("td"):
        if len(cell.get_text()) > LONG:
            cell["class"] = "long"
    for old in soup.select("style"):  # pandas' own, for each table
        old.decompose()
    heading = soup.select_one("h1")
    lead = soup.select_one(".markdown p")
    contents = [(h2["id"], _text(h2)) for h2 in soup.select("h2[id]")]
    title = _text(heading) if heading else name
    lead = _text(lead) if lead else ""
    return dict(name=name, title=title, lead=lead, contents=contents, body=Markup(soup))


def _text(tag):
    """The text of an element without its anchor, its formulas in letters."""
    copy = BeautifulSoup(str(tag), "html.parser")
    for extra in copy.select(".anchor-link"):
        extra.decompose()
    for picture in copy.select("svg"):
        tex = re.sub(r"\\mathrm|[{}]", "", picture.get("aria-label", ""))
        picture.replace_with(re.sub(r"\^(\d)", lambda power: "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(power[1])], tex))
    return " ".join(copy.get_text().split())


def _prepare_outputs(notebook):
    """Describe pictures by the text above them, drop progress bars, say where widgets live."""
    above = ""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            above = re.sub(r"[*#`$]", "", cell.source.strip().split("\n\n")[-1])
        if cell.cell_type != "code":
            continue
        outputs = [(output, output.get("data", {})) for output in cell.outputs]
        bars = [re.search(r"\d%\|", data.get("text/plain", "")) for _, data in outputs]
        cell.outputs = [output for output, bar in zip(cell.outputs, bars) if not bar]
        for output, data in outputs:
            if "image/png" in data:
                output.metadata["alt"] = " ".join(above.split())[:200]
            if "application/vnd.jupyter.widget-view+json" in data:
                output.data = nbformat.from_dict({"text/html": LIVE})


def _first_picture(notebook):
    """The first PNG among a notebook's outputs, or None."""
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", []))
    pngs = (output.get("data", {}).get("image/png") for output in outputs)
    first = next(filter(None, pngs), None)
    return first and base64.b64decode(first)


def _run_of(notebook):
    """When and how long a notebook ran, with which parameters, as papermill noted it."""
    noted = notebook.metadata.get("papermill", {})
    seconds = [cell.metadata.get("papermill", {}).get("duration") or 0.0 for cell in notebook.cells]
    run = dict(seconds=noted.get("duration"), slowest_s=max(seconds, default=0.0))
    run["started"] = noted.get("start_time", "")[:19].replace("T", " ")
    run["cells"] = sum(cell.cell_type == "code" for cell in notebook.cells)
    return run | dict(parameters=noted.get("parameters", {}))


def _figures_of(folder):
    """The PNGs of a folder and what each says of itself, as `plots.save` wrote it."""
    found = []
    for file in sorted(folder.glob("*.png")):
        with Image.open(file) as image:
            said = image.info
            (width, height) = image.size
        about = dict(name=file.stem, notebook=Path(said.get("Subject", "")).stem)
        about |= dict(source=style.source_of(file), scenario=said.get("Keywords", ""))
        pdf = file.with_suffix(".pdf").exists()
        found.append(about | dict(width=width, height=height, pdf=pdf))
    return found


def _tables_of(folder):
    """The CSV files of a folder, and the notebook that the LaTeX beside each names."""
    found = []
    for file in sorted(folder.glob("*.csv")):
        tex = file.with_suffix(".tex")
        said = tex.read_text(encoding="utf-8") if tex.exists() else ""
        subject = re.search(r"^% Subject: (.*)$", said, re.M)
        notebook = Path(subject[1]).stem if subject else ""
        about = dict(name=file.stem, notebook=notebook, tex=tex.exists())
        found.append(about | dict(frame=pd.read_csv(file)))
    return found


def _ledger_of(tables):
    """Every table with the columns `claim` and `verdict`: (table, its rows with a claim)."""
    found = []
    for table in tables:
        columns = list(table["frame"])
        if {"claim", "verdict"} <= set(columns):
            columns.insert(columns.index("claim") + 1, columns.pop(columns.index("verdict")))
            rows = table["frame"].dropna(subset=["claim"])[columns]
            found.append((table, rows.dropna(axis="columns", how="all")))
    return found


def tone(verdict):
    """Which of four kinds a verdict is of: good, part (of the interpretations), bad or open."""
    if str(verdict).startswith("holds "):
        return "part"
    return {"holds": "good", "does not hold": "bad"}.get(str(verdict), "open")


def _as_html(frame):
    """A table as HTML: numbers in four digits, verdicts in colour, nothing where nothing is."""

    def cell(value):
        if isinstance(value, float):
            return "" if pd.isna(value) else f"{value:.4g}"
        text = escape(str(value))
        return f'<div class="long">{text}</div>' if len(str(value)) > LONG else text

    def verdict(value):
        return f'<span class="verdict {tone(value)}">{cell(value)}</span>' if cell(value) else ""

    # where a long name may be broken
    frame = frame.rename(columns=lambda name: escape(str(name)).replace("_", "_<wbr>"))
    formatters = {column: verdict if column == "verdict" else cell for column in frame}
    plain = dict(index=False, border=0, escape=False, na_rep="")
    return Markup(frame.to_html(formatters=formatters, **plain))


def _provenance():
    """What the results came from, as pairs (what, value)."""
    ours = (ROOT / ".git").exists()  # not that of a repository around this folder
    describe = ["git", "-C", ROOT, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    commit = ours and subprocess.run(describe, capture_output=True, text=True).stdout.strip()
    return [
        ("Project", f"rhec {__version__}"),
        ("Source", f"{style.source()} (digest of rhec/, notebooks/ and the standard fields)"),
        ("Commit", commit or "no git repository"),
        ("Machine", timing.machine()),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Report made", datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")),
    ]


def _packages():
    """The packages in environment.txt that are installed here: (name, version, pinned version)."""
    pins = (ROOT / "environment.txt").read_text(encoding="utf-8")
    installed = set()
    for name, pinned in re.findall(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)", pins, re.M):
        # others are of another system or Python
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            installed.add((name, importlib.metadata.version(name), pinned))
    return sorted(installed)


def build(notebooks, figures=style.FOLDER, report=REPORT, live=False):
    """Write the site; it replaces the old one only when it is whole.

    Args:
        notebooks: paths of executed notebooks, in the order of the pages.
        figures: folder of the figures and tables that they left.
        report: folder of the site.
        live: whether to link the live page (`python -m rhec.workbench.live.page`).

    Raises:
        ValueError: if a notebook cannot be shown; the old site is left as it was.
    """
    report.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=report.parent, prefix="unfinished-") as folder:
        unfinished = Path(folder) / report.name
        _write_site(notebooks, figures, unfinished, live)
        (unfinished / "report.d").touch()  # for `make clean`
        made = [f"build/report/{file.relative_to(unfinished)}" for file in unfinished.rglob("*.*")]
        (unfinished / "report.d").write_text(f"MADE += {' '.join(made)}\n")
        shutil.rmtree(report, ignore_errors=True)
        unfinished.rename(report)


def _write_site(notebooks, figures, site, live):
    """All pages, and what they show, into a new folder."""
    (site / "notebooks").mkdir(parents=True)
    shutil.copytree(figures, site / "figures")
    for file in notebooks:
        shutil.copy(file, site / "notebooks")

    documents = {f"docs-{file.stem}": file for file in sorted((ROOT / "docs").glob("*.md"))}
    names = [*documents, *(file.stem for file in notebooks)]
    stories = [_notebook_page(file, names) for file in notebooks]
    texts = {name: file.read_text(encoding="utf-8") for name, file in documents.items()}
    docs = [_page(name, _markdown(text), names) for name, text in texts.items()]
    drawn = _figures_of(figures)
    tables = _tables_of(figures)
    (site / "pictures").mkdir()
    for story in stories:
        if story["picture"]:
            (site / f"pictures/{story['name']}.png").write_bytes(story["picture"])
    ledger = _ledger_of(tables)
    # other tables repeat what the ledger says
    counted = [rows for table, rows in ledger if table["name"] == "claims"]
    verdicts = [rows["verdict"].map(tone) for rows in counted or [rows for _, rows in ledger]]
    common = dict(
        stories=stories,
        docs=docs,
        figures=drawn,
        tables=tables,
        ledger=ledger,
        counts=Counter(itertools.chain(*verdicts)),
        version=__version__,
        source=style.source(),
        provenance=_provenance(),
        packages=_packages(),
        environment=sorted({figure["source"] for figure in drawn}),
        live=_scenes() if live else {},
    )
    looks = dict(undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    loader = jinja2.FileSystemLoader(TEMPLATES)
    jinja = jinja2.Environment(loader=loader, autoescape=True, **looks)
    jinja.filters["table"] = _as_html
    jinja.filters["seconds"] = lambda value: "–" if value is None else f"{value:.1f} s"
    jinja.filters["nice"] = lambda name: name.replace("_", " ")

    def write(page, template, **more):
        text = jinja.get_template(f"{template}.html.j2").render(common, page=page, **more)
        (site / f"{page}.html").write_text(text, encoding="utf-8")

    for page in ["index", *RESULTS]:
        write(page, page)
    contents, body = reference.of_the_face()
    write("reference", "reference", contents=contents, body=Markup(body))
    for template, pages in {"story": stories, "document": docs}.items():
        for each in pages:
            write(each["name"], template, **{template: each})
    styles = (HtmlFormatter(style=name) for name in ("friendly", "github-dark"))
    light, dark = (style.get_style_defs(".highlight") for style in styles)
    ours = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    css = f"{light}\n@media (prefers-color-scheme: dark) {{\n{dark}\n}}\n{ours}"
    (site / "report.css").write_text(css, encoding="utf-8")


def _scenes():
    """{notebook: the live page's scene about it}."""
    scenes = tomllib.loads(SCENES.read_text(encoding="utf-8"))
    return {scene["notebook"]: name for name, scene in scenes.items()}


def _main():
    about = (
        "Make build/report/ from executed notebooks, such as build/notebooks/03_scenario_a.ipynb."
    )
    parser = argparse.ArgumentParser(prog="python -m rhec.workbench.report", description=about)
    parser.add_argument("notebooks", metavar="NOTEBOOK", nargs="+", type=Path)
    parser.add_argument("--live", action="store_true", help="link the live page")
    arguments = parser.parse_args()
    try:
        build(arguments.notebooks, live=arguments.live)
    except KeyboardInterrupt:
        parser.exit(130, "report: interrupted; an older one is left as it was\n")
    except ValueError as error:
        parser.exit(1, f"report: {error}\n")
    print(f"report: open {os.path.relpath(REPORT / 'index.html')}")


if __name__ == "__main__":
    _main()
