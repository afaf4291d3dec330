"""Overview of one run, as shown by `Run.plot`."""

import matplotlib.pyplot as plt
import numpy as np

from rhec import paper
from rhec.style import COLOURS, DOUBLE_IN, SKY, styled


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
