"""RHE or EKF: which is the better in the worlds in which the paper's numbers are possible.

The worlds are those of `notebooks.studies.which_worlds`. In each, RHE and EKF drive with W by the
same rule. By prediction it is fitted in each world (`fitted_noises`): this rule needs no truth, so
that whoever works in that world can follow it there. The other rules need the truth. They have the
W that was tuned in the default world, as if one had moved on with it; so has PREDICTION_OF_DEFAULT.

`python -m notebooks.studies.order_in_worlds` makes all files of this module in data/.
"""

import argparse

import numpy as np
import pandas as pd
from scipy import stats

from notebooks.studies import which_worlds
from notebooks.studies.parallel import map_runs, parallel_map
from notebooks.studies.which_worlds import DATA, UNKNOWNS, UNUSED_SEED, Variant
from rhec import paper
from rhec.simulation.offline import deviances
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import tuning

NOISES = DATA / "posterior_noises.csv"
ORDER_DRIVES = DATA / "order_drives.parquet"
EFFECTS = DATA / "order_effects.csv"

ESTIMATORS = ("rhe", "ekf")
PREDICTION_OF_DEFAULT = "prediction, as in the default world"
# {rule: W}, a name of `which_worlds.noise_of`.
RULES = {
    "printed": "printed",
    "consistent": "consistent",
    "prediction": "fitted",
    "tracking": "tracking",
    PREDICTION_OF_DEFAULT: "prediction",
}


# W and V by prediction, in each world

_TRAINING_SEED = UNUSED_SEED + 2**20  # of the first world's first training drive
_TRAINING_DRIVES = 2
_TRAINING_ROWS = 1.5  # one row, a headland and half a row
_CANDIDATES = 32  # of a generation
_ELITE = 8  # of those, about which the next generation is drawn
_GENERATIONS = 8
_FIRST_DEVIATION = 1.0  # of a logarithm
_LEAST = 1e-3  # less than 1 mm, 1 mrad or 1 mm/s has no effect
_MOST = 10.0
# The places in (sigma_w, sigma_v) that each unknown sets. That of the speed in W stays _LEAST, and
# the EKF has no σ_ω, since its yaw rate is an input.
_PLACES = {
    "rhe": [(0, 1), (2,), (4,), (5,), (6, 7), (8,), (9,)],
    "ekf": [(0, 1), (2,), (4, 5), (6,)],
}
_FIRST = {"rhe": (0.003, 0.01, 0.002, 0.002, 0.015, 0.025, 0.03)}
_FIRST["ekf"] = (0.003, 0.01, 0.015, 0.025)


def fitted_noises(worlds):
    """W and V of RHE and EKF by one-step prediction in each world, on training drives there.

    The true state is in the loop, so that the measurements do not depend on any estimator.

    Args:
        worlds: [of `which_worlds.fields_of`, …].

    Returns:
        DataFrame, one row a world and estimator: sigma_w and sigma_v, numbers that spaces separate.
    """
    found = parallel_map(_fitted_in, list(enumerate(worlds)))
    rows = [row for of_world in found for row in of_world]
    return pd.DataFrame(rows, columns=["world", "estimator", "sigma_w", "sigma_v"])


def _fitted_in(numbered):
    """The rows of `fitted_noises` of one world (number, fields)."""
    number, world = numbered
    fields = {name: of for name, of in world.items() if name not in which_worlds.NOT_OF_SCENARIO}
    fields |= dict(duration_s=which_worlds.duration_s(_TRAINING_ROWS, fields))
    seeds = range(_TRAINING_SEED + _TRAINING_DRIVES * number, _TRAINING_SEED + 2 * (number + 1))
    runs = simulate([Scenario(**fields, estimator="oracle", seed=seed) for seed in seeds])
    rows = []
    for estimator in ESTIMATORS:
        noise = fit_prediction(estimator, runs, seed=number)
        texts = (" ".join(f"{value:.3g}" for value in sigma) for sigma in noise)
        rows.append((number, estimator, *texts))
    return rows


