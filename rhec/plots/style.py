"""One look for every figure and table, and the file that says where it came from.

A figure function takes data, returns a matplotlib Figure and is decorated with `styled`; `save` and
`save_table` write files that carry the version, a digest of the source, the scenario and the
notebook that made them.
"""

import dataclasses
import functools
import hashlib
import json
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt

from rhec import __version__

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "figures"

COLUMN_IN, DOUBLE_IN = 3.4, 6.5  # widths of the paper's figures [in]

# Okabe and Ito's palette, told apart by colour-blind readers: one colour a role, the same in every
# figure.
BLACK, GREY = "#000000", "#7f7f7f"
ORANGE, SKY, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILLION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
COLOURS = {
    "reference": GREY,
    "truth": BLACK,
    "measured": SKY,
    "RHE": BLUE,
    "EKF": VERMILLION,
    "oracle": GREEN,
    "tolerance": YELLOW,
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
    """Decorator: `draw` runs in the style and its Figure is handed over, whatever the caller's own
    rcParams.
    """

    @functools.wraps(draw)
    def drawn(*args, **kwargs):
        # a notebook's backend sets rcParams when first used: not inside the context
        plt.draw_if_interactive()
        with mpl.rc_context(RC):
            figure = draw(*args, **kwargs)
            figure.draw_without_rendering()  # ticks take their style when first drawn
        plt.close(figure)  # else pyplot keeps it, and a notebook shows it twice
        return figure

    return drawn


def source(root=ROOT):
    """Digest of what figures are made of. Not the commit's name: making them again in a fresh clone
    would then change them.
    """
    files = sorted(
        [*root.glob("rhec/**/*.py"), *root.glob("data/*"), *root.glob("notebooks/*.ipynb")]
    )
    return hashlib.sha256(
        b"".join(file.relative_to(root).as_posix().encode() + file.read_bytes() for file in files)
    ).hexdigest()[:12]


def describe(scenario):
    """A scenario, or any nest of dicts, lists and dataclasses, as one line of JSON."""

    def plain(value):
        if dataclasses.is_dataclass(value):
            return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return str(value)

    return json.dumps(scenario, default=plain)


def provenance(name, scenario, notebook):
    """What a file says of its making, under keys that a PDF allows; the scenario, with its seed, is
    the Keywords.
    """
    about = {
        "Title": name,
        "Creator": f"rhec {__version__} (source {source()})",
        "Subject": notebook,
        "Keywords": None if scenario is None else describe(scenario),
    }
    return {key: value for key, value in about.items() if value is not None}


def save(figure, name, scenario=None, folder=FOLDER, notebook=None):
    """Write `figure` to folder/name.png and .pdf, byte for byte the same if made again; return the
    PNG's path.
    """
    png = _in(folder, f"{name}.png")
    about = provenance(name, scenario, notebook)
    # savefig leaves a figure that has no layout with the default one, so that default must be none
    # here
    with mpl.rc_context(RC | {"figure.constrained_layout.use": False}):
        figure.savefig(png, metadata=about)
        figure.savefig(png.with_name(f"{name}.pdf"), metadata=about | {"CreationDate": None})
    return png


def save_table(dataframe, name, caption, folder=FOLDER, scenario=None, notebook=None):
    """Write the columns of `dataframe`, not its index, to folder/name.csv in full and to name.tex
    in four digits.

    The caption is LaTeX, the table needs the package booktabs. Returns the CSV's path.
    """
    csv = _in(folder, f"{name}.csv")
    about = "".join(
        f"% {key}: {value}\n" for key, value in provenance(name, scenario, notebook).items()
    )
    table = dataframe.to_latex(
        index=False, escape=True, float_format="%.4g", caption=caption, label=f"tab:{name}"
    )
    dataframe.to_csv(csv, index=False)
    csv.with_name(f"{name}.tex").write_text(about + table, encoding="utf-8")
    return csv


def _in(folder, file):
    Path(folder).mkdir(parents=True, exist_ok=True)
    return Path(folder) / file
