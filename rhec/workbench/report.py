"""The report: executed notebooks, figures, tables, claims and where all of it came from, as one
site that needs no network.

    python -m rhec.workbench.report build/notebooks/scenario_a.ipynb …

nbconvert turns the notebooks' cells into HTML, Jinja puts every page into one frame, matplotlib
typesets the formulas (as SVG, in the figures' fonts), so that no page needs a script. The templates
stand in `templates/`.
"""

import argparse
import base64
import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
import tempfile
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
from rhec.plots import style
from rhec.studies import timing

ROOT = Path(__file__).resolve().parents[2]
TEMPLATES = Path(__file__).parent / "templates"
REPORT = ROOT / "build/report"
LONG = 40  # characters: a text in a table that wants room
LIVE = '<p class="live">Sliders, and pictures that follow them: run <code>make lab</code> and open this notebook.</p>'
FONT = FontProperties(math_fontfamily="stix", size=100)  # a hundredth of it is an em


# Formulas


def formula(tex, display=False):
    """The SVG of a formula, as high as the text around it (1 em), in the text's colour. Raises a
    ValueError for what mathtext does not know.
    """
    text = f"${' '.join(tex.split())}$"
    text = re.sub(
        r"\\([gln]e)\b", r"\\\1q", text
    )  # mathtext has \geq, \leq and \neq by their long names alone
    try:
        width, height, depth = text_to_path.get_text_width_height_descent(text, FONT, ismath=True)
        outline = TextPath((0, 0), text, prop=FONT)
    except ValueError as error:
        raise ValueError(
            f"formula was {tex!r}; it must be TeX that matplotlib's mathtext knows: {str(error).splitlines()[-1]}"
        ) from None
    letters = {1: "M", 2: "L", 3: "Q", 4: "C", 79: "Z"}
    curves = "".join(
        letters[code]
        + ("" if code == 79 else " ".join(f"{x:.1f},{-y:.1f}" for x, y in vertices.reshape(-1, 2)))
        for vertices, code in outline.iter_segments(simplify=False, curves=True)
    )
    svg = (
        f'<svg class="formula" role="img" aria-label="{escape(tex.strip())}" viewBox="0 {depth - height:.1f} {width:.1f} {height:.1f}" '
        f'style="width: {width / 100:.3f}em; height: {height / 100:.3f}em; vertical-align: {-depth / 100:.3f}em">'
        f'<path fill="currentColor" d="{curves}"/></svg>'
    )
    return f'<span class="display">{svg}</span>' if display else svg


class Renderer(IPythonRenderer):
    """Markdown as in nbconvert, with its formulas typeset."""

    def inline_math(self, body):
        return formula(body)

    def block_math(self, body):
        return formula(body, display=True)


class Cells(HTMLExporter):
    """A notebook's cells as HTML, without the page around them."""

    def __init__(self):
        super().__init__(template_name="cells", extra_template_basedirs=[str(TEMPLATES)])

    def markdown2html(self, context, source):
        return MarkdownWithMath(renderer=Renderer(escape=False, anchor_link_text="#")).render(
            source
        )

    markdown2html = jinja2.pass_context(markdown2html)


# Pages


def notebook_page(file, pages):
    """What the report shows of an executed notebook: name, title, lead, contents, body (HTML),
    first picture (PNG), run (times). pages: all names.
    """
    notebook = nbformat.read(file, as_version=4)
    prepare_outputs(notebook)
    try:
        body, _ = Cells().from_notebook_node(notebook)
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from None
    soup = BeautifulSoup(body, "html.parser")
    for link in soup.select("a[href$='.ipynb']"):
        name = Path(link["href"]).stem
        if name in pages:
            link["href"] = f"{name}.html"
    for table in soup.select("table"):
        table.attrs.pop("border", None)
        table.wrap(soup.new_tag("div", attrs={"class": "scroll"}))
    for cell in soup.select("td"):
        if len(cell.get_text()) > LONG:
            cell["class"] = "long"
    for old in soup.select("style"):  # pandas' own, for each table
        old.decompose()
    heading, lead = soup.select_one("h1"), soup.select_one(".markdown p")
    contents = [(h2["id"], plain(h2)) for h2 in soup.select("h2[id]")]
    return dict(
        name=file.stem,
        title=plain(heading) if heading else file.stem,
        lead=plain(lead) if lead else "",
        contents=contents,
        body=Markup(soup),
        picture=first_picture(notebook),
        run=run_of(notebook),
    )


