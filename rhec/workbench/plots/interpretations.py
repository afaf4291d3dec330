"""The audit of interpretations: why the printed W loses the EKF's yaw and makes κ chatter, how the
calibrated W was found, and how far each interpretation moves the results.

`sweep` and `runs` are as `rhec.workbench.studies.interpretations.swept` returns them, `printed` and
`calibrated` the two values of the standard deviation that is swept.
"""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots.parts import BOUND, legend_outside, note, panels_beside, shade
from rhec.workbench.plots.style import BLACK, BLUE, DOUBLE_IN, GREY, ORANGE, SKY, VERMILLION, styled
from rhec.workbench.studies import statistics
from rhec.workbench.studies.interpretations import QUANTITIES

_CHATTER_S = (40, 100)  # what is shown of the time: before and in the first turn
_COLOURS = (SKY, ORANGE, VERMILLION)
_SIGMA_UNIFORM = 1 / np.sqrt(12)  # standard deviation of a uniform distribution on [0, 1]
_MOST_DEVIANCE = 2.0  # drawn: by then a value is out of the question
_SMALL_LEGEND = dict(ncols=3, fontsize=6, loc="upper center", columnspacing=0.8, handlelength=1.2)


def _mark(axes, **values):
    """Vertical lines at the printed and the calibrated value of what the x axis shows."""
    for (name, value), style in zip(values.items(), ((0, (1, 1)), (0, (4, 2)))):
        axes.axvline(value, color=GREY, linewidth=0.8, linestyle=style, label=name, zorder=1)


def _swept(axes, label, **values):
    """The axis of the swept standard deviation: printed and calibrated value, and a legend."""
    _mark(axes, **values)
    axes.set_xlabel(label)
    axes.minorticks_off()
    axes.legend(loc="best", fontsize=6, frameon=True, framealpha=0.85, edgecolor="none")


def _means(axes, sweep, column, label, colour, marker):
    """Means over seeds with their intervals, against the swept standard deviation."""
    found = {sigma: statistics.mean(rows[column]) for sigma, rows in sweep.groupby("sigma")}
    value, low, high = np.array([each[:3] for each in found.values()]).T
    look = dict(fmt=marker, markersize=3, color=colour, capsize=1.5, elinewidth=0.8, label=label)
    axes.errorbar(list(found), value, [value - low, high - value], **look)


@styled
def ekf_yaw(analysis, sweep, runs, printed, calibrated):
    """Why the EKF loses its yaw: gains, uncertainty and error, by the position's process noise σ_x.

    Args:
        analysis: As `rhec.workbench.studies.interpretations.ekf_on_a_straight` returns it.
        sweep: Metrics of runs, one row each, with `sigma`, the swept standard deviation.
        runs: {value of σ_x: Run}, to show over time.
        printed: Value of σ_x in the paper's W.
        calibrated: Its value in the calibrated W.
    """
    figure, (gains, yaw, time) = plt.subplots(1, 3, figsize=(DOUBLE_IN, 2.3))
    sigma_x_m = analysis["sigma_x_m"]
    for axes, column, colour, label in [
        (gains, "gain_position", BLACK, "position [-]"),
        (gains, "gain_yaw_radpm", VERMILLION, "yaw [rad/m]"),
        (yaw, "sigma_yaw_rad", VERMILLION, "filter's own, steady"),
    ]:
        axes.loglog(sigma_x_m, analysis[column], color=colour, label=label)
    _means(yaw, sweep, "rms_yaw_rad", "RMS error, simulated", BLACK, "o")
    for axes in (gains, yaw):
        _swept(axes, r"$\sigma_x$ of $W_k$ [m a step]", printed=printed, calibrated=calibrated)
    for (value, run), colour in zip(sorted(runs.items()), _COLOURS):
        c = run.columns
        look = dict(color=colour, linewidth=0.7, label=f"{value:g} m")
        time.plot(c["t_s"], c["theta_hat_rad"] - c["theta_rad"], **look)
    time.margins(y=0.25)
    time.legend(title=r"$\sigma_x$", title_fontsize=6, **_SMALL_LEGEND)
    gains.set(ylabel="steady gain of GNSS", title="gains on a straight")
    yaw.set(ylabel="yaw error [rad]", title=f"{sweep['seed'].nunique()} seeds")
    time.set(xlabel="time [s]", ylabel=r"$\hat\theta-\theta$ [rad]", title="seed 0")
    return figure


