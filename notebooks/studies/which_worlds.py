"""Which worlds give the paper's numbers: the inverse problem of its field experiment.

The paper states what its robot did, and neither soil nor speed nor which way its path turned. Here
soil, sensors, speed and drive are drawn from PRIORS and CHOICES_OF, each world is driven on several
fields by the paper's robots, and approximate Bayesian computation
(`notebooks.studies.abc_regression`) finds the worlds in which one drive gives what the paper states
(STATEMENTS). Worlds of a first round are the prior's; those of a second are near the first ones
that came near the paper, with weights that make up for it.

The paper is one drive with each estimator. So the simulation that is compared with it is one
drive on one field, never the mean of several. The two drives are on the same soil at different
times, so that their noise differs. W is unknown, too: that of either estimator is printed or free.
None is one that was tuned in the default world, so that the posterior does not depend on it.

`python -m notebooks.studies.which_worlds` drives all worlds, in about ten minutes of two quiet
cores, and writes `data/prior_drives.parquet`, `data/posterior_worlds.csv` and
`data/posterior_drives.parquet`. What depends on rules for W is in
`notebooks.studies.order_in_worlds`.
"""

import dataclasses
import itertools
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from notebooks.declared import ROOT
from notebooks.studies import abc_regression
from notebooks.studies.parallel import map_runs
from notebooks.studies.statistics import share_interval
from rhec import paper
from rhec.simulation.closed_loop import set_up
from rhec.simulation.metrics import SETTLING_SAMPLES
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.path import Path

DATA = ROOT / "data"
PRIOR_DRIVES = DATA / "prior_drives.parquet"
POSTERIOR_WORLDS = DATA / "posterior_worlds.csv"
POSTERIOR_DRIVES = DATA / "posterior_drives.parquet"

FIRST_ROUND = 2048  # worlds of the prior
SECOND_ROUND = 2560  # worlds near those of the first that came near the paper
KEEP_FIRST = 800  # nearest simulations of the first round, behind the second
FIELDS = 2  # of each world
FIRST_SEED = 2000  # beyond held-out and training seeds; world k has FIRST_SEED + 2 k and the next
_BLOCK = 256  # worlds that are driven at a time, whose soils have to fit into memory
KEEP = 4200  # nearest simulations behind a posterior
DRAWS = 480  # worlds in POSTERIOR_WORLDS
COPIES = 64  # of the default world, and of the centre, in POSTERIOR_DRIVES
UNUSED_SEED = FIRST_SEED + 2**20  # no world of either round has these fields
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
_SIGMA = "judged: none to ten times that of the GNSS"
_RATIO = "judged: a heading, and an estimator, that last"
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
    "row_length_m": Prior(15.0, 30.0, False, "judged; the paper gives no length"),
    "rows": Prior(1.2, 3.2, False, "judged: straight and curved lines, no length given"),
    "turn_demand": Prior(0.6, 0.9, False, "judged: headlands that the yaw rate's bound allows"),
    "start_offset_m": Prior(0.3, 1.5, False, "judged: the paper starts off-track"),
    "sigma_rhe_m": Prior(0.001, 0.3, True, _SIGMA),
    "sigma_rhe_ratio_radpm": Prior(0.1, 10.0, True, _RATIO),
    "sigma_rhe_traction": Prior(0.001, 0.3, True, "judged: constant to as fast as printed"),
    "sigma_ekf_m": Prior(0.001, 0.3, True, _SIGMA),
    "sigma_ekf_ratio_radpm": Prior(0.1, 10.0, True, _RATIO),
}


# Unknowns that are one of a few, each as likely as the others. The first turn is to the left by
# convention: a world and its mirror image give the same numbers, so that turns to the right alone
# are turns to the left with the opposite slip_difference.
CHOICES_OF = {
    "turns": ("left", "alternate", "figure_of_eight"),  # the paper does not say (G18)
    "start_side": (1, -1),  # to the left of the path or to its right
    "command_delay": (0, 1),  # either reading of eq. (13) (G10)
}
UNKNOWNS = (*PRIORS, *CHOICES_OF)

