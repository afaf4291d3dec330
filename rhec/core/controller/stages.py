"""The stages of an RHC: what eq. (12) weighs and bounds, in one list of quantities.

    w_i = (x_i, u_i, y_i, u_i - u_{i-1}),  y_i = h(x_i, u_i, p̂)

    min  ½ Σ_{i=0..N} ‖w_i - w_r,i‖²_{W_i} + Σ price(t),   W_i = diag(Q, R, Q_y, R_Δ)
    s.t. x_0 = x̂, x_{i+1} = F(x_i, u_i, p̂), lower - t ≤ some entries of w_i ≤ upper + t

Of u, w has the commands alone. The weights of node N are (Q_N, 0, Q_N,y, 0). The paper weighs x and
u, and bounds u. u_{-1} is the command of the sample before.

Commands are kept within their bounds exactly. Hard bounds of all else are soft ones whose price the
QP chooses, so high that they are exceeded where they cannot be kept, and nowhere else. Then `ok` is
0, and the commands lead back as fast as their own bounds allow.

No command moves the state of node 0: it has neither weight nor bound. An output that depends on a
command counts at the nodes 0 … N-1, any other one at the nodes 1 … N.
"""

import functools
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core.model.limits import MAX_QP_ENTRY
from rhec.core.model.robot_model import Model, interval
from rhec.core.solver.interior_point import NO_PRICE


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


class Stages(NamedTuple):
    """The structure of an RHC, which decides the shapes of its Functions."""

    model: Model
    command: tuple[int, ...]  # places of the commanded inputs in `model.inputs`
    dt_s: float  # length of an interval [s]
    N: int  # intervals of the prediction
    outputs: Outputs | None = None
    has_changes: bool = False  # whether changes of commands have weights or bounds
    # Whether more than the commands is bounded, or more than x and u weighed, or by full matrices.
    # Then all weights are matrices, and the QP is solved by an interior point; else weights are
    # diagonals, and it is solved by an active set.
    is_general: bool = False
    bounded: tuple[int, ...] = ()  # places in w of what is bounded besides the commands
    # None, or an object whose `build(stages)` returns what solves the QP instead, with the methods
    # of `rhec.core.controller.qp.ActiveSet`.
    qp: Any = None
    damped: bool = False  # whether `improve` is built, too, an iteration that takes part of a step

    @property
    def n_x(self):
        """Length of the state x."""
        return len(self.model.states)

    @property
    def n_u(self):
        """Length of the input u, whether commanded or not; it ends with what is known."""
        return len(self.model.acting)

    @property
    def n_s(self):
        """Length of the joint state s = (x, p)."""
        return self.n_x + len(self.model.parameters)

    @property
    def n_c(self):
        """Number of commands."""
        return len(self.command)

    @property
    def n_y(self):
        """Number of outputs."""
        return len(self.outputs.names) if self.outputs else 0

    @property
    def n_z(self):
        """Number of the QP's states: x and, if changes count, the commands before."""
        return self.n_x + self.has_changes * self.n_c

    @property
    def interval(self):
        """The model's shooting interval."""
        return interval(self.model, measured=False)

    @property
    def quantities(self):
        """Names of the entries of w; that of a change is the command's in a tuple."""
        commands = tuple(self.model.inputs[place] for place in self.command)
        outputs = self.outputs.names if self.outputs else ()
        changes = tuple((name,) for name in commands) if self.has_changes else ()
        return (*self.model.states, *commands, *outputs, *changes)

    @property
    def rows(self):
        """Places in w of what is bounded, the commands first."""
        return [*range(self.n_x, self.n_x + self.n_c), *self.bounded]

    @property
    def soft_names(self):
        """How a message names the rows that a plan may exceed."""
        names = (self.quantities[place] for place in self.bounded)
        return tuple(
            f"the change of {name[0]!r}" if isinstance(name, tuple) else repr(name)
            for name in names
        )

    @property
    def memory(self):
        """Shapes of the predicted joint states s, the planned inputs u, and the commands before."""
        before = dict(before=(self.n_c, 1)) if self.has_changes else {}
        return dict(s=(self.n_s, self.N + 1), u=(self.n_u, self.N)) | before

    @property
    def unknowns(self):
        """What of the memory an iteration improves."""
        return {name: self.memory[name] for name in ("s", "u")}

    @property
    def weights(self):
        """Shapes of the weights, matrices or their diagonals."""
        sizes = dict(Q=self.n_x, QN=self.n_x, R=self.n_c)
        if self.n_y:
            sizes |= dict(Q_y=self.n_y, QN_y=self.n_y)
        if self.has_changes:
            sizes |= dict(R_delta=self.n_c)
        return {name: (n, n if self.is_general else 1) for name, n in sizes.items()}

    @property
    def references(self):
        """Shapes of the estimate s_0 and of the references."""
        y_ref = dict(y_ref=(self.n_y, self.N + 1)) if self.n_y else {}
        return (
            dict(s_0=(self.n_s, 1), x_ref=(self.n_x, self.N + 1), u_ref=(self.n_u, self.N)) | y_ref
        )

    @property
    def bounds(self):
        """Shapes of the rows' bounds along the horizon and at its end, and of soft prices."""
        rows = (len(self.rows), 1)
        bounds = dict(lower=rows, upper=rows)
        if self.is_general:
            prices = (len(self.bounded), 1)
            bounds |= dict(lower_N=rows, upper_N=rows, linear=prices, quadratic=prices)
        return bounds

    @property
    def data(self):
        """Shapes of what may be new in each sample: references and bounds."""
        return self.references | self.bounds

    @property
    def dynamics(self):
        """Sparsities of F, D and B of all intervals, side by side."""
        return {name: ca.repmat(part, 1, self.N) for name, part in self.interval.sparsities.items()}

    @property
    def slopes(self):
        """Sparsities at a node of y and its slopes C by s and E by u; none without outputs."""
        if not self.n_y:
            return {}
        outputs = linearised_outputs(self)
        return {name: outputs.sparsity_out(name) for name in outputs.name_out()}

    @property
    def loop_symbols(self):
        """SX or MX, for Functions that repeat an interval."""
        # In one piece, a step takes two thirds of the time, and a long horizon 7 s to compile. The
        # paper's horizon has 15 intervals, one command and six joint states.
        is_long = self.N > 15 or self.N * self.n_c * self.n_s > 100
        in_one_piece = not self.is_general and (self.qp or not is_long)
        return ca.SX if in_one_piece else compiled.loop_symbols()


