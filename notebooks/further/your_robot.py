"""Pictures and a table of any robot in closed loop.

`log` is {name: array with a row a sample}, as the loop of `your_robot.ipynb` keeps it: true poses
x, measurements z, commands u, estimates x_hat and p_hat, their standard deviations sigma, and the
true slips.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from notebooks.plots.parts import BOUND, legend_outside
from rhec.style import BLUE, COLOURS, DOUBLE_IN, styled


@styled
def positions(log, path):
    """Draw the positions of a drive in the plane: measured, reference, truth and RHE."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.4))
    _, s_m = path.project(log["x"][:, :2])
    reference, _ = path.poses(np.linspace(0, s_m.max(), len(log["x"])))
    for name, poses, look in (
        ("measured", log["z"], dict(linestyle="none", marker=".", markersize=2, zorder=1)),
        ("reference", reference, dict(linestyle="--")),
        ("truth", log["x"], {}),
        ("RHE", log["x_hat"], {}),
    ):
        axes.plot(*poses[:, :2].T, label=name, color=COLOURS[name], **look)
    axes.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    legend_outside(figure, axes, "lower center")
    return figure


@styled
def parameters_and_commands(time_s, log, parameters, commands):
    """Draw estimated parameters with two standard deviations, the truth, and commands.

    Args:
        time_s: Times of the samples.
        log: The log.
        parameters: {name: (lowest, highest) or None} of the parameters, the last of the states.
        commands: The same of the commands.
    """
    grid = dict(sharex=True, sharey="row", squeeze=False)
    figure, panels = plt.subplots(2, len(parameters), figsize=(DOUBLE_IN, 3.8), **grid)
    sigmas = log["sigma"][:, -len(parameters) :]
    for k, (axes, name) in enumerate(zip(panels[0], parameters)):
        middle = log["p_hat"][:, k]
        ends = (middle - 2 * sigmas[:, k], middle + 2 * sigmas[:, k])
        lowest, highest = parameters[name] or (-np.inf, np.inf)
        band = np.clip(ends, lowest, highest)
        axes.fill_between(time_s, *band, color=BLUE, alpha=0.2, linewidth=0, label="2 σ")
        axes.plot(time_s, log["slips"][:, k], color=COLOURS["truth"], label="truth")
        axes.plot(time_s, middle, color=COLOURS["RHE"], label="RHE")
    for axes, command in zip(panels[1], log["u"].T):
        axes.step(time_s, command, where="post", color=COLOURS["RHE"])
    for row, bounds in zip(panels, (parameters, commands)):
        for axes, name in zip(row, bounds):
            for limit in bounds[name] or ():
                axes.axhline(limit, **BOUND)
            axes.set_title(name)
    panels[0, 0].set_ylabel("parameter [-]")
    panels[1, 0].set_ylabel("command [m/s]")
    figure.supxlabel("time [s]  (dashed: bounds)", fontsize=8)
    legend_outside(figure, panels[0, 0], "upper center")
    return figure


def errors(log, path, v_max_mps):
    """Mean errors in the second half of each half of a drive, once the slips have converged."""
    samples = len(log["x"])
    late = (np.arange(samples) % (samples // 2)) >= samples // 4
    left_m, _ = path.project(log["x"][:, :2])
    distance_m = np.abs(left_m)
    slip_error = np.abs(log["p_hat"] - log["slips"])
    position_error_m = np.linalg.norm((log["x"] - log["x_hat"])[late, :2], axis=1)
    at_bound = np.isin(log["u"], [0.0, v_max_mps]).any(axis=1)
    values = {
        "mean distance from the path [m]": distance_m[late].mean(),
        "mean error of the estimated position [m]": position_error_m.mean(),
        "mean error of slip_left": slip_error[late, 0].mean(),
        "mean error of slip_right": slip_error[late, 1].mean(),
        "share of commands at a bound": at_bound.mean(),
    }
    return pd.DataFrame(dict(quantity=[*values], value=[*values.values()]))
