"""Which worlds give the paper's numbers: the inverse problem of its field experiment.

The paper states what its robot did, and neither soil nor speed. Here soil, sensors, speed and drive
are drawn from PRIORS, each world is driven on several fields by the paper's robots, and approximate
Bayesian computation (`notebooks.studies.abc_regression`) finds the worlds in which one drive
gives what the paper states (STATEMENTS).

The paper is one drive with each estimator. So the simulation that is compared with it is one
drive on one field, never the mean of several. The two drives are on the same soil at different
times, so that their noise differs. W is unknown, too: the RHE's is one of W_RHE, and the EKF's,
with which nobody can drive as printed, is printed or free.

`python -m notebooks.studies.which_worlds` drives all worlds, in a quarter of an hour, and writes
`data/prior_drives.parquet`, `data/posterior_worlds.csv` and `data/posterior_drives.parquet`; it
keeps blocks of worlds in build/inverse and goes on where it was interrupted.
"""

import argparse
import dataclasses
import hashlib
import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from notebooks.studies import abc_regression, statistics
from notebooks.studies.parallel import map_runs
from notebooks.studies.tables import interval_text
from rhec import paper
from rhec.files import replacing
from rhec.simulation.campaigns import store
from rhec.simulation.closed_loop import set_up
from rhec.simulation.metrics import SETTLING_SAMPLES
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning

DATA = Path(__file__).parents[2] / "data"
PRIOR_DRIVES = DATA / "prior_drives.parquet"
POSTERIOR_DRIVES = DATA / "posterior_drives.parquet"
POSTERIOR_WORLDS = DATA / "posterior_worlds.csv"

WORLDS = 2048
FIELDS = 8  # of each world, and one vector register of lanes
ROW_FIELDS = 2  # of those, for Q¹ and Q², which need the first row only
FIRST_SEED = 2000  # beyond held-out and training seeds; world k has FIRST_SEED + 8 k and the next 7
_BLOCK = 256  # worlds in one file of build/inverse
KEEP = 500  # nearest simulations behind a posterior
DRAWS = 200  # worlds in POSTERIOR_WORLDS
CENTRE_COPIES = 25  # of the centre in POSTERIOR_DRIVES, FIELDS fields each
_MOST_WORLDS = 2**17
_UNUSED_SEED = FIRST_SEED + FIELDS * _MOST_WORLDS  # no world of the prior has these fields
_OTHER_TIME = 2**24  # from the seed of the RHE's noise to that of the EKF's


class Prior(NamedTuple):
    """What is believed of an unknown before the paper's numbers are seen.

    Attributes:
        least: Least value.
        most: Largest value; uniform between the two.
        logarithmic: Whether its logarithm is uniform instead.
        source: Where the range is from.
    """

    least: float
    most: float
    logarithmic: bool
    source: str


_RTK = "Carballido et al. 2014 (1.4 cm between rows, RTK); the paper (0.03 m)"
_CORRELATION = "Miller et al. 2012 (115 s) to Odolinski 2012 (13 to 17 min)"
_CONE_INDEX = "soil's resistance to penetration varies by 16 to 46 % (Bragantia)"
_ROBOTS = "four recorded robots (tuning.SLIP: 0.015), a factor of three to either side"
# A deviation is a share of the mean slip, 1 - traction, since slip cannot vary where there is none.
PRIORS = {
    "speed_mps": Prior(0.25, 0.75, False, "Liu et al. 2025 (0.35 and 0.75 m/s, tracks, field)"),
    "mu_slip": Prior(
        0.01, 0.25, True, "rubber tracks: 2 to 4 % at best (AG Tire Talk 2022); wet: more"
    ),
    "mu_variation": Prior(0.1, 0.6, False, _CONE_INDEX),
    "kappa_slip": Prior(0.01, 0.4, True, "Martínez et al. 2005; the recorded tracked robot"),
    "kappa_variation": Prior(0.1, 0.6, False, _CONE_INDEX),
    "correlation_length_m": Prior(1.0, 15.0, True, "Bekele et al. 2005 (below 9 m)"),
    "slip_difference": Prior(-0.02, 0.02, False, "judged; none is published for this robot"),
    "rotation_centre_m": Prior(-0.25, 0.25, False, "judged: a quarter of the robot's length"),
    "bump_diffusion_radpsqrtm": Prior(0.005, 0.045, True, _ROBOTS),
    "rut_length_m": Prior(0.0, 1.0, False, "judged: up to the robot's length"),
    "gnss_sigma_m": Prior(0.008, 0.035, False, _RTK),
    "gnss_slow_share": Prior(0.0, 0.98, False, _CORRELATION),
    "gnss_slow_time_s": Prior(30.0, 1000.0, True, _CORRELATION),
    "encoder_sigma_mps": Prior(0.005, 0.035, False, "the paper (accuracy 0.035 m/s)"),
    "speed_sigma_mps": Prior(0.0, 0.05, False, "the paper (σ_ν = 0.05 m/s)"),
    "command_delay": Prior(0, 1, False, "the paper, eq. (13), either reading (G10)"),
    "row_length_m": Prior(15.0, 30.0, False, "judged; the paper gives no length"),
    "rows": Prior(1.2, 2.2, False, "judged: straight and curved lines, no length given"),
    "turn_demand": Prior(0.6, 0.9, False, "judged: headlands that the yaw rate's bound allows"),
    "start_offset_m": Prior(0.3, 1.5, False, "judged: the paper starts off-track"),
    "sigma_ekf_m": Prior(0.001, 0.3, True, "judged: none to ten times that of the GNSS"),
    "sigma_ekf_ratio_radpm": Prior(0.1, 10.0, True, "judged: a heading, and a filter, that last"),
}
_DISCRETE = ("command_delay",)

