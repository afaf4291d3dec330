"""The share of fields on which the robot stays within the tolerance, over its mean speed."""

import matplotlib.pyplot as plt

from rhec import paper
from rhec.workbench.plots import style
from rhec.workbench.plots.parts import BOUND, legend_above, legend_outside, shade
from rhec.workbench.studies.ensured import CAUTIOUS, PROPOSAL

_COLOURS = {PROPOSAL: style.VERMILLION, "full oracle": style.COLOURS["oracle"]}


@style.styled
def fronts(table, target):
    """Draw shares with 95 % intervals over the mean speed, one panel for each promise.

    Dotted lines join drives at constant speeds, diamonds are cautious drives, and the dashed corner
    is the target.

    Args:
        table: Table of `rhec.workbench.studies.ensured.front`.
        target: (share, speed [m/s]) to reach simultaneously.
    """
    promises = table["promise"].unique()
    figure, panels = plt.subplots(1, len(promises), figsize=(style.DOUBLE_IN, 2.7), sharey=True)
    for axes, promise in zip(panels, promises):
        by_promise = table[table["promise"] == promise]
        for (estimator, mode), rows in by_promise.groupby(["estimator", "mode"], sort=False):
            careful = mode == CAUTIOUS
            error = [rows["share"] - rows["low"], rows["high"] - rows["share"]]
            look = dict(color=_COLOURS.get(estimator, style.COLOURS["RHE"]), capsize=1.5)
            look |= dict(fmt="D-" if careful else "o:", markersize=4 if careful else 2.5)
            axes.errorbar(
                rows["speed_mps"],
                rows["share"],
                yerr=error,
                elinewidth=0.7,
                label=f"{estimator}, {mode}",
                **look,
            )
        share, speed = target
        corner = ([speed, speed, 1], [1.02, share, share])
        axes.plot(*corner, "--", color=style.BLACK, linewidth=0.7, label="target")
        axes.set(title=promise, xlabel="mean speed [m/s]", ylim=(0, 1.02))
        axes.set_xlim(table["speed_mps"].min() - 0.02, table["speed_mps"].max() + 0.02)
    panels[0].set_ylabel(f"share of {table['n'].iloc[0]} fields within 0.12 m")
    legend_outside(figure, panels[0], "lower center", 3)
    return figure


@style.styled
def where_it_slows(runs):
    """Draw speed, true error and κ along the path, for drives on one field.

    Args:
        runs: {name: Run}; the first has a constant speed.
    """
    figure, panels = plt.subplots(3, figsize=(style.DOUBLE_IN, 3.9), sharex=True)
    speeds, errors, soil = panels
    for (name, run), colour in zip(runs.items(), (style.GREY, style.VERMILLION)):
        columns = run.columns
        look = dict(color=colour, label=name, linewidth=0.8)
        speeds.plot(columns["s_m"], columns["nu_mps"], **look)
        errors.plot(columns["s_m"], columns["error_true_m"], **look)
    soil.plot(columns["s_m"], columns["kappa"], color=style.BLACK, linewidth=0.8, label="κ")
    soil.plot(
        columns["s_m"],
        columns["kappa_hat"],
        color=style.BLUE,
        linewidth=0.6,
        label=f"estimate, {name}",
    )
    errors.axhline(paper.TOLERANCE_M, **BOUND)
    for axes in panels:
        _, curvatures = run.path.poses(columns["s_m"])
        shade(axes, columns["s_m"], curvatures != 0)
    speeds.set(ylabel="speed ν [m/s]", ylim=(0, None))
    errors.set(ylabel="true error [m]\n(dashed: 0.12 m)", ylim=(0, 0.3))
    soil.set(ylabel="κ [-]", ylim=(0, 1), xlim=(0, run.path.length_m))
    soil.set_xlabel("arc length of the path [m]  (shaded: curves)")
    for axes in (speeds, soil):
        legend_above(axes)
    return figure
