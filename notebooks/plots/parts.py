"""Shared parts of figures: panels, bounds, intervals, legends, axes."""

import matplotlib.pyplot as plt
import numpy as np

import rhec
from notebooks.studies.tables import with_minus
from rhec.style import BLACK, COLOURS, DOUBLE_IN, SMALL_PT

BOUND = dict(color=BLACK, linewidth=0.6, linestyle="--")
TOLERANCE = dict(color=COLOURS["tolerance"], alpha=0.35, linewidth=0, zorder=0)
_OF_WORLDS = {field for fields in rhec.WORLDS.values() for field in fields}  # what they differ in


def panels_beside(n, height_in):
    """A figure with n panels side by side and a common y axis."""
    size = (DOUBLE_IN, height_in)
    figure, panels = plt.subplots(1, n, figsize=size, sharey=True, squeeze=False)
    return figure, panels[0]


def world_text(scenario):
    """The world of a Scenario by its name, for a title."""
    for name, fields in rhec.WORLDS.items():
        usual = rhec.Scenario(**fields)
        if all(getattr(scenario, field) == getattr(usual, field) for field in _OF_WORLDS):
            return f"{name} world"
    return "a world of its own"


def frequencies(axes, values, limits, colour, bins=50):
    """Draw which percentage of the values is in each bin, an outline along the vertical axis.

    Values beyond the limits count in the outermost bins.
    """
    edges = np.linspace(*limits, bins + 1)
    counts, _ = np.histogram(np.clip(values, *limits), edges)
    axes.stairs(100 * counts / np.size(values), edges, orientation="horizontal", color=colour)
    axes.set_xlim(left=0, auto=True)


def note(axes, text, xy, offset=(0, 0), **look):
    """Write small text at an offset [points] from a point."""
    look = dict(textcoords="offset points", fontsize=SMALL_PT, va="center") | look
    axes.annotate(text, xy, offset, **look)


def shade(axes, t_s, where):
    """Shade the times at which `where` is true."""
    look = dict(color="0.93", linewidth=0, zorder=0)
    axes.fill_between(t_s, 0, 1, where=where, transform=axes.get_xaxis_transform(), **look)


def time_axis(panels, t_s, where, shaded):
    """Label the time axis of the last panel, and shade times in all panels."""
    for axes in panels:
        shade(axes, t_s, where)
        axes.grid(axis="x", visible=False)
    panels[-1].set(xlabel=f"time [s]  (shaded: {shaded})", xlim=(t_s.min(), t_s.max()))


def legend_above(axes):
    """Add a legend in one line above the axes, at the right."""
    entries = axes.get_legend_handles_labels()
    place = dict(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1)
    axes.legend(*entries, **place, ncols=len(entries[0]))


def legend_outside(figure, axes, place):
    """Add a legend in one line of the entries of the axes at an edge of the figure."""
    entries = axes.get_legend_handles_labels()
    figure.legend(*entries, loc=f"outside {place}", ncols=len(entries[0]))


def ticks_at_the_ends(axes, ticks):
    """Limit the x axis to three ticks: both ends, with their labels inside, and the middle."""
    axes.set_xlim(ticks[0], ticks[-1])
    texts = [f"{tick:.2g}" if abs(tick) < 100 else f"{tick:.0f}" for tick in ticks]
    axes.set_xticks(ticks, [with_minus(text) for text in texts])
    for label, side in zip(axes.get_xticklabels(), ("left", "center", "right")):
        label.set_horizontalalignment(side)
