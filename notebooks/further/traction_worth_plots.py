"""A map of what an estimate of the traction is worth, over the soil."""

import matplotlib.pyplot as plt
from matplotlib.colors import LinearSegmentedColormap

from notebooks.further import traction_map
from notebooks.studies.tables import with_minus
from rhec import paper, style

_WORTH = LinearSegmentedColormap.from_list("worth", [style.SKY, "w", style.ORANGE])
_SPAN = 0.3  # of the ratios that differ in colour, on both sides of 1


@style.styled
def map_of_worth(table):
    """Draw the errors with estimated traction over those of each rival, a cell for each soil.

    Blue cells say that estimating pays, orange ones that it costs; a number is bold where the 95 %
    interval excludes 1. A cross is a soil on which the robot is lost, even with estimated traction.
    Hatched cells are constants above 1, which no rival is told.

    Args:
        table: Of `notebooks.further.traction_map.worth_map`.
    """
    variations = list(table["variation"].unique())
    size = dict(figsize=(style.DOUBLE_IN, 2.3))
    shared = dict(sharex=True, sharey=True, squeeze=False)
    figure, (panels,) = plt.subplots(1, len(variations), **size, **shared)
    for variation, axes in zip(variations, panels):
        image = _draw_cells(axes, table[table["variation"] == variation])
        axes.set_title(f"varies by {variation:g} of its slip", loc="center")
    panels[0].set_ylabel("mean κ of the soil [-]")
    figure.supxlabel("error of the constant κ that the rival is told [-]", fontsize=8)
    label = "error with estimated traction\nover the rival's [-]"
    figure.colorbar(image, ax=panels, label=label, fraction=0.03, pad=0.01, extend="both")
    words = [f"{table['n'].max()} fields a cell", "bold: the 95 % interval excludes 1"]
    words += ["hatched: κ would be above 1"]
    if (table["error_m"] > paper.TOLERANCE_M).any():
        words += ["×: the robot is lost"]
    figure.suptitle("; ".join(words), fontsize=8)
    return figure


def _draw_cells(axes, of_panel):
    """One panel: ratios as colours and numbers, mean κ from above to below."""
    told = [*map(str, traction_map.ERRORS), traction_map.NO_SLIP]
    kappas = [*of_panel["kappa"].unique()]
    cells = of_panel.set_index(["kappa", "told"])
    ratios = of_panel.pivot(index="kappa", columns="told", values="mean")
    ratios = ratios.reindex(kappas, columns=told)
    is_certain = (cells["high"] < 1) | (cells["low"] > 1)
    look = dict(cmap=_WORTH, vmin=1 - _SPAN, vmax=1 + _SPAN, aspect="auto")
    is_lost = of_panel.groupby("kappa")["error_m"].first().loc[kappas] > paper.TOLERANCE_M
    axes.patch.set(hatch="////", edgecolor="0.8", linewidth=0)  # shows where no cell is
    image = axes.imshow(ratios.where(~is_lost, axis=0), **look)
    for (kappa, name), cell in cells.iterrows():
        text = "×" if is_lost[kappa] else f"{cell['mean']:.2f}"
        place = told.index(name), kappas.index(kappa)
        weight = "bold" if is_certain[kappa, name] else "normal"
        axes.text(*place, text, ha="center", va="center", fontsize=8, weight=weight)
    axes.set_xticks(range(len(told)), [_tick(name) for name in told])
    axes.set_yticks(range(len(kappas)), [f"{each:g}" for each in kappas])
    axes.grid(visible=False)
    axes.tick_params(length=0)
    return image


def _tick(told):
    """What a rival is told, at the axis."""
    if told == traction_map.NO_SLIP:
        return "no slip"
    error = float(told)
    return with_minus(f"{error:+g}") if error else "0"
