"""The window of a `rhec.RHE` and the plan of a `rhec.RHC`, written down for other solvers.

Each is written once, by multiple shooting with `casadi.Opti`. Only the `rhec.Model` and the options
are rhec's, so that these problems can tell whether rhec solves its own. States and inputs stand in
the order of the stages, as FATROP needs them; IPOPT takes any order.
"""

import contextlib
import itertools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from rhec import Bound


class Solver(NamedTuple):
    """A solver that CasADi has an interface to."""

    name: str
    options: dict
    by_stages: bool = False  # whether it knows no unknown that many stages share


EXACT = Solver(
    "ipopt",
    {
        "print_level": 0,
        "sb": "yes",
        "tol": 1e-11,
        "bound_relax_factor": 0.0,  # otherwise IPOPT may exceed each bound by 1e-8
    },
)
# What IPOPT says of a solution to which double precision allows no better one.
_SOLVED = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Search_Direction_Becomes_Too_Small")
_ACTIVE = 1e-6  # distance from a bound that counts as being at it


class Window(NamedTuple):
    """The solution of a window, and whether IPOPT says that it is one."""

    x: np.ndarray  # (n_x, N+1)
    u: np.ndarray  # (n_u, N)
    p: np.ndarray  # (n_p,) at the newest node
    solved: bool

    @property
    def newest(self):
        """(n_x + n_p,) state and parameters at the newest node."""
        return np.append(self.x[:, -1], self.p)


class Plan(NamedTuple):
    """The solution of a plan, and whether IPOPT says that it is one."""

    u: np.ndarray  # (n_u, N)
    cost: float
    solved: bool
    active: bool  # whether a state or an output is at a bound


