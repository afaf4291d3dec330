"""The paper's tracked robot as a Model (Sec. "System Model with Traction Coefficients").

State ξ = (x, y, θ) [m, m, rad], input u = ω [rad/s], parameters p = (ν, μ, κ) [m/s, 1, 1], output
z = (x, y, ν, ω), eq. (5)-(8).
"""

from dataclasses import replace
from typing import NamedTuple

import casadi as ca

from rhec.core.model.robot_model import Model
from rhec.core.model.robot_model import rk4 as rk4  # eq. (3)
from rhec.tracked_robot.tuning import Noise

# The estimate of every estimator, in this order: pose ξ and parameters p.
QUANTITIES = ("x_m", "y_m", "theta_rad", "nu_mps", "mu", "kappa")
YAW_DRIFT = "yaw_drift_radpm"  # one more parameter, not in the paper: see `f_with_drift`
# What GNSS and encoders measure, z; the measurements of other sensors follow.
OUTPUTS = ("x_m", "y_m", "nu_mps", "omega_radps")
_TRACTION = {"mu": (0.0, 1.0), "kappa": (0.0, 1.0)}  # eq. (14)
_LIMITS = (1e8, 1e8, 100.0, 100.0)
# An encoder that measures nothing for a sample tells nothing: 1 m/s and 1 rad/s are full speed.
SIGMA_HELD = {"nu_mps": 1.0, "omega_radps": 1.0}


def f(xi, u, p):
    """Eq. (2): ξ̇ = f(ξ, u, p) = (μν cos θ, μν sin θ, κω); eq. (1) where μ = κ = 1.

    Args:
        xi: (3,) pose (x, y, θ) [m, m, rad].
        u: Yaw rate ω of the tracks [rad/s].
        p: (3,) speed ν of the tracks [m/s], traction coefficients μ and κ.

    Returns:
        (3,) dξ/dt.
    """
    theta = xi[2]
    nu, mu, kappa = (p[i] for i in range(3))
    return ca.vertcat(mu * nu * ca.cos(theta), mu * nu * ca.sin(theta), kappa * u)


def f_with_drift(xi, u, p):
    """Eq. (2) with the yaw drift δ [rad/m], which is not in the paper: θ̇ = κω + μνδ.

    Args:
        xi: (3,) pose (x, y, θ) [m, m, rad].
        u: Yaw rate ω of the tracks [rad/s].
        p: (4,) speed ν of the tracks [m/s], traction coefficients μ and κ, yaw drift δ [rad/m].

    Returns:
        (3,) dξ/dt.
    """
    nu = p[0]
    mu = p[1]
    delta = p[3]
    return f(xi, u, p) + ca.vertcat(0, 0, mu * nu * delta)


def h(xi, u, p):
    """Eq. (4): z = h(ξ, u, p) = (x, y, ν, ω), by GNSS and the encoders; arguments as for `f`."""
    return ca.vertcat(xi[0], xi[1], p[0], u)


def _with_measured_speed(f):
    """f(ξ, ω, p) with the speed as the first input instead of the first parameter."""
    return lambda xi, u, p: f(xi, u[1], ca.vertcat(u[0], p))


def _with_drift(model, f):
    """A Model with the yaw drift as its last parameter, which has no bounds."""
    return replace(model, parameters=model.parameters | {YAW_DRIFT: None}, f=f)


class SpeedModel(NamedTuple):
    """How a robot's speed enters its model, and the noise that goes with it."""

    model: Model
    noise: Noise | None = None  # its default, where `tuning.NOISES` has none

    @property
    def n_sigma_w(self):
        """Number of entries at the joint state's end that have process noise."""
        return len(self.noise.sigma_w if self.noise else self.model.joint_names)


_PARAMETER = Model(
    states=QUANTITIES[:3],
    inputs=("omega_radps",),
    parameters={"nu_mps": None} | _TRACTION,
    outputs=OUTPUTS,
    f=f,
    h=h,
    max_measurement=_LIMITS,
    sigma_held={"omega_radps": SIGMA_HELD["omega_radps"]},
)
_INPUT = Model(
    states=QUANTITIES[:3],
    inputs=("nu_mps", "omega_radps"),
    parameters=_TRACTION,
    outputs=OUTPUTS,
    f=_with_measured_speed(f),
    max_measurement=_LIMITS,
    sigma_held=SIGMA_HELD,
)
# ν is one parameter of the window, as in the paper, or a measured input of each interval
# (interpretation G13).
SPEED_MODELS = {"parameter": SpeedModel(_PARAMETER), "input": SpeedModel(_INPUT)}
# The same with the yaw drift, which is not in the paper.
DRIFTING_SPEED_MODELS = {
    "parameter": SpeedModel(_with_drift(_PARAMETER, f_with_drift)),
    "input": SpeedModel(_with_drift(_INPUT, _with_measured_speed(f_with_drift))),
}
