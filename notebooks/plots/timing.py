"""The paper's Figure 5: the order and the times of the phases."""

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator

from notebooks.plots.parts import BOUND, note
from rhec import paper
from rhec.style import (
    BLACK,
    BLUE,
    DOUBLE_IN,
    GREEN,
    GREY,
    ORANGE,
    SKY,
    SMALL_PT,
    VERMILLION,
    styled,
)

_COLOURS = {
    ("RHE", "preparation"): SKY,
    ("RHC", "preparation"): GREEN,
    ("RHE", "feedback"): BLUE,
    ("RHC", "feedback"): ORANGE,
}
_FEEDBACK = [("RHE", "feedback"), ("RHC", "feedback")]
# Begin and end of each phase in a period; the drawing is not to scale.
_PLACES = dict(zip(_COLOURS, ((0.52, 0.76), (0.76, 1.0), (0.0, 0.17), (0.17, 0.34))))
_COMMAND = _PLACES["RHC", "feedback"][1]


def _cycle(axes):
    """Draw two periods: feedback before the command, preparation before the next measurement."""
    for k, instant in enumerate(("$t_{k-1}$", "$t_k$", "$t_{k+1}$")):
        axes.axvline(k, **BOUND)
        note(axes, instant, (k, 1), (0, 5), ha="center", xycoords=("data", "axes fraction"))
    for k in (0, 1):
        for which, (begin, end) in _PLACES.items():
            problem, phase = which
            look = dict(color=_COLOURS[which], edgecolor=BLACK, linewidth=0.5)
            axes.barh(problem == "RHC", end - begin, 0.95, k + begin, **look)
            text = f"{problem}\n{'feedback' if phase == 'feedback' else 'prepare'}"
            ink = "w" if _COLOURS[which] in (BLUE, GREEN) else BLACK
            centre = dict(ha="center", color=ink, linespacing=0.95)
            note(axes, text, (k + (begin + end) / 2, problem == "RHC"), **centre)
        arrow = dict(arrowstyle="-|>", color=VERMILLION, shrinkA=0, shrinkB=0)
        index = ("{k-1}", "k")[k]
        for x, tip, foot, signal in [
            (k, -0.48, -1.25, f"$z_{index}$"),
            (k + _COMMAND, 2.15, 1.5, rf"$\omega_{index}$"),
        ]:
            axes.annotate("", (x, tip), (x, foot), arrowprops=arrow)
            note(axes, signal, (x, (tip + foot) / 2), (4, 0), color=VERMILLION, fontsize=8)
    axes.set(xlim=(-0.02, 2.02), ylim=(2.2, -1.3), yticks=[], xticks=[])
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    period = f"not to scale: a period lasts {1000 * paper.DT_S:.0f} ms"
    axes.set_title(period, fontsize=SMALL_PT, loc="right", pad=16)


@styled
def phases(times, machine):
    """Draw Figure 5: the phases in two sampling periods, and their times here and in the paper.

    Args:
        times: Rows with problem ("RHE", "RHC"), phase ("preparation", "feedback"), minimum_us,
            average_us, maximum_us.
        machine: Name of the machine of these times.
    """
    size = dict(figsize=(DOUBLE_IN, 3.6), height_ratios=(1, 1.3))
    figure, (cycle, axes) = plt.subplots(2, **size)
    _cycle(cycle)
    ours = times.set_index(["problem", "phase"])
    columns = ["minimum_us", "average_us", "maximum_us"]
    ours = {which: ours.loc[which, columns].to_list() for which in _COLOURS}
    papers = {which: [1000 * ms for ms in paper.TABLE_1_MS[which]] for which in _COLOURS}
    for reported, marker, colour, shift, label in [
        (ours, "o", BLUE, -0.13, f"here: {machine}"),
        (papers, "D", GREY, 0.13, "paper: Raspberry Pi 3 (another processor)"),
    ]:
        for place, (low, average, high) in enumerate(reported.values()):
            axes.plot([low, high], [place + shift] * 2, color=colour, linewidth=0.9)
            look = dict(color=colour, markersize=4, label=None if place else label)
            axes.plot(average, place + shift, marker, linestyle="none", **look)
        total = sum(reported[which][1] for which in _FEEDBACK)
        last = len(_COLOURS)
        axes.plot(total, last + shift, marker, color=colour, markersize=4)
        # One text above its marker and one below, for the two may be as long.
        note(axes, f"{total:.3g} µs", (total, last + shift), (5, -40 * shift))
    names = [" ".join(which) for which in _COLOURS]
    axes.set_yticks(range(len(names) + 1), [*names, "measurement to command"])
    axes.set(ylim=(len(names) + 0.8, -0.5))
    axes.set(xscale="log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.set_xlabel("time [µs], logarithmic; marker: average, line: minimum to maximum")
    axes.grid(axis="y", visible=False)
    figure.legend(loc="outside lower center", ncols=1)
    return figure
