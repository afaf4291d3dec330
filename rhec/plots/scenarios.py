"""The paper's Figures 6 to 13, drawn from finished runs.

`run` is a Run as `rhec.simulate` returns it, `sweep` has a row a run as `rhec.campaign` returns
them. Every interval is a 95 % bootstrap interval over seeds, and every number that the paper
reports stands beside ours.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import LinearSegmentedColormap

from rhec import paper
from rhec.plots import parts
from rhec.plots.style import BLACK, COLOURS, COLUMN_IN, DOUBLE_IN, GREY, styled
from rhec.studies.scenario_tables import REPORTED
from rhec.studies.statistics import over_seeds

__all__ = ["errors", "estimates", "kkt", "slip_fields", "speed", "trajectories", "trajectories_q"]
__all__ += ["violations", "weight_sweep", "yaw_rate"]

# dark where it slips, grey so that trajectories stand out
_TRACTION = LinearSegmentedColormap.from_list("traction", ["0.35", "1"])
_TRACTION_BAR = dict(extend="min", fraction=0.03, pad=0.02)
_TIGHT = dict(handlelength=1.5, columnspacing=1.2)  # a legend
_LINES = {
    "Q1": dict(color=COLOURS["Q1"], label="$Q^1$"),
    "Q2": dict(color=COLOURS["Q2"], label="$Q^2$"),
    "Q2, look-ahead": dict(color=COLOURS["Q2"], label="$Q^2$, look-ahead", dashes=(3, 1.5)),
    "Q3": dict(color=COLOURS["Q3"], label="$Q^3$"),
    "RHE": dict(color=COLOURS["RHE"], label="RHE"),
    "EKF": dict(color=COLOURS["EKF"], label="EKF"),
}


def _about(run):
    """The run's process noise and seed, for a title."""
    return f"{run.scenario.process_noise} process noise, seed {run.scenario.seed}"


def _time_axis(axes, log):
    """Time along the last of the axes, the curved parts of the path shaded in all."""
    parts.time_axis(axes, log["t_s"], ~log["on_straight"], "curved parts of the path")


def _field(axes, terrain, values):
    """A slip field as a map, in the same colours in every figure. Returns the image."""
    left, bottom = np.subtract(terrain.origin_m, terrain.cell_m / 2)
    width, height = np.array(values.shape) * terrain.cell_m
    extent = (left, left + width, bottom, bottom + height)
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.grid(visible=False)
    look = dict(origin="lower", interpolation="bilinear", cmap=_TRACTION, vmin=0.5, vmax=1)
    return axes.imshow(values.T, extent=extent, **look)


def _reference(axes, path, up_to_m=None):
    """The reference trajectory from the start of the path to an arc length [m], else to its end."""
    poses, _ = path.poses(np.arange(0, (up_to_m or path.length_m) + 0.05, 0.1))
    axes.plot(*poses[:, :2].T, **parts.BOUND | dict(linewidth=0.8, label="reference"))


def _first_row(run):
    """The log until the robot leaves the path's first straight."""
    _, s = run.path.project(run.log[["x_m", "y_m"]])
    return run.log[np.minimum.accumulate(run.path.poses(s)[1] == 0)]


@styled
def trajectories_q(runs):
    """Figure 6: trajectories on the first row from the off-track start, and true errors over time.

    Args:
        runs: {yaw weight: Run}, weights "Q1", "Q2", "Q2, look-ahead" or "Q3". A dot marks the
            settling time: from there the true error stays within 0.12 m for 5 s.
    """
    figure, (plane, time) = plt.subplots(2, figsize=(COLUMN_IN, 4.0))
    first = next(iter(runs.values()))
    rows = {name: _first_row(run) for name, run in runs.items()}
    ends = [first.path.project(log[["x_m", "y_m"]])[1].max() for log in rows.values()]
    _reference(plane, first.path, max(ends))
    for name, log in rows.items():
        look, settled_s = _LINES[name], runs[name].metrics["settling_time_s"]
        plane.plot(log["x_m"], log["y_m"], **look)
        words = "never" if np.isnan(settled_s) else f"{settled_s:.1f} s"
        label = {"label": f"{look['label']}: {words}"}
        time.plot(log["t_s"], log["error_true_m"], **look | label)
        then_m = np.interp(settled_s, log["t_s"], log["error_true_m"])
        time.plot(settled_s, then_m, "o", markersize=4, color=look["color"], markeredgecolor="w")
    time.axhline(paper.TOLERANCE_M, **parts.BOUND)
    time.axhspan(0, paper.TOLERANCE_M, **parts.TOLERANCE)
    place = dict(xycoords=("axes fraction", "data"), ha="right", va="baseline")
    parts.note(time, f"{paper.TOLERANCE_M} m", (1, paper.TOLERANCE_M), (0, 2), **place)
    end_s = max(log["t_s"].iloc[-1] for log in rows.values())
    time.set(xlim=(0, end_s), ylim=0, xlabel="time [s]", ylabel="true error [m]")
    title = f"First row: {_about(first)}"
    plane.set(xlabel="$x$ [m]", ylabel="$y$ [m], stretched", title=title)
    plane.legend()
    time.legend(title="settling time (dots)", title_fontsize=7)
    return figure


