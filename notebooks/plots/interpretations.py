"""Effects of the interpretations: the printed and the prediction W, and changes of the results.

`sweep` and `runs` are the results of `notebooks.studies.interpretations.swept`; `printed` and
`prediction` are two values of the swept standard deviation.
"""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.plots.parts import BOUND, note, panels_beside, shade, ticks_at_the_ends
from notebooks.studies import statistics
from notebooks.studies.interpretations import QUANTITIES
from notebooks.studies.tables import with_minus
from rhec.style import BLACK, BLUE, DOUBLE_IN, GREY, ORANGE, SKY, SMALL_PT, VERMILLION, styled

_CHATTER_S = (40, 100)  # times before and in the first turn
_COLOURS = (SKY, ORANGE, VERMILLION)
_SIGMA_UNIFORM = 1 / np.sqrt(12)  # standard deviation of a uniform distribution on [0, 1]
# Above the axes and their title, so that no legend lies on a curve.
_LEGEND_ABOVE = dict(loc="lower left", bbox_to_anchor=(-0.1, 1.12), borderaxespad=0)
_LEGEND_ABOVE |= dict(fontsize=SMALL_PT, handlelength=1.2)


def _mark(axes, **values):
    """Draw vertical lines at the printed and the prediction value."""
    for (name, value), style in zip(values.items(), ((0, (1, 1)), (0, (4, 2)))):
        axes.axvline(value, color=GREY, linewidth=0.8, linestyle=style, label=name, zorder=1)


def _swept(axes, label, **values):
    """Label the axis of the swept standard deviation, with printed and prediction value."""
    _mark(axes, **values)
    axes.set_xlabel(label)
    axes.minorticks_off()
    axes.legend(**_LEGEND_ABOVE)


def _means(axes, sweep, column, label, colour, marker):
    """Draw means over seeds with 95 % intervals over the swept standard deviation."""
    means = {sigma: statistics.mean(rows[column]) for sigma, rows in sweep.groupby("sigma")}
    value, low, high = np.array([mean[:3] for mean in means.values()]).T
    look = dict(fmt=marker, markersize=3, color=colour, capsize=1.5, elinewidth=0.8, label=label)
    axes.errorbar(list(means), value, [value - low, high - value], **look)


@styled
def ekf_yaw(analysis, sweep, runs, printed, prediction):
    """Draw gains, uncertainty and error of the EKF's yaw over the process noise σ_x.

    Args:
        analysis: Table of `notebooks.studies.interpretations.ekf_on_a_straight`.
    """
    figure, (gains, yaw, time) = plt.subplots(1, 3, figsize=(DOUBLE_IN, 2.9))
    sigma_x_m = analysis["sigma_x_m"]
    for axes, column, colour, label in [
        (gains, "gain_position", BLACK, "position [-]"),
        (gains, "gain_yaw_radpm", VERMILLION, "yaw [rad/m]"),
        (yaw, "sigma_yaw_rad", VERMILLION, "by the filter, steady"),
    ]:
        axes.loglog(sigma_x_m, analysis[column], color=colour, label=label)
    _means(yaw, sweep, "rms_yaw_rad", "RMS error, simulated", BLACK, "o")
    for axes in (gains, yaw):
        _swept(axes, r"$\sigma_x$ of $W_k$ [m a step]", printed=printed, prediction=prediction)
    for (value, run), colour in zip(sorted(runs.items()), _COLOURS):
        c = run.columns
        look = dict(color=colour, linewidth=0.7, label=f"{value:g} m")
        time.plot(c["t_s"], c["theta_hat_rad"] - c["theta_rad"], **look)
    time.legend(title=r"$\sigma_x$", title_fontsize=SMALL_PT, **_LEGEND_ABOVE)
    gains.set(ylabel="steady gain of GNSS", title="gains on a straight")
    yaw.set(ylabel="yaw error [rad]", title=f"{sweep['seed'].nunique()} seeds")
    time.set(xlabel="time [s]", ylabel=r"$\hat\theta-\theta$ [rad]", title="seed 0")
    return figure


