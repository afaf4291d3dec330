"""Process noise W from training seeds, never from the paper's results: by prediction (G1, G2), by
consistency and by tracking, each for RHE and EKF alike. Seeds below 1000 are never used.

All estimators are tuned by the same rules, in the default world and with the arrival mean that
ACADO's code has: the same bounds on a standard deviation per sample, and for each rule the same
search.

By prediction. 1. Drive the default scenario on the training seeds with the true state in the loop,
so that the data do not depend on any estimator. 2. Run an estimator over the recorded measurements;
its deviance is -2 log likelihood of each measurement given all before it. 3. Choose the standard
deviations behind W that minimise the deviance summed over all training runs (`search`).

By consistency. W minimises the mean true error among those whose covariance is as large as the
errors (`notebooks/further/consistency.py`).

By tracking. The robot drives the training seeds by the estimator, and W minimises the mean true
error. That W need not give the best estimates; it gives those that this controller drives best.

The last two objectives have many minima, of which differential evolution (`evolve`) finds a good
one. They see the RHE's errors, so they also set its σ_ω, through which noise of the yaw enters the
window; it is one more unknown after those of W.

    python -m notebooks.studies.calibration    repeats likelihood and tracking (half an hour)
"""

import contextlib

import numpy as np

from notebooks.rivals import by_name
from rhec import paper
from rhec.core.lanes import lanes
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.closed_loop import build_sample, set_up
from rhec.simulation.offline import run_estimator
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate

TRAINING_SEEDS = range(1000, 1010)
_TRACKING_SEEDS = range(1000, 1024)
# Bounds on a standard deviation per sample; less than 1 mm, 1 mrad or 1 mm/s has no effect.
LEAST = 1e-3
MOST = 10.0
_FIRST = 0.01  # where each search begins
EVALUATIONS = 40  # of `search`, for each unknown
_MEMBERS = 6  # of `evolve`, for each unknown
_GENERATIONS = 20
# The places in sigma_w that each unknown sets.
_POSE = [(0, 1), (2,), (3,)]
_SOIL = [(4,), (5,)]
UNKNOWNS = dict.fromkeys(("rhe", "augmented_ekf", "bounded_ekf"), _POSE + _SOIL)
_NOT_ESTIMATED = "ekf", "rhe_no_slip", "rhe_fixed_traction", "fixed_traction", "traction_oracle"
UNKNOWNS |= dict.fromkeys((*_NOT_ESTIMATED, "drift_oracle"), _POSE)
UNKNOWNS["yaw_drift_ekf"] = _POSE + _SOIL + [(6,)]
# Of the rules that look at errors: W, and in place 6 the RHE's σ_ω.
OF_ERRORS = dict(rhe=_POSE + _SOIL + [(6,)], ekf=_POSE, bounded_ekf=_POSE + _SOIL)
_MOST_BY_TRACKING = 1.0
# Soil that slips as much as that under recorded robots, the same below both tracks, and noise that
# is white: what the models assume.
SOFT_SOIL = dict(mu_mean=0.9, mu_deviation=0.04, kappa_mean=0.8, kappa_deviation=0.08)
SOFT_SOIL |= dict(soil_under="centre", slip_difference=0.0, gnss_sigma_m=0.03, gnss_slow_share=0.0)
SOFT_SOIL |= dict(bump_sigma_radps=0.02, rut_length_m=0.0)


def oracle_runs(seeds, duration_s=240.0, **world):
    """Runs with the true state in the loop, one a seed, in the default world or another."""
    fields = dict(estimator="oracle", duration_s=duration_s) | world
    return simulate([Scenario(seed=seed, **fields) for seed in seeds])


def deviance(estimator, sigma_w, runs, **fields):
    """-2 log likelihood of the measurements of Runs under a process noise.

    `fields` are other settings of the estimator, fields of Scenario.
    """
    sigma_w = tuple(map(float, sigma_w))
    scenario = Scenario(estimator=by_name(estimator), sigma_w=sigma_w, **fields)
    return sum(run_estimator(scenario, run, "deviance")["deviance"].sum() for run in runs)


