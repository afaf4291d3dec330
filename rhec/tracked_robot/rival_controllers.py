"""Controllers to compare the paper's with: linear time-varying MPC and pure pursuit.

Each has the step of the RHC (`rhec.core.controller.rhc.build_phases`), with the same memory, names
and results, so that a closed loop can take one for the other.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, packed_size, select_inputs, unpack
from rhec.core.controller import rhc
from rhec.tracked_robot.references import LEAST_KAPPA

_LEAST_DISTANCE_M = 0.05  # to the goal of pure pursuit, of which the square is a divisor


def _within(omega, lower, upper):
    return ca.fmin(ca.fmax(omega, lower), upper)


def _with_memory(horizon, name, shapes, plan):
    """A step (memory, …) -> (memory, kkt, command, ok) whose memory is the plan, as the RHC's."""

    @casadi_function(name, ca.MX, memory=(packed_size(horizon.memory), 1), **shapes)
    def step(memory, **signals):
        result = plan(**signals)
        last = unpack(memory, horizon.memory)
        memory = ca.veccat(*(result.get(name, last[name]) for name in horizon.memory))
        return dict(memory=memory, **{key: result[key] for key in ("kkt", "command", "ok")})

    return step


def build_ltv_mpc(horizon):
    """Linear time-varying MPC: the RHC's QP, linearised about the path instead of its last plan.

    The error to the path obeys e_{i+1} = A_i e_i + B_i (u_i - ū_i), with A_i and B_i of the model
    at the desired poses and ū_i = (θ_r,i+1 - θ_r,i) / (κ̂ Δt), the yaw rate that follows the path
    (Falcone et al., "Predictive active steering control for autonomous vehicle systems", 2007).
    Cost and bounds are those of eq. (12).
    """
    phases = rhc.build_phases(horizon)

    def plan(**signals):
        x_ref = signals["x_ref"]
        parameters = signals["s_0"][horizon.n_x :]
        kappa = ca.fmax(parameters[2], LEAST_KAPPA)
        omega = (x_ref[2, 1:] - x_ref[2, :-1]) / (kappa * horizon.dt_s)
        u = _within(omega, signals["lower"], signals["upper"])
        s = ca.vertcat(x_ref, ca.repmat(parameters, 1, horizon.N + 1))
        values = signals | dict(s=s, u=u)
        for phase in ("linearise", "feedback", "expand"):
            function = phases[phase]
            values |= function(**select_inputs(function, values))
        return values | dict(command=values["u_plan"][:, 0])

    shapes = horizon.weights | horizon.references
    return _with_memory(horizon, "ltv_mpc_step", shapes, plan)


def build_pure_pursuit(horizon):
    """Pure pursuit of the first desired pose, with the traction taken into account.

    An arc through the goal has the curvature 2 left / distance² (Coulter, "Implementation of the
    pure pursuit path tracking algorithm", 1992), and the tracks must turn by

        ω = 2 μ̂ν̂ left / (κ̂ distance²)

    The goal is `look_ahead_m` ahead of the closest point. Weights have no effect.
    """
    needed = ("s_0", "x_ref", "lower", "upper")
    shapes = {name: horizon.references[name] for name in needed}

    def plan(s_0, x_ref, lower, upper):
        x, y, theta, nu, mu, kappa = ca.vertsplit(s_0)
        ahead = x_ref[0, 0] - x
        beside = x_ref[1, 0] - y
        left = beside * ca.cos(theta) - ahead * ca.sin(theta)
        distance_squared = ca.fmax(ahead**2 + beside**2, _LEAST_DISTANCE_M**2)
        omega = 2 * mu * nu * left / (ca.fmax(kappa, LEAST_KAPPA) * distance_squared)
        command = _within(omega, lower, upper)
        u = ca.repmat(command, 1, horizon.N)
        nodes = [s_0]
        for _ in range(horizon.N):
            nodes.append(horizon.interval.step(nodes[-1], command, horizon.dt_s))
        return dict(s=ca.horzcat(*nodes), u=u, kkt=ca.MX(0), command=command, ok=ca.MX(1))

    return _with_memory(horizon, "pure_pursuit_step", shapes, plan)


CONTROLLERS = dict(ltv_mpc=build_ltv_mpc, pure_pursuit=build_pure_pursuit)
