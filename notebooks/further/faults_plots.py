"""Sensor faults: an overview of all cases."""

import matplotlib.pyplot as plt

from notebooks.further.faults import FAMILIES
from notebooks.plots.parts import BOUND, log_axis, note
from rhec import paper
from rhec.style import DOUBLE_IN, SMALL_PT, colour_of, styled

_ESTIMATORS = ("EKF", "RHE")


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
    for estimator in _ESTIMATORS:
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