def plain(tag):
    """The text of an element without its anchor and its pictures."""
    copy = BeautifulSoup(str(tag), "html.parser")
    for extra in copy.select(".anchor-link"):
        extra.decompose()
    for picture in copy.select("svg"):
        tex = re.sub(r"\\mathrm|[{}]", "", picture.get("aria-label", ""))
        picture.replace_with(re.sub(r"\^(\d)", lambda power: "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(power[1])], tex))
    return " ".join(copy.get_text().split())


def prepare_outputs(notebook):
    """Give each picture the beginning of the text above it as its description, drop progress bars,
    and say where other widgets live.
    """
    above = ""
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            above = re.sub(r"[*#`$]", "", cell.source.strip().split("\n\n")[-1])
        if cell.cell_type == "code":
            cell.outputs = [
                output
                for output in cell.outputs
                if not re.search(r"\d%\|", output.get("data", {}).get("text/plain", ""))
            ]
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                output.metadata["alt"] = " ".join(above.split())[:200]
            if "application/vnd.jupyter.widget-view+json" in data:
                output.data = nbformat.from_dict({"text/html": LIVE})


def first_picture(notebook):
    """The first PNG among a notebook's outputs, or None."""
    pngs = (
        output["data"]["image/png"]
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if "image/png" in output.get("data", {})
    )
    first = next(pngs, None)
    return first and base64.b64decode(first)


def run_of(notebook):
    """When and how long a notebook ran, with which parameters, and its slowest cell, as papermill
    noted it.
    """
    noted = notebook.metadata.get("papermill", {})
    seconds = [cell.metadata.get("papermill", {}).get("duration") or 0.0 for cell in notebook.cells]
    return dict(
        started=noted.get("start_time", "")[:19].replace("T", " "),
        seconds=noted.get("duration"),
        slowest_s=max(seconds, default=0.0),
        parameters=noted.get("parameters", {}),
        cells=sum(cell.cell_type == "code" for cell in notebook.cells),
    )


def figures_of(folder):
    """[{name, notebook, source, scenario, width, height}] of the PNGs that `figures.save` left in a
    folder, as they say themselves.
    """
    found = []
    for file in sorted(folder.glob("*.png")):
        with Image.open(file) as image:
            said, (width, height) = image.info, image.size
        found.append(
            dict(
                name=file.stem,
                notebook=Path(said.get("Subject", "")).stem,
                source=said.get("Creator", ""),
                scenario=said.get("Keywords", ""),
                width=width,
                height=height,
                pdf=file.with_suffix(".pdf").exists(),
            )
        )
    return found


def tables_of(folder):
    """[{name, notebook, frame}] of the CSV files in a folder; the notebook is named in the LaTeX
    beside it.
    """
    found = []
    for file in sorted(folder.glob("*.csv")):
        tex = file.with_suffix(".tex")
        subject = (
            re.search(r"^% Subject: (.*)$", tex.read_text(encoding="utf-8"), re.M)
            if tex.exists()
            else None
        )
        found.append(
            dict(
                name=file.stem,
                notebook=Path(subject[1]).stem if subject else "",
                tex=tex.exists(),
                frame=pd.read_csv(file),
            )
        )
    return found


def ledger_of(tables):
    """[(table, its rows with a claim, the verdict beside it)]: every table that has the columns
    `claim` and `verdict`.
    """
    found = []
    for table in tables:
        columns = list(table["frame"])
        if {"claim", "verdict"} <= set(columns):
            columns.insert(columns.index("claim") + 1, columns.pop(columns.index("verdict")))
            found.append(
                (
                    table,
                    table["frame"]
                    .dropna(subset=["claim"])[columns]
                    .dropna(axis="columns", how="all"),
                )
            )
    return found


def tone(verdict):
    """Which of four kinds a verdict is of: good, part (of the readings), bad or open."""
    return {"holds": "good", "fails": "bad", "does not hold": "bad"}.get(
        str(verdict), "part" if str(verdict).startswith("holds ") else "open"
    )


def as_html(frame):
    """A table as HTML: numbers in four digits, verdicts in colour, nothing where nothing is."""

    def cell(value):
        if isinstance(value, float):
            return "" if pd.isna(value) else f"{value:.4g}"
        return (
            f'<div class="long">{escape(value)}</div>'
            if len(str(value)) > LONG
            else escape(str(value))
        )

    def verdict(value):
        return f'<span class="verdict {tone(value)}">{cell(value)}</span>' if cell(value) else ""

    frame = frame.rename(
        columns=lambda name: escape(str(name)).replace("_", "_<wbr>")
    )  # where a long name may be broken
    formatters = {column: verdict if column == "verdict" else cell for column in frame}
    return Markup(
        frame.to_html(index=False, border=0, escape=False, formatters=formatters, na_rep="")
    )


def provenance():
    """[(what, value)]: what the results came from."""
    ours = (ROOT / ".git").exists()  # not that of a repository around this folder
    commit = ours and subprocess.run(
        ["git", "-C", ROOT, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"],
        capture_output=True,
        text=True,
    )
    return [
        ("Project", f"rhec {__version__}"),
        ("Source", f"{style.source()} (digest of rhec/, notebooks/ and data/)"),
        ("Commit", commit.stdout.strip() if ours else "no git repository"),
        ("Machine", timing.machine()),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Report made", datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")),
    ]


def packages():
    """[(name, version, pinned)] of the packages in environment.txt that are installed here."""
    pins = re.findall(
        r"^([A-Za-z0-9._-]+)==([^ ;\\]+)",
        (ROOT / "environment.txt").read_text(encoding="utf-8"),
        re.M,
    )
    installed = {}
    for name, pinned in pins:
        try:
            installed[name] = (name, importlib.metadata.version(name), pinned)
        except importlib.metadata.PackageNotFoundError:  # of another system or Python
            continue
    return sorted(installed.values())


def build(notebooks, figures=style.FOLDER, report=REPORT):
    """Write the site; it replaces the old one only when it is whole."""
    report.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=report.parent, prefix="unfinished-") as folder:
        unfinished = Path(folder) / report.name
        write_site(notebooks, figures, unfinished)
        shutil.rmtree(report, ignore_errors=True)
        unfinished.rename(report)


