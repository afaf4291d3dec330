"""Many worlds: what the paper leaves open is drawn at random, all of it at once, and the claims
about driving are judged in each world.

The worlds are a scrambled Sobol sequence over UNKNOWNS (SciPy's `qmc`), so that no two unknowns
are correlated. Which unknown decides a claim is read from Spearman's rank correlations between the
unknown and how far the claim is on its side, with the false discovery rate held at 5 % over the
whole table (Benjamini and Hochberg).
"""

import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.workbench.studies.claims import run_sets
from rhec.workbench.studies.statistics import (
    CONFIDENCE,
    FAILS,
    HOLDS,
    UNDECIDED,
    interval_text,
    share,
    verdict,
)

__all__ = [
    "CLAIMS",
    "FIRST_SEED",
    "UNKNOWNS",
    "VARIANTS",
    "Claim",
    "correlations",
    "drive",
    "fields_of",
    "in_world",
    "judge",
    "readable_summary",
    "sample_parameters",
    "scenario",
    "summary",
    "unknowns",
]

# name: (least, most, on a logarithmic scale). turn_demand is the share of the yaw rate's bound that
# the headland needs at the soil's means.
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
FIRST_SEED = 2000  # beyond the ledger's and the calibration's seeds; no world shares a field
_DISCOVERIES = 0.05  # false discovery rate of the rank correlations
_FLOOR_M = 1e-3  # an overshoot below 1 mm counts as 1 mm

_CALIBRATED = dict(process_noise="calibrated")
# variant: (fields of Scenario, whether it needs the first row only); p printed, c calibrated
VARIANTS = {
    "rhe_p": (dict(), False),
    "rhe_c": (_CALIBRATED, False),
    "oracle": (dict(estimator="oracle"), False),
    "ekf_p": (dict(estimator="ekf"), False),
    "ekf_c": (dict(estimator="ekf") | _CALIBRATED, False),
    "q1": (dict(q=paper.Q1) | _CALIBRATED, True),
    "q2": (dict(q=paper.Q2) | _CALIBRATED, True),
    "q2_look_ahead": (dict(q=paper.Q2, look_ahead_m=run_sets.LOOK_AHEAD_M) | _CALIBRATED, True),
}


class Claim(NamedTuple):
    """A claim that is judged in each world.

    Args:
        claim: In words.
        measured: Function of the runs of all variants that returns one number a run: how far the
            claim is on its side (a logarithm, 0 at the bound), or, of an exact claim, whether it
            holds in the run.
    """

    claim: str
    measured: Callable


def _less(one, other):
    """ln(other / one): above 0 where `one` is the smaller."""
    return np.log(other / one)


def _overshoots(one, other, factor):
    """ln(o_one / (factor o_other)) of the overshoots o, an overshoot below 1 mm counted as 1 mm."""
    most, least = (np.maximum(runs.overshoot_m, _FLOOR_M) for runs in (one, other))
    return np.log(most / (factor * least))


def _stays(runs, within_m=paper.ROW_SPACING_M / 2):
    """Whether each robot arrives and then stays in its row, or within a tolerance."""
    return runs.arrived & (runs.max_error_true_m < within_m)


def _relative_to_oracle(flags, oracle):
    """Flags relative to the oracle: where it fails too, the claim is not refuted."""
    return flags | ~oracle


