"""Which estimator a scenario means: its step (memory, z, settings …) -> (memory, estimate, …), its
first memory, its settings V and W.
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi.build import vector
from rhec.estimator import augmented_ekf, ekf, rhe
from rhec.extensions import dual

# Those that are told the traction are not the paper's: W of their own, found as the calibrated ones
# are.
SIGMA_W_TRACTION_ORACLE, SIGMA_W_FIXED_TRACTION = (
    (0.001, 0.001, 0.0048, 0.001),
    (0.0075, 0.0075, 0.0052, 0.0016),
)
NAMES = ("rhe", "ekf", "augmented_ekf", "fixed_traction", "dual", "oracle", "traction_oracle")
EKFS = ("ekf", "fixed_traction", "traction_oracle")  # one filter, told another traction each


def identity(estimator):
    """A name for compiled code: the estimator's, or the whole text of a Function of one's own."""
    return estimator.serialize() if isinstance(estimator, ca.Function) else estimator


def step(identity, horizon_rhe, speed_model, arrival_mean, qp, robust):
    """The estimator's Function. Beyond memory and z it takes by name what it needs: V, W, the
    `traction` (2,) it is told or all the `truth` (6,).
    """
    if identity == "rhe":
        return rhe.functions(paper.DT_S, horizon_rhe, speed_model, arrival_mean, qp, robust)["step"]
    if identity == "dual":
        return dual.functions(paper.DT_S, horizon_rhe, arrival_mean, qp, robust)["step"]
    if identity in EKFS:
        return ekf.functions(paper.DT_S)["step"]
    if identity == "augmented_ekf":
        return augmented_ekf.functions(paper.DT_S)["step"]
    if identity == "oracle":
        memory, z, truth = ca.SX.sym("memory", 6), ca.SX.sym("z", 4), ca.SX.sym("truth", 6)
        return ca.Function(
            "oracle",
            [memory, z, truth],
            [truth, truth],
            ["memory", "z", "truth"],
            ["memory", "estimate"],
            {"allow_duplicate_io_names": True},
        )
    return ca.Function.deserialize(identity)


def first_memory(scenario, guess, sigma=rhe.SIGMA_START):
    """The memory before the first sample, from a guess of (x, y, θ, ν, μ, κ) and its standard
    deviations, which begin at the paper's W.
    """
    if scenario.estimator == "rhe":
        return vector(
            rhe.start(guess, sigma, scenario.horizon_rhe, scenario.speed_model, scenario.robust)
        )
    if scenario.estimator in EKFS:
        return vector(ekf.start(guess, sigma))
    if scenario.estimator == "augmented_ekf":
        return vector(augmented_ekf.start(guess, sigma))
    if scenario.estimator == "dual":
        soil = rhe.start(guess, sigma, scenario.horizon_rhe, robust=scenario.robust)
        return np.append(vector(soil), vector(ekf.start(guess, sigma)))
    length = (
        scenario.estimator.numel_in(0)
        if isinstance(scenario.estimator, ca.Function)
        else len(guess)
    )
    return np.append(guess, np.zeros(length))[:length]


def entries(estimator, speed_model):
    """How many standard deviations sigma_w has; 0 for an estimator without process noise."""
    return {
        "rhe": rhe.entries(speed_model),
        "dual": len(dual.SIGMA_W),
        "augmented_ekf": 6,
        **dict.fromkeys(EKFS, 4),
    }.get(estimator, 0)


def variances(scenario):
    """The settings V and W of the scenario's estimator."""
    if scenario.estimator == "rhe":
        return rhe.variances(
            scenario.speed_model,
            scenario.reading,
            scenario.sigma_w,
            scenario.sigma_v,
            scenario.track_width_m,
        )
    default = {
        "ekf": ekf.SIGMA_W[scenario.reading],
        "augmented_ekf": augmented_ekf.SIGMA_W[scenario.reading],
        "dual": dual.SIGMA_W,
        "fixed_traction": SIGMA_W_FIXED_TRACTION,
        "traction_oracle": SIGMA_W_TRACTION_ORACLE,
    }
    sigma_w = (
        default.get(str(scenario.estimator), (0.0,))
        if scenario.sigma_w is None
        else scenario.sigma_w
    )
    return dict(V=np.square(scenario.sigma_v), W=np.square(sigma_w))
