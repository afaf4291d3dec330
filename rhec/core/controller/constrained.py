"""Receding horizon control with outputs, weights of changes, and bounds on more than commands.

    min  ½ Σ_{i=1..N-1} ‖x_r,i - x_i‖²_Q + ½ ‖x_r,N - x_N‖²_{Q_N}
         + ½ Σ_{i=0..N-1} (‖u_r,i - u_i‖²_R + ‖u_i - u_{i-1}‖²_{R_Δ} + ‖y_r,i - y_i‖²_{Q_y})
         + ½ ‖y_r,N - y_N‖²_{Q_N,y} + Σ price(t)
    s.t. x_0 = x̂, x_{i+1} = F(x_i, u_i, p̂), y_i = h(x_i, u_i, p̂),
         lower - t ≤ row ≤ upper + t of states, outputs and changes u_i - u_{i-1},
         lower ≤ u_i ≤ upper

As in `rhc`, one Gauss-Newton step a sample, with all weights as full matrices. Its QP is solved by
`interior_point`, in changes of (x, u) from the plan rolled out from the new estimate. With weights
or bounds of changes, the last commands are states, too. u_{-1} is the command of the sample before.

Hard bounds of states, outputs and changes are soft ones whose price the QP chooses, so high that
they are exceeded where they cannot be kept, and nowhere else. Then `ok` is 0, and the commands
lead back as fast as their own bounds allow.

A state is bounded from node 1 on, because no command moves node 0. An output that depends on a
command is bounded and weighed at the nodes 0 … N-1, any other one at the nodes 1 … N.
"""

import enum
import functools
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.controller.horizon import Horizon, build_roll_out, planned
from rhec.core.model.limits import MAX_QP_ENTRY
from rhec.core.solver.interior_point import NO_PRICE, Shape, interior_point
from rhec.core.solver.relaxation import relaxation


class Kind(enum.Enum):
    """What a row bounds."""

    COMMAND = enum.auto()
    STATE = enum.auto()
    OUTPUT = enum.auto()
    CHANGE = enum.auto()  # of a command, from the sample before


class Row(NamedTuple):
    """One bounded quantity; `place` is its place among the commands, states or outputs."""

    kind: Kind
    place: int


@dataclass(frozen=True, eq=False)
class Outputs:
    """Named outputs y = h(x, u, p) of a controller; equal if they compute the same."""

    names: tuple[str, ...]
    function: ca.Function

    @functools.cached_property
    def key(self):
        """Everything that decides what is compiled for these outputs, as text."""
        return repr((self.names, self.function.serialize()))

    def __hash__(self):
        return hash(self.key)

    def __eq__(self, other):
        return isinstance(other, Outputs) and self.key == other.key


