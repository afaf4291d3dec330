"""An iteration of a constrained RHC that goes a share of its step.

Where a Gauss-Newton step goes too far, as it does along a curved bound, full steps may jump to and
fro for ever. With the steps d, now, and d' before, the share becomes
-share d'·(d - d') / ‖d - d'‖² (Aitken's relaxation; Irons and Tuck, 1969).
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.controller import constrained
from rhec.core.controller.constrained import Kind, bounds_of_nodes, ends_with
from rhec.core.solver.line_search import CONVERGED, DONE
from rhec.core.solver.rti import IMPROVE

_LEAST_SHARE = 0.05
_FULL_SHARE = 0.99  # from here on a full step is taken, which ends exactly at the bounds
_NO_STEP = 1e-9  # relative to the largest number: a step at which an iteration ends
_TINY = 1e-300


def build_phases(horizon):
    """Build the phases of a constrained RHC, and an iteration without shift (see `rti`)."""
    phases = constrained.build_phases(horizon)
    return phases | {IMPROVE: _build_improve(horizon, phases)}


def _build_improve(horizon, phases):
    """Linearise, feedback and expand, and a share of their step.

    `penalty` carries the last share and step on; at first it is 0. Where the QP was not solved,
    what expand leaves stays.
    """
    cost = _build_cost(horizon)
    unknowns = {name: horizon.memory[name] for name in "su"}
    carried = 1 + sum(rows * columns for rows, columns in unknowns.values())
    shapes = horizon.memory | horizon.weights | horizon.references | horizon.bounds

    @casadi_function("rhc_improve", ca.MX, **shapes, penalty=(carried, 1))
    def improve(penalty, **inputs):
        values = dict(inputs)
        for name in ("linearise", "feedback", "expand"):
            full = phases[name](**select_inputs(phases[name], values))
            values |= full if name != "expand" else {}
        ok = values["ok"]
        change = values["kkt"] / ca.fmax(cost(**select_inputs(cost, inputs))["cost"], _TINY)
        step = ca.veccat(*(full[name] - inputs[name] for name in unknowns))
        stays = ca.norm_inf(step) <= _NO_STEP * ca.norm_inf(ca.veccat(full["s"], full["u"]))
        share = _next_share(penalty[0], penalty[1:], step)
        # The iteration after one that was not solved, and moved nothing, would be the same.
        done = ca.if_else(ok, ca.logic_or(change <= DONE, stays), ca.norm_inf(step) == 0)
        is_full = ca.logic_or(ca.logic_or(done, ca.logic_not(ok)), share == 1)
        after = {}
        for name in unknowns:
            part = inputs[name] + share * (full[name] - inputs[name])
            after[name] = ca.if_else(is_full, full[name], part)
        outputs = {name: values[name] for name in phases["feedback"].name_out()}
        outputs |= after | dict(before=inputs["before"], u_plan=after["u"])
        outputs |= dict(converged=ok * ca.logic_or(change <= CONVERGED, stays), done=done)
        carry = ca.if_else(ok, ca.vertcat(share, step), ca.DM.zeros(carried))
        return outputs | dict(penalty_after=carry)

    return improve


def _next_share(share, last, step):
    """The share of a step, from the share and the step before; share 0 says that there is none."""
    change = step - last
    relaxed = -share * ca.dot(last, change) / ca.fmax(ca.dot(change, change), _TINY)
    # A comparison with a number that is none is false; then the step is a full one.
    is_partial = ca.logic_and(share > 0, relaxed < _FULL_SHARE)
    return ca.if_else(is_partial, ca.fmax(relaxed, _LEAST_SHARE), 1)


def _build_cost(horizon):
    """The cost of nodes s and inputs u, and the price of what soft rows exceed."""
    N = horizon.plain.N
    command = list(horizon.plain.command)
    node = _build_node(horizon)
    data = horizon.weights | horizon.references | horizon.bounds

    @casadi_function("rhc_cost", ca.MX, **horizon.memory, **data)
    def cost(s, u, before, s_0, x_ref, u_ref, y_ref, Q, QN, R, Q_y, QN_y, R_delta, **bounds):
        last = ca.horzcat(before, u[command, : N - 1])
        refs = x_ref[:, :N], u_ref, y_ref[:, :N]
        # The state of node 0 is given, and has no weight.
        weights = ca.horzcat(ca.DM.zeros(*Q.shape), ca.repmat(Q, 1, N - 1))
        costs, rows = node.map(N)(s[:, :N], u, last, *refs, weights, R, Q_y, R_delta)
        of_outputs, _ = ends_with(horizon)
        nothing = ca.DM.zeros(horizon.n_c, horizon.n_c)
        at_end = of_outputs @ QN_y @ of_outputs
        end = (s[:, N], u[:, -1], u[command, -1], x_ref[:, N], u_ref[:, -1], y_ref[:, N])
        cost_N, rows_N = node(*end, QN, nothing, at_end, nothing)
        rows = ca.horzcat(rows, rows_N)
        lower, upper = bounds_of_nodes(horizon, bounds)
        t = ca.fmax(ca.fmax(rows - upper, lower - rows), 0)[len(horizon.rows) - horizon.n_soft :, :]
        price = (
            ca.dot(bounds["linear"], ca.sum2(t)) + ca.dot(bounds["quadratic"], ca.sum2(t**2)) / 2
        )
        return dict(cost=ca.sum2(costs) + cost_N + price)

    return cost


def _build_node(horizon):
    """The cost of a node without soft prices, and the values of its rows."""
    n_x = horizon.plain.n_x
    command = list(horizon.plain.command)
    s_i = (horizon.plain.n_s, 1)
    u_i = (horizon.plain.n_u, 1)
    c_i = (horizon.n_c, 1)
    Q_i, _, R_i, Q_yi, _, R_di = horizon.weights.values()

    @casadi_function("rhc_cost_node")
    def node(
        s: s_i, u: u_i, last: c_i, x_ref: (n_x, 1), u_ref: u_i, y_ref: (horizon.n_y, 1),
        Q: Q_i, R: R_i, Q_y: Q_yi, R_delta: R_di,
    ):  # fmt: skip
        y = ca.SX(0, 1)
        if horizon.n_y:
            y = horizon.outputs.function(s[:n_x], u, s[n_x:])
        change = u[command] - last
        off = [(Q, s[:n_x] - x_ref), (R, (u - u_ref)[command]), (Q_y, y - y_ref)]
        off.append((R_delta, change))
        cost = sum(ca.bilin(weight, each, each) for weight, each in off) / 2
        values = {Kind.COMMAND: u[command], Kind.STATE: s, Kind.OUTPUT: y, Kind.CHANGE: change}
        rows = ca.vertcat(*(values[row.kind][row.place] for row in horizon.rows))
        return dict(cost=cost, rows=ca.densify(rows))

    return node
