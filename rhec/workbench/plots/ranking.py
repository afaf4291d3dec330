"""Estimators ranked by how the robot drives with them, and the proposal's pose noise."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots import style
from rhec.workbench.plots.parts import DOTS, legend_above, log_axis, note, seed_range
from rhec.workbench.studies import ranking
from rhec.workbench.studies.statistics import over_seeds

_FAMILIES = {  # colours by the beginning of an estimator's name; all others are grey
    "dual": style.VERMILLION,
    "RHE": style.COLOURS["RHE"],
    "traction oracle": style.COLOURS["oracle"],
    "full oracle": style.BLACK,
}
_OFF_SCALE = 1.8  # times the paper's RHE; a larger mean is drawn as an arrow at the edge
_ERROR = ranking.QUANTITIES["mean_error_true_m"]
_RATIO = f"true error, ratio to {ranking.PAPERS}"


@style.styled
def ranked(sweep):
    """True error of every estimator, and its ratio to the paper's RHE at equal seeds.

    Dots are seeds. Where seeds are off the scale, their number stands at its edge; an arrow is a
    mean that is off the scale. The dashed and the dotted line are the targets of the proposal.

    Args:
        sweep: as in `rhec.workbench.studies.ranking.ranking_table`.
    """
    table = ranking.ranking_table(sweep)
    names = list(dict.fromkeys(table["contestant"]))
    estimates = table.set_index(["contestant", "quantity"])[["mean", "low", "high"]]
    size = (style.DOUBLE_IN, 0.22 * len(names) + 0.8)
    widths = (3, 2)
    figure, (errors, ratios) = plt.subplots(1, 2, figsize=size, sharey=True, width_ratios=widths)
    largest = _OFF_SCALE * estimates.loc[(ranking.PAPERS, _ERROR), "mean"]
    for place, name in enumerate(names):
        colour = _colour_of(name)
        seeds = sweep.loc[sweep["contestant"] == name, "mean_error_true_m"].to_numpy()
        _draw_seeds(errors, place, seeds, largest, colour)
        _draw_mean(errors, place, estimates.loc[(name, _ERROR)], largest, ".4f", colour)
        # The paper's RHE has no ratio to itself.
        ratio = estimates.loc[(name, _RATIO)] if (name, _RATIO) in estimates.index else (1, 1, 1)
        _draw_mean(ratios, place, ratio, _OFF_SCALE, ".2f", colour)
    for axes, most in ((errors, largest), (ratios, _OFF_SCALE)):
        axes.set_xlim(0, most)
        axes.grid(axis="y", visible=False)
    _draw_targets(errors, ratios, estimates, names)
    figure.legend(loc="outside lower center", ncols=2)
    errors.set_yticks(range(len(names)), names)
    errors.get_yticklabels()[names.index(ranking.PROPOSAL)].set_fontweight("bold")
    errors.set(ylim=(len(names) - 0.4, -0.6), xlabel="mean true error of a drive [m]")
    errors.set_title(f"{seed_range(sweep)}; mean and 95 % interval")
    ratios.set_xlabel("ratio to the paper's RHE, both axes cut")
    return figure


def _colour_of(name):
    """The colour of an estimator's family."""
    families = (colour for family, colour in _FAMILIES.items() if name.startswith(family))
    return next(families, style.GREY)


def _draw_seeds(axes, place, errors, largest, colour):
    """A dot for each seed, and the number of seeds beyond the scale."""
    spread = np.linspace(0.3, -0.3, len(errors))
    inside = errors < largest
    dots = dict(color=colour, markersize=1.5, alpha=0.3)
    axes.plot(errors[inside], (place + spread)[inside], **DOTS, **dots)
    if not inside.all():
        # A white box keeps the number readable on top of the dots.
        box = dict(boxstyle="square,pad=0.1", facecolor="w", edgecolor="none", alpha=0.85)
        look = dict(ha="right", fontsize=5.5, color=colour, bbox=box, zorder=4)
        note(axes, f"{(~inside).sum()} off scale", (largest, place), (-4, 0), **look)


def _draw_mean(axes, place, estimate, most, digits, colour):
    """A mean with its 95 % interval, or an arrow at the edge, and its number to the right."""
    mean, low, high = estimate
    if mean < most:
        look = dict(fmt="D", markeredgecolor="w", markeredgewidth=0.5, markersize=4, capsize=2)
        axes.errorbar(
            mean, place, xerr=[[mean - low], [high - mean]], color=colour, zorder=3, **look
        )
    else:
        axes.plot(most, place, ">", color=colour, markersize=4, clip_on=False)
    note(axes, f"{mean:{digits}}", (1, place), (5, 0), xycoords=("axes fraction", "data"))


def _draw_targets(errors, ratios, estimates, names):
    """Vertical lines at the gain over the paper's RHE and the distance to the traction oracle."""
    target = dict(color=style.BLACK, linewidth=0.7)
    gain = f"target: {100 * ranking.LEAST_GAIN:.0f} % below the paper's RHE"
    ratios.axvline(1 - ranking.LEAST_GAIN, **target, linestyle="--", label=gain)
    oracles = [name for name in names if name.startswith("traction oracle")]
    if oracles:
        best = (1 + ranking.MOST_ABOVE) * estimates.loc[(oracles[0], _ERROR), "mean"]
        above = f"target: {100 * ranking.MOST_ABOVE:.0f} % above {oracles[0]}"
        errors.axvline(best, **target, linestyle=":", label=above)


@style.styled
def pose_noise(rows):
    """True errors and RMS error of the yaw over the process noise σ_θ of the proposal's filter.

    A ring marks the minimum of each curve and the dotted line the proposal's σ_θ. Bands are 95 %
    intervals over seeds.

    Args:
        rows: as `rhec.workbench.studies.ranking.by_pose_noise` returns them.
    """
    figure, (errors, yaw) = plt.subplots(2, figsize=(style.COLUMN_IN, 3.6), sharex=True)
    by_sigma = rows.groupby("sigma_theta_rad")
    sigmas = np.sort(rows["sigma_theta_rad"].unique())
    for axes, column, label, colour in [
        (errors, "curves_m", "curves", style.BLUE),
        (errors, "straights_m", "straights", style.ORANGE),
        (errors, "all_m", "whole drive", style.BLACK),
        (yaw, "rms_yaw_rad", "estimated yaw", style.PURPLE),
    ]:
        mean, low, high = np.array([over_seeds(np.mean, of[column])[:3] for _, of in by_sigma]).T
        axes.plot(sigmas, mean, color=colour, label=label)
        axes.fill_between(sigmas, low, high, color=colour, alpha=0.2, linewidth=0)
        ring = dict(color="w", markeredgecolor=colour, markersize=5)
        least = mean.argmin()
        axes.plot(sigmas[least], mean[least], "o", **ring)
    for axes in (errors, yaw):
        axes.axvline(ranking.SIGMA_THETA, color=style.GREY, linestyle=":")
        log_axis(axes.xaxis)
    legend_above(errors, handlelength=1.5)
    errors.set_ylabel("mean true error [m]")
    label = r"process noise $\sigma_\theta$ of the pose filter [rad per sample]"
    yaw.set(xlabel=label, ylabel="RMS error of estimated yaw [rad]")
    return figure
