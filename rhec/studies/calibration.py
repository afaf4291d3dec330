"""Process noise from training seeds, never from the paper's results: by likelihood (calibrated W,
R1, R2), and by tracking.

By likelihood. 1. Drive the default scenario on the training seeds with the true state in the loop,
so that the data do not depend on any estimator. 2. Run an estimator over the recorded measurements;
its deviance is -2 log likelihood of each measurement given all before it. 3. Choose the standard
deviations behind W that minimise the deviance summed over all training runs (Powell's method on
their logarithms, position x and y sharing one).

By tracking. The robot drives the training seeds by the estimator, and W minimises the mean true
error (Nelder and Mead's method): not an estimator's best guess of the truth, but the one that this
controller drives best by. Seeds below 1000 are never used.

    python -m rhec.studies.calibration    repeats all of it (minutes)
"""

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from rhec._casadi import compiled, scan
from rhec._casadi.build import pack_array, select_inputs
from rhec.columns import MEASUREMENTS, POSE
from rhec.scenario import Scenario
from rhec.simulation import known_traction, simulate
from rhec.tracked_robot.estimators import Choice, build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

__all__ = [
    "SETTLED_S", "TRAINING_SEEDS", "calibrate", "deviance", "oracle_runs",
    "run_estimator", "scan_arguments"
]  # fmt: skip

SETTLED_S = 20.0  # by then the first guess, which is exact, no longer counts
TRAINING_SEEDS = range(1000, 1010)
_TRACKING_SEEDS = range(1000, 1024)
# of a standard deviation per sample; 1 mm, 1 mrad, 1 mm/s: less is the same as none
_LEAST, _MOST = 1e-3, 10.0
# by likelihood: x and y, θ, ν[, μ, κ]
_UNKNOWNS = dict(rhe=5, ekf=3, augmented_ekf=5, fixed_traction=3, traction_oracle=3)
# by tracking: where in sigma_w each unknown stands, and where the search begins; the rest is _LEAST
_POSE, _SOIL = {(0, 1): 0.003, (2,): 0.01, (3,): 0.01}, {(4,): 0.01, (5,): 0.01}
_DUAL = {(4,): 0.006, (5,): 0.03, (6, 7): 0.002, (8,): 0.02, (9,): 0.01}
_TRACKING = {
    "rhe": (dict(estimation_horizon=15), {(0, 1): 0.02, (2,): 0.01, (3,): 0.1} | _SOIL),
    "ekf": ({}, _POSE),
    "augmented_ekf": ({}, _POSE | _SOIL),
    "fixed_traction": ({}, _POSE),
    "traction_oracle": ({}, _POSE),
    "dual": (dict(estimation_horizon=10), _DUAL),
}


def oracle_runs(seeds, duration_s=240.0):
    """Runs of the default scenario with the true state in the loop, one a seed."""
    asked = dict(estimator="oracle", duration_s=duration_s)
    return [simulate(Scenario(seed=seed, **asked)) for seed in seeds]


def _build_scan(outputs, choice):
    """Scan of an estimator's step over a stream of z and the traction that it is given, with these
    of its outputs as the row.
    """
    step = build_step(Choice(*choice))
    stream = ca.MX.sym("stream", 6)
    given = dict(z_N=stream[:4], traction=stream[4:])
    own = {name: ca.MX.sym(name, step.sparsity_in(name)) for name in step.name_in()}
    own = {name: symbol for name, symbol in own.items() if name not in given}
    result = step(**select_inputs(step, own | given))
    memory, options = own.pop("memory"), {"allow_duplicate_io_names": True}
    row = ca.veccat(*(result[name] for name in outputs))
    names = ["memory", "stream", *own], ["memory", "row"]
    signals = [memory, stream, *own.values()], [result["memory"], row]
    return scan.build_scan(ca.Function("recorded", *signals, *names, options))


def scan_arguments(scenario, run, *outputs):
    """Arguments of `scan.scan` for these outputs of the scenario's estimator on the measurements of
    a run; it starts where the robot is.
    """
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator, choice.robust)
    guess = (*run.log.loc[0, POSE], run.scenario.speed_mps, 1.0, 1.0)
    memory = pack_array(estimator.init(choice, dict(zip(QUANTITIES, guess))))
    true = run.log[["mu", "kappa"]].to_numpy()
    traction = np.broadcast_to(known_traction(estimator.given, run.terrain.mean, true), true.shape)
    stream = np.hstack([run.log[MEASUREMENTS], traction])
    return compiled.load(_build_scan, outputs, choice), memory, stream, estimator.settings(scenario)


def run_estimator(scenario, run, *outputs):
    """Outputs of the scenario's estimator on the measurements of a run, side by side (n, …)."""
    return scan.scan(*scan_arguments(scenario, run, *outputs))[1]


def deviance(estimator, sigma_w, runs, **fields):
    """Sum of -2 log likelihood of the measurements of `runs` under the process noise sigma_w;
    fields of Scenario: how else the estimator is set.
    """
    scenario = Scenario(estimator=estimator, sigma_w=tuple(map(float, sigma_w)), **fields)
    return sum(run_estimator(scenario, run, "deviance").sum() for run in runs)


def _sigma_from(logarithms):
    """(x, y, θ, …) from the logarithms of (x and y, θ, …)."""
    sigma = np.exp(logarithms)
    return np.insert(sigma, 0, sigma[0])


def _rounded(sigma):
    return tuple(float(f"{value:.2g}") for value in sigma)


def calibrate(estimator, **fields):
    """Process noise of an estimator by maximum likelihood on the training seeds: standard
    deviations, to two digits, and the deviance.
    """
    runs, unknowns = oracle_runs(TRAINING_SEEDS), _UNKNOWNS[estimator]
    result = minimize(
        lambda logarithms: deviance(estimator, _sigma_from(logarithms), runs, **fields),
        np.full(unknowns, np.log(0.03)),
        method="Powell",
        bounds=[np.log((_LEAST, _MOST))] * unknowns,
        options=dict(xtol=0.01, ftol=1e-6),
    )
    return _rounded(_sigma_from(result.x)), result.fun


def _tune_for_tracking(estimator, seeds=_TRACKING_SEEDS, evaluations=120):
    """Process noise of an estimator by least mean true error on these seeds: standard
    deviations, to two digits, and the error [m].
    """
    fields, unknowns = _TRACKING[estimator]

    def sigma_w(logarithms):
        choice = Choice.of(Scenario(estimator=estimator))
        sigma = np.full(estimator_of(estimator).n_sigma_w(choice), _LEAST)
        for places, logarithm in zip(unknowns, logarithms):
            sigma[list(places)] = np.exp(logarithm)
        return sigma

    def error_m(logarithms):
        given = dict(estimator=estimator, sigma_w=tuple(sigma_w(logarithms)), **fields)
        runs = [simulate(Scenario(seed=seed, **given)) for seed in seeds]
        return np.mean([run.metrics["mean_error_true_m"] for run in runs])

    begin, options = np.log([*unknowns.values()]), dict(maxfev=evaluations, adaptive=True)
    result = minimize(error_m, begin, method="Nelder-Mead", options=options)
    return _rounded(sigma_w(result.x)), result.fun


if __name__ == "__main__":
    for name in _UNKNOWNS:
        print("by likelihood", name, *calibrate(name))
    for name in _TRACKING:
        print("by tracking", name, *_tune_for_tracking(name))