# Fields of Scenario; G7 belongs to the printed W.
W_RHE = {
    "printed": dict(process_noise="printed"),
    "smoothed": dict(process_noise="printed", arrival_mean="smoothed"),
    "free": {},  # sigma_rhe_m, sigma_rhe_ratio_radpm and sigma_rhe_traction of the world
}
W_EKF = ("printed", "free")  # free: sigma_ekf_m and sigma_ekf_ratio_radpm of the world
PRINTED = "printed", "smoothed"  # the W of the paper, of either estimator
CHOICES = tuple(itertools.product(W_RHE, W_EKF))  # of W


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
}
_NUMBERS = 4  # the first of STATEMENTS are printed numbers


# Worlds


class Design(NamedTuple):
    """Which worlds are driven.

    Attributes:
        unit: (n, d) their points between 0 and 1, where the prior is uniform.
        weights: (n,) by which they stand for the prior.
    """

    unit: np.ndarray
    weights: np.ndarray


def first_round(n=FIRST_ROUND):
    """The Design of the first n worlds of the prior: a scrambled Sobol sequence."""
    return Design(_sobol(FIRST_ROUND, seed=0)[:n], np.ones(n))


def both_rounds(drives):
    """The Design of all worlds that were driven: those of the prior, then those near the paper.

    Args:
        drives: Of the first round alone, or of both.
    """
    first = first_round()
    table = simulations(drives.iloc[: FIELDS * FIRST_ROUND], first)
    near = abc_regression.posterior(table, observed(), KEEP_FIRST)
    proposal = abc_regression.proposal(near, table.discrete)
    second = proposal.unit_at(_sobol(SECOND_ROUND, seed=1))
    unit = np.concatenate([first.unit, second])
    return Design(unit, proposal.weights(unit, FIRST_ROUND / len(unit)))


def _sobol(n, seed):
    """n points (n, d) of a scrambled Sobol sequence."""
    sequence = stats.qmc.Sobol(len(UNKNOWNS), rng=np.random.default_rng(seed))
    return sequence.random_base2((n - 1).bit_length())[:n]


def worlds_at(unit):
    """Worlds at points (n, d) between 0 and 1, by the priors' quantiles: DataFrame (n, UNKNOWNS).

    A point u becomes least + (most - least) u, or least^(1-u) most^u on a logarithmic scale. Of a
    choice between k values, each has the k-th part of the range.
    """
    least, most, logarithmic, _ = map(np.array, zip(*PRIORS.values()))
    floor = np.where(logarithmic, least, 1.0)  # keeps the unused power real
    ceiling = np.where(logarithmic, most, 1.0)
    of_range = unit[:, : len(PRIORS)]
    powers = floor ** (1 - of_range) * ceiling**of_range
    values = np.where(logarithmic, powers, least + (most - least) * of_range)
    worlds = pd.DataFrame(values, columns=list(PRIORS))
    for (name, values), of_choice in zip(CHOICES_OF.items(), unit[:, len(PRIORS) :].T):
        places = np.minimum((of_choice * len(values)).astype(int), len(values) - 1)
        worlds[name] = [values[place] for place in places]
    return worlds


def fields_of(world):
    """The fields of Scenario that a world sets, and the free W of RHE and EKF (sigma_rhe_…, …).

    At the pace v = μν the headland's radius is v / (κ ω_max demand). With `rows` = 1.25 the robot
    drives one row, one headland and a quarter of the next row.

    Bumps of the correlation length ℓ and of σ rad/s at the paper's speed ν let the yaw walk at
    random by D = √(2ℓ) σ/ν in rad/√m; those of one sample have ℓ = ν Δt / 2.
    """
    world = dict(world)
    for name in ("mu", "kappa"):
        slip = world.pop(f"{name}_slip")
        world[f"{name}_mean"] = 1 - slip
        world[f"{name}_deviation"] = world.pop(f"{name}_variation") * slip
    world["start_offset_m"] *= world.pop("start_side")
    pace_mps = world["mu_mean"] * world["speed_mps"]
    radius_m = pace_mps / (world["kappa_mean"] * paper.OMEGA_MAX_RADPS * world.pop("turn_demand"))
    drive = dict(
        headland_radius_m=radius_m,
        duration_s=duration_s(world.pop("rows"), world | dict(headland_radius_m=radius_m)),
    )
    rut_m = max(world["rut_length_m"], paper.SPEED_MPS * paper.DT_S / 2)
    sigma = world.pop("bump_diffusion_radpsqrtm") * paper.SPEED_MPS / (2 * rut_m) ** 0.5
    ground = dict(bump_sigma_radps=sigma, soil_under="tracks")
    noise = {
        f"sigma_{name}_rad": world[f"sigma_{name}_m"] * world.pop(f"sigma_{name}_ratio_radpm")
        for name in ("rhe", "ekf")
    }
    return world | drive | ground | noise