# Fields of Scenario; G7 belongs to the printed W, since the others were tuned with the filter's.
W_RHE = {
    "printed": dict(process_noise="printed"),
    "smoothed": dict(process_noise="printed", arrival_mean="smoothed"),
    "prediction": dict(process_noise="prediction"),
    "consistent": dict(process_noise="consistent"),
}
W_EKF = ("printed", "free")  # free: sigma_ekf_m and sigma_ekf_ratio_radpm of the world
PRINTED = "printed", "smoothed"  # the W of the paper, of either estimator


class Statement(NamedTuple):
    """Something that the paper states of its drives, as a number of one simulated drive.

    Attributes:
        text: In words.
        observed: The statistic's value in the paper.
        within: A drive meets the statement if its statistic is this near to `observed`.
        least_unit: The distance to `observed` is in units of the spread of one drive, or in these
            if they are larger.
    """

    text: str
    observed: float
    within: float
    least_unit: float = 0.01  # where all drives hold, the spread is 0


_A_QUARTER = float(np.log(1.25))
STATEMENTS = {
    "error_rhe": Statement(
        "mean error with the RHE 0.0423 m", float(np.log(paper.MEAN_ERROR_RHE_M)), _A_QUARTER
    ),
    "error_ekf": Statement(
        "mean error with the EKF 0.0514 m", float(np.log(paper.MEAN_ERROR_EKF_M)), _A_QUARTER
    ),
    "violations_rhe": Statement("no violation with the RHE", paper.VIOLATIONS_RHE**0.5, 0.0),
    "violations_ekf": Statement(
        "17 violations with the EKF", paper.VIOLATIONS_EKF**0.5, 34**0.5 - 17**0.5
    ),
    # How large a share is "consistently", the words leave open.
    "near_bound": Statement("estimates stay close to the upper bound", 0.0, 0.05, least_unit=0.25),
    "slow_q1": Statement("Q¹ does not arrive within a reasonable time", 0.0, 0.0),
    "overshoot_q2": Statement("Q² oscillates about the path", 0.0, 0.0),
    "reaches_bound": Statement("the yaw rate reaches its bounds", 0.0, 0.0),
    "gain": Statement(
        "the RHE's error is smaller by a factor of 1.22",
        float(np.log(paper.MEAN_ERROR_EKF_M / paper.MEAN_ERROR_RHE_M)),
        float(np.log(paper.MEAN_ERROR_EKF_M / paper.MEAN_ERROR_RHE_M)) / 2,
    ),
}
_NUMBERS = 4  # the first of STATEMENTS are printed numbers


# Worlds


def sample_unit(n=WORLDS, seed=0):
    """The first n points of a scrambled Sobol sequence over PRIORS, (n, d) between 0 and 1."""
    sequence = stats.qmc.Sobol(len(PRIORS), rng=np.random.default_rng(seed))
    return sequence.random_base2((n - 1).bit_length())[:n]


def worlds_at(unit):
    """Worlds at points (n, d) between 0 and 1, by the priors' quantiles: DataFrame (n, d).

    A point u becomes least + (most - least) u, or least^(1-u) most^u on a logarithmic scale.
    """
    least, most, logarithmic, _ = map(np.array, zip(*PRIORS.values()))
    floor = np.where(logarithmic, least, 1.0)  # keeps the unused power real
    ceiling = np.where(logarithmic, most, 1.0)
    powers = floor ** (1 - unit) * ceiling**unit
    worlds = pd.DataFrame(
        np.where(logarithmic, powers, least + (most - least) * unit), columns=list(PRIORS)
    )
    return worlds.assign(command_delay=(worlds["command_delay"] >= 0.5).astype(int))


