"""The problems that all contestants solve: consecutive samples of one closed-loop run, each with
the answer at convergence.
"""

from typing import NamedTuple

import numpy as np

from rhec import RHC, RHE, paper
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.tracked_robot.references import PathTracker


class Problem(NamedTuple):
    """One sample, and the optimum of its two nonlinear problems."""

    z: np.ndarray  # (4, N+1) the window of measurements, the newest last
    m: np.ndarray  # (6,) mean of the arrival cost
    H: np.ndarray  # (6, 6) its weight
    estimate: np.ndarray  # (6,) answer at the newest node; the controller starts from it
    xi_ref: np.ndarray  # (3, N+1)
    omega_ref: np.ndarray  # (N,)
    omega_plan: np.ndarray  # (N,) answer


def drive(samples):
    """A run with so many samples after the window has filled up."""
    duration_s = (paper.HORIZON + samples) * paper.DT_S
    return simulate(Scenario(process_noise="prediction", duration_s=duration_s))


def measured(run):
    """The measurements (n, 4) of a run."""
    return run.log[["x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"]].to_numpy()


def live(run):
    """rhec's estimator and controller as they begin this run."""
    guess = (*run.log.loc[0, ["x_m", "y_m", "theta_rad"]], run.scenario.speed_mps, 1.0, 1.0)
    return RHE(process_noise=run.scenario.process_noise, guess=guess), RHC()


def record(run, iterations=20):
    """The problems of a run, from the first full window on, each iterated so often."""
    estimator, controller = live(run)
    tracker = PathTracker(run.path)
    z = measured(run)
    problems = []
    for k, newest in enumerate(z):
        estimator.prepare()
        estimate = np.array(estimator.solve(newest, iterations)[:6])
        references = tracker.references(estimate, newest[3])
        xi_ref, omega_ref = (each.copy() for each in references)
        controller.prepare()
        controller.solve(estimate[:3], estimate[3:], xi_ref, omega_ref, iterations)
        if k >= paper.HORIZON:
            arrival = estimator.iteration.current
            problems.append(
                Problem(
                    z[k - paper.HORIZON : k + 1].T.copy(),
                    arrival["m"].copy(),
                    np.linalg.inv(arrival["P"].reshape(6, 6)),
                    estimate,
                    xi_ref,
                    omega_ref,
                    controller.omega_plan,
                )
            )
    return problems


def with_sums(parts):
    """{(problem, phase): number} with "overall" of each problem and of both."""
    parts = dict(parts)
    for problem in ("RHE", "RHC"):
        phases = [number for (which, _), number in parts.items() if which == problem]
        if len(phases) > 1:
            parts[problem, "overall"] = sum(phases)
    if ("RHE", "overall") in parts:
        parts["RHE + RHC", "overall"] = parts["RHE", "overall"] + parts["RHC", "overall"]
    return parts
