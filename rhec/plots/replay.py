"""A replayed log in pictures.

`replays` is {name: samples}, as `rhec.logs.scores.perturbed_replay` returns them; what a log does not know
(its true pose, say) is left out of the picture.
"""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import LogLocator

from rhec.logs import scores
from rhec.plots.style import (
    BLACK,
    COLOURS,
    DOUBLE_IN,
    FOLDER,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    ROOT,
    styled,
)
from rhec.studies.statistics import over_seeds

LOOKS = {
    "RHE": {"color": COLOURS["RHE"]},
    "RHE, ν as input": {"color": GREEN},
    "RHE, ν over the window": {"color": PURPLE},
    "EKF": {"color": COLOURS["EKF"]},
    "augmented EKF": {"color": ORANGE},
}
STRAIGHT_RADPS, SMOOTH = (
    0.05,
    11,
)  # slower turns count as straight, by the median of so many samples


def replay_folder(file):
    """Where the pictures of a log belong: the shipped log's with all others, any other log's in
    build/replay/, under the letters and digits of its name.
    """
    file = Path(file).resolve()
    if file.is_relative_to(ROOT / "data"):
        return FOLDER
    return (
        ROOT / "build" / "replay" / (re.sub(r"[^A-Za-z0-9]+", "_", file.stem).strip("_") or "log")
    )


def _broken(samples, *columns):
    """Columns as arrays with a gap after each segment, so that lines do not cross it."""
    parts = [
        np.append(
            part[list(columns)].to_numpy(dtype=float), np.full((1, len(columns)), np.nan), axis=0
        )
        for _, part in samples.groupby("segment")
    ]
    return np.concatenate(parts).T


def _time(axes, samples):
    """Time along the last of the axes, what is straight or standing shaded in all."""
    t = samples["t_s"]
    straight = (
        samples["omega_meas_radps"].abs().rolling(SMOOTH, center=True, min_periods=1).median()
        < STRAIGHT_RADPS
    )
    straight &= samples["segment"].diff(-1) == 0
    for each in axes:
        each.fill_between(
            t,
            0,
            1,
            where=straight,
            transform=each.get_xaxis_transform(),
            color="0.93",
            linewidth=0,
            zorder=0,
        )
        each.grid(axis="x", visible=False)
    axes[-1].set_xlabel(
        f"time [s]  (shaded: straight or standing, the tracks turn by less than {STRAIGHT_RADPS} rad/s)"
    )
    axes[-1].set_xlim(t.min(), t.max())


