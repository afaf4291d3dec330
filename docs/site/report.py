"""The report: a site of the executed notebooks, the figures, the claims and the documents.

Sphinx and MyST-NB build it without network.

    python -m docs.site.report build/notebooks/03_scenario_a.ipynb …

`docs/conf.py` configures Sphinx, `docs/index.md` orders the pages. This module copies the sources
to a folder with the structure of the repository, which preserves links, and writes the pages
"figures", "claims", "parameters" and "provenance" as Markdown.
"""

import argparse
import importlib.metadata
import platform
import re
import shutil
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from pathlib import Path
from urllib.parse import quote

import nbformat
import pandas as pd
from nbformat.v4 import new_output
from PIL import Image
from sphinx.application import Sphinx

from docs.live import page, wasm
from docs.site import cards
from docs.site.content_policy import with_policy
from notebooks.captions import alternative_text, with_captions, without_links
from notebooks.claims.rules import CLAIMS
from notebooks.declared import ROOT
from notebooks.parameter_table import parameters_of
from notebooks.plots.claims import LOOKS, kind_of
from notebooks.studies import answer, timing
from notebooks.studies.tables import to_markdown
from rhec import __version__, style

REPORT = ROOT / "build/report"
_COPIED = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "CITATION.cff", "LICENSE")
_WIDGET = "application/vnd.jupyter.widget-view+json"
_NO_SLIDERS = "*Here are sliders when this notebook runs in JupyterLab:* `.venv/bin/rhec lab`"
_WIDTH_PX = 900  # of the pictures in notebooks
# Packages whose scripts and styles the pages hold.
SHOWN = ("furo", "Sphinx", "myst-nb", "Pygments")
# Beginnings of the names of the paper's tables, in its order.
_PAPERS_TABLES = ("table1", "table_scenario_a", "table_scenario_b", "claims")
# {page: the pages below it in the menu}; docs/index.md has the pages at the top.
_BELOW = {
    "claims": ("docs/claims", "docs/interpretations", "docs/world", "docs/acado"),
    "figures": ("notebooks/0[2-9]*", "notebooks/further/*"),
    "docs/your_log": ("docs/log_columns", "docs/recorded_robots"),
    "docs/extending": ("docs/campaigns", "docs/performance"),
    "CONTRIBUTING": (
        "docs/architecture",
        "docs/naming",
        "docs/what_did_not_pay",
        "docs/systems",
        "docs/threat_model",
        "SECURITY",
        "CHANGELOG",
    ),
}
# Names of what a cell saves: `style.save(figure, "fig08_errors")`.
_SAVED = re.compile(r'\bsave(?:_table)?\([^,]+,\s*"(\w+)"')
_SHOWN_PNG = re.compile(r"(_images/[\w.-]+)\.png")


def build(notebooks, figures=style.FOLDER, report=REPORT, live=False):
    """Write the site; it replaces the old one only when it is whole.

    Args:
        notebooks: paths of executed notebooks.
        figures: folder of the figures and tables that they left. The report shows those alone;
            other files there are a person's own, and may be anything.
        report: folder of the site.
        live: whether to add the live page, which needs a compiler for WebAssembly.

    Raises:
        sphinx.errors.SphinxError: If a page cannot be built; the old site stays unchanged.
    """
    began = time.monotonic()
    report.parent.mkdir(parents=True, exist_ok=True)
    print(f"report: {len(notebooks)} notebooks and the documents become a site")
    with tempfile.TemporaryDirectory(dir=report.parent, prefix="unfinished-") as folder:
        source = Path(folder) / "source"
        site = Path(folder) / report.name
        _lay_out(source, notebooks, figures, live)
        tags = ["live"] if live else []
        doctrees = Path(folder) / "doctrees"
        print("report: Sphinx writes the pages (half a minute or more)")
        Sphinx(source, ROOT / "docs", site, doctrees, "html", status=None, tags=tags).build()
        print("report: pictures are made smaller")
        for file in site.rglob("*.map"):  # of the theme's sources, which are not there
            file.unlink()
        with ThreadPoolExecutor() as threads:  # Pillow lets other threads run meanwhile
            list(threads.map(_shrink, (site / "_images").glob("*.png")))
        for file in site.rglob("*.html"):
            text = _SHOWN_PNG.sub(r"\1.webp", file.read_text(encoding="utf-8"))
            file.write_text(with_policy(text), encoding="utf-8")
        if live:
            print("report: the closed loop becomes WebAssembly for the live page")
            page.write(site)
        shutil.rmtree(report, ignore_errors=True)
        site.rename(report)
    pages = sum(1 for _ in report.rglob("*.html"))
    size_mb = sum(file.stat().st_size for file in report.rglob("*") if file.is_file()) / 1e6
    took_s = time.monotonic() - began
    print(f"report: {pages} pages, {size_mb:.1f} MB, in {took_s:.0f} s")