def fit_prediction(estimator, runs, seed=0):
    """W and V that predict the next measurements of Runs best, each given all before it.

    The cross-entropy method: each generation of candidates is drawn from a normal distribution of
    the logarithms, which becomes that of the best ones. All candidates run at a time, in lanes.

    Args:
        estimator: "rhe" or "ekf".
        runs: The Runs.
        seed: Of the candidates.

    Returns:
        A `tuning.Noise`.
    """
    rng = np.random.default_rng(seed)
    scenario = Scenario(estimator=estimator)
    mean = np.log(_FIRST[estimator])
    root = _FIRST_DEVIATION * np.eye(len(mean))
    best = np.inf, None
    for _ in range(_GENERATIONS):
        candidates = mean + rng.standard_normal((_CANDIDATES, len(mean))) @ root.T
        candidates = np.clip(candidates, np.log(_LEAST), np.log(_MOST))
        noises = [_noise_at(estimator, candidate) for candidate in candidates]
        scores = deviances(scenario, noises, runs).sum(axis=1)
        ranked = np.argsort(scores)
        best = min(best, (scores[ranked[0]], noises[ranked[0]]), key=lambda scored: scored[0])
        elite = candidates[ranked[:_ELITE]]
        mean = elite.mean(axis=0)
        root = np.diag(elite.std(axis=0) + 0.02)
    return best[1]


def _noise_at(estimator, logarithms):
    """The Noise at a point of the search."""
    sigma_w = [_LEAST] * len(tuning.NOISES[estimator]["printed"].sigma_w)
    sigma = np.array([*sigma_w, *paper.SIGMA_V])
    for places, logarithm in zip(_PLACES[estimator], logarithms):
        sigma[list(places)] = np.exp(logarithm)
    sigma = sigma.tolist()
    return tuning.Noise(tuple(sigma[: len(sigma_w)]), tuple(sigma[len(sigma_w) :]))


# Drives in the posterior's worlds

OWN = "own"  # the path and length that a world itself has
PATTERNS = ("alternate", "left", "right", "figure_of_eight")
_PATTERN_ROWS = 2.999  # three rows and the two headlands between them
# {name: Variant}
VARIANTS = {f"{e}_{rule}": Variant(e, w) for rule, w in RULES.items() for e in ESTIMATORS}
_KEPT = ("error", "violations")


def with_noises(worlds, noises):
    """Worlds with the noise that `fitted_noises` found in each, for the W "fitted"."""
    worlds = [dict(world) for world in worlds]
    for row in noises.itertuples():
        worlds[row.world][f"fitted_{row.estimator}"] = dict(
            sigma_w=tuple(map(float, row.sigma_w.split())),
            sigma_v=tuple(map(float, row.sigma_v.split())),
        )
    return worlds


def on_pattern(world, turns):
    """A world whose robot drives three rows with turns of one of PATTERNS, or as it did itself."""
    if turns == OWN:
        return world
    world = world | dict(turns=turns)
    return world | dict(duration_s=which_worlds.duration_s(_PATTERN_ROWS, world))


def drive_by_rule(worlds):
    """Drive worlds by each rule, on their own paths and on each of PATTERNS.

    RHE and EKF have the same fields and the same noise, which are those of all rules, too. A
    world has two fields on its own path, and one on each of PATTERNS.

    Args:
        worlds: Of `with_noises`.

    Returns:
        DataFrame, one row a world and field, with columns (turns and variant, error or violations);
        turns are OWN or of PATTERNS. NaN where a field was not driven.
    """
    tables = {}
    for turns in (OWN, *PATTERNS):
        driven = [on_pattern(world, turns) for world in worlds]
        fields = which_worlds.FIELDS if turns == OWN else 1
        table = which_worlds.drive(driven, UNUSED_SEED, VARIANTS, fields, paired=True)
        for variant in VARIANTS:
            tables[f"{turns} {variant}"] = table[variant][list(_KEPT)]
    return pd.concat(tables, axis=1).astype(np.float16)