@styled
def rhe_kappa(analysis, sweep, runs, printed, calibrated):
    """Why κ chatters: how well the RHE's window determines κ on straights and in curves, and κ over
    time, by the process noise σ_κ.

    Args:
        analysis: DataFrame with sigma_kappa, straight, curve: the RHE's own standard deviations.
        sweep: Metrics of runs, one row each, with `sigma`, the swept standard deviation.
        runs: {value of σ_κ: Run}, to show over time.
        printed: Value of σ_κ in the paper's W.
        calibrated: Its value in the calibrated W.
    """
    figure, (known, found, time) = plt.subplots(1, 3, figsize=(DOUBLE_IN, 2.3))
    for part, colour in (("straight", VERMILLION), ("curve", BLUE)):
        known.loglog(analysis["sigma_kappa"], analysis[part], color=colour, label=part)
    _means(found, sweep, "rms_kappa_straights", "straights", VERMILLION, "s")
    _means(found, sweep, "rms_kappa_curves", "curves", BLUE, "o")
    found.set(xscale="log", ylim=0)
    for axes in (known, found):
        axes.axhline(_SIGMA_UNIFORM, label="anything in [0, 1]", **BOUND)
        _swept(axes, r"$\sigma_\kappa$ of $W$ [a step]", printed=printed, calibrated=calibrated)
    for (value, run), colour in zip(sorted(runs.items(), reverse=True), _COLOURS):
        c = run.columns
        look = dict(color=colour, linewidth=0.8, label=f"{value:g}")
        time.plot(c["t_s"], c["kappa_hat"], **look)
    time.plot(c["t_s"], c["kappa"], color=BLACK, linewidth=0.8, label="truth")
    shade(time, c["t_s"], ~c["on_straight"])
    time.set_xlim(*_CHATTER_S)
    time.legend(**_SMALL_LEGEND)
    known.set(ylabel=r"standard deviation of $\hat\kappa$", title="by the RHE's own window")
    title = f"simulated, {sweep['seed'].nunique()} seeds"
    found.set(ylabel=r"RMS error of $\hat\kappa$", title=title)
    time.set(
        xlabel="time [s]  (shaded: curves)",
        ylabel=r"$\hat\kappa$ [-]",
        title="seed 0, the first turn",
    )
    time.set_ylim(-0.03, 1.35)
    return figure


@styled
def likelihood(profiles):
    """How the calibrated W was found: -2 log likelihood a sample above its least, along one
    standard deviation of W at a time.

    Args:
        profiles: {title: (table of
            `rhec.workbench.studies.interpretations.likelihood_profile`, printed value, calibrated
            value)}.
    """
    figure, panels = plt.subplots(1, len(profiles), figsize=(DOUBLE_IN, 2.0))
    for axes, (title, (table, printed, calibrated)) in zip(panels, profiles.items()):
        axes.plot(table["sigma"], table["deviance"], "o-", color=BLUE, markersize=2)
        _mark(axes, printed=printed, calibrated=calibrated)
        most = min(1.05 * table["deviance"].max(), _MOST_DEVIANCE)
        axes.set(xscale="log", xlabel=title, ylim=(-0.03 * most, most))
        beyond = (table["deviance"] > most).sum()
        cut = f"cut: {beyond} of {len(table)} above" if beyond else ""
        axes.set_title(cut, fontsize=6.5)
        axes.minorticks_off()
        axes.tick_params(axis="x", labelsize=6)
    panels[0].set_ylabel("deviance a sample,\nabove least [-]")
    legend_outside(figure, panels[0], "upper right", 2)
    return figure


@styled
def forest(table, baseline):
    """Differences of each interpretation from the baseline, with 95 % intervals, by quantity.

    Coloured where the interval excludes 0: more in vermillion, less in blue. What is off the scale
    is an arrow at its edge, with its number.

    Args:
        table: as `rhec.workbench.studies.interpretations.one_at_a_time` returns it.
        baseline: process noise of the baseline, "printed" or "calibrated".
    """
    others = table[table["interpretation"] != "baseline"].drop_duplicates("interpretation")
    names = others["interpretation"]
    figure, panels = panels_beside(len(QUANTITIES), 0.9 + 0.17 * len(others))
    for axes, quantity in zip(panels, QUANTITIES.values()):
        rows = table[table["quantity"] == quantity].set_index("interpretation")
        most = _scale(rows.loc[names, "change"])
        for place, name in enumerate(names):
            row = rows.loc[name]
            colour = GREY
            if row.change_low > 0:
                colour = VERMILLION
            elif row.change_high < 0:
                colour = BLUE
            if abs(row.change) <= most:
                ends = np.clip([row.change_low, row.change_high], -most, most)
                axes.plot(ends, [place] * 2, color=colour, linewidth=1.2)
                axes.plot(row.change, place, "o", color=colour, markersize=3)
            else:
                side = np.sign(row.change)
                axes.plot(side * most, place, ">" if side > 0 else "<", color=colour, markersize=4)
                at = dict(xy=(side * most, place), offset=(-5 * side, 0), fontsize=5.5)
                note(axes, f"{row.change:+.2g}", **at, ha="right" if side > 0 else "left")
        axes.axvline(0, color=BLACK, linewidth=0.6)
        axes.set_xlim(-1.08 * most, 1.08 * most)
        axes.set_xticks([-most, 0, most], [f"−{most:g}", "0", f"{most:g}"])
        words, _, unit = quantity.removesuffix("]").partition(" [")
        unit = "" if unit in ("", "-") else f" {unit}"
        title = f"{words}\n{rows.loc['baseline', 'value']:.3g}{unit}"
        axes.set_title(title, fontsize=7, loc="center")
        axes.tick_params(axis="x", labelsize=5.5)
        axes.grid(axis="y", visible=False)
    labels = [f"{row.words}  {row.interpretation}" for row in others.itertuples()]
    panels[0].set_yticks(range(len(labels)), labels)
    panels[0].set_ylim(len(labels) - 0.5, -0.5)
    about = f"{baseline} process noise; its mean is in each title"
    label = f"change from the baseline ({about}), {table['n'].iloc[0]} seeds, 95 % intervals;\n"
    figure.supxlabel(label + "linear axes; arrows: off the scale, with their numbers", fontsize=7)
    return figure


def _scale(changes):
    """The end of an axis on which three of four changes can be told apart: one digit."""
    size = np.quantile(np.abs(changes), 0.75) or 1.0
    digit = 10 ** np.floor(np.log10(size))
    return float(np.ceil(1.5 * size / digit) * digit)
