"""The paper's Figure 5 for the exported C: which phase runs when, on the paper's computer and on
this one.
"""

import matplotlib.pyplot as plt

from rhec.plots.style import BLACK, BLUE, COLUMN_IN, GREEN, ORANGE, SKY, styled

PHASES = {
    ("RHE", "preparation"): SKY,
    ("RHC", "preparation"): GREEN,
    ("RHE", "feedback"): BLUE,
    ("RHC", "feedback"): ORANGE,
}


@styled
def embedded_times(times):
    """Mean times of the four phases around the sampling instant t_k, one axis [ms or µs] a machine,
    one row for each who says so.

    times: rows with machine, who, problem ("RHE", "RHC"), phase ("preparation", "feedback"),
    mean_ms. Both preparations are over at t_k, where the measurement arrives (drawn as late as can
    be); both feedbacks lie between it and the command.
    """
    panels = list(times.groupby("machine", sort=False))
    rows = [of["who"].nunique() for _, of in panels]
    figure, all_axes = plt.subplots(
        len(panels),
        1,
        figsize=(COLUMN_IN, 0.75 + 0.5 * len(panels) + 0.42 * sum(rows)),
        height_ratios=[n + 0.4 for n in rows],
        squeeze=False,
    )
    for axes, (machine, of) in zip(all_axes[:, 0], panels):
        unit, factor = ("ms", 1.0) if of["mean_ms"].max() > 0.1 else ("µs", 1e3)
        for place, (_, said) in enumerate(of.groupby("who", sort=False)):
            mean = factor * said.set_index(["problem", "phase"])["mean_ms"]
            begin = -(mean["RHE", "preparation"] + mean["RHC", "preparation"])
            for which, colour in PHASES.items():
                axes.barh(
                    place, mean[which], 0.5, begin, color=colour, edgecolor=BLACK, linewidth=0.4
                )
                begin += mean[which]
            delay, whole = begin, mean.sum()
            axes.annotate(
                f"{delay:.3g} of {whole:.3g} {unit}",
                (begin, place),
                (4, 0),
                textcoords="offset points",
                va="center",
                fontsize=7,
            )
        axes.axvline(0, color=BLACK, linewidth=0.6, linestyle="--", zorder=0)
        axes.set_yticks(
            range(of["who"].nunique()), [who.replace(", ", ",\n") for who in of["who"].unique()]
        )
        axes.set_ylim(of["who"].nunique() - 0.5, -0.5)
        axes.set_title(machine, loc="left")
        axes.set_xlabel(f"time since the sampling instant $t_k$ [{unit}]")
        low, high = axes.get_xlim()
        axes.set_xlim(low - 0.03 * (high - low), high + 0.45 * (high - low))  # room for the numbers
        axes.grid(axis="y", visible=False)
    handles = [
        plt.Rectangle((0, 0), 1, 1, facecolor=colour, edgecolor=BLACK, linewidth=0.4)
        for colour in PHASES.values()
    ]
    figure.legend(
        handles,
        [f"{problem} {phase}" for problem, phase in PHASES],
        loc="outside upper center",
        ncols=2,
    )
    return figure
