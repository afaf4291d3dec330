"""The pictures of the benchmark."""

import matplotlib.pyplot as plt

from benchmark.step import REFERENCE, SPEEDUP, WHOLE
from notebooks.studies import timing
from rhec.style import BLACK, BLUE, COLUMN_IN, DOUBLE_IN, GREY, VERMILLION, styled

LOOKS = {
    "RHE": (BLUE, "^"),
    "RHC": (VERMILLION, "v"),
    "RHE + RHC": (BLACK, "o"),
    "closed loop": (BLACK, "D"),
}


def quartiles(rows):
    """How far the quartiles are from the median, as errorbar wants it."""
    return [
        rows["median_us"] - rows["lower_quartile_us"],
        rows["upper_quartile_us"] - rows["median_us"],
    ]


@styled
def step(table):
    """Time per step by contestant on a logarithmic axis: medians, with lines from quartile to
    quartile (mostly shorter than the marker is wide).
    """
    overall = table[table["phase"] == "overall"]
    whole = overall[overall["problem"].isin(WHOLE)].sort_values("median_us", ascending=False)
    places = {name: place for place, name in enumerate(whole["contestant"])}

    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 0.36 * (len(whole) + 1)))
    for problem, (colour, marker) in LOOKS.items():
        rows = overall[overall["problem"] == problem]
        axes.errorbar(
            rows["median_us"],
            rows["contestant"].map(places),
            xerr=quartiles(rows),
            fmt=marker,
            color=colour,
            markersize=4,
            label=problem,
        )
    for row in whole.to_dict("records"):
        text = f"{row['median_us']:,.{1 if row['median_us'] < 100 else 0}f} µs"
        if row["contestant"] != REFERENCE and SPEEDUP in row:
            text += f", {row[SPEEDUP]:,.{0 if row[SPEEDUP] > 10 else 1}f} times as fast"
        axes.annotate(
            text,
            (row["median_us"], places[row["contestant"]]),
            (0, 7),
            textcoords="offset points",
            ha="center",
        )
    axes.set_xscale("log")
    axes.margins(x=0.12)
    axes.set_xlabel("time per step [µs]")
    axes.set_yticks(range(len(places)), list(places))
    axes.set_ylim(len(places) - 0.5, -0.7)
    axes.grid(axis="y", visible=False)
    axes.set_title(timing.machine(), loc="right", fontsize=6)
    axes.legend(loc="lower right")
    return figure


@styled
def horizon(table):
    """Time per step over the number of intervals, both axes logarithmic, with what growth by the
    first, second and third power would be.
    """
    figure, axes = plt.subplots(figsize=(COLUMN_IN, 2.6))
    for problem, rows in table.groupby("problem", sort=False):
        colour, marker = LOOKS[problem]
        axes.errorbar(
            rows["intervals"],
            rows["median_us"],
            yerr=quartiles(rows),
            fmt=f"{marker}-",
            color=colour,
            markersize=4,
            label=problem,
        )
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.autoscale(False)
    both = table[table["problem"] == "RHE + RHC"]
    intervals = both["intervals"].to_numpy()
    for power in (1, 2, 3):
        guide = both["median_us"].iloc[0] * (intervals / intervals[0]) ** power
        axes.plot(intervals, guide, color=GREY, linewidth=0.6, linestyle=":", zorder=0)
        axes.annotate(
            f"$N^{power}$",
            (intervals[1], guide[1]),
            (-2, 2),
            textcoords="offset points",
            color=GREY,
            ha="right",
        )
    axes.set_xticks(intervals, intervals)
    axes.minorticks_off()
    axes.set_xlabel("intervals $N$")
    axes.set_ylabel("time per step [µs]")
    axes.set_title(timing.machine(), loc="right", fontsize=5)
    axes.legend()
    return figure


@styled
def campaign(table):
    """Samples a second and memory over the number of runs, by number of processes."""
    figure, (speed, memory) = plt.subplots(1, 2, figsize=(DOUBLE_IN, 2.4))
    looks = zip((BLUE, VERMILLION, BLACK), "os^")
    for (workers, rows), (colour, marker) in zip(table.groupby("workers"), looks):
        label = f"{workers} process{'es' * (workers > 1)}"
        look = dict(color=colour, marker=marker, markersize=4, label=label)
        speed.plot(rows["runs"], rows["samples_per_s"] / 1e3, **look)
        memory.plot(rows["runs"], rows["memory_mb"], **look)
    for axes, label in (
        (speed, "closed-loop samples [1000/s]"),
        (memory, "memory at the end [MB]"),
    ):
        axes.set_xscale("log")
        axes.set_ylim(0)
        axes.set_xlabel("runs of 1,200 samples")
        axes.set_ylabel(label)
    memory.legend(loc="best")
    memory.set_title(timing.machine(), loc="right", fontsize=6)
    return figure


@styled
def kinds(table):
    """What a run costs in a campaign, a bar for each kind."""
    names = table["field"].str.replace("_", " ") + ": " + table["value"].str.replace("_", " ")
    figure, axes = plt.subplots(figsize=(DOUBLE_IN, 0.2 * len(table) + 0.7))
    bars = axes.barh(names, table["run_ms"], color=BLUE, height=0.6)
    axes.bar_label(bars, fmt="%.1f", padding=3)
    axes.set_ylim(len(table) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.set_xlabel("a run of 1,200 samples, least of 3 campaigns of 64 [ms of CPU time]")
    axes.set_title(timing.machine(), loc="right", fontsize=6)
    return figure