CLAIMS = {  # ids as in claims.toml, with the process noise (p printed, c calibrated)
    "A1 c": Claim(
        "Q¹ settles at least twice as slowly as Q³",
        lambda r: _less(2 * r.rhe_c.settling_time_s, r.q1.settling_time_s),
    ),
    "A10 c": Claim(
        "Q² overshoots at least twice as far as Q³", lambda r: _overshoots(r.q2, r.rhe_c, 2)
    ),
    "A5 c": Claim(
        "Look-ahead at least halves the overshoot of Q²",
        lambda r: -_overshoots(r.q2_look_ahead, r.q2, 0.5),
    ),
    "I2 c": Claim(
        "RHE stays within 0.12 m where the oracle does",
        lambda r: _relative_to_oracle(
            _stays(r.rhe_c, paper.TOLERANCE_M), _stays(r.oracle, paper.TOLERANCE_M)
        ),
    ),
    "B1 p": Claim(
        "RHE stays in its row where the oracle does",
        lambda r: _relative_to_oracle(_stays(r.rhe_p), _stays(r.oracle)),
    ),
    "B1 c": Claim(
        "RHE stays in its row where the oracle does",
        lambda r: _relative_to_oracle(_stays(r.rhe_c), _stays(r.oracle)),
    ),
    "B2 c": Claim(
        "EKF stays in its row where the oracle does",
        lambda r: _relative_to_oracle(_stays(r.ekf_c), _stays(r.oracle)),
    ),
    "B5 p": Claim(
        "RHE's mean error is below the EKF's",
        lambda r: _less(r.rhe_p.mean_error_m, r.ekf_p.mean_error_m),
    ),
    "B5 c": Claim(
        "RHE's mean error is below the EKF's",
        lambda r: _less(r.rhe_c.mean_error_m, r.ekf_c.mean_error_m),
    ),
    "B7 p": Claim(
        "RHE: no violation by raw GNSS where the oracle has none",
        lambda r: _relative_to_oracle(r.rhe_p.violations == 0, r.oracle.violations == 0),
    ),
    "B7 c": Claim(
        "RHE: no violation by raw GNSS where the oracle has none",
        lambda r: _relative_to_oracle(r.rhe_c.violations == 0, r.oracle.violations == 0),
    ),
    "B8 c": Claim(
        "RHE: no violation by true position where the oracle has none",
        lambda r: _relative_to_oracle(r.rhe_c.violations_true == 0, r.oracle.violations_true == 0),
    ),
    "B19 c": Claim(
        "RHC's output reaches its bounds",
        lambda r: r.rhe_c.omega_peak_radps >= paper.OMEGA_MAX_RADPS * (1 - 1e-9),
    ),
    "C1 c": Claim("RHE's yaw is good to 2°", lambda r: _less(r.rhe_c.rms_yaw_rad, 0.035)),
    "C2 c": Claim(
        "RHE's μ is better than a constant", lambda r: _less(r.rhe_c.rms_mu, r.rhe_c.mu_deviation)
    ),
    "C3 c": Claim(
        "RHE's κ is better than a constant",
        lambda r: _less(r.rhe_c.rms_kappa, r.rhe_c.kappa_deviation),
    ),
    "R2": Claim(
        "Calibrated W tracks better than printed",
        lambda r: _less(r.rhe_c.mean_error_true_m, r.rhe_p.mean_error_true_m),
    ),
}


def unknowns():
    """UNKNOWNS as a DataFrame, one row each: least, most, logarithmic."""
    return pd.DataFrame(UNKNOWNS, ["least", "most", "logarithmic"]).T


def sample_parameters(n, seed=0):
    """The first n worlds of the Sobol sequence, one row each, one column an unknown.

    A point u in [0, 1) becomes least + (most - least) u, or least^(1-u) most^u on a logarithmic
    scale.
    """
    # A Sobol sequence is balanced at powers of two, so it is drawn to the next one and cut.
    sequence = stats.qmc.Sobol(len(UNKNOWNS), rng=np.random.default_rng(seed))
    unit = sequence.random_base2((n - 1).bit_length())[:n]
    least, most, logarithmic = map(np.array, zip(*UNKNOWNS.values()))
    scaled = np.where(logarithmic, least ** (1 - unit) * most**unit, least + (most - least) * unit)
    return pd.DataFrame(scaled, columns=list(UNKNOWNS))


def scenario(world, variant, seed):
    """The Scenario of a variant in a world.

    It lasts for one row, one headland and a quarter of the next row, or for the first row alone
    where a variant needs no more.

    Args:
        world: One value for each of UNKNOWNS.
        variant: Of VARIANTS.
        seed: Of the field.
    """
    fields, first_row = VARIANTS[variant]
    world = fields_of(world)
    pace_mps = world["mu_mean"] * world["speed_mps"]
    row_m = world["row_length_m"]
    length_m = row_m if first_row else 1.25 * row_m + np.pi * world["headland_radius_m"]
    return Scenario(**world, duration_s=length_m / pace_mps, seed=seed, **fields)


def fields_of(world):
    """A world as fields of Scenario: the turn's demand on the yaw rate becomes its radius.

    At pace v = μν the headland's radius is v / (κ ω_max demand).

    Args:
        world: One value for each of UNKNOWNS.
    """
    fields = dict(world)
    pace_mps = fields["mu_mean"] * fields["speed_mps"]
    largest_radps = fields["kappa_mean"] * paper.OMEGA_MAX_RADPS
    radius_m = pace_mps / (largest_radps * fields.pop("turn_demand"))
    return fields | dict(headland_radius_m=radius_m)