def _decades(axis):
    """A logarithmic axis with 1, 2 and 5 written out."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.axes.minorticks_off()


@styled
def replay_log(samples, title):
    """What was recorded: the positions in the plane [m], and speed [m/s] and yaw rate [rad/s] by
    the encoders over time [s].
    """
    figure, panels = plt.subplot_mosaic(
        [["plane", "speed"], ["plane", "yaw rate"]], figsize=(DOUBLE_IN, 2.6), width_ratios=(1, 2)
    )
    panels["plane"].plot(
        samples["x_meas_m"],
        samples["y_meas_m"],
        ".",
        color=COLOURS["measured"],
        markersize=1.5,
        label="measured",
    )
    if {"x_m", "y_m"} <= set(samples):
        panels["plane"].plot(
            *_broken(samples, "x_m", "y_m"), color=COLOURS["truth"], linewidth=0.5, label="truth"
        )
    panels["plane"].legend()
    panels["plane"].set(xlabel="$x$ [m]", ylabel="$y$ [m]", aspect="equal", adjustable="datalim")
    for name, reading, truth, label in [
        ("speed", "nu_meas_mps", "v_true_mps", "speed [m/s]"),
        ("yaw rate", "omega_meas_radps", "yaw_rate_true_radps", "yaw rate [rad/s]"),
    ]:
        panels[name].plot(
            *_broken(samples, "t_s", reading),
            color=COLOURS["measured"],
            linewidth=0.8,
            label="encoders",
        )
        if truth in samples:
            panels[name].plot(
                *_broken(samples, "t_s", truth),
                color=COLOURS["truth"],
                linewidth=0.5,
                label="truth, over ground",
            )
        panels[name].set_ylabel(label)
    _time([panels["speed"], panels["yaw rate"]], samples)
    panels["speed"].sharex(panels["yaw rate"])
    panels["speed"].tick_params(labelbottom=False)
    handles, labels = panels["speed"].get_legend_handles_labels()
    panels["speed"].legend(
        handles, labels, loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0.1
    )
    panels["plane"].set_title(title.replace("$", r"\$"), loc="left")  # a file's name is no formula
    return figure


@styled
def replay_yaw(replays):
    """Error of the estimated yaw [rad] over time [s], a row an estimator, with the band of two
    standard deviations that the estimator states.

    Where the log has no true yaw: the estimated yaw itself.
    """
    figure, panels = plt.subplots(
        len(replays), figsize=(DOUBLE_IN, 0.4 + 1.2 * len(replays)), sharex=True, squeeze=False
    )
    for axes, (name, samples) in zip(panels[:, 0], replays.items()):
        known = "theta_rad" in samples
        value = scores.yaw_error(samples) if known else samples["theta_hat_rad"]
        plotted = samples.assign(
            value=value, low=-2 * samples["sigma_theta_rad"], high=2 * samples["sigma_theta_rad"]
        )
        t, value, low, high = _broken(plotted, "t_s", "value", "low", "high")
        axes.plot(t, value, **LOOKS.get(name, {}), linewidth=0.7)
        title = name
        if known:
            axes.fill_between(t, low, high, color=GREY, alpha=0.35, linewidth=0)
            score = scores.score(samples)
            title += f": RMS {score['yaw_rms_rad']:.3f} rad after {scores.FROM_M:.0f} m, {score['inside_95']:.0%} within 1.96 σ"
            extent = np.clip(1.15 * np.nanmax(np.abs(value)), 0.1, np.pi)
            axes.set_ylim(-extent, extent)
        axes.set_ylabel("yaw error [rad]" if known else "yaw [rad]")
        axes.set_title(title, loc="left")
    _time(panels[:, 0], samples)
    return figure


@styled
def replay_traction(replays, first):
    """μ and κ [-] over time [s]: the estimates of all, the band of two standard deviations of
    `first`, and where there is truth the regressions of true motion on encoder readings, over a
    sliding window and over the whole log (dashed).
    """
    figure, panels = plt.subplots(2, figsize=(DOUBLE_IN, 3.4), sharex=True)
    samples = replays[first]
    known = {truth for _, truth in scores.REGRESSIONS} <= set(samples)
    for place, (axes, name, symbol) in enumerate(zip(panels, ("mu", "kappa"), (r"\mu", r"\kappa"))):
        t, value, sigma = _broken(samples, "t_s", f"{name}_hat", f"sigma_{name}")
        axes.fill_between(
            t,
            np.clip(value - 2 * sigma, 0, 1),
            np.clip(value + 2 * sigma, 0, 1),
            color=GREY,
            alpha=0.3,
            linewidth=0,
        )
        for each, estimates in replays.items():
            axes.plot(
                *_broken(estimates, "t_s", f"{name}_hat"),
                **LOOKS.get(each, {}),
                linewidth=0.9 if each == first else 0.5,
                label=each,
            )
        if known:
            axes.plot(
                samples["t_s"],
                scores.sliding_regression(samples)[:, place],
                ".",
                color=ORANGE,
                markersize=1.5,
                label=f"regression over {scores.WINDOW_S:.0f} s",
            )
            axes.axhline(
                scores.regression(samples)[place],
                color=BLACK,
                linestyle="--",
                linewidth=0.8,
                label="regression, whole log",
            )
        axes.set_ylim(-0.05, 1.15)
        axes.set_ylabel(f"${symbol}$ [-]")
    panels[0].legend(
        loc="lower right",
        bbox_to_anchor=(1, 1),
        ncols=6,
        borderaxespad=0.1,
        handlelength=1.2,
        columnspacing=1.0,
    )
    _time(panels, samples)
    return figure


@styled
def replay_uncertainty(samples, name):
    """What one estimator says of its own uncertainty: standard deviations of yaw [rad] and of μ, κ
    [-] over time [s], and the motion they depend on.
    """
    figure, (motion, yaw, traction) = plt.subplots(3, figsize=(DOUBLE_IN, 3.6), sharex=True)
    motion.plot(
        *_broken(samples, "t_s", "nu_meas_mps"), color=BLACK, linewidth=0.7, label="speed [m/s]"
    )
    motion.plot(
        *_broken(samples, "t_s", "omega_meas_radps"),
        color=COLOURS["measured"],
        linewidth=0.7,
        label="yaw rate [rad/s]",
    )
    motion.set_ylabel("encoders")
    yaw.plot(
        *_broken(samples, "t_s", "sigma_theta_rad"),
        color=COLOURS["RHE"],
        label=r"$\sigma_\theta$ [rad]",
    )
    yaw.set_ylabel(r"$\sigma_\theta$ [rad]")
    for column, label, colour in [
        ("sigma_mu", r"$\sigma_\mu$", ORANGE),
        ("sigma_kappa", r"$\sigma_\kappa$", PURPLE),
    ]:
        traction.plot(*_broken(samples, "t_s", column), color=colour, label=label)
    traction.set_ylabel(r"$\sigma_\mu$, $\sigma_\kappa$ [-]")
    for axes in (yaw, traction):
        _decades(axes.yaxis)
    for axes in (motion, traction):
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0.1)
    motion.set_title(name, loc="left")
    _time((motion, yaw, traction), samples)
    return figure


@styled
def replay_innovations(replays):
    """Innovations: how far each measured position lies from the predicted one [m], over time [s]; a
    row an estimator, on a logarithmic scale.
    """
    figure, panels = plt.subplots(
        len(replays),
        figsize=(DOUBLE_IN, 0.4 + 1.0 * len(replays)),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for axes, (name, samples) in zip(panels[:, 0], replays.items()):
        length = np.hypot(samples["innovation_x_m"], samples["innovation_y_m"])
        axes.semilogy(samples["t_s"], length, ".", markersize=1.2, **LOOKS.get(name, {}))
        axes.set_title(
            f"{name}: RMS {scores.score(samples)['innovation_rms_m']:.3f} m after {scores.FROM_M:.0f} m",
            loc="left",
        )
        axes.set_ylabel("innovation [m]")
        axes.minorticks_off()
    _time(panels[:, 0], samples)
    return figure


@styled
def replay_trials(trials):
    """The trial over noise seeds: RMS error of the yaw [rad] of each estimator, every seed a dot,
    mean and 95 % interval beside them.
    """
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.2))
    for place, (name, rows) in enumerate(trials.items()):
        values, look = rows["yaw_rms_rad"], LOOKS.get(name, {})
        axes.plot(
            place + np.linspace(-0.25, 0.05, len(values)),
            values,
            "o",
            markersize=2.5,
            alpha=0.6,
            markeredgewidth=0,
            **look,
        )
        mean, low, high, n = over_seeds(np.mean, values)
        axes.errorbar(
            place + 0.2,
            mean,
            [[mean - low], [high - mean]],
            fmt="D",
            markersize=3.5,
            capsize=2.5,
            **look,
        )
        axes.annotate(
            f"{mean:.3g}", (place + 0.25, mean), (3, 0), textcoords="offset points", va="center"
        )
    axes.set_xticks(range(len(trials)), list(trials))
    axes.set_xlim(-0.5, len(trials) - 0.3)
    _decades(axes.yaxis)
    axes.set_ylim(
        0.7 * min(rows["yaw_rms_rad"].min() for rows in trials.values()),
        1.4 * max(rows["yaw_rms_rad"].max() for rows in trials.values()),
    )
    axes.set_ylabel("RMS yaw error [rad]")
    axes.set_title(f"{n} noise seeds; mean and 95 % interval", loc="left")
    axes.grid(axis="x", visible=False)
    return figure


@styled
def replay_faults(table):
    """Largest error of the position [m] and of the yaw [rad] from the beginning of each fault on,
    as it is and robust; every noise seed a dot, means bars.

    table: rows of `scores.fault_scores`.
    """
    figure, panels = plt.subplots(
        1, 2, figsize=(DOUBLE_IN, 0.6 + 0.26 * table["fault"].nunique()), sharey=True
    )
    names = list(dict.fromkeys(table["fault"]))
    for axes, column, label in zip(
        panels,
        ("worst_position_m", "worst_yaw_rad"),
        ("largest position error [m]", "largest yaw error [rad]"),
    ):
        for (robust, look), shift in zip(
            {False: COLOURS["EKF"], True: COLOURS["RHE"]}.items(), (-0.18, 0.18)
        ):
            for place, name in enumerate(names):
                values = table.loc[(table["fault"] == name) & (table["robust"] == robust), column]
                axes.plot(
                    values,
                    np.full(len(values), place + shift),
                    "o",
                    markersize=2,
                    alpha=0.5,
                    markeredgewidth=0,
                    color=look,
                )
                axes.plot(
                    values.mean(),
                    place + shift,
                    "|",
                    markersize=8,
                    color=look,
                    label=("robust" if robust else "as it is") if place == 0 else None,
                )
        _decades(axes.xaxis)
        axes.set_xlabel(label)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    panels[1].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, borderaxespad=0.1)
    return figure