def search(objective, unknowns):
    """Find the standard deviations that minimise an objective, with EVALUATIONS a unknown.

    Args:
        objective: Function of sigma_w, a tuple.
        unknowns: For each unknown, the places in sigma_w that it sets; other places are LEAST.

    Returns:
        The best sigma_w that was tried, to two digits, and its objective.
    """
    from scipy.optimize import minimize  # a fifth of a second to load, and few ever search

    tried = {}

    def evaluate(logarithms):
        if len(tried) == EVALUATIONS * len(unknowns):
            raise _Exhausted
        sigma_w = _sigma_of(logarithms, unknowns)
        tried[sigma_w] = objective(sigma_w)
        return tried[sigma_w]

    # Powell's own limit counts whole lines only; the exception stops at the exact number.
    with contextlib.suppress(_Exhausted):
        minimize(
            evaluate,
            np.full(len(unknowns), np.log(_FIRST)),
            method="Powell",
            bounds=[np.log((LEAST, MOST))] * len(unknowns),
            options=dict(xtol=0.01, ftol=1e-6),
        )
    best = min(tried, key=tried.get)
    return tuple(float(f"{value:.2g}") for value in best), tried[best]


def _sigma_of(logarithms, unknowns):
    """The standard deviations with these logarithms in the places of the unknowns, else LEAST."""
    sigma = np.full(max(map(max, unknowns)) + 1, LEAST)
    for places, logarithm in zip(unknowns, logarithms):
        sigma[list(places)] = np.exp(logarithm)
    return tuple(sigma.tolist())


def evolve(objective, unknowns, most):
    """Find the standard deviations that minimise an objective with many minima.

    Args:
        objective, unknowns: As for `search`.
        most: Upper bound on a standard deviation.

    Returns:
        The best sigma_w, to two digits, and its objective.
    """
    from scipy.optimize import differential_evolution  # as above

    found = differential_evolution(
        lambda logarithms: objective(_sigma_of(logarithms, unknowns)),
        [np.log((LEAST, most))] * len(unknowns),
        popsize=_MEMBERS,
        maxiter=_GENERATIONS,
        seed=0,
        polish=False,
    )
    return tuple(float(f"{value:.2g}") for value in _sigma_of(found.x, unknowns)), found.fun


def of_errors(estimator, sigma):
    """The fields of Scenario for what `evolve` finds with OF_ERRORS: W, and σ_ω of an RHE."""
    if estimator != "rhe":
        return dict(estimator=estimator, sigma_w=sigma)
    return dict(sigma_w=sigma[:6], sigma_v=(*paper.SIGMA_V[:3], sigma[6]))


class _Exhausted(Exception):
    """All evaluations are used up."""


def calibrate(estimator, **world):
    """sigma_w of an estimator by maximum likelihood on the training seeds, and its deviance.

    `world` are fields of Scenario other than the default world's.
    """
    runs = oracle_runs(TRAINING_SEEDS, **world)
    return search(lambda sigma_w: deviance(estimator, sigma_w, runs), UNKNOWNS[estimator])


def tracking_error_m(seeds=_TRACKING_SEEDS, **fields):
    """Mean true error [m] over these seeds of a Scenario with these fields."""
    scenarios = [Scenario(seed=seed, **fields) for seed in seeds]
    # One structure is driven hundreds of times, which pays for compiling its lanes.
    lanes.load(build_sample, *set_up(scenarios[0]).structure)
    return campaign(scenarios, workers=1)["mean_error_true_m"].fillna(np.inf).mean()


def tune_for_tracking(estimator):
    """W of an estimator (`of_errors`) by least mean true error, and that error [m]."""
    return evolve(
        lambda sigma: tracking_error_m(**of_errors(estimator, sigma)),
        OF_ERRORS[estimator],
        _MOST_BY_TRACKING,
    )


if __name__ == "__main__":
    for name in UNKNOWNS:
        print("by prediction", name, *calibrate(name))
    for name in ("rhe", "ekf", "augmented_ekf"):
        print("by prediction on soft soil", name, *calibrate(name, **SOFT_SOIL))
    for name in OF_ERRORS:
        print("by tracking", name, *tune_for_tracking(name))