@styled
def weight_sweep(sweep):
    """The numbers behind Figure 6: settling time and overshoot for each yaw weight over seeds.

    Args:
        sweep: as in `rhec.studies.scenario_tables.scenario_a_table`.
    """
    figure, both = plt.subplots(2, figsize=(COLUMN_IN, 3.6), sharex=True)
    by_weight = dict(list(sweep.groupby("weight", sort=False)))
    labels = [
        f"{_LINES[name]['label']}\n{runs['settling_time_s'].count()} of {len(runs)} settle"
        for name, runs in by_weight.items()
    ]
    columns = {"settling_time_s": "settling time [s]", "overshoot_m": "overshoot [m]"}
    for axes, (column, quantity) in zip(both, columns.items()):
        for place, (name, runs) in enumerate(by_weight.items()):
            look = dict(color=_LINES[name]["color"], markersize=2, alpha=0.5)
            places = place + np.array([-0.3, 0.05, 0.25])
            mean = parts.strip(axes, places, runs[column].dropna(), **look)
            at, look = (places[2], mean.high), dict(ha="center", va="baseline")
            parts.note(axes, f"{mean.mean:.2g}", at, (0, 3), **look)
        axes.set_xticks(range(len(labels)), labels)
        axes.grid(axis="x", visible=False)
        axes.margins(y=0.12)
        axes.set(xlim=(-0.5, len(labels) - 0.4), ylim=0, ylabel=quantity)
    both[1].tick_params(axis="x", labelsize=6.5)
    noise = sweep["process_noise"].iloc[0]
    both[0].set_title(f"{noise} process noise, {parts.seed_range(sweep)}\nmean and 95 % interval")
    return figure


@styled
def slip_fields(terrain, path, title):
    """The slip fields μ and κ [-] as maps, side by side, and the path on them.

    Args:
        terrain: a rhec.Terrain.
        path: a rhec.Path.
        title: which fields they are.
    """
    figure, both = parts.panels_beside(2, 2.0)
    for axes, values, name in zip(both, (terrain.mu, terrain.kappa), (r"$\mu$", r"$\kappa$")):
        image = _field(axes, terrain, values)
        _reference(axes, path)
        axes.set_title(f"{name}: mean {values.mean():.2f}, deviation {values.std():.2f}")
    both[1].set_ylabel("")
    figure.colorbar(image, ax=both, label=r"traction $\mu$, $\kappa$ [-]", **_TRACTION_BAR)
    figure.suptitle(title, fontsize=8)
    return figure


@styled
def trajectories(runs):
    """Figure 7: reference and trajectories on the map of κ: all, the start, and where the true
    error after settling is largest.

    Args:
        runs: {"RHE": Run, "EKF": Run} on the same terrain.
    """
    first = next(iter(runs.values()))
    mosaic = [["all", "all"], ["start", "worst"]]
    figure, panels = plt.subplot_mosaic(mosaic, figsize=(COLUMN_IN, 3.5))
    for axes in panels.values():
        image = _field(axes, first.terrain, first.terrain.kappa)
        _reference(axes, first.path)
        for name, run in runs.items():
            axes.plot(run.log["x_m"], run.log["y_m"], **_LINES[name])
    everything = pd.concat([run.log for run in runs.values()])
    worst = max(runs.values(), key=lambda run: run.metrics["max_error_true_m"])
    largest = worst.metrics["max_error_true_m"]
    place = worst.log[worst.log["error_true_m"] == largest]
    for name, log, margin_m, title in [
        ("all", everything, 2, _about(first)),
        ("start", everything[everything["t_s"] < 25], 0.2, "start, $y$ stretched"),
        ("worst", place, 2.5 * largest, f"largest error {largest:.2f} m"),
    ]:
        low, high = log[["x_m", "y_m"]].min() - margin_m, log[["x_m", "y_m"]].max() + margin_m
        panels[name].set(xlim=(low.x_m, high.x_m), ylim=(low.y_m, high.y_m), title=title)
    panels["start"].set(aspect="auto", box_aspect=1)
    panels["worst"].set_ylabel("")
    figure.colorbar(image, ax=panels["all"], label=r"$\kappa$ [-]", **_TRACTION_BAR)
    parts.legend_outside(figure, panels["all"], "lower center", 3)
    return figure