def duration_s(rows, fields):
    """How long a drive over so many rows, with the headlands between them, takes [s]."""
    path = Path.rows(fields["row_length_m"], fields["headland_radius_m"], fields["turns"])
    row_m, turn_m = np.diff(path.segments[:3, 0])
    length_m = rows * row_m + np.floor(rows) * turn_m
    return round(float(length_m / (fields["mu_mean"] * fields["speed_mps"])), 1)


# Drives


_SPEED_NOISE_MPS = 0.001  # of a sample, in a free W


def noise_of(estimator, w, fields):
    """The fields of Scenario that give an estimator its W in a world.

    A free W is one of the paper's two estimators; others have theirs by prediction instead, and so
    has what else a rule picks.

    Args:
        estimator: Of Scenario.
        w: Of W_RHE or W_EKF, the name of a rule for W, or "fitted", which a world must have in
            fitted_rhe and fitted_ekf.
        fields: Of the world (`fields_of`).
    """
    if w == "fitted":
        return fields[f"fitted_{estimator}"]
    if w == "free" and estimator not in ("rhe", "ekf"):
        return dict(process_noise="prediction")
    if w != "free":
        return W_RHE.get(w, dict(process_noise=w))
    sigma_m = fields[f"sigma_{estimator}_m"]
    sigma_w = (sigma_m, sigma_m, fields[f"sigma_{estimator}_rad"], _SPEED_NOISE_MPS)
    if estimator == "rhe":
        sigma_w += (fields["sigma_rhe_traction"],) * 2
    return dict(process_noise="prediction", sigma_w=sigma_w, sigma_v=paper.SIGMA_V)


class Variant(NamedTuple):
    """A robot that is driven in a world.

    Attributes:
        estimator: "rhe" or "ekf".
        w: Of W_RHE or W_EKF, or the name of a rule for W.
        q: Weight of the controller.
        first_row: Whether the drive ends with the first row.
    """

    estimator: str
    w: str
    q: tuple = paper.Q3
    first_row: bool = False


# What the prior's worlds drive.
VARIANTS = {f"ekf_{w}": Variant("ekf", w) for w in W_EKF}
for _w in W_RHE:
    VARIANTS[f"rhe_{_w}"] = Variant("rhe", _w)
    VARIANTS[f"q1_{_w}"] = Variant("rhe", _w, paper.Q1, first_row=True)
    VARIANTS[f"q2_{_w}"] = Variant("rhe", _w, paper.Q2, first_row=True)


def scenario(fields, variant, seed, paired=False):
    """The Scenario of one drive of a Variant in a world.

    Args:
        fields: Of the world (`fields_of`).
        variant: The Variant.
        seed: Of its field, and of the noise.
        paired: Whether RHE and EKF have the same noise. Else the EKF has one of its own, as in the
            paper, whose drives were at two times.
    """
    noise = noise_of(variant.estimator, variant.w, fields)
    of_world = {name: of for name, of in fields.items() if name not in NOT_OF_SCENARIO}
    if variant.first_row:
        of_world |= dict(duration_s=duration_s(1.0 - 1e-9, fields))
    names = dict(estimator=variant.estimator, q=variant.q)
    drive = Scenario(**of_world | noise | names, seed=seed)
    if paired or variant.estimator == "rhe":
        return drive
    soil = set_up(drive).terrain
    return dataclasses.replace(drive, terrain=soil, seed=seed + _OTHER_TIME)