# The quantities of a node, and their slopes


def quantities(stages, s, u, u_before, y):
    """w of a node, or of several side by side: states, commands, outputs, changes of commands.

    Args:
        stages: The Stages.
        s: (n_s, n) joint states at n nodes.
        u: (n_u, n) inputs after each.
        u_before: (n_c, n) commands before each.
        y: (n_y, n) outputs.
    """
    command = list(stages.command)
    changes = [u[command, :] - u_before] if stages.has_changes else []
    return ca.vertcat(s[: stages.n_x, :], u[command, :], y, *changes)


def jacobian(stages, C, E):
    """J = ∂w/∂z of a node, z = (x, the commands before, the commands)."""
    n_z = stages.n_z
    unit = ca.DM.eye(n_z + stages.n_c)
    x, before, u = ca.vertsplit(unit, [0, stages.n_x, n_z, n_z + stages.n_c])
    by_before = ca.SX(stages.n_y, before.size1())
    y = ca.horzcat(C[:, : stages.n_x], by_before, E[:, list(stages.command)])
    return ca.vertcat(x, u, y, *([u - before] if stages.has_changes else []))


def linearised_outputs(stages):
    """The Function (s, u) -> (Y, C, E): the outputs, ∂y/∂s and ∂y/∂u."""
    s = ca.SX.sym("s", stages.n_s)
    u = ca.SX.sym("u", stages.n_u)
    y = ca.SX(0, 1)
    if stages.n_y:
        y = stages.outputs.function(s[: stages.n_x], u, s[stages.n_x :])
    results = [y, ca.jacobian(y, s), ca.jacobian(y, u)]
    return ca.Function("rhc_outputs", [s, u], results, ["s", "u"], ["Y", "C", "E"], {"cse": True})


