"""The paper's Figures 6 to 13, drawn from finished runs.

A `Run` is what `rhec.simulate` returns, a sweep what `rhec.campaign` returns: one row a run. Every
interval is a 95 % bootstrap interval over seeds, and every number that the paper reports stands
beside ours.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import LinearSegmentedColormap

from rhec import paper
from rhec.plots.style import BLACK, COLOURS, COLUMN_IN, DOUBLE_IN, GREY, styled
from rhec.studies.scenario_tables import REPORTED
from rhec.studies.statistics import over_seeds

TRACTION = LinearSegmentedColormap.from_list(
    "traction", ["0.35", "1"]
)  # dark where it slips, grey so that trajectories stand out
LINES = {
    "Q1": {"color": COLOURS["Q1"], "label": "$Q^1$"},
    "Q2": {"color": COLOURS["Q2"], "label": "$Q^2$"},
    "Q2, look-ahead": {
        "color": COLOURS["Q2"],
        "label": "$Q^2$, look-ahead",
        "linestyle": (0, (3, 1.5)),
    },
    "Q3": {"color": COLOURS["Q3"], "label": "$Q^3$"},
    "RHE": {"color": COLOURS["RHE"], "label": "RHE"},
    "EKF": {"color": COLOURS["EKF"], "label": "EKF"},
}
# What the figures are made of


def _about(run):
    """Which run it is, for a title."""
    return f"{run.scenario.process_noise} W, seed {run.scenario.seed}"


def _seeds(sweep):
    """Which runs they are, for a title."""
    seeds = sorted(sweep["seed"].unique())
    return f"{len(seeds)} seeds, {seeds[0]} to {seeds[-1]}"


def _title(axes, text):
    axes.set_title(text, loc="left")


def _time_axis(axes, log):
    """Time along the last of the axes, the curved parts of the path shaded in all."""
    for each in axes:
        each.fill_between(
            log["t_s"],
            0,
            1,
            where=~log["on_straight"],
            transform=each.get_xaxis_transform(),
            color="0.93",
            linewidth=0,
            zorder=0,
        )
        each.grid(axis="x", visible=False)
    axes[-1].set_xlabel("time [s]  (shaded: curved parts of the path)")
    axes[-1].set_xlim(log["t_s"].iloc[0], log["t_s"].iloc[-1])


def _above(axes, source):
    """The legend of `source` in one line above the axes, to the right, clear of the title and of
    the data.
    """
    axes.legend(
        *source.get_legend_handles_labels(),
        loc="lower right",
        bbox_to_anchor=(1, 1),
        ncols=4,
        borderaxespad=0.1,
        handlelength=1.5,
        columnspacing=1.2,
    )


def _field(axes, terrain, values):
    """A slip field as a map, by its image; the same colours in every figure."""
    (x, y), half = terrain.origin_m, terrain.cell_m / 2
    width, height = np.array(values.shape) * terrain.cell_m
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.grid(visible=False)
    return axes.imshow(
        values.T,
        origin="lower",
        extent=(x - half, x - half + width, y - half, y - half + height),
        interpolation="bilinear",
        cmap=TRACTION,
        vmin=0.5,
        vmax=1,
    )


def _reference(axes, path, up_to_m=None, **look):
    """The reference trajectory, from the start of the path to an arc length [m], else to its end."""
    poses, _ = path.poses(np.arange(0, (up_to_m or path.length_m) + 0.05, 0.1))
    axes.plot(
        *poses[:, :2].T,
        **{"color": BLACK, "linewidth": 0.8, "linestyle": "--", "label": "reference"} | look,
    )


def _strip(axes, groups):
    """Groups (label, values, look) side by side: every seed a dot, their mean and its 95 % interval
    beside them.
    """
    for place, (_, values, look) in enumerate(groups):
        values = values.dropna()
        spread = np.linspace(-0.3, 0.05, len(values))
        axes.plot(
            place + spread,
            values,
            "o",
            markersize=2,
            color=look["color"],
            alpha=0.5,
            markeredgewidth=0,
        )
        mean, low, high, _ = over_seeds(np.mean, values)
        axes.errorbar(
            place + 0.25,
            mean,
            [[mean - low], [high - mean]],
            fmt="D",
            markersize=3.5,
            color=look["color"],
            capsize=2.5,
        )
        axes.annotate(
            f"{mean:.2g}",
            (place + 0.25, high),
            (0, 3),
            textcoords="offset points",
            ha="center",
            fontsize=7,
        )
    axes.set_xticks(range(len(groups)), [label for label, _, _ in groups])
    axes.set_xlim(-0.5, len(groups) - 0.4)
    axes.grid(axis="x", visible=False)
    axes.margins(y=0.12)


# Scenario A


def _first_row(run):
    """The log until the robot leaves the path's first straight."""
    _, s = run.path.project(run.log[["x_m", "y_m"]])
    return run.log[np.minimum.accumulate(run.path.poses(s)[1] == 0)]