class WindowProblem:
    """The estimation problem over N intervals, eq. (10), for any measurements.

    With the joint state s = (x, p) and the rows z of the measurements

        min  ½ ‖s_0 - m‖²_H + ½ Σ_{i=0..N} ‖(z_i - h(x_i, u_{i-1}, p_i)) / σ_v‖²
                            + ½ Σ_{i=1..N} ‖w_i / σ_w,i‖²
        s.t. x_i = F(x_{i-1}, u_{i-1}, p_{i-1}) + w_x,i,  p_i = p_{i-1} + w_p,i,  bounds,

    without w where there is no noise within the window. An output that depends on inputs belongs to
    the interval that ends at its node, so the oldest node has none.

    Args:
        model: A rhec.Model, discrete or with the rule "rk4".
        intervals: N.
        dt: Length of an interval [s].
        noisy: Whether all of s has process noise within the window. Otherwise p is one unknown.
        solver: Solver.

    Attributes:
        given: The opti's parameters m, H, z (n_z, N+1) and their weights 1 / σ_v, and σ_w
            (n_x + n_p, N) if noisy.
        s: (n_x + n_p, N+1) expression of the joint states.
    """

    def __init__(self, model, intervals, dt, noisy=False, solver=EXACT):
        self._model = model
        self._limits = _bounds_of_joint_state(model)
        self._step = _joint_step(model, dt)
        n_x = len(model.states)
        n_s = n_x + len(model.parameters)
        opti = self.opti = ca.Opti()
        nodes, inputs = self._make_unknowns(intervals, each_its_own_p=noisy or solver.by_stages)
        self.s = ca.horzcat(*nodes)
        self._u = ca.horzcat(*inputs)
        m = opti.parameter(n_s)
        H = opti.parameter(n_s, n_s)
        z = opti.parameter(len(model.outputs), intervals + 1)
        weight = opti.parameter(*z.shape)
        sigma_w = opti.parameter(n_s, intervals) if noisy else None
        self.given = [m, H, z, weight, *([sigma_w] if noisy else [])]

        residuals = []
        gaps = []
        for i, s in enumerate(nodes):
            # The oldest node's outputs of inputs have no weight, whatever the input.
            measured = model.measurement(s[:n_x], inputs[max(i - 1, 0)], s[n_x:])
            residuals.append(weight[:, i] * _difference(model, z[:, i], measured))
            if i < intervals:
                gap = (nodes[i + 1] - self._step(s, inputs[i]))[: self._unknowns[0].numel()]
                if noisy:
                    residuals.append(gap / sigma_w[:, i])
                else:
                    gaps.append(gap)
                    opti.subject_to(gap == 0)
            for place, (low, high) in self._limits.items():
                # As rhec.RHE says: without bounds of states, p is bounded at the newest node alone.
                everywhere = place < n_x or noisy and model.state_bounds
                if everywhere or i == intervals:
                    opti.subject_to(opti.bounded(low, s[place], high))
        residuals = ca.vertcat(*residuals)
        arrival = ca.bilin(H, nodes[0] - m, nodes[0] - m)
        opti.minimize((arrival + ca.sumsqr(residuals)) / 2)
        self._trajectory = ca.Function("trajectory", [opti.x], [self.s, self._u])
        _set_solver(opti, solver)
        slopes = [ca.jacobian(each, opti.x) for each in (nodes[0], residuals, ca.vertcat(*gaps))]
        newest = ca.jacobian(nodes[-1], opti.x)
        self._slopes = ca.Function("slopes", [opti.x, *self.given], [*slopes, newest]).expand()

    def solve(self, z, m, H, sigma_v, sigma_w=None):
        """Solve the problem by IPOPT, from m and the measured inputs on.

        Args:
            z: (N+1, n_z) measurements, the newest last, NaN where there is none.
            m: (n_x + n_p,) mean of the arrival cost.
            H: (n_x + n_p, n_x + n_p) its weight.
            sigma_v: (n_z,) standard deviations of the measurements.
            sigma_w: (N, n_x + n_p) those of the process noise of each interval.

        Returns:
            Window.
        """
        self._values = [m, H, np.nan_to_num(z).T, self.weights(z, sigma_v).T]
        self._values += [] if sigma_w is None else [np.transpose(sigma_w)]
        for parameter, value in zip(self.given, self._values, strict=True):
            self.opti.set_value(parameter, value)
        self.begin(m, z)
        self._found, solved = _solve(self.opti)
        s, u = (each.full() for each in self._trajectory(self._found))
        n_x = len(self._model.states)
        return Window(s[:n_x], u, s[n_x:, -1], solved)

    def begin(self, s, z):
        """Set the first point: s (n_x + n_p,) at the oldest node, rolled out by the inputs of z."""
        s = np.array(s, dtype=float)
        for place, pair in self._limits.items():
            s[place] = np.clip(s[place], *pair)
        inputs = self._measured_inputs(z)
        self.opti.set_initial(self._u, inputs)
        for unknown, u in itertools.zip_longest(self._unknowns, inputs.T):
            self.opti.set_initial(unknown, s[: unknown.numel()])
            s = s if u is None else self._step(s, u).full().ravel()

    def weights(self, z, sigma_v):
        """1 / σ_v (N+1, n_z), and 0 where a measurement is missing or does not count."""
        weights = np.where(np.isnan(z), 0.0, 1 / np.array(sigma_v))
        weights[0, reads_inputs(self._model)] = 0.0
        return weights

    def covariance(self):
        """That of the newest (x, p) at the last solution, bounds aside: (n_x + n_p, n_x + n_p).

        It is that of the inverse of the KKT matrix, with the Gauss-Newton Hessian.
        """
        slopes = self._slopes(self._found, *self._values)
        arrival, residuals, gaps, newest = (each.sparse() for each in slopes)
        H = np.array(self._values[1])
        hessian = residuals.T @ residuals + arrival.T @ H @ arrival
        kkt = scipy.sparse.bmat([[hessian, gaps.T], [gaps, None]], format="csc")
        newest = np.pad(newest.toarray(), ((0, 0), (0, gaps.shape[0])))  # of multipliers: nothing
        return newest @ scipy.sparse.linalg.splu(kkt).solve(newest.T)

    def _make_unknowns(self, intervals, each_its_own_p):
        """The joint states of all nodes and the inputs of all intervals."""
        model = self._model
        n_p = len(model.parameters)
        if each_its_own_p:
            nodes, inputs = _stages(
                self.opti, intervals, len(model.states) + n_p, len(model.inputs)
            )
            self._unknowns = nodes
        else:
            states, inputs = _stages(self.opti, intervals, len(model.states), len(model.inputs))
            p = self.opti.variable(n_p)
            nodes = [ca.vertcat(x, p) for x in states]
            self._unknowns = [*states[:-1], nodes[-1]]
        return nodes, inputs

    def _measured_inputs(self, z):
        """The inputs (n_u, N) as they are measured; 0 for those that are not."""
        model = self._model
        u = np.zeros(self._u.shape)
        for row, name in enumerate(model.inputs):
            if name in model.outputs:
                u[row] = np.nan_to_num(z[1:, model.outputs.index(name)])
        return u


