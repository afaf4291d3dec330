"""The readings audit: why the printed W loses the EKF's yaw and makes κ chatter, how the calibrated
W was found, what every reading moves.
"""

import matplotlib.pyplot as plt
import numpy as np

from rhec.plots.style import BLACK, BLUE, DOUBLE_IN, GREY, ORANGE, SKY, VERMILLION, styled
from rhec.studies import statistics
from rhec.studies.interpretations import QUANTITIES

COLOURS = (SKY, ORANGE, VERMILLION)
NOTHING_KNOWN = 1 / np.sqrt(12)  # standard deviation of a uniform distribution on [0, 1]


def _mark(axes, **values):
    """Vertical lines at the printed and the calibrated value of what the x axis shows."""
    for (name, value), style in zip(values.items(), ((0, (1, 1)), (0, (4, 2)))):
        axes.axvline(value, color=GREY, linewidth=0.8, linestyle=style, label=name, zorder=1)


def _swept(axes, label, **values):
    """The axis of the swept standard deviation, with both readings' values and a legend."""
    _mark(axes, **values)
    axes.set_xlabel(label)
    axes.minorticks_off()
    axes.legend(loc="best", fontsize=6, frameon=True, framealpha=0.85, edgecolor="none")


def _means(axes, sweep, column, label, colour, marker):
    """Means over seeds with their intervals, against the swept standard deviation."""
    found = sweep.groupby("sigma")[column].apply(lambda values: statistics.mean(values))
    value, low, high = (
        np.array([getattr(each, name) for each in found]) for name in ("value", "low", "high")
    )
    axes.errorbar(
        found.index,
        value,
        [value - low, high - value],
        fmt=marker,
        markersize=3,
        color=colour,
        capsize=1.5,
        elinewidth=0.8,
        label=label,
    )


@styled
def ekf_yaw(analysis, sweep, runs, printed, calibrated):
    """Why the EKF loses its yaw: steady gains, the yaw's uncertainty, and the yaw error over time,
    by the position's process noise σ_x.

    analysis: `rhec.studies.interpretations.ekf_on_a_straight`; sweep, runs:
    `rhec.studies.interpretations.swept`; printed, calibrated: the two readings' σ_x [m].
    """
    figure, (gains, yaw, time) = plt.subplots(1, 3, figsize=(DOUBLE_IN, 2.3))
    gains.loglog(
        analysis["sigma_x_m"], analysis["gain_position"], color=BLACK, label="position [-]"
    )
    gains.loglog(
        analysis["sigma_x_m"], analysis["gain_yaw_radpm"], color=VERMILLION, label="yaw [rad/m]"
    )
    yaw.loglog(
        analysis["sigma_x_m"],
        analysis["sigma_yaw_rad"],
        color=VERMILLION,
        label="filter's own, steady",
    )
    _means(yaw, sweep, "rms_yaw_rad", "RMS error, simulated", BLACK, "o")
    for axes in (gains, yaw):
        _swept(axes, r"$\sigma_x$ of $W_k$ [m a step]", printed=printed, calibrated=calibrated)
    for (value, run), colour in zip(sorted(runs.items()), COLOURS):
        c = run.columns
        time.plot(
            c["t_s"],
            c["theta_hat_rad"] - c["theta_rad"],
            color=colour,
            linewidth=0.7,
            label=f"{value:g} m",
        )
    time.margins(y=0.25)
    time.legend(
        title=r"$\sigma_x$",
        ncols=3,
        fontsize=6,
        title_fontsize=6,
        loc="upper center",
        columnspacing=0.8,
        handlelength=1.2,
    )
    gains.set_ylabel("steady gain of GNSS")
    yaw.set_ylabel("yaw error [rad]")
    time.set(xlabel="time [s]", ylabel=r"$\hat\theta-\theta$ [rad]")
    gains.set_title("gains on a straight", loc="left")
    yaw.set_title(f"{sweep['seed'].nunique()} seeds", loc="left")
    time.set_title("seed 0", loc="left")
    return figure


