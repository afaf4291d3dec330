"""The tuned noises of all estimators, `rhec/tracked_robot/tuned.csv`, each by a rule (G1, G2).

Training seeds alone are used, 1000 and up, never the paper's results and never a seed below 1000.
All estimators are tuned alike: in the default world, with the arrival mean that ACADO's code has,
on the same seeds, with the same bounds on a standard deviation per sample, and with as many
evaluations for each unknown. Each rule sets W and V, as far as the estimator uses them.

- "prediction" foresees the measurements best. The robot drives the training seeds with the true
  state in the loop, so that the data do not depend on any estimator. An estimator runs over what
  was measured; its deviance is -2 log likelihood of each measurement given all before it, summed
  (`rhec.core.estimator.kalman.update`). This needs no truth. Of a window with bounds it is a sum of
  one-step predictive scores, not a likelihood of one model.
- "consistent" has errors as large as the estimator says, on the same drives, and looks at nothing
  else (`notebooks.further.consistency.departure`).
- "tracking" drives best: the robot drives the training seeds by the estimator, with the paper's
  weights, and the mean true error is the least. That W need not give the best estimates.
- "soft_soil" is as "prediction" on SOFT_SOIL, for recorded robots.

    python -m notebooks.studies.calibration                             makes the whole table
    python -m notebooks.studies.calibration rhe ekf --rules prediction  makes these rows again

Rows are written as they are found, so what was interrupted goes on with the rows that are left. The
search begins at the row that the table has, too: another run of the same world finds no worse one.
"""

import argparse
import csv
import functools
import itertools
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import NamedTuple

import numpy as np
import pandas as pd

from notebooks.further import consistency
from notebooks.rivals import RIVALS, noises
from rhec import paper
from rhec.core.lanes import lanes
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.closed_loop import build_sample, set_up
from rhec.simulation.offline import run_estimator_on_all
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot import tuning

TRAINING_SEEDS = range(1000, 1024)
# Each evaluation of "tracking" drives anew, which takes longer.
_TRACKING_SEEDS = range(1000, 1016)
# Bounds on a standard deviation per sample; less than 1 mm, 1 mrad or 1 mm/s has no effect.
LEAST = 1e-3
MOST = 1.0
# Of `search`, for each unknown.
_MEMBERS = 5  # of differential evolution
_GENERATIONS = 12
EVALUATIONS = 60  # of each of these, as their own limits count them
_DOWNHILL = {  # {method of scipy.optimize.minimize: options}
    "COBYQA": dict(initial_tr_radius=1.0, final_tr_radius=0.003),
    "Powell": dict(xtol=0.01, ftol=1e-6),
}
_DIVERGED = 1e12  # an objective that is no number
# The search works on one vector, sigma = (*sigma_v, *sigma_w); an unknown sets some places of it.
_N_V = len(paper.SIGMA_V)
FILTER = [(0, 1), (2,), (4, 5), (6,), (7,)]  # V of positions and speed, W of pose and speed
WINDOW = [*FILTER, (3,)]  # V of the yaw rate, too, which a filter takes as exact
TRACTION = [(8,), (9,)]  # W
YAW_DRIFT = [(10,)]  # W
# Soil that slips as much as that under recorded robots, the same below both tracks, and noise that
# is white: what the models assume.
SOFT_SOIL = dict(mu_mean=0.9, mu_deviation=0.04, kappa_mean=0.8, kappa_deviation=0.08)
SOFT_SOIL |= dict(soil_under="centre", slip_difference=0.0, gnss_sigma_m=0.03, gnss_slow_share=0.0)
SOFT_SOIL |= dict(bump_sigma_radps=0.02, rut_length_m=0.0)


class Tuned(NamedTuple):
    """What is tuned: an estimator, by its name or of one's own, and what is unknown of its noise.

    Attributes:
        fields: The fields of Scenario that make it.
        unknowns: For each unknown the places that it sets in (*sigma_v, *sigma_w), such as
            FILTER + TRACTION for a filter of (x, y, θ, ν, μ, κ).
        rules: Those by which it is tuned.
    """

    fields: dict
    unknowns: list
    rules: tuple = ("prediction",)


