"""Any robot in closed loop: its track, estimated parameters, commands, and solver tolerances."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots.parts import panels_beside
from rhec.workbench.plots.style import BLUE, COLOURS, DOUBLE_IN, VERMILLION, styled

_BOUND = dict(color=VERMILLION, linestyle=":")


@styled
def positions(tracks):
    """Positions in the plane; measured ones are dots.

    Args:
        tracks: Name of each track, "reference", "truth", "measured" or "RHE": (n, 2) positions [m].
    """
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 1.9))
    looks = dict(measured=dict(linestyle="none", marker=".", markersize=2, zorder=1))
    looks["reference"] = dict(linestyle="--")
    for name, track in tracks.items():
        axes.plot(*np.transpose(track), label=name, color=COLOURS[name], **looks.get(name, {}))
    axes.set(aspect="equal", xlabel="$x$ [m]", ylabel="$y$ [m]")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


@styled
def parameters_and_bounds(time_s, estimates, sigmas, truth, bounds):
    """Estimated parameters over time with two standard deviations, the truth, and the bounds, at
    which the band ends; one axes a parameter.

    Args:
        time_s: (n,) times [s].
        estimates: (n, n_p) estimates.
        sigmas: (n, n_p) their standard deviations, bounds left aside.
        truth: (n, n_p) true values.
        bounds: Name of each parameter: (lowest, highest), or None; as in `rhec.Model`.
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
    # The two bounds share one entry.
    handles, labels = panels[0].get_legend_handles_labels()
    unique = dict(zip(labels, handles))
    figure.legend(unique.values(), unique.keys(), loc="outside right center")
    return figure


@styled
def commands_and_bounds(time_s, commands, bounds):
    """Commands over time between their bounds, one axes a command.

    Args:
        time_s: (n,) times [s].
        commands: (n, n_u) commands.
        bounds: Name of each command: (lowest, highest); as in `rhec.RHC`.
    """
    figure, panels = panels_beside(len(bounds), 1.8)
    for axes, name, command in zip(panels, bounds, np.transpose(commands)):
        axes.step(time_s, command, where="post", color=BLUE)
        for limit in bounds[name]:
            axes.axhline(limit, **_BOUND)
        axes.set(xlabel="time [s]", title=name)
    panels[0].set_ylabel("command, bounds dotted")
    return figure


@styled
def solver_tolerances(time_s, tolerances, iterated):
    """KKT tolerances on logarithmic axes: over time, and over iterations of one problem.

    Args:
        time_s: (n,) times [s].
        tolerances: Name of each solver: (n,) KKT tolerances.
        iterated: Name of each solver: its KKT tolerances, iteration by iteration.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2), width_ratios=(2, 1))
    for name, colour in zip(tolerances, (BLUE, VERMILLION)):
        left.semilogy(time_s, tolerances[name], color=colour, label=name, linewidth=0.7)
        steps = range(1, len(iterated[name]) + 1)
        right.semilogy(steps, iterated[name], ".-", color=colour, label=name)
    left.set(xlabel="time [s]", ylabel="KKT tolerance")
    right.set_xlabel("iteration, last sample")
    right.legend()
    return figure
