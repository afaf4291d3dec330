"""The paper's Figure 5: which phase runs when, to the scale of measured times."""

import matplotlib.pyplot as plt

from rhec import paper
from rhec.plots.style import BLACK, BLUE, COLUMN_IN, SKY, VERMILLION, styled

COLOURS = {"preparation": SKY, "feedback": BLUE}


@styled
def phases(times):
    """Figure 5: preparation and feedback of RHE and RHC on a time axis [µs] around the sampling
    instant t_k, as long as they take on average.

    times: rows with problem ("RHE", "RHC"), phase ("preparation", "feedback"), minimum_us,
    average_us, maximum_us. The measurement z_k arrives at t_k; both preparations are over by then
    (drawn as late as can be), and only the two feedbacks lie between it and the command ω.
    """
    average = times.set_index(["phase", "problem"])["average_us"]
    estimated = average["feedback", "RHE"]
    commanded = estimated + average["feedback", "RHC"]
    begins = {
        ("preparation", "RHE"): -average["preparation"].sum(),
        ("preparation", "RHC"): -average["preparation", "RHC"],
        ("feedback", "RHE"): 0,
        ("feedback", "RHC"): estimated,
    }
    labels = {
        (
            row.phase,
            row.problem,
        ): f"{row.problem} {row.phase}\n{row.average_us:.1f} µs ({row.minimum_us:.1f} to {row.maximum_us:.1f})"
        for row in times.itertuples()
    }

    figure, axes = plt.subplots(figsize=(COLUMN_IN, 2.6))
    axes.axvline(0, color=BLACK, linewidth=0.6, linestyle="--", zorder=0)
    for place, (which, begin) in enumerate(begins.items()):
        axes.barh(place, average[which], 0.5, begin, color=COLOURS[which[0]], edgecolor=BLACK)
    for x, top, bottom, signal in [
        (0, -0.7, 1.75, "$z_k$"),
        (estimated, 2.25, 2.75, r"$\hat\xi,\ \hat p$"),
        (commanded, 3.25, 3.75, r"$\omega$"),
    ]:
        axes.annotate(
            "",
            (x, bottom),
            (x, top),
            arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "shrinkA": 0, "shrinkB": 0},
        )
        axes.annotate(
            signal,
            (x, bottom - 0.25),
            (4, 0),
            textcoords="offset points",
            va="center",
            color=VERMILLION,
        )
    ready = f"ready before $t_k$,\nany time in the\n{1000 * paper.DT_S:.0f} ms since $t_{{k-1}}$"
    for text, place, side in [(ready, 0.5, 1), ("all that delays\nthe command", 2.5, -1)]:
        axes.annotate(
            text,
            (0, place),
            (8 * side, 0),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=7,
        )

    reported = 1000 * sum(paper.TABLE_1_MS[problem, "feedback"][1] for problem in ("RHE", "RHC"))
    axes.set_title(
        f"measurement to command: {commanded:.1f} µs, paper: {reported:.0f} µs", loc="right"
    )
    axes.set_xlabel("time since the sampling instant $t_k$ [µs]")
    axes.set_yticks(range(len(begins)), [labels[which] for which in begins])
    axes.set_ylim(4.1, -0.9)
    axes.use_sticky_edges = False
    axes.margins(x=0.06)
    axes.grid(axis="y", visible=False)
    return figure
