"""Overviews of a run and of a recorded log, as shown by `Run.plot` and `Summary.plot`."""

import matplotlib.pyplot as plt
import numpy as np

from rhec import paper
from rhec.style import BLACK, COLOURS, DOUBLE_IN, GREY, SKY, styled


@styled
def overview(run, sigma):
    """Draw path and robot, errors over time, and the traction with two standard deviations.

    Args:
        run: A Run.
        sigma: {"mu", "kappa": standard deviations (n,)} of the estimates, which are not in the
            log; what is missing has no band.
    """
    ratios = dict(height_ratios=(3, 2, 1.5, 1.5))
    figure, panels = plt.subplots(4, figsize=(DOUBLE_IN, 7), gridspec_kw=ratios)
    _draw_map(panels[0], run)
    _draw_errors(panels[1], run)
    for axes, name, symbol in zip(panels[2:], ("mu", "kappa"), ("μ", "κ")):
        _draw_traction(axes, run, name, sigma.get(name))
        axes.set_ylabel(f"{symbol} [-]")
    panels[-1].set_xlabel("t [s]")
    return figure


def _draw_map(axes, run):
    points, _ = run.path.poses(np.arange(0, run.path.length_m, 0.1))
    axes.plot(points[:, 0], points[:, 1], color=COLOURS["reference"], label="path")
    axes.plot(run.columns["x_m"], run.columns["y_m"], color=COLOURS["truth"], label="robot")
    mean_m = run.metrics["mean_error_m"]
    title = f"{run.scenario.duration_s:g} s, mean error {mean_m:.3f} m by GNSS"
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title=title)
    axes.legend(ncols=2)


def _draw_errors(axes, run):
    t_s = run.columns["t_s"]
    axes.plot(t_s, run.columns["error_m"], color=COLOURS["measured"], label="by GNSS")
    axes.plot(t_s, run.columns["error_true_m"], color=COLOURS["truth"], label="true")
    axes.axhline(paper.TOLERANCE_M, color=COLOURS["tolerance"], label="tolerance")
    # The large error at the start would hide the rest.
    axes.set(ylabel="error [m]", ylim=(0, 3 * paper.TOLERANCE_M))
    axes.legend(ncols=3)


def _draw_traction(axes, run, name, sigma):
    t_s = run.columns["t_s"]
    estimate = run.columns[f"{name}_hat"]
    if sigma is not None:
        low = estimate - 2 * sigma
        high = estimate + 2 * sigma
        axes.fill_between(t_s, low, high, color=SKY, alpha=0.45, linewidth=0, label="± 2 σ")
    axes.plot(t_s, run.columns[name], color=COLOURS["truth"], label="true")
    axes.plot(t_s, estimate, color=COLOURS["RHE"], label="estimated")
    # Neither a few wild estimates nor a wide band shall hide how the traction changes.
    shown = np.concatenate([run.columns[name], estimate[np.isfinite(estimate)]])
    low, high = np.percentile(shown, (0.5, 99.5))
    margin = 0.1 * (high - low) + 0.01
    axes.set_ylim(low - margin, high + margin)
    axes.legend(ncols=3)


# A recorded log


@styled
def log_overview(summary):
    """Draw traction and yaw of a log with two standard deviations over time, and the path.

    Args:
        summary: A Summary with estimates, as `rhec.log` returns it.
    """
    mosaic = [["path", "κ"], ["path", "μ"], ["path", "yaw"]]
    size = (DOUBLE_IN, 4.2)
    figure, panels = plt.subplot_mosaic(mosaic, figsize=size, width_ratios=(2, 3))
    for symbol, name in (("κ", "kappa"), ("μ", "mu")):
        _draw_traction_of_log(panels[symbol], summary, symbol, name)
    _draw_yaw(panels["yaw"], summary.way, summary.samples)
    _draw_path(panels["path"], summary.samples)
    for symbol in ("κ", "μ"):
        panels[symbol].sharex(panels["yaw"])
        panels[symbol].tick_params(labelbottom=False)
    panels["yaw"].set_xlabel("t [s]")
    handles = {}
    for symbol in ("κ", "yaw"):
        lines, names = panels[symbol].get_legend_handles_labels()
        handles |= dict(zip(names, lines))
    figure.legend(handles.values(), handles, loc="outside upper right", ncols=3)
    return figure


def _broken(samples, *columns):
    """Columns as arrays with a NaN after each segment, which interrupts lines."""
    gap = np.full((1, len(columns)), np.nan)
    parts = [part[[*columns]].to_numpy(dtype=float) for _, part in samples.groupby("segment")]
    return np.concatenate([np.append(part, gap, axis=0) for part in parts]).T


def _draw_traction_of_log(axes, summary, symbol, name):
    """Draw κ or μ: on the way with its band, smoothed, and the regression over the whole log."""
    hat = f"{name}_hat"
    t_s, value, sigma = _broken(summary.way, "t_s", hat, f"sigma_{name}")
    low, high = np.clip([value - 2 * sigma, value + 2 * sigma], 0, 1)
    axes.fill_between(t_s, low, high, color=SKY, alpha=0.45, linewidth=0, label="± 2 σ")
    axes.plot(t_s, value, color=COLOURS["RHE"], linewidth=0.7, label="on the way")
    axes.plot(*_broken(summary.samples, "t_s", hat), color=BLACK, linewidth=0.7, label="smoothed")
    mean = summary.traction.loc[symbol, "value"]
    axes.axhline(mean, color=GREY, linestyle="--", linewidth=0.7, label="regression")
    axes.set(ylim=(0, 1.05), ylabel=f"{symbol} [-]")


def _draw_yaw(axes, causal, smoothed):
    """Draw the yaw on the way minus the smoothed one, and the true one if the log has it."""
    yaw = "theta_hat_rad"
    t_s, sigma = _broken(causal, "t_s", "sigma_theta_rad")
    limit = 2 * sigma
    axes.fill_between(t_s, -limit, limit, color=SKY, alpha=0.45, linewidth=0)
    apart = {"on the way": (causal[yaw], COLOURS["RHE"])}
    if "theta_rad" in smoothed:
        apart["truth"] = (smoothed["theta_rad"], COLOURS["Q1"])
    for name, (value, colour) in apart.items():
        error = (value - smoothed[yaw] + np.pi) % (2 * np.pi) - np.pi
        _, error = _broken(smoothed.assign(error=error), "t_s", "error")
        axes.plot(t_s, error, color=colour, linewidth=0.7, label=name)
    extent = np.clip(1.5 * np.nanquantile(limit, 0.95), 0.1, np.pi)
    axes.set(ylim=(-extent, extent), ylabel="yaw − smoothed\n[rad]")


def _draw_path(axes, samples):
    """Draw the measured positions and the smoothed path."""
    look = dict(marker=".", linestyle="none", markersize=1.5, color=COLOURS["measured"])
    axes.plot(samples["x_meas_m"], samples["y_meas_m"], **look, label="measured")
    axes.plot(*_broken(samples, "x_hat_m", "y_hat_m"), color=BLACK, linewidth=0.7, label="smoothed")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", adjustable="datalim")
    axes.legend()
