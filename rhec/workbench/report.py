"""The report: a site of the executed notebooks, figures, tables, documents, and the reference.

Sphinx builds it without network.

    python -m rhec.workbench.report build/notebooks/03_scenario_a.ipynb …

`docs/conf.py` configures Sphinx, `docs/index.md` orders the pages. This module copies the sources
to a folder with the structure of the repository, which preserves links, and writes the pages
"figures", "tables", "claims" and "provenance" as Markdown.
"""

import argparse
import importlib.metadata
import io
import os
import platform
import re
import shutil
import subprocess
import tempfile
import tomllib
from base64 import b64decode, b64encode
from datetime import datetime
from html import escape
from pathlib import Path

import nbformat
import pandas as pd
from PIL import Image
from sphinx.application import Sphinx

from rhec import __version__
from rhec.workbench import cards, results
from rhec.workbench.content_policy import with_policy
from rhec.workbench.plots import style
from rhec.workbench.studies import timing

__all__ = ["build", "made_by"]

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "build/report"
# The scenes of the live page, which name notebooks.
_SCENES = Path(__file__).parent / "live/scenes.toml"
THUMBNAIL = (640, 640)  # largest size [px]
LONG = 30  # longer texts [characters] in a table are broken into lines
_WIDGET = "application/vnd.jupyter.widget-view+json"
_COPIED = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "CITATION.cff", "LICENSE")
# README's picture has a width, which Markdown cannot give it; Sphinx copies only its own images.
_IMG = re.compile(r'<img src="(.+?)" width="(.+?)" align="(.+?)"\s+alt="(.+?)">')
_IMAGE = r"""```{image} \1
:width: \2px
:align: \3
:alt: \4
```"""
_WIDE = "---\nhide-toc: true\n---\n\n"  # a page without the table of contents at the right


def build(notebooks, figures=style.FOLDER, report=REPORT, live=False, published=None):
    """Write the site; it replaces the old one only when it is whole.

    Args:
        notebooks: paths of executed notebooks.
        figures: folder of the figures and tables that they left.
        report: folder of the site.
        live: whether to link the live page, which `python -m rhec.workbench.live.page` adds.
        published: names of the files in `figures` that the report may read; by default all. Other
            files are a person's own, and may be anything.

    Raises:
        sphinx.errors.SphinxError: If a page cannot be built; the old site stays unchanged.
    """
    report.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=report.parent, prefix="unfinished-") as folder:
        source = Path(folder) / "source"
        site = Path(folder) / report.name
        site.mkdir()
        _lay_out(source, notebooks, figures, live, published)
        _run_sphinx(source, site, ["live"] if live else [])
        for page in site.rglob("*.html"):
            page.write_text(with_policy(page.read_text(encoding="utf-8")), encoding="utf-8")
        (site / "report.d").touch()  # for `make clean`
        files = [f"build/report/{file.relative_to(site)}" for file in site.rglob("*.*")]
        (site / "report.d").write_text(f"MADE += {' '.join(files)}\n")
        shutil.rmtree(report, ignore_errors=True)
        site.rename(report)


def _run_sphinx(source, site, tags):
    """Build the site from its sources, and print the warnings of Sphinx."""
    cache = site.parent / "doctrees"
    app = Sphinx(source, ROOT / "docs", site, cache, "html", status=None, tags=tags)
    app.build()
    for left in (".buildinfo", "objects.inv", "_sphinx_design_static"):
        (site / left).unlink(missing_ok=True)


def made_by(notebooks, figures=style.FOLDER):
    """Names of the files in a folder that these notebooks made, by the lists beside them."""
    names = set()
    for rules in (Path(notebook).with_suffix(".d") for notebook in notebooks):
        text = rules.read_text(encoding="utf-8") if rules.exists() else ""
        files = (
            ROOT / file for line in re.findall(r"(?m)^MADE \+=(.*)$", text) for file in line.split()
        )
        names |= {file.name for file in files if file.parent == figures}
    return names


def _copy_figures(figures, folder, published):
    folder.mkdir()
    for file in figures.iterdir():
        if file.is_file() and (published is None or file.name in published):
            shutil.copy(file, folder)


