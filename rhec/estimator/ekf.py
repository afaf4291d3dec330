"""Extended Kalman Filter, eq. (kinematicmodelEKF), (generalmodelEKF), (noise).

State (x, y, θ, ν); the measured yaw rate is the input. The paper designs it on the traditional
model, that is μ = κ = 1; here the traction is an argument, so that the same filter can also be told
the true one.
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi.build import with_packed_memory
from rhec.estimator.kalman import is_valid_measurement, symmetric, update

# Process noise W as standard deviations of (x, y, θ, ν) per sample: to the letter (R1), and as
# `rhec.studies.calibration` found it on training seeds.
SIGMA_W = {"printed": paper.SIGMA_W_EKF, "calibrated": (0.017, 0.017, 0.013, 0.001)}
MEASURED = ((0, 0), (1, 1), (3, 2))  # x, y, ν: (place in the state, place in z)


def f(m, omega, traction, dt_s):
    """Eq. (kinematicmodelEKF) with traction (μ, κ): one Euler step of `dt_s` [s] from (x, y, θ, ν)."""
    x, y, theta, nu = ca.vertsplit(m)
    mu, kappa = ca.vertsplit(traction)
    return ca.vertcat(
        x + dt_s * mu * nu * ca.cos(theta),
        y + dt_s * mu * nu * ca.sin(theta),
        theta + dt_s * kappa * omega,
        nu,
    )


def predict_and_correct(m, P, predicted, started, z, V, W):
    """Mean and covariance predicted by the model's step m -> predicted (not before the first
    sample), then corrected by z; with the deviance.
    """
    A = ca.jacobian(predicted, m)
    m = ca.if_else(started, predicted, m)
    P = ca.if_else(started, symmetric(A @ P @ A.T) + ca.diag(W), P)
    m, P, _, _, deviance = update(m, P, z, V, MEASURED)
    return m, P, deviance


def build_step(dt_s, f=f):
    """The EKF as one CasADi Function {step}: predict by f, then correct.

    Memory: m (4,), P (4, 4), omega () last yaw rate [rad/s], started () 0 before the first sample,
    which only corrects. V (4,), W (4,) are variances, traction (2,). z (4,) holds the yaw rate of
    the interval that ends now; a missing one is the last one held.
    """

    def step(m, P, omega, started, z, V, W, traction):
        omega = ca.if_else(is_valid_measurement(z, 3), z[3], omega)
        m, P, deviance = predict_and_correct(m, P, f(m, omega, traction, dt_s), started, z, V, W)
        return dict(
            estimate=ca.vertcat(m, traction),
            covariance=P,
            deviance=deviance,
            m=m,
            P=P,
            omega=omega,
            started=1,
        )

    memory = dict(m=(4, 1), P=(4, 4), omega=(1, 1), started=(1, 1))
    return dict(
        step=with_packed_memory(
            "ekf_step", step, memory, dict(z=(4, 1), V=(4, 1), W=(4, 1), traction=(2, 1)), ca.SX
        )
    )


def init(guess, sigma):
    """Memory before the first sample: guess (6,) = (x, y, θ, ν, μ, κ), sigma (6,) its standard
    deviations.
    """
    return dict(m=np.array(guess[:4]), P=np.diag(np.square(sigma[:4])), omega=0.0, started=0.0)