def drive(worlds, seeds):
    """Drive every world.

    Args:
        worlds: Of `sample_parameters`.
        seeds: Fields of each world.

    Returns:
        {variant: DataFrame of metrics}, `seeds` rows for each world in turn.
    """
    rows = [world for world in worlds.to_dict("records") for _ in range(seeds)]
    return run_sets.drive(
        {
            variant: [scenario(world, variant, FIRST_SEED + k) for k, world in enumerate(rows)]
            for variant in VARIANTS
        }
    )


def in_world(values):
    """Judge a claim in one world.

    Args:
        values: Of the claim's `measured`, one a run; flags if the claim is exact.

    Returns:
        The verdict, by Student's t interval of the mean (an exact claim holds if all flags are
        true), and the mean.
    """
    if values.dtype == bool:
        return (HOLDS if values.all() else FAILS), np.mean(values)
    # SciPy divides by a standard deviation of zero.
    if np.ptp(values) == 0:
        low = high = values[0]
    else:
        low, high = stats.ttest_1samp(values, 0).confidence_interval(CONFIDENCE)
    return verdict(low, high, above=0), np.mean(values)


def judge(runs, n):
    """Judge every claim in every world.

    Args:
        runs: Of `drive`.
        n: How many worlds they are of.

    Returns:
        DataFrames (n, claims) of verdicts, and of how far the claim is on its side.
    """
    runs = SimpleNamespace(**runs)
    verdicts = pd.DataFrame()
    margins = pd.DataFrame()
    for id_, claim in CLAIMS.items():
        measured = np.asarray(claim.measured(runs)).reshape(n, -1)
        verdicts[id_], margins[id_] = zip(*map(in_world, measured))
    return verdicts, margins.astype(float)


def correlations(worlds, margins):
    """Rank correlations between the unknowns and how far each claim is on its side.

    Args:
        worlds: Of `sample_parameters`.
        margins: Of `judge`.

    Returns:
        DataFrames (claims, unknowns) of the correlations, NaN where a claim's margin is constant,
        and of whether each is significant with the false discovery rate held over all.
    """
    rho, p = (pd.DataFrame(np.nan, margins.columns, worlds.columns) for _ in range(2))
    for claim, unknown in itertools.product(margins, worlds):
        if np.ptp(margins[claim]) > 0:
            result = stats.spearmanr(margins[claim], worlds[unknown])
            rho.loc[claim, unknown], p.loc[claim, unknown] = result
    adjusted = p.to_numpy(copy=True)
    tested = ~np.isnan(adjusted)
    adjusted[tested] = stats.false_discovery_control(adjusted[tested])
    return rho, pd.DataFrame(adjusted < _DISCOVERIES, p.index, p.columns)


def summary(worlds, verdicts, margins):
    """In how many worlds each claim holds, and which unknown decides it.

    Args:
        worlds: Of `sample_parameters`.
        verdicts: Of `judge`.
        margins: Of `judge`.

    Returns:
        DataFrame, one row a claim: the share of worlds where it holds with its interval, those
        where it is undecided and fails, and the unknown of the strongest significant correlation.
    """
    rho, significant = correlations(worlds, margins)
    rows = []
    for id_, (claim, _) in CLAIMS.items():
        holds = share(verdicts[id_] == HOLDS)
        candidates = rho.loc[id_][significant.loc[id_]]
        deciding = candidates.abs().idxmax() if len(candidates) else ""
        strength = candidates.get(deciding, np.nan)
        direction = "more helps" if strength > 0 else "less helps" if strength < 0 else ""
        row = dict(id=id_, claim=claim, holds=holds.value, low=holds.low, high=holds.high)
        row |= {"undecided": np.mean(verdicts[id_] == UNDECIDED)}
        row |= {"fails": np.mean(verdicts[id_] == FAILS), "worlds": holds.n}
        row |= dict(decided_by=deciding, direction=direction, rank_correlation=strength)
        rows.append(row)
    return pd.DataFrame(rows)


def readable_summary(table):
    """The table of `summary` for readers: shares of worlds as "0.82 [0.76, 0.87]"."""
    shares = zip(table["holds"], table["low"], table["high"])
    shown = table.assign(holds=[interval_text(*interval) for interval in shares])
    shown = shown.drop(columns=["low", "high"]).set_index("id")
    return shown.round(2).fillna("")
