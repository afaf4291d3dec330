"""Many worlds: what the paper leaves open is drawn anew, all at once, and the claims about driving
are judged in each world on its own.

The worlds are a scrambled Sobol sequence over UNKNOWNS (SciPy's `qmc`), so that no two unknowns
move together. Which unknown decides a claim is read from rank correlations (SciPy's `spearmanr`)
between the unknown and how far the claim is on its side, with the false discovery rate held at 5 %
over the whole table (`false_discovery_control`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from rhec import paper
from rhec.campaigns.campaign import campaign
from rhec.scenario import Scenario
from rhec.studies.claims.run_sets import LOOK_AHEAD_M, complete
from rhec.studies.statistics import CONFIDENCE, FAILS, HOLDS, UNDECIDED, always, share, verdict

# name: (least, most, on a logarithmic scale); turn_demand: share of the bound on the yaw rate that
# the headland asks for at the soil's means
UNKNOWNS = {
    "speed_mps": (0.2, 0.7, False),
    "mu_mean": (0.75, 0.95, False),
    "mu_deviation": (0.01, 0.1, False),
    "kappa_mean": (0.65, 0.95, False),
    "kappa_deviation": (0.02, 0.15, False),
    "correlation_length_m": (1.0, 10.0, True),
    "gnss_sigma_m": (0.01, 0.05, False),
    "gnss_slow_share": (0.0, 0.95, False),
    "gnss_slow_time_s": (5.0, 300.0, True),
    "bump_sigma_radps": (0.0, 0.05, False),
    "encoder_sigma_mps": (0.005, 0.035, False),
    "row_length_m": (15.0, 25.0, False),
    "turn_demand": (0.6, 0.9, False),
    "start_offset_m": (0.3, 1.5, False),
}
FIRST_SEED = 2000  # beyond the ledger's and the calibration's; every world has fields of its own
DISCOVERIES = 0.05  # false discovery rate of the rank correlations
FLOOR_M = 1e-3  # an overshoot below 1 mm counts as 1 mm

# variant: (fields of the scenario, whether the first row is all it needs)
VARIANTS = {
    "RHE, printed": (dict(), False),
    "RHE, calibrated": (dict(process_noise="calibrated"), False),
    "EKF, printed": (dict(estimator="ekf"), False),
    "EKF, calibrated": (dict(estimator="ekf", process_noise="calibrated"), False),
    "Q1": (dict(process_noise="calibrated", q=paper.Q1), True),
    "Q2": (dict(process_noise="calibrated", q=paper.Q2), True),
    "Q2, look-ahead": (
        dict(process_noise="calibrated", q=paper.Q2, look_ahead_m=LOOK_AHEAD_M),
        True,
    ),
}


class Claim(NamedTuple):
    """A claim in a world. `measured` takes {variant: runs} to one number a run: how far the claim
    is on its side (a logarithm, 0 at the bound), or, of an exact claim, whether it holds in the
    run.
    """

    id: str
    claim: str
    measured: Callable
    exact: bool = False


def closer(one, other, column):
    """log(other / one) of a metric: above 0 where `one` has less."""
    return lambda runs: np.log(runs[other][column] / runs[one][column])


def overshoots(one, other, factor):
    """log of how much more `one` overshoots than `factor` times `other`."""
    return lambda runs: np.log(
        np.maximum(runs[one].overshoot_m, FLOOR_M)
        / (factor * np.maximum(runs[other].overshoot_m, FLOOR_M))
    )


def stays(variant):
    return lambda runs: (
        runs[variant].arrived & (runs[variant].mean_error_true_m < paper.TOLERANCE_M)
    )


CLAIMS = (  # ids as in the ledger, with the reading: p printed, c calibrated
    Claim(
        "A1 c",
        "Q¹ settles at least twice as slowly as Q³",
        lambda runs: np.log(
            runs["Q1"].settling_time_s / (2 * runs["RHE, calibrated"].settling_time_s)
        ),
    ),
    Claim(
        "A2 c", "Q² overshoots at least twice as far as Q³", overshoots("Q2", "RHE, calibrated", 2)
    ),
    Claim(
        "A5 c",
        "Look-ahead at least halves the overshoot of Q²",
        lambda runs: -overshoots("Q2, look-ahead", "Q2", 0.5)(runs),
    ),
    Claim("B1 p", "RHE arrives and stays", stays("RHE, printed"), True),
    Claim("B1 c", "RHE arrives and stays", stays("RHE, calibrated"), True),
    Claim("B2 c", "EKF arrives and stays", stays("EKF, calibrated"), True),
    Claim(
        "B5 p",
        "RHE's mean error is below the EKF's",
        closer("RHE, printed", "EKF, printed", "mean_error_m"),
    ),
    Claim(
        "B5 c",
        "RHE's mean error is below the EKF's",
        closer("RHE, calibrated", "EKF, calibrated", "mean_error_m"),
    ),
    Claim(
        "B7 p",
        "RHE: no violation by raw GNSS",
        lambda runs: runs["RHE, printed"].violations == 0,
        True,
    ),
    Claim(
        "B7 c",
        "RHE: no violation by raw GNSS",
        lambda runs: runs["RHE, calibrated"].violations == 0,
        True,
    ),
    Claim(
        "B8 c",
        "RHE: no violation by true position",
        lambda runs: runs["RHE, calibrated"].violations_true == 0,
        True,
    ),
    Claim(
        "B19 c",
        "RHC's output reaches its bounds",
        lambda runs: runs["RHE, calibrated"].omega_peak_radps >= paper.OMEGA_MAX_RADPS * (1 - 1e-9),
        True,
    ),
    Claim(
        "C1 c",
        "RHE's yaw is good to 2°",
        lambda runs: np.log(0.035 / runs["RHE, calibrated"].rms_yaw_rad),
    ),
    Claim(
        "C2 c",
        "RHE's μ is better than a constant",
        lambda runs: np.log(runs["RHE, calibrated"].mu_deviation / runs["RHE, calibrated"].rms_mu),
    ),
    Claim(
        "C3 c",
        "RHE's κ is better than a constant",
        lambda runs: np.log(
            runs["RHE, calibrated"].kappa_deviation / runs["RHE, calibrated"].rms_kappa
        ),
    ),
    Claim(
        "R2",
        "Calibrated W tracks better than printed",
        closer("RHE, calibrated", "RHE, printed", "mean_error_true_m"),
    ),
)


def worlds(n, seed=0):
    """The first n worlds of the sequence, one row each."""
    unit = stats.qmc.Sobol(len(UNKNOWNS), rng=np.random.default_rng(seed)).random_base2(
        (n - 1).bit_length()
    )[:n]
    least, most, logarithmic = map(np.array, zip(*UNKNOWNS.values()))
    scaled = np.where(logarithmic, least ** (1 - unit) * most**unit, least + (most - least) * unit)
    return pd.DataFrame(scaled, columns=list(UNKNOWNS))


def scenario(world, variant, seed):
    """A world's scenario: one row, one headland and a quarter of the next row, or the first row
    alone where that is all a variant needs.
    """
    fields, first_row = VARIANTS[variant]
    world = dict(world)
    pace_mps = world["mu_mean"] * world["speed_mps"]
    radius_m = pace_mps / (world["kappa_mean"] * paper.OMEGA_MAX_RADPS * world.pop("turn_demand"))
    length_m = (
        world["row_length_m"] if first_row else 1.25 * world["row_length_m"] + np.pi * radius_m
    )
    return Scenario(
        headland_radius_m=radius_m, duration_s=length_m / pace_mps, seed=seed, **world, **fields
    )


def drive(drawn, seeds):
    """{variant: runs}, `seeds` rows for each world in turn."""
    asked = [
        scenario(world, variant, FIRST_SEED + seeds * place + k)
        for variant in VARIANTS
        for place, world in enumerate(drawn.to_dict("records"))
        for k in range(seeds)
    ]
    table, each = complete(campaign(asked)), len(drawn) * seeds
    return {
        variant: table.iloc[place * each : (place + 1) * each].reset_index(drop=True)
        for place, variant in enumerate(VARIANTS)
    }


def in_world(values, exact):
    """A claim in one world on its runs' numbers: (verdict, how far on its side). Student's t
    interval: five runs are too few for a bootstrap.
    """
    if exact:
        return always(values).verdict, np.mean(values)
    if np.ptp(values) == 0:
        low = high = values[0]
    else:
        low, high = stats.ttest_1samp(values, 0).confidence_interval(CONFIDENCE)
    return verdict(low, high, above=0), np.mean(values)


def judge(runs, n):
    """Every claim in every world: DataFrames (n worlds, claims) of verdicts and of how far the
    claim is on its side.
    """
    found = {
        claim.id: [
            in_world(values, claim.exact)
            for values in np.asarray(claim.measured(runs)).reshape(n, -1)
        ]
        for claim in CLAIMS
    }
    return (
        pd.DataFrame({name: [verdict for verdict, _ in each] for name, each in found.items()}),
        pd.DataFrame(
            {name: [margin for _, margin in each] for name, each in found.items()}, dtype=float
        ),
    )


def correlations(drawn, margins):
    """Rank correlations (claims, unknowns) of how far a claim is on its side with each unknown, and
    which of them count as discoveries.
    """
    rho, p = (pd.DataFrame(np.nan, margins.columns, drawn.columns) for _ in range(2))
    for claim in margins:
        if np.ptp(margins[claim]) > 0:
            for unknown in drawn:
                rho.loc[claim, unknown], p.loc[claim, unknown] = stats.spearmanr(
                    margins[claim], drawn[unknown]
                )
    adjusted = p.to_numpy(copy=True)
    known = ~np.isnan(adjusted)
    adjusted[known] = stats.false_discovery_control(adjusted[known])
    return rho, pd.DataFrame(adjusted < DISCOVERIES, p.index, p.columns)


def summary(drawn, verdicts, margins):
    """One row a claim: the share of worlds where it holds with its interval, and the unknown that
    decides it: the strongest discovery, if any.
    """
    rho, discovered = correlations(drawn, margins)
    rows = []
    for claim in CLAIMS:
        holds, of = (
            share(verdicts[claim.id] == HOLDS),
            rho.loc[claim.id].where(discovered.loc[claim.id]),
        )
        deciding = "" if of.isna().all() else of.abs().idxmax()
        rows.append(
            dict(
                id=claim.id,
                claim=claim.claim,
                holds=holds.value,
                low=holds.low,
                high=holds.high,
                undecided=np.mean(verdicts[claim.id] == UNDECIDED),
                fails=np.mean(verdicts[claim.id] == FAILS),
                worlds=holds.n,
                decided_by=deciding,
                direction=""
                if not deciding
                else "more helps"
                if of[deciding] > 0
                else "less helps",
                rank_correlation=np.nan if not deciding else of[deciding],
            )
        )
    return pd.DataFrame(rows)
