"""Robust handling beside plain estimation on recorded robots, one point for each cell of a grid.

    python -m rhec.workbench.plots.robustness_grid

draws docs/robustness_grid.png from data/robustness_grid.csv.
"""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from rhec.workbench.plots import style
from rhec.workbench.plots.parts import legend_outside
from rhec.workbench.studies.robustness_grid import TOLERANCE

__all__ = ["robust_over_plain"]

CELLS = style.ROOT / "data/robustness_grid.csv"
_LABELS = dict(yaw_rms_rad="RMS error of the yaw [rad]", worst_position_m="worst position [m]")
_COLOURS = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE, style.SKY)


@style.styled
def robust_over_plain(cells):
    """Draw the robust error over the plain one, with the bound above which a cell is lost.

    Args:
        cells: DataFrame of `rhec.workbench.studies.robustness_grid.lost_cells`, with the column
            fault.
    """
    figure, panels = plt.subplots(1, 2, figsize=(style.DOUBLE_IN, 2.9))
    for axes, (error, (factor, more)) in zip(panels, TOLERANCE.items()):
        for colour, (fault, of_fault) in zip(_COLOURS, cells.groupby("fault", sort=False)):
            plain, robust = (of_fault[f"{error}, {how}"] for how in ("plain", "robust"))
            axes.plot(plain, robust, ".", color=colour, markersize=3, label=fault)
        both = cells[[f"{error}, plain", f"{error}, robust"]].to_numpy()
        plain = np.geomspace(both.min(), both.max(), 50)
        axes.plot(
            plain, factor * plain + more, color=style.BLACK, linewidth=0.8, label="lost above"
        )
        axes.set(xscale="log", yscale="log", title=_LABELS[error])
        axes.set(xlabel="without robust handling", ylabel="with it")
    legend_outside(figure, panels[0], "lower center", 7)
    return figure


if __name__ == "__main__":
    robust_over_plain(pd.read_csv(CELLS)).savefig(style.ROOT / "docs/robustness_grid.png", dpi=150)