@styled
def errors(runs):
    """Figure 8: Euclidean errors from raw GNSS to the path over time; means after settling.

    Args:
        runs: {process noise: {"RHE": Run, "EKF": Run}}, a row for each, a column for each.
    """
    size = (DOUBLE_IN, 0.6 + 1.6 * len(runs))
    figure, grid = plt.subplots(len(runs), 2, figsize=size, sharex=True, sharey=True, squeeze=False)
    for row, by_estimator in zip(grid, runs.values()):
        for axes, (name, run) in zip(row, by_estimator.items()):
            mean, reported = run.metrics["mean_error_m"], REPORTED[name, "mean_error_m"]
            axes.semilogy(run.log["t_s"], run.log["error_m"], color=COLOURS[name], linewidth=0.6)
            axes.minorticks_off()
            for level, line, meaning in [
                (paper.TOLERANCE_M, "--", f"{paper.TOLERANCE_M} m"),
                (mean, "-", "mean after settling"),
                (reported, ":", "mean in the paper"),
            ]:
                axes.axhline(level, color=BLACK, linewidth=0.9, linestyle=line, label=meaning)
            about = f"{name}, {run.scenario.process_noise} W"
            axes.set_title(f"{about}: mean {mean:.4f} m, paper: {reported} m")
            _time_axis([axes], run.log)
        row[0].set_ylabel("error, raw GNSS [m]")
    for axes in grid[:-1].flat:
        axes.set_xlabel("")
    grid[0, 0].set_ylim(0.004)
    noises = " and ".join(runs)
    figure.suptitle(f"{noises} process noise W, seed {run.scenario.seed}", fontsize=8)
    parts.legend_outside(figure, grid[0, 0], "lower center", 3)
    return figure


def _violation_bars(axes, place, name, runs):
    """Bars of one estimator, by raw GNSS and in truth, and the number that the paper reports."""
    top = dict(xycoords=("data", "axes fraction"), ha="center", va="top")
    for shift, column, alpha in [(-0.2, "violations", 0.9), (0.2, "violations_true", 0.4)]:
        x, estimate = place + shift, over_seeds(np.mean, runs[column])
        axes.bar(x, estimate.mean, 0.38, color=COLOURS[name], alpha=alpha)
        spread = np.linspace(-0.13, 0.13, len(runs))
        axes.plot(x + spread, runs[column], **parts.DOTS, markersize=1.5, color=GREY)
        parts.vertical_interval(axes, x, estimate, color=BLACK, capsize=2, linewidth=0.8)
        parts.note(axes, f"{estimate.mean:.3g}", (x, 1), (0, -10), **top)
    reported = REPORTED[name, "violations"]
    axes.hlines(reported, place - 0.45, place + 0.45, color=BLACK, linestyle=":", zorder=3)
    parts.note(axes, f"paper: {reported}", (place, 1), **top)


@styled
def violations(sweep):
    """Figure 9: samples on straight lines with an error above 0.12 m in a run, by raw GNSS and in
    truth, over seeds; a panel for each process noise.

    Bars are means, whiskers 95 % intervals, dots seeds, dotted lines numbers of the paper.
    """
    by_noise = list(sweep.groupby("process_noise", sort=False))
    figure, panels = parts.panels_beside(len(by_noise), 2.7, COLUMN_IN)
    for axes, (noise, runs) in zip(panels, by_noise):
        for place, (name, of_one) in enumerate(runs.groupby("estimator", sort=False)):
            _violation_bars(axes, place, name.upper(), of_one)
        axes.set_xticks([-0.2, 0.2, 0.8, 1.2], ["raw", "true"] * 2)
        axes.set_xticks([0, 1], ["RHE", "EKF"], minor=True)
        axes.tick_params(axis="x", which="minor", length=0, pad=14)
        axes.grid(axis="x", visible=False)
        axes.set_title(f"{noise} process noise")
    axes.set_yscale("symlog", linthresh=10, linscale=0.6)
    axes.set_yticks(ticks := [0, 5, 10, 20, 50, 100, 200, 500, 1000], ticks)
    panels[0].set(ylim=(0, 3000), ylabel="violations on straights in a run [samples]")
    figure.suptitle(f"{parts.seed_range(sweep)}; mean, 95 % interval, each seed", fontsize=8)
    return figure


