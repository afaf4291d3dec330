"""Pure pursuit, to compare the paper's controller with.

    pursuing = dataclasses.replace(scenario, controller=pure_pursuit.controller(scenario))

It drives on an arc through the first desired pose, with the traction taken into account. An arc
through the goal has the curvature 2 left / distance² (Coulter, "Implementation of the pure pursuit
path tracking algorithm", 1992), and the tracks must turn by

    ω = 2 μ̂ν̂ left / (κ̂ distance²)

The goal is `look_ahead_m` ahead of the closest point. Weights have no effect.
"""

import casadi as ca

import rhec
from rhec.core._casadi.build import casadi_function
from rhec.tracked_robot.references import LEAST_KAPPA
from rhec.tracked_robot.rhc import horizon_of

_LEAST_DISTANCE_M = 0.05  # to the goal, of which the square is a divisor


def controller(scenario):
    """Pure pursuit for a Scenario, as a rhec.Controller.

    Raises:
        ValueError: If the scenario has no goal ahead.
    """
    if scenario.look_ahead_m == 0:
        raise ValueError("look_ahead_m was 0.0; for pure pursuit it should be above 0, such as 1.0")
    return rhec.Controller(build_step(scenario.prediction_horizon))


def build_step(N):
    """The step of pure pursuit, of a loop whose references have N intervals."""
    references = horizon_of(N).references
    needed = ("s_0", "x_ref", "lower", "upper")

    @casadi_function("pure_pursuit_step", **{name: references[name] for name in needed})
    def step(s_0, x_ref, lower, upper):
        x, y, theta, nu, mu, kappa = ca.vertsplit(s_0)
        ahead = x_ref[0, 0] - x
        beside = x_ref[1, 0] - y
        left = beside * ca.cos(theta) - ahead * ca.sin(theta)
        distance_squared = ca.fmax(ahead**2 + beside**2, _LEAST_DISTANCE_M**2)
        omega = 2 * mu * nu * left / (ca.fmax(kappa, LEAST_KAPPA) * distance_squared)
        return dict(command=ca.fmin(ca.fmax(omega, lower), upper))

    return step
