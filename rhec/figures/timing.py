"""The paper's Figure 5: which phase runs when, to the scale of measured times."""

import matplotlib.pyplot as plt

from rhec import paper

from .style import BLACK, BLUE, COLUMN_IN, GREY, SKY, VERMILLION, styled

COLOURS = {"preparation": SKY, "feedback": BLUE}


@styled
def phases(times):
    """Figure 5: preparation and feedback of RHE and RHC on a time axis [µs] around the sampling instant t_k, as long as their averages.

    times: rows with problem ("RHE", "RHC"), phase ("preparation", "feedback"), minimum_us, average_us, maximum_us. The measurement z_k arrives at
    t_k; both preparations are over by then (drawn as late as can be), and only the two feedbacks lie between it and the command ω.
    """
    average = times.set_index(["phase", "problem"])["average_us"]
    estimated = average["feedback", "RHE"]
    commanded = estimated + average["feedback", "RHC"]
    begins = {("preparation", "RHE"): -average["preparation"].sum(), ("preparation", "RHC"): -average["preparation", "RHC"],
              ("feedback", "RHE"): 0, ("feedback", "RHC"): estimated}
    labels = {(row.phase, row.problem): f"{row.problem} {row.phase}\n{row.average_us:.1f} µs ({row.minimum_us:.1f} to {row.maximum_us:.1f})"
              for row in times.itertuples()}

    figure, axes = plt.subplots(figsize=(COLUMN_IN, 2.3))
    for place, (which, begin) in enumerate(begins.items()):
        axes.barh(place, average[which], 0.5, begin, color=COLOURS[which[0]], edgecolor=BLACK)
    for x, top, bottom, text in [(0, -0.75, 1.75, "$z_k$ arrives"), (estimated, 2.25, 2.75, ""), (commanded, 3.25, 3.75, "")]:
        axes.annotate(text, (x, bottom), (x, top), arrowprops={"arrowstyle": "-|>", "color": VERMILLION, "shrinkA": 0, "shrinkB": 0}, ha="center")
    axes.set_yticks(range(len(begins)), [labels[which] for which in begins])
    axes.set_ylim(4.6, -1.2)
    return figure
