"""Estimators and controllers ranked by the tracking error, and the error over the weight R."""

import matplotlib.pyplot as plt
import numpy as np

from rhec import paper
from rhec.workbench.plots import style
from rhec.workbench.plots.parts import DOTS, legend_above, legend_outside, note, seed_range
from rhec.workbench.studies import ranking
from rhec.workbench.studies.statistics import over_seeds

_FAMILIES = {  # {beginning of a contestant's name: colour}; all others are grey
    "yaw-drift": style.PURPLE,
    "RHE": style.COLOURS["RHE"],
    "EKF": style.COLOURS["EKF"],
    "traction": style.COLOURS["oracle"],
    "full oracle": style.BLACK,
}
_OFF_SCALE = 1.3  # upper limit of the axes as a multiple of the paper's RHE
_ERROR = ranking.QUANTITIES["mean_error_true_m"]


@style.styled
def ranked(sweep):
    """Draw the true error of every contestant, one panel a world, in the order of the first.

    Dots are seeds. A number at the edge counts seeds outside the axis; an arrow is a mean outside
    the axis. A star at a mean says that the first look excluded the contestant. The dashed line is
    the target of the proposal relative to the paper's RHE, the dotted one that relative to the
    oracle that knows traction and yaw drift.

    Args:
        sweep: As in `rhec.workbench.studies.ranking.ranking_table`.
    """
    table = ranking.ranking_table(sweep)
    worlds = list(dict.fromkeys(table["world"]))
    names = list(dict.fromkeys(table["contestant"]))
    estimates = table.set_index(["world", "contestant", "quantity"])[["mean", "low", "high"]]
    size = (style.DOUBLE_IN, 0.22 * len(names) + 0.9)
    figure, panels = plt.subplots(1, len(worlds), figsize=size, sharey=True, squeeze=False)
    for axes, world in zip(panels[0], worlds):
        _draw_world(axes, world, names, sweep[sweep["world"] == world], estimates)
    first = panels[0][0]
    legend_outside(figure, first, "lower center", 2)
    first.set_yticks(range(len(names)), names)
    first.set_ylim(len(names) - 0.4, -0.6)
    for label in first.get_yticklabels():
        label.set_fontweight("bold" if label.get_text() == ranking.PROPOSAL else "normal")
    return figure


def _draw_world(axes, world, names, sweep, estimates):
    """Draw the contestants of one world."""
    largest = _OFF_SCALE * estimates.loc[(world, ranking.PAPERS, _ERROR), "mean"]
    for place, name in enumerate(names):
        seeds = sweep.loc[sweep["contestant"] == name, "mean_error_true_m"].to_numpy()
        if len(seeds):
            colour = _colour_of(name)
            _draw_seeds(axes, place, seeds, largest, colour)
            star = "*" * (len(seeds) < sweep["seed"].nunique())
            estimate = estimates.loc[(world, name, _ERROR)]
            _draw_mean(axes, place, estimate, largest, colour, star)
    _draw_targets(axes, estimates.loc[world])
    axes.set_xlim(0, largest)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("mean true error of a drive [m]")
    n_seeds = sweep["contestant"].value_counts()
    fewer = f"\n(*: {n_seeds.min()} of them)" if n_seeds.min() < n_seeds.max() else ""
    axes.set_title(f"{world} world: {seed_range(sweep)}{fewer}")


def _colour_of(name):
    """The colour of an estimator's family."""
    families = (colour for family, colour in _FAMILIES.items() if name.startswith(family))
    return next(families, style.GREY)


def _draw_seeds(axes, place, errors, largest, colour):
    """Draw a dot for each seed, and the number of seeds outside the axis."""
    spread = np.linspace(0.3, -0.3, len(errors))
    inside = errors < largest
    dots = dict(color=colour, markersize=1.5, alpha=0.3)
    axes.plot(errors[inside], (place + spread)[inside], **DOTS, **dots)
    if not inside.all():
        # A white box keeps the number readable on top of the dots.
        box = dict(boxstyle="square,pad=0.1", facecolor="w", edgecolor="none", alpha=0.85)
        look = dict(ha="right", fontsize=5.5, color=colour, bbox=box, zorder=4)
        note(axes, f"{(~inside).sum()} off scale", (largest, place), (-4, 0), **look)


def _draw_mean(axes, place, estimate, most, colour, star):
    """Draw a mean with its 95 % interval, or an arrow at the edge, and its number at the right.

    A star stands at the number.
    """
    mean, low, high = estimate
    if mean < most:
        look = dict(fmt="D", markeredgecolor="w", markeredgewidth=0.5, markersize=4, capsize=2)
        axes.errorbar(
            mean, place, xerr=[[mean - low], [high - mean]], color=colour, zorder=3, **look
        )
    else:
        axes.plot(most, place, ">", color=colour, markersize=4, clip_on=False)
    note(axes, f"{mean:.4f}{star}", (1, place), (5, 0), xycoords=("axes fraction", "data"))


def _draw_targets(axes, estimates):
    """Draw vertical lines at the targets relative to the paper's RHE and to the oracle."""
    look = dict(color=style.BLACK, linewidth=0.7)
    aims = [
        (ranking.PAPERS, 1 - ranking.LEAST_GAIN, "--", f"{100 * ranking.LEAST_GAIN:.0f} % below"),
        (ranking.LIMIT, 1 + ranking.MOST_ABOVE, ":", f"{100 * ranking.MOST_ABOVE:.0f} % above"),
    ]
    for name, factor, line, words in aims:
        if (name, _ERROR) in estimates.index:
            mean = estimates.loc[(name, _ERROR), "mean"]
            axes.axvline(factor * mean, **look, linestyle=line, label=f"{words} {name}")


@style.styled
def over_gain(rows):
    """Draw mean true errors over the controller's weight R. A ring marks each minimum.

    Bands are 95 % intervals over seeds, the dotted line the paper's R.

    Args:
        rows: Table of `rhec.workbench.studies.ranking.by_gain`.
    """
    figure, axes = plt.subplots(figsize=(style.COLUMN_IN, 3.4))
    colours = (style.COLOURS["RHE"], style.ORANGE, style.PURPLE, style.GREY)
    colours += (style.VERMILLION, style.COLOURS["oracle"])
    for colour, (name, of_name) in zip(colours, rows.groupby("contestant", sort=False)):
        by_weight = of_name.groupby("r")["mean_error_true_m"]
        weights = np.array([weight for weight, _ in by_weight])
        mean, low, high = np.array([over_seeds(np.mean, seeds)[:3] for _, seeds in by_weight]).T
        axes.plot(weights, mean, color=colour, label=name)
        axes.fill_between(weights, low, high, color=colour, alpha=0.2, linewidth=0)
        least = mean.argmin()
        ring = dict(color="w", markeredgecolor=colour, markersize=5)
        axes.plot(weights[least], mean[least], "o", **ring)
    axes.axvline(paper.R, color=style.GREY, linestyle=":")
    axes.set_xscale("log")
    axes.set(xlabel="weight R of the yaw rate, eq. (22)", ylabel="mean true error [m]")
    legend_above(axes, ncols=1, handlelength=1.5)
    return figure
