"""The paper's Figures 6 to 13, drawn from finished runs.

`run` is a Run as `rhec.simulate` returns it, `drives` are Runs that differ by their seeds, `table`
is of `rhec.workbench.studies.scenario_tables`. Bands and thin lines hold the middle 90 % of the
drives, thick lines are 95 % intervals of their mean. Where the paper reports a number, it is shown
beside ours.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import LinearSegmentedColormap

from rhec import paper
from rhec.workbench.plots import parts
from rhec.workbench.plots.style import BLACK, COLOURS, COLUMN_IN, DOUBLE_IN, SKY, styled
from rhec.workbench.studies.consistency import stated
from rhec.workbench.studies.scenario_tables import REPORTED, over_fields, share_of_fields

# Dark where the soil slips; grey, so that coloured trajectories stand out.
_TRACTION = LinearSegmentedColormap.from_list("traction", ["0.35", "1"])
_TRACTION_BAR = dict(extend="min", fraction=0.03, pad=0.02)
_TIGHT = dict(handlelength=1.5, columnspacing=1.2)  # a legend
_KKT = {"RHE": "RHE", "RHC": "oracle"}
_LEAST_KKT = 1e-5
_DOT_AND_LINES = "dot and thick line: mean, 95 % interval; thin line: middle 90 % of the drives"
_POOLED = round(1 / paper.DT_S)  # samples of one second
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


def _fields(drives):
    """How many fields, for a title."""
    seeds = [run.scenario.seed for run in drives]
    return f"{len(seeds)} fields (seeds {min(seeds)} to {max(seeds)})"


def _over(drives):
    """What a line and its band are, for a title."""
    noise = drives[0].scenario.process_noise
    return f"{noise} process noise: median, middle 90 % of {_fields(drives)}"


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


def _corridor(axes, path):
    """The tolerance to the left and right of the path, as two thin lines."""
    poses, _ = path.poses(np.arange(0, path.length_m + 0.05, 0.1))
    x, y, theta = poses.T
    for side_m in (-paper.TOLERANCE_M, paper.TOLERANCE_M):
        look = dict(color=COLOURS["tolerance"], linewidth=1.2, zorder=1)
        axes.plot(x - side_m * np.sin(theta), y + side_m * np.cos(theta), **look)


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
        look = _LINES[name]
        settled_s = runs[name].metrics["settling_time_s"]
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
def weight_sweep(table, process_noise):
    """The numbers behind Figure 6: settling time and overshoot for each yaw weight, over fields.

    Args:
        table: as `rhec.workbench.studies.scenario_tables.scenario_a_table` returns it.
        process_noise: of the drives, "printed" or "calibrated".
    """
    figure, panels = parts.panels_beside(2, 1.5)
    for axes, quantity in zip(panels, ("settling time [s]", "overshoot [m]")):
        rows = table[(table["quantity"] == quantity)]
        for place, row in enumerate(rows.itertuples()):
            parts.interval_row(axes, place, row, _LINES[row.weight]["color"])
        parts.rows_axis(axes, [_LINES[name]["label"] for name in rows["weight"]], quantity)
    settled = table.loc[table["quantity"] == "settling time [s]", ["n", "weight"]].to_numpy()
    counts = ", ".join(f"{n} with {_LINES[name]['label']}" for n, name in settled)
    panels[0].set_title(f"{process_noise} process noise, {table['n'].max()} fields, a seed each")
    figure.supxlabel(f"{_DOT_AND_LINES}; settled: {counts}", fontsize=7)
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
    """Figure 7: reference and trajectories on the map of κ.

    Above, the whole drive; below, the start and the place of the largest true error after settling,
    both with the 0.12 m on either side of the path in yellow.

    Args:
        runs: {"RHE": Run, "EKF": Run} on the same terrain.
    """
    first = next(iter(runs.values()))
    mosaic = [["all", "all"], ["start", "worst"]]
    figure, panels = plt.subplot_mosaic(mosaic, figsize=(COLUMN_IN, 3.5))
    for axes in panels.values():
        image = _field(axes, first.terrain, first.terrain.kappa)
        _reference(axes, first.path)
        # The RHE is drawn last and narrow, so that both lines show where they agree.
        for name in ("EKF", "RHE"):
            log = runs[name].log
            wide = dict(linewidth=1.8) if name == "EKF" else {}
            axes.plot(log["x_m"], log["y_m"], **_LINES[name], **wide)
        axes.plot(*log[["x_m", "y_m"]].iloc[0], "o", color=BLACK, markersize=3)
    everything = pd.concat([run.log for run in runs.values()])
    worst = max(runs.values(), key=lambda run: run.metrics["max_error_true_m"])
    largest = worst.metrics["max_error_true_m"]
    place = worst.log[worst.log["error_true_m"] == largest]
    for name, log, margin_m, title in [
        ("all", everything, 2, _about(first)),
        ("start", everything[everything["t_s"] < 25], 0.2, "start, $y$ stretched"),
        ("worst", place, 2.5 * largest, f"largest error {largest:.2f} m"),
    ]:
        low = log[["x_m", "y_m"]].min() - margin_m
        high = log[["x_m", "y_m"]].max() + margin_m
        panels[name].set(xlim=(low.x_m, high.x_m), ylim=(low.y_m, high.y_m), title=title)
    for name in ("start", "worst"):
        _corridor(panels[name], first.path)
    panels["start"].set(aspect="auto", box_aspect=1)
    parts.note(panels["start"], "start", first.log[["x_m", "y_m"]].iloc[0], (5, 3))
    ahead = first.path.poses(np.array([0.3, 0.45]) * first.scenario.row_length_m)[0][:, :2]
    arrow = dict(arrowstyle="-|>", color=BLACK, linewidth=1)
    for axes in (panels["all"], panels["start"]):
        axes.annotate("", ahead[1] + (0, 1.0), ahead[0] + (0, 1.0), arrowprops=arrow)
    panels["worst"].set_ylabel("")
    figure.colorbar(image, ax=panels["all"], label=r"$\kappa$ [-]", **_TRACTION_BAR)
    parts.legend_outside(figure, panels["all"], "lower center", 3)
    return figure


@styled
def errors(drives, table):
    """Figure 8: Euclidean errors from raw GNSS to the path over time, and the share of fields on
    which they are above 0.12 m.

    Args:
        drives: {process noise: {"RHE": drives, "EKF": drives}}, a column for each.
        table: as `rhec.workbench.studies.scenario_tables.scenario_b_table` returns it.
    """
    size = (DOUBLE_IN, 3.6)
    heights = (2, 1)
    grid = dict(sharex=True, sharey="row", squeeze=False, height_ratios=heights)
    figure, (above, below) = plt.subplots(2, len(drives), figsize=size, **grid)
    means = table[table["quantity"] == "mean error, raw GNSS [m]"]
    means = means.set_index(["process_noise", "estimator"])
    for error, share, (noise, by_name) in zip(above, below, drives.items()):
        lines = []
        for name in ("EKF", "RHE"):
            log = by_name[name][0].log
            look = dict(color=COLOURS[name])
            t_s = log["t_s"][: len(log) // _POOLED * _POOLED : _POOLED]
            _, median, p95 = over_fields(by_name[name], "error_m", _POOLED)
            error.fill_between(t_s, median, p95, alpha=0.25, linewidth=0, **look)
            error.plot(t_s, median, label=name, **look)
            beyond = share_of_fields(by_name[name], "error_m", paper.TOLERANCE_M, _POOLED)
            share.plot(t_s, 100 * beyond, **look)
            mean = means.loc[(noise, name)]
            reported = REPORTED[name, "mean_error_m"]
            lines += [f"{name}: mean {mean['mean']:.4f} m (n = {mean['n']}), paper: {reported} m"]
        error.axhline(paper.TOLERANCE_M, **parts.BOUND, label=f"{paper.TOLERANCE_M} m")
        error.set_title("\n".join([f"{noise} process noise", *lines[::-1]]))
        error.set_yscale("log")
        error.minorticks_off()
        _time_axis([error, share], log)
    above[0].set(ylabel="error, raw GNSS [m]", ylim=(0.02, 10))
    above[0].set_yticks(ticks := [0.03, 0.1, 0.3, 1, 3, 10], [f"{tick:g}" for tick in ticks])
    below[0].set(ylabel=f"samples above\n{paper.TOLERANCE_M} m [%]", ylim=(0, 100))
    many = f"median (line) to 95th percentile of {_fields(by_name['RHE'])}, means over 1 s"
    figure.suptitle(many, fontsize=8)
    parts.legend_outside(figure, above[0], "lower center", 3)
    return figure


@styled
def violations(table):
    """Figure 9: samples on straight lines with an error above 0.12 m in a drive, by raw GNSS and in
    truth; a panel for each process noise.

    Args:
        table: as `rhec.workbench.studies.scenario_tables.scenario_b_table` returns it.
    """
    counts = table[table["quantity"].str.startswith("violations") & table["p5"].notna()]
    noises = list(counts.groupby("process_noise", sort=False))
    figure, panels = parts.panels_beside(len(noises), 1.9)
    for axes, (noise, rows) in zip(panels, noises):
        rows = rows.sort_values("estimator", ascending=False, kind="stable")
        for place, row in enumerate(rows.itertuples()):
            parts.interval_row(axes, place, row, COLOURS[row.estimator])
            if row.paper != "":
                look = dict(color=BLACK, markerfacecolor="none", markersize=5, clip_on=False)
                axes.plot(row.paper, place, "D", label="paper: 0 and 17", zorder=4, **look)
        labels = [f"{row.estimator}, {row.quantity.split(', ')[1]}" for row in rows.itertuples()]
        axes.set_xscale("symlog", linthresh=1, linscale=0.4)
        axes.set_xticks(ticks := [0, 1, 10, 100, 1000], ticks)
        axes.set(xlim=(0, 1200), title=f"{noise} process noise, {rows['n'].iloc[0]} fields")
        parts.rows_axis(axes, labels, "violations in a drive [samples], logarithmic above 1")
    handles, labels = axes.get_legend_handles_labels()
    place = dict(loc="outside lower center", title=_DOT_AND_LINES, title_fontsize=7)
    figure.legend(handles[:1], labels[:1], **place)
    return figure


@styled
def estimates(runs):
    """Figure 10: the RHE's yaw error, and its traction parameters with the truth and eq. (14).

    Bands are two standard deviations by the RHE's own covariance.

    Args:
        runs: {process noise: Run}, a column for each.
    """
    grid = dict(figsize=(DOUBLE_IN, 4.2), sharex=True, sharey="row", squeeze=False)
    figure, rows = plt.subplots(3, len(runs), **grid)
    for panels, run in zip(rows.T, runs.values()):
        entries = stated(run)
        t_s = run.log["t_s"]
        log = run.log
        for axes, name, symbol in zip(
            panels, entries, (r"$\hat\theta-\theta$", r"$\mu$", r"$\kappa$")
        ):
            value, sigma, truth, inside = entries[name]
            low = value - 2 * sigma
            high = value + 2 * sigma
            axes.fill_between(t_s, low, high, color=SKY, alpha=0.45, linewidth=0, label="± 2 σ")
            axes.plot(t_s, value, color=COLOURS["RHE"], linewidth=0.8, label="RHE")
            axes.plot(t_s, truth, color=COLOURS["truth"], linewidth=0.8, label="truth")
            axes.set_title(f"{symbol}: within ± 2 σ in {100 * inside:.0f} % of the samples")
        for axes in panels[1:]:
            axes.hlines([0, 1], *t_s.iloc[[0, -1]], label="constraints", **parts.BOUND)
        panels[0].set_title(f"{_about(run)}\n{panels[0].get_title(loc='left')}")
        _time_axis(panels, log)
    labels = ("yaw error [rad],\ncut at ± 0.3", "$\\mu$ [-],\ncut at 0.5", r"$\kappa$ [-]")
    limits = ((-0.3, 0.3), (0.5, 1.1), (-0.06, 1.1))
    for axes, label, limit in zip(rows[:, 0], labels, limits):
        axes.set(ylabel=label, ylim=limit)
    parts.legend_outside(figure, rows[1, 0], "lower center", 4)
    return figure


@styled
def speed(drives):
    """Figure 11: measured, estimated and true speed of the tracks ν over time."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.2))
    for column, name in [("nu_meas_mps", "measured"), ("nu_mps", "truth"), ("nu_hat_mps", "RHE")]:
        of_drives = over_fields(drives, column, _POOLED)
        t_s = drives[0].log["t_s"][: of_drives.shape[1] * _POOLED : _POOLED]
        parts.band(axes, t_s, of_drives, name, color=COLOURS[name])
    axes.axhline(drives[0].scenario.speed_mps, **parts.BOUND, label="reference")
    axes.set(ylabel=r"speed $\nu$ [m/s]", title=_over(drives))
    parts.legend_above(axes, **_TIGHT)
    _time_axis([axes], drives[0].log)
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
    # A command is held until the next sample, so it belongs to the yaw rate one row later.
    rms = np.sqrt(np.mean((actual.to_numpy()[1:] - commanded.to_numpy()[:-1]) ** 2))
    title = f"{_about(run)}: actual - reference, RMS {rms:.3f} rad/s"
    axes.set(ylabel=r"yaw rate $\omega$ [rad/s]", title=title)
    _time_axis([axes], run.log)
    return figure


