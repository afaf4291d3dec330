"""The inverse problem: which worlds give the paper's numbers."""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.plots.parts import log_axis, ticks_at_the_ends
from notebooks.studies import which_worlds
from rhec import paper
from rhec.style import BLACK, BLUE, DOUBLE_IN, GREY, ORANGE, SMALL_PT, VERMILLION, styled

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


@styled
def predictions(prior, posterior):
    """Draw errors and violations of single drives, and the paper's.

    Args:
        prior: (n, k) statistics of drives of the prior.
        posterior: (m, k) those of the posterior.

    Returns:
        A Figure.
    """
    figure, panels = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.6))
    errors, counts = panels
    names = list(which_worlds.STATEMENTS)
    for statistics, colour, name in [(prior, GREY, "prior"), (posterior, BLUE, "posterior")]:
        of = dict(zip(names, statistics.T))
        look = dict(s=2, color=colour, linewidth=0, alpha=0.5, label=name, rasterized=True)
        errors.scatter(np.exp(of["error_rhe"]), np.exp(of["error_ekf"]), **look)
        # Counts are whole: spread within a unit, they do not hide each other.
        spread = np.random.default_rng(0).uniform(-0.4, 0.4, (2, len(statistics)))
        counts.scatter(
            of["violations_rhe"] ** 2 + spread[0], of["violations_ekf"] ** 2 + spread[1], **look
        )
    paper_look = dict(marker="*", color=VERMILLION, s=60, zorder=5, label="the paper")
    errors.scatter(paper.MEAN_ERROR_RHE_M, paper.MEAN_ERROR_EKF_M, **paper_look)
    counts.scatter(paper.VIOLATIONS_RHE, paper.VIOLATIONS_EKF, **paper_look)
    errors.set(xlim=(0.01, 0.5), ylim=(0.01, 0.5))
    log_axis(errors.xaxis)
    log_axis(errors.yaxis)
    errors.set(xlabel="mean error with the RHE [m]", ylabel="mean error with the EKF [m]")
    counts.set(xlim=(-1, 60), ylim=(-1, 120))
    counts.set(xlabel="violations with the RHE", ylabel="violations with the EKF")
    errors.set_title(f"{len(prior)} drives of the prior, {len(posterior)} of the posterior")
    errors.legend(loc="lower right", markerscale=1.5)
    return figure
