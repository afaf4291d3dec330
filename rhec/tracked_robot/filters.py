"""The robot's Kalman filters: the paper's EKF, eq. (23)-(26), and its rivals, as rows of a table.

The paper's filter has the state (x, y, θ, ν), the measured yaw rate as input, an Euler step, and
the traditional model, that is μ = κ = 1. An oracle is the same filter that is passed the true
traction. The augmented filter, of which the paper warns (Sec. Extended Kalman Filter), has (μ, κ)
as states, too, and does not keep their estimates between 0 and 1. The bounded filter does.

Not in the paper is the yaw drift δ [rad/m]. The paper's model turns by its yaw rate alone. On soil
that differs between the tracks the robot also turns on a straight, in proportion to the way that it
goes (left and right slip, or the lateral offset of the instantaneous centre of rotation; Pentzer,
Brennan and Reichard, 2014):

    θ̇ = κω + μνδ,  δ = (μ_r - μ_l) / (b μ)

δ is estimated like the traction, as a random walk, but without bounds. By this result, `yaw_drift`,
the controller corrects its command (`rhec.tracked_robot.yaw_disturbance`).
"""

from dataclasses import replace

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import with_packed_memory
from rhec.core.estimator.filter import Filter, Noise
from rhec.core.model.base import Model, interval
from rhec.tracked_robot import tuning
from rhec.tracked_robot.choice import EstimatorRecord, TractionInput
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f, f_with_drift
from rhec.tracked_robot.rhe import SIGMA_START

_NOTHING = ca.SX(0, 1)
_TRACTION = QUANTITIES[4:]
_YAW_DRIFT = "yaw_drift_radpm"
# At the start the yaw drift is unknown: 0.05 rad/m are two per cent of slip between the tracks.
_GUESS = {_YAW_DRIFT: 0.0}
_SIGMA_START = SIGMA_START | {_YAW_DRIFT: 0.05}


def _euler(x, u, p):
    """Eq. (23): one Euler step of a sample from (x, y, θ, ν), with u = (ω, μ, κ)."""
    x_m, y_m, theta, nu = ca.vertsplit(x)
    omega, mu, kappa = ca.vertsplit(u)
    ahead = paper.DT_S * mu * nu
    turned = theta + paper.DT_S * kappa * omega
    return ca.vertcat(x_m + ahead * ca.cos(theta), y_m + ahead * ca.sin(theta), turned, nu)


def _with_constant_speed(f):
    """f(ξ, ω, p) as the rate of (x, y, θ, ν), with u = (ω, μ, κ, …)."""
    return lambda x, u, p: ca.vertcat(f(x[:3], u[0], ca.vertcat(x[3], u[1:])), 0)


def _pose_and_speed(f, passed, discrete=False):
    """The Model of (x, y, θ, ν) with the yaw rate as input.

    So is what a filter is `passed` of the soil, which no output measures.
    """
    return Model(
        states=QUANTITIES[:4],
        inputs=("omega_radps", *passed),
        parameters={},
        outputs=_ROBOT.outputs,
        f=f,
        max_measurement=_ROBOT.limits,
        sigma_held=_ROBOT.sigma_held,
        discrete=discrete,
    )


_ROBOT = SPEED_MODELS["parameter"].model
_DRIFTING_ROBOT = replace(_ROBOT, parameters=_ROBOT.parameters | {_YAW_DRIFT: None}, f=f_with_drift)
_PAPERS = _pose_and_speed(_euler, _TRACTION, discrete=True)
# These show what knowing the traction is worth, so they are otherwise the better model.
_KNOWN_TRACTION = _pose_and_speed(_with_constant_speed(f), _TRACTION)
_KNOWN_DRIFT = _pose_and_speed(_with_constant_speed(f_with_drift), (*_TRACTION, _YAW_DRIFT))


def _build_step(name, model, bounds):
    """A filter as a Function (memory, z_N, V, W) -> (memory, estimate, …).

    A filter that is passed the traction has it as one more input: the `traction` of the sample, on
    which the robot drives from there on. It ends the estimate.
    """
    kalman = Filter(interval(model), paper.DT_S, bounds=bounds)
    shapes = dict(z_N=(4, 1), V=(4, 1), W=(model.n_s, 1))
    n_passed = len(model.inputs) - 1
    if n_passed:
        shapes["traction"] = (n_passed, 1)

    @with_packed_memory(f"{name}_step", kalman.memory_shapes, ca.SX, **shapes)
    def step(z_N, V, W, traction=_NOTHING, **memory):
        # The yaw rate counts as exact, also where the last one is held.
        noise = Noise(V=ca.vertcat(V[:3], 0), W=W, held=0)
        after = kalman.sample(z_N, noise, **memory)
        known = ca.vertcat(after.m, traction)
        results = dict(estimate=known[:6], covariance=after.P, deviance=after.deviance)
        if _YAW_DRIFT in model.names:  # estimated or passed
            results["yaw_drift"] = known[6]
        # The interval that begins at this sample is on the soil of this sample.
        return results | after.memory | dict(v=ca.vertcat(after.v[0], traction))

    return step


def _init(model, guess, sigma):
    """The memory before the first sample, {name: array}."""
    guess = _GUESS | guess
    sigma = _SIGMA_START | sigma
    return dict(
        m=np.array([guess[name] for name in model.joint_names]),
        P=np.diag(np.square([sigma[name] for name in model.joint_names])),
        # No interval ends at the first sample, so that its inputs have no effect.
        v=np.zeros(len(model.inputs)),
        started=0.0,
    )


def _filter(name, model, passed=TractionInput.NONE, bounds=None):
    """The EstimatorRecord of a filter; `tuning` has its noise.

    Args:
        name: Of the filter.
        model: What it knows of the robot.
        passed: What it is passed of the soil; (1, 1) for one that takes a traction.
        bounds: Of its states, as for a Filter; None: those of the model.
    """
    return EstimatorRecord(
        build_step=lambda choice: _build_step(
            name, model, model.bounds if bounds is None else bounds
        ),
        init=lambda choice, guess, sigma=_SIGMA_START: _init(model, guess, sigma),
        settings=lambda scenario: tuning.variances_of(name, scenario),
        states=lambda choice: model.joint_names,
        n_sigma_w=lambda choice: model.n_s,
        traction_input=passed,
        has_yaw_drift=_YAW_DRIFT in model.names,
    )


ESTIMATORS = {
    "ekf": _filter("ekf", _PAPERS),
    "augmented_ekf": _filter("augmented_ekf", _ROBOT, bounds={}),
    "bounded_ekf": _filter("bounded_ekf", _ROBOT),
    "yaw_drift_ekf": _filter("yaw_drift_ekf", _DRIFTING_ROBOT),
    "fixed_traction": _filter("fixed_traction", _KNOWN_TRACTION, TractionInput.FIELD_MEAN),
    "traction_oracle": _filter("traction_oracle", _KNOWN_TRACTION, TractionInput.TRUE),
    "drift_oracle": _filter("drift_oracle", _KNOWN_DRIFT, TractionInput.TRUE_WITH_DRIFT),
}
