"""The multiverse: in what share of worlds each claim holds, and what it depends on."""

import matplotlib.pyplot as plt
from matplotlib.colors import LinearSegmentedColormap

from rhec.plots.style import BLUE, DOUBLE_IN, GREEN, ORANGE, VERMILLION, styled
from rhec.studies.statistics import FAILS, HOLDS, UNDECIDED

SIDES = LinearSegmentedColormap.from_list("sides", [VERMILLION, "white", BLUE])
LABELS = {
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

    table: `rhec.studies.multiverse.summary`; correlations, discovered: as
    `rhec.studies.multiverse.correlations` returns them. Numbers stand where a correlation is a
    discovery; blue: more of the unknown helps the claim.
    """
    figure, (bars, heat) = plt.subplots(
        1, 2, figsize=(DOUBLE_IN, 0.9 + 0.2 * len(table)), sharey=True, width_ratios=(1, 2.4)
    )
    places, left = range(len(table)), 0
    for column, verdict, colour, hatch in [
        ("holds", HOLDS, GREEN, ""),
        ("undecided", UNDECIDED, ORANGE, "...."),
        ("fails", FAILS, VERMILLION, "xxxx"),
    ]:
        bars.barh(
            places,
            100 * table[column],
            left=left,
            height=0.7,
            color=colour,
            hatch=hatch,
            edgecolor="white",
            linewidth=0,
            label=verdict,
        )
        left = left + 100 * table[column]
    ends = table[["low", "high"]].sub(table["holds"], axis=0).to_numpy().T
    bars.errorbar(
        100 * table["holds"],
        places,
        xerr=100 * abs(ends),
        fmt="none",
        ecolor="k",
        elinewidth=0.8,
        capsize=1.5,
    )
    bars.set_yticks(places, [f"{row.claim}  {row.id}" for row in table.itertuples()])
    bars.set(
        xlim=(0, 100),
        ylim=(len(table) - 0.5, -0.5),
        xlabel=f"worlds [%]  (n = {table['worlds'].iloc[0]})",
    )
    bars.grid(axis="y", visible=False)
    bars.legend(
        loc="lower left",
        bbox_to_anchor=(-0.6, 1.0),
        ncols=3,
        handlelength=1.2,
        columnspacing=0.8,
        borderaxespad=0.2,
    )

    image = heat.imshow(correlations, cmap=SIDES, vmin=-1, vmax=1, aspect="auto")
    for i, claim in enumerate(correlations.index):
        for j, unknown in enumerate(correlations.columns):
            if discovered.loc[claim, unknown]:
                rho = correlations.loc[claim, unknown]
                heat.text(
                    j,
                    i,
                    f"{rho:.1f}".replace("-", "−").replace("0.", "."),
                    ha="center",
                    va="center",
                    fontsize=6,
                    color="white" if abs(rho) > 0.75 else "black",
                )
    heat.set_xticks(
        range(len(correlations.columns)),
        [LABELS[name] for name in correlations.columns],
        rotation=50,
        ha="right",
        rotation_mode="anchor",
    )
    heat.grid(visible=False)
    heat.tick_params(axis="y", length=0)
    figure.colorbar(
        image, ax=heat, label="rank correlation (blue: more helps)", fraction=0.04, pad=0.02
    )
    return figure
