"""Pictures of the gallery: states beside commands, or estimates beside their errors."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots.parts import BOUND
from rhec.workbench.plots.style import COLOURS, DOUBLE_IN, styled


@styled
def controlled(problem, drive):
    """Draw states and commands of a closed loop over time.

    Args:
        problem: A `rhec.workbench.studies.gallery.ControlProblem`.
        drive: Its Drive.
    """
    model = problem.options["model"]
    time_s = problem.options["dt"] * np.arange(len(drive.x))
    figure, (above, below) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.0))
    for name, states in zip(model.states, drive.x.T):
        above.plot(time_s, states, label=name)
    for name, commands in zip(model.inputs, drive.u.T):
        below.step(time_s[:-1], commands, where="post", label=name)
        for bound in problem.options["bounds"].get(name, ()):
            below.axhline(bound, **BOUND)
    for axes, title in ((above, "states"), (below, "commands")):
        axes.set(xlabel="time [s]", title=title)
        axes.legend(fontsize="x-small")
    return figure


@styled
def estimated(problem, record, state=0):
    """Draw one state as it is, as estimated and the estimate's error; the truth in black.

    Args:
        problem: A `rhec.workbench.studies.gallery.EstimationProblem`.
        record: Its Record.
        state: Place of the state.
    """
    model = problem.options["model"]
    time_s = problem.options["dt"] * np.arange(len(record.x))
    figure, (above, below) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.0))
    above.plot(time_s, record.x[:, state], color=COLOURS["truth"], label="truth")
    above.plot(time_s, record.x_hat[:, state], "--", color=COLOURS["RHE"], label="RHE")
    above.set(xlabel="time [s]", title=model.states[state])
    above.legend(fontsize="x-small")
    if model.parameters:
        shown = record.p_hat[:, 0]
        wanted = problem.p[0]
        (title,) = model.parameters
    else:
        shown = (record.x_hat - record.x)[:, state]
        wanted = 0.0
        title = f"error of {model.states[state]}"
    below.axhline(wanted, color=COLOURS["truth"], linewidth=0.6)
    below.plot(time_s, shown, color=COLOURS["RHE"])
    below.set(xlabel="time [s]", title=title)
    return figure