def _shrink(png):
    """Make a picture a WebP with 256 colours, which takes a quarter of the bytes."""
    with Image.open(png) as picture:
        # Over white, as on paper: a palette with transparency has few opaque colours.
        paper = Image.new("RGBA", picture.size, "white")
        paper.alpha_composite(picture.convert("RGBA"))
        # Median cut, the default, leaves steps in maps of the soil, and larger files.
        palette = paper.convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE)
        palette.convert("RGB").save(png.with_suffix(".webp"), lossless=True)
    png.unlink()


def _lay_out(source, notebooks, figures, live):
    """All that the pages are made of, in a new folder."""
    shutil.copytree(ROOT / "docs", source / "docs", ignore=shutil.ignore_patterns("index.md", "_*"))
    shutil.copy(ROOT / "docs/index.md", source)
    for name in _COPIED:
        shutil.copy(ROOT / name, source)
    _link_cards(source / "README.md")
    (source / "licences").mkdir()
    for package in SHOWN:
        (source / f"licences/{package}.txt").write_text(licence(package), encoding="utf-8")
    (source / "figures").mkdir()
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    shown = " ".join(page.read_text("utf-8") for page in pages)
    for picture in {*re.findall(r"figures/\w+\.png", shown)}:
        shutil.copy(ROOT / picture, source / picture)
    places = {path.name: path.relative_to(ROOT) for path in (ROOT / "notebooks").rglob("*.ipynb")}
    stories = {places[file.name]: nbformat.read(file, as_version=4) for file in notebooks}
    captions = {}
    for place, notebook in stories.items():
        captions[place] = _copy_saved(notebook, figures, source / "figures")
        root = "../" * len(place.parent.parts)
        _prepare(notebook)
        _show_saved(notebook, source / "figures", root)
        _link_claims(notebook, root)
        (source / place).parent.mkdir(parents=True, exist_ok=True)
        nbformat.write(notebook, source / place)
    ledger = figures / "claims.csv"
    if not ledger.exists():
        ledger = answer.RESULTS / "claims.csv"
    pages = {
        "figures": _figures_page(stories, captions, source / "figures"),
        "claims": cards.page(pd.read_csv(ledger), live),
        "parameters": _parameters_page(stories),
        "provenance": _provenance_page(stories, source / "figures"),
    }
    for name, text in pages.items():
        (source / f"{name}.md").write_text(text, encoding="utf-8")
    for name, below in _BELOW.items():
        with (source / f"{name}.md").open("a", encoding="utf-8") as page_:
            page_.write(_menu(below))


def _menu(below):
    """The pages below another one in the menu, in Markdown."""
    names = "\n".join(f"/{name}" for name in below)
    return f"\n\n```{{toctree}}\n:hidden:\n:glob:\n\n{names}\n```\n"


def _link_cards(readme):
    """Give each verdict its colour, and let the counts of the ledger lead to the cards."""
    text = readme.read_text(encoding="utf-8")

    def link(part):
        verdict = " ".join(part[1].split())  # a line may end in it
        kind = quote(kind_of(verdict))
        return f'<a href="claims.html?verdict={kind}">{_coloured(verdict)}{part[2]}</a>'

    def cell(part):
        return f"| {_coloured(part[1])}"

    text = re.sub(rf"\[([^\[\]]*?)(:\s\d+)\]\({re.escape(answer.LEDGER)}\)", link, text)
    words = "|".join(answer.VERDICTS)
    text = re.sub(rf"\| ({words})(?=:| \|)", cell, text)
    readme.write_text(text, encoding="utf-8")


def _coloured(verdict):
    """A verdict in words, with its colour beside it."""
    colour, _ = LOOKS[kind_of(answer.VERDICTS.get(verdict, verdict))]
    return f'<span class="verdict" style="--verdict: {colour}">{verdict}</span>'


