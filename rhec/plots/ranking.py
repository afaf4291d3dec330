"""Beyond the paper: estimators ranked by how the robot drives with them, the proposal's pose noise,
and which estimators know how sure they may be.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator

from rhec.plots.style import (
    BLACK,
    BLUE,
    COLOURS,
    COLUMN_IN,
    DOUBLE_IN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILLION,
    styled,
)
from rhec.studies import consistency, ranking
from rhec.studies.statistics import over_seeds

FAMILIES = {
    "dual": VERMILLION,
    "RHE": COLOURS["RHE"],
    "traction oracle": COLOURS["oracle"],
    "full oracle": BLACK,
}  # the rest is grey
STATES = {"x": "$x$", "y": "$y$", "θ": r"$\theta$", "ν": r"$\nu$", "μ": r"$\mu$", "κ": r"$\kappa$"}
OFF_SCALE = 1.8  # times the paper's RHE: what is worse is drawn as an arrow at the edge


# Ranking


@styled
def ranked(sweep):
    """Mean true error [m] of every contestant: each seed a dot, mean and 95 % interval; and its
    ratio to that of the paper's RHE at equal seeds.

    sweep: as in `rhec.studies.ranking.ranking_table`. Dashed: 30 % less than the paper's RHE. An arrow at the edge: off
    the scale.
    """
    table = ranking.ranking_table(sweep)
    names = list(dict.fromkeys(table["contestant"]))
    estimates = table.set_index(["contestant", "quantity"])[["mean", "low", "high"]]
    figure, (errors, ratios) = plt.subplots(
        1, 2, figsize=(DOUBLE_IN, 0.22 * len(names) + 0.8), sharey=True, width_ratios=(3, 2)
    )
    shown = [
        (
            errors,
            ranking.QUANTITIES["mean_error_true_m"],
            OFF_SCALE
            * estimates.loc[(ranking.PAPERS, ranking.QUANTITIES["mean_error_true_m"]), "mean"],
            ".4f",
        ),
        (ratios, f"true error, ratio to {ranking.PAPERS}", OFF_SCALE, ".2f"),
    ]
    for place, name in enumerate(names):
        colour = next(
            (colour for family, colour in FAMILIES.items() if name.startswith(family)), GREY
        )
        seeds = sweep.loc[sweep["contestant"] == name, "mean_error_true_m"]
        errors.plot(
            seeds,
            place + np.linspace(0.3, -0.3, len(seeds)),
            "o",
            color=colour,
            markersize=1.5,
            alpha=0.3,
            markeredgewidth=0,
        )
        for axes, quantity, most, digits in shown:
            mean, low, high = (
                estimates.loc[(name, quantity)]
                if (name, quantity) in estimates.index
                else (1.0, 1.0, 1.0)
            )
            if mean < most:
                axes.errorbar(
                    mean,
                    place,
                    xerr=[[mean - low], [high - mean]],
                    fmt="D",
                    color=colour,
                    markeredgecolor="w",
                    markeredgewidth=0.5,
                    markersize=4,
                    capsize=2,
                    zorder=3,
                )
            else:
                axes.plot(most, place, ">", color=colour, markersize=4, clip_on=False)
            axes.annotate(
                f"{mean:{digits}}",
                (1, place),
                (5, 0),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                va="center",
                fontsize=7,
            )
    for axes, _, most, _ in shown:
        axes.set_xlim(0, most)
        axes.grid(axis="y", visible=False)
    ratios.axvline(1 - ranking.LEAST_GAIN, color=BLACK, linestyle="--", linewidth=0.7)
    errors.set_yticks(range(len(names)), names)
    errors.get_yticklabels()[names.index(ranking.PROPOSAL)].set_fontweight("bold")
    errors.set_ylim(len(names) - 0.4, -0.6)
    errors.set_xlabel("mean true error of a drive [m]")
    ratios.set_xlabel("ratio to the paper's RHE")
    seeds = sorted(sweep["seed"].unique())
    errors.set_title(
        f"{len(seeds)} seeds, {seeds[0]} to {seeds[-1]}; mean and 95 % interval", loc="left"
    )
    return figure


def _plain(axis):
    """Plain numbers along a logarithmic axis."""
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.axes.minorticks_off()


@styled
def pose_noise(rows):
    """What the process noise σ_θ of the proposal's pose filter does: true errors [m] on straights
    and in curves, and the RMS error of the yaw [rad].

    rows: of `ranking.by_pose_noise`. A ring marks the least of each curve, the dotted line the
    proposal's σ_θ; bands are 95 % intervals over seeds.
    """
    figure, (errors, yaw) = plt.subplots(2, figsize=(COLUMN_IN, 3.6), sharex=True)
    curves = [
        (errors, "curves_m", "curves", BLUE),
        (errors, "straights_m", "straights", ORANGE),
        (errors, "all_m", "whole drive", BLACK),
        (yaw, "rms_yaw_rad", "estimated yaw", PURPLE),
    ]
    for axes, column, label, colour in curves:
        estimates = np.array(
            [over_seeds(np.mean, each[column])[:3] for _, each in rows.groupby("sigma_theta_rad")]
        )
        sigmas = np.sort(rows["sigma_theta_rad"].unique())
        axes.plot(sigmas, estimates[:, 0], color=colour, label=label)
        axes.fill_between(sigmas, *estimates[:, 1:].T, color=colour, alpha=0.2, linewidth=0)
        least = estimates[:, 0].argmin()
        axes.plot(
            sigmas[least], estimates[least, 0], "o", color="w", markeredgecolor=colour, markersize=5
        )
    for axes in (errors, yaw):
        axes.axvline(ranking.SIGMA_THETA, color=GREY, linestyle=":")
        axes.set_xscale("log")
        _plain(axes.xaxis)
    errors.legend(
        loc="lower right", bbox_to_anchor=(1, 1), ncols=3, borderaxespad=0.1, handlelength=1.5
    )
    errors.set_ylabel("mean true error [m]")
    yaw.set_ylabel("RMS error of estimated yaw [rad]")
    yaw.set_xlabel(r"process noise $\sigma_\theta$ of the pose filter [rad per sample]")
    return figure


# Consistency


@styled
def nees_over_time(measured):
    """Mean NEES over runs, by its degrees of freedom, at each time [s] for each {name:
    Consistency}, on a logarithmic scale; shaded: 95 % χ² bounds.
    """
    columns = 2
    figure, panels = plt.subplots(
        -(-len(measured) // columns),
        columns,
        figsize=(DOUBLE_IN, 0.3 + 0.95 * -(-len(measured) // columns)),
        sharex=True,
        sharey=True,
    )
    for axes, (name, each) in zip(panels.flat, measured.items()):
        degrees, runs = len(each.states), len(each.nees)
        axes.axhspan(
            *consistency.bounds(runs, degrees), color=COLOURS["tolerance"], alpha=0.5, linewidth=0
        )
        colour = COLOURS[next(role for role in ("EKF", "RHE", "oracle") if role in name)]
        axes.semilogy(each.t_s, each.nees.mean(axis=0) / degrees, color=colour, linewidth=0.6)
        (_, values, _), *_ = consistency.normalised(each)
        axes.set_title(
            f"{name}: {100 * consistency.share_inside(values, degrees):.0f} % inside", loc="left"
        )
        axes.set_xlim(0, each.t_s[-1])
        _plain(axes.yaxis)
    for axes in panels.flat[len(measured) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    figure.supylabel(f"mean NEES of {runs} runs / degrees of freedom", fontsize=8)
    return figure


@styled
def errors_over_sigma(measured):
    """RMS error over its own standard deviation for each state and each {name: Consistency}: 1
    (line) is consistent, above is overconfident.
    """
    figure, axes = plt.subplots(figsize=(COLUMN_IN, 0.32 * len(measured) + 0.7))
    ratios = np.full((len(measured), len(STATES)), np.nan)
    for row, each in zip(ratios, measured.values()):
        row[: len(each.states)] = np.sqrt(consistency.mean_square_errors(each).mean(axis=0))
    axes.imshow(np.log2(ratios), cmap="PuOr_r", vmin=-2.5, vmax=2.5, aspect="auto")
    for (row, column), ratio in np.ndenumerate(ratios):
        axes.annotate(
            "–" if np.isnan(ratio) else f"{ratio:.2f}",
            (column, row),
            ha="center",
            va="center",
            fontsize=7,
            color="w" if abs(np.log2(ratio)) > 1.7 else BLACK,
        )
    axes.set_xticks(range(len(STATES)), STATES.values())
    axes.set_yticks(range(len(measured)), measured)
    axes.grid(visible=False)
    axes.set_title("RMS error / standard deviation", loc="left")
    return figure