class ConstrainedHorizon(NamedTuple):
    """The structure of an RHC with bounds on more than commands."""

    plain: Horizon
    outputs: Outputs
    rows: tuple[Row, ...]  # those of all commands first
    has_changes: bool  # whether changes of commands have weights or bounds

    @property
    def n_c(self):
        """Number of commands."""
        return len(self.plain.command)

    @property
    def n_y(self):
        """Number of outputs."""
        return len(self.outputs.names)

    @property
    def n(self):
        """Number of the QP's states: x and, if changes count, the last commands."""
        return self.plain.n_x + self.has_changes * self.n_c

    @property
    def n_soft(self):
        """Number of rows that may be exceeded: all but those of the commands."""
        return len(self.rows) - self.n_c

    @property
    def soft_names(self):
        """Names of these rows, as `bounds` and `delta_bounds` have them."""
        model = self.plain.model
        commands = [model.inputs[place] for place in self.plain.command]
        names = {Kind.STATE: model.states, Kind.OUTPUT: self.outputs.names, Kind.CHANGE: commands}
        what = {Kind.CHANGE: "the change of "}
        return tuple(
            what.get(row.kind, "") + repr(names[row.kind][row.place])
            for row in self.rows[self.n_c :]
        )

    @property
    def memory(self):
        """Shapes of the predicted joint states, the planned inputs, and the commands before."""
        return self.plain.memory | dict(before=(self.n_c, 1))

    @property
    def weights(self):
        """Shapes of the weight matrices."""
        x, y, c = ((n, n) for n in (self.plain.n_x, self.n_y, self.n_c))
        return dict(Q=x, QN=x, R=c, Q_y=y, QN_y=y, R_delta=c)

    @property
    def references(self):
        """Shapes of the estimate s_0 and of the references."""
        plain = self.plain.references
        references = {name: plain[name] for name in ("s_0", "x_ref", "u_ref")}
        return references | dict(y_ref=(self.n_y, self.plain.N + 1))

    @property
    def data(self):
        """Shapes of what may be new in each sample, references and bounds."""
        return self.references | self.bounds

    @property
    def bounds(self):
        """Shapes of the rows' bounds along the horizon and at its end, and of the soft prices."""
        names = ("lower", "upper", "lower_N", "upper_N")
        bounds = dict.fromkeys(names, (len(self.rows), 1))
        return bounds | dict.fromkeys(("linear", "quadratic"), (self.n_soft, 1))

    def first_commands(self, settings):
        """The commands before the first sample: 0, or the nearest number within their bounds."""
        lower, upper = (settings[name][: self.n_c] for name in ("lower", "upper"))
        return dict(before=np.clip(0.0, lower, upper))


class ConstrainedStages:
    """The stages of a ConstrainedHorizon, as `rhec.core.controller.phases` takes them.

    Args:
        horizon: The ConstrainedHorizon.
    """

    tolerance = ("decrease", "complementarity")
    taken = "solved"
    reported = ("iterations", "excess")

    def __init__(self, horizon):
        plain = horizon.plain
        self.loop_symbols = compiled.loop_symbols()
        self.roll_out = build_roll_out(plain)
        unknowns = plain.memory
        cost = _build_cost(horizon)
        data = {name: cost.sparsity_in(name) for name in cost.name_in() if name not in unknowns}
        self.search = relaxation(unknowns, data, cost)
        self._horizon = horizon
        self._outputs = linearised_outputs(horizon)
        self._stages = _build_stages(horizon)
        self._solve = interior_point(_shape_of_qp(horizon, self._stages[0]))
        self._condition = _build_condition(horizon, self._outputs, self.roll_out)

    def prepare(self, inputs):
        """The outputs along the plan, and the stages of the QP."""
        horizon = self._horizon
        plain = horizon.plain
        N = plain.N
        u = inputs["u"]
        # Inputs that are not commanded stay, after the horizon, what they are in its last interval.
        Y, C, E = self._outputs.map(N + 1)(inputs["s"], ca.horzcat(u, u[:, -1]))
        # A map is a loop in C. N inlined calls would take the compiler longer than all the rest.
        before_end = C[:, : N * plain.n_s], E[:, : N * plain.n_u]
        stage, last_stage = self._stages
        weights = (inputs[name] for name in ("Q", "R", "Q_y", "R_delta"))
        qp_D, qp_B, H, G = stage.map(N)(inputs["D"], inputs["B"], *before_end, *weights)
        end = C[:, -plain.n_s :], E[:, -plain.n_u :]
        H_N, G_N = last_stage(*end, inputs["QN"], inputs["QN_y"])
        sides = dict(qp_D=(qp_D, qp_D[:, -horizon.n :]), qp_B=(qp_B, qp_B[:, -horizon.n_c :]))
        sides |= dict(H=(H, H_N), G=(G, _with_sparsity(G_N, stage.sparsity_out("G"))))
        matrices = {name: ca.horzcat(*each) for name, each in sides.items()}
        return dict(Y=Y, C=C, E=E) | matrices

    def solve(self, inputs):
        """The estimate and the references move gradient and rows; the QP gives the change."""
        horizon = self._horizon
        at_plan = self._condition(**select_inputs(self._condition, inputs))
        ends, tops = bounds_of_nodes(horizon, inputs)
        qp = {name: inputs[name] for name in ("H", "G", "linear", "quadratic")}
        qp |= dict(D=inputs["qp_D"], B=inputs["qp_B"], g=at_plan["g"])
        rows = at_plan["rows"]
        solution = self._solve(**qp, lower=ends - rows, upper=tops - rows)
        z = solution["z"]
        results = {name: solution[name] for name in ("complementarity", "iterations", "excess")}
        solved = solution["solved"]
        results |= dict(solved=solved, ok=solved * (ca.sum1(solution["excess"]) == 0))
        results["decrease"] = ca.fabs(ca.dot(at_plan["g"], z))
        return dict(change=z[horizon.n :, : horizon.plain.N]) | results

    def command_bounds(self, inputs):
        """Lowest and highest commands: those of the first rows."""
        n_c = self._horizon.n_c
        return inputs["lower"][:n_c], inputs["upper"][:n_c]

    def remember(self, u):
        """The commands of the last sample."""
        return dict(before=u[list(self._horizon.plain.command), 0])

    def kkt(self, u, u_ref, u_plan, decrease, complementarity):
        """The KKT tolerance of the plan u: |g'z| of the QP's solution z, and Σ λ |b + t|."""
        return decrease + complementarity