@styled
def trajectories_q(runs):
    """Figure 6: reference and trajectories on the first row from the off-track start, and true
    error [m] over time [s], for each yaw weight.

    runs: {"Q1": Run, "Q2": …}. A dot marks the settling time: from there the true error stays
    within 0.12 m for 5 s.
    """
    figure, (plane, time) = plt.subplots(2, figsize=(COLUMN_IN, 4.0))
    first = next(iter(runs.values()))
    rows = {name: _first_row(run) for name, run in runs.items()}
    _reference(
        plane,
        first.path,
        max(first.path.project(log[["x_m", "y_m"]])[1].max() for log in rows.values()),
    )
    for name, log in rows.items():
        plane.plot(log["x_m"], log["y_m"], **LINES[name])
        arrival = runs[name].metrics["settling_time_s"]
        settling = "never" if np.isnan(arrival) else f"{arrival:.1f} s"
        time.plot(
            log["t_s"],
            log["error_true_m"],
            **LINES[name] | {"label": f"{LINES[name]['label']}: {settling}"},
        )
        time.plot(
            arrival,
            np.interp(arrival, log["t_s"], log["error_true_m"]),
            "o",
            markersize=4,
            color=LINES[name]["color"],
            markeredgecolor="w",
        )
    time.axhline(paper.TOLERANCE_M, color=BLACK, linewidth=0.6, linestyle="--")
    time.axhspan(
        0, paper.TOLERANCE_M, color=COLOURS["tolerance"], alpha=0.35, linewidth=0, zorder=0
    )
    time.annotate(
        f"{paper.TOLERANCE_M} m",
        (1, paper.TOLERANCE_M),
        (0, 2),
        xycoords=("axes fraction", "data"),
        textcoords="offset points",
        ha="right",
        fontsize=7,
    )
    time.set_xlim(0, max(log["t_s"].iloc[-1] for log in rows.values()))
    time.set_ylim(0)
    plane.set(xlabel="$x$ [m]", ylabel="$y$ [m], stretched")
    time.set(xlabel="time [s]", ylabel="true error [m]")
    plane.legend()
    time.legend(title="settling time (dots)", title_fontsize=7)
    _title(plane, f"First row: {_about(first)}")
    return figure


@styled
def weight_sweep(sweep):
    """The numbers behind Figure 6: settling time [s] and overshoot [m] for each yaw weight over
    seeds; sweep as in `rhec.studies.scenario_tables.scenario_a_table`.
    """
    figure, (settling, overshoot) = plt.subplots(2, figsize=(COLUMN_IN, 3.6), sharex=True)
    for axes, column in [(settling, "settling_time_s"), (overshoot, "overshoot_m")]:
        _strip(
            axes,
            [
                (
                    f"{LINES[name]['label']}\n{runs['settling_time_s'].count()} of {len(runs)} settle",
                    runs[column],
                    LINES[name],
                )
                for name, runs in sweep.groupby("weight", sort=False)
            ],
        )
        axes.set_ylim(0)
    settling.set_ylabel("settling time [s]")
    overshoot.set_ylabel("overshoot [m]")
    overshoot.tick_params(axis="x", labelsize=6.5)
    _title(settling, f"{sweep['process_noise'].iloc[0]} W, {_seeds(sweep)}; mean and 95 % interval")
    return figure