@styled
def rhe_kappa(analysis, sweep, runs, printed, calibrated):
    """Why κ chatters: what the RHE's window knows of κ on straights and in curves, and κ over time,
    by the process noise σ_κ.

    analysis: DataFrame with sigma_kappa, straight, curve: the RHE's own standard deviations; sweep,
    runs, printed, calibrated: as in `ekf_yaw`.
    """
    figure, (known, found, time) = plt.subplots(1, 3, figsize=(DOUBLE_IN, 2.3))
    known.loglog(analysis["sigma_kappa"], analysis["straight"], color=VERMILLION, label="straight")
    known.loglog(analysis["sigma_kappa"], analysis["curve"], color=BLUE, label="curve")
    _means(found, sweep, "rms_kappa_straights", "straights", VERMILLION, "s")
    _means(found, sweep, "rms_kappa_curves", "curves", BLUE, "o")
    found.set(xscale="log")
    found.set_ylim(0)
    for axes in (known, found):
        axes.axhline(
            NOTHING_KNOWN, color=BLACK, linewidth=0.6, linestyle="--", label="anything in [0, 1]"
        )
        _swept(axes, r"$\sigma_\kappa$ of $W$ [a step]", printed=printed, calibrated=calibrated)
    for (value, run), colour in zip(sorted(runs.items(), reverse=True), COLOURS):
        time.plot(
            run.columns["t_s"],
            run.columns["kappa_hat"],
            color=colour,
            linewidth=0.6,
            label=f"{value:g}",
        )
    c = run.columns
    time.plot(c["t_s"], c["kappa"], color=BLACK, linewidth=0.8, label="truth")
    time.fill_between(
        c["t_s"],
        0,
        1,
        where=~c["on_straight"],
        transform=time.get_xaxis_transform(),
        color="0.93",
        linewidth=0,
        zorder=0,
    )
    time.set_ylim(-0.03, 1.35)
    time.legend(ncols=3, fontsize=6, loc="upper center", columnspacing=0.8, handlelength=1.2)
    known.set_ylabel(r"standard deviation of $\hat\kappa$")
    found.set_ylabel(r"RMS error of $\hat\kappa$")
    time.set(xlabel="time [s]  (shaded: curves)", ylabel=r"$\hat\kappa$ [-]")
    known.set_title("by the RHE's own window", loc="left")
    found.set_title(f"simulated, {sweep['seed'].nunique()} seeds", loc="left")
    time.set_title("seed 0", loc="left")
    return figure


@styled
def likelihood(profiles):
    """How the calibrated W was found: -2 log likelihood a sample above its least, along one
    standard deviation of W at a time.

    profiles: {title: (table of `rhec.studies.interpretations.likelihood_profile`, printed value,
    calibrated value)}.
    """
    figure, each = plt.subplots(1, len(profiles), figsize=(DOUBLE_IN, 2.0), sharey=True)
    for axes, (title, (table, printed, calibrated)) in zip(each, profiles.items()):
        axes.plot(table["sigma"], table["deviance"], "o-", color=BLUE, markersize=2)
        _mark(axes, printed=printed, calibrated=calibrated)
        axes.set(xscale="log", xlabel=title)
        axes.set_yscale("symlog", linthresh=1e-2)
        axes.minorticks_off()
        axes.tick_params(axis="x", labelsize=6)
    each[0].set_ylabel("deviance a sample, above least")
    figure.legend(*each[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


@styled
def forest(table, baseline):
    """What each reading moves: differences from the baseline with their 95 % intervals, one panel a
    quantity, one row a reading.

    table: `rhec.studies.interpretations.one_at_a_time`. Coloured where the interval excludes 0:
    more in vermillion, less in blue.
    """
    readings = table.loc[
        table["interpretation"] != "baseline", ["interpretation", "words"]
    ].drop_duplicates()
    figure, panels = plt.subplots(
        1, len(QUANTITIES), figsize=(DOUBLE_IN, 0.8 + 0.17 * len(readings)), sharey=True
    )
    for axes, quantity in zip(panels, QUANTITIES.values()):
        of = table[table["quantity"] == quantity].set_index("interpretation")
        for place, name in enumerate(readings["interpretation"]):
            row = of.loc[name]
            colour = VERMILLION if row.change_low > 0 else BLUE if row.change_high < 0 else GREY
            axes.plot([row.change_low, row.change_high], [place] * 2, color=colour, linewidth=1.2)
            axes.plot(
                row.change,
                place,
                {VERMILLION: ">", BLUE: "<", GREY: "o"}[colour],
                color=colour,
                markersize=3,
            )
        axes.axvline(0, color=BLACK, linewidth=0.6)
        scale = _typical(of.loc[readings["interpretation"], "change"])
        axes.set_xscale("symlog", linthresh=scale)
        axes.set_xticks([-10 * scale, 0, 10 * scale], [f"−{10 * scale:g}", "0", f"{10 * scale:g}"])
        axes.set_title(
            f"{quantity.rsplit(' [', 1)[0]}\n{of.loc['baseline', 'value']:.3g}"
            + (
                f" {quantity.rsplit(' [', 1)[1].rstrip(']')}"
                if "[" in quantity and "[-]" not in quantity
                else ""
            ),
            fontsize=7,
        )
        axes.tick_params(axis="x", labelsize=5.5)
        axes.minorticks_off()
        axes.grid(axis="y", visible=False)
    panels[0].set_yticks(
        range(len(readings)),
        [f"{row.words}  {row.interpretation}" for row in readings.itertuples()],
    )
    panels[0].set_ylim(len(readings) - 0.5, -0.5)
    n = table["n"].iloc[0]
    figure.supxlabel(
        f"change from the baseline ({baseline} reading; its mean is in each title), {n} seeds, 95 % intervals; scales are linear\n"
        "near 0 and logarithmic beyond",
        fontsize=7,
    )
    return figure


def _typical(changes):
    """A scale at which most of the changes can be told apart."""
    sizes = np.abs(changes[np.abs(changes) > 0])
    return float(10 ** np.round(np.log10(np.median(sizes)))) if len(sizes) else 1.0