def linearised_outputs(horizon):
    """The Function (s, u) -> (y, C = ∂y/∂s, E = ∂y/∂u)."""
    plain = horizon.plain
    s = ca.SX.sym("s", plain.n_s)
    u = ca.SX.sym("u", plain.n_u)
    y = ca.SX(0, 1)
    if horizon.n_y:
        y = horizon.outputs.function(s[: plain.n_x], u, s[plain.n_x :])
    results = [y, ca.jacobian(y, s), ca.jacobian(y, u)]
    return ca.Function("rhc_outputs", [s, u], results, ["s", "u"], ["Y", "C", "E"], {"cse": True})


def feeds_through(horizon):
    """1 for each output that depends on a command, else 0, as a list."""
    E = linearised_outputs(horizon).sparsity_out("E")
    return [
        int(any(E.has_nz(row, place) for place in horizon.plain.command))
        for row in range(horizon.n_y)
    ]


def _rows_of_stage(horizon, C, E):
    """The rows G of a stage, in its states (x and, if changes count, c) and commands."""
    n_c = horizon.n_c
    n = horizon.n
    unit = ca.DM.eye(n + n_c)
    of_output = ca.horzcat(
        C[:, : horizon.plain.n_x],
        ca.SX(horizon.n_y, n - horizon.plain.n_x),
        E[:, list(horizon.plain.command)],
    )
    choices = {
        Kind.COMMAND: lambda place: unit[n + place, :],
        Kind.STATE: lambda place: unit[place, :],
        Kind.OUTPUT: lambda place: of_output[place, :],
        Kind.CHANGE: lambda place: unit[n + place, :] - unit[n - n_c + place, :],
    }
    return ca.vertcat(*(ca.SX(choices[row.kind](row.place)) for row in horizon.rows))


def _hessian(horizon, C, E, Q, R, Q_y, R_delta):
    """The Hessian of a stage's cost in its states and commands."""
    n_x = horizon.plain.n_x
    n_c = horizon.n_c
    H = ca.SX(horizon.n + n_c, horizon.n + n_c)
    x = slice(0, n_x)
    u = slice(horizon.n, horizon.n + n_c)
    C = C[:, :n_x]
    E = E[:, list(horizon.plain.command)]
    H[x, x] = Q + C.T @ Q_y @ C
    H[u, x] = E.T @ Q_y @ C
    H[u, u] = R + E.T @ Q_y @ E
    if horizon.has_changes:
        before = slice(n_x, horizon.n)
        H[u, u] += R_delta
        H[u, before] = -R_delta
        H[before, u] = -R_delta
        H[before, before] = R_delta
    H[x, u] = H[u, x].T
    return ca.densify(H)


