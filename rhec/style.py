"""The style of all figures and tables, and files with their provenance.

A figure function takes data, returns a matplotlib Figure and is decorated with `styled`. Files
contain the version, the scenario and the notebook. All except PNGs also contain a digest of the
source; without it, the PNGs in git change only if the pictures change.
"""

import contextlib
import dataclasses
import functools
import hashlib
import io
import json
import os
import re
import zlib
from pathlib import Path

from rhec.files import replacing
from rhec.version import __version__

ROOT = Path(__file__).resolve().parents[1]
# In an installed wheel there is no project, and nothing is written among the packages.
_HERE = ROOT if (ROOT / "pyproject.toml").exists() else Path.cwd()
FOLDER = Path(os.environ.get("RHEC_FIGURES", _HERE / "figures"))
_OWN_PARAMETERS = "", {}  # of a notebook that runs as it is
_running = _OWN_PARAMETERS  # (name of the notebook, {parameter: value} of what was changed)
_NOTE_IN = 0.16  # height of the line that names changed parameters
_LONGEST_NAME = 120  # of a folder, in letters
_LATEX = str.maketrans({letter: f"\\{letter}" for letter in "_%#&$"})

# Widths of the paper's figures [in]
COLUMN_IN = 3.4
DOUBLE_IN = 6.5
SMALL_PT = 7  # the smallest text of a figure, at its width in print

# Okabe and Ito's palette for colour-blind readers. A colour has the same role in all figures.
BLACK = "#000000"
GREY = "#7f7f7f"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
_YELLOW = "#F0E442"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
PURPLE = "#CC79A7"
SOIL = "#784614"  # where it slips; white where it holds
COLOURS = {
    "reference": GREY,
    "truth": BLACK,
    "measured": SKY,
    "RHE": BLUE,
    "EKF": VERMILLION,
    "oracle": GREEN,
    "bounded EKF": ORANGE,
    "soil": SOIL,
    "tolerance": _YELLOW,
    "Q1": ORANGE,
    "Q2": PURPLE,
    "Q3": BLUE,  # all other figures of the RHE use Q3
}

# What figures and tables call the estimators of `Scenario.estimator`.
LABELS = {"rhe": "RHE", "ekf": "EKF", "bounded_ekf": "bounded EKF", "oracle": "oracle"}
_OF_OTHERS = ORANGE, PURPLE, GREEN, SKY, SOIL

RC = {
    "figure.figsize": (COLUMN_IN, 2.2),
    "figure.constrained_layout.use": True,
    "font.family": "STIXGeneral",  # ships with matplotlib and matches the paper's Times
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "axes.labelsize": 8,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    # As text, so that the colours can be imported without Matplotlib.
    "axes.prop_cycle": f"cycler(color={[BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE, BLACK]})",
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "0.9",
    "grid.linewidth": 0.4,
    "lines.linewidth": 1.0,
    "patch.linewidth": 0.7,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # TrueType, so that text can be selected
}


def label_of(estimator):
    """What figures and tables call an estimator: a name of `Scenario.estimator`, or a
    rhec.Estimator.
    """
    return LABELS.get(estimator, estimator) if isinstance(estimator, str) else estimator.label


def colour_of(estimator):
    """The colour of an estimator, by its name or label, or of a rhec.Estimator.

    One that is not in COLOURS and brings none along has a colour that follows from its label, so
    that it is the same in all figures.
    """
    label = label_of(estimator)
    own = getattr(estimator, "colour", None)
    return own or COLOURS.get(label, _OF_OTHERS[zlib.crc32(label.encode()) % len(_OF_OTHERS)])