NOT_OF_SCENARIO = (
    "sigma_rhe_m",
    "sigma_rhe_rad",
    "sigma_rhe_traction",
    "sigma_ekf_m",
    "sigma_ekf_rad",
    "fitted_rhe",
    "fitted_ekf",
)
_NEVER_S = 6000.0  # a robot that never arrives has settled so late
_EXCURSION_S = 2.0  # violations that are this far apart are of two excursions


def measured(run):
    """What is kept of a drive, by name: SI units, shares, seconds."""
    metrics = run.metrics
    settled_s = metrics["settling_time_s"]
    near = (run.columns["mu_hat"] >= 0.9) & (run.columns["kappa_hat"] >= 0.9)
    return dict(
        error=metrics["mean_error_m"],
        violations=metrics["violations"],
        excursions=count_excursions(run, 0.0 if np.isnan(settled_s) else settled_s),
        near=np.mean(near),
        peak=metrics["omega_peak_radps"] / paper.OMEGA_MAX_RADPS,
        settled=_NEVER_S if np.isnan(settled_s) else settled_s,
        overshoot=metrics["overshoot_m"],
    )


def count_excursions(run, settled_s):
    """How often a robot that has arrived leaves the tolerance by raw GNSS."""
    c = run.columns
    counted = c["on_straight"] & (c["t_s"] >= settled_s + SETTLING_SAMPLES * paper.DT_S)
    beyond_s = c["t_s"][counted & (c["error_m"] > paper.TOLERANCE_M)]
    return int(len(beyond_s[:1]) + np.sum(np.diff(beyond_s) > _EXCURSION_S))


def drive(worlds, first_seed, variants=None, fields=FIELDS, paired=False):
    """Drive worlds, each on so many fields.

    Args:
        worlds: [of `fields_of`, …].
        first_seed: Of the first world's first field.
        variants: {name: Variant}; None: VARIANTS.
        fields: How many of each world.
        paired: As for `scenario`.

    Returns:
        DataFrame, one row a world and field, with columns (variant, what `measured` names).
    """
    variants = VARIANTS if variants is None else variants
    index = pd.MultiIndex.from_product(
        [range(len(worlds)), range(fields), variants], names=[*_INDEX, "variant"]
    )
    drives = [
        scenario(worlds[world], variants[variant], first_seed + fields * world + field, paired)
        for world, field, variant in index
    ]
    table = pd.DataFrame(map_runs(measured, drives), index)
    return table.unstack("variant").swaplevel(axis=1)


# Storage

_INDEX = ["world", "field"]
# What is kept of the prior's drives, by the beginning of a variant's name.
_COUNTED = ("error", "violations", "excursions")
_KEPT = dict(
    ekf=_COUNTED,
    rhe=(*_COUNTED, "near", "peak", "settled", "overshoot"),
    q1=("settled",),
    q2=("overshoot",),
)


def kept(table):
    """The columns of a table of `drive` that are stored, as 16-bit numbers (three digits)."""
    columns = [
        (variant, name)
        for variant in VARIANTS
        if variant in table.columns.unique(0)
        for name in _KEPT[variant.split("_")[0]]
    ]
    return table[columns].astype(np.float16)


def write(table, file):
    """Write a table of `drive`, whose worlds are in order."""
    flat = table.set_axis([".".join(names) for names in table.columns], axis=1)
    flat.to_parquet(file, index=False, compression="zstd", compression_level=19)


def read(file):
    """A table of `drive` from a file."""
    table = pd.read_parquet(file).astype(float)
    columns = pd.MultiIndex.from_tuples([name.split(".") for name in table.columns])
    return _numbered(table.set_axis(columns, axis=1))