def rule_rows(drives, effective):
    """RHE and EKF with W by the same rule in the posterior's worlds, by rule and path.

    A world counts by the mean of its drives; lost is a mean error above the tolerance.

    Args:
        drives: Of `drive_by_rule`.
        effective: How many of the worlds are effectively different.

    Returns:
        DataFrame, one row a rule and path: medians over worlds of both errors [m] and of EKF / RHE
        with its middle 90 %; the share of worlds in which the RHE's error is the smaller, with its
        95 % interval; how many worlds have neither robot lost, and that share among those; in which
        shares of the worlds the RHE, and the EKF, has fewer violations.
    """
    rows = []
    for rule in RULES:
        for turns in (OWN, *PATTERNS):
            rhe, ekf = (drives[f"{turns} {e}_{rule}"].groupby("world").mean() for e in ESTIMATORS)
            better = (rhe["error"] < ekf["error"]).to_numpy()
            ratio = (ekf["error"] / rhe["error"]).to_numpy()
            kept = (np.maximum(rhe["error"], ekf["error"]) <= paper.TOLERANCE_M).to_numpy()
            share, low, high = which_worlds.effective_share(better.mean(), effective)
            rows.append(
                {
                    "rule for W": rule,
                    "turns": turns,
                    "RHE [m]": rhe["error"].median(),
                    "EKF [m]": ekf["error"].median(),
                    "EKF / RHE": np.median(ratio),
                    "EKF / RHE p5": np.quantile(ratio, 0.05),
                    "EKF / RHE p95": np.quantile(ratio, 0.95),
                    "RHE better": share,
                    "low": low,
                    "high": high,
                    "neither lost": kept.mean(),
                    "RHE better, neither lost": better[kept].mean() if kept.any() else np.nan,
                    "RHE fewer violations": (rhe["violations"] < ekf["violations"]).mean(),
                    "EKF fewer violations": (rhe["violations"] > ekf["violations"]).mean(),
                    "worlds": len(better),
                    "effective worlds": effective,
                }
            )
    return pd.DataFrame(rows).round(5)


def order_drives():
    """The drives that ORDER_DRIVES holds, as of `drive_by_rule`."""
    return which_worlds.read(ORDER_DRIVES)


def effective_worlds():
    """How many of the posterior's worlds are effectively different."""
    return which_worlds.effective_number(which_worlds.posterior_table()["world"])


# Which unknowns decide

EFFECT_ROWS = 256  # of each of the two samples, a power of 2
EFFECT_RULES = ("consistent", "prediction", "tracking")
_EFFECT_SEED = UNUSED_SEED + 2**21
_EFFECT_VARIANTS = {f"{e}_{rule}": Variant(e, rule) for rule in EFFECT_RULES for e in ESTIMATORS}
# A free W says nothing of an order in which W is picked by rule.
_EFFECT_UNKNOWNS = tuple(name for name in UNKNOWNS if not name.startswith("sigma_"))
_RESAMPLES = 500


def effect_design(rows=EFFECT_ROWS):
    """Two samples of the prior's worlds, and those in which one unknown is of the other: unit.

    Returns:
        (2 + d, rows, all unknowns): A, B, and for each of the d unknowns A with that of B.
    """
    d = len(_EFFECT_UNKNOWNS)
    both = stats.qmc.Sobol(2 * d, rng=np.random.default_rng(2)).random(rows)
    places = [UNKNOWNS.index(name) for name in _EFFECT_UNKNOWNS]
    unit = np.full((2 + d, rows, len(UNKNOWNS)), 0.5)
    unit[0][:, places] = both[:, :d]
    unit[1][:, places] = both[:, d:]
    for row, place in enumerate(places):
        unit[2 + row] = unit[0]
        unit[2 + row][:, place] = unit[1][:, place]
    return unit