@styled
def kkt(drives):
    """Figure 13: KKT tolerances of RHE and RHC after one Gauss-Newton iteration.

    Time is logarithmic, because the transient ends after two or three samples.
    """
    figure, panels = parts.panels_beside(2, 2.2)
    for axes, name in zip(panels, _KKT):
        tolerance = over_fields(drives, f"kkt_{name.lower()}")
        t_s = paper.DT_S * np.arange(1, tolerance.shape[1] + 1)
        colour = COLOURS[_KKT[name]]
        parts.band(axes, t_s, np.maximum(tolerance, _LEAST_KKT / 2), name, color=colour)
        largest_s = t_s[tolerance[1].argmax()]
        most = tolerance[1].max()
        title = f"{name}: largest median {most:.2g}, at {largest_s:.1f} s"
        axes.set(xscale="log", yscale="log", title=title, xlim=(t_s[0], t_s[-1]))
        axes.set_xlabel("time [s], logarithmic; the first sample is at 0.2 s")
        axes.minorticks_off()
    # The RHC's tolerance vanishes where every command is at its bound, hence the cut.
    panels[0].set(ylabel=f"KKT tolerance [-], cut at {_LEAST_KKT:g}", ylim=_LEAST_KKT)
    figure.suptitle(_over(drives), fontsize=8)
    return figure
