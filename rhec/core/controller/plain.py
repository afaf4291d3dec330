"""The stages of an RHC of which only the commands are bounded, with diagonal weights: eq. (12).

Its QP is solved in the changes Δu of the commands, with all states eliminated.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.controller.horizon import (
    active_before,
    build_roll_out,
    commanded_stages,
    for_all_samples,
    plain_stages,
    planned,
    row_of_commands,
)
from rhec.core.solver import gauss_newton
from rhec.core.solver.line_search import line_search
from rhec.core.solver.stage_qp import stage_qp


class PlainStages:
    """The stages of a Horizon, as `rhec.core.controller.phases` takes them.

    Args:
        horizon: The Horizon.
    """

    tolerance = ("g", "least", "most", "multipliers")
    taken = "ok"
    reported = ()

    def __init__(self, horizon):
        self.loop_symbols = horizon.loop_symbols
        self.roll_out = build_roll_out(horizon)
        self.search = _build_search(horizon) if horizon.damped else None
        self._horizon = horizon
        self._qp = horizon.qp.build(horizon) if horizon.qp else StagewiseQP(horizon)
        self._gradient = _build_gradient(horizon, self.roll_out)

    def prepare(self, inputs):
        """What the QP can prepare, such as its Hessian."""
        return self._qp.prepare(**{name: inputs[name] for name in ("D", "B", "Q", "QN", "R")})

    def solve(self, inputs):
        """The estimate and the references move the gradient; the QP gives the change."""
        horizon = self._horizon
        step = self._gradient(**select_inputs(self._gradient, inputs))
        change, multipliers, solved = self._qp.solve(step, inputs)
        change = ca.reshape(change, len(horizon.command), horizon.N)
        return dict(change=change, multipliers=multipliers, ok=solved, **step)

    def command_bounds(self, inputs):
        """Lowest and highest commands."""
        return inputs["lower"], inputs["upper"]

    def remember(self, u):
        """The plan alone is remembered."""
        return {}

    def kkt(self, u, u_ref, u_plan, g, least, most, multipliers):
        """The KKT tolerance of the plan u, whose other inputs follow u_ref."""
        horizon = self._horizon
        before = planned(horizon, [u[place, :] for place in horizon.command], u_ref)
        change = row_of_commands(u_plan - before, horizon).T
        return gauss_newton.kkt_tolerance(ca.dot(g.T, change), multipliers, least, most)


class StagewiseQP:
    """The QP in the commanded inputs by a Riccati recursion over its stages."""

    def __init__(self, horizon):
        self.horizon = horizon
        weights = (ca.Sparsity.diag(n) for n in (horizon.n_x, len(horizon.command)))
        stages = (*plain_stages(horizon), *weights)
        self._solve = stage_qp(horizon.N, *stages, horizon.loop_symbols)

    def prepare(self, D, B, Q, QN, R):
        """Return no outputs: the recursion needs the active set, so there is nothing to prepare."""
        return {}

    def solve(self, step, inputs):
        """Solve min ½ Δu'HΔu + g'Δu, least ≤ Δu ≤ most, where the stages imply H.

        `step` holds the gradient g and the bounds least and most of the commands' change Δu, as
        rows; `inputs` are those of the feedback phase. Returns the rows Δu and its multipliers, and
        whether they are the solution.
        """
        stages = commanded_stages(self.horizon, inputs)
        stages |= {name: ca.diag(inputs[name]) for name in self.horizon.weights}
        bounds = dict(lower=step["least"], upper=step["most"])
        active = active_before(self.horizon, inputs)
        solution = self._solve(**stages, g=step["g"], **bounds, active=active)
        return solution["x"], solution["multipliers"], solution["solved"]


def _build_backward(horizon):
    """The gradient g in an interval's commands, and the adjoint λ before it, from the one after.

    λ' = λ_{i+1} + Q (x_{i+1} - x_r,{i+1}), where the parameters have no weight;
    g_i = R (u_i - u_r,i) + B_i' λ' and λ_i = A_i' λ'.
    """
    n_x = horizon.n_x
    n_p = horizon.n_s - n_x
    command = list(horizon.command)
    s_i = (horizon.n_s, 1)
    x_i = (n_x, 1)
    u_i = (horizon.n_u, 1)
    R_i = horizon.weights["R"]
    _, D_i, B_i = horizon.interval.sparsities.values()

    @casadi_function("rhc_backward")
    def backward(
        adjoint: s_i, D: D_i, B: B_i, weight: x_i, s: s_i, ref: x_i, u: u_i, u_ref: u_i, R: R_i
    ):
        adjoint = adjoint + ca.vertcat(weight * (s[:n_x] - ref), ca.SX(n_p, 1))
        g = R * (u - u_ref)[command] + B[:, command].T @ adjoint
        return dict(g=g, adjoint_before=(horizon.interval.A_0 + D).T @ adjoint)

    return backward


def _build_gradient(horizon, roll_out):
    """The gradient of the cost at the previous plan, rolled out from the new estimate."""
    N = horizon.N
    command = list(horizon.command)
    backward = _build_backward(horizon)
    shapes = horizon.memory | horizon.dynamics | horizon.weights | horizon.references

    @casadi_function("rhc_gradient", horizon.loop_symbols, **shapes)
    def gradient(s, u, F, D, B, Q, QN, R, s_0, x_ref, u_ref, lower, upper):
        plan = planned(horizon, [u[place, :] for place in command], u_ref)
        nodes = roll_out(s, u, F, D, B, s_0, plan)
        D = ca.horzsplit(D, horizon.n_s)
        B = ca.horzsplit(B, horizon.n_u)
        ref, u, u_ref = map(ca.horzsplit, (x_ref, plan, u_ref))
        adjoint = ca.DM.zeros(horizon.n_s)  # λ_N
        g = [None] * N
        weight = QN  # of node N; node 0 has none, since no input moves it
        for i in reversed(range(N)):
            end = nodes[i + 1], ref[i + 1]
            g[i], adjoint = backward(adjoint, D[i], B[i], weight, *end, u[i], u_ref[i], R)
            weight = Q
        u = row_of_commands(plan, horizon)
        least = for_all_samples(lower, horizon) - u
        most = for_all_samples(upper, horizon) - u
        return dict(g=ca.vertcat(*g).T, least=least, most=most)

    return gradient


def _build_search(horizon):
    """The line search, with the cost of eq. (12) and Σ |x̂ - s_0|, |F(s_i, u_i) - s_{i+1}|."""
    N = horizon.N
    memory = horizon.memory
    command = list(horizon.command)
    data = {name: horizon.references[name] for name in ("s_0", "x_ref", "u_ref")}

    @casadi_function("rhc_cost_and_gaps", ca.MX, **memory, **horizon.weights, **data)
    def cost_and_gaps(s, u, Q, QN, R, s_0, x_ref, u_ref):
        weights = ca.horzcat(ca.repmat(Q, 1, N - 1), QN)
        off = s[: horizon.n_x, 1:] - x_ref[:, 1:]
        moved = (u - u_ref)[command, :]
        squares = ca.vertcat(ca.vec(weights * off**2), ca.vec(ca.repmat(R, 1, N) * moved**2))
        dt_s = ca.repmat(ca.DM(horizon.dt_s), 1, N)
        ends = horizon.interval.step.map(N)(s[:, :N], u, dt_s)
        gaps = ca.veccat(s[:, 0] - s_0, ends - s[:, 1:])
        return dict(cost=ca.sum1(squares) / 2, gaps=ca.sum1(ca.fabs(gaps)))

    return line_search("rhc_search", memory, horizon.weights | data, cost_and_gaps)