class PlanProblem:
    """The control problem over N intervals, eq. (12), for any start and reference.

        min  ½ Σ_{i=1..N} ‖x_i - x_r,i‖²_{Q_i}
             + ½ Σ_{i=0..N-1} (‖u_i - u_r,i‖²_R + ‖u_i - u_{i-1}‖²_{R_Δ})
             + Σ linear·t + ½ quadratic·t²
        s.t. x_{i+1} = F(x_i, u_i, p), lower - t ≤ row ≤ upper + t

    Before the horizon the commands were as near to 0 as allowed. An input that is not commanded is
    that of the reference.

    Args:
        options: Options of a rhec.RHC with diagonal weights, without bounds that hold at the end
            alone.
        solver: Solver. One by stages takes neither soft bounds nor weights or bounds of changes.

    Attributes:
        given: The opti's parameters: the start, p, x_ref (n_x, N+1), u_ref (n_u, N).
        u: (n_u, N) expression of the inputs.
    """

    def __init__(self, options, solver=EXACT):
        self._options = options
        model = options["model"]
        N = self._N = options["horizon"]
        n_x = len(model.states)
        F = next_state(model, options["dt"])
        opti = self.opti = ca.Opti()
        nodes, inputs = _stages(opti, N, n_x, len(model.inputs))
        self._x = ca.horzcat(*nodes)
        self.u = ca.horzcat(*inputs)
        start = opti.parameter(n_x)
        p = opti.parameter(len(model.parameters))
        x_ref = opti.parameter(n_x, N + 1)
        u_ref = opti.parameter(len(model.inputs), N)
        self.given = [start, p, x_ref, u_ref]
        self._commands = options.get("command", model.inputs)

        held = [i for i, name in enumerate(model.inputs) if name not in self._commands]
        rows = self._rows(self._x, self.u, p)
        excess = [opti.variable() if row.bound.is_soft else None for row in rows]
        for i in range(N + 1):
            if i < N:
                opti.subject_to(nodes[i + 1] == F(nodes[i], inputs[i], p))
                for place in held:
                    opti.subject_to(inputs[i][place] == u_ref[place, i])
            if i == 0:
                opti.subject_to(nodes[0] == start)
            for row, t in zip(rows, excess):
                if row.stage == i:
                    _bound(opti, row, t)
        soft = [(row, t) for row, t in zip(rows, excess) if t is not None]
        opti.minimize(self._cost(self._x, self.u, x_ref, u_ref) + _price(soft))
        for _, t in soft:
            opti.subject_to(t >= 0)
        room = ca.vertcat(*(_room(row, t) for row, t in zip(rows, excess) if row.counts))
        self._answer = ca.Function("answer", [opti.x, *self.given], [self.u, opti.f, room])
        _set_solver(opti, solver)
        self._value = self._rolled_out(F)

    def cost(self, x, x_ref, u, p=(), u_ref=0.0):
        """Roll the inputs out.

        Args:
            x: (n_x,) state.
            x_ref: (n_x,) or (n_x, N+1) desired states.
            u: (n_u, N) inputs.
            p: (n_p,) parameters.
            u_ref: (n_u,) or (n_u, N) desired inputs.

        Returns:
            Their cost, with the price of soft bounds.
        """
        return float(self._value(*self._values(x, p, x_ref, u_ref), u)[1])

    def solve(self, x, x_ref, p=(), u_ref=0.0, u=None):
        """Solve the problem by IPOPT.

        Args:
            x: (n_x,) state.
            x_ref: (n_x,) or (n_x, N+1) desired states.
            p: (n_p,) parameters.
            u_ref: (n_u,) or (n_u, N) desired inputs.
            u: (n_u, N) inputs to begin from, rolled out; None: those desired, and a state that
                stays.

        Returns:
            Plan.
        """
        values = self._values(x, p, x_ref, u_ref)
        for parameter, value in zip(self.given, values):
            self.opti.set_value(parameter, value)
        states = np.tile(np.reshape(x, (-1, 1)), (1, self._N + 1))
        if u is not None:
            states = self._value(*values, u)[0]
        self.opti.set_initial(self._x, states)
        self.opti.set_initial(self.u, values[-1] if u is None else u)
        found, solved = _solve(self.opti)
        u, cost, room = self._answer(found, *values)
        active = np.any(room.full() < _ACTIVE)
        return Plan(u=u.full(), cost=float(cost), solved=solved, active=bool(active))

    def _values(self, x, p, x_ref, u_ref):
        """What is given, at all nodes and in all intervals."""
        values = [np.reshape(np.array(each, dtype=float), (-1, 1)) for each in (x, p)]
        for each, parameter in zip((x_ref, u_ref), self.given[2:]):
            each = np.array(each, dtype=float)
            each = each if each.ndim == 2 else each.reshape(-1, 1)
            values.append(np.broadcast_to(each, parameter.shape))
        return values

    def _rolled_out(self, F):
        """The Function (start, p, x_ref, u_ref, u) -> (states, cost with the price)."""
        given = [ca.SX.sym("given", *each.shape) for each in self.given]
        u = ca.SX.sym("u", *self.u.shape)
        start, p, x_ref, u_ref = given
        states = [start]
        for each in ca.horzsplit(u):
            states.append(F(states[-1], each, p))
        states = ca.horzcat(*states)
        soft = [row for row in self._rows(states, u, p) if row.bound.is_soft]
        beyond = [
            ca.fmax(ca.fmax(row.value - row.bound.highest, row.bound.lowest - row.value), 0)
            for row in soft
        ]
        cost = self._cost(states, u, x_ref, u_ref) + _price(zip(soft, beyond))
        return ca.Function("value", [*given, u], [states, cost])

    def _cost(self, nodes, u, x_ref, u_ref):
        """The quadratic cost."""
        options = self._options
        N = self._N
        Q = np.array(options["q"])
        QN = np.array(options.get("qn", options.get("qn_factor", 1.0) * Q))
        off = (nodes - x_ref)[:, 1:] ** 2
        cost = ca.dot(ca.repmat(Q, 1, N), off) + ca.dot(QN - Q, off[:, -1])
        cost += ca.dot(ca.repmat(self._of_commands("r"), 1, N), (u - u_ref) ** 2)
        if "r_delta" in options:
            cost += ca.dot(ca.repmat(self._of_commands("r_delta"), 1, N), self._changes(u) ** 2)
        return cost / 2

    def _of_commands(self, name):
        """The option's weights of all inputs (n_u,), 0 of those that are not commanded."""
        weights = dict(zip(self._commands, self._options[name], strict=True))
        return np.array([weights.get(each, 0.0) for each in self._options["model"].inputs])

    def _changes(self, u):
        """The changes (n_u, N) of the inputs, from those before the horizon on."""
        bounds = self._options["bounds"] or {}
        before = []
        for name in self._options["model"].inputs:
            bound = _as_bound(bounds.get(name, (-np.inf, np.inf)))
            before.append(np.clip(0.0, bound.lowest, bound.highest))
        return ca.diff(ca.horzcat(ca.DM(before), u), 1, 1)

    def _rows(self, nodes, u, p):
        """The bounded expressions of all nodes where they count."""
        model = self._options["model"]
        rows = []
        for name, given in (self._options["bounds"] or {}).items():
            if name in model.inputs:
                values, first = u[model.inputs.index(name), :], 0
            elif name in model.states:
                values, first = nodes[model.states.index(name), 1:], 1
            else:
                values, first = self._output(name, nodes, u, p)
            counts = name not in model.inputs
            rows += _rows_of(values, given, first, counts)
        for name, given in self._options.get("delta_bounds", {}).items():
            rows += _rows_of(self._changes(u)[model.inputs.index(name), :], given, 0, False)
        return rows

    def _output(self, name, nodes, u, p):
        """An output at the nodes 1 … N, or 0 … N-1 if it depends on a command; and which node."""
        model = self._options["model"]
        outputs = self._options.get("outputs") or {}
        symbols = _symbols(model)
        if isinstance(outputs, dict):
            value = ca.SX(outputs[name](*symbols))
        else:
            value = model.measurement(*symbols)[model.outputs.index(name)]
        h = ca.Function("h", symbols, [value])
        first = 0 if ca.depends_on(value, symbols[1]) else 1
        values = [h(nodes[:, i + first], u[:, i], p) for i in range(self._N)]
        return ca.horzcat(*values), first