def styled(draw):
    """Decorate a figure function to draw in this style, independently of the caller's rcParams."""

    @functools.wraps(draw)
    def drawn(*args, **kwargs):
        # Imported here: the explorer's screen needs the colours, and no Matplotlib.
        import matplotlib as mpl
        import matplotlib.pyplot as plt

        # The first use of a notebook's backend sets rcParams, so it must be outside the context.
        plt.draw_if_interactive()
        with mpl.rc_context(RC):
            figure = draw(*args, **kwargs)
            # Matplotlib creates ticks when they are first used and derives their number from the
            # label size. Both must happen inside the context.
            visible = (axes for axes in figure.axes if axes.axison)
            for axis in (axis for axes in visible for axis in (axes.xaxis, axes.yaxis)):
                sizes = {label.get_fontsize() for label in axis.get_ticklabels()}
                if len(sizes) == 1:
                    axis.set_tick_params(labelsize=sizes.pop())
            figure.draw_without_rendering()
            figure.set_layout_engine("none")  # it stands, and takes as long as to draw
        plt.close(figure)  # otherwise a notebook shows it twice
        return figure

    return drawn


def source(root=ROOT):
    """Digest of the sources of figures: modules, the standard fields and notebooks.

    Unlike the name of a commit, it does not change when only figures are committed; nor when
    JupyterLab keeps a copy of a notebook that it has saved.
    """
    patterns = ("rhec/**/*.py", "data/*.npz", "notebooks/**/*.py", "notebooks/**/*.ipynb")
    found = sorted(file for pattern in patterns for file in root.glob(pattern) if file.is_file())
    files = (file for file in found if ".ipynb_checkpoints" not in file.parts)
    pieces = (file.relative_to(root).as_posix().encode() + file.read_bytes() for file in files)
    return hashlib.sha256(b"".join(pieces)).hexdigest()[:12]


def _as_json(scenario):
    """A scenario, or any nest of dicts, lists, dataclasses and Runs, as one line of JSON."""

    def plain(value):
        # Its scenario makes a run.
        value = getattr(value, "scenario", value)
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return str(value)

    return json.dumps(scenario, default=plain)


def running_notebook():
    """Name of the notebook that runs: by our runner, by JupyterLab, or None."""
    path = os.environ.get("RHEC_NOTEBOOK") or os.environ.get("JPY_SESSION_NAME")
    return Path(path).name if path else None


def set_changed(notebook, changed):
    """Tell with which parameters figures and tables are made from now on.

    Those of a notebook with changed parameters go into a folder of their own, unless RHEC_FIGURES
    names one, so that they never replace those of the paper. They name what was changed.

    Args:
        notebook: Name of the notebook, without a suffix.
        changed: {parameter: value} of those that differ from the notebook's own.

    Returns:
        The folder of its figures and tables.
    """
    global _running
    _running = (notebook, changed) if changed else _OWN_PARAMETERS
    return _folder()


def _folder():
    """The folder of the figures and tables of the notebook that runs."""
    notebook, changed = _running
    if not changed or "RHEC_FIGURES" in os.environ:
        return FOLDER
    text = ",".join(f"{name}={value}" for name, value in changed.items())
    text = re.sub(r"[^\w.,=+-]+", "_", text)
    if len(text) > _LONGEST_NAME:
        text = f"{text[:_LONGEST_NAME]}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    return FOLDER / notebook / text


def _note():
    """The changed parameters of the notebook that runs, as a line; "" if there are none."""
    _, changed = _running
    return ", ".join(f"{name} = {value}" for name, value in changed.items())


def provenance(name, scenario, notebook=None, note=""):
    """Where a file came from, by keys that a PDF allows; its Keywords are the scenario.

    The Subject is the notebook and, after a comma, the parameters that were changed.
    """
    notebook = notebook or running_notebook() or (note and f"{_running[0]}.ipynb")
    metadata = {
        "Title": name,
        "Creator": f"rhec {__version__}, source {source()}",
        "Subject": ", ".join(filter(None, [notebook, note])) or None,
        "Keywords": None if scenario is None else _as_json(scenario),
    }
    return {key: value for key, value in metadata.items() if value is not None}


def as_comments(metadata):
    """A provenance as comments at the beginning of a LaTeX file."""
    return "".join(f"% {key}: {value}\n" for key, value in metadata.items())


def note_of(csv):
    """The changed parameters behind a table, from the LaTeX beside it; "" if there are none."""
    tex = Path(csv).with_suffix(".tex")
    text = tex.read_text(encoding="utf-8") if tex.exists() else ""
    found = re.search(r"^% Subject: [^,\n]*, (.*)$", text, re.MULTILINE)
    return found[1] if found else ""


