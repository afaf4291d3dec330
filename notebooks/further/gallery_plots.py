"""Pictures of the gallery: states beside commands, or estimates beside their errors."""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.plots.parts import BOUND, in_words
from rhec.core.controller.bounds import Bound
from rhec.style import COLOURS, DOUBLE_IN, styled


@styled
def controlled(problem, drive, states=None, time="time [s]"):
    """Draw states and commands of a ControlProblem's Drive over time.

    Of the named states the bounds are drawn, too; without names all states are drawn.
    """
    model = problem.options["model"]
    times = problem.options["dt"] * np.arange(len(drive.x))
    figure, (above, below) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.0))
    bounds = problem.options["bounds"]
    for name, values in zip(model.states, drive.x.T):
        if states is None or name in states:
            above.plot(times, values, label=in_words(name))
        for bound in _limits(bounds.get(name)) if states and name in states else ():
            above.axhline(bound, **BOUND)
    for name, commands in zip(model.inputs, drive.u.T):
        below.step(times[:-1], commands, where="post", label=in_words(name))
        for bound in _limits(bounds.get(name)):
            below.axhline(bound, **BOUND)
    for axes, title in ((above, "states"), (below, "commands")):
        axes.set(xlabel=time, title=title)
        axes.legend()
    return figure


def _limits(bound):
    """The finite numbers of a bound, which may be a pair, a rhec.Bound or None."""
    if isinstance(bound, Bound):
        bound = bound.lowest, bound.highest
    return [number for number in bound or () if np.isfinite(number)]


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
    """Draw one state of an EstimationProblem's Record, its estimate and the estimate's error."""
    model = problem.options["model"]
    time_s = problem.options["dt"] * np.arange(len(record.x))
    figure, (above, below) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.0))
    above.plot(time_s, record.x[:, state], color=COLOURS["truth"], label="truth")
    above.plot(time_s, record.x_hat[:, state], "--", color=COLOURS["RHE"], label="RHE")
    above.set(xlabel="time [s]", title=in_words(model.states[state]))
    above.legend()
    if model.parameters:
        shown = record.p_hat[:, 0]
        wanted = problem.p[0]
        (title,) = map(in_words, model.parameters)
    else:
        shown = (record.x_hat - record.x)[:, state]
        wanted = 0.0
        title = f"error of {in_words(model.states[state])}"
    below.axhline(wanted, color=COLOURS["truth"], linewidth=0.6)
    below.plot(time_s, shown, color=COLOURS["RHE"])
    below.set(xlabel="time [s]", title=title)
    return figure
