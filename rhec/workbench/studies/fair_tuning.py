"""One tuner for every contestant: controller and estimator together, with one budget.

What an estimator is worth depends on the weights of the controller behind it: R = 10 leaves so slow
a controller that the estimate must lead it. So each contestant is tuned as a whole, by the same
rules: EVALUATIONS for each of its unknowns, the mean true error over the same training fields, and
the same search on logarithms.

1. At most a third of the budget: points of a Sobol sequence over all bounds, after three points
   with the likeliest W and R = 10 (the paper's), 1 and 0.1.
2. The rest: Nelder and Mead's method, half each from the two best points.

    python -m rhec.workbench.studies.fair_tuning [WORLD] [CONTESTANT …]

tunes in a world of `rhec.WORLDS`, the default without one. Every evaluation is kept in
build/tuning, so that the same command goes on where it was interrupted. The results are
`rhec.tracked_robot.tuned_loops.TUNED`.
"""

import contextlib
import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import optimize
from scipy.stats import qmc

from rhec import paper
from rhec.core.lanes import lanes
from rhec.simulation.campaigns.batch import simulate_batch
from rhec.simulation.closed_loop import build_sample, set_up
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning

__all__ = ["CONTESTANTS", "EVALUATIONS", "TRAINING_SEEDS", "Contestant", "Unknown", "tune"]

EVALUATIONS = 40  # for each unknown
TRAINING_SEEDS = range(1000, 1024)
_FOLDER = Path("build/tuning")
_SEED = 0  # of the Sobol sequence
_SHARE_SOBOL = 1 / 3
_SIMPLEX = 0.7  # size of the first simplex, in logarithms: a factor of two


class Unknown(NamedTuple):
    """What is tuned: a number's name, the least and largest value, and its places in sigma_w."""

    name: str
    least: float
    most: float
    places: tuple = ()


class Contestant(NamedTuple):
    """A loop: its label in tables, the fields of Scenario that it keeps, and its unknowns."""

    label: str
    fields: dict
    unknowns: tuple

    def scenario_fields(self, values):
        """The fields of Scenario with these values of the unknowns."""
        by_name = dict(zip([unknown.name for unknown in self.unknowns], map(float, values)))
        fields = dict(self.fields)
        places = [unknown.places for unknown in self.unknowns]
        if any(places):
            sigma = np.zeros(1 + max(map(max, filter(None, places))))
            for unknown in self.unknowns:
                sigma[list(unknown.places)] = by_name.get(unknown.name)
            fields["sigma_w"] = tuple(sigma.tolist())
        if "q_theta" in by_name:
            fields["q"] = (*paper.Q3[:2], by_name["q_theta"])
        if "sigma_omega" in by_name:
            fields["sigma_v"] = (*paper.SIGMA_V[:3], by_name["sigma_omega"])
        others = ("r", "look_ahead_m", "observer_time_s")
        return fields | {name: by_name[name] for name in others if name in by_name}


_R = Unknown("r", 1e-3, 30.0)
_Q_THETA = Unknown("q_theta", 1e-2, 10.0)
_LOOK_AHEAD = Unknown("look_ahead_m", 0.2, 5.0)
_OBSERVER = Unknown("observer_time_s", 0.2, 60.0)
# An RHE has process noise inside its window only through its inputs.
_SIGMA_OMEGA = Unknown("sigma_omega", 5e-3, 0.5)


def _sigma(name, *places, least=1e-3, most=10.0):
    return Unknown(f"sigma_{name}", least, most, places)


