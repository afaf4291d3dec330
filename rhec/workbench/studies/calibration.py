"""Process noise from training seeds, never from the paper's results: by likelihood (calibrated W,
R1, R2), and by tracking. Seeds below 1000 are never used.

All estimators are tuned alike: the same bounds on what a standard deviation per sample may be, the
same first one, the same search (Powell's method on logarithms, position x and y sharing one) and
the same number of evaluations for each unknown.

By likelihood. 1. Drive the default scenario on the training seeds with the true state in the loop,
so that the data do not depend on any estimator. 2. Run an estimator over the recorded measurements;
its deviance is -2 log likelihood of each measurement given all before it. 3. Choose the standard
deviations behind W that minimise the deviance summed over all training runs.

By tracking. The robot drives the training seeds by the estimator, and W minimises the mean true
error: not an estimator's best guess of the truth, but the one that this controller drives best by.

    python -m rhec.workbench.studies.calibration    repeats all of it (half an hour)
"""

import contextlib

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled, scan
from rhec.core._casadi.build import pack_array, select_inputs
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.closed_loop import build_sample, known_traction, set_up, simulate
from rhec.simulation.columns import MEASUREMENTS, POSE
from rhec.simulation.lanes import lanes
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import Choice, build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

__all__ = [
    "DUAL",
    "EVALUATIONS",
    "LEAST",
    "MOST",
    "SETTLED_S",
    "TRAINING_SEEDS",
    "UNKNOWNS",
    "calibrate",
    "columns",
    "deviance",
    "oracle_runs",
    "run_estimator",
    "scan_arguments",
    "search",
    "tracking_error_m",
    "tune_for_tracking",
]

SETTLED_S = 20.0  # by then the first guess, which is exact, no longer counts
TRAINING_SEEDS = range(1000, 1010)
_TRACKING_SEEDS = range(1000, 1024)
# of a standard deviation per sample; 1 mm, 1 mrad, 1 mm/s: less is the same as none
LEAST = 1e-3
MOST = 10.0
# where each search begins; how many for each unknown
_FIRST = 0.01
EVALUATIONS = 40
# where in sigma_w each unknown stands
_POSE = [(0, 1), (2,), (3,)]
_SOIL = [(4,), (5,)]
UNKNOWNS = dict.fromkeys(("rhe", "augmented_ekf", "bounded_ekf"), _POSE + _SOIL)
# Its RHE has no noise of its own in the pose, and a shorter window, for the time that a step takes.
UNKNOWNS["dual"] = [*_SOIL, (6, 7), (8,), (9,)]
DUAL = dict(estimation_horizon=10)
_NOT_ESTIMATED = "ekf", "rhe_no_slip", "rhe_fixed_traction", "fixed_traction", "traction_oracle"
UNKNOWNS |= dict.fromkeys(_NOT_ESTIMATED, _POSE)


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
    memory = own.pop("memory")
    options = {"allow_duplicate_io_names": True}
    row = ca.veccat(*(result[name] for name in outputs))
    names = ["memory", "stream", *own], ["memory", "row"]
    signals = [memory, stream, *own.values()], [result["memory"], row]
    return scan.build_scan(ca.Function("recorded", *signals, *names, options))


def columns(run, names):
    """Columns of a run's log, (n, names); pandas takes longer than the estimators that use them."""
    return np.array([run.columns[name] for name in names]).T


def scan_arguments(scenario, run, *outputs):
    """Arguments of `scan.scan` for these outputs of the scenario's estimator on the measurements of
    a run; it starts where the robot is.
    """
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator, choice.robust)
    guess = (*(run.columns[name][0] for name in POSE), run.scenario.speed_mps, 1.0, 1.0)
    memory = pack_array(estimator.init(choice, dict(zip(QUANTITIES, guess))))
    true = columns(run, ["mu", "kappa"])
    traction = np.broadcast_to(known_traction(estimator.given, run.terrain.mean, true), true.shape)
    stream = np.hstack([columns(run, MEASUREMENTS), traction])
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


def search(objective, unknowns):
    """The standard deviations that make the objective least within the bounds and evaluations that
    all are given, to two digits, and its value; `unknowns`: where each of them stands.
    """
    from scipy.optimize import minimize  # a fifth of a second; few ever search

    tried = {}

    def evaluate(logarithms):
        if len(tried) == EVALUATIONS * len(unknowns):
            raise _Exhausted
        sigma = np.full(max(map(max, unknowns)) + 1, LEAST)
        for places, logarithm in zip(unknowns, logarithms):
            sigma[list(places)] = np.exp(logarithm)
        sigma_w = tuple(sigma.tolist())
        tried[sigma_w] = objective(sigma_w)
        return tried[sigma_w]

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


class _Exhausted(Exception):
    """All evaluations are used up."""


def calibrate(estimator, **fields):
    """Process noise of an estimator by maximum likelihood on the training seeds: standard
    deviations, to two digits, and the deviance.
    """
    runs = oracle_runs(TRAINING_SEEDS)
    return search(lambda sigma_w: deviance(estimator, sigma_w, runs, **fields), UNKNOWNS[estimator])


def tracking_error_m(seeds=_TRACKING_SEEDS, **fields):
    """Mean true error [m] over these seeds of robots that drive by a Scenario of these fields."""
    scenarios = [Scenario(seed=seed, **fields) for seed in seeds]
    lanes.load(build_sample, *set_up(scenarios[0]).structure)  # a search is worth compiling them
    return campaign(scenarios, workers=1)["mean_error_true_m"].fillna(np.inf).mean()


def tune_for_tracking(estimator, **fields):
    """Process noise of an estimator by least mean true error on the training seeds: standard
    deviations, to two digits, and the error [m].
    """
    return search(
        lambda sigma_w: tracking_error_m(estimator=estimator, sigma_w=sigma_w, **fields),
        UNKNOWNS[estimator],
    )


if __name__ == "__main__":
    for name in UNKNOWNS:
        if name in tuning.SIGMA_W:
            print("by likelihood", name, *calibrate(name))
        fields = DUAL if name == "dual" else {}
        print("by tracking", name, *tune_for_tracking(name, **fields))
