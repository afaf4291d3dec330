"""The paper's extended Kalman filter, eq. (23)-(26), and variants that take a Runge-Kutta step.

The paper's filter has the state (x, y, θ, ν), the measured yaw rate as input, an Euler step, and
the traditional model, that is μ = κ = 1. Here the traction is an argument, so that the same filter
can be given the true one. The augmented filter, of which the paper warns (Sec. Extended Kalman
Filter), has (μ, κ) as states, too, and does not keep their estimates between 0 and 1. The bounded
filter does.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import with_packed_memory
from rhec.core.estimator.ekf import predict_and_correct
from rhec.core.model.base import Model, interval, rk4
from rhec.core.model.limits import is_valid_measurement
from rhec.core.solver.box_qp import box_qp
from rhec.tracked_robot import tuning
from rhec.tracked_robot.choice import Estimator, TractionInput
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f
from rhec.tracked_robot.rhe import SIGMA_START

_ROBOT = SPEED_MODELS["parameter"].model
_POSE_AND_SPEED = Model(
    states=QUANTITIES[:4],
    inputs=("omega_radps", *QUANTITIES[4:]),
    parameters={},
    outputs=_ROBOT.outputs,
    f=lambda x, u, p: ca.vertcat(f(x[:3], u[0], ca.vertcat(x[3], u[1:])), 0),
    max_measurement=_ROBOT.limits,
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


def _filter(model, move, m, P, omega, started, z, V, W):
    """One sample: m⁻ = f(m, ω), P⁻ = APA' + W, eq. (24)-(26), then the update with z (4,).

    `move` is (m, ω) -> m⁻ and omega the last valid yaw rate; before the first sample, where
    `started` is 0, there is only the update. V and W are variances. The result is the memory after
    the sample, with covariance and deviance.
    """
    # While the encoders are silent, the last yaw rate is held.
    omega = ca.if_else(is_valid_measurement(z[3], model.limits[3]), z[3], omega)
    predicted = move(m, omega)
    A = ca.jacobian(predicted, m)
    outputs = interval(model).outputs
    m, P, deviance = predict_and_correct(m, P, predicted, A, ca.diag(W), started, z, V, outputs)
    return dict(covariance=P, deviance=deviance, m=m, P=P, omega=omega, started=1)


def _memory(n):
    return dict(m=(n, 1), P=(n, n), omega=(1, 1), started=(1, 1))


def build_step(dt_s, integrate=_euler, n_traction=2):
    """The EKF as a Function (memory, z_N, V, W, traction) -> (memory, estimate, …).

    Its memory is that of `_filter`, and the traction (2,) of the last sample: the robot drove on it
    during the interval that ends now. `integrate` is `_euler`, as in the paper, or `runge_kutta`,
    or takes a traction with more than two entries, `n_traction`; they end the estimate.
    """
    memory = _memory(4) | dict(last_traction=(n_traction, 1))
    inputs = dict(z_N=(4, 1), V=(4, 1), W=(4, 1), traction=(n_traction, 1))

    @with_packed_memory("ekf_step", memory, ca.SX, **inputs)
    def step(m, P, omega, last_traction, started, z_N, V, W, traction):
        def move(m, omega):
            return integrate(m, omega, last_traction, dt_s)

        after = _filter(_POSE_AND_SPEED, move, m, P, omega, started, z_N, V, W)
        return dict(estimate=ca.vertcat(after["m"], traction), last_traction=traction) | after

    return step


def build_joint_step(model, dt_s, bounded=False):
    """An EKF of a robot's joint state as a Function (memory, z_N, V, W) -> (memory, estimate, …).

    `model` has the states (x, y, θ), the input ω, and parameters whose first one is ν. With
    `bounded` the estimate stays within the model's bounds.
    """
    n = model.n_s

    # The parameters are random walks: they stay in the mean.
    def move(m, omega):
        return ca.vertcat(rk4(model.dynamics, m[:3], omega, m[3:], dt_s), m[3:])

    @with_packed_memory("augmented_ekf_step", _memory(n), ca.SX, z_N=(4, 1), V=(4, 1), W=(n, 1))
    def step(m, P, omega, started, z_N, V, W):
        after = _filter(model, move, m, P, omega, started, z_N, V, W)
        if bounded:
            after["m"] = within_bounds(interval(model).bounds, after["m"], after["P"])
        return dict(estimate=after["m"]) | after

    return step


def within_bounds(bounds, m, P):
    """The likeliest state within the bounds {place: (lowest, highest)} of a Gaussian (m, P).

    With q the bounded states and H = P_qq⁻¹: min ½ (q - m_q)' H (q - m_q) within the bounds; the
    other states are conditioned on q, m - P_xq H (m_q - q). P does not change, as in the RHE.
    """
    places = [*bounds]
    lower, upper = (ca.DM([bound[side] for bound in bounds.values()]) for side in (0, 1))
    # The information of q alone, with the other states marginalised.
    H = ca.inv_minor(P[places, places])
    q, _ = box_qp(len(places))(H, -H @ m[places], lower, upper)
    m = m - P[:, places] @ H @ (m[places] - q)
    m[places] = q  # exactly, without rounding
    return m


def init(names, guess, sigma=SIGMA_START):
    """The memory before the first sample, {name: array}, for the states of these names."""
    memory = dict(
        m=np.array([guess[name] for name in names]),
        P=np.diag(np.square([sigma[name] for name in names])),
        omega=0.0,
        started=0.0,
    )
    # No interval ends at the first sample, so that its traction has no effect.
    return memory if len(names) > 4 else memory | dict(last_traction=np.ones(2))


def _estimator(name, build, n=4, traction_input=TractionInput.NONE):
    """The Estimator with the first n of QUANTITIES as states, whose step is build(dt_s)."""
    return Estimator(
        build_step=lambda choice: build(choice.dt_s),
        init=lambda choice, guess, sigma=SIGMA_START: init(QUANTITIES[:n], guess, sigma),
        settings=lambda scenario: tuning.variances_of(name, scenario),
        states=lambda choice: QUANTITIES[:n],
        n_sigma_w=lambda choice: n,
        traction_input=traction_input,
    )


def _build_augmented_step(dt_s):
    return build_joint_step(_ROBOT, dt_s)


def _build_bounded_step(dt_s):
    return build_joint_step(_ROBOT, dt_s, bounded=True)


def _build_better_step(dt_s):
    return build_step(dt_s, runge_kutta)


ESTIMATORS = {
    "ekf": _estimator("ekf", build_step),
    "augmented_ekf": _estimator("augmented_ekf", _build_augmented_step, 6),
    "bounded_ekf": _estimator("bounded_ekf", _build_bounded_step, 6),
    # They show what knowing the traction is worth, so their model is otherwise the better one.
    "fixed_traction": _estimator("fixed_traction", _build_better_step, 4, TractionInput.FIELD_MEAN),
    "traction_oracle": _estimator("traction_oracle", _build_better_step, 4, TractionInput.TRUE),
}