@styled
def rhe_kappa(analysis, sweep, runs, printed, prediction):
    """Draw the uncertainty and error of the RHE's κ over the process noise σ_κ, and κ over time.

    Args:
        analysis: DataFrame with sigma_kappa, straight, curve: standard deviations by the RHE.
    """
    figure, (stated, simulated, time) = plt.subplots(1, 3, figsize=(DOUBLE_IN, 2.9))
    for part, colour in (("straight", VERMILLION), ("curve", BLUE)):
        stated.loglog(analysis["sigma_kappa"], analysis[part], color=colour, label=part)
    _means(simulated, sweep, "rms_kappa_straights", "straights", VERMILLION, "s")
    _means(simulated, sweep, "rms_kappa_curves", "curves", BLUE, "o")
    simulated.set(xscale="log", ylim=0)
    for axes in (stated, simulated):
        axes.axhline(_SIGMA_UNIFORM, label="anything in [0, 1]", **BOUND)
        _swept(axes, r"$\sigma_\kappa$ of $W$ [-, a step]", printed=printed, prediction=prediction)
    for (value, run), colour in zip(sorted(runs.items(), reverse=True), _COLOURS):
        c = run.columns
        look = dict(color=colour, linewidth=0.8, label=f"{value:g}")
        time.plot(c["t_s"], c["kappa_hat"], **look)
    time.plot(c["t_s"], c["kappa"], color=BLACK, linewidth=0.8, label="truth")
    shade(time, c["t_s"], ~c["on_straight"])
    time.set_xlim(*_CHATTER_S)
    time.legend(title=r"$\sigma_\kappa$ [-]", title_fontsize=SMALL_PT, ncols=2, **_LEGEND_ABOVE)
    stated.set(ylabel=r"standard deviation of $\hat\kappa$ [-]", title="by the RHE's covariance")
    title = f"simulated, {sweep['seed'].nunique()} seeds"
    simulated.set(ylabel=r"RMS error of $\hat\kappa$ [-]", title=title)
    time.set(
        xlabel="time [s]  (shaded: curves)",
        ylabel=r"$\hat\kappa$ [-]",
        title="seed 0, the first turn",
    )
    time.set_ylim(-0.03, 1.03)
    return figure


@styled
def forest(table, baseline):
    """Draw differences of interpretations from the baseline, with 95 % intervals, by quantity.

    Intervals that exclude 0 are vermillion for an increase and blue for a decrease; an increase of
    each of the quantities is worse. Arrows at the edge mark values outside the axis.

    Args:
        table: Table of `notebooks.studies.interpretations.one_at_a_time`.
        baseline: Process noise of the baseline, "printed" or "prediction".
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
                at = dict(xy=(side * most, place), offset=(-5 * side, 0))
                note(
                    axes, with_minus(f"{row.change:+.2g}"), **at, ha="right" if side > 0 else "left"
                )
        axes.axvline(0, color=BLACK, linewidth=0.6)
        ticks_at_the_ends(axes, [-most, 0, most])
        axes.set_xlim(-1.08 * most, 1.08 * most)
        words, _, unit = quantity.removesuffix("]").partition(" [")
        unit = "" if unit in ("", "-") else f" {unit}"
        title = f"{words}\n{rows.loc['baseline', 'value']:.3g}{unit}"
        axes.set_title(with_minus(title), fontsize=SMALL_PT, loc="center")
        axes.tick_params(axis="x", labelsize=SMALL_PT)
        axes.grid(axis="y", visible=False)
    labels = [f"{row.words}  {row.interpretation}" for row in others.itertuples()]
    panels[0].set_yticks(range(len(labels)), labels)
    panels[0].set_ylim(len(labels) - 0.5, -0.5)
    description = f"{baseline} process noise; its mean is in each title"
    label = (
        f"change from the baseline ({description}), {table['n'].iloc[0]} seeds, 95 % intervals;\n"
    )
    scale = "vermillion: worse for the RHE, blue: better; arrows: off the scale, with numbers"
    figure.supxlabel(label + scale, fontsize=SMALL_PT)
    return figure


def _scale(changes):
    """1.5 times the upper quartile of the changes, rounded up to one digit."""
    size = np.quantile(np.abs(changes), 0.75) or 1.0
    digit = 10 ** np.floor(np.log10(size))
    return float(np.ceil(1.5 * size / digit) * digit)