_POSE = (_sigma("xy", 0, 1), _sigma("theta", 2), _sigma("nu", 3))
_RHC = (_R, _Q_THETA)
_SOIL = (_sigma("mu", 4), _sigma("kappa", 5))
_DRIFT = (_sigma("drift", 6, least=1e-5, most=0.1),)
_BOUNDED = dict(estimator="bounded_ekf")
CONTESTANTS = {
    "ekf": Contestant("EKF", dict(estimator="ekf"), _RHC + _POSE),
    "fixed_traction": Contestant(
        "EKF, traction two constants", dict(estimator="fixed_traction"), _RHC + _POSE
    ),
    "bounded_ekf": Contestant("bounded EKF", _BOUNDED, _RHC + _POSE + _SOIL),
    "rhe_smoothed": Contestant(
        "RHE, smoothed arrival",
        dict(estimator="rhe", arrival_mean="smoothed"),
        _RHC + _POSE + _SOIL + (_SIGMA_OMEGA,),
    ),
    "rhe": Contestant(
        "RHE, filtered arrival",
        dict(estimator="rhe", arrival_mean="filtered"),
        _RHC + _POSE + _SOIL + (_SIGMA_OMEGA,),
    ),
    "rhe_fixed": Contestant(
        "RHE, traction two constants",
        dict(estimator="rhe_fixed_traction", arrival_mean="filtered"),
        _RHC + _POSE + (_SIGMA_OMEGA,),
    ),
    "observer": Contestant(
        "bounded EKF, disturbance observer",
        _BOUNDED | dict(disturbance_observer=True),
        (*_RHC, *_POSE, *_SOIL, _OBSERVER),
    ),
    "yaw_drift_ekf": Contestant(
        "yaw-drift EKF", dict(estimator="yaw_drift_ekf"), _RHC + _POSE + _SOIL + _DRIFT
    ),
    "yaw_drift_rhe": Contestant(
        "yaw-drift RHE",
        dict(estimator="yaw_drift_rhe", arrival_mean="filtered"),
        _RHC + _POSE + _SOIL + _DRIFT + (_SIGMA_OMEGA,),
    ),
    "ltv_mpc": Contestant(
        "bounded EKF, linear time-varying MPC",
        _BOUNDED | dict(controller="ltv_mpc"),
        _RHC + _POSE + _SOIL,
    ),
    "pure_pursuit": Contestant(
        "bounded EKF, pure pursuit",
        _BOUNDED | dict(controller="pure_pursuit"),
        (_LOOK_AHEAD, *_POSE, *_SOIL),
    ),
    "pure_pursuit_drift": Contestant(
        "yaw-drift EKF, pure pursuit",
        dict(estimator="yaw_drift_ekf", controller="pure_pursuit"),
        (_LOOK_AHEAD, *_POSE, *_SOIL, *_DRIFT),
    ),
    "traction_oracle": Contestant(
        "traction oracle", dict(estimator="traction_oracle"), _RHC + _POSE
    ),
    "drift_oracle": Contestant(
        "traction and drift oracle", dict(estimator="drift_oracle"), _RHC + _POSE
    ),
    "oracle": Contestant("full oracle", dict(estimator="oracle"), _RHC),
}


def _error_m(fields, seeds):
    """Mean true error [m] over these seeds; infinite where a run has none."""
    scenarios = [Scenario(seed=seed, **fields) for seed in seeds]
    # One structure is driven hundreds of times, which pays for compiling its lanes.
    lanes.load(build_sample, *set_up(scenarios[0]).structure)
    # `simulate_batch` takes a result of 0 for none: a tuple is not.
    errors = simulate_batch(scenarios, lambda run: (run.metrics["mean_error_true_m"],))
    return float(np.nan_to_num(np.mean(errors), nan=np.inf))


class _Kept:
    """An objective whose evaluations are kept in a file, and counted up to a budget.

    A search that is repeated asks the same questions in the same order, and gets the answers of
    the file until it comes to where it was interrupted.
    """

    def __init__(self, objective, file, budget):
        self._objective = objective
        self._file = file
        self._budget = budget
        self.tried = {}  # {point: value}, of this search
        lines = file.read_text().splitlines() if file.exists() else []
        self._known = {tuple(point): value for point, value in map(json.loads, lines)}

    def __call__(self, point):
        key = tuple(round(float(number), 9) for number in point)
        if key not in self.tried:
            if len(self.tried) == self._budget:
                raise _Exhausted
            if key not in self._known:
                self._known[key] = self._objective(key)
                with self._file.open("a") as lines:
                    lines.write(json.dumps([key, self._known[key]]) + "\n")
            self.tried[key] = self._known[key]
        return self.tried[key]

    def best(self, n=1):
        """The n best points of this search, the best first."""
        return sorted(self.tried, key=self.tried.get)[:n]