def fields_of(world):
    """The fields of Scenario that a world sets, and the free W of the EKF: sigma_ekf_m and _rad.

    At the pace v = μν the headland's radius is v / (κ ω_max demand). With `rows` = 1.25 the robot
    drives one row, one headland and a quarter of the next row.

    Bumps of the correlation length ℓ and of σ rad/s at the paper's speed ν let the yaw walk at
    random by D = √(2ℓ) σ/ν in rad/√m; those of one sample have ℓ = ν Δt / 2.
    """
    world = {name: float(value) for name, value in world.items()}
    for name in ("mu", "kappa"):
        slip = world.pop(f"{name}_slip")
        world[f"{name}_mean"] = 1 - slip
        world[f"{name}_deviation"] = world.pop(f"{name}_variation") * slip
    pace_mps = world["mu_mean"] * world["speed_mps"]
    radius_m = pace_mps / (world["kappa_mean"] * paper.OMEGA_MAX_RADPS * world.pop("turn_demand"))
    rows = world.pop("rows")
    length_m = rows * world["row_length_m"] + np.floor(rows) * np.pi * radius_m
    drive = dict(headland_radius_m=radius_m, duration_s=round(length_m / pace_mps, 1))
    rut_m = max(world["rut_length_m"], paper.SPEED_MPS * paper.DT_S / 2)
    sigma = world.pop("bump_diffusion_radpsqrtm") * paper.SPEED_MPS / np.sqrt(2 * rut_m)
    ground = dict(bump_sigma_radps=sigma, soil_under="tracks")
    sigma_m = world.pop("sigma_ekf_m")
    noise = dict(sigma_ekf_m=sigma_m, sigma_ekf_rad=sigma_m * world.pop("sigma_ekf_ratio_radpm"))
    return world | drive | ground | noise | dict(command_delay=int(world["command_delay"]))


# Drives


_SPEED_NOISE_MPS = 0.001  # of a sample, in the EKF's free W


def noise_of(estimator, w, fields):
    """The fields of Scenario that give an estimator its W in a world.

    Args:
        estimator: "rhe" or "ekf".
        w: Of W_RHE or W_EKF, or another name of a W.
        fields: Of the world (`fields_of`).
    """
    if estimator == "ekf" and w == "free":
        sigma_m = fields["sigma_ekf_m"]
        return dict(sigma_w=(sigma_m, sigma_m, fields["sigma_ekf_rad"], _SPEED_NOISE_MPS))
    return W_RHE.get(w, dict(process_noise=w))


# {name: (estimator, W, weight, whether it needs the first row only)}
VARIANTS = {f"ekf_{w}": ("ekf", w, paper.Q3, False) for w in W_EKF}
for _w in W_RHE:
    VARIANTS[f"rhe_{_w}"] = "rhe", _w, paper.Q3, False
    VARIANTS[f"q1_{_w}"] = "rhe", _w, paper.Q1, True
    VARIANTS[f"q2_{_w}"] = "rhe", _w, paper.Q2, True
OF_PRIOR = tuple(VARIANTS)  # what the prior's worlds drive; the posterior's drive all
# Each rule for both estimators, and what else is driven: {name: (W of the RHE, of the EKF)}.
RULES = {
    "prediction": ("prediction", "prediction"),
    "consistent": ("consistent", "consistent"),
    "tracking": ("tracking", "tracking"),
    "as printed": ("printed", "printed"),
    "RHE as printed, EKF by prediction": ("printed", "prediction"),
}
VARIANTS |= {f"ekf_{w}": ("ekf", w, paper.Q3, False) for _, w in RULES.values()}
VARIANTS |= dict(rhe_tracking=("rhe", "tracking", paper.Q3, False))


def scenario(fields, variant, seed):
    """The Scenario of one drive; it ends with the first row where the variant needs no more."""
    estimator, w, q, first_row = VARIANTS[variant]
    noise = noise_of(estimator, w, fields)
    fields = {name: value for name, value in fields.items() if name not in _NOT_OF_SCENARIO}
    if first_row:
        pace_mps = fields["mu_mean"] * fields["speed_mps"]
        fields = fields | dict(duration_s=round(fields["row_length_m"] / pace_mps, 1))
    drive = Scenario(**fields, **noise, estimator=estimator, q=q, seed=seed)
    if estimator == "rhe":
        return drive
    soil = set_up(drive).terrain
    return dataclasses.replace(drive, terrain=soil, seed=seed + _OTHER_TIME)


_NOT_OF_SCENARIO = "sigma_ekf_m", "sigma_ekf_rad"
_NEVER_S = 6000.0  # a robot that never arrives has settled so late
_EXCURSION_S = 2.0  # violations that are this far apart are of two excursions


