"""Parts that several figures share: tolerance and bounds, seeds with their interval, shaded times,
legends, logarithmic axes.
"""

from matplotlib.ticker import LogLocator

from rhec.plots.style import BLACK, COLOURS

__all__ = ["BOUND", "DOTS", "TOLERANCE", "legend_above", "log_axis", "note", "seed_range", "shade"]
__all__ += ["vertical_interval"]

BOUND = dict(color=BLACK, linewidth=0.6, linestyle="--")
TOLERANCE = dict(color=COLOURS["tolerance"], alpha=0.35, linewidth=0, zorder=0)
DOTS = dict(linestyle="none", marker="o", markeredgewidth=0)  # a dot a seed


def seed_range(sweep):
    """How many seeds a sweep has, and which, for a title."""
    seeds = sorted(sweep["seed"].unique())
    return f"{len(seeds)} seeds, {seeds[0]} to {seeds[-1]}"


def vertical_interval(axes, x, estimate, **look):
    """Mark an Interval (mean, low, high, …) at x."""
    mean, low, high = estimate[:3]
    axes.errorbar(x, mean, [[mean - low], [high - mean]], **look)


def note(axes, text, xy, offset=(0, 0), **look):
    """Small text at an offset [points] from a point."""
    look = dict(textcoords="offset points", fontsize=7, va="center") | look
    axes.annotate(text, xy, offset, **look)


def shade(axes, t_s, where):
    """Shade the times at which a condition holds."""
    look = dict(color="0.93", linewidth=0, zorder=0)
    axes.fill_between(t_s, 0, 1, where=where, transform=axes.get_xaxis_transform(), **look)


def legend_above(axes, handles_of=None, **look):
    """A legend in one line above the axes, to the right, clear of the title and of the data.

    handles_of: the axes whose entries it shows, if other ones.
    """
    entries = (handles_of or axes).get_legend_handles_labels()
    place = dict(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1)
    axes.legend(*entries, **place | dict(ncols=len(entries[0])) | look)


def log_axis(axis):
    """A logarithmic axis with 1, 2 and 5 written out."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter("{x:g}")
    axis.axes.minorticks_off()
