"""Pictures as data: panels and their marks.

Matplotlib draws them as a figure; a page draws them from a list of marks and a buffer of numbers.
"""

from typing import NamedTuple

import numpy as np

from rhec.style import BLACK, BLUE, COLOURS, DOUBLE_IN, SOIL, styled

_PX = 4 / 3  # one point [px]
# CSS variables that adapt to dark pages.
_PAGE_COLOURS = {BLACK: "--ink", BLUE: "--blue", COLOURS["tolerance"]: "--tolerance"}


class Mark(NamedTuple):
    """A "line", the "area" inside a line, "dots", or "soil": traction (n_x, n_y) over a grid.

    width: line width or diameter of dots [pt]; dash: lengths of dashes and gaps [pt]; full: False
    for rings; label: text in the legend, by which a reader hides marks; note: what else than the
    label stands beside a value under the pointer, None if its values are not told. NaN leaves a
    gap.
    """

    kind: str
    x: np.ndarray
    y: np.ndarray
    colour: str = BLACK
    width: float = 0.75
    alpha: float = 1.0
    dash: tuple = ()
    full: bool = True
    label: str = ""
    note: str | None = None
    traction: np.ndarray | None = None


class Panel(NamedTuple):
    """A pair of axes.

    scale: "equal" for equal scales, "log" for a logarithmic y axis, or ""; across: what is along x.
    """

    title: str
    xlim: tuple
    ylim: tuple
    marks: list
    scale: str = ""
    across: str = ""


class Picture(NamedTuple):
    """Panels by name. A row of `layout` has the names of its panels, as in CSS grid areas."""

    layout: tuple
    panels: dict

    @property
    def legend(self):
        """The first mark with each label, starting with the topmost one."""
        marks = [mark for panel in self.panels.values() for mark in reversed(panel.marks)]
        first = {}
        for mark in marks:
            first.setdefault(mark.label, mark)
        return [mark for label, mark in first.items() if label]


@styled
def figure_of(picture):
    """A Picture as a matplotlib Figure."""
    from matplotlib.figure import Figure  # here, because a page draws without Matplotlib

    figure = Figure(figsize=(DOUBLE_IN, 4.3))
    axes = figure.subplot_mosaic([row.split() for row in picture.layout])
    for name, panel in picture.panels.items():
        ax = axes[name]
        if panel.scale == "log":
            ax.set_yscale("log")
        for height, mark in enumerate(panel.marks, 1):  # the grid is at 0.5
            _draw(ax, mark, height)
        ax.set_xlim(panel.xlim, auto=True)  # an equal scale widens one of both limits
        ax.set_ylim(panel.ylim, auto=True)
        ax.set_aspect("equal" if panel.scale == "equal" else "auto", adjustable="datalim")
        ax.set_title(panel.title)
        ax.set_xlabel(panel.across, loc="right")
    handles = [_line(mark, [], [], label=mark.label) for mark in picture.legend]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles))
    return figure


def _draw(axes, mark, height):
    """Draw a mark above those with a lower height."""
    if mark.kind == "soil":
        half = (mark.x[1] - mark.x[0]) / 2
        extent = (mark.x[0] - half, mark.x[-1] + half, mark.y[0] - half, mark.y[-1] + half)
        look = dict(origin="lower", interpolation="bilinear", cmap=_wet(), vmin=0, vmax=0.91)
        # As in plot.js: the root shows small differences on firm soil, too.
        axes.imshow(np.sqrt(1 - mark.traction.T), extent=extent, zorder=height, **look)
    elif mark.kind == "area":
        look = dict(color=mark.colour, alpha=mark.alpha, linewidth=0)
        axes.fill(mark.x, mark.y, zorder=height, **look)
    else:
        axes.add_line(_line(mark, mark.x, mark.y, zorder=height))


def _wet():
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("wet", [f"{SOIL}00", SOIL])


def _line(mark, x, y, **more):
    """The Line2D of a mark with a line or dots, or of any mark in a legend."""
    from matplotlib.lines import Line2D

    look = dict(color=mark.colour, alpha=mark.alpha, linewidth=mark.width)
    if mark.dash:  # Matplotlib counts dashes in line widths
        look |= dict(linestyle=(0, tuple(length / mark.width for length in mark.dash)))
    if mark.kind == "dots":
        look |= dict(linestyle="none", marker="o", markersize=mark.width)
        look |= {} if mark.full else dict(markerfacecolor="none")
    return Line2D(x, y, **look, **more)


def _look(mark):
    colour = _PAGE_COLOURS.get(mark.colour, mark.colour)
    width = mark.width * _PX
    dash = [_PX * length for length in mark.dash]
    line = dict(kind=mark.kind, colour=colour, width=width, radius=width / 2, dash=dash)
    return line | dict(alpha=mark.alpha, full=mark.full, label=mark.label, note=mark.note)


def packed(picture):
    """A Picture for a page: a description for JSON, and the bytes of all numbers (float32).

    The description of an array is (index of its first number, length).
    """
    arrays = []
    places = {}  # of each array by its id: many lines share the array of times

    def place(array):
        if id(array) not in places:
            places[id(array)] = sum(each.size for each in arrays), array.size
            arrays.append(array.ravel())
        return places[id(array)]

    def described(mark):
        drawn = dict(x=mark.x, y=mark.y, traction=mark.traction)
        own = {name: place(array) for name, array in drawn.items() if array is not None}
        return _look(mark) | own

    panels = {
        name: panel._replace(marks=[described(mark) for mark in panel.marks])._asdict()
        for name, panel in picture.panels.items()
    }
    legend = [_look(mark) for mark in picture.legend]
    content = dict(layout=picture.layout, panels=panels, legend=legend)
    with np.errstate(over="ignore"):
        joined = np.concatenate(arrays, dtype=np.float32, casting="same_kind")
    return content, joined.tobytes()
