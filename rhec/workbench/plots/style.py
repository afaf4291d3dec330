"""One look for every figure and table, and files that say where they came from.

A figure function takes data, returns a matplotlib Figure and is decorated with `styled`. Files
carry the version, the scenario and the notebook that made them; all but PNGs carry a digest of the
source, too. A PNG has none, so that pictures kept in git change only with what they show.
"""

import contextlib
import dataclasses
import functools
import hashlib
import json
import re
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from rhec import __version__

__all__ = ["BLACK", "BLUE", "COLOURS", "COLUMN_IN", "DOUBLE_IN", "FOLDER", "GREEN", "GREY"]
__all__ += ["ORANGE", "PURPLE", "RC", "ROOT", "ROWS", "SKY", "VERMILLION", "as_comments"]
__all__ += ["provenance", "save", "save_table", "source", "source_of", "styled"]

ROOT = Path(__file__).resolve().parents[3]
# Installed from a wheel, there is no project, and nothing is written among the packages.
FOLDER = (ROOT if (ROOT / "pyproject.toml").exists() else Path.cwd()) / "figures"
ROWS = ROOT / "build/campaign/notebooks"  # of campaigns: what one notebook drove serves another

# widths of the paper's figures [in]
COLUMN_IN = 3.4
DOUBLE_IN = 6.5

# Okabe and Ito's palette, told apart by colour-blind readers: one colour a role in every figure
BLACK = "#000000"
GREY = "#7f7f7f"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
_YELLOW = "#F0E442"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
PURPLE = "#CC79A7"
COLOURS = {
    "reference": GREY,
    "truth": BLACK,
    "measured": SKY,
    "RHE": BLUE,
    "EKF": VERMILLION,
    "oracle": GREEN,
    "tolerance": _YELLOW,
    "Q1": ORANGE,
    "Q2": PURPLE,
    "Q3": BLUE,  # Q3 is the RHE's controller everywhere else, so it keeps the RHE's colour
}

RC = {
    "figure.figsize": (COLUMN_IN, 2.2),
    "figure.constrained_layout.use": True,
    "font.family": "STIXGeneral",  # ships with matplotlib and matches the paper's Times
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titlelocation": "left",
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "axes.prop_cycle": mpl.cycler(color=[BLUE, VERMILLION, GREEN, ORANGE, SKY, PURPLE, BLACK]),
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
    "pdf.fonttype": 42,  # text stays text
}


def styled(draw):
    """Decorate a figure function: it draws in this style, whatever the caller's rcParams are."""

    @functools.wraps(draw)
    def drawn(*args, **kwargs):
        # a notebook's backend sets rcParams when first used: not inside the context
        plt.draw_if_interactive()
        with mpl.rc_context(RC):
            figure = draw(*args, **kwargs)
            # Ticks take their style when first asked for; how many they are follows the size that
            # their labels are told to have, each time they are drawn.
            shown = (axes for axes in figure.axes if axes.axison)
            for axis in (each for axes in shown for each in (axes.xaxis, axes.yaxis)):
                sizes = {label.get_fontsize() for label in axis.get_ticklabels()}
                if len(sizes) == 1:
                    axis.set_tick_params(labelsize=sizes.pop())
            figure.draw_without_rendering()
        plt.close(figure)  # else pyplot keeps it, and a notebook shows it twice
        return figure

    return drawn


def source(root=ROOT):
    """Digest of what figures are made of: modules, the standard fields and notebooks.

    The commit's name is no such digest: making the figures again in a fresh clone would change it.
    """
    patterns = ("rhec/**/*.py", "data/*.npz", "notebooks/*.ipynb")
    files = sorted(file for pattern in patterns for file in root.glob(pattern) if file.is_file())
    pieces = (file.relative_to(root).as_posix().encode() + file.read_bytes() for file in files)
    return hashlib.sha256(b"".join(pieces)).hexdigest()[:12]


def _as_json(scenario):
    """A scenario, or any nest of dicts, lists and dataclasses, as one line of JSON."""

    def plain(value):
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return str(value)

    return json.dumps(scenario, default=plain)


def provenance(name, scenario, notebook):
    """Where a file came from, by keys that a PDF allows; its Keywords are the scenario."""
    about = {
        "Title": name,
        "Creator": f"rhec {__version__}, source {source()}",
        "Subject": notebook,
        "Keywords": None if scenario is None else _as_json(scenario),
    }
    return {key: value for key, value in about.items() if value is not None}


def as_comments(about):
    """A provenance as comments at the beginning of a LaTeX file."""
    return "".join(f"% {key}: {value}\n" for key, value in about.items())


def source_of(png):
    """Version and digest of the source behind a figure, from the PDF beside it; "" without one."""
    pdf = Path(png).with_suffix(".pdf")
    creator = re.search(rb"/Creator \((.*?)\)", pdf.read_bytes()) if pdf.exists() else None
    return creator[1].decode() if creator else ""


def save(figure, name, scenario=None, folder=FOLDER, notebook=None):
    """Write a figure as PNG and PDF, byte for byte the same if made again.

    Args:
        figure: a matplotlib Figure.
        name: of the files, without a suffix.
        scenario: a rhec.Scenario, or any nest of dicts and lists with what made the figure.
        folder: where the files go; made if it is not there.
        notebook: name of the notebook that made it.

    Returns:
        The PNG's path.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    png = Path(folder) / f"{name}.png"
    about = provenance(name, scenario, notebook)
    # savefig gives a figure without a layout the default one, which must be none here
    with mpl.rc_context(RC | {"figure.constrained_layout.use": False}):
        with _replacing(png) as unfinished:
            creator = {"Creator": f"rhec {__version__}"}
            figure.savefig(unfinished, format="png", metadata=about | creator)
        figure.set_layout_engine(None)  # it stands, and takes as long as to draw
        with _replacing(png.with_suffix(".pdf")) as unfinished:
            figure.savefig(unfinished, format="pdf", metadata=about | {"CreationDate": None})
    return png


@contextlib.contextmanager
def _replacing(file):
    """A context with the path of an unfinished file, which replaces the file once it is whole."""
    unfinished = file.with_name(f"{file.name}.unfinished")
    try:
        yield unfinished
        unfinished.replace(file)
    finally:
        unfinished.unlink(missing_ok=True)


def save_table(dataframe, name, caption, folder=FOLDER, scenario=None, notebook=None):
    """Write the columns of a DataFrame, not its index, as CSV in full and as LaTeX in four digits.

    Args:
        dataframe: the table.
        name: of the files, without a suffix.
        caption: in LaTeX; the table needs the package booktabs.
        folder, scenario, notebook: as for `save`.

    Returns:
        The CSV's path.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    csv = Path(folder) / f"{name}.csv"
    label = f"tab:{name}"
    look = dict(index=False, escape=True, float_format="%.4g", caption=caption, label=label)
    with _replacing(csv) as unfinished:
        dataframe.to_csv(unfinished, index=False)
    about = as_comments(provenance(name, scenario, notebook))
    with _replacing(csv.with_suffix(".tex")) as unfinished:
        unfinished.write_text(about + dataframe.to_latex(**look), encoding="utf-8")
    return csv
