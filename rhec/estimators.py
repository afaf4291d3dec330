"""Which estimator a scenario means: its step (memory, z, settings …) -> (memory, estimate, …), its first memory, its process noise."""

import casadi as ca
import numpy as np

from rhec import ekf, paper, rhe
from rhec.function import vector
from rhec.scenario import SIGMA_W


def identity(estimator):
    """A name for compiled code: the estimator's, or the whole text of a Function of one's own."""
    return estimator.serialize() if isinstance(estimator, ca.Function) else estimator


def step(identity, horizon_rhe, speed_model, arrival_mean, qp):
    """The estimator's Function. Beyond memory and z it takes by name what it needs: V, W, the true `traction` (2,) or all the `truth` (6,)."""
    if identity == "rhe":
        return rhe.functions(paper.DT_S, horizon_rhe, speed_model, arrival_mean, qp)["step"]
    if identity in ("ekf", "traction_oracle"):
        return ekf.functions(paper.DT_S)["step"]
    if identity == "oracle":
        memory, z, truth = ca.SX.sym("memory", 6), ca.SX.sym("z", 4), ca.SX.sym("truth", 6)
        return ca.Function("oracle", [memory, z, truth], [truth, truth], ["memory", "z", "truth"], ["memory", "estimate"],
                           {"allow_duplicate_io_names": True})
    return ca.Function.deserialize(identity)


def first_memory(scenario, guess):
    """The memory before the first sample, from a guess of (x, y, θ, ν, μ, κ). The arrival cost begins at the paper's W."""
    if scenario.estimator == "rhe":
        return vector(rhe.start(guess, paper.SIGMA_W_RHE, scenario.horizon_rhe, scenario.speed_model))
    if scenario.estimator in ("ekf", "traction_oracle"):
        return vector(ekf.start(guess, paper.SIGMA_W_EKF))
    length = scenario.estimator.numel_in(0) if isinstance(scenario.estimator, ca.Function) else len(guess)
    return np.append(guess, np.zeros(length))[:length]


def sigma_w(scenario):
    """The standard deviations behind W. The traction oracle is not the paper's: it always has the calibrated ones."""
    if scenario.sigma_w is not None:
        return np.array(scenario.sigma_w)
    if scenario.estimator == "traction_oracle":
        return np.array(SIGMA_W["ekf", "calibrated"])
    sigma = np.array(SIGMA_W.get((scenario.estimator, scenario.reading), (0.0,)))
    return np.delete(sigma, 3) if scenario.estimator == "rhe" and scenario.speed_model == "input" else sigma