def drive_effects(rows=EFFECT_ROWS):
    """The order in each world of `effect_design`.

    The k-th world of all samples has the k-th field, so that only one unknown differs between two
    worlds that are compared. Errors above the tolerance count as the tolerance, since lost is lost:
    two lost robots have no order.

    Returns:
        {rule: (2 + d, rows) ln(error of the EKF / that of the RHE)}.
    """
    unit = effect_design(rows)
    fields = [
        which_worlds.fields_of(world)
        for of_sample in unit
        for world in which_worlds.worlds_at(of_sample).to_dict("records")
    ]
    seeds = np.tile(np.arange(rows), len(unit))
    drives = [
        which_worlds.scenario(world, variant, _EFFECT_SEED + int(seed), paired=True)
        for world, seed in zip(fields, seeds)
        for variant in _EFFECT_VARIANTS.values()
    ]
    errors = np.array(map_runs(_error, drives)).reshape(len(unit), rows, len(_EFFECT_VARIANTS))
    errors = np.minimum(errors, paper.TOLERANCE_M)
    by_variant = dict(zip(_EFFECT_VARIANTS, np.moveaxis(errors, -1, 0)))
    return {
        rule: np.log(by_variant[f"ekf_{rule}"] / by_variant[f"rhe_{rule}"]) for rule in EFFECT_RULES
    }


def _error(run):
    """The mean error of a drive, by raw GNSS [m]."""
    return run.metrics["mean_error_m"]


def effects(orders, seed=0):
    """Total effects of the unknowns on the order, over the prior's worlds.

    The total effect of an unknown is the share of the variance that is left if all others are known
    (I. Sobol', Math. Comput. Simul. 55, 2001), here by scipy.stats.sobol_indices. It is found for
    the sign of RHE - EKF and for ln(EKF / RHE).

    Args:
        orders: Of `drive_effects`.
        seed: Of the bootstrap.

    Returns:
        DataFrame, one row a rule and unknown: both total effects with their 95 % intervals
        (bootstrap over rows of the samples), and the share of worlds in which the RHE is the better
        in the lower, middle and upper third of the unknown's prior.
    """
    unit = effect_design(next(iter(orders.values())).shape[1])
    rows = []
    for rule, log_ratio in orders.items():
        indices = {
            name: _total_effects(values, seed)
            for name, values in dict(sign=np.sign(log_ratio), ratio=log_ratio).items()
        }
        better = (log_ratio[:2] > 0).ravel()
        for k, unknown in enumerate(_EFFECT_UNKNOWNS):
            thirds = np.minimum((unit[:2, :, UNKNOWNS.index(unknown)].ravel() * 3).astype(int), 2)
            row = {"rule for W": rule, "unknown": unknown}
            for name, (total, low, high) in indices.items():
                row |= {f"of the {name}": total[k], f"{name} low": low[k], f"{name} high": high[k]}
            for third, words in enumerate(("lower", "middle", "upper")):
                row[f"RHE better, {words} third"] = better[thirds == third].mean()
            rows.append(row)
    return pd.DataFrame(rows)


def _total_effects(values, seed):
    """Total effects (d,) of values (2 + d, rows), and the ends of their 95 % intervals."""
    n = values.shape[1]
    rng = np.random.default_rng(seed)
    again = [_total_effect(values[:, rng.integers(n, size=n)]) for _ in range(_RESAMPLES)]
    return _total_effect(values), *np.quantile(again, [0.025, 0.975], axis=0)


def _total_effect(values):
    func = dict(f_A=values[:1], f_B=values[1:2], f_AB=values[2:, None, :])
    return np.ravel(stats.sobol_indices(func=func, n=values.shape[1]).total_order)


# Making the files


def main():
    """Fit the noise in each of the posterior's worlds, and drive them by each rule."""
    parser = argparse.ArgumentParser(
        "python -m notebooks.studies.order_in_worlds", description=__doc__
    )
    parts = ("noises", "drives", "effects")
    parser.add_argument("part", nargs="*", default=parts, help=f"of {parts}; without any, all")
    chosen = parser.parse_args().part
    worlds = which_worlds.posterior_worlds()
    if "noises" in chosen:
        fitted_noises(worlds).to_csv(NOISES, index=False)
    if "drives" in chosen:
        which_worlds.write(drive_by_rule(with_noises(worlds, pd.read_csv(NOISES))), ORDER_DRIVES)
    if "effects" in chosen:
        effects(drive_effects()).to_csv(EFFECTS, index=False, float_format="%.4g")


if __name__ == "__main__":
    main()