_ALL = "consistent", "prediction", "tracking", "soft_soil"
ESTIMATORS = {
    "rhe": Tuned(dict(estimator="rhe"), WINDOW + TRACTION, _ALL),
    "rhe_yaw_drift": Tuned(
        dict(estimator="rhe", yaw_drift=True), WINDOW + TRACTION + YAW_DRIFT, _ALL
    ),
    # Without the traction the yaw drift follows the speed.
    "rhe_no_slip_yaw_drift": Tuned(
        dict(estimator=RIVALS["rhe_no_slip_yaw_drift"]), [*WINDOW, (8,)]
    ),
    "rhe_fixed_traction": Tuned(dict(estimator=RIVALS["rhe_fixed_traction"]), WINDOW),
    "rhe_no_slip": Tuned(dict(estimator=RIVALS["rhe_no_slip"]), WINDOW),
    "ekf": Tuned(dict(estimator="ekf"), FILTER, _ALL),
    "augmented_ekf": Tuned(
        dict(estimator=RIVALS["augmented_ekf"]), FILTER + TRACTION, ("prediction", "soft_soil")
    ),
    "bounded_ekf": Tuned(dict(estimator="bounded_ekf"), FILTER + TRACTION, _ALL[:3]),
    "fixed_traction": Tuned(dict(estimator=RIVALS["fixed_traction"]), FILTER),
    "traction_oracle": Tuned(dict(estimator=RIVALS["traction_oracle"]), FILTER),
    "drift_oracle": Tuned(dict(estimator=RIVALS["drift_oracle"]), FILTER),
    "yaw_drift_ekf": Tuned(dict(estimator=RIVALS["yaw_drift_ekf"]), FILTER + TRACTION + YAW_DRIFT),
}


def oracle_runs(seeds, duration_s=240.0, **world):
    """Runs with the true state in the loop, one a seed, in the default world or another."""
    fields = dict(estimator="oracle", duration_s=duration_s) | world
    return simulate([Scenario(seed=seed, **fields) for seed in seeds])


def deviance(estimator, sigma_w, runs, **fields):
    """-2 log likelihood of the measurements of Runs under a process noise, up to a constant.

    `fields` are other settings of the estimator, fields of Scenario.
    """
    scenario = Scenario(estimator=estimator, sigma_w=tuple(map(float, sigma_w)), **fields)
    every = run_estimator_on_all(scenario, runs, "deviance")
    return sum(of_run["deviance"].sum() for of_run in every)


def tracking_error_m(**fields):
    """Mean true error [m] over training seeds of a Scenario with these fields."""
    scenarios = [Scenario(seed=seed, **fields) for seed in _TRACKING_SEEDS]
    # One structure is driven hundreds of times, which pays for compiling its lanes.
    lanes.load(build_sample, *set_up(scenarios[0]).structure)
    return campaign(scenarios, workers=1)["mean_error_true_m"].fillna(np.inf).mean()


# The rules. Each makes, for the fields of an estimator, the function of its noise to be minimised.


def by_prediction(fields, **world):
    """The rule "prediction": -2 log likelihood of what was measured on training seeds."""
    runs = oracle_runs(TRAINING_SEEDS, sensors=fields.get("sensors", ()), **world)
    return lambda **noise: deviance(runs=runs, **fields, **noise)


def by_consistency(fields):
    """The rule "consistent": the departure from consistency on training seeds."""
    runs = oracle_runs(TRAINING_SEEDS, sensors=fields.get("sensors", ()))
    return lambda **noise: consistency.departure(Scenario(**fields, **noise), runs)


def by_tracking(fields):
    """The rule "tracking": the mean true error of drives by the estimator [m]."""
    return lambda **noise: tracking_error_m(**fields, **noise)


RULES = {
    "consistent": by_consistency,
    "prediction": by_prediction,
    "tracking": by_tracking,
    "soft_soil": functools.partial(by_prediction, **SOFT_SOIL),
}
SEEDS = dict.fromkeys(RULES, TRAINING_SEEDS) | dict(tracking=_TRACKING_SEEDS)


def calibrate(estimator, rule):
    """The noise of one of ESTIMATORS by a rule: a row of tuned.csv, as of `tune`."""
    found = tune(ESTIMATORS[estimator], rule, _known(estimator, rule))
    return dict(estimator=estimator, process_noise=rule) | found


def tune(tuned, rule, known=None):
    """The noise of any estimator, such as one of one's own, by a rule.

    Args:
        tuned: A Tuned.
        rule: A name in RULES.
        known: A good (*sigma_v, *sigma_w), if there is one, from which the search begins, too.

    Returns:
        {"sigma_w", "sigma_v": tuples, "objective": that of these, "evaluations": their number,
        "seeds": those of the training}.
    """
    objective = RULES[rule](tuned.fields)
    unused = {*range(_N_V)} - {place for places in tuned.unknowns for place in places}

    def noise_of(sigma):
        """sigma_w and sigma_v of a vector, to three digits; the paper's where none is used."""
        digits = [float(f"{value:.3g}") for value in sigma]
        for place in unused:
            digits[place] = paper.SIGMA_V[place]
        return dict(sigma_w=tuple(digits[_N_V:]), sigma_v=tuple(digits[:_N_V]))

    tried = []

    def evaluate(sigma):
        value = objective(**noise_of(sigma))
        tried.append((value if np.isfinite(value) else _DIVERGED, sigma))
        return tried[-1][0]

    search(evaluate, tuned.unknowns, known)
    least, best = min(tried)
    seeds = f"{SEEDS[rule][0]}-{SEEDS[rule][-1]}"
    return noise_of(best) | dict(objective=float(least), evaluations=len(tried), seeds=seeds)


def _known(estimator, rule):
    """(*sigma_v, *sigma_w) of the row that the table has now, or None."""
    row = read_rows(file_of(estimator)).get((estimator, rule))
    return row and tuple(map(float, f"{row['sigma_v']} {row['sigma_w']}".split()))


