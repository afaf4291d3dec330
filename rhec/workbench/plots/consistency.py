"""Consistency of estimators: NEES over time, and RMS errors over stated standard deviations.

`measured` is {estimator: Consistency}. Estimators without an assigned colour are grey.
"""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots.parts import log_axis
from rhec.workbench.plots.style import BLACK, COLOURS, COLUMN_IN, DOUBLE_IN, GREY, ORANGE, styled
from rhec.workbench.studies import consistency

_COLOURS = {"yaw-drift": ORANGE} | {kind: COLOURS[kind] for kind in ("EKF", "RHE", "oracle")}
_SYMBOLS = {"θ": r"$\theta$", "ν": r"$\nu$", "μ": r"$\mu$", "κ": r"$\kappa$"}


@styled
def nees_over_time(measured):
    """Draw the mean NEES of runs over its degrees of freedom, with 95 % χ² bounds, over time."""
    rows = -(-len(measured) // 2)
    size = (DOUBLE_IN, 0.3 + 0.95 * rows)
    figure, panels = plt.subplots(rows, 2, figsize=size, sharex=True, sharey=True, squeeze=False)
    for axes, (name, result) in zip(panels.flat, measured.items()):
        degrees = len(result.states)
        runs = len(result.nees)
        bounds = consistency.bounds(runs, degrees)
        axes.axhspan(*bounds, color=COLOURS["tolerance"], alpha=0.5, linewidth=0)
        colour = next((colour for kind, colour in _COLOURS.items() if kind in name), GREY)
        axes.semilogy(result.t_s, result.nees.mean(axis=0) / degrees, color=colour, linewidth=0.6)
        (_, values, _), *_ = consistency.normalised(result)
        inside = consistency.share_inside(values, degrees)
        axes.set(title=f"{name}: {100 * inside:.0f} % inside", xlim=(0, result.t_s[-1]))
        log_axis(axes.yaxis)
    for axes in panels.flat[len(measured) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
    figure.supylabel(f"mean NEES of {runs} runs / degrees of freedom", fontsize=8)
    return figure


@styled
def errors_over_sigma(measured):
    """Draw RMS error over standard deviation: 1 is consistent, larger is overconfident."""
    figure, axes = plt.subplots(figsize=(COLUMN_IN, 0.32 * len(measured) + 0.7))
    states = consistency.STATES
    ratios = np.full((len(measured), len(states)), np.nan)
    for row, result in zip(ratios, measured.values()):
        row[: len(result.states)] = np.sqrt(consistency.mean_square_errors(result).mean(axis=0))
    axes.imshow(np.log2(ratios), cmap="PuOr_r", vmin=-2.5, vmax=2.5, aspect="auto")
    for (row, column), ratio in np.ndenumerate(ratios):
        text = "–" if np.isnan(ratio) else f"{ratio:.2f}"
        look = dict(ha="center", va="center", fontsize=7)
        axes.text(column, row, text, color="w" if abs(np.log2(ratio)) > 1.7 else BLACK, **look)
    axes.set_xticks(range(len(states)), [_SYMBOLS.get(state, f"${state}$") for state in states])
    axes.set_yticks(range(len(measured)), measured)
    axes.grid(visible=False)
    axes.set_title("RMS error / standard deviation")
    return figure
