"""Kalman filters that know another part of the robot or of its soil than the paper's EKF.

The augmented filter, of which the paper warns (Sec. Extended Kalman Filter), has (μ, κ) as states
and does not keep their estimates between 0 and 1. An oracle is told the true traction, a filter
with fixed traction the field's mean.

Not in the paper is the yaw drift δ [rad/m]. The paper's model turns by its yaw rate alone. On soil
that differs between the tracks the robot also turns on a straight, in proportion to the way that it
goes (left and right slip, or the lateral offset of the instantaneous centre of rotation; Pentzer,
Brennan and Reichard, 2014):

    θ̇ = κω + μνδ,  δ = (μ_r - μ_l) / (b μ)

δ is estimated like the traction, as a random walk, but without bounds. By this result, `yaw_drift`,
the controller corrects its command (`rhec.tracked_robot.yaw_disturbance`).
"""

import casadi as ca

import rhec
from notebooks.rivals.noises import NOISES
from rhec.tracked_robot.filters import build_step, pose_and_speed
from rhec.tracked_robot.kinematics import (
    DRIFTING_SPEED_MODELS,
    QUANTITIES,
    SPEED_MODELS,
    YAW_DRIFT,
    f,
    f_with_drift,
)

_TRACTION = QUANTITIES[4:]
_ROBOT = SPEED_MODELS["parameter"].model
_DRIFTING_ROBOT = DRIFTING_SPEED_MODELS["parameter"].model


def _with_constant_speed(f):
    """f(ξ, ω, p) as the rate of (x, y, θ, ν), with u = (ω, μ, κ, …)."""
    return lambda x, u, p: ca.vertcat(f(x[:3], u[0], ca.vertcat(x[3], u[1:])), 0)


# These show what knowing the traction is worth, so they are otherwise the better model.
_KNOWN_TRACTION = pose_and_speed(_with_constant_speed(f), _TRACTION)
_KNOWN_DRIFT = pose_and_speed(_with_constant_speed(f_with_drift), (*_TRACTION, YAW_DRIFT))


def _first(model):
    """The Function (guess, sigma) -> first memory of a filter."""
    guess = ca.SX.sym("guess", len(QUANTITIES))
    sigma = ca.SX.sym("sigma", len(QUANTITIES) + 1)
    means = dict(zip(QUANTITIES, ca.vertsplit(guess))) | {YAW_DRIFT: 0.0}
    deviations = dict(zip((*QUANTITIES, YAW_DRIFT), ca.vertsplit(sigma)))
    m = ca.vertcat(*(means[name] for name in model.joint_names))
    P = ca.diag(ca.vertcat(*(deviations[name] for name in model.joint_names)) ** 2)
    # No interval ends at the first sample, so that its inputs have no effect.
    v = ca.SX.zeros(len(model.inputs))
    started = 0
    memory = ca.veccat(m, ca.densify(P), v, started)
    return ca.Function("first", [guess, sigma], [memory], ["guess", "sigma"], ["memory"])


def _filter(name, model, bounds=None, told=()):
    """A filter as a rhec.Estimator; arguments as of `rhec.tracked_robot.filters.build_step`."""
    return rhec.Estimator(
        build_step(name, model, bounds, told),
        first=_first(model),
        states=model.joint_names,
        noises=NOISES[name],
    )


RIVALS = {
    "augmented_ekf": _filter("augmented_ekf", _ROBOT, bounds={}),
    "yaw_drift_ekf": _filter("yaw_drift_ekf", _DRIFTING_ROBOT),
    "fixed_traction": _filter("fixed_traction", _KNOWN_TRACTION, told=("mean_traction",)),
    "traction_oracle": _filter("traction_oracle", _KNOWN_TRACTION, told=("traction",)),
    "drift_oracle": _filter("drift_oracle", _KNOWN_DRIFT, told=("traction", "yaw_drift")),
}