def _lay_out(source, notebooks, figures, live, published):
    """All that the pages are made of, in a new folder."""
    shutil.copytree(ROOT / "docs", source / "docs", ignore=shutil.ignore_patterns("index.md"))
    shutil.copy(ROOT / "docs/index.md", source)
    for name in _COPIED:
        shutil.copy(ROOT / name, source)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (source / "README.md").write_text(_IMG.sub(_IMAGE, readme), encoding="utf-8")
    _copy_figures(figures, source / "figures", published)
    figures = source / "figures"
    (source / "notebooks").mkdir()
    stories = {file.stem: nbformat.read(file, as_version=4) for file in notebooks}
    scenes = tomllib.loads(_SCENES.read_text(encoding="utf-8"))
    scene_of = {scene["notebook"]: name for name, scene in scenes.items()}
    captions = {}
    for name, notebook in stories.items():
        for figure, text in _captions(notebook, figures).items():
            captions[figure] = name, _from_the_root(text)
        _prepare(notebook, scene_of.get(name), live)
        nbformat.write(notebook, source / f"notebooks/{name}.ipynb")
    pages = {
        "figures": _figures_page(stories, captions, figures),
        "tables": _tables_page(figures),
        "claims": _claims_page(figures / "claims.csv", live),
        "provenance": _provenance_page(stories, figures),
    }
    for name, text in pages.items():
        (source / f"{name}.md").write_text(text, encoding="utf-8")


# ---------------------------------------------------------------- notebooks


def _captions(notebook, figures):
    """{figure: paragraph above it} for the figures of a notebook; adds an anchor for each."""
    captions = {}
    above = notebook.cells[0]
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            above = cell
            continue
        if not _pictures(cell):
            continue
        named = [name for name in re.findall(r'"(\w+)"', cell.source) if name not in captions]
        saved = [name for name in named if (figures / f"{name}.png").exists()]
        captions |= dict.fromkeys(saved, _last_paragraph(above))
        above.source += "".join(f'\n\n<a id="{name}"></a>' for name in saved)
    return captions


def _prepare(notebook, scene, live):
    """Describe the pictures of a notebook, fold its code, and remove widgets.

    Args:
        notebook: The executed notebook, which is modified.
        scene: The corresponding scene of the live page, or None.
        live: Whether the report has a live page.
    """
    notebook.metadata.pop("widgets", None)  # their state, which needs a kernel
    unfolded = notebook.metadata.get("rhec", {}).get("code") == "open"
    above = notebook.cells[0]
    sliders = [above] if scene and live else []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            above = cell
            continue
        sliders += [above for output in cell.get("outputs", []) if _is_explorer(output)]
        cell.outputs = [output for output in cell.outputs if _WIDGET not in output.get("data", {})]
        _prepare_pictures(cell, _last_paragraph(above))
        if not unfolded or cell.metadata.get("jupyter", {}).get("source_hidden"):
            cell.metadata["tags"] = [*cell.metadata.get("tags", []), "hide-input"]
    for cell in sliders:
        cell.source += _slider_tip(scene, live)


def _is_explorer(output):
    """Whether an output is a widget other than a progress bar."""
    data = output.get("data", {})
    return _WIDGET in data and not re.search(r"\d%\|", data.get("text/plain", ""))


def _slider_tip(scene, live):
    page = f'<a href="../live.html#{scene or ""}">the live page</a> moves them in this browser; '
    return (
        "\n\n:::{tip}\n"
        f"Sliders: {page if live else ''}`make lab` opens this notebook with Python.\n:::\n"
    )


def _pictures(cell):
    return [output for output in cell.outputs if "image/png" in output.get("data", {})]


def _prepare_pictures(cell, caption):
    """Add a description and a size to the pictures of a cell, and compress them."""
    for output in _pictures(cell):
        output.data["image/png"] = _with_fewer_colours(output.data["image/png"])
        width = output.metadata.get("image/png", {}).get("width")
        image = dict(width=f"{width}px") if width else {}
        cell.metadata["mystnb"] = dict(image=image | dict(alt=_plain(caption)[:250]))


def _last_paragraph(cell):
    """The last paragraph of a text cell, which describes the picture below."""
    prose = re.sub(r"(?m)^<a id=.*$|^#.*$", "", cell.source)
    pieces = [piece.strip() for piece in prose.split("\n\n") if piece.strip()]
    return pieces[-1] if pieces else ""