def ends_with(horizon):
    """Diagonal matrices: 1 for what counts at node N, of the outputs and of the rows."""
    at_end = [1 - each for each in feeds_through(horizon)]
    rows = [
        at_end[row.place] if row.kind is Kind.OUTPUT else row.kind is Kind.STATE
        for row in horizon.rows
    ]
    return ca.diag(ca.DM(at_end)), ca.diag(ca.DM(rows))


def _build_stages(horizon):
    """Two Functions: a stage of the QP, and that of node N, whose commands change nothing."""
    plain = horizon.plain
    outputs = linearised_outputs(horizon)
    parts = dict(D=plain.interval.sparsities["D"], B=plain.interval.sparsities["B"])
    parts |= {name: outputs.sparsity_out(name) for name in "CE"}
    weights = horizon.weights
    x = list(range(plain.n_x))
    added = ca.SX(horizon.n - plain.n_x, horizon.n - plain.n_x)

    @casadi_function(
        "rhc_stage", **parts, **{name: weights[name] for name in ("Q", "R", "Q_y", "R_delta")}
    )
    def stage(D, B, C, E, Q, R, Q_y, R_delta):
        B = B[x, list(plain.command)]
        if horizon.has_changes:
            B = ca.vertcat(B, ca.SX.eye(horizon.n_c))
        return dict(
            qp_D=ca.diagcat(D[x, x], added),
            qp_B=B,
            H=_hessian(horizon, C, E, Q, R, Q_y, R_delta),
            G=_rows_of_stage(horizon, C, E),
        )

    @casadi_function(
        "rhc_last_stage", C=parts["C"], E=parts["E"], QN=weights["QN"], QN_y=weights["QN_y"]
    )
    def last_stage(C, E, QN, QN_y):
        of_outputs, of_rows = ends_with(horizon)
        counted = of_outputs @ QN_y @ of_outputs
        unit = ca.DM.eye(horizon.n_c)
        nothing = ca.SX(*E.shape)
        H = _hessian(horizon, C, nothing, QN, unit, counted, 0 * unit)
        G = of_rows @ _rows_of_stage(horizon, C, nothing)
        return dict(H=H, G=G)

    return stage, last_stage


def _shape_of_qp(horizon, stage):
    """The Shape of the QP whose stages are those of the Function `stage`."""
    plain = horizon.plain
    x = list(range(plain.n_x))
    A_0 = ca.diagcat(plain.interval.A_0[x, x], ca.DM(horizon.n - plain.n_x, horizon.n - plain.n_x))
    D, B, G = (stage.sparsity_out(name) for name in ("qp_D", "qp_B", "G"))
    return Shape(plain.N, A_0, D, B, G, horizon.n_soft)


def _with_sparsity(matrix, sparsity):
    """The matrix with this sparsity, which contains its own."""
    return ca.project(matrix, sparsity)


def _build_node(horizon):
    """The gradient of a node's cost, and the values of its rows, at the plan rolled out."""
    plain = horizon.plain
    n_x = plain.n_x
    command = list(plain.command)
    outputs = linearised_outputs(horizon)
    C_i, E_i = (outputs.sparsity_out(name) for name in "CE")
    s_i = (plain.n_s, 1)
    u_i = (plain.n_u, 1)
    y_i = (horizon.n_y, 1)
    c_i = (horizon.n_c, 1)
    Q_i, _, R_i, Q_yi, _, R_di = horizon.weights.values()

    @casadi_function("rhc_node")
    def node(
        s_old: s_i, s: s_i, u_old: u_i, u: u_i, before: c_i, Y: y_i, C: C_i, E: E_i,
        x_ref: (n_x, 1), u_ref: u_i, y_ref: y_i,
        Q: Q_i, R: R_i, Q_y: Q_yi, R_delta: R_di,
    ):  # fmt: skip
        y = Y + C @ (s - s_old) + E @ (u - u_old)
        of_y = Q_y @ (y - y_ref)
        change = u[command] - before
        g_x = Q @ (s[:n_x] - x_ref) + C[:, :n_x].T @ of_y
        g_u = R @ (u - u_ref)[command] + E[:, command].T @ of_y + R_delta @ change
        g = [g_x, -R_delta @ change, g_u] if horizon.has_changes else [g_x, g_u]
        values = {Kind.COMMAND: u[command], Kind.STATE: s, Kind.OUTPUT: y, Kind.CHANGE: change}
        rows = ca.vertcat(*(values[row.kind][row.place] for row in horizon.rows))
        return dict(g=ca.densify(ca.vertcat(*g)), rows=ca.densify(rows))

    return node