def measured(run):
    """What is kept of a drive, by name: SI units, shares, seconds."""
    metrics = run.metrics
    settled_s = metrics["settling_time_s"]
    near = (run.columns["mu_hat"] >= 0.9) & (run.columns["kappa_hat"] >= 0.9)
    excursions, row_m = count_excursions(run, 0.0 if np.isnan(settled_s) else settled_s)
    return dict(
        error=metrics["mean_error_m"],
        violations=metrics["violations"],
        excursions=excursions,
        row_m=row_m,
        near=np.mean(near),
        peak=metrics["omega_peak_radps"] / paper.OMEGA_MAX_RADPS,
        settled=_NEVER_S if np.isnan(settled_s) else settled_s,
        overshoot=metrics["overshoot_m"],
    )


def count_excursions(run, settled_s):
    """How often a robot that has arrived leaves the tolerance by raw GNSS, on how many metres."""
    c = run.columns
    counted = c["on_straight"] & (c["t_s"] >= settled_s + SETTLING_SAMPLES * paper.DT_S)
    beyond_s = c["t_s"][counted & (c["error_m"] > paper.TOLERANCE_M)]
    excursions = len(beyond_s[:1]) + np.sum(np.diff(beyond_s) > _EXCURSION_S)
    steps_m = np.hypot(np.diff(c["x_m"]), np.diff(c["y_m"]))
    return int(excursions), float(steps_m[counted[1:]].sum())


def drive(fields, first_seed, variants=OF_PRIOR):
    """Drive worlds, each on FIELDS fields.

    Args:
        fields: [of `fields_of`, …], one a world.
        first_seed: Of the first world's first field.
        variants: Of VARIANTS.

    Returns:
        DataFrame, one row a world and field, with columns (variant, what `measured` names); NaN in
        the fields that Q¹ and Q² do not drive.
    """
    places = [
        (world, field, variant)
        for world in range(len(fields))
        for variant in variants
        for field in range(ROW_FIELDS if VARIANTS[variant][3] else FIELDS)
    ]
    drives = [
        scenario(fields[world], variant, first_seed + FIELDS * world + field)
        for world, field, variant in places
    ]
    index = pd.MultiIndex.from_tuples(places, names=["world", "field", "variant"])
    table = pd.DataFrame(map_runs(measured, drives), index)
    return table.unstack("variant").swaplevel(axis=1)


# Storage

_INDEX = ["world", "field"]
# Columns of the files are whole numbers of these steps; those of errors are 2 % of the error.
_STEPS = dict(near=0.01, peak=0.01, settled=0.4, overshoot=2e-3, row_m=0.5)
_ON_ROW = ("settled", "overshoot")  # compared with those of Q¹ and Q²
_MOST = 254  # of one byte; 255 where nothing was driven
_LEAST_ERROR_M = 5e-3
_ERROR_STEP = 0.02
_COUNTED = ("error", "violations", "excursions")
_KEPT = dict(
    ekf=_COUNTED,
    rhe=(*_COUNTED, "row_m", "near", "peak", "settled", "overshoot"),
    q1=("settled",),
    q2=("overshoot",),
)


def pack(table):
    """A table of `drive` as bytes: errors between 5 mm and 0.8 m to 2 %, the rest by _STEPS."""
    columns = {}
    for variant in [name for name in VARIANTS if name in table.columns.unique(0)]:
        for name in _KEPT[variant.split("_")[0]]:
            values = table[variant, name]
            if name in _ON_ROW:
                values = values.where(table.index.get_level_values("field") < ROW_FIELDS)
            if name == "error":
                values = np.log(values / _LEAST_ERROR_M) / _ERROR_STEP
            else:
                values = values / _STEPS.get(name, 1)
            whole = values.round().clip(0, _MOST).fillna(_MOST + 1)
            columns[f"{variant}.{name}"] = whole.astype("uint8")
    return pd.DataFrame(columns, table.index)


def unpack(table):
    """The reverse of `pack`, up to rounding."""
    table = table.where(table <= _MOST).astype(float)
    table.columns = pd.MultiIndex.from_tuples([tuple(name.split(".")) for name in table.columns])
    for variant, name in table.columns:
        if name == "error":
            table[variant, name] = _LEAST_ERROR_M * np.exp(_ERROR_STEP * table[variant, name])
        else:
            table[variant, name] *= _STEPS.get(name, 1)
    return table


