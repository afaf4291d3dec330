"""The map of the soil beside the soil, and the error with it from pass to pass."""

import matplotlib.pyplot as plt
import numpy as np

from rhec.workbench.plots import style
from rhec.workbench.plots.parts import legend_outside
from rhec.workbench.studies.soil_map import TUNED_GAINS

_MARGIN_M = 3.0  # around the path
_COLOURS = (style.BLUE, style.VERMILLION, style.GREEN)


@style.styled
def map_beside_truth(soil, known, path):
    """Draw μ and κ as they are, as the map has them, and how sure the map is.

    Args:
        soil: The rhec.Terrain.
        known: The rhec.SoilMap.
        path: The rhec.Path that was driven.
    """
    figure, panels = plt.subplots(2, 3, figsize=(style.DOUBLE_IN, 2.9), sharex=True, sharey=True)
    for row, (name, symbol) in zip(panels, (("mu", "μ"), ("kappa", "κ"))):
        truth = getattr(soil, name)
        limits = dict(vmin=truth.min(), vmax=truth.max(), cmap="viridis")
        sigma = getattr(known, f"sigma_{name}")
        drawn = (
            (soil, truth, symbol, limits),
            (known, getattr(known, name), f"{symbol} of the map", limits),
            (known, sigma, f"σ of the map's {symbol}", dict(vmin=0, cmap="magma")),
        )
        for axes, (grid, values, title, look) in zip(row, drawn):
            figure.colorbar(_field(axes, grid, values, look), ax=axes, shrink=0.9)
            axes.set_title(title)
    x, y, _ = path.poses(np.linspace(0, path.length_m, 400))[0].T
    x_min, x_max, y_min, y_max = path.box
    for axes in panels.ravel():
        axes.plot(x, y, color=style.GREY, linewidth=0.6)
        axes.set(xlim=(x_min - _MARGIN_M, x_max + _MARGIN_M), aspect="equal")
        axes.set_ylim(y_min - _MARGIN_M, y_max + _MARGIN_M)
        axes.grid(False)
    for axes in panels[1]:
        axes.set_xlabel("x [m]")
    for axes in panels[:, 0]:
        axes.set_ylabel("y [m]")
    return figure


def _field(axes, grid, values, look):
    """Draw values on a grid with `origin_m` and `cell_m`, each around its point."""
    x, y = (at + grid.cell_m * np.arange(n) for at, n in zip(grid.origin_m, values.shape))
    return axes.pcolormesh(x, y, values.T, shading="nearest", rasterized=True, **look)


@style.styled
def by_pass(table):
    """Draw the error over that of the rivals, from pass to pass, one panel for each gains.

    Args:
        table: Of `rhec.workbench.studies.soil_map.ratios`.
    """
    ratios = table[table["quantity"] != "error [m]"]
    gains = ratios["gains"].unique()
    figure, panels = plt.subplots(1, len(gains), figsize=(style.DOUBLE_IN, 2.3), sharey=True)
    for axes, gain in zip(np.atleast_1d(panels), gains):
        of_gain = ratios[ratios["gains"] == gain]
        groups = of_gain.groupby(["quantity", "way"], sort=False)
        quantities = [*of_gain["quantity"].unique()]
        for place, ((quantity, way), rows) in enumerate(groups):
            error = [rows["mean"] - rows["low"], rows["high"] - rows["mean"]]
            is_same = way == of_gain["way"].iloc[0]
            axes.errorbar(
                rows["number"] + 0.04 * (place - len(groups) / 2),
                rows["mean"],
                yerr=error,
                fmt="o-" if is_same else "D:",
                markersize=3,
                linewidth=0.8,
                color=_COLOURS[quantities.index(quantity)],
                label=f"{quantity}, {way}",
            )
        axes.axhline(1, color=style.BLACK, linewidth=0.6)
        title = "tuned noise and gains" if gain == TUNED_GAINS else f"R = {gain}"
        axes.set(title=title, xlabel="pass", xticks=sorted(rows["number"]))
    np.atleast_1d(panels)[0].set_ylabel("error with the map /\nerror of the rival")
    legend_outside(figure, np.atleast_1d(panels)[0], "lower center", 2)
    return figure