class _Exhausted(Exception):
    """All evaluations are used up."""


def _first_points(contestant):
    """Logarithms of the likeliest W with R = 10, 1 and 0.1, and other unknowns in the middle."""
    estimator = contestant.fields["estimator"]
    likeliest = tuning.SIGMA_W.get(estimator, {}).get("calibrated", ())
    for r in (10.0, 1.0, 0.1):
        values = []
        for unknown in contestant.unknowns:
            value = np.sqrt(unknown.least * unknown.most)
            if unknown.name in ("r", "q_theta"):
                value = dict(r=r, q_theta=paper.Q3[2])[unknown.name]
            elif unknown.places and likeliest:
                value = likeliest[unknown.places[0]]
            values.append(np.clip(value, unknown.least, unknown.most))
        yield np.log(values)


def tune(contestant, world, seeds=TRAINING_SEEDS, folder=_FOLDER, evaluations=EVALUATIONS):
    """The fields of Scenario with which a contestant tracks best on the training seeds.

    Args:
        contestant: A key of CONTESTANTS.
        world: Fields of Scenario that are not the contestant's.
        seeds: Of the fields driven.
        folder: Where evaluations are kept.
        evaluations: The budget for each unknown.

    Returns:
        Fields of Scenario, numbers to three digits, and their mean true error [m].
    """
    chosen = CONTESTANTS[contestant]
    logarithms = np.log([(unknown.least, unknown.most) for unknown in chosen.unknowns])
    lowest, highest = logarithms.T

    def fields_of(point):
        values = [float(f"{value:.3g}") for value in np.exp(np.clip(point, lowest, highest))]
        return chosen.scenario_fields(values)

    folder.mkdir(parents=True, exist_ok=True)
    budget = evaluations * len(chosen.unknowns)
    kept = _Kept(
        lambda point: _error_m(world | fields_of(point), seeds),
        folder / f"{contestant}.jsonl",
        budget,
    )
    for point in _first_points(chosen):
        kept(point)
    sobol = qmc.Sobol(len(chosen.unknowns), rng=np.random.default_rng(_SEED))
    # A Sobol sequence is even after a power of two.
    for point in sobol.random_base2(int(np.log2(_SHARE_SOBOL * budget))):
        kept(lowest + point * (highest - lowest))
    starts = kept.best(2)
    each = (budget - len(kept.tried)) // 2
    for start in starts:
        # The kept points are rounded, so that one at a bound may be beyond it.
        start = np.clip(start, lowest, highest)
        _nelder_mead(kept, start, np.c_[lowest, highest], each)
    (best,) = kept.best()
    return fields_of(best), kept.tried[best]


def _nelder_mead(objective, start, bounds, evaluations):
    """Nelder and Mead's method from a start (n,), within bounds (n, 2) and so many evaluations."""
    n = len(start)
    middle = bounds.mean(axis=1)
    # Towards the middle, so that the simplex stays within the bounds.
    sides = np.where(start < middle, _SIMPLEX, -_SIMPLEX)
    simplex = start + np.vstack([np.zeros(n), np.diag(sides)])
    options = dict(
        initial_simplex=simplex, maxfev=evaluations, adaptive=True, xatol=0.01, fatol=1e-6
    )
    with contextlib.suppress(_Exhausted):
        optimize.minimize(objective, start, method="Nelder-Mead", bounds=bounds, options=options)


def _main():
    world, *names = sys.argv[1:] or ["default"]
    from rhec.simulation.worlds import WORLDS

    for name in names or CONTESTANTS:
        fields, error_m = tune(name, WORLDS[world], folder=_FOLDER / world)
        print(f"{error_m:.5f}", json.dumps({name: fields}), flush=True)


if __name__ == "__main__":
    _main()