def _from_the_root(text):
    """A notebook's text for a page beside the folder of notebooks: its links lead the same way."""
    return re.sub(r"\]\((?!\w+:|#|/)([^)]+)\)", _link_from_the_root, text)


def _link_from_the_root(match):
    return f"]({os.path.normpath(f'notebooks/{match[1]}')})"


def _plain(text):
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(re.sub(r"[*#`$\\]", "", text).split())


def _with_fewer_colours(png):
    """A PNG (base64) with 256 colours, which are enough for drawings."""
    image = (
        Image.open(io.BytesIO(b64decode(png)))
        .convert("RGB")
        .quantize(256, Image.Quantize.FASTOCTREE, dither=0)
    )
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return b64encode(file.getvalue()).decode()


# ---------------------------------------------------------------- figures and tables


def _figures_page(stories, captions, folder):
    """The figures of the paper in its order, then those of each study."""
    drawn = sorted(file.stem for file in folder.glob("*.png"))
    groups = {"The paper": [name for name in drawn if re.match(r"fig\d", name)]}
    for story, notebook in stories.items():
        saved = [name for name in captions if captions[name][0] == story]
        groups[_title(story, notebook)] = [
            name for name in saved if name not in groups["The paper"]
        ]
    named = [name for names in groups.values() for name in names]
    groups["Other figures"] = [name for name in drawn if name not in named]
    (folder / "thumbnails").mkdir()
    text = f"{_WIDE}# Figures\n\nThe figures of the paper in its order, then those of the studies. "
    text += "Each file carries the scenario and the notebook that made it.\n"
    for title, names in groups.items():
        if names:
            gallery = "\n".join(
                _figure(name, *captions.get(name, ("", "")), folder) for name in names
            )
            text += f"\n## {title}\n\n::::{{container}} gallery\n{gallery}\n::::\n"
    return text


def _figure(name, story, caption, folder):
    """A thumbnail with its caption and links, as Markdown."""
    with Image.open(folder / f"{name}.png") as image:
        image.thumbnail(THUMBNAIL)
        image.convert("RGB").save(folder / f"thumbnails/{name}.webp", quality=80)
    links = [f"[notebook](notebooks/{story}.ipynb)"] if story else []
    if (folder / f"{name}.pdf").exists():
        links.append(f"{{download}}`PDF <figures/{name}.pdf>`")
    target = f":target: notebooks/{story}.html#{name}\n" if story else ""
    return (
        f":::{{figure}} figures/thumbnails/{name}.webp\n:name: {name}\n{target}"
        f":alt: {_plain(caption)[:250] or name}\n\n{caption or name}\n\n"
        f"`{name}`: {' · '.join(links)}\n:::"
    )


def _title(story, notebook):
    heading = re.search(r"(?m)^# (.*)$", notebook.cells[0].source)
    return heading[1] if heading else story


def _tables_page(folder):
    """All tables with rounded numbers, and links to their files."""
    text = f"{_WIDE}# Tables\n\nThree digits here, all of them in the CSV files.\n"
    for file in sorted(folder.glob("*.csv")):
        tex = file.with_suffix(".tex")
        latex = tex.read_text(encoding="utf-8") if tex.exists() else ""
        caption = re.search(r"\\caption\{(.*?)\}\n", latex)
        caption = re.sub(r"\\,|\\(?=[%_&])", "", caption[1]) if caption else ""
        files = [f"{{download}}`CSV <figures/{file.name}>`"]
        files += [f"{{download}}`LaTeX <figures/{tex.name}>`"] if tex.exists() else []
        table = _as_html(results.readable(pd.read_csv(file)))
        text += f"\n## {file.stem.replace('_', ' ')}\n\n{caption}. "
        text += f"{' · '.join(files)}\n\n{table}\n"
    return text


def _as_html(table):
    """A DataFrame as HTML in a scrollable frame; numbers have three digits."""

    def cell(value):
        text = results.format_number(value) if isinstance(value, float) else str(value)
        if text.startswith("<a id="):
            return text
        return f'<div class="long">{escape(text)}</div>' if len(text) > LONG else escape(text)

    table = table.rename(columns=lambda name: escape(str(name)).replace("_", " "))
    html = table.to_html(
        index=False,
        border=0,
        escape=False,
        classes="docutils",
        formatters=[cell] * len(table.columns),
    )
    return f'```{{raw}} html\n<div class="table-wrapper docutils container">{html}</div>\n```'


