"""Loops of estimator and controller by their tracking error, and the error over the weight R."""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.further import traction_worth
from notebooks.plots.parts import DOTS, legend_above, note
from notebooks.studies.statistics import over_seeds
from rhec import paper, style

_FAMILIES = {  # {beginning of a loop's name: colour}; all others are grey
    "yaw-drift": style.PURPLE,
    "RHE": style.COLOURS["RHE"],
    "EKF": style.COLOURS["EKF"],
    "traction": style.COLOURS["oracle"],
    "full oracle": style.BLACK,
}
_OFF_SCALE = 1.3  # upper limit of the axis as a multiple of the paper's RHE


@style.styled
def ranked(tables, worth):
    """Draw the true error of every loop, the best above, a dot a seed.

    A number at the edge counts seeds outside the axis, and an arrow is a mean outside. A star at a
    mean says that the loop had the first look alone. The tables are those of
    `notebooks.further.traction_worth.in_two_looks`, worth is their `worth_table`.
    """
    means = worth[worth["quantity"] == traction_worth.ERROR].set_index("loop")
    n_fields = means["n"].max()
    largest = _OFF_SCALE * means.loc[traction_worth.PAPERS, "mean"]
    figure, axes = plt.subplots(figsize=(style.DOUBLE_IN, 0.22 * len(means) + 0.9))
    for place, (name, mean) in enumerate(means.iterrows()):
        colour = _colour_of(name)
        errors = tables[name]["mean_error_true_m"].to_numpy()
        _draw_seeds(axes, place, errors, largest, colour)
        star = "*" if mean["n"] < n_fields else ""
        _draw_mean(axes, place, mean[["mean", "low", "high"]], largest, colour, star)
    axes.set_yticks(range(len(means)), means.index)
    axes.set_ylim(len(means) - 0.4, -0.6)
    axes.set_xlim(0, largest)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("mean true error of a drive [m]")
    fewer = f" (*: {means['n'].min()} of them)" if means["n"].min() < n_fields else ""
    axes.set_title(f"{n_fields} fields{fewer}")
    return figure


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


@style.styled
def over_gain(rows):
    """Draw mean true errors over the controller's weight R. A ring marks each minimum.

    Bands are 95 % intervals over seeds, the dotted line the paper's R. The rows are those of
    `notebooks.further.traction_worth.by_gain`.
    """
    figure, axes = plt.subplots(figsize=(style.COLUMN_IN, 3.4))
    colours = (style.COLOURS["RHE"], style.ORANGE, style.PURPLE, style.GREY)
    colours += (style.VERMILLION, style.COLOURS["oracle"])
    for colour, (name, of_name) in zip(colours, rows.groupby("loop", sort=False)):
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
