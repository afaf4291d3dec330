"""How the loops of `notebooks.further.rivals.tuned_loops` were tuned: each by the same search.

What an estimator is worth depends on the weights of the controller behind it: R = 10 leaves so slow
a controller that the estimate must lead it. So each loop is tuned as a whole, by the same rules:
EVALUATIONS for each of its unknowns, the mean true error over the same training fields of the
default world, and the same search on logarithms.

1. At most a third of the budget: points of a Sobol sequence over all bounds, after three points
   with W by prediction and R = 10 (the paper's), 1 and 0.1.
2. The rest: Nelder and Mead's method, half each from the two best points.

    python -m notebooks.further.tune_loops [LOOP …]

prints the fields of Scenario of each loop, with their mean true error [m] (half an hour for each).
"""

import contextlib
import sys

import numpy as np
from scipy import optimize
from scipy.stats import qmc

from notebooks.rivals import RIVALS
from notebooks.studies.calibration import tracking_error_m
from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning

EVALUATIONS = 40  # for each unknown
_SEED = 0  # of the Sobol sequence
_SHARE_SOBOL = 1 / 3
_SIMPLEX = 0.7  # size of the first simplex, in logarithms: a factor of two
_PLACES = dict(xy=(0, 1), theta=(2,), nu=(3,), mu=(4,), kappa=(5,), drift=(6,))  # in sigma_w
# Least and largest value of each unknown. An RHE has process noise inside its window only through
# its inputs, by sigma_omega.
BOUNDS = dict.fromkeys(_PLACES, (1e-3, 10.0))
BOUNDS |= dict(drift=(1e-5, 0.1), r=(1e-3, 30.0), q_theta=(1e-2, 10.0))
BOUNDS |= dict(sigma_omega=(5e-3, 0.5))
_POSE = ("xy", "theta", "nu")
_RHC = ("r", "q_theta")
_SOIL = ("mu", "kappa")
_OF_RHE = (*_RHC, *_POSE, *_SOIL, "sigma_omega")
LOOPS = {  # {loop: (fields of Scenario that it keeps, its unknowns)}
    "ekf": (dict(estimator="ekf"), _RHC + _POSE),
    "fixed_traction": (dict(estimator=RIVALS["fixed_traction"]), _RHC + _POSE),
    "bounded_ekf": (dict(estimator="bounded_ekf"), _RHC + _POSE + _SOIL),
    "rhe": (dict(estimator="rhe"), _OF_RHE),
    "rhe_yaw_drift": (dict(estimator="rhe", yaw_drift=True), (*_OF_RHE, "drift")),
    "rhe_gyro": (dict(estimator="rhe", sensors=("gyro",)), _OF_RHE),
    "rhe_fixed": (dict(estimator=RIVALS["rhe_fixed_traction"]), _RHC + _POSE + ("sigma_omega",)),
    "yaw_drift_ekf": (dict(estimator=RIVALS["yaw_drift_ekf"]), _RHC + _POSE + _SOIL + ("drift",)),
    "traction_oracle": (dict(estimator=RIVALS["traction_oracle"]), _RHC + _POSE),
    "drift_oracle": (dict(estimator=RIVALS["drift_oracle"]), _RHC + _POSE),
    "oracle": (dict(estimator="oracle"), _RHC),
}


def fields_of(loop, values):
    """The fields of Scenario of a loop with these values of its unknowns."""
    kept, unknowns = LOOPS[loop]
    by_name = dict(zip(unknowns, values))
    sigma_w = [by_name[name] for name, places in _PLACES.items() if name in by_name for _ in places]
    fields = kept | dict(r=by_name["r"], q=(*paper.Q3[:2], by_name["q_theta"]))
    if sigma_w:
        fields |= dict(sigma_w=tuple(sigma_w))
    if "sigma_omega" in by_name:
        fields |= dict(sigma_v=(*paper.SIGMA_V[:3], by_name["sigma_omega"]))
    return fields


def _first_points(loop):
    """Logarithms of W by prediction with R = 10, 1 and 0.1, and of other unknowns in the middle."""
    kept, unknowns = LOOPS[loop]
    rules = tuning.noises_of(tuning.name_of_noise(Scenario(**kept)))
    predicting = rules["prediction"].sigma_w if rules else ()
    bounds = np.array([BOUNDS[name] for name in unknowns])
    for r in (10.0, 1.0, 0.1):
        known = dict(r=r, q_theta=paper.Q3[2])
        for name in _PLACES.keys() & unknowns if predicting else ():
            known[name] = predicting[_PLACES[name][0]]
        middle = np.sqrt(bounds.prod(axis=1))
        values = [known.get(name, value) for name, value in zip(unknowns, middle)]
        yield np.log(np.clip(values, *bounds.T))


class _Exhausted(Exception):
    """All evaluations are used up."""


def tune(loop, error_m=tracking_error_m, evaluations=EVALUATIONS):
    """The fields of Scenario with which a loop tracks best, and their error [m].

    error_m(**fields) is what is made least. The fields' numbers have three digits.
    """
    _, unknowns = LOOPS[loop]
    bounds = np.log([BOUNDS[name] for name in unknowns])
    lowest, highest = bounds.T
    budget = evaluations * len(unknowns)
    tried = {}  # {point: error}

    def at(point):
        return fields_of(loop, [float(f"{x:.3g}") for x in np.exp(np.clip(point, lowest, highest))])

    def evaluate(point):
        key = tuple(round(float(number), 9) for number in point)
        if key not in tried:
            if len(tried) == budget:
                raise _Exhausted
            tried[key] = error_m(**at(key))
        return tried[key]

    for point in _first_points(loop):
        evaluate(point)
    sobol = qmc.Sobol(len(unknowns), rng=np.random.default_rng(_SEED))
    # A Sobol sequence is even after a power of two.
    for point in sobol.random_base2(int(np.log2(_SHARE_SOBOL * budget))):
        evaluate(lowest + point * (highest - lowest))
    each = (budget - len(tried)) // 2
    for start in sorted(tried, key=tried.get)[:2]:
        # The kept points are rounded, so that one at a bound may be beyond it.
        start = np.clip(start, lowest, highest)
        # Towards the middle, so that the simplex stays within the bounds.
        sides = np.diag(np.where(start < bounds.mean(axis=1), _SIMPLEX, -_SIMPLEX))
        options = dict(initial_simplex=start + np.vstack([0 * start, sides]), adaptive=True)
        options |= dict(maxfev=each, xatol=0.01, fatol=1e-6)
        with contextlib.suppress(_Exhausted):
            optimize.minimize(evaluate, start, method="Nelder-Mead", bounds=bounds, options=options)
    best = min(tried, key=tried.get)
    return at(best), tried[best]


if __name__ == "__main__":
    for name in sys.argv[1:] or LOOPS:
        fields, error = tune(name)
        print(f"{error:.5f}", name, fields, flush=True)