def write_site(notebooks, figures, site):
    """All pages, and what they show, into a new folder."""
    (site / "notebooks").mkdir(parents=True)
    shutil.copytree(figures, site / "figures")
    for file in notebooks:
        shutil.copy(file, site / "notebooks")

    names = [file.stem for file in notebooks]
    stories = [notebook_page(file, names) for file in notebooks]
    drawn, tables = figures_of(figures), tables_of(figures)
    (site / "pictures").mkdir()
    for story in stories:
        if story["picture"]:
            (site / f"pictures/{story['name']}.png").write_bytes(story["picture"])
    ledger = ledger_of(tables)
    counted = [rows for table, rows in ledger if table["name"] == "claims"] or [
        rows for _, rows in ledger
    ]  # other tables repeat what the ledger says
    verdicts = (
        pd.concat([rows["verdict"].map(tone) for rows in counted])
        if counted
        else pd.Series(dtype=str)
    )
    common = dict(
        stories=stories,
        figures=drawn,
        tables=tables,
        ledger=ledger,
        counts=verdicts.value_counts().to_dict(),
        version=__version__,
        source=style.source(),
        provenance=provenance(),
        packages=packages(),
        environment=sorted({figure["source"] for figure in drawn}),
    )

    jinja = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    jinja.filters.update(
        table=as_html, seconds=lambda value: "–" if value is None else f"{value:.1f} s", nice=nice
    )
    for page in (
        "index",
        "results-claims",
        "results-figures",
        "results-tables",
        "results-provenance",
    ):  # a notebook may be called claims, too
        write(
            site / f"{page}.html", jinja.get_template(f"{page}.html.j2").render(common, page=page)
        )
    for story in stories:
        write(
            site / f"{story['name']}.html",
            jinja.get_template("story.html.j2").render(common, page=story["name"], story=story),
        )
    light, dark = (
        HtmlFormatter(style=name).get_style_defs(".highlight")
        for name in ("friendly", "github-dark")
    )
    ours = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    write(
        site / "report.css", f"{light}\n@media (prefers-color-scheme: dark) {{\n{dark}\n}}\n{ours}"
    )


def nice(name):
    """A file's name as words."""
    return name.replace("_", " ")


def write(file, text):
    file.write_text(text, encoding="utf-8")


def main():
    parser = argparse.ArgumentParser(
        prog="python -m rhec.workbench.report",
        description="Make build/report/ from executed notebooks.",
    )
    parser.add_argument(
        "notebooks",
        metavar="NOTEBOOK",
        nargs="+",
        type=Path,
        help="such as build/notebooks/scenario_a.ipynb",
    )
    try:
        build(parser.parse_args().notebooks)
    except KeyboardInterrupt:
        parser.exit(130, "report: interrupted; an older one is left as it was\n")
    except ValueError as error:
        parser.exit(1, f"report: {error}\n")
    print(f"report: open {os.path.relpath(REPORT / 'index.html')}")


if __name__ == "__main__":
    main()