def counts_at_end(stages):
    """1 for each entry of w that counts at node N: states, and outputs that no command moves."""
    E = ca.DM(linearised_outputs(stages).sparsity_out("E"), 1)
    is_moved = ca.sum2(E[:, list(stages.command)]) > 0
    of_changes = ca.DM.zeros(stages.n_c * stages.has_changes)
    commands = ca.DM.zeros(stages.n_c)
    return ca.vertcat(ca.DM.ones(stages.n_x), commands, ca.densify(1 - is_moved), of_changes)


def weight(stages, Q, R, Q_y=None, R_delta=None):
    """W of a node; each part is a matrix or its diagonal."""
    parts = [part for part in (Q, R, Q_y, R_delta) if part is not None]
    return ca.diagcat(*(part if stages.is_general else ca.diag(part) for part in parts))


def weights_before_end(stages, given):
    """The arguments of `weight` at the nodes 0 … N-1."""
    return {name: given[name] for name in ("Q", "R", "Q_y", "R_delta") if name in stages.weights}


def weights_at_end(stages, given, of_commands=0):
    """The arguments of `weight` at node N, whose commands change nothing."""
    n_c = stages.n_c
    R = ca.DM.eye(n_c) if stages.is_general else ca.DM.ones(n_c)
    weights = dict(Q=given["QN"], R=of_commands * R)
    if stages.n_y:
        first = stages.n_x + n_c
        counts = ca.diag(counts_at_end(stages)[first : first + stages.n_y])
        weights["Q_y"] = counts @ given["QN_y"] @ counts
    if stages.has_changes:
        weights["R_delta"] = ca.DM.zeros(n_c, n_c)
    return weights


# The QP's gradient and rows


def build_node(stages):
    """The Function of a node at the plan rolled out: the gradient J'W (w - w_r), and the rows."""
    s_i = (stages.n_s, 1)
    u_i = (stages.n_u, 1)
    shapes = dict(s=s_i, u=u_i, u_before=(stages.n_c, 1), x_ref=(stages.n_x, 1), u_ref=u_i)
    if stages.n_y:
        shapes |= dict(s_old=s_i, u_old=u_i, y_ref=(stages.n_y, 1)) | stages.slopes
    shapes |= weights_before_end(stages, stages.weights)
    none = dict(C=ca.SX(0, stages.n_s), E=ca.SX(0, stages.n_u), y_ref=ca.SX(0, 1))

    @casadi_function("rhc_node", **shapes)
    def node(s, u, u_before, x_ref, u_ref, **given):
        weights = weights_before_end(stages, given)
        C, E, y_ref = (given.get(name, none[name]) for name in none)
        y = ca.SX(0, 1)
        if stages.n_y:
            y = given["Y"] + C @ (s - given["s_old"]) + E @ (u - given["u_old"])
        w = quantities(stages, s, u, u_before, y)
        # The reference of a change is none.
        w_ref = quantities(stages, x_ref, u_ref, u_ref[list(stages.command)], y_ref)
        g = jacobian(stages, C, E).T @ (weight(stages, **weights) @ (w - w_ref))
        return dict(g=ca.densify(g), rows=ca.densify(w[stages.rows]))

    return node


def bounds_of_nodes(stages, bounds):
    """The bounds (n_rows, N+1) of all nodes, lower and upper: none where a row does not count."""
    at_end = counts_at_end(stages)[stages.rows]
    # A row depends on a command and counts at the nodes 0 … N-1, or on none and at 1 … N.
    at_begin = 1 - at_end

    def of_nodes(along, end, none):
        first = ca.if_else(at_begin, along, none)
        last = ca.if_else(at_end, end, none)
        return ca.horzcat(first, ca.repmat(along, 1, stages.N - 1), last)

    lower = of_nodes(bounds["lower"], bounds["lower_N"], -MAX_QP_ENTRY)
    return lower, of_nodes(bounds["upper"], bounds["upper_N"], MAX_QP_ENTRY)