def search(objective, unknowns, known=None):
    """Evaluate an objective down to its low minima.

    Of its many minima differential evolution finds a good one. COBYQA goes on from there, which
    models the objective by a quadratic: valleys are curved, because an estimator uses V and W
    nearly by their ratio alone. Powell's method then reaches the bounds. The same is done from a
    sigma that is known. All work on logarithms.

    Args:
        objective: Function of sigma, a tuple.
        unknowns: For each unknown the places in sigma that it sets; other places are LEAST.
        known: A good sigma, if there is one.
    """
    from scipy.optimize import differential_evolution, minimize  # 0.2 s, and few ever search

    bounds = [np.log((LEAST, MOST))] * len(unknowns)

    def evaluate(logarithms):
        return objective(sigma_of(logarithms, unknowns))

    found = differential_evolution(
        evaluate,
        bounds,
        strategy="rand1bin",  # those about the best one often stay in a shallow minimum
        popsize=_MEMBERS,
        maxiter=_GENERATIONS,
        tol=0,  # so that it takes all its evaluations
        seed=0,
        polish=False,
    )
    starts = [found.x]
    if known:
        logarithms = np.log([known[places[0]] for places in unknowns])
        starts.append(np.clip(logarithms, *bounds[0]))
    for best in starts:
        for method, options in _DOWNHILL.items():
            options = options | dict(maxfev=EVALUATIONS * len(unknowns))
            best = minimize(evaluate, best, method=method, bounds=bounds, options=options).x


def sigma_of(logarithms, unknowns):
    """The standard deviations with these logarithms in the places of the unknowns, else LEAST."""
    sigma = np.full(max(map(max, unknowns)) + 1, LEAST)
    for places, logarithm in zip(unknowns, logarithms):
        sigma[list(places)] = np.exp(logarithm)
    return tuple(sigma.tolist())


# The table

COLUMNS = "estimator process_noise sigma_w sigma_v objective evaluations seeds".split()


def read_rows(file):
    """The rows of a tuned.csv, {(estimator, rule): row}."""
    with open(file, encoding="utf-8", newline="") as lines:
        return {(row["estimator"], row["process_noise"]): row for row in csv.DictReader(lines)}


def write_rows(file, rows):
    """Write {(estimator, rule): row} in the order of ESTIMATORS and of their rules."""
    order = [(name, rule) for name, tuned in ESTIMATORS.items() for rule in tuned.rules]
    others = [key for key in rows if key not in order]
    with open(file, "w", encoding="utf-8", newline="") as lines:
        writer = csv.DictWriter(lines, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows[key] for key in (*order, *others) if key in rows)


def file_of(name):
    """The tuned.csv that has an estimator: that of the rivals, or that of rhec."""
    return noises.FILE if name in RIVALS else tuning.FILE


def readable_noises():
    """W and V of RHE and EKF by each of their rules, for readers; see `tuning.Noise`."""
    rows = []
    for name in ("rhe", "ekf"):
        for rule, noise in tuning.NOISES[name].items():
            x, _, *others = noise.sigma_w
            x_measured, _, *others_measured = noise.sigma_v
            cells = [" ".join(f"{value:g}" for value in (x, *others))]
            cells.append(" ".join(f"{value:g}" for value in (x_measured, *others_measured)))
            rows.append((name, rule, *cells))
    columns = ["estimator", "rule", "W: x and y, θ, ν, μ, κ", "V: x and y, ν, ω"]
    return pd.DataFrame(rows, columns=columns)


def make_table(names, rules):
    """Tune these estimators by these of their rules, and write each row as it is found."""
    wanted = [
        (name, rule)
        for name, rule in itertools.product(names, rules)
        if rule in ESTIMATORS[name].rules
    ]
    spawn = multiprocessing.get_context("spawn")  # a fork of a process with threads may hang
    with ProcessPoolExecutor(mp_context=spawn) as pool:
        found = {pool.submit(calibrate, *key): key for key in wanted}
        for future in as_completed(found):
            row = future.result()
            for name in ("sigma_w", "sigma_v"):
                row[name] = " ".join(f"{value:g}" for value in row[name])
            print(*row.values(), flush=True)
            file = file_of(row["estimator"])
            write_rows(file, read_rows(file) | {found[future]: row})


def main():
    """The command line; see the head of this module."""
    parser = argparse.ArgumentParser(description="Tune estimators and write tuned.csv.")
    parser.add_argument("estimator", nargs="*", default=[*ESTIMATORS], help="all by default")
    parser.add_argument("--rules", nargs="+", choices=RULES, default=[*RULES])
    given = parser.parse_args()
    unknown = {*given.estimator} - {*ESTIMATORS}
    if unknown:
        parser.error(f"estimator was {min(unknown)!r}; it should be one of {tuple(ESTIMATORS)}")
    make_table(given.estimator, given.rules)


if __name__ == "__main__":
    main()
