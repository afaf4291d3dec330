"""Pictures of the gallery: states beside commands, or estimates beside their errors."""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.plots.parts import BOUND, in_words, legend_outside, panels_apart
from rhec.core.controller.bounds import Bound
from rhec.style import COLOURS, DOUBLE_IN, styled

_SOFT = BOUND | dict(linestyle=":")
_STILL = 0.01  # share of a signal's range within which it counts as settled


@styled
def controlled(problem, drive, states=None, time="time [s]"):
    """Draw states and commands of a ControlProblem's Drive over time, until they have settled.

    Each command has a panel of its own, because their units differ. Of the named states the bounds
    are drawn, too; without names all states are drawn.
    """
    model = problem.options["model"]
    bounds = problem.options["bounds"]
    times = problem.options["dt"] * np.arange(len(drive.x))
    layout = [["states", name] for name in model.inputs]
    figure, panels = plt.subplot_mosaic(layout, figsize=(DOUBLE_IN, 2.4), sharex=True)
    for name, values in zip(model.states, drive.x.T):
        if states is None or name in states:
            panels["states"].plot(times, values, label=in_words(name))
    for name in states or ():
        _draw_bound(panels["states"], bounds.get(name))
    for name, commands in zip(model.inputs, drive.u.T):
        axes = panels[name]
        axes.step(times[:-1], commands, where="post", color=COLOURS["RHE"])
        _draw_bound(axes, bounds.get(name))
        axes.set_title(f"command: {in_words(name)}")
    panels["states"].set(title="states", xlabel=time)
    panels[model.inputs[-1]].set(xlabel=time, xlim=(0, _until(times, drive)))
    legend_outside(figure, panels["states"], "lower center", 4)
    return figure


def _until(times, drive):
    """The end of a time axis: half as long again as until all signals have settled."""
    signals = np.column_stack([drive.x[:-1], drive.u])
    moving = np.abs(signals - signals[-1]) > _STILL * np.ptp(signals, axis=0)
    last = np.flatnonzero(moving.any(axis=1))[-1]
    return min(1.5 * times[last], times[-1])


def _draw_bound(axes, bound):
    """Draw the finite ends of a bound, which may be a pair, a rhec.Bound or None."""
    is_soft = isinstance(bound, Bound) and bound.is_soft
    ends = (bound.lowest, bound.highest) if isinstance(bound, Bound) else bound or ()
    look = _SOFT if is_soft else BOUND
    label = "soft bound: may be passed, at a price" if is_soft else "bound"
    for end in filter(np.isfinite, ends):
        axes.axhline(end, label=label, **look)
        label = None  # both ends share one entry of the legend


@styled
def around_the_obstacle(problem, drive):
    """Draw the path of the obstacle's unicycle, and its distance from the obstacle over time."""
    least = problem.options["bounds"]["distance_m"][0]
    figure, (plane, below) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.4))
    plane.add_patch(plt.Circle((0.5, 0.5), least, color="0.85"))
    plane.plot(*drive.x[:, :2].T, ".-", markersize=3, color=COLOURS["RHE"])
    plane.plot(*problem.goal[:2], "x", color=COLOURS["truth"])
    plane.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    time_s = problem.options["dt"] * np.arange(len(drive.x))
    below.plot(time_s, np.hypot(*(drive.x[:, :2] - 0.5).T), color=COLOURS["RHE"])
    below.axhline(least, **BOUND)
    below.set(xlabel="time [s]", title="distance from the obstacle's centre [m]")
    return figure


@styled
def estimated(problem, record, state=0):
    """Draw one state of an EstimationProblem's Record and its estimate, the estimate's error, and
    the first parameter, if there is one.
    """
    model = problem.options["model"]
    time_s = problem.options["dt"] * np.arange(len(record.x))
    name = in_words(model.states[state])
    figure, panels = panels_apart(3 if model.parameters else 2, 2.2)
    panels[0].plot(time_s, record.x[:, state], color=COLOURS["truth"], label="truth")
    panels[0].plot(time_s, record.x_hat[:, state], "--", color=COLOURS["RHE"], label="RHE")
    panels[0].set_title(name)
    error = (record.x_hat - record.x)[:, state]
    drawn = [(error, 0.0, f"error of {name}")]
    if model.parameters:
        drawn.append((record.p_hat[:, 0], problem.p[0], in_words(*model.parameters)))
    for axes, (shown, wanted, title) in zip(panels[1:], drawn):
        axes.axhline(wanted, color=COLOURS["truth"], linewidth=0.6)
        axes.plot(time_s, shown, color=COLOURS["RHE"])
        axes.set_title(title)
    for axes in panels:
        axes.set_xlabel("time [s]")
    legend_outside(figure, panels[0], "lower center", 2)
    return figure
