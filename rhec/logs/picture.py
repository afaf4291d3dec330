"""The picture of a Summary: traction and yaw with their uncertainty over time, and the path."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, POSE, SIGMA
from rhec.style import BLACK, COLOURS, DOUBLE_IN, GREY, SKY, styled


def _broken(samples, *columns):
    """Columns as arrays with a NaN after each segment, which interrupts lines."""
    gap = np.full((1, len(columns)), np.nan)
    parts = [part[[*columns]].to_numpy(dtype=float) for _, part in samples.groupby("segment")]
    return np.concatenate([np.append(part, gap, axis=0) for part in parts]).T


@styled
def picture(summary):
    """Draw the Summary of a log.

    Args:
        summary: A Summary with estimates.
    """
    mosaic = [["path", "κ"], ["path", "μ"], ["path", "yaw"]]
    size = (DOUBLE_IN, 4.2)
    figure, panels = plt.subplot_mosaic(mosaic, figsize=size, width_ratios=(2, 3))
    for name, place in (("κ", 5), ("μ", 4)):
        _draw_traction(panels[name], summary, name, place)
    _draw_yaw(panels["yaw"], summary.comparison.samples, summary.samples)
    _draw_path(panels["path"], summary.samples)
    for name in ("κ", "μ"):
        panels[name].sharex(panels["yaw"])
        panels[name].tick_params(labelbottom=False)
    panels["yaw"].set_xlabel("t [s]")
    figure.legend(*panels["κ"].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return figure


def _draw_traction(axes, summary, name, place):
    """Draw κ or μ: on the way with its band, smoothed, and the regression over the whole log."""
    hat = ESTIMATE[place]
    t_s, value, sigma = _broken(summary.comparison.samples, "t_s", hat, SIGMA[place])
    low, high = np.clip([value - 2 * sigma, value + 2 * sigma], 0, 1)
    axes.fill_between(t_s, low, high, color=SKY, alpha=0.45, linewidth=0, label="± 2 σ")
    axes.plot(t_s, value, color=COLOURS["RHE"], linewidth=0.7, label="on the way")
    axes.plot(*_broken(summary.samples, "t_s", hat), color=BLACK, linewidth=0.7, label="smoothed")
    mean = summary.traction.loc[name, "value"]
    axes.axhline(mean, color=GREY, linestyle="--", linewidth=0.7, label="regression")
    axes.set(ylim=(0, 1.05), ylabel=f"{name} [-]")


def _draw_yaw(axes, causal, smoothed):
    """Draw the yaw on the way minus the smoothed one, and the true one if the log has it."""
    yaw = ESTIMATE[2]
    t_s, sigma = _broken(causal, "t_s", SIGMA[2])
    limit = 2 * sigma
    axes.fill_between(t_s, -limit, limit, color=SKY, alpha=0.45, linewidth=0)
    apart = {"on the way": (causal[yaw], COLOURS["RHE"])}
    if POSE[2] in smoothed:
        apart["truth"] = (smoothed[POSE[2]], COLOURS["Q1"])
    for name, (value, colour) in apart.items():
        error = (value - smoothed[yaw] + np.pi) % (2 * np.pi) - np.pi
        _, error = _broken(smoothed.assign(error=error), "t_s", "error")
        axes.plot(t_s, error, color=colour, linewidth=0.7, label=name)
    extent = np.clip(1.5 * np.nanquantile(limit, 0.95), 0.1, np.pi)
    axes.set(ylim=(-extent, extent), ylabel="yaw - smoothed [rad]")
    axes.legend(ncols=2)


def _draw_path(axes, samples):
    """Draw the measured positions and the smoothed path."""
    look = dict(marker=".", linestyle="none", markersize=1.5, color=COLOURS["measured"])
    axes.plot(samples[MEASUREMENTS[0]], samples[MEASUREMENTS[1]], **look, label="measured")
    axes.plot(*_broken(samples, *ESTIMATE[:2]), color=BLACK, linewidth=0.7, label="smoothed")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", adjustable="datalim")
    axes.legend()