# ---------------------------------------------------------------- notebooks


def _copy_saved(notebook, figures, folder):
    """Copy the files that the cells of a notebook saved; {figure: caption}."""
    captions = {}
    for cell, caption in with_captions(notebook):
        for name in _SAVED.findall(cell.source):
            for file in figures.glob(f"{name}.*"):
                shutil.copy(file, folder)
            if (folder / f"{name}.png").exists():
                captions[name] = _numbered(name, caption)
    return captions


def _numbered(name, caption):
    """A caption that begins with the figure's number, if the paper has such a figure."""
    number = re.match(r"fig(\d\d)_", name)
    if number is None or caption.startswith("**Figure"):
        return caption
    return f"**Figure {int(number[1])}.** {caption}"


def _prepare(notebook):
    """Describe the pictures of a notebook, fold its code, and replace its widgets."""
    notebook.metadata.pop("widgets", None)  # their state, which needs a kernel
    folded = notebook.metadata.get("rhec", {}).get("code") != "open"
    for cell, caption in with_captions(notebook):
        cell.outputs = [_without_widget(output) for output in cell.outputs]
        for output in cell.outputs:
            if "image/png" in output.get("data", {}):
                output.data.pop("text/html", None)  # the same picture for other readers
        cell.metadata["mystnb"] = dict(
            image=dict(alt=alternative_text(caption), width=f"{_WIDTH_PX}px")
        )
        if folded:
            cell.metadata["tags"] = [*cell.metadata.get("tags", []), "hide-input"]


def _show_saved(notebook, folder, root):
    """Show a figure that its cell saved from the file, so that the site has it once."""
    for cell, caption in with_captions(notebook):
        saved = [name for name in _SAVED.findall(cell.source) if (folder / f"{name}.png").exists()]
        drawn = [output for output in cell.outputs if "image/png" in output.get("data", {})]
        if len(saved) == len(drawn) == 1:
            alt = re.sub(r"[\[\]]", "", alternative_text(caption))
            image = f"![{alt}]({root}figures/{saved[0]}.png)"
            drawn[0].data = {"text/markdown": image}


def _link_claims(notebook, root):
    """Let the ids of claims in tables lead to their cards; root: from the page to the site."""
    link = rf'\1<a href="{root}claims.html#\2">\2</a>'
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "text/html" in data:
                is_id = rf"(<t[hd][^>]*>)({'|'.join(CLAIMS)})(?=</t[hd]>)"
                data["text/html"] = re.sub(is_id, link, data["text/html"])


def _without_widget(output):
    is_widget = _WIDGET in output.get("data", {})
    return new_output("display_data", {"text/markdown": _NO_SLIDERS}) if is_widget else output


# ---------------------------------------------------------------- pages


def _figures_page(stories, captions, folder):
    """The figures of the paper in its order, then those of each notebook, then all tables."""
    figures = [(name, place) for place, names in captions.items() for name in names]
    of_paper = sorted(figure for figure in figures if re.match(r"fig\d", figure[0]))
    groups = {"The paper": of_paper}
    for place, notebook in stories.items():
        groups[_title(notebook)] = [
            each for each in figures if each[1] == place and each not in of_paper
        ]
    text = "---\nhide-toc: true\n---\n\n# Figures\n\n"
    text += (
        "`make figures` and `make studies` leave each as PNG and PDF in `figures/`. These files\n"
    )
    text += "carry the scenario and the notebook that made them.\n"
    for title, group in groups.items():
        if group:
            gallery = "\n".join(
                _figure(folder / f"{name}.png", place, captions[place][name])
                for name, place in group
            )
            text += f"\n## {title}\n\n::::{{container}} gallery\n{gallery}\n::::\n"
    # The tables that the paper has come first, in its order.
    names = sorted(file.stem for file in folder.glob("*.csv"))
    names.sort(key=lambda name: [not name.startswith(first) for first in _PAPERS_TABLES])
    tables = [f"- {{download}}`{name}.csv <figures/{name}.csv>`" for name in names]
    return "\n".join([text, "## Tables with all digits\n", *tables, ""])