def repeated(u):
    """Inputs (n, N) at the nodes 0 … N: after the horizon they stay what they are in its last."""
    return ca.horzcat(u, u[:, -1])


# The cost, which a search along a step compares


def build_cost(stages):
    """The Function of the cost of nodes s and inputs u, and of their gaps.

    The cost has the price of what soft rows exceed. The gaps are Σ |F(s_i, u_i) - s_{i+1}| and
    |x̂ - s_0| of each state. Its other results are those that `relaxation` names.
    """
    N = stages.N
    references = stages.references
    bounds = stages.bounds if stages.is_general else {}
    no_y = ca.MX(0, N + 1)

    @casadi_function("rhc_cost", ca.MX, **stages.memory, **stages.weights, **references, **bounds)
    def cost(s, u, s_0, x_ref, u_ref, before=None, y_ref=no_y, **given):
        command = list(stages.command)
        along = repeated(u)
        u_before = None if before is None else ca.horzcat(before, u[command, :])
        y = no_y
        if stages.n_y:
            y = stages.outputs.function.map(N + 1)(s[: stages.n_x, :], along, s[stages.n_x :, :])
        w = quantities(stages, s, along, u_before, y)
        wanted = repeated(u_ref)
        off = w - quantities(stages, x_ref, wanted, wanted[command, :], y_ref)
        # The state of node 0 is given.
        off[: stages.n_x, 0] = 0
        W = weight(stages, **weights_before_end(stages, given))
        W_N = weight(stages, **weights_at_end(stages, given))
        total = (ca.dot(off[:, :N], W @ off[:, :N]) + ca.bilin(W_N, off[:, N], off[:, N])) / 2
        dt_s = ca.repmat(ca.DM(stages.dt_s), 1, N)
        ends = stages.interval.step.map(N)(s[:, :N], u, dt_s)
        gaps = ca.fabs(ca.horzcat(s[:, 0] - s_0, ends - s[:, 1:]))
        found = dict(gaps=ca.sum2(gaps)) | _roots_of_weights(stages, W, W_N)
        if not stages.is_general:
            return dict(cost=total) | found
        t = _beyond_bounds(stages, w, given)
        is_soft = given["linear"] < NO_PRICE
        linear = ca.if_else(is_soft, given["linear"], 0)
        price = ca.dot(linear, ca.sum2(t)) + ca.dot(given["quadratic"], ca.sum2(t**2)) / 2
        beyond = ca.if_else(is_soft, 0, ca.sum2(t))
        rows = w[stages.bounded, :]
        way = ca.sum2(ca.fabs(rows - ca.repmat(rows[:, 0], 1, N + 1)))
        return dict(cost=total + price, beyond=beyond, way=way) | found

    return cost


def _roots_of_weights(stages, W, W_N):
    """The roots of what a unit of each joint state and input costs; 0 without a weight."""
    of_w = ca.diag(W)
    of_x = ca.sqrt(ca.fmax(of_w, ca.diag(W_N)))[: stages.n_x]
    of_u = ca.MX(stages.n_u, 1)
    of_u[list(stages.command)] = ca.sqrt(of_w[stages.n_x : stages.n_x + stages.n_c])
    return dict(root_s=ca.vertcat(of_x, ca.MX(stages.n_s - stages.n_x, 1)), root_u=of_u)


def _beyond_bounds(stages, w, bounds):
    """How far the rows besides the commands are beyond their bounds, at all nodes."""
    lower, upper = bounds_of_nodes(stages, bounds)
    rows = w[stages.rows, :]
    return ca.fmax(ca.fmax(rows - upper, lower - rows), 0)[stages.n_c :, :]
