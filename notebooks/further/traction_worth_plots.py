"""Loops of estimator and controller by their tracking error, and a map over the soil."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from notebooks.further import traction_map, traction_worth, unknowns
from notebooks.plots.parts import DOTS, legend_outside, log_axis, note, panels_beside
from notebooks.studies.tables import with_minus
from rhec import paper, style

_FAMILIES = {  # {beginning of a loop's name: colour}; all others are grey
    "yaw-drift": style.PURPLE,
    "RHE": style.COLOURS["RHE"],
    "EKF": style.COLOURS["EKF"],
    "traction": style.COLOURS["oracle"],
    "full oracle": style.BLACK,
}
_WORTH = LinearSegmentedColormap.from_list("worth", [style.SKY, "w", style.ORANGE])
_SPAN = 0.3  # of the ratios that differ in colour, on both sides of 1
_OFF_SCALE = 1.3  # upper limit of the axis as a multiple of the paper's RHE


@style.styled
def ranked(tables, worth):
    """Draw the true error of every loop, the best above, a dot a seed.

    A number at the edge counts seeds outside the axis, and an arrow is a mean outside. The tables
    are those of `notebooks.further.traction_worth.drive`, worth is their `worth_table`.
    """
    means = worth[worth["quantity"] == traction_worth.ERROR].set_index("loop")
    largest = _OFF_SCALE * means.loc[traction_worth.PAPERS, "mean"]
    figure, axes = plt.subplots(figsize=(style.DOUBLE_IN, 0.22 * len(means) + 0.9))
    for place, (name, mean) in enumerate(means.iterrows()):
        colour = _colour_of(name)
        errors = tables[name]["mean_error_true_m"].to_numpy()
        _draw_seeds(axes, place, errors, largest, colour)
        _draw_mean(axes, place, mean[["mean", "low", "high"]], largest, colour)
    axes.set_yticks(range(len(means)), means.index)
    axes.set_ylim(len(means) - 0.4, -0.6)
    axes.set_xlim(0, largest)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("mean true error of a drive [m]")
    axes.set_title(f"{means['n'].max()} fields")
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
        look = dict(ha="right", color=colour, bbox=box, zorder=4)
        note(axes, f"{(~inside).sum()} off scale", (largest, place), (-4, 0), **look)


def _draw_mean(axes, place, estimate, most, colour):
    """Draw a mean with its 95 % interval, or an arrow at the edge, and its number at the right."""
    mean, low, high = estimate
    if mean < most:
        look = dict(fmt="D", markeredgecolor="w", markeredgewidth=0.5, markersize=4, capsize=2)
        axes.errorbar(
            mean, place, xerr=[[mean - low], [high - mean]], color=colour, zorder=3, **look
        )
    else:
        axes.plot(most, place, ">", color=colour, markersize=4, clip_on=False)
    note(axes, f"{mean:.4f}", (1, place), (5, 0), xycoords=("axes fraction", "data"))


_ROBOTS = {  # {robot: colour and line} of the picture of unknowns
    unknowns.NOTHING: (style.GREY, ":"),
    unknowns.TOLD_TRACTION: (style.BLACK, ":"),
    unknowns.TRACTION: (style.COLOURS["RHE"], "--"),
    unknowns.GYRO: (style.GREEN, "--"),
    unknowns.DRIFT: (style.PURPLE, "-"),
    unknowns.BOTH: (style.COLOURS["RHE"], "-"),
    unknowns.ALL: (style.GREEN, "-"),
}

_LEAST_M, _MOST_M = 0.008, 0.2  # limits of its axis


@style.styled
def unknowns_by_difference(table):
    """Draw the errors over the difference of the tracks' slip, and those of other worlds.

    Args:
        table: Of `notebooks.further.unknowns.worth_table`.
    """
    errors = table[table["quantity"] == unknowns.ERROR]
    figure, panels = panels_beside(2, 3.4)
    for axes, weights in zip(panels, (unknowns.AS_PRINTED, unknowns.TUNED)):
        of_weights = errors[errors["weights"] == weights].set_index(["robot", "world"])
        for number, (robot, (colour, line)) in enumerate(_ROBOTS.items()):
            shift = 0.03 * (number - len(_ROBOTS) / 2)
            _draw_robot(axes, of_weights.loc[robot], colour, line, robot, shift)
        axes.set_title(weights, loc="center")
        labels = [_label(world) for world in _places()]
        axes.set_xticks(range(len(labels)), labels, fontsize=style.SMALL_PT, rotation=60)
        log_axis(axes.yaxis)
        axes.set_ylim(_LEAST_M, _MOST_M)
        axes.set_xlabel("d (the left track slips more), and other worlds")
    panels[0].set_ylabel("mean true error of a drive [m]")
    legend_outside(figure, panels[0], "lower center", 3)
    fields = errors["n"].min()
    words = f"W by prediction, turns to alternate sides, {fields} fields or more of each world"
    figure.suptitle(words, fontsize=8)
    return figure


def _places():
    """The worlds along the axis: by d, then the others."""
    worlds = [*unknowns.WORLDS, unknowns.POSTERIOR]
    worlds.remove(unknowns.SOFT)  # an oracle is lost in it, too
    return worlds


def _label(world):
    """A world, at the axis."""
    return with_minus(world.removeprefix("d = ")).replace(", ", ",\n")


def _draw_robot(axes, errors, colour, line, label, shift):
    """Draw the means of a robot with their intervals: a line over d, points for other worlds."""
    errors = errors.loc[_places()]
    n = len(unknowns.DIFFERENCES)
    look = dict(color=colour, markersize=2.5, marker="o", capsize=1, elinewidth=0.6)
    for part, style_of_line in ((slice(0, n), line), (slice(n, None), "none")):
        rows = errors.iloc[part]
        place = np.arange(len(errors))[part] + shift
        ends = [rows["mean"] - rows["low"], rows["high"] - rows["mean"]]
        text = label if style_of_line != "none" else None
        axes.errorbar(place, rows["mean"], yerr=ends, linestyle=style_of_line, label=text, **look)


@style.styled
def map_of_worth(table):
    """Draw the errors with estimated traction over those of each rival, a cell for each soil.

    Blue cells say that estimating pays, orange ones that it costs; a number is bold where the 95 %
    interval excludes 1. A cross is a soil on which the robot is lost, even with estimated traction.
    Hatched cells are constants above 1, which no rival is told.

    Args:
        table: Of `notebooks.further.traction_map.worth_map`.
    """
    variations = list(table["variation"].unique())
    size = dict(figsize=(style.DOUBLE_IN, 2.3))
    shared = dict(sharex=True, sharey=True, squeeze=False)
    figure, (panels,) = plt.subplots(1, len(variations), **size, **shared)
    for variation, axes in zip(variations, panels):
        image = _draw_cells(axes, table[table["variation"] == variation])
        axes.set_title(f"varies by {variation:g} of its slip", loc="center")
    panels[0].set_ylabel("mean κ of the soil [-]")
    figure.supxlabel("error of the constant κ that the rival is told [-]", fontsize=8)
    label = "error with estimated traction\nover the rival's [-]"
    figure.colorbar(image, ax=panels, label=label, fraction=0.03, pad=0.01, extend="both")
    words = [f"{table['n'].max()} fields a cell", "bold: the 95 % interval excludes 1"]
    words += ["hatched: κ would be above 1"]
    if (table["error_m"] > paper.TOLERANCE_M).any():
        words += ["×: the robot is lost"]
    figure.suptitle("; ".join(words), fontsize=8)
    return figure


def _draw_cells(axes, of_panel):
    """One panel: ratios as colours and numbers, mean κ from above to below."""
    told = [*map(str, traction_map.ERRORS), traction_map.NO_SLIP]
    kappas = [*of_panel["kappa"].unique()]
    cells = of_panel.set_index(["kappa", "told"])
    ratios = of_panel.pivot(index="kappa", columns="told", values="mean")
    ratios = ratios.reindex(kappas, columns=told)
    is_certain = (cells["high"] < 1) | (cells["low"] > 1)
    look = dict(cmap=_WORTH, vmin=1 - _SPAN, vmax=1 + _SPAN, aspect="auto")
    is_lost = of_panel.groupby("kappa")["error_m"].first().loc[kappas] > paper.TOLERANCE_M
    axes.patch.set(hatch="////", edgecolor="0.8", linewidth=0)  # shows where no cell is
    image = axes.imshow(ratios.where(~is_lost, axis=0), **look)
    for (kappa, name), cell in cells.iterrows():
        text = "×" if is_lost[kappa] else f"{cell['mean']:.2f}"
        place = told.index(name), kappas.index(kappa)
        weight = "bold" if is_certain[kappa, name] else "normal"
        axes.text(*place, text, ha="center", va="center", fontsize=8, weight=weight)
    axes.set_xticks(range(len(told)), [_tick(name) for name in told])
    axes.set_yticks(range(len(kappas)), [f"{each:g}" for each in kappas])
    axes.grid(visible=False)
    axes.tick_params(length=0)
    return image


def _tick(told):
    """What a rival is told, at the axis."""
    if told == traction_map.NO_SLIP:
        return "no slip"
    error = float(told)
    return with_minus(f"{error:+g}") if error else "0"
