"""Pictures and a table of any robot in closed loop.

`log` is {name: array with a row a sample}, as the loop of `your_robot.ipynb` keeps it: true poses
x, measurements z, commands u, estimates x_hat and p_hat, their standard deviations sigma, and the
true slips.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from notebooks.plots.parts import legend_outside, panels_beside
from rhec.style import BLUE, COLOURS, DOUBLE_IN, VERMILLION, styled

_BOUND = dict(color=VERMILLION, linestyle=":")


@styled
def positions(tracks):
    """Draw {"reference", "truth", "measured" or "RHE": (n, 2) positions [m]} in the plane."""
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 2.4))
    looks = dict(measured=dict(linestyle="none", marker=".", markersize=2, zorder=1))
    looks["reference"] = dict(linestyle="--")
    for name, track in tracks.items():
        axes.plot(*np.transpose(track), label=name, color=COLOURS[name], **looks.get(name, {}))
    axes.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    legend_outside(figure, axes, "lower center", 4)
    return figure


@styled
def parameters_and_bounds(time_s, estimates, sigmas, truth, bounds):
    """Draw estimated parameters with two standard deviations within the bounds, and the truth.

    All but the bounds, {name: (lowest, highest) or None}, are arrays (n, n_p).
    """
    figure, panels = panels_beside(len(bounds), 2.2)
    columns = (np.transpose(values) for values in (estimates, sigmas, truth))
    for axes, name, middle, sigma, true in zip(panels, bounds, *columns):
        limits = bounds[name] or ()
        band = np.clip([middle - 2 * sigma, middle + 2 * sigma], *limits or (-np.inf, np.inf))
        axes.fill_between(time_s, *band, color=BLUE, alpha=0.2, linewidth=0, label="2 σ")
        axes.plot(time_s, true, color=COLOURS["truth"], label="truth")
        axes.plot(time_s, middle, color=COLOURS["RHE"], label="RHE")
        for limit in limits:
            axes.axhline(limit, label="bounds", **_BOUND)
        axes.set(xlabel="time [s]", title=name)
    panels[0].set_ylabel("parameter [-]")
    # The two bounds share one legend entry.
    handles, labels = panels[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles))
    figure.legend(unique.values(), unique.keys(), loc="outside right center")
    return figure


@styled
def commands_and_bounds(time_s, commands, bounds):
    """Draw commands (n, n_u) over time, and their bounds {name: (lowest, highest)}."""
    figure, panels = panels_beside(len(bounds), 1.8)
    for axes, name, command in zip(panels, bounds, np.transpose(commands)):
        axes.step(time_s, command, where="post", color=BLUE)
        for limit in bounds[name]:
            axes.axhline(limit, **_BOUND)
        axes.set(xlabel="time [s]", title=name)
    panels[0].set_ylabel("command, bounds dotted")
    return figure


def positions_of(log, path):
    """{name: (n, 2) positions [m]} of a drive: measured, reference, truth and RHE."""
    _, s_m = path.project(log["x"][:, :2])
    reference, _ = path.poses(np.linspace(0, s_m.max(), len(log["x"])))
    poses = dict(measured=log["z"], reference=reference, truth=log["x"], RHE=log["x_hat"])
    return {name: values[:, :2] for name, values in poses.items()}


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
