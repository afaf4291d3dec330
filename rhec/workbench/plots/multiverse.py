"""The multiverse: the share of worlds in which each claim holds, and the unknowns it depends on."""

import matplotlib.pyplot as plt
from matplotlib.colors import LinearSegmentedColormap

from rhec.workbench.plots.style import BLUE, DOUBLE_IN, GREEN, ORANGE, VERMILLION, styled
from rhec.workbench.studies.statistics import FAILS, HOLDS, UNDECIDED

_SIDES = LinearSegmentedColormap.from_list("sides", [VERMILLION, "white", BLUE])
_LABELS = {
    "speed_mps": "speed",
    "mu_mean": r"$\mu$: mean",
    "mu_deviation": r"$\mu$: deviation",
    "kappa_mean": r"$\kappa$: mean",
    "kappa_deviation": r"$\kappa$: deviation",
    "correlation_length_m": "correlation length",
    "gnss_sigma_m": r"GNSS $\sigma$",
    "gnss_slow_share": "GNSS: slow share",
    "gnss_slow_time_s": "GNSS: slow time",
    "bump_sigma_radps": r"bumps $\sigma$",
    "encoder_sigma_mps": r"encoders $\sigma$",
    "row_length_m": "row length",
    "turn_demand": "turn demand",
    "start_offset_m": "start offset",
}


@styled
def multiverse_map(table, correlations, discovered):
    """Left, the share of worlds where each claim holds, is undecided, or does not hold; right, its
    rank correlation with each unknown.

    Numbers stand where a correlation is a discovery; blue: more of the unknown helps the claim.

    Args:
        table: as `rhec.workbench.studies.multiverse.summary` returns it.
        correlations: as `rhec.workbench.studies.multiverse.correlations` returns them.
        discovered: likewise, where a correlation is significant.
    """
    size = (DOUBLE_IN, 0.9 + 0.2 * len(table))
    widths = (1, 2.4)
    figure, (bars, heat) = plt.subplots(1, 2, figsize=size, sharey=True, width_ratios=widths)
    _draw_shares(bars, table)
    image = heat.imshow(correlations, cmap=_SIDES, vmin=-1, vmax=1, aspect="auto")
    for i, claim in enumerate(correlations.index):
        for j, unknown in enumerate(correlations.columns):
            if discovered.loc[claim, unknown]:
                rho = correlations.loc[claim, unknown]
                text = f"{rho:.1f}".replace("-", "−").replace("0.", ".")
                colour = "white" if abs(rho) > 0.75 else "black"
                heat.text(j, i, text, ha="center", va="center", fontsize=5.5, color=colour)
    labels = [_LABELS[name] for name in correlations.columns]
    heat.set_xticks(range(len(labels)), labels, rotation=50, ha="right", rotation_mode="anchor")
    heat.grid(visible=False)
    heat.tick_params(axis="y", length=0)
    label = "rank correlation (blue: more helps)"
    figure.colorbar(image, ax=heat, label=label, fraction=0.04, pad=0.02)
    return figure


def _draw_shares(axes, table):
    """A stacked bar a claim, with the interval of the share where it holds."""
    places = range(len(table))
    left = 0
    for column, verdict, colour, hatch in [
        ("holds", HOLDS, GREEN, ""),
        ("undecided", UNDECIDED, ORANGE, "...."),
        ("fails", FAILS, VERMILLION, "xxxx"),
    ]:
        look = dict(color=colour, hatch=hatch, edgecolor="white", linewidth=0, label=verdict)
        axes.barh(places, 100 * table[column], left=left, height=0.7, **look)
        left = left + 100 * table[column]
    ends = 100 * abs(table[["low", "high"]].sub(table["holds"], axis=0).to_numpy().T)
    look = dict(fmt="none", ecolor="k", elinewidth=0.8, capsize=1.5)
    axes.errorbar(100 * table["holds"], places, xerr=ends, **look)
    axes.set_yticks(places, [f"{row.claim}  {row.id}" for row in table.itertuples()])
    label = f"worlds [%]  (n = {table['worlds'].iloc[0]})"
    axes.set(xlim=(0, 100), ylim=(len(table) - 0.5, -0.5), xlabel=label)
    axes.grid(axis="y", visible=False)
    look = dict(handlelength=1.2, columnspacing=0.8, borderaxespad=0.2)
    axes.legend(loc="lower left", bbox_to_anchor=(-0.6, 1.0), ncols=3, **look)
