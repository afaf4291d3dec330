"""Sensor faults: an overview of all cases, and true errors over time.

In plots over time a narrow line (the RHE) lies on a broad one (the EKF), so that equal results are
visible.
"""

import matplotlib.pyplot as plt
import numpy as np

from notebooks.further.faults import FAMILIES
from notebooks.plots.parts import BOUND, TOLERANCE, legend_outside, log_axis, note, seed_range
from rhec import paper
from rhec.style import DOUBLE_IN, SMALL_PT, colour_of, styled

_WIDTHS = {"EKF": 2.0, "RHE": 0.8}
# Limits of the error axis.
_LEAST_M = 0.01
_MOST_M = 100.0
_PANELS = 4  # panels in a row


def _draw_errors(axes, error, estimator, before_s):
    """Draw median and largest error over seeds; return the times since the fault began [s]."""
    # The time before the fault differs between runs; the axis begins where one run has data.
    first = np.flatnonzero(~np.isnan(error).any(axis=0))[0]
    error = error[:, first:]
    look = dict(color=colour_of(estimator), linewidth=_WIDTHS[estimator])
    t_s = (first + np.arange(error.shape[1])) * paper.DT_S - before_s
    axes.plot(t_s, np.nanmedian(error, axis=0), label=f"{estimator}: median", **look)
    axes.plot(t_s, np.nanmax(error, axis=0), ":", label=f"{estimator}: largest", **look)
    return t_s


@styled
def fault_courses(keys, table, errors, before_s):
    """Draw the true error since the fault began, median and largest over seeds, a panel per case.

    The fault lasts in the yellow area; its duration is the median over seeds. The title has the
    number of seeds that recovered and the longest recovery time. keys are (family, case) of the
    panels, table and errors results of `notebooks.further.faults.study`, whose first errors are
    before_s [s] before the fault.
    """
    rows = -(-len(keys) // _PANELS)
    columns = min(len(keys), _PANELS)
    look = dict(figsize=(DOUBLE_IN, 0.8 + 1.7 * rows), sharey=True, squeeze=False)
    figure, grid = plt.subplots(rows, columns, **look)
    for axes, (family, case) in zip(grid.flat, keys):
        runs_of_case = table[(table["family"] == family) & (table["case"] == case)]
        lines = [_label(FAMILIES[family], case)]
        for estimator, runs in runs_of_case.groupby("estimator", sort=False):
            back = runs["recovery_s"].count()
            last_s = runs["recovery_s"].max()
            when = f", last in {last_s:.0f} s" if back else ""
            lines.append(f"{estimator}: {back} of {len(runs)} recover{when}")
            t_s = _draw_errors(axes, errors[family, case, estimator], estimator, before_s)
        duration_s = np.median(runs_of_case["end_s"] - runs_of_case["begin_s"])
        axes.axvspan(0, max(duration_s, paper.DT_S), **TOLERANCE, label="while it lasts")
        axes.axhline(paper.TOLERANCE_M, **BOUND, label=f"{paper.TOLERANCE_M} m")
        axes.set_title("\n".join(lines), fontsize=SMALL_PT)
        axes.set(yscale="log", xlim=(t_s[0], t_s[-1]))
        axes.minorticks_off()
    for axes in grid.flat[len(keys) :]:
        axes.set_visible(False)
    top = max(np.nanmax(error) for (*key, _), error in errors.items() if (*key,) in keys)
    grid[0, 0].set_ylim(_LEAST_M, min(2 * top, _MOST_M))
    cut = f", cut at {_MOST_M:g} m" if top > _MOST_M else ""
    figure.supylabel(f"true error [m]{cut}", fontsize=8)
    for axes in grid[-1]:
        axes.set_xlabel("time since it began [s]")
    figure.suptitle(seed_range(table), fontsize=8)
    legend_outside(figure, grid[0, 0], "lower center", 6)
    return figure


@styled
def fault_overview(table, n):
    """Draw the largest true error after the fault and the recovery time for all cases.

    Means over seeds have 95 % intervals; a ring marks the worst seed. At the right are the numbers
    of the n seeds that recovered, with the RHE and with the EKF. The table has the rows of
    `notebooks.further.faults.fault_table` of both.
    """
    cases = list(table.groupby(["family", "case"], sort=False))
    size = dict(figsize=(DOUBLE_IN, 1.1 + 0.135 * len(cases)), sharey=True)
    figure, (errors, times) = plt.subplots(1, 2, **size)
    for axes, column in ((errors, "max_after_m"), (times, "recovery_s")):
        for place, (_, runs) in enumerate(cases):
            for row in runs.to_dict("records"):
                colour = colour_of(row["estimator"])
                at = place + (0.2, -0.2)[row["estimator"] == "RHE"]
                low = row[f"{column}_low"]
                high = row[f"{column}_high"]
                axes.plot([low, high], [at, at], color=colour, linewidth=1.2)
                axes.plot(row[column], at, "o", color=colour, markersize=2.5)
                ring = dict(color=colour, markersize=3.5, markeredgewidth=0.5)
                axes.plot(row[f"{column}_largest"], at, "o", markerfacecolor="none", **ring)
        axes.grid(axis="y", visible=False)
    for place, (_, runs) in enumerate(cases):
        back = runs.set_index("estimator")["back"]
        at = dict(xycoords=("axes fraction", "data"))
        note(times, f"{back['RHE']}, {back['EKF']}", (1, place), (3, 0), **at)
        if place and cases[place - 1][0][0] != cases[place][0][0]:
            for axes in (errors, times):
                axes.axhline(place - 0.5, color="0.6", linewidth=0.4)
    log_axis(errors.xaxis, labelled=(1,))
    errors.axvline(paper.TOLERANCE_M, **BOUND)
    errors.set_yticks(range(len(cases)), [_label(*key) for key, _ in cases], fontsize=SMALL_PT)
    errors.set(ylim=(len(cases) - 0.4, -0.6))
    errors.set_xlabel(f"largest true error afterwards [m],\ndashed: {paper.TOLERANCE_M} m")
    times.set_xlabel(f"time to recover [s]; right: how many\nof {n} seeds recovered, RHE and EKF")
    for estimator in _WIDTHS:
        errors.plot([], [], "o-", color=colour_of(estimator), markersize=2.5, label=estimator)
    ring = dict(color="0.3", markersize=3.5, linestyle="none", markerfacecolor="none")
    errors.plot([], [], "o", label="worst seed", **ring)
    title = f"{n} seeds: mean, 95 % interval, worst seed"
    figure.legend(
        *errors.get_legend_handles_labels(), loc="outside upper center", ncols=3, title=title
    )
    figure.get_layout_engine().set(w_pad=0.1)  # letters are wider in print than when laid out
    return figure


def _label(family, case):
    return case if family == FAMILIES["none"] else f"{family}: {case}"