# ---------------------------------------------------------------- claims and provenance


def _claims_page(file, live):
    """The verdicts on all claims, with an anchor for each, such as `claims.html#B5`."""
    if not file.exists():
        return "# Verdicts on the paper\n\n`make claims` has not been run.\n"
    costs = ROOT / "data/claim_costs.csv"
    return cards.page(pd.read_csv(file), live, pd.read_csv(costs) if costs.exists() else None)


def _provenance_page(stories, figures):
    """The provenance of the results."""
    made_by = {style.source_of(file) for file in sorted(figures.glob("*.png"))} - {""}
    facts = [
        ("Project", f"rhec {__version__}"),
        ("Source", f"{style.source()} (digest of rhec/, notebooks/ and the standard fields)"),
        ("Commit", _commit()),
        *(("Figures made by", maker) for maker in sorted(made_by)),
        ("Machine", timing.machine()),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Report made", datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")),
    ]
    runs = pd.DataFrame([_run_of(name, notebook) for name, notebook in stories.items()])
    packages = pd.DataFrame(
        _packages(), columns=["package", "version", "pinned in environment.txt"]
    )
    return "\n\n".join(
        [
            "# Provenance",
            results.to_markdown(pd.DataFrame(facts, columns=["what", "value"])),
            "## Notebooks",
            results.to_markdown(runs),
            "## Packages",
            results.to_markdown(packages),
        ]
    )


def _commit():
    """The commit of the repository in this folder, not of an enclosing one."""
    if not (ROOT / ".git").exists():
        return "no git repository"
    describe = ["git", "-C", ROOT, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    return subprocess.run(describe, capture_output=True, text=True).stdout.strip()


def _run_of(name, notebook):
    """Start, duration and parameters of a notebook, as recorded by papermill."""
    record = notebook.metadata.get("papermill", {})
    parameters = record.get("parameters", {})
    changed = ", ".join(f"{key} = {value}" for key, value in parameters.items())
    return {
        "notebook": f"[{name}](notebooks/{name}.ipynb)",
        "started (UTC)": record.get("start_time", "")[:19].replace("T", " "),
        "duration [s]": results.format_number(record.get("duration")),
        "code cells": sum(cell.cell_type == "code" for cell in notebook.cells),
        "parameters": changed or "as in the notebook",
    }


def _packages():
    """The packages in environment.txt that are installed here: (name, version, pinned version)."""
    pins = (ROOT / "environment.txt").read_text(encoding="utf-8")
    pinned = dict(re.findall(r"^([A-Za-z0-9._-]+)==([^ ;\\]+)", pins, re.M))
    distributions = importlib.metadata.distributions()
    installed = {package.metadata["Name"]: package.version for package in distributions}
    both = sorted(pinned.keys() & installed.keys())  # the others are for another system or Python
    return [(name, installed[name], pinned[name]) for name in both]


def _main():
    about = (
        "Make build/report/ from executed notebooks, such as build/notebooks/03_scenario_a.ipynb."
    )
    parser = argparse.ArgumentParser(prog="python -m rhec.workbench.report", description=about)
    parser.add_argument("notebooks", metavar="NOTEBOOK", nargs="+", type=Path)
    parser.add_argument("--live", action="store_true", help="link the live page")
    also = "a file in figures/ to publish besides those that the notebooks made"
    parser.add_argument("--also", metavar="FILE", nargs="*", default=[], type=Path, help=also)
    options = parser.parse_args()
    try:
        published = made_by(options.notebooks) | {file.name for file in options.also}
        build(options.notebooks, live=options.live, published=published)
    except KeyboardInterrupt:
        parser.exit(130, "report: interrupted; an older report stays unchanged\n")
    if not options.live:
        print("report: without the live page, because no compiler for WebAssembly is installed")
    print(f"report: open {os.path.relpath(REPORT / 'index.html')}")


if __name__ == "__main__":
    _main()