@styled
def estimates(run):
    """Figure 10: the RHE's yaw and traction parameters, the truth, and the constraints (14)."""
    figure, panels = plt.subplots(3, figsize=(DOUBLE_IN, 4.4), sharex=True)
    log = run.log
    for axes, truth, estimate, symbol, unit, rms in [
        (panels[0], "theta_rad", "theta_hat_rad", r"yaw $\theta$", "rad", "rms_yaw_rad"),
        (panels[1], "mu", "mu_hat", r"$\mu$", "-", "rms_mu"),
        (panels[2], "kappa", "kappa_hat", r"$\kappa$", "-", "rms_kappa"),
    ]:
        axes.plot(log["t_s"], log[estimate], color=COLOURS["RHE"], label="RHE")
        axes.plot(log["t_s"], log[truth], color=COLOURS["truth"], linewidth=0.8, label="truth")
        title = f"{symbol}: RMS error after settling {run.metrics[rms]:.3f} [{unit}]"
        axes.set(ylabel=f"{symbol} [{unit}]", title=title)
    for axes in panels[1:]:
        axes.hlines([0, 1], *log["t_s"].iloc[[0, -1]], label="constraints", **parts.BOUND)
        axes.set_ylim(-0.06, 1.06)
    parts.legend_above(panels[0], panels[2], **_TIGHT)
    _time_axis(panels, log)
    figure.suptitle(f"RHE, {_about(run)}", fontsize=8)
    return figure


@styled
def speed(run):
    """Figure 11: measured, estimated and true speed of the tracks ν over time."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.0))
    for column, name, width in [
        ("nu_mps", "truth", 0.4),
        ("nu_meas_mps", "measured", 0.6),
        ("nu_hat_mps", "RHE", 1.0),
    ]:
        axes.plot(run.log["t_s"], run.log[column], color=COLOURS[name], linewidth=width, label=name)
    parts.legend_above(axes, **_TIGHT)
    axes.set(ylabel=r"speed $\nu$ [m/s]", title=_about(run))
    _time_axis([axes], run.log)
    return figure


@styled
def yaw_rate(run):
    """Figure 12: the yaw rate that the RHC commands, its bounds, and the tracks' actual one ω."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.0))
    t_s, actual, commanded = (run.log[name] for name in ("t_s", "omega_radps", "omega_cmd_radps"))
    axes.plot(t_s, actual, color=COLOURS["truth"], linewidth=0.6, label="actual")
    look = dict(color=COLOURS["RHE"], linewidth=0.9)
    axes.step(t_s, commanded, where="post", label="reference (RHC)", **look)
    bound = run.scenario.omega_max_radps
    axes.hlines([-bound, bound], *t_s.iloc[[0, -1]], label="bounds", **parts.BOUND)
    parts.legend_above(axes, **_TIGHT)
    # a command lasts until the next sample
    rms = np.sqrt(np.mean((actual.to_numpy()[1:] - commanded.to_numpy()[:-1]) ** 2))
    title = f"{_about(run)}: actual - reference, RMS {rms:.3f} rad/s"
    axes.set(ylabel=r"yaw rate $\omega$ [rad/s]", title=title)
    _time_axis([axes], run.log)
    return figure


@styled
def kkt(run):
    """Figure 13: KKT tolerances of RHE and RHC after one Gauss-Newton iteration, over time."""
    figure, panels = plt.subplots(2, figsize=(DOUBLE_IN, 3.0), sharex=True)
    for axes, name, colour in zip(panels, ("RHE", "RHC"), (COLOURS["RHE"], COLOURS["oracle"])):
        tolerance = run.log[f"kkt_{name.lower()}"]
        axes.semilogy(run.log["t_s"], tolerance, color=colour, linewidth=0.7)
        axes.minorticks_off()
        # it vanishes where every input is at its bound
        least, median = tolerance.min(), tolerance.median()
        largest = f"largest {tolerance.max():.2g} at {run.log['t_s'][tolerance.idxmax()]:.1f} s"
        title = f"{name}, {_about(run)}: {largest}, median {median:.2g}"
        axes.set(ylabel="KKT tolerance [-]", ylim=max(least, median / 1000), title=title)
    _time_axis(panels, run.log)
    return figure
