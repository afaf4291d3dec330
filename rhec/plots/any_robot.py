"""Pictures of any robot in closed loop: where it was, what was estimated, commanded, and solved."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.plots.style import BLUE, COLOURS, DOUBLE_IN, VERMILLION, styled

__all__ = ["commands_and_bounds", "parameters_and_bounds", "positions", "solver_tolerances"]

_LINES = {"reference": "--", "truth": "-"}


@styled
def positions(tracks):
    """Positions in the plane.

    Args:
        tracks: Name of each track, "reference", "truth", "measured" or "RHE": (n, 2) positions [m].

    Returns:
        The figure; "measured" is drawn as dots.
    """
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 1.9))
    for name, track in tracks.items():
        x, y = np.asarray(track).T
        look = dict(label=name, color=COLOURS[name])
        if name == "measured":
            axes.plot(x, y, ".", markersize=2, zorder=1, **look)
        else:
            axes.plot(x, y, _LINES.get(name, "-"), **look)
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


@styled
def parameters_and_bounds(time_s, estimates, sigmas, truth, bounds):
    """Estimated parameters over time with two standard deviations, the truth, and the bounds.

    Args:
        time_s: (n,) times [s].
        estimates: (n, n_p) estimates.
        sigmas: (n, n_p) their standard deviations, bounds left aside.
        truth: (n, n_p) true values.
        bounds: Name of each parameter: (lowest, highest), or None; as in `rhec.Model`.

    Returns:
        The figure, one axes a parameter. The band ends at the bounds.
    """
    figure, grid = plt.subplots(
        1, len(bounds), figsize=(DOUBLE_IN, 2.2), sharey=True, squeeze=False
    )
    for i, (axes, (name, limits)) in enumerate(zip(grid[0], bounds.items())):
        middle, width = np.asarray(estimates)[:, i], 2 * np.asarray(sigmas)[:, i]
        low, high = (-np.inf, np.inf) if limits is None else limits
        band = np.clip([middle - width, middle + width], low, high)
        axes.fill_between(time_s, *band, color=BLUE, alpha=0.2, linewidth=0, label="2 σ")
        axes.plot(time_s, np.asarray(truth)[:, i], color=COLOURS["truth"], label="truth")
        axes.plot(time_s, middle, color=COLOURS["RHE"], label="RHE")
        for limit in limits or ():
            axes.axhline(limit, color=VERMILLION, linestyle=":", label="bounds")
        axes.set_title(name)
        axes.set_xlabel("time [s]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    unique = dict(zip(labels, handles))
    figure.legend(unique.values(), unique.keys(), loc="outside right center")
    return figure


@styled
def commands_and_bounds(time_s, commands, bounds):
    """Commands over time between their bounds.

    Args:
        time_s: (n,) times [s].
        commands: (n, n_u) commands.
        bounds: Name of each command: (lowest, highest); as in `rhec.RHC`.

    Returns:
        The figure, one axes a command.
    """
    figure, grid = plt.subplots(
        1, len(bounds), figsize=(DOUBLE_IN, 1.8), sharey=True, squeeze=False
    )
    for i, (axes, (name, limits)) in enumerate(zip(grid[0], bounds.items())):
        axes.step(time_s, np.asarray(commands)[:, i], where="post", color=BLUE)
        for limit in limits:
            axes.axhline(limit, color=VERMILLION, linestyle=":")
        axes.set_title(name)
        axes.set_xlabel("time [s]")
    grid[0, 0].set_ylabel("command, bounds dotted")
    return figure


@styled
def solver_tolerances(time_s, tolerances, iterated):
    """KKT tolerances on logarithmic axes: over time, and over iterations of one problem.

    Args:
        time_s: (n,) times [s].
        tolerances: Name of each solver: (n,) KKT tolerances.
        iterated: Name of each solver: its KKT tolerances, iteration by iteration.

    Returns:
        The figure.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2), width_ratios=(2, 1))
    for name, colour in zip(tolerances, (BLUE, VERMILLION)):
        left.semilogy(time_s, tolerances[name], color=colour, label=name, linewidth=0.7)
        steps = range(1, len(iterated[name]) + 1)
        right.semilogy(steps, iterated[name], ".-", color=colour, label=name)
    left.set_xlabel("time [s]")
    left.set_ylabel("KKT tolerance")
    right.set_xlabel("iteration, last sample")
    right.legend()
    return figure
