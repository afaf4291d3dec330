"""Is the RHE nearer to the path than the EKF? The order of the two, one variation at a time.

Each variation changes one choice of the default drive, for both estimators alike, and W is that of
one rule, tuned in the default world. The list is meant to overturn the order: paths that turn the
other way, soil that slips to the other side or a lot, other speeds, weights and sensors. A cell of
the table holds the difference of the mean errors by raw GNSS, RHE − EKF, at equal seeds.
"""

import itertools

import pandas as pd

from notebooks.claims import run_sets
from notebooks.studies.scenario_tables import is_lost
from notebooks.studies.statistics import FAILS, HOLDS, LOST, difference, share
from notebooks.studies.tables import with_minus
from rhec import paper
from rhec.simulation.faults import Fault
from rhec.simulation.scenario import Scenario
from rhec.simulation.worlds import WORLDS

RULES = ("consistent", "prediction", "tracking")  # with W as printed the EKF is lost
_OF_RHE = ("estimation_horizon",)  # fields that an EKF does not have
_LATE = Fault(kind="latency", delay_s=0.2)
VARIATIONS = {  # {what is varied: fields of Scenario}
    "as by default": dict(),
    "turns to the left only": dict(turns="left"),
    "turns to the right only": dict(turns="right"),
    "a figure of eight": dict(turns="figure_of_eight"),
    "rows of 15 m": dict(row_length_m=15.0),
    "turns of 12 m radius": dict(headland_radius_m=12.0),
    "start on the right": dict(start_offset_m=-paper.START_OFFSET_M),
    "d = −0.015": dict(slip_difference=-0.015),
    "d = −0.005": dict(slip_difference=-0.005),
    "d = 0": dict(slip_difference=0.0),
    "d = 0.015": dict(slip_difference=0.015),
    "left only, d = −0.005": dict(turns="left", slip_difference=-0.005),
    "right only, d = −0.005": dict(turns="right", slip_difference=-0.005),
    "soil the same below both tracks": dict(soil_under="centre", slip_difference=0.0),
    "mean κ 0.85": dict(kappa_mean=0.85, kappa_deviation=0.03),
    "mean κ 0.99": dict(kappa_mean=0.99, kappa_deviation=0.004),
    "left only, mean κ 0.99": dict(turns="left", kappa_mean=0.99, kappa_deviation=0.004),
    "soil varies over 1 m": dict(correlation_length_m=1.0),
    "firm soil": WORLDS["firm"],
    "wet patches": WORLDS["wet patches"],
    "soft soil": WORLDS["soft"],
    "uncertain soil": WORLDS["uncertain"],
    "turns 0.2 m ahead of the antenna": dict(rotation_centre_m=0.2),
    "turns 0.2 m behind the antenna": dict(rotation_centre_m=-0.2),
    "bumps of 0.02 rad/s": dict(bump_sigma_radps=0.02),
    "speed 0.3 m/s": dict(speed_mps=0.3),
    "speed 0.7 m/s": dict(speed_mps=0.7),
    "white GNSS": dict(gnss_slow_share=0.0),
    "GNSS nearly all slow": dict(gnss_slow_share=0.95),
    "GNSS σ 0.03 m": dict(gnss_sigma_m=0.03),
    "positions 0.2 s late": dict(faults=(_LATE,)),
    "command one sample late": dict(command_delay=1),
    "backwards": dict(backwards=True),
    "path's yaw rate as reference": dict(input_reference="curvature"),
    "R = 1": dict(r=1.0),
    "R = 0.1": dict(r=0.1),
    "Q²": dict(q=paper.Q2),
    "window of 5 intervals": dict(estimation_horizon=5),
    "window of 30 intervals": dict(estimation_horizon=30),
}


def one_variation_at_a_time(fields, folder=None):
    """Drive both estimators under each variation and rule, and compare their mean errors.

    Args:
        fields: How many fields, from seed 0 on.
        folder: Where the campaign keeps its rows.

    Returns:
        DataFrame, one row a variation and rule: rhe_m and ekf_m, the means [m]; mean, low and high
        of RHE − EKF with its 95 % interval [m]; n; share, of the fields in which the RHE has less;
        and the verdict on "the RHE has less".
    """
    scenarios = {
        (name, estimator, rule): [
            Scenario(estimator=estimator, process_noise=rule, seed=seed, **_fields(of, estimator))
            for seed in range(fields)
        ]
        for (name, of), estimator, rule in itertools.product(
            VARIATIONS.items(), ("rhe", "ekf"), RULES
        )
    }
    drives = run_sets.drive(scenarios, folder)
    rows = []
    for name, rule in itertools.product(VARIATIONS, RULES):
        both = [drives[name, estimator, rule] for estimator in ("rhe", "ekf")]
        rows.append(dict(variation=name, process_noise=rule) | _compared(*both))
    return pd.DataFrame(rows)


def _fields(of, estimator):
    """The fields of a variation that an estimator has."""
    return {name: value for name, value in of.items() if estimator == "rhe" or name not in _OF_RHE}


def _compared(rhe, ekf):
    """Columns of a row: both means, and their paired difference."""
    one, other = (drives["mean_error_m"] for drives in (rhe, ekf))
    found = difference(one, other, below=0)
    return dict(
        rhe_m=one.mean(),
        ekf_m=other.mean(),
        mean=found.value,
        low=found.low,
        high=found.high,
        n=found.n,
        share=share(one < other).value,
        verdict=LOST if is_lost(ekf) else found.verdict,
    )


def readable_order(table):
    """The table of `one_variation_at_a_time` for readers: RHE / EKF [m] and RHE − EKF [mm]."""
    half_mm = 500 * (table["high"] - table["low"])
    texts = [
        f"{row.rhe_m:.4f} / {row.ekf_m:.4f}, {1e3 * row.mean:+.1f} ± {half:.1f}"
        for row, half in zip(table.itertuples(), half_mm)
    ]
    cells = table.assign(cell=[with_minus(text) for text in texts])
    lost = table["verdict"] == LOST
    cells.loc[lost, "cell"] = [f"{row.rhe_m:.4f} / lost" for row in table[lost].itertuples()]
    return cells.pivot_table(
        "cell", "variation", "process_noise", aggfunc="first", sort=False
    ).rename_axis(None, axis=1)


def in_words(table):
    """What the table says of the order, as Markdown: how often it holds, and where it does not."""
    judged = table[table["verdict"] != LOST]
    counts = judged["verdict"].value_counts()
    says = (
        f"Of {len(judged)} cells in which the EKF is not lost, the RHE has the smaller mean error "
        f"with its whole 95 % interval in {counts.get(HOLDS, 0)}, the larger one in "
        f"{counts.get(FAILS, 0)}, and {len(judged) - counts.get(HOLDS, 0) - counts.get(FAILS, 0)} "
        f"are undecided ({table['n'].max()} fields each)."
    )
    others = judged[judged["verdict"] != HOLDS]
    cells = [
        with_minus(f"{row.variation}, W {row.process_noise}: {1e3 * row.mean:+.1f} mm")
        for row in others.itertuples()
    ]
    return says + (f" The others: {'; '.join(cells)}." if cells else "")