# Scenario B


@styled
def slip_fields(terrain, path, title):
    """The slip fields μ and κ [-] as maps, side by side, and the path on them; title says which
    fields they are.
    """
    figure, both = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.0), sharey=True)
    for axes, values, name in zip(both, (terrain.mu, terrain.kappa), (r"$\mu$", r"$\kappa$")):
        image = _field(axes, terrain, values)
        _reference(axes, path)
        _title(axes, f"{name}: mean {values.mean():.2f}, deviation {values.std():.2f}")
    both[1].set_ylabel("")
    figure.colorbar(
        image, ax=both, label=r"traction $\mu$, $\kappa$ [-]", extend="min", fraction=0.03, pad=0.02
    )
    figure.suptitle(title, fontsize=8)
    return figure


@styled
def trajectories(runs):
    """Figure 7: the reference and the trajectories of RHE and EKF [m] on the map of κ [-]: all, the
    start, and where the error is largest.

    runs: {"RHE": Run, "EKF": Run} on the same terrain. The largest error is the true one after the
    arrival.
    """
    first = next(iter(runs.values()))
    figure, panels = plt.subplot_mosaic(
        [["all", "all"], ["start", "worst"]], figsize=(COLUMN_IN, 3.5)
    )
    for axes in panels.values():
        image = _field(axes, first.terrain, first.terrain.kappa)
        _reference(axes, first.path)
        for name, run in runs.items():
            axes.plot(run.log["x_m"], run.log["y_m"], **LINES[name])
    everything = pd.concat([run.log for run in runs.values()])
    worst = max(runs.values(), key=lambda run: run.metrics["max_error_true_m"])
    largest = worst.metrics["max_error_true_m"]
    place = worst.log[worst.log["error_true_m"] == largest]
    for name, log, margin_m, title in [
        ("all", everything, 2, _about(first)),
        ("start", everything[everything["t_s"] < 25], 0.2, "start, $y$ stretched"),
        ("worst", place, 2.5 * largest, f"largest error {largest:.2f} m"),
    ]:
        (x, y), (x_end, y_end) = (
            log[["x_m", "y_m"]].min() - margin_m,
            log[["x_m", "y_m"]].max() + margin_m,
        )
        panels[name].set(xlim=(x, x_end), ylim=(y, y_end))
        _title(panels[name], title)
    panels["start"].set(aspect="auto", box_aspect=1)
    panels["worst"].set_ylabel("")
    figure.colorbar(
        image, ax=panels["all"], label=r"$\kappa$ [-]", extend="min", fraction=0.03, pad=0.02
    )
    figure.legend(*panels["all"].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@styled
def errors(runs):
    """Figure 8: Euclidean errors from raw GNSS to the path [m] over time [s], a row for each
    reading, a column for each estimator.

    runs: {reading: {"RHE": Run, "EKF": Run}}. Means count from the arrival on; dotted: the mean
    that the paper reports.
    """
    figure, grid = plt.subplots(
        len(runs),
        2,
        figsize=(DOUBLE_IN, 0.6 + 1.6 * len(runs)),
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for row, by_estimator in zip(grid, runs.values()):
        for axes, (name, run) in zip(row, by_estimator.items()):
            mean, reported = run.metrics["mean_error_m"], REPORTED[name, "mean_error_m"]
            axes.semilogy(run.log["t_s"], run.log["error_m"], color=COLOURS[name], linewidth=0.6)
            axes.minorticks_off()
            for level, line, meaning in [
                (paper.TOLERANCE_M, "--", f"{paper.TOLERANCE_M} m"),
                (mean, "-", "mean after arrival"),
                (reported, ":", "mean in the paper"),
            ]:
                axes.axhline(level, color=BLACK, linewidth=0.9, linestyle=line, label=meaning)
            _title(
                axes,
                f"{name}, {run.scenario.process_noise} W: mean {mean:.4f} m, paper: {reported} m",
            )
            _time_axis([axes], run.log)
        row[0].set_ylabel("error, raw GNSS [m]")
    for axes in grid[:-1].flat:
        axes.set_xlabel("")
    grid[0, 0].set_ylim(0.004)
    figure.suptitle(f"seed {run.scenario.seed}", fontsize=8)
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


@styled
def violations(sweep):
    """Figure 9: samples on straight lines with an error above 0.12 m in a run, by raw GNSS and in
    truth, over seeds.

    sweep: rows of `rhec.campaign`. Bars are means, whiskers 95 % intervals, dots seeds, dotted
    lines what the paper reports; a panel for each reading. The scale is linear up to 10 and
    logarithmic beyond, for both estimators to be seen.
    """
    readings = list(sweep.groupby("process_noise", sort=False))
    figure, panels = plt.subplots(
        1, len(readings), figsize=(COLUMN_IN, 2.7), sharey=True, squeeze=False
    )
    for axes, (process_noise, runs) in zip(panels[0], readings):
        for place, (name, each) in enumerate(
            (name.upper(), each) for name, each in runs.groupby("estimator", sort=False)
        ):
            for shift, column, alpha in [(-0.2, "violations", 0.9), (0.2, "violations_true", 0.4)]:
                mean, low, high, _ = over_seeds(np.mean, each[column])
                axes.bar(place + shift, mean, 0.38, color=COLOURS[name], alpha=alpha)
                axes.plot(
                    place + shift + np.linspace(-0.13, 0.13, len(each)),
                    each[column],
                    "o",
                    markersize=1.5,
                    color=GREY,
                    markeredgewidth=0,
                )
                axes.errorbar(
                    place + shift,
                    mean,
                    [[mean - low], [high - mean]],
                    color=BLACK,
                    capsize=2,
                    linewidth=0.8,
                )
                axes.annotate(
                    f"{mean:.3g}",
                    (place + shift, 1),
                    (0, -10),
                    xycoords=("data", "axes fraction"),
                    textcoords="offset points",
                    ha="center",
                    va="top",
                    fontsize=7,
                )
            reported = REPORTED[name, "violations"]
            axes.hlines(reported, place - 0.45, place + 0.45, color=BLACK, linestyle=":", zorder=3)
            axes.annotate(
                f"paper: {reported}",
                (place, 1),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="top",
                fontsize=7,
            )
        axes.set_xticks([-0.2, 0.2, 0.8, 1.2], ["raw", "true"] * 2)
        axes.set_xticks([0, 1], ["RHE", "EKF"], minor=True)
        axes.tick_params(axis="x", which="minor", length=0, pad=14)
        axes.grid(axis="x", visible=False)
        _title(axes, f"{process_noise} W")
    axes.set_yscale("symlog", linthresh=10, linscale=0.6)
    axes.set_yticks(ticks := [0, 5, 10, 20, 50, 100, 200, 500, 1000], ticks)
    axes.set_ylim(0, 3000)
    panels[0, 0].set_ylabel("violations on straights in a run [samples]")
    figure.suptitle(f"{_seeds(sweep)}; mean, 95 % interval, each seed", fontsize=8)
    return figure


@styled
def estimates(run):
    """Figure 10: the RHE's yaw [rad] and traction parameters μ, κ [-] over time [s], against the
    truth, with the constraints 0 and 1.
    """
    figure, panels = plt.subplots(3, figsize=(DOUBLE_IN, 4.4), sharex=True)
    log = run.log
    for axes, truth, estimate, symbol, unit, rms in [
        (panels[0], "theta_rad", "theta_hat_rad", r"yaw $\theta$", "rad", "rms_yaw_rad"),
        (panels[1], "mu", "mu_hat", r"$\mu$", "-", "rms_mu"),
        (panels[2], "kappa", "kappa_hat", r"$\kappa$", "-", "rms_kappa"),
    ]:
        axes.plot(log["t_s"], log[estimate], color=COLOURS["RHE"], label="RHE")
        axes.plot(log["t_s"], log[truth], color=COLOURS["truth"], linewidth=0.8, label="truth")
        axes.set_ylabel(f"{symbol} [{unit}]")
        _title(axes, f"{symbol}: RMS error after arrival {run.metrics[rms]:.3f} [{unit}]")
    for axes in panels[1:]:
        axes.hlines(
            [0, 1],
            *log["t_s"].iloc[[0, -1]],
            color=BLACK,
            linewidth=0.6,
            linestyle="--",
            label="constraints",
        )
        axes.set_ylim(-0.06, 1.06)
    _above(panels[0], panels[2])
    _time_axis(panels, log)
    figure.suptitle(f"RHE, {_about(run)}", fontsize=8)
    return figure


@styled
def speed(run):
    """Figure 11: measured, estimated and true speed of the tracks ν [m/s] over time [s]."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.0))
    for column, name, width in [
        ("nu_mps", "truth", 0.4),
        ("nu_meas_mps", "measured", 0.6),
        ("nu_hat_mps", "RHE", 1.0),
    ]:
        axes.plot(run.log["t_s"], run.log[column], color=COLOURS[name], linewidth=width, label=name)
    axes.set_ylabel(r"speed $\nu$ [m/s]")
    _above(axes, axes)
    _title(axes, _about(run))
    _time_axis([axes], run.log)
    return figure


@styled
def yaw_rate(run):
    """Figure 12: the reference yaw rate that the RHC commands, with its bounds, and the actual one
    of the tracks ω [rad/s] over time [s].
    """
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.0))
    axes.plot(
        run.log["t_s"],
        run.log["omega_radps"],
        color=COLOURS["truth"],
        linewidth=0.6,
        label="actual",
    )
    axes.step(
        run.log["t_s"],
        run.log["omega_cmd_radps"],
        where="post",
        color=COLOURS["RHE"],
        linewidth=0.9,
        label="reference (RHC)",
    )
    bound = run.scenario.omega_max_radps
    axes.hlines(
        [-bound, bound],
        *run.log["t_s"].iloc[[0, -1]],
        color=BLACK,
        linewidth=0.6,
        linestyle="--",
        label="bounds",
    )
    axes.set_ylabel(r"yaw rate $\omega$ [rad/s]")
    _above(axes, axes)
    reached = (
        run.log["omega_radps"].to_numpy()[1:] - run.log["omega_cmd_radps"].to_numpy()[:-1]
    )  # a command lasts until the next sample
    _title(axes, f"{_about(run)}: actual - reference, RMS {np.sqrt(np.mean(reached**2)):.3f} rad/s")
    _time_axis([axes], run.log)
    return figure


@styled
def kkt(run):
    """Figure 13: KKT tolerances [-] of RHE and RHC after their one Gauss-Newton iteration, over
    time [s].
    """
    figure, panels = plt.subplots(2, figsize=(DOUBLE_IN, 3.0), sharex=True)
    for axes, name, colour in zip(panels, ("RHE", "RHC"), (COLOURS["RHE"], COLOURS["oracle"])):
        tolerance = run.log[f"kkt_{name.lower()}"]
        axes.semilogy(run.log["t_s"], tolerance, color=colour, linewidth=0.7)
        axes.minorticks_off()
        axes.set_ylabel("KKT tolerance [-]")
        axes.set_ylim(
            max(tolerance.min(), tolerance.median() / 1000)
        )  # it vanishes where every input is at its bound
        largest = f"largest {tolerance.max():.2g} at {run.log['t_s'][tolerance.idxmax()]:.1f} s"
        _title(axes, f"{name}, {_about(run)}: {largest}, median {tolerance.median():.2g}")
    _time_axis(panels, run.log)
    return figure