def _indexed(table):
    """A table whose rows are worlds in order, FIELDS fields each, with that index."""
    rows = np.arange(len(table))
    return table.set_index(pd.MultiIndex.from_arrays([rows // FIELDS, rows % FIELDS], names=_INDEX))


def _write(packed, file):
    packed.to_parquet(file, index=False, compression="zstd", compression_level=19)


def prior_drives():
    """The drives of the prior's worlds that PRIOR_DRIVES holds, as `drive` returns them."""
    return unpack(_indexed(pd.read_parquet(PRIOR_DRIVES)))


def posterior_drives():
    """The drives of the posterior's worlds and of its centre, on fields that no other drive used.

    Returns:
        As `drive`, for the DRAWS worlds of `posterior_table`, and for CENTRE_COPIES of the centre.
    """
    drives = unpack(_indexed(pd.read_parquet(POSTERIOR_DRIVES)))
    rows = DRAWS * FIELDS
    return drives.iloc[:rows], _indexed(drives.iloc[rows:].reset_index(drop=True))


def posterior_table():
    """DRAWS equally likely worlds, given the paper's numbers: fields of Scenario, with
    the W of each estimator, w_rhe and w_ekf.
    """
    return pd.read_csv(POSTERIOR_WORLDS)


def posterior_worlds():
    """Equally likely worlds, given the paper's numbers.

    Returns:
        [{field of Scenario: value}, …], DRAWS of them: soil, sensors, speed, delay, drive, and
        the free W of the EKF.
    """
    return posterior_table().drop(columns=["w_rhe", "w_ekf"]).to_dict("records")


# Statistics


def statistics_of(drives, w_rhe, w_ekf, counts="violations"):
    """The statistics of STATEMENTS of each drive, (n, k), with one of W_RHE and one of W_EKF.

    Errors are logarithms and counts square roots, whose spread depends little on their size. What
    the paper says in words is a shortfall: 0 where it holds, else how far the drive falls short.
    Estimates are close to the bound in the share of samples in which both are at least 0.9. Q¹
    settles at least twice as late as Q³, or not on the first row at all; Q² overshoots at least
    twice as far as Q³. `counts` are "violations", in samples, or "excursions" (G17).
    """
    rhe, ekf, q1, q2 = (
        drives[name] for name in (f"rhe_{w_rhe}", f"ekf_{w_ekf}", f"q1_{w_rhe}", f"q2_{w_rhe}")
    )
    # The table's rows are worlds in order, FIELDS fields each.
    driven = np.arange(len(drives)) // FIELDS * FIELDS + np.arange(len(drives)) % ROW_FIELDS
    settled = rhe["settled"].to_numpy()[driven], q1["settled"].to_numpy()[driven]
    overshoot = (np.maximum(runs["overshoot"].to_numpy()[driven], _FLOOR_M) for runs in (rhe, q2))
    return np.column_stack(
        [
            np.log(rhe["error"]),
            np.log(ekf["error"]),
            np.sqrt(rhe[counts]),
            np.sqrt(ekf[counts]),
            1 - rhe["near"],
            _falls_short_of_twice(*settled),
            _falls_short_of_twice(*overshoot),
            np.maximum(1 - rhe["peak"], 0),
            np.log(ekf["error"] / rhe["error"]),
        ]
    )


def _falls_short_of_twice(one, other):
    """How far ln(other / one) is below ln 2, 0 where it is not."""
    return np.maximum(np.log(2 * one / other), 0)


def observed():
    """The paper's statistics, (k,)."""
    return np.array([statement.observed for statement in STATEMENTS.values()])


def meets(statistics):
    """Which statements drives meet: (n, k) flags of (n, k) statistics."""
    within = np.array([statement.within for statement in STATEMENTS.values()])
    return np.abs(statistics - observed()) <= within + 1e-9  # of rounding


def simulations(drives, unit, counts="violations", printed=None):
    """All simulated experiments: each field of each world with each of CHOICES, in that order.

    The statistics are scaled by the spread of one drive: the standard deviation over the fields of
    a world, as the root mean square over the experiments whose errors are both below the tolerance.

    Args:
        drives: Of `drive`.
        unit: (n, d) the worlds' points.
        counts: As for `statistics_of`.
        printed: Prior probability that an estimator's W is the printed one, of each estimator by
            itself. None: all of W_RHE are equally likely, and so are all of W_EKF.

    Returns:
        An `abc_regression.Simulations`, with the experiments of one choice of W after the other.
    """
    tables = np.stack([statistics_of(drives, *choice, counts) for choice in CHOICES])
    by_world = tables.reshape(len(CHOICES), -1, FIELDS, len(STATEMENTS))
    near = np.all(by_world[..., :2] < np.log(paper.TOLERANCE_M), axis=(2, 3))
    deviations = np.sqrt(by_world[near].var(axis=1, ddof=1).mean(axis=0))
    least = [statement.least_unit for statement in STATEMENTS.values()]
    worlds = np.repeat(np.arange(len(unit)), FIELDS)
    likely = [
        _prior_of(w_rhe, W_RHE, printed) * _prior_of(w_ekf, W_EKF, printed)
        for w_rhe, w_ekf in CHOICES
    ]
    return abc_regression.Simulations(
        unit,
        np.tile(worlds, len(CHOICES)),
        tables.reshape(-1, len(STATEMENTS)),
        np.maximum(deviations, least),
        np.isin(list(PRIORS), _DISCRETE),
        np.repeat(likely, len(worlds)),
    )


def _prior_of(w, choices, printed):
    """The prior probability of one of an estimator's choices of W."""
    alike = [name for name in choices if (name in PRINTED) == (w in PRINTED)]
    if printed is None:
        return 1 / len(choices)
    return (printed if w in PRINTED else 1 - printed) / len(alike)


CHOICES = tuple(itertools.product(W_RHE, W_EKF))  # of W
_FLOOR_M = 1e-3  # an overshoot below 1 mm counts as 1 mm


# The posterior


def posterior_draws(table, n=DRAWS, seed=0):
    """Equally likely worlds with their W, given the paper's numbers.

    Args:
        table: Of `simulations`.
        n: How many.
        seed: Of the draw.

    Returns:
        DataFrame of n worlds, by PRIORS; one of their fields (`fields_of`) with the W of each
        estimator, w_rhe and w_ekf; and the `abc_regression.Draws` that they are from.
    """
    draws = abc_regression.posterior(table, observed(), KEEP)
    unit, rows = abc_regression.resample(draws, n, np.random.default_rng(seed))
    worlds = worlds_at(unit)
    fields = pd.DataFrame(map(fields_of, worlds.to_dict("records")))
    of_choice = len(table.world) // len(CHOICES)
    w_rhe, w_ekf = zip(*(CHOICES[row // of_choice] for row in rows))
    return worlds, fields.assign(w_rhe=w_rhe, w_ekf=w_ekf), draws


PRIORS_ON_PRINTED = (None, 0.8, 0.95)


def sensitivity(drives, unit, n=2000, seed=0):
    """What the posterior says of W and of the world, by how 17 is counted and by the prior on W.

    Args:
        drives, unit: As for `simulations`.
        n: Draws of each posterior.
        seed: Of the draws.

    Returns:
        DataFrame, one row a reading of G17 and one of PRIORS_ON_PRINTED: the probability of each W
        of the RHE and of the printed one of the EKF, medians with 90 % intervals of a few unknowns,
        and how many worlds are effectively behind it.
    """
    rows = {}
    for counts, printed in itertools.product(("violations", "excursions"), PRIORS_ON_PRINTED):
        table = simulations(drives, unit, counts, printed)
        worlds, fields, draws = posterior_draws(table, n, seed)
        row = {f"RHE {w}": f"{np.mean(fields['w_rhe'] == w):.2f}" for w in W_RHE}
        row["EKF printed"] = f"{np.mean(fields['w_ekf'] == 'printed'):.3f}"
        worlds = worlds[fields["w_ekf"].to_numpy() == "free"]
        for name in ("kappa_slip", "slip_difference", "sigma_ekf_m", "sigma_ekf_ratio_radpm"):
            low, median, high = np.quantile(worlds[name], [0.05, 0.5, 0.95])
            row[name] = f"{median:.2g} [{low:.2g}, {high:.2g}]"
        row["effective worlds"] = round(draws.effective_worlds)
        rows[counts, "flat" if printed is None else f"{printed:.0%} printed"] = row
    return pd.DataFrame(rows).T.rename_axis(["17 are", "prior on W"])


def learned(worlds):
    """What the paper's numbers tell of each unknown, by the worlds of `posterior_draws`.

    Returns:
        DataFrame, one row an unknown: its prior's range, the posterior's median and 90 % interval,
        `narrowed`, 1 - the 90 % interval's width over the prior's (on the logarithmic scale where
        the prior is), and the prior's source.
    """
    rows = {}
    for name, prior in PRIORS.items():
        if name in _DISCRETE:
            continue
        low, median, high = np.quantile(worlds[name], [0.05, 0.5, 0.95])
        scale = np.log if prior.logarithmic else np.asarray
        width = (scale(high) - scale(low)) / (scale(prior.most) - scale(prior.least)) / 0.9
        rows[name] = dict(
            prior=f"{prior.least:g} to {prior.most:g}" + ", log" * prior.logarithmic,
            median=median,
            low=low,
            high=high,
            narrowed=1 - width,
            source=prior.source,
        )
    return pd.DataFrame(rows).T.rename_axis("unknown")


def centre():
    """One world in the middle of the posterior: the median of each field, rounded.

    Returns:
        {field of Scenario: value} of soil, ground, sensors and speed.
    """
    medians = posterior_table()[list(_CENTRE_STEPS)].median()
    steps = medians.index.map(_CENTRE_STEPS)
    # Twice: a multiple of a step such as 0.1 has digits beyond it.
    rounded = ((medians / steps).round() * steps).round(6)
    return rounded.to_dict() | dict(soil_under="tracks")


def centre_drive():
    """Rows, headlands, start and length of the posterior's drive: the median of each field."""
    names = ["row_length_m", "headland_radius_m", "start_offset_m", "duration_s"]
    return posterior_table()[names].median().round(1).to_dict()


def centre_noise():
    """The EKF's free W in the middle of the posterior: the medians of its two numbers."""
    return posterior_table()[[*_NOT_OF_SCENARIO]].median().round(4).to_dict()


# What each median is rounded to: finer than the posterior can tell.
_CENTRE_STEPS = {
    "speed_mps": 0.05,
    "mu_mean": 0.005,
    "mu_deviation": 0.001,
    "kappa_mean": 0.005,
    "kappa_deviation": 0.001,
    "correlation_length_m": 0.5,
    "slip_difference": 0.001,
    "rotation_centre_m": 0.1,
    "bump_sigma_radps": 0.001,
    "rut_length_m": 0.1,
    "gnss_sigma_m": 0.001,
    "gnss_slow_share": 0.05,
    "gnss_slow_time_s": 10.0,
    "encoder_sigma_mps": 0.001,
    "speed_sigma_mps": 0.001,
}


def shares(statistics, seed=0):
    """How often one drive gives what the paper states.

    Args:
        statistics: (n, k), the fields of each world next to each other, or (m, n, k) if each world
            was driven with m choices of W.
        seed: Of the bootstrap.

    Returns:
        DataFrame, one row for each of STATEMENTS, one for the four numbers together and one for all
        statements: the share of drives that meet it with a 95 % interval (bootstrap over worlds),
        and the share of worlds, with one W each, in which at least one of the FIELDS drives does.
    """
    flags = _with_totals(meets(statistics))
    by_world = flags.reshape(-1, flags.shape[-2] // FIELDS, FIELDS, flags.shape[-1])
    of_drives = by_world.mean(axis=(0, 2))
    of_worlds = by_world.any(axis=2).mean(axis=0)
    worlds = len(of_drives)
    # How often each world comes in each resample.
    counts = np.random.default_rng(seed).multinomial(
        worlds, np.full(worlds, 1 / worlds), _RESAMPLES
    )
    table = {}
    for name, values in dict(drives=of_drives, worlds=of_worlds).items():
        low, high = np.quantile(counts @ values / worlds, _ENDS, axis=0)
        table |= {name: values.mean(axis=0), f"{name}_low": low, f"{name}_high": high}
    return pd.DataFrame(table, _statement_texts()).rename_axis("statement")


def _with_totals(flags):
    """Flags of STATEMENTS, followed by those of the four numbers together and of all statements."""
    numbers = flags[..., :_NUMBERS].all(axis=-1, keepdims=True)
    return np.concatenate([flags, numbers, flags.all(axis=-1, keepdims=True)], axis=-1)


def _statement_texts():
    texts = [statement.text for statement in STATEMENTS.values()]
    return [*texts, "the four numbers together", "all statements together"]


_RESAMPLES = 1000
_ENDS = (0.025, 0.975)  # of the bootstrap's means


def statistics_with_own_w(drives, worlds):
    """Statistics (n, k) of the drives of worlds that have a W each (`posterior_draws`)."""
    tables = {choice: statistics_of(drives, *choice) for choice in CHOICES}
    own = zip(worlds["w_rhe"], worlds["w_ekf"])
    parts = [
        tables[choice][FIELDS * world : FIELDS * (world + 1)] for world, choice in enumerate(own)
    ]
    return np.concatenate(parts)


def by_rule(drives):
    """RHE and EKF side by side in the drives of worlds, with the W of each of RULES.

    Args:
        drives: Of `drive` with all VARIANTS.

    Returns:
        DataFrame, one row a rule: means over all drives of both errors [m], of violations and of
        excursions on 100 m of row, with 95 % intervals over worlds; the share of drives, and of
        worlds in the mean, in which the RHE's error is the smaller, and of those in which its
        violations are fewer (Clopper and Pearson's interval of the share of worlds).
    """
    rows = {}
    for rule, (w_rhe, w_ekf) in RULES.items():
        both = {"RHE": drives[f"rhe_{w_rhe}"], "EKF": drives[f"ekf_{w_ekf}"]}
        row_m = drives[f"rhe_{w_rhe}"]["row_m"].groupby("world").sum()
        row = {}
        for name, of in both.items():
            by_world = of.groupby("world")
            row[f"error, {name} [m]"] = interval_text(
                *statistics.over_seeds(np.mean, by_world["error"].mean())[:3]
            )
            for counts in ("violations", "excursions"):
                per_row = 100 * by_world[counts].sum() / row_m.where(row_m > 0)
                row[f"{counts} in 100 m, {name}"] = interval_text(
                    *statistics.over_seeds(np.mean, per_row)[:3]
                )
        for column, words in (("error", "error"), ("violations", "violations")):
            rhe, ekf = (of[column] for of in both.values())
            means = [of.groupby("world").mean() for of in (rhe, ekf)]
            worlds = statistics.share(means[0] < means[1])
            row[f"drives with less {words}"] = f"{np.mean(rhe < ekf):.3f}"
            row[f"worlds with less {words}"] = interval_text(worlds.value, worlds.low, worlds.high)
        rows[rule] = row
    return pd.DataFrame(rows).T.rename_axis("rule for W")


def truths(table, n, rng, near=None):
    """At most n rows of `simulations` to check the method on, each of another world.

    They are chosen of all, or of those of the `abc_regression.Draws` near.
    """
    rows = rng.permutation(len(table.world) if near is None else near.rows)
    _, first = np.unique(table.world[rows], return_index=True)
    return rng.permutation(rows[first])[:n]


def repeated(worlds):
    """Drive some worlds of the prior again, by their numbers, and compare with PRIOR_DRIVES.

    Returns:
        DataFrame, one row a world: how many numbers were compared, how many differ, and by how many
        of their steps at most.
    """
    stored = pd.read_parquet(PRIOR_DRIVES)
    unit = sample_unit(len(stored) // FIELDS)
    rows = []
    for world in worlds:
        fields = fields_of(worlds_at(unit[[world]]).iloc[0])
        now = pack(drive([fields], FIRST_SEED + FIELDS * world)).to_numpy(int)
        then = stored.iloc[FIELDS * world : FIELDS * (world + 1)].to_numpy(int)
        off = np.abs(now - then)
        rows.append(dict(numbers=off.size, different=np.sum(off > 0), steps=off.max()))
    return pd.DataFrame(rows, pd.Index(worlds, name="world"))


# Making the files


def drive_prior(n, folder):
    """Packed rows of the first n worlds of the prior, driven in blocks that a folder keeps.

    Blocks of other code, versions or priors are left alone.
    """
    ranges = {name: prior[:3] for name, prior in PRIORS.items()}
    variants = {name: VARIANTS[name] for name in OF_PRIOR}
    design = repr((ranges, variants, W_RHE, tuning.NOISES, _KEPT)).encode()
    design = hashlib.sha256(design).hexdigest()[:16]
    folder = store.open_folder(folder) / design
    folder.mkdir(exist_ok=True)
    blocks = []
    # Blocks are whole, so that a longer campaign can go on with them.
    every = sample_unit(-(-n // _BLOCK) * _BLOCK)
    for first in range(0, n, _BLOCK):
        file = folder / f"{first:06d}.parquet"
        if not file.exists():
            unit = every[first : first + _BLOCK]
            fields = [*map(fields_of, worlds_at(unit).to_dict("records"))]
            packed = pack(drive(fields, FIRST_SEED + FIELDS * first))
            with replacing(file) as unfinished:
                _write(packed, unfinished)
            print(f"worlds {first} to {first + len(unit) - 1}", flush=True)
        blocks.append(pd.read_parquet(file))
    return _indexed(pd.concat(blocks, ignore_index=True).iloc[: n * FIELDS])


def drive_posterior():
    """Drive the posterior's worlds and copies of its centre; packed rows (`posterior_drives`)."""
    middle = centre() | centre_drive() | centre_noise()
    worlds = [*posterior_worlds(), *[middle] * CENTRE_COPIES]
    return pack(drive(worlds, _UNUSED_SEED, tuple(VARIANTS)))


def main():
    """Drive the worlds, find the posterior, drive it, and write all three files."""
    parser = argparse.ArgumentParser(
        "python -m notebooks.studies.which_worlds", description=__doc__
    )
    parser.add_argument("--worlds", type=int, default=WORLDS, help=f"of the prior ({WORLDS})")
    parser.add_argument("--folder", type=Path, default=Path("build/inverse"), help="of the blocks")
    options = parser.parse_args()
    if not 1 <= options.worlds <= _MOST_WORLDS:
        parser.exit(2, f"--worlds was {options.worlds}; it should be 1 to {_MOST_WORLDS}\n")
    _write(drive_prior(options.worlds, options.folder), PRIOR_DRIVES)
    table = simulations(prior_drives(), sample_unit(options.worlds))
    _, fields, draws = posterior_draws(table)
    fields.to_csv(POSTERIOR_WORLDS, index=False, float_format="%.5g")
    _write(drive_posterior(), POSTERIOR_DRIVES)
    print(f"{draws.effective_worlds:.0f} effective worlds; centre: {centre()}")


if __name__ == "__main__":
    main()
