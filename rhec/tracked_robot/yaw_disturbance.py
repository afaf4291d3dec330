"""Compensation of a disturbance of the yaw rate, around any controller. Not in the paper.

The soil turns the robot by more than κω. Written as a part d [rad/s] of the tracks' yaw rate:

    θ̇ = κ (ω + d)

d is that of an estimated yaw drift δ, d = μ̂ν̂δ̂ / κ̂ (`rhec.tracked_robot.filters`).
The controller plans ω + d, from a measured ω + d, within bounds moved by d; what is commanded is ω.
Its own model stays as it is. What it remembers of its plan is ω + d.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function
from rhec.tracked_robot.references import LEAST_KAPPA

_ONE = (1, 1)
_MOST = 0.5  # share of the bound ω_max that a disturbance may take: the rest is left for steering


def _bounded(d, upper):
    """The disturbance d within its share of the bound; 0 where it is not finite."""
    return ca.if_else(ca.fabs(d) < np.inf, ca.fmax(ca.fmin(d, _MOST * upper), -_MOST * upper), 0)


def build_from_drift():
    """d = μ̂ν̂δ̂ / κ̂ as a Function (estimate, yaw_drift, upper) -> disturbance [rad/s]."""

    @casadi_function("disturbance_from_drift", estimate=(6, 1), yaw_drift=_ONE, upper=_ONE)
    def disturbance(estimate, yaw_drift, upper):
        _, _, _, nu, mu, kappa = ca.vertsplit(estimate)
        d = mu * nu * yaw_drift / ca.fmax(kappa, LEAST_KAPPA)
        return dict(disturbance=_bounded(d, upper))

    return disturbance


def counted_in():
    """ω + d of a measured ω, as a Function (omega_measured, disturbance) -> omega_measured."""

    @casadi_function("counted_in", omega_measured=_ONE, disturbance=_ONE)
    def counted_in(omega_measured, disturbance):
        return dict(omega_measured=omega_measured + disturbance)

    return counted_in


def moved_bounds():
    """The bounds of ω + d, as a Function (lower, upper, disturbance) -> (lower, upper)."""

    @casadi_function("moved_bounds", lower=_ONE, upper=_ONE, disturbance=_ONE)
    def moved(lower, upper, disturbance):
        return dict(lower=lower + disturbance, upper=upper + disturbance)

    return moved


def taken_off():
    """The command ω of a planned ω + d, as a Function (command, disturbance) -> command."""

    @casadi_function("taken_off", command=_ONE, disturbance=_ONE)
    def taken_off(command, disturbance):
        return dict(command=command - disturbance)

    return taken_off
