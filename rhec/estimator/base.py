"""Which estimator a scenario means: its step (memory, z, settings …) -> (memory, estimate, …), its
first memory, its settings V and W.
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi.build import pack_array
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


def estimator_key(estimator):
    """A name for compiled code: the estimator's, or the whole text of a Function of one's own."""
    return estimator.serialize() if isinstance(estimator, ca.Function) else estimator


def step(key, estimation_horizon, speed_model, arrival_mean, qp, robust):
    """The estimator's Function. Beyond memory and z it takes by name what it needs: V, W, the
    `traction` (2,) it is told or all the `truth` (6,).
    """
    if key == "rhe":
        return rhe.build_phases(
            paper.DT_S, estimation_horizon, speed_model, arrival_mean, qp, robust
        )["step"]
    if key == "dual":
        return dual.build_step(paper.DT_S, estimation_horizon, arrival_mean, qp, robust)["step"]
    if key in EKFS:
        return ekf.build_step(paper.DT_S)["step"]
    if key == "augmented_ekf":
        return augmented_ekf.build_step(paper.DT_S)["step"]
    if key == "oracle":
        memory, z, truth = ca.SX.sym("memory", 6), ca.SX.sym("z", 4), ca.SX.sym("truth", 6)
        return ca.Function(
            "oracle",
            [memory, z, truth],
            [truth, truth],
            ["memory", "z", "truth"],
            ["memory", "estimate"],
            {"allow_duplicate_io_names": True},
        )
    return ca.Function.deserialize(key)


def first_memory(scenario, guess, sigma=rhe.SIGMA_START):
    """The memory before the first sample, from a guess of (x, y, θ, ν, μ, κ) and its standard
    deviations, which begin at the paper's W.
    """
    if scenario.estimator == "rhe":
        return pack_array(
            rhe.init(
                guess, sigma, scenario.estimation_horizon, scenario.speed_model, scenario.robust
            )
        )
    if scenario.estimator in EKFS:
        return pack_array(ekf.init(guess, sigma))
    if scenario.estimator == "augmented_ekf":
        return pack_array(augmented_ekf.init(guess, sigma))
    if scenario.estimator == "dual":
        soil = rhe.init(guess, sigma, scenario.estimation_horizon, robust=scenario.robust)
        return np.append(pack_array(soil), pack_array(ekf.init(guess, sigma)))
    length = (
        scenario.estimator.numel_in(0)
        if isinstance(scenario.estimator, ca.Function)
        else len(guess)
    )
    return np.append(guess, np.zeros(length))[:length]


def n_sigma_w(estimator, speed_model):
    """How many standard deviations sigma_w has; 0 for an estimator without process noise."""
    return {
        "rhe": rhe.n_sigma_w(speed_model),
        "dual": len(dual.SIGMA_W),
        "augmented_ekf": 6,
        **dict.fromkeys(EKFS, 4),
    }.get(estimator, 0)


def noise_settings(scenario):
    """The settings V and W of the scenario's estimator."""
    if scenario.estimator == "rhe":
        return rhe.noise_settings(
            scenario.speed_model,
            scenario.process_noise,
            scenario.sigma_w,
            scenario.sigma_v,
            scenario.track_width_m,
        )
    default = {
        "ekf": ekf.SIGMA_W[scenario.process_noise],
        "augmented_ekf": augmented_ekf.SIGMA_W[scenario.process_noise],
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