def next_state(model, dt):
    """Build the Function (x, u, p) -> x one sample later.

    Args:
        model: A rhec.Model, discrete or with the rule "rk4".
        dt: Length of a sample [s].

    Returns:
        The Function, by steps of Runge and Kutta, or the model's own if it is discrete.
    """
    x, u, p = _symbols(model)
    if model.discrete:
        return ca.Function("next", [x, u, p], [model.dynamics(x, u, p)])
    step = dt / model.steps
    after = x
    for _ in range(model.steps):
        k = [model.dynamics(after, u, p)]
        for share in (step / 2, step / 2, step):
            k.append(model.dynamics(after + share * k[-1], u, p))
        after = after + step / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
    return ca.Function("next", [x, u, p], [after])


def reads_inputs(model):
    """Which outputs (n_z,) of a rhec.Model depend on inputs."""
    symbols = _symbols(model)
    outputs = ca.vertsplit(model.measurement(*symbols))
    return np.array([ca.depends_on(each, symbols[1]) for each in outputs])


class _Row(NamedTuple):
    """One bounded expression."""

    value: Any
    bound: Bound
    stage: int
    counts: bool  # whether it is of a state or an output


def _rows_of(values, given, first, counts):
    """The rows of a quantity from its first stage on."""
    bound = _as_bound(given)
    stages = itertools.count(first)
    return [_Row(value, bound, i, counts) for value, i in zip(ca.horzsplit(values), stages)]


