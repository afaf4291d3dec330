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


def disturbance_of(nu, mu, kappa, yaw_drift, upper):
    """d of a yaw drift, at most half of ω_max = `upper`; 0 where it is not finite.

    The arguments are CasADi expressions or numbers.
    """
    d = mu * nu * yaw_drift / ca.fmax(kappa, LEAST_KAPPA)
    within = ca.fmax(ca.fmin(d, _MOST * upper), -_MOST * upper)
    return ca.if_else(ca.fabs(d) < np.inf, within, 0)


def counted_in():
    """d and ω + d of a measured ω, as a Function (estimate, yaw_drift, upper, omega_measured)."""

    @casadi_function("counted_in", estimate=(6, 1), yaw_drift=_ONE, upper=_ONE, omega_measured=_ONE)
    def counted_in(estimate, yaw_drift, upper, omega_measured):
        _, _, _, nu, mu, kappa = ca.vertsplit(estimate)
        d = disturbance_of(nu, mu, kappa, yaw_drift, upper)
        return dict(disturbance=d, omega_measured=omega_measured + d)

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
