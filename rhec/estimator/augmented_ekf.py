"""Extended Kalman Filter of the adaptive model, eq. (systemmodel): what the paper warns of (Sec.
Extended Kalman Filter).

State (x, y, θ, ν, μ, κ): the traction parameters are random walks beside the rest, and nothing
keeps their estimates between 0 and 1.
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi.build import with_packed_memory
from rhec.estimator import ekf
from rhec.estimator.kalman import is_valid_measurement

# W as standard deviations of (x, y, θ, ν, μ, κ) per sample. The paper has no such filter: printed
# is the RHE's, for the same six; calibrated as ever.
SIGMA_W = {"printed": paper.SIGMA_W_RHE, "calibrated": (0.001, 0.001, 0.005, 0.001, 0.0058, 0.0055)}


def build_step(dt_s):
    """The filter as one CasADi Function {step}: predict, then correct; memory as in `ekf`, with m
    (6,), P (6, 6), W (6,).
    """

    def step(m, P, omega, started, z, V, W):
        omega = ca.if_else(is_valid_measurement(z, 3), z[3], omega)
        predicted = ca.vertcat(ekf.f(m[:4], omega, m[4:], dt_s), m[4:])
        m, P, deviance = ekf.predict_and_correct(m, P, predicted, started, z, V, W)
        return dict(estimate=m, covariance=P, deviance=deviance, m=m, P=P, omega=omega, started=1)

    memory = dict(m=(6, 1), P=(6, 6), omega=(1, 1), started=(1, 1))
    return dict(
        step=with_packed_memory(
            "augmented_ekf_step", step, memory, dict(z=(4, 1), V=(4, 1), W=(6, 1)), ca.SX
        )
    )


def init(guess, sigma):
    """Memory before the first sample: guess (6,) = (x, y, θ, ν, μ, κ), sigma its standard
    deviations.
    """
    return dict(m=np.array(guess), P=np.diag(np.square(sigma[:6])), omega=0.0, started=0.0)