def _as_bound(given):
    return given if isinstance(given, Bound) else Bound(*given)


def _bound(opti, row, t):
    """Bound a row; a soft one may exceed by t, and has a side for each bound."""
    if t is None:
        opti.subject_to(opti.bounded(row.bound.lowest, row.value, row.bound.highest))
    else:
        opti.subject_to(row.value - t <= row.bound.highest)
        opti.subject_to(row.value + t >= row.bound.lowest)


def _room(row, t):
    """How far a row is from its nearer bound."""
    return ca.fmin(row.value - row.bound.lowest, row.bound.highest - row.value) + (
        0.0 if t is None else t
    )


def _price(excess):
    """The price of what soft rows exceed by."""
    price = 0
    for row, t in excess:
        linear, quadratic = row.bound.prices
        price += linear * t + quadratic * t**2 / 2
    return price


def _stages(opti, intervals, n_s, n_u):
    """States of all nodes and inputs of all intervals, made in the order of the stages."""
    nodes = []
    inputs = []
    for _ in range(intervals):
        nodes.append(opti.variable(n_s))
        inputs.append(opti.variable(n_u))
    nodes.append(opti.variable(n_s))
    return nodes, inputs


def _set_solver(opti, solver):
    interface = {"print_time": False, "expand": True}
    if solver.by_stages:
        interface["structure_detection"] = "auto"
    opti.solver(solver.name, interface, solver.options)


def _solve(opti):
    """All unknowns, and whether IPOPT says that they are a solution."""
    with contextlib.suppress(RuntimeError):  # what it has found is read all the same
        opti.solve()
    return opti.debug.value(opti.x), opti.return_status() in _SOLVED


def _joint_step(model, dt):
    """The Function (s, u) -> s one sample later, in which the parameters stay."""
    x, u, p = _symbols(model)
    after = ca.vertcat(next_state(model, dt)(x, u, p), p)
    return ca.Function("joint", [ca.vertcat(x, p), u], [after])


def _bounds_of_joint_state(model):
    """{place in (x, p): (lowest, highest)} of what is bounded."""
    pairs = [(model.state_bounds or {}).get(name) for name in model.states]
    pairs += model.parameters.values()
    return {place: pair for place, pair in enumerate(pairs) if pair is not None}


def _difference(model, z, measured):
    """z minus what the model measures, angles by the shorter way."""
    off = ca.vertsplit(z - measured)
    for row, name in enumerate(model.outputs):
        if name in model.angles:
            off[row] = ca.atan2(ca.sin(off[row]), ca.cos(off[row]))
    return ca.vertcat(*off)


def _symbols(model):
    names = (model.states, model.inputs, model.parameters)
    return [ca.SX.sym(name, len(of)) for name, of in zip("xup", names)]