def source_of(png):
    """Version and digest of the source behind a figure, from the PDF beside it; "" without one."""
    pdf = Path(png).with_suffix(".pdf")
    creator = re.search(rb"/Creator \((.*?)\)", pdf.read_bytes()) if pdf.exists() else None
    return creator[1].decode() if creator else ""


@dataclasses.dataclass(frozen=True)
class Saved:
    """A saved figure; a notebook shows its PNG, so that it is drawn once."""

    png: Path

    def __repr__(self):
        return self.png.name

    def _repr_png_(self):
        return self.png.read_bytes()


def save(figure, name, scenario=None, folder=None, notebook=None):
    """Write a figure as PNG and PDF, with reproducible bytes.

    Args:
        figure: The matplotlib Figure.
        name: Name of the files, without a suffix.
        scenario: A Scenario or a Run, or nested dicts and lists that describe the runs.
        folder: Folder of the files, which is created if needed; by default that of the notebook
            that runs.
        notebook: Name of the notebook; by default the one that runs.

    Returns:
        Saved, with the path of the PNG.
    """
    import matplotlib as mpl

    note = "" if folder else _note()
    png = Path(folder or _folder()) / f"{name}.png"
    png.parent.mkdir(parents=True, exist_ok=True)
    metadata = provenance(name, scenario, notebook, note)
    # savefig applies the default layout to figures without one, so the default must be none here.
    layout = mpl.rc_context(RC | {"figure.constrained_layout.use": False})
    with layout, _noted(figure, note) as box:
        with replacing(png) as unfinished:
            creator = {"Creator": f"rhec {__version__}"}
            figure.savefig(unfinished, format="png", metadata=metadata | creator, bbox_inches=box)
        # To memory first, because Matplotlib's PDF writer hides the error of a full disk.
        pdf = io.BytesIO()
        undated = metadata | {"CreationDate": None}
        figure.savefig(pdf, format="pdf", metadata=undated, bbox_inches=box)
        with replacing(png.with_suffix(".pdf")) as unfinished:
            unfinished.write(pdf.getvalue())
    _list_as_made(png, png.with_suffix(".pdf"))
    return Saved(png)


@contextlib.contextmanager
def _noted(figure, note):
    """A context in which a figure has a line above it, and what of it is saved then."""
    if not note:
        yield None
        return
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches()
    line = figure.text(
        0.02, 1.0, note, size=SMALL_PT, color=VERMILLION, va="bottom", parse_math=False
    )
    try:
        yield Bbox([[0, 0], [width, height + _NOTE_IN]])
    finally:
        line.remove()


def _list_as_made(*files):
    """List files of a notebook's run, for `make clean`; not those of a user's own folder."""
    made = os.environ.get("RHEC_MADE")
    if made and files[0].parent == _folder():
        with open(made, "a", encoding="utf-8") as listing:
            listing.writelines(f"{file.relative_to(ROOT)}\n" for file in files)


def save_table(dataframe, name, caption, folder=None, scenario=None, notebook=None):
    """Write a DataFrame without index as CSV with all digits and as LaTeX with four digits.

    Args:
        dataframe: The table.
        name: Name of the files, without a suffix.
        caption: Caption in LaTeX; the table needs the package booktabs.
        folder, scenario, notebook: As in `save`.

    Returns:
        The path of the CSV.
    """
    note = "" if folder else _note()
    csv = Path(folder or _folder()) / f"{name}.csv"
    csv.parent.mkdir(parents=True, exist_ok=True)
    label = f"tab:{name}"
    if note:
        caption = f"{caption} ({note.translate(_LATEX)})"
    look = dict(index=False, escape=True, float_format="%.4g", caption=caption, label=label)
    with replacing(csv) as unfinished:
        dataframe.to_csv(unfinished, index=False)
    comments = as_comments(provenance(name, scenario, notebook, note))
    with replacing(csv.with_suffix(".tex")) as unfinished:
        unfinished.write((comments + dataframe.to_latex(**look)).encode())
    _list_as_made(csv, csv.with_suffix(".tex"))
    return csv
