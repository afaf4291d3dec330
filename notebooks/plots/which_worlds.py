"""The inverse problem: which worlds give the paper's numbers, and whether the method can tell."""

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

from notebooks.plots.parts import log_axis, note, ticks_at_the_ends
from notebooks.studies import which_worlds
from notebooks.studies.names import RULES, TURNS
from rhec import paper
from rhec.style import (
    BLACK,
    BLUE,
    COLOURS,
    DOUBLE_IN,
    GREEN,
    GREY,
    ORANGE,
    SMALL_PT,
    VERMILLION,
    styled,
)

_LABELS = {
    "speed_mps": "speed [m/s]",
    "mu_slip": r"mean slip ahead, $1 - \mu$",
    "mu_variation": r"deviation of $\mu$ / slip",
    "kappa_slip": r"mean slip in turning, $1 - \kappa$",
    "kappa_variation": r"deviation of $\kappa$ / slip",
    "correlation_length_m": "correlation length [m]",
    "slip_difference": "turns to the first turn's side",
    "rotation_centre_m": "centre of rotation ahead [m]",
    "bump_diffusion_radpsqrtm": r"yaw from bumps [rad/$\sqrt{\mathrm{m}}$]",
    "rut_length_m": "length of ruts [m]",
    "gnss_sigma_m": r"GNSS $\sigma$ [m]",
    "gnss_slow_share": "GNSS: slow share",
    "gnss_slow_time_s": "GNSS: slow time [s]",
    "encoder_sigma_mps": r"encoders $\sigma$ [m/s]",
    "speed_sigma_mps": r"common speed $\sigma$ [m/s]",
    "row_length_m": "length of a row [m]",
    "rows": "rows driven",
    "turn_demand": "turn demand of the headland",
    "start_offset_m": "offset at the start [m]",
    "sigma_rhe_m": r"RHE: $\sigma_{xy}$ of $W$ [m]",
    "sigma_rhe_ratio_radpm": r"RHE: $\sigma_\theta / \sigma_{xy}$ [rad/m]",
    "sigma_rhe_traction": r"RHE: $\sigma_{\mu\kappa}$ of $W$",
    "sigma_ekf_m": r"EKF: $\sigma_{xy}$ of $W$ [m]",
    "sigma_ekf_ratio_radpm": r"EKF: $\sigma_\theta / \sigma_{xy}$ [rad/m]",
}
_COLUMNS = 4
_BINS = 12
_MOST_RATIO = 4.0  # upper end of the axis of the EKF's error over the RHE's
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
        axes.set_xlabel(_LABELS[name], labelpad=1, fontsize=SMALL_PT)
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


@styled
def order(table):
    """Draw in which share of worlds the RHE is the better, and by how much, by rule and path.

    Args:
        table: Of `notebooks.studies.order_in_worlds.rule_rows`.

    Returns:
        A Figure: shares with 95 % intervals, and the median of EKF / RHE with its middle 90 %.
    """
    rules = [*table["rule for W"].unique()]
    looks = dict(zip(table["turns"].unique(), (BLACK, BLUE, ORANGE, VERMILLION, GREEN)))
    figure, (shares, ratios) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 3.0), sharey=True)
    for k, (turns, colour) in enumerate(looks.items()):
        rows = table[table["turns"] == turns]
        places = np.arange(len(rules)) + 0.15 * (k - 2)
        look = dict(fmt="o", color=colour, markersize=3, elinewidth=0.8)
        for axes, value, low, high in (
            (shares, "RHE better", "low", "high"),
            (ratios, "EKF / RHE", "EKF / RHE p5", "EKF / RHE p95"),
        ):
            middle = rows[value].to_numpy()
            ends = np.abs(rows[[low, high]].to_numpy().T - middle)
            label = "the world's own path" if turns == "own" else TURNS[turns]
            axes.errorbar(middle, places, xerr=ends, label=label, **look)
    for place, rule in enumerate(rules):
        least = table.loc[table["rule for W"] == rule, "EKF / RHE"].min()
        if least > _MOST_RATIO:
            note(ratios, f"beyond the axis: {least:.0f} or more", (1.05, place))
    shares.set_yticks(np.arange(len(rules)), [RULES.get(rule, rule) for rule in rules])
    shares.set(
        xlim=(0, 1.02), ylim=(len(rules) - 0.5, -0.5), xlabel="worlds with the RHE the better"
    )
    ratios.set(xscale="log", xlim=(0.7, _MOST_RATIO), xlabel="error of the EKF / error of the RHE")
    ratios.minorticks_off()
    ratios.set_xticks([0.7, 1, 1.5, 2, 3, 4], ["0.7", "1", "1.5", "2", "3", "4"])
    ratios.axvline(1, color=BLACK, linewidth=0.6, linestyle=":")
    shares.axvline(0.5, color=BLACK, linewidth=0.6, linestyle=":")
    figure.legend(*shares.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


@styled
def calibration(checks, draws):
    """Draw simulation-based calibration: distribution of the truths' ranks minus the uniform one.

    Args:
        checks: {name: (n, d) ranks, of `notebooks.studies.abc_regression.ranks`}.
        draws: How many draws each rank is among.

    Returns:
        A Figure; a line leaves the band if the posterior of its unknown is wrong, each band at
        95 % for all unknowns together.
    """
    size = (DOUBLE_IN, 2.4)
    figure, panels = plt.subplots(1, len(checks), figsize=size, sharey=True, squeeze=False)
    for axes, (name, ranks) in zip(panels.flat, checks.items()):
        n, unknowns = ranks.shape
        half = band(n, unknowns)
        levels = (np.arange(draws + 1) + 1) / (draws + 1)
        look = dict(color=COLOURS["tolerance"], alpha=0.5, linewidth=0)
        band_drawn = axes.axhspan(-half, half, **look)
        off = np.array([np.mean(ranks <= rank, axis=0) for rank in range(draws + 1)])
        off -= levels[:, None]
        outside = np.abs(off).max(axis=0) > half
        axes.plot(levels, off[:, ~outside], color=GREY, linewidth=0.5)
        for line, label in zip(off[:, outside].T, np.array(list(_LABELS))[outside]):
            axes.plot(levels, line, linewidth=1, label=_LABELS[label])
        if outside.any():
            axes.legend(fontsize=SMALL_PT)
        axes.set(title=f"{name} (n = {n})", xlabel="rank of the truth / draws", xlim=(0, 1))
    panels[0, 0].set_ylabel("share of truths − uniform")
    words = "95 % band, for all unknowns together"
    figure.legend([band_drawn], [words], loc="outside lower center")
    return figure


def band(n, unknowns):
    """Half width of the 95 % band of the largest deviation, for all unknowns together.

    The distance of Kolmogorov and Smirnov of n uniform ranks, with Bonferroni's correction.
    """
    return stats.kstwo.ppf(1 - 0.05 / unknowns, n)
