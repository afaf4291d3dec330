"""Estimators ranked by how the robot drives with them, and the proposal's pose noise."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots import style
from rhec.workbench.plots.parts import DOTS, legend_above, log_axis, note, seed_range
from rhec.workbench.studies import ranking
from rhec.workbench.studies.statistics import over_seeds

__all__ = ["pose_noise", "ranked"]

_FAMILIES = {  # by the beginning of the contestant's name; the rest is grey
    "dual": style.VERMILLION,
    "RHE": style.COLOURS["RHE"],
    "traction oracle": style.COLOURS["oracle"],
    "full oracle": style.BLACK,
}
_OFF_SCALE = 1.8  # times the paper's RHE: what is worse is drawn as an arrow at the edge


@style.styled
def ranked(sweep):
    """True error of every contestant, and its ratio to the paper's RHE at equal seeds.

    Dots: seeds; where some are off the scale, so many are counted at its edge, and an arrow is a
    mean that is. Dashed: the gain asked of the proposal. Dotted: what it may have at most, by the
    best that knows the traction.

    Args:
        sweep: as in `rhec.workbench.studies.ranking.ranking_table`.
    """
    table = ranking.ranking_table(sweep)
    names = list(dict.fromkeys(table["contestant"]))
    estimates = table.set_index(["contestant", "quantity"])[["mean", "low", "high"]]
    size = (style.DOUBLE_IN, 0.22 * len(names) + 0.8)
    widths = (3, 2)
    figure, (errors, ratios) = plt.subplots(1, 2, figsize=size, sharey=True, width_ratios=widths)
    error, ratio = ranking.QUANTITIES["mean_error_true_m"], f"true error, ratio to {ranking.PAPERS}"
    largest = _OFF_SCALE * estimates.loc[(ranking.PAPERS, error), "mean"]
    shown = [(errors, error, largest, ".4f"), (ratios, ratio, _OFF_SCALE, ".2f")]
    mark = dict(fmt="D", markeredgecolor="w", markeredgewidth=0.5, markersize=4, capsize=2)
    for place, name in enumerate(names):
        families = (colour for family, colour in _FAMILIES.items() if name.startswith(family))
        colour = next(families, style.GREY)
        look = mark | dict(color=colour, zorder=3)
        seeds = sweep.loc[sweep["contestant"] == name, "mean_error_true_m"]
        spread = np.linspace(0.3, -0.3, len(seeds))
        inside = seeds.to_numpy() < largest
        dots = dict(color=colour, markersize=1.5, alpha=0.3)
        errors.plot(seeds[inside], (place + spread)[inside], **DOTS, **dots)
        if not inside.all():
            beyond = dict(ha="right", fontsize=5.5, color=colour)
            note(errors, f"{(~inside).sum()} beyond ", (largest, place), (-4, 4), **beyond)
        for axes, quantity, most, digits in shown:
            known = (name, quantity) in estimates.index  # the paper's RHE has no ratio to itself
            mean, low, high = estimates.loc[(name, quantity)] if known else (1.0, 1.0, 1.0)
            if mean < most:
                axes.errorbar(mean, place, xerr=[[mean - low], [high - mean]], **look)
            else:
                axes.plot(most, place, ">", color=colour, markersize=4, clip_on=False)
            note(axes, f"{mean:{digits}}", (1, place), (5, 0), xycoords=("axes fraction", "data"))
    for axes, _, most, _ in shown:
        axes.set_xlim(0, most)
        axes.grid(axis="y", visible=False)
    target = dict(color=style.BLACK, linewidth=0.7)
    ratios.axvline(1 - ranking.LEAST_GAIN, **target, linestyle="--", label="gain asked for")
    oracles = [name for name in names if name.startswith("traction oracle")]
    if oracles:
        best = (1 + ranking.MOST_ABOVE) * estimates.loc[(oracles[0], error), "mean"]
        above = f"{100 * ranking.MOST_ABOVE:.0f} % above {oracles[0]}"
        errors.axvline(best, **target, linestyle=":", label=above)
    figure.legend(loc="outside lower center", ncols=2)
    errors.set_yticks(range(len(names)), names)
    errors.get_yticklabels()[names.index(ranking.PROPOSAL)].set_fontweight("bold")
    errors.set(ylim=(len(names) - 0.4, -0.6), xlabel="mean true error of a drive [m]")
    errors.set_title(f"{seed_range(sweep)}; mean and 95 % interval")
    ratios.set_xlabel("ratio to the paper's RHE, both axes cut")
    return figure


@style.styled
def pose_noise(rows):
    """True errors and RMS error of the yaw over the process noise σ_θ of the proposal's filter.

    A ring marks the least of each curve, the dotted line the proposal's σ_θ; bands are 95 %
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