def _build_condition(horizon, outputs, roll_out):
    """The gradient g and the values of the rows, at the previous plan from the new estimate."""
    plain = horizon.plain
    N = plain.N
    command = list(plain.command)
    node = _build_node(horizon)
    shapes = dict(plain.dynamics)
    shapes |= {name: ca.repmat(outputs.sparsity_out(name), 1, N + 1) for name in ("Y", "C", "E")}
    shapes |= horizon.memory | horizon.weights | horizon.references

    @casadi_function("rhc_condition", compiled.loop_symbols(), **shapes)
    def condition(F, D, B, Y, C, E, s, u, before, Q, QN, R, Q_y, QN_y, R_delta, **references):
        s_0, x_ref, u_ref, y_ref = (references[name] for name in horizon.references)
        plan = planned(plain, [u[place, :] for place in command], u_ref)
        nodes = ca.horzcat(*roll_out(s, u, F, D, B, s_0, plan))
        last = ca.horzcat(before, plan[command, : N - 1])
        outputs = Y[:, :N], C[:, : N * plain.n_s], E[:, : N * plain.n_u]
        columns = (s[:, :N], nodes[:, :N], u, plan, last, *outputs, x_ref[:, :N], u_ref)
        g, rows = node.map(N)(*columns, y_ref[:, :N], Q, R, Q_y, R_delta)
        of_outputs, _ = ends_with(horizon)
        nothing = ca.DM.zeros(horizon.n_c, horizon.n_c)
        outputs = Y[:, N], C[:, -plain.n_s :], E[:, -plain.n_u :]
        end = (s[:, N], nodes[:, N], u[:, -1], plan[:, -1], plan[command, -1], *outputs)
        weights = (QN, nothing, of_outputs @ QN_y @ of_outputs, nothing)
        g_N, rows_N = node(*end, x_ref[:, N], u_ref[:, -1], y_ref[:, N], *weights)
        return dict(g=ca.horzcat(g, g_N), rows=ca.horzcat(rows, rows_N))

    return condition


def bounds_of_nodes(horizon, bounds):
    """The bounds (n_rows, N+1) of all nodes, lower and upper: none where a row does not count."""
    N = horizon.plain.N
    _, at_end = ends_with(horizon)
    at_end = ca.diag(at_end)
    # What counts at the end does not depend on a command, and so does not count at the beginning.
    at_begin = 1 - at_end

    def of_nodes(path, end, none):
        first = ca.if_else(at_begin, path, none)
        last = ca.if_else(at_end, end, none)
        return ca.horzcat(first, ca.repmat(path, 1, N - 1), last)

    lower = of_nodes(bounds["lower"], bounds["lower_N"], -MAX_QP_ENTRY)
    return lower, of_nodes(bounds["upper"], bounds["upper_N"], MAX_QP_ENTRY)


def _build_cost(horizon):
    """The cost of nodes s and inputs u, and the price of what soft rows exceed."""
    N = horizon.plain.N
    command = list(horizon.plain.command)
    node = _build_cost_of_node(horizon)
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
        t = ca.fmax(ca.fmax(rows - upper, lower - rows), 0)[horizon.n_c :, :]
        linear = ca.if_else(bounds["linear"] < NO_PRICE, bounds["linear"], 0)
        price = ca.dot(linear, ca.sum2(t)) + ca.dot(bounds["quadratic"], ca.sum2(t**2)) / 2
        return dict(cost=ca.sum2(costs) + cost_N + price)

    return cost


def _build_cost_of_node(horizon):
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
