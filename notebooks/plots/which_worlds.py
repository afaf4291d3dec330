"""The inverse problem: which worlds give the paper's numbers."""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.plots.parts import ticks_at_the_ends
from notebooks.studies import which_worlds
from rhec.style import BLACK, BLUE, DOUBLE_IN, GREY, ORANGE, SMALL_PT, styled

_COLUMNS = 4
_BINS = 12
_LEARNED = 0.15  # an unknown whose interval is narrowed by this much is drawn in colour


@styled
def posterior(worlds, table):
    """Draw each unknown's posterior as a histogram over its prior's range, where the prior is flat.

    Args:
        worlds: Of `notebooks.studies.which_worlds.posterior_draws`.
        table: Of `notebooks.studies.which_worlds.learned`.

    Returns:
        A Figure; unknowns of which the paper's numbers tell little are grey.
    """
    rows = -(-len(table) // _COLUMNS)
    size = (DOUBLE_IN, 1.1 * rows)
    figure, panels = plt.subplots(rows, _COLUMNS, figsize=size, squeeze=False)
    for axes, (name, row) in zip(panels.flat, table.iterrows()):
        prior = which_worlds.PRIORS[name]
        space = np.geomspace if prior.logarithmic else np.linspace
        edges = space(prior.least, prior.most, _BINS + 1)
        values = worlds[name].dropna()
        counts, _ = np.histogram(values, edges)
        colour = BLUE if row["narrowed"] > _LEARNED else GREY
        density = counts / len(values) * _BINS
        axes.stairs(density, edges, fill=True, color=colour, alpha=0.6)
        axes.axhline(1, color=BLACK, linewidth=0.6, linestyle=":")
        axes.axvline(row["median"], color=ORANGE, linewidth=1)
        if prior.logarithmic:
            axes.set(xscale="log")
            axes.minorticks_off()
        ticks_at_the_ends(axes, edges[[0, _BINS // 2, _BINS]])
        axes.set_ylim(0, max(2.5, 1.1 * density.max()))
        axes.set_xlabel(name, labelpad=1, fontsize=SMALL_PT)
        axes.set_title(f"narrowed by {max(100 * row['narrowed'], 0):.0f} %", fontsize=SMALL_PT)
        axes.tick_params(axis="x", labelsize=SMALL_PT)
    for axes in panels.flat[len(table) :]:
        axes.set_visible(False)
    figure.supylabel(f"posterior / prior, {len(worlds)} draws", fontsize=8)
    return figure
