"""Compensation of a disturbance of the yaw rate, in front of any controller. Not in the paper.

The soil turns the robot by more than κω. Written as a part d [rad/s] of the tracks' yaw rate:

    θ̇ = κ (ω + d)

d is either that of an estimated yaw drift δ, d = μ̂ν̂δ̂ / κ̂, or that of a disturbance observer
(Ohnishi, Shibata and Murakami, "Motion control for advanced mechatronics", 1996): what the encoders
do not explain of the estimated turning, low-pass filtered with the time constant T.

    d⁺ = d + Δt/T ((θ̂_k - θ̂_{k-1}) / (κ̂ Δt) - ω_measured - d)

The estimator in front of the observer gets ω_measured + d for the yaw rate: without d in its model
its yaw would be off by as much as it takes to explain the turning by positions alone.

The controller plans ω + d, within bounds moved by d, and commands ω: its own model stays as it is.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, select_inputs, with_packed_memory
from rhec.tracked_robot.references import LEAST_KAPPA

_MOST = 0.5  # share of the bound ω_max that a disturbance may take: the rest is left for steering


def _bounded(d, upper):
    """The disturbance d within its share of the bound; 0 where it is not finite."""
    return ca.if_else(ca.fabs(d) < np.inf, ca.fmax(ca.fmin(d, _MOST * upper), -_MOST * upper), 0)


def build_from_drift():
    """d = μ̂ν̂δ̂ / κ̂ as a Function (estimate, yaw_drift, upper) -> disturbance [rad/s]."""
    one = (1, 1)

    @casadi_function("disturbance_from_drift", estimate=(6, 1), yaw_drift=one, upper=one)
    def disturbance(estimate, yaw_drift, upper):
        _, _, _, nu, mu, kappa = ca.vertsplit(estimate)
        d = mu * nu * yaw_drift / ca.fmax(kappa, LEAST_KAPPA)
        return dict(disturbance=_bounded(d, upper))

    return disturbance


def build_observer(dt_s):
    """The observer as a Function (memory, estimate, omega_measured, …) -> (memory, disturbance).

    Its memory is d, the last estimated yaw, and whether there was one.
    """
    one = (1, 1)
    memory = dict(d=one, theta=one, observing=one)
    inputs = dict(estimate=(6, 1), omega_measured=one, observer_time_s=one, upper=one)

    @with_packed_memory("disturbance_observer", memory, ca.SX, **inputs)
    def observe(d, theta, observing, estimate, omega_measured, observer_time_s, upper):
        turned = estimate[2] - theta
        kappa = ca.fmax(estimate[5], LEAST_KAPPA)
        unexplained = turned / (kappa * dt_s) - omega_measured
        share = ca.fmin(dt_s / observer_time_s, 1) * observing
        d = _bounded(d + share * (unexplained - d), upper)
        return dict(disturbance=d, d=d, theta=estimate[2], observing=1)

    return observe


def corrected(z, memory):
    """The measurement z = (x, y, ν, ω) with the observer's last d added to the yaw rate."""
    return z + ca.vertcat(0, 0, 0, memory[0])


def init_observer():
    """The observer's memory before the first sample."""
    return dict(d=0.0, theta=0.0, observing=0.0)


def compensated(control):
    """A controller's step with the input `disturbance` d: it plans ω + d and commands ω.

    The reference u_ref already counts d in where it is a measured yaw rate. What the controller
    remembers of its plan is ω + d.
    """
    shapes = {name: control.size_in(name) for name in control.name_in()}

    @casadi_function("compensated_step", ca.MX, **shapes, disturbance=(1, 1))
    def step(disturbance, **signals):
        bounds = dict(lower=signals["lower"] + disturbance, upper=signals["upper"] + disturbance)
        planned = control(**select_inputs(control, signals | bounds))
        return planned | dict(command=planned["command"] - disturbance)

    return step
