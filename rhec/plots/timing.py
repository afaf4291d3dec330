"""The paper's Figure 5: which phase runs when, to the scale of measured times, here and in C."""

import matplotlib.pyplot as plt

from rhec import paper
from rhec.plots.parts import BOUND, note
from rhec.plots.style import BLACK, BLUE, COLUMN_IN, GREEN, ORANGE, SKY, VERMILLION, styled

__all__ = ["embedded_times", "phases"]

_PHASE_COLOURS = {"preparation": SKY, "feedback": BLUE}
_COLOURS = {
    ("RHE", "preparation"): SKY,
    ("RHC", "preparation"): GREEN,
    ("RHE", "feedback"): BLUE,
    ("RHC", "feedback"): ORANGE,
}
_NOW = BOUND | dict(zorder=0)
_SINCE = "time since the sampling instant $t_k$"


@styled
def phases(times):
    """Figure 5: mean times of preparation and feedback around the sampling instant t_k.

    Both preparations are over when the measurement z_k arrives at t_k (drawn as late as can be);
    only the two feedbacks lie between it and the command ω.

    Args:
        times: rows with problem ("RHE", "RHC"), phase ("preparation", "feedback"), minimum_us,
            average_us, maximum_us.
    """
    average = times.set_index(["phase", "problem"])["average_us"]
    estimated = average["feedback", "RHE"]
    commanded = estimated + average["feedback", "RHC"]
    bars = [(phase, problem) for phase in _PHASE_COLOURS for problem in ("RHE", "RHC")]
    prepared = average["preparation"]
    begins = dict(zip(bars, (-prepared.sum(), -prepared["RHC"], 0, estimated)))
    labels = {}
    for row in times.itertuples():
        took = f"{row.average_us:.1f} µs ({row.minimum_us:.1f} to {row.maximum_us:.1f})"
        labels[row.phase, row.problem] = f"{row.problem} {row.phase}\n{took}"

    figure, axes = plt.subplots(figsize=(COLUMN_IN, 2.6))
    axes.axvline(0, **_NOW)
    for place, ((phase, problem), begin) in enumerate(begins.items()):
        look = dict(color=_PHASE_COLOURS[phase], edgecolor=BLACK)
        axes.barh(place, average[phase, problem], 0.5, begin, **look)
    arrow = {"arrowstyle": "-|>", "color": VERMILLION, "shrinkA": 0, "shrinkB": 0}
    for x, top, bottom, signal in [
        (0, -0.7, 1.75, "$z_k$"),
        (estimated, 2.25, 2.75, r"$\hat\xi,\ \hat p$"),
        (commanded, 3.25, 3.75, r"$\omega$"),
    ]:
        axes.annotate("", (x, bottom), (x, top), arrowprops=arrow)
        note(axes, signal, (x, bottom - 0.25), (4, 0), color=VERMILLION, fontsize=8)
    ready = f"ready before $t_k$,\nany time in the\n{1000 * paper.DT_S:.0f} ms since $t_{{k-1}}$"
    note(axes, ready, (0, 0.5), (8, 0), ha="left")
    note(axes, "all that delays\nthe command", (0, 2.5), (-8, 0), ha="right")

    reported = 1000 * sum(paper.TABLE_1_MS[problem, "feedback"][1] for problem in ("RHE", "RHC"))
    title = f"measurement to command: {commanded:.1f} µs, paper: {reported:.0f} µs"
    axes.set_title(title, loc="right")
    axes.set_yticks(range(len(begins)), [labels[which] for which in begins])
    axes.set(ylim=(4.1, -0.9), xlabel=f"{_SINCE} [µs]")
    axes.use_sticky_edges = False
    axes.margins(x=0.06)
    axes.grid(axis="y", visible=False)
    return figure


@styled
def embedded_times(times):
    """Figure 5 for the exported C: mean times of the four phases around the sampling instant t_k,
    one axis a machine, one row for each source of times.

    Args:
        times: rows with machine, who, problem, phase as for `phases`, and mean_ms.
    """
    machines = list(times.groupby("machine", sort=False))
    rows = [of_one["who"].nunique() for _, of_one in machines]
    size = dict(figsize=(COLUMN_IN, 0.75 + 0.5 * len(machines) + 0.42 * sum(rows)))
    size["height_ratios"] = [n + 0.4 for n in rows]
    figure, panels = plt.subplots(len(machines), squeeze=False, **size)
    edge = dict(edgecolor=BLACK, linewidth=0.4)
    for axes, (machine, of_one) in zip(panels[:, 0], machines):
        unit, factor = ("ms", 1.0) if of_one["mean_ms"].max() > 0.1 else ("µs", 1e3)
        sources = dict(list(of_one.groupby("who", sort=False)))
        for place, given in enumerate(sources.values()):
            mean = factor * given.set_index(["problem", "phase"])["mean_ms"]
            begin = -(mean["RHE", "preparation"] + mean["RHC", "preparation"])
            for which, colour in _COLOURS.items():
                label = f"{which[0]} {which[1]}"
                axes.barh(place, mean[which], 0.5, begin, color=colour, label=label, **edge)
                begin += mean[which]
            note(axes, f"{begin:.3g} of {mean.sum():.3g} {unit}", (begin, place), (4, 0))
        axes.axvline(0, **_NOW)
        axes.set_yticks(range(len(sources)), [name.replace(", ", ",\n") for name in sources])
        axes.set(ylim=(len(sources) - 0.5, -0.5), title=machine, xlabel=f"{_SINCE} [{unit}]")
        low, high = axes.get_xlim()
        axes.set_xlim(low - 0.03 * (high - low), high + 0.45 * (high - low))  # room for the numbers
        axes.grid(axis="y", visible=False)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles[:4], labels[:4], loc="outside upper center", ncols=2)
    return figure
