"""The calibrated reading: W from the likelihood of innovations on training seeds, never from the paper's results (readings R1, R2).

Procedure. 1. Drive the default scenario on the training seeds with the true state in the loop, so that the data do not depend on any estimator.
2. Run an estimator over the recorded measurements; its deviance is -2 log likelihood of each measurement given all before it. 3. Choose the
standard deviations behind W that minimise the deviance summed over all training runs (Powell's method on their logarithms, position x and y
sharing one), between LEAST and MOST. The paper's text is not consulted; seeds below 1000 are never used. `python -m rhec.calibration` repeats it.
"""

import dataclasses

import casadi as ca
import numpy as np
from scipy.optimize import minimize

from rhec import compiled, estimators, fold, paper
from rhec.closed_loop import simulate
from rhec.scenario import Scenario

TRAINING_SEEDS = range(1000, 1010)
MEASURED = ["x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"]
UNKNOWNS = {"rhe": 5, "ekf": 3}   # x and y, θ, ν[, μ, κ]
LEAST, MOST = 1e-3, 10.0          # of a standard deviation per sample; 1 mm, 1 mrad, 1 mm/s: less is the same as none


def functions(estimator):
    """The estimator's step with its deviance as the row: what the likelihood is summed from."""
    step = estimators.step(estimator, paper.HORIZON, "parameter", "smoothed", "structured", False)
    inputs = step.mx_in()
    outputs = dict(zip(step.name_out(), step.call(inputs)))
    return fold.functions(ca.Function("deviance", inputs, [outputs["memory"], outputs["deviance"]], step.name_in(), ["memory", "deviance"],
                                      {"allow_duplicate_io_names": True}))


def deviance(estimator, sigma_w, runs):
    """Sum of -2 log likelihood of the measurements of `runs` under the process noise sigma_w."""
    steps = compiled.load(functions, estimator)
    settings = dict(V=np.square(paper.SIGMA_V), W=np.square(sigma_w)) | (dict(traction=np.ones(2)) if estimator == "ekf" else {})
    total = 0.0
    for run in runs:
        x, y, theta = run.log.loc[0, ["x_m", "y_m", "theta_rad"]]
        scenario = dataclasses.replace(run.scenario, estimator=estimator)
        memory = estimators.first_memory(scenario, (x, y, theta, scenario.speed_mps, 1.0, 1.0))
        total += fold.fold(steps, memory, run.log[MEASURED].to_numpy(), settings)[1].sum()
    return total


def sigma_from(logarithms):
    """(x, y, θ, …) from the logarithms of (x and y, θ, …)."""
    sigma = np.exp(logarithms)
    return np.insert(sigma, 0, sigma[0])


def calibrate(estimator, seeds=TRAINING_SEEDS):
    """Process noise of "rhe" or "ekf" by maximum likelihood on these seeds: standard deviations, rounded to two digits, and the deviance."""
    runs = [simulate(Scenario(estimator="oracle", seed=seed)) for seed in seeds]
    unknowns = UNKNOWNS[estimator]
    result = minimize(lambda logarithms: deviance(estimator, sigma_from(logarithms), runs), np.full(unknowns, np.log(0.03)), method="Powell",
                      bounds=[np.log((LEAST, MOST))] * unknowns, options=dict(xtol=0.01, ftol=1e-6))
    return tuple(float(f"{value:.2g}") for value in sigma_from(result.x)), result.fun


if __name__ == "__main__":
    for name in UNKNOWNS:
        print(name, *calibrate(name))
