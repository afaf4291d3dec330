"""What faults do: true error over time for each case of a family."""

import matplotlib.pyplot as plt
import numpy as np

from rhec import paper
from rhec.plots.style import BLACK, BLUE, COLOURS, DOUBLE_IN, VERMILLION, styled
from rhec.studies.robustness import FAMILIES

LOOKS = {"off": {"color": VERMILLION}, "on": {"color": BLUE}}
BELOW_M, BEYOND_M = 0.01, 100.0  # what is drawn


@styled
def fault_family(family, table, errors, before_s):
    """True error [m] over the time [s] since the trouble began, a panel for each case of a family:
    median over seeds, and the band of all seeds.

    table, errors: of `robustness.study`; the errors begin before_s before the trouble. Shaded:
    while it lasts (the median, if that differs by seed). Dashed: 0.12 m. The title says how many
    seeds came back, and when the last of them did.
    """
    table = table[table["family"] == family]
    cases = list(dict.fromkeys(table["case"]))
    handlings = list(dict.fromkeys(table["handling"]))
    figure, panels = plt.subplots(
        1, len(cases), figsize=(DOUBLE_IN, 2.5), sharey=True, squeeze=False
    )
    for axes, case in zip(panels[0], cases):
        lines = []
        for handling in handlings:
            of_case = table[(table["case"] == case) & (table["handling"] == handling)]
            back, n, last = of_case["recovery_s"].count(), len(of_case), of_case["recovery_s"].max()
            lines.append(f"{handling}: {back} of {n} back" + (f", ≤ {last:.0f} s" if back else ""))
            error = np.clip(errors[family, case, handling], BELOW_M, BEYOND_M)
            first = np.flatnonzero(~np.isnan(error).any(axis=0))[
                0
            ]  # the shortest run's beginning: not all have a time before
            error = error[:, first:]
            t_s = (first + np.arange(error.shape[1])) * paper.DT_S - before_s
            axes.fill_between(
                t_s,
                np.nanmin(error, axis=0),
                np.nanmax(error, axis=0),
                alpha=0.3,
                linewidth=0,
                **LOOKS[handling],
            )
            axes.plot(
                t_s,
                np.nanmedian(error, axis=0),
                label=f"robust handling {handling}",
                **LOOKS[handling],
            )
        duration_s = np.median(of_case["end_s"] - of_case["begin_s"])
        axes.axvspan(
            0,
            max(duration_s, paper.DT_S),
            color=COLOURS["tolerance"],
            alpha=0.35,
            linewidth=0,
            zorder=0,
        )
        axes.axhline(paper.TOLERANCE_M, color=BLACK, linewidth=0.6, linestyle="--")
        axes.set_title("\n".join([case, *lines]), loc="left", fontsize=7)
        axes.set_yscale("log")
        axes.minorticks_off()
        axes.set_xlim(t_s[0], t_s[-1])
        axes.set_xlabel("time since it began [s]")
    panels[0, 0].set_ylabel("true error [m]")
    top = max(np.nanmax(each) for key, each in errors.items() if key[0] == family)
    panels[0, 0].set_ylim(BELOW_M, min(2 * top, BEYOND_M))
    seeds = table["seed"]
    figure.suptitle(
        f"{FAMILIES[family]}; {seeds.nunique()} seeds, {seeds.min()} to {seeds.max()}: median and range",
        fontsize=8,
    )
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(handlings)
    )
    return figure