def _figure(file, place, caption):
    """A figure with its caption and links, as Markdown; a wide one takes the page's width."""
    wide = ":figclass: wide\n" if _is_wide(file) else ""
    name = file.stem
    return (
        f":::{{figure}} figures/{name}.png\n:name: {name}\n:loading: lazy\n{wide}"
        f":target: {place.with_suffix('.html')}\n:alt: {alternative_text(caption) or name}\n\n"
        f"{without_links(caption) or name}\n\n`figures/{name}.pdf`\n:::"
    )


def _is_wide(png):
    """Whether a figure is wider than a column of the paper."""
    with Image.open(png) as picture:
        return picture.width > style.COLUMN_IN * style.RC["savefig.dpi"] + 1


_RUN = """# Notebooks with other parameters

Every notebook runs with other parameters by [papermill](https://papermill.readthedocs.io), which
writes the executed notebook and leaves the original as it is:

    .venv/bin/python -m notebooks.run notebooks/03_scenario_a.ipynb -p world soft -p seeds 50

The result is `build/notebooks/03_scenario_a-custom.ipynb`, with its figures and tables in the
folder of that name beside it. `--output` names another place. A value that a parameter cannot take
is refused in one sentence before anything runs. `--help` after a notebook shows its parameters in
the terminal. In JupyterLab, edit the first cell of code and run all cells."""


def _parameters_page(stories):
    """How to run notebooks with other parameters, and what these are."""
    parts = [_RUN]
    for place, notebook in stories.items():
        table = pd.DataFrame(parameters_of(ROOT / place)).assign(
            name=lambda rows: "`" + rows["name"] + "`"
        )
        parts += [f"## [{_title(notebook)}]({place})", to_markdown(table)]
    return "\n\n".join(parts)


def _title(notebook):
    return re.search(r"(?m)^# (.*)$", notebook.cells[0].source)[1]


def _provenance_page(stories, figures):
    """The provenance of the results."""
    sources = {style.source_of(file) for file in figures.glob("*.png")} - {""}
    facts = [
        ("Project", f"rhec {__version__}"),
        ("Source", f"{style.source()} (digest of rhec/, notebooks/ and the standard fields)"),
        ("Commit", _commit()),
        *(("Figures made by", source) for source in sorted(sources)),
        ("Machine", timing.machine()),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
        ("Report made", datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")),
    ]
    runs = pd.DataFrame([_run_of(place, notebook) for place, notebook in stories.items()])
    licences = ", ".join(f"{{download}}`{name} <licences/{name}.txt>`" for name in SHOWN)
    return "\n\n".join(
        [
            "# Provenance",
            to_markdown(pd.DataFrame(facts, columns=["what", "value"])),
            "## Notebooks",
            to_markdown(runs),
            f"These pages hold scripts and styles of other projects; their licences: {licences}.",
        ]
    )


def _commit():
    """The commit of the repository in this folder, not of an enclosing one."""
    if not (ROOT / ".git").exists():
        return "no git repository"
    describe = ["git", "-C", ROOT, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*"]
    return subprocess.run(describe, capture_output=True, text=True).stdout.strip()


def _run_of(place, notebook):
    """Start, duration and parameters of a notebook, as recorded by papermill."""
    record = notebook.metadata.get("papermill", {})
    changed = ", ".join(f"{key} = {value}" for key, value in record.get("parameters", {}).items())
    return {
        "notebook": f"[{place.stem}]({place})",
        "started (UTC)": record.get("start_time", "")[:19].replace("T", " "),
        "duration [s]": f"{record.get('duration', 0):.3g}",
        "parameters": changed or "as in the notebook",
    }


def licence(package):
    """The text of an installed package's licence."""
    files = importlib.metadata.files(package)
    (file,) = [each for each in files if re.search(r"/LICEN[CS]E\b[^/]*$", str(each))]
    return file.read_text(encoding="utf-8")


def _main():
    about = "Make build/report/ from executed notebooks, such as build/notebooks/00_start.ipynb."
    parser = argparse.ArgumentParser(prog="python -m docs.site.report", description=about)
    parser.add_argument("notebooks", metavar="NOTEBOOK", nargs="+", type=Path)
    live = wasm.can_compile()
    build(parser.parse_args().notebooks, live=live)
    if not live:
        print("report: without the live page, because ziglang is not installed")


if __name__ == "__main__":
    _main()
