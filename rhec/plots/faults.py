"""Sensor faults: true error over time for each case of a family."""

import numpy as np

from rhec import paper
from rhec.plots.parts import BOUND, TOLERANCE, legend_outside, panels_beside, seed_range
from rhec.plots.style import BLUE, VERMILLION, styled
from rhec.studies.robustness import FAMILIES

__all__ = ["fault_family"]

_COLOURS = {"off": VERMILLION, "on": BLUE}
_LEAST_M, _MOST_M = 0.01, 100.0  # errors drawn


def _draw_errors(axes, error, handling, before_s):
    """Median over seeds and the band of all seeds. Returns the times [s] since the fault began."""
    # from the shortest run's beginning: not all have a time before
    first = np.flatnonzero(~np.isnan(error).any(axis=0))[0]
    error = np.clip(error[:, first:], _LEAST_M, _MOST_M)
    t_s = (first + np.arange(error.shape[1])) * paper.DT_S - before_s
    low, median, high = (f(error, axis=0) for f in (np.nanmin, np.nanmedian, np.nanmax))
    axes.fill_between(t_s, low, high, alpha=0.3, linewidth=0, color=_COLOURS[handling])
    axes.plot(t_s, median, label=f"robust handling {handling}", color=_COLOURS[handling])
    return t_s


@styled
def fault_family(family, table, errors, before_s):
    """True error since the fault began, a panel a case: median and band of all seeds.

    Shaded: while the fault lasts (the median, if that differs by seed). Dashed: 0.12 m. The title
    says how many seeds recovered, and when the last of them did.

    Args:
        family: of the cases, a key of `rhec.studies.robustness.FAMILIES`.
        table, errors: of `rhec.studies.robustness.study`.
        before_s: how long before the fault the errors begin [s].
    """
    table = table[table["family"] == family]
    cases, handlings = table["case"].unique(), table["handling"].unique()
    figure, panels = panels_beside(len(cases), 2.5)
    for axes, case in zip(panels, cases):
        lines = [case]
        for handling in handlings:
            runs = table[(table["case"] == case) & (table["handling"] == handling)]
            back, last_s = runs["recovery_s"].count(), runs["recovery_s"].max()
            when = f", ≤ {last_s:.0f} s" if back else ""
            lines.append(f"{handling}: {back} of {len(runs)} back{when}")
            t_s = _draw_errors(axes, errors[family, case, handling], handling, before_s)
        duration_s = np.median(runs["end_s"] - runs["begin_s"])
        axes.axvspan(0, max(duration_s, paper.DT_S), **TOLERANCE)
        axes.axhline(paper.TOLERANCE_M, **BOUND)
        axes.set_title("\n".join(lines), fontsize=7)
        axes.set(yscale="log", xlim=(t_s[0], t_s[-1]), xlabel="time since it began [s]")
        axes.minorticks_off()
    top = max(np.nanmax(error) for key, error in errors.items() if key[0] == family)
    panels[0].set(ylabel="true error [m]", ylim=(_LEAST_M, min(2 * top, _MOST_M)))
    figure.suptitle(f"{FAMILIES[family]}; {seed_range(table)}: median and range", fontsize=8)
    legend_outside(figure, panels[0], "lower center", len(handlings))
    return figure
