"""The share of fields on which the robot stays within the tolerance, over its mean speed."""

import matplotlib.pyplot as plt

from notebooks.further import tolerance
from notebooks.plots.parts import legend_outside
from rhec import style

_COLOURS = (style.COLOURS["RHE"], style.VERMILLION, style.COLOURS["oracle"])
_SIZES = (7.5, 5.5, 3.5)  # so that rings around the same place are all seen


@style.styled
def shares_over_speed(table, promise=tolerance.PROMISES["whole"]):
    """Draw shares with 95 % intervals over the mean speed, one panel a world.

    A dotted line joins a loop's constant speed (circle) and its cautious one (diamond). The dashed
    corner is the target.
    """
    rows = table[table["promise"] == promise]
    worlds = rows["world"].unique()
    size = (style.DOUBLE_IN, 2.7)
    figure, panels = plt.subplots(1, len(worlds), figsize=size, sharex=True, sharey=True)
    for axes, world in zip(panels, worlds):
        of_world = rows[rows["world"] == world]
        of_loops = of_world.groupby("loop", sort=False)
        for (loop, drives), colour, size in zip(of_loops, _COLOURS, _SIZES):
            axes.plot(drives["speed_mps"], drives["share"], ":", color=colour)
            for speed, drive in drives.groupby("speed", sort=False):
                error = [drive["share"] - drive["low"], drive["high"] - drive["share"]]
                look = dict(fmt="D" if speed == tolerance.CAUTIOUS else "o", markersize=size)
                axes.errorbar(
                    drive["speed_mps"],
                    drive["share"],
                    yerr=error,
                    color=colour,
                    markerfacecolor="none",
                    elinewidth=0.7,
                    capsize=1.5,
                    label=f"{loop}, {speed}",
                    **look,
                )
        share = tolerance.LEAST_SHARE
        speed_mps = tolerance.LEAST_SPEED_MPS
        corner = ([speed_mps, speed_mps, 1], [1.02, share, share])
        axes.plot(*corner, "--", color=style.BLACK, linewidth=0.7, label="target")
        title = f"{world}: {of_world['n'].iloc[0]} fields"
        axes.set(title=title, xlabel="mean speed [m/s]", ylim=(-0.02, 1.02))
    panels[0].set_xlim(rows["speed_mps"].min() - 0.02, rows["speed_mps"].max() + 0.02)
    panels[0].set_ylabel("share of fields within 0.12 m")
    legend_outside(figure, panels[0], "lower center", 4)
    return figure
