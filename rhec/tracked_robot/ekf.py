"""The paper's extended Kalman filter, eq. (23)-(26), and its rivals, which take a Runge-Kutta step.

The paper's has state (x, y, θ, ν), the measured yaw rate as input, an Euler step, and the
traditional model, that is μ = κ = 1; here the traction is an argument, so that one filter can also
be told the true one. The augmented one is what the paper warns of (Sec. Extended Kalman Filter):
(μ, κ) are states, too, and nothing keeps their estimates between 0 and 1. The bounded one does
keep them there.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import with_packed_memory
from rhec.core.estimator.ekf import predict_and_correct
from rhec.core.model import base
from rhec.core.model.limits import is_valid_measurement
from rhec.core.solver.box_qp import box_qp
from rhec.tracked_robot import tuning
from rhec.tracked_robot.choice import Estimator, TractionInput
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f, rk4
from rhec.tracked_robot.rhe import SIGMA_START

__all__ = ["ESTIMATORS", "build_step", "init", "runge_kutta"]

_POSE_AND_SPEED = base.Model(
    states=QUANTITIES[:4],
    inputs=("omega_radps", *QUANTITIES[4:]),
    parameters={},
    outputs=SPEED_MODELS["parameter"].model.outputs,
    f=lambda x, u, p: ca.vertcat(f(x[:3], u[0], ca.vertcat(x[3], u[1:])), 0),
    max_measurement=SPEED_MODELS["parameter"].model.limits,
)


def _euler(m, omega, traction, dt_s):
    """Eq. (23) with traction (μ, κ): one Euler step of `dt_s` [s] from (x, y, θ, ν)."""
    x, y, theta, nu = ca.vertsplit(m)
    mu, kappa = ca.vertsplit(traction)
    ahead = dt_s * mu * nu
    return ca.vertcat(
        x + ahead * ca.cos(theta), y + ahead * ca.sin(theta), theta + dt_s * kappa * omega, nu
    )


def runge_kutta(m, omega, traction, dt_s):
    """Eq. (2) over `dt_s` [s] by one Runge-Kutta step from (x, y, θ, ν)."""
    return ca.vertcat(rk4(f, m[:3], omega, ca.vertcat(m[3], traction), dt_s), m[3])


def build_step(dt_s, integrate=_euler):
    """The EKF as a Function (memory, z_N, V, W, traction) -> (memory, estimate, …).

    Its memory: m (4,), P (4, 4), omega the last yaw rate [rad/s], driven the traction (2,) told at
    the last sample, on which the interval that ends now was driven, started 0 before the first
    sample, which only corrects. z_N (4,) holds the yaw rate of the interval that ends now; a
    missing one is the last one held.
    """
    memory = _memory(4) | dict(driven=(2, 1))

    @with_packed_memory("ekf_step", memory, ca.SX, z_N=(4, 1), V=(4, 1), W=(4, 1), traction=(2, 1))
    def step(m, P, omega, driven, started, z_N, V, W, traction):
        def move(m, omega):
            return integrate(m, omega, driven, dt_s)

        after = _filtered(_POSE_AND_SPEED, move, m, P, omega, started, z_N, V, W)
        return dict(estimate=ca.vertcat(after["m"], traction), driven=traction) | after

    return step


def _build_augmented_step(dt_s, bounded):
    """The augmented EKF as a Function (memory, z_N, V, W) -> (memory, estimate, …)."""
    model = SPEED_MODELS["parameter"].model

    @with_packed_memory("augmented_ekf_step", _memory(6), ca.SX, z_N=(4, 1), V=(4, 1), W=(6, 1))
    def step(m, P, omega, started, z_N, V, W):
        def move(m, omega):
            return ca.vertcat(runge_kutta(m[:4], omega, m[4:], dt_s), m[4:])

        after = _filtered(model, move, m, P, omega, started, z_N, V, W)
        if bounded:
            after["m"] = _within_bounds(base.interval(model).bounds, after["m"], after["P"])
        return dict(estimate=after["m"]) | after

    return step


def _within_bounds(bounds, m, P):
    """The likeliest state within the bounds {place: (lowest, highest)} of a Gaussian (m, P): all of
    it is conditioned on those that are violated. P stays: bounds left aside, as the RHE's.
    """
    places = [*bounds]
    lower, upper = (ca.DM([bound[side] for bound in bounds.values()]) for side in (0, 1))
    H = ca.inv_minor(P[places, places])
    x, _ = box_qp(len(places))(H, -H @ m[places], lower, upper)
    m = m - P[:, places] @ H @ (m[places] - x)
    m[places] = x
    return m


def _memory(n):
    return dict(m=(n, 1), P=(n, n), omega=(1, 1), started=(1, 1))


def _filtered(model, move, m, P, omega, started, z, V, W):
    """The memory after a sample, with covariance and deviance."""
    omega = ca.if_else(is_valid_measurement(z[3], model.limits[3]), z[3], omega)
    predicted = move(m, omega)
    A = ca.jacobian(predicted, m)
    outputs = base.interval(model).outputs
    m, P, deviance = predict_and_correct(m, P, predicted, A, ca.diag(W), started, z, V, outputs)
    return dict(covariance=P, deviance=deviance, m=m, P=P, omega=omega, started=1)


def init(n, guess, sigma=SIGMA_START):
    """Memory before the first sample of a filter of the first n QUANTITIES, by quantity."""
    m, sigma = ([of[name] for name in QUANTITIES[:n]] for of in (guess, sigma))
    memory = dict(m=np.array(m), P=np.diag(np.square(sigma)), omega=0.0, started=0.0)
    return memory if n == 6 else memory | dict(driven=np.ones(2))


def _estimator(name, build, n=4, traction_input=TractionInput.NONE):
    def settings(scenario):
        tuned = tuning.SIGMA_W[name][scenario.process_noise]
        sigma_w = tuned if scenario.sigma_w is None else scenario.sigma_w
        return dict(V=np.square(tuning.sigma_v_of(scenario)), W=np.square(sigma_w))

    return Estimator(
        build_step=lambda choice: build(choice.dt_s),
        init=lambda choice, guess, sigma=SIGMA_START: init(n, guess, sigma),
        settings=settings,
        states=lambda choice: QUANTITIES[:n],
        n_sigma_w=lambda choice: n,
        traction_input=traction_input,
    )


def _build_rival(dt_s):
    return build_step(dt_s, runge_kutta)


ESTIMATORS = {
    "ekf": _estimator("ekf", build_step),
    "augmented_ekf": _estimator(
        "augmented_ekf", lambda dt_s: _build_augmented_step(dt_s, bounded=False), 6
    ),
    "bounded_ekf": _estimator(
        "bounded_ekf", lambda dt_s: _build_augmented_step(dt_s, bounded=True), 6
    ),
    "fixed_traction": _estimator(
        "fixed_traction", _build_rival, traction_input=TractionInput.FIELD_MEAN
    ),
    "traction_oracle": _estimator(
        "traction_oracle", _build_rival, traction_input=TractionInput.TRUE
    ),
}