def _numbered(table):
    """A table of `drive` whose worlds follow one another, with their numbers from 0 on."""
    rows = np.arange(len(table))
    index = pd.MultiIndex.from_arrays([rows // FIELDS, rows % FIELDS], names=_INDEX)
    return table.set_index(index)


def prior_drives():
    """The drives of the first and second round that PRIOR_DRIVES holds, as of `drive`."""
    return read(PRIOR_DRIVES)


def posterior_table():
    """DRAWS equally likely worlds, given the paper's numbers: fields of Scenario, with
    the W of each estimator, w_rhe and w_ekf.

    They were drawn when the rows of `simulations` stood in another order, and all further files
    rest on them. `main` draws other worlds of the same posterior: of the 24 unknowns none is
    distributed otherwise (Kolmogorov and Smirnov, each p at least 0.13).
    """
    return pd.read_csv(POSTERIOR_WORLDS)


def posterior_worlds():
    """Equally likely worlds, given the paper's numbers.

    Returns:
        [{field of Scenario: value}, …], DRAWS of them: soil, sensors, speed, delay, drive, and
        the free W of both estimators.
    """
    return posterior_table().drop(columns=["w_rhe", "w_ekf", "world"]).to_dict("records")


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
    overshoots = (np.maximum(of["overshoot"], _FLOOR_M) for of in (rhe, q2))
    return np.column_stack(
        [
            np.log(rhe["error"]),
            np.log(ekf["error"]),
            np.sqrt(rhe[counts]),
            np.sqrt(ekf[counts]),
            1 - rhe["near"],
            _falls_short_of_twice(rhe["settled"], q1["settled"]),
            _falls_short_of_twice(*overshoots),
            np.maximum(1 - rhe["peak"], 0),
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


def simulations(drives, design, counts="violations", printed=0.5):
    """All simulated experiments: each field of each world with each of CHOICES, in that order.

    The statistics are scaled by the spread of one drive: the standard deviation over the fields of
    a world, as the root mean square over the experiments whose errors are both below the tolerance.

    Args:
        drives: Of `drive`.
        design: The Design of the worlds.
        counts: As for `statistics_of`.
        printed: Prior probability that an estimator's W is the printed one, of each estimator by
            itself.

    Returns:
        An `abc_regression.Simulations`, with the experiments of one choice of W after the other.
    """
    tables = np.stack([statistics_of(drives, *choice, counts) for choice in CHOICES])
    by_world = tables.reshape(len(CHOICES), -1, FIELDS, len(STATEMENTS))
    near = np.all(by_world[..., :2] < np.log(paper.TOLERANCE_M), axis=(2, 3))
    deviations = np.sqrt(by_world[near].var(axis=1, ddof=1).mean(axis=0))
    least = [statement.least_unit for statement in STATEMENTS.values()]
    worlds = np.repeat(np.arange(len(design.unit)), FIELDS)
    likely = [
        _prior_of(w_rhe, W_RHE, printed) * _prior_of(w_ekf, W_EKF, printed)
        for w_rhe, w_ekf in CHOICES
    ]
    return abc_regression.Simulations(
        design.unit,
        np.tile(worlds, len(CHOICES)),
        tables.reshape(-1, len(STATEMENTS)),
        np.maximum(deviations, least),
        np.isin(UNKNOWNS, list(CHOICES_OF)),
        np.outer(likely, design.weights[worlds]).ravel(),
    )


def _prior_of(w, choices, printed):
    """The prior probability of one of an estimator's choices of W."""
    alike = [name for name in choices if (name in PRINTED) == (w in PRINTED)]
    return (printed if w in PRINTED else 1 - printed) / len(alike)


_FLOOR_M = 1e-3  # an overshoot below 1 mm counts as 1 mm


# The posterior


def posterior_draws(table, n=DRAWS, seed=0, keep=None):
    """Equally likely worlds with their W, given the paper's numbers.

    Args:
        table: Of `simulations`.
        n: How many.
        seed: Of the draw.
        keep: How many of the nearest simulations count; None: KEEP.

    Returns:
        DataFrame of n worlds, by UNKNOWNS, NaN where a W is not free; one of their fields
        (`fields_of`) with the W of each estimator, w_rhe and w_ekf, and the `world` of the table
        that each is from; and the `abc_regression.Draws` that they are from.
    """
    draws = abc_regression.posterior(table, observed(), keep or KEEP)
    unit, rows = abc_regression.resample(draws, n, np.random.default_rng(seed))
    worlds = worlds_at(unit)
    fields = pd.DataFrame(map(fields_of, worlds.to_dict("records")))
    of_choice = len(table.world) // len(CHOICES)
    w_rhe, w_ekf = zip(*(CHOICES[row // of_choice] for row in rows))
    fields = fields.assign(w_rhe=w_rhe, w_ekf=w_ekf, world=table.world[rows])
    for estimator in ("rhe", "ekf"):
        names = [name for name in PRIORS if name.startswith(f"sigma_{estimator}")]
        worlds.loc[fields[f"w_{estimator}"] != "free", names] = np.nan
    return worlds, fields, draws


PRIORS_ON_PRINTED = (0.5, 0.8, 0.95)
KEPT = (250, 500, 1000, 2000, 4200)  # simulations, in `by_kept`


def sensitivity(drives, design, n, seed):
    """What the posterior says of W and of the world, by how 17 is counted and by the prior on W.

    Args:
        drives, design: As for `simulations`.
        n: Draws of each posterior.
        seed: Of the draws.

    Returns:
        DataFrame, one row a reading of G17 and one of PRIORS_ON_PRINTED: as `_summary`.
    """
    rows = {}
    for counts, printed in itertools.product(("violations", "excursions"), PRIORS_ON_PRINTED):
        table = simulations(drives, design, counts, printed)
        rows[counts, f"{printed:.0%}"] = _summary(*posterior_draws(table, n, seed))
    return pd.DataFrame(rows).T.rename_axis(["17 are", "prior on the printed W"])


def by_kept(table, n, seed):
    """What the posterior says of W and of the world, by how many of the simulations are kept.

    Args:
        table: Of `simulations`.
        n, seed: As for `sensitivity`.

    Returns:
        DataFrame, one row for each of KEPT: the largest distance to the paper, in spreads of one
        drive, and as `_summary`.
    """
    rows = {}
    for keep in KEPT:
        worlds, fields, draws = posterior_draws(table, n, seed, keep)
        off = (table.statistics[draws.rows] - observed()) / table.scales
        distance = np.sqrt(np.square(off).sum(axis=1)).max()
        rows[keep] = {"largest distance": f"{distance:.2f}"} | _summary(worlds, fields, draws)
    return pd.DataFrame(rows).T.rename_axis("kept")


def _summary(worlds, fields, draws):
    """Of a posterior: effective worlds, probabilities of choices, medians with 90 % intervals."""
    row = {"effective worlds": f"{draws.effective_worlds:.0f}"}
    row |= {f"RHE {w}": f"{np.mean(fields['w_rhe'] == w):.3f}" for w in W_RHE}
    row["EKF printed"] = f"{np.mean(fields['w_ekf'] == 'printed'):.3f}"
    row |= {turns: f"{np.mean(worlds['turns'] == turns):.2f}" for turns in CHOICES_OF["turns"]}
    sizes = worlds.assign(slip_difference_size=worlds["slip_difference"].abs())
    for name in ("mu_slip", "kappa_slip", "slip_difference", "slip_difference_size"):
        row[name] = _median_text(sizes[name])
    return row


def _median_text(values):
    """The median of values with the interval of their middle 90 %."""
    low, median, high = np.quantile(values, [0.05, 0.5, 0.95])
    return f"{median:.2g} [{low:.2g}, {high:.2g}]"


def learned(worlds):
    """What the paper's numbers tell of each unknown, by the worlds of `posterior_draws`.

    Returns:
        DataFrame, one row an unknown with a range: that of its prior, the posterior's median and
        90 % interval, `narrowed`, 1 - the 90 % interval's width over the prior's (on the
        logarithmic scale where the prior is), and the prior's source.
    """
    rows = {}
    for name, prior in PRIORS.items():
        low, median, high = np.quantile(worlds[name].dropna(), [0.05, 0.5, 0.95])
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

    A world and its mirror image are equally likely, so of `slip_difference` it is the median of the
    size: without a hand to tell, its own median is about 0, where few of the worlds are.

    Returns:
        {field of Scenario: value} of soil, ground, sensors and speed.
    """
    table = posterior_table()
    table = table.assign(slip_difference=table["slip_difference"].abs())
    medians = table[list(_CENTRE_STEPS)].median()
    steps = medians.index.map(_CENTRE_STEPS)
    # Twice: a multiple of a step such as 0.1 has digits beyond it.
    rounded = ((medians / steps).round() * steps).round(6)
    return rounded.to_dict() | dict(soil_under="tracks")


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


_RESAMPLES = 1000
_ENDS = (0.025, 0.975)  # of the bootstrap's medians


def beside_the_default(seed=0):
    """The posterior's median of each field of a world beside the default of Scenario.

    Args:
        seed: Of the bootstrap over worlds.

    Returns:
        DataFrame, one row a field: the default, the posterior's median with its 95 % interval
        (bootstrap over the posterior's worlds), the middle 90 % of the posterior, and in which of
        its quantiles the default lies.
    """
    table = posterior_table()
    table = table.assign(slip_difference=table["slip_difference"].abs())
    _, of_world = np.unique(table["world"], return_inverse=True)
    rng = np.random.default_rng(seed)
    worlds = of_world.max() + 1
    # How often each world comes in each resample.
    counts = rng.multinomial(worlds, np.full(worlds, 1 / worlds), _RESAMPLES)
    rows = {}
    for name in _CENTRE_STEPS:
        values = table[name].to_numpy()
        order = np.argsort(values)
        weights = np.cumsum(counts[:, of_world[order]], axis=1)
        medians = values[order][np.argmax(weights >= weights[:, -1:] / 2, axis=1)]
        low, high = np.quantile(medians, _ENDS)
        default = getattr(Scenario(), name)
        rows[name] = dict(
            default=default,
            median=np.median(values),
            low=low,
            high=high,
            p5=np.quantile(values, 0.05),
            p95=np.quantile(values, 0.95),
            quantile=np.mean(values < default),
        )
    return pd.DataFrame(rows).T.rename_axis("field")


def middle_worlds():
    """Two worlds with a drive of the posterior's medians, turning to alternate sides.

    The medians are those of the length of a row and of the whole drive, of the offset at the start,
    and of the share of the yaw rate's bound that a headland demands, so that each world has
    headlands for its own speed.

    Returns:
        {"default": fields, "centre": fields}: the world of Scenario and `centre`, with the medians
        of the free W.
    """
    table = posterior_table()
    pace_mps = table["mu_mean"] * table["speed_mps"]
    tightest_m = pace_mps / (table["kappa_mean"] * paper.OMEGA_MAX_RADPS)
    demand = (tightest_m / table["headland_radius_m"]).median()
    driven_m = (pace_mps * table["duration_s"]).median()
    drive = dict(turns="alternate", command_delay=0)
    for name in ("row_length_m", "start_offset_m"):
        drive[name] = float(table[name].abs().median().round(1))
    for estimator in ("rhe", "ekf"):
        names = [name for name in NOT_OF_SCENARIO if name.startswith(f"sigma_{estimator}")]
        of_free = table[table[f"w_{estimator}"] == "free"]
        drive |= of_free[names].median().round(4).to_dict()
    found = {}
    middle = centre()
    default = {name: getattr(Scenario(), name) for name in middle}
    for name, of in dict(default=default, centre=middle).items():
        pace = of["mu_mean"] * of["speed_mps"]
        radius_m = pace / (of["kappa_mean"] * paper.OMEGA_MAX_RADPS * demand)
        length = dict(
            headland_radius_m=float(radius_m), duration_s=round(float(driven_m / pace), 1)
        )
        found[name] = of | drive | length
    return found


def drive_posterior():
    """Drive the posterior's worlds, and COPIES of each of `middle_worlds`, on unused fields."""
    middle = [world for world in middle_worlds().values() for _ in range(COPIES)]
    return kept(drive([*posterior_worlds(), *middle], UNUSED_SEED))


def posterior_drives():
    """The drives that POSTERIOR_DRIVES holds.

    Returns:
        {"posterior", "default", "centre": as of `drive`}, for the worlds of `posterior_table`, and
        for COPIES of each of `middle_worlds`.
    """
    drives = read(POSTERIOR_DRIVES)
    ends = np.cumsum([0, DRAWS, COPIES, COPIES]) * FIELDS
    names = ("posterior", "default", "centre")
    return {name: drives.iloc[ends[k] : ends[k + 1]] for k, name in enumerate(names)}


def shares(statistics, effective=None):
    """How often one drive gives what the paper states.

    Args:
        statistics: (n, k), the fields of each world next to each other, or (m, n, k) if each world
            was driven with m choices of W.
        effective: How many worlds are effectively behind it, for the intervals; None: all.

    Returns:
        DataFrame, one row for each of STATEMENTS, one for the four numbers together and one for all
        statements: the share of drives that meet it with a 95 % interval (`effective_share`),
        where the drives of a world count as one.
    """
    flags = meets(statistics)
    numbers = flags[..., :_NUMBERS].all(axis=-1, keepdims=True)
    flags = np.concatenate([flags, numbers, flags.all(axis=-1, keepdims=True)], axis=-1)
    texts = [statement.text for statement in STATEMENTS.values()]
    texts += ["the four numbers together", "all statements together"]
    n = effective or flags.shape[-2] / FIELDS
    rows = [effective_share(value, n) for value in flags.reshape(-1, len(texts)).mean(axis=0)]
    columns = ["drives", "drives_low", "drives_high"]
    return pd.DataFrame(rows, texts, columns).rename_axis("statement")


def effective_share(value, n):
    """A share with its 95 % interval (`statistics.share_interval`), n the effective trials."""
    return value, *share_interval(value * n, n)


def effective_number(worlds):
    """Kish's effective number of different worlds among draws, given the world of each."""
    counts = np.unique(worlds, return_counts=True)[1]
    return counts.sum() ** 2 / np.square(counts).sum()


def statistics_with_own_w(drives, worlds):
    """Statistics (n, k) of the drives of worlds that have a W each (`posterior_draws`)."""
    tables = {choice: statistics_of(drives, *choice) for choice in CHOICES}
    own = zip(worlds["w_rhe"], worlds["w_ekf"])
    parts = [
        tables[choice][FIELDS * world : FIELDS * (world + 1)] for world, choice in enumerate(own)
    ]
    return np.concatenate(parts)


def truths(table, n, rng, near):
    """At most n rows of `simulations` to check the method on, each of another world.

    They are chosen as the prior has them, of all (near None), or of those of the
    `abc_regression.Draws` near.
    """
    rows = np.arange(len(table.world)) if near is None else near.rows
    # Exponential races: the first n are a draw without replacement by the prior's weights.
    rows = rows[np.argsort(rng.exponential(size=len(rows)) / table.prior[rows])]
    _, first = np.unique(table.world[rows], return_index=True)
    return rows[np.sort(first)[:n]]


# Making the files


def drive_round(unit, first_world):
    """Drive worlds at points (n, d) between 0 and 1, as `prior_drives` has them.

    Args:
        unit: The points.
        first_world: Number of the first, which fixes its seeds.
    """
    tables = []
    for first in range(0, len(unit), _BLOCK):
        of_block = unit[first : first + _BLOCK]
        worlds = [*map(fields_of, worlds_at(of_block).to_dict("records"))]
        number = first_world + first
        tables.append(kept(drive(worlds, FIRST_SEED + FIELDS * number)))
        print(f"worlds {number} to {number + len(worlds) - 1}", flush=True)
    return _numbered(pd.concat(tables).astype(float))


def main():
    """Drive the worlds of both rounds, and write them and the posterior's."""
    first = drive_round(first_round().unit, 0)
    design = both_rounds(first)
    second = drive_round(design.unit[FIRST_ROUND:], FIRST_ROUND)
    write(pd.concat([first, second]).astype(np.float16), PRIOR_DRIVES)
    _, fields, _ = posterior_draws(simulations(prior_drives(), design))
    fields.to_csv(POSTERIOR_WORLDS, index=False, float_format="%.5g")
    write(drive_posterior(), POSTERIOR_DRIVES)


if __name__ == "__main__":
    main()
