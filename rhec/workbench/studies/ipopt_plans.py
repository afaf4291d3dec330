"""The nonlinear problem of a `rhec.RHC`, written down once more for IPOPT by multiple shooting.

    min  ½ Σ_{i=1..N} ‖x_i - x_r,i‖²_{Q_i} + ½ Σ_{i=0..N-1} (‖u_i‖²_R + ‖u_i - u_{i-1}‖²_{R_Δ})
         + Σ linear·t + ½ quadratic·t²
    s.t. x_{i+1} = F(x_i, u_i), lower - t ≤ row ≤ upper + t

Nothing of it is the controller's, except the options that both are given.
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core.controller.bounds import Bound

__all__ = ["IPOPT", "Plan", "Reference", "next_state"]

IPOPT = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
# Otherwise IPOPT may exceed each bound by 1e-8.
_STRICT = IPOPT | {"ipopt.bound_relax_factor": 0.0}
# Otherwise it leaves its first point at once, and may go to another local solution.
_NEAR = _STRICT | {
    # Where a bound is reached that does not push, IPOPT stays about the root of its tolerance away.
    "ipopt.tol": 1e-13,
    "ipopt.compl_inf_tol": 1e-14,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.mu_init": 1e-14,
    **{f"ipopt.warm_start_{name}": 1e-12 for name in ("bound_push", "bound_frac")},
    **{f"ipopt.warm_start_{name}": 1e-12 for name in ("slack_bound_push", "slack_bound_frac")},
    "ipopt.warm_start_mult_bound_push": 1e-12,
}
_ACTIVE = 1e-6  # distance from a bound that counts as being at it


class Plan(NamedTuple):
    """A solution, and whether IPOPT says that it is one."""

    u: np.ndarray  # (n_u, N)
    cost: float
    solved: bool
    active: bool  # whether a state, output or change is at a bound


class _Row(NamedTuple):
    """One bounded expression."""

    value: Any
    bound: Bound
    is_command: bool


def next_state(model, dt):
    """Build the Function (x, u, p) -> x one sample later.

    Args:
        model: A rhec.Model, discrete or with the rule "rk4".
        dt: Length of a sample [s].

    Returns:
        The Function, by steps of Runge and Kutta, or the model's own if it is discrete.
    """
    names = (model.states, model.inputs, model.parameters)
    x, u, p = (ca.SX.sym(name, len(of)) for name, of in zip("xup", names))
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


class Reference:
    """The problem of one sample, for any start.

    Args:
        options: Options of a rhec.RHC that commands all inputs, by bounds and diagonal weights, of
            a Model without parameters.
    """

    def __init__(self, options):
        self._options = options
        model = options["model"]
        N = self._N = options["horizon"]
        n_x = len(model.states)
        self._shape = (len(model.inputs), N)
        start = ca.SX.sym("start", n_x)
        goal = ca.SX.sym("goal", n_x, N + 1)
        u = ca.SX.sym("u", *self._shape)
        x = ca.SX.sym("x", n_x, N)
        nodes = ca.horzcat(start, x)
        F = next_state(model, options["dt"])
        ends = [F(nodes[:, i], u[:, i], []) for i in range(N)]
        self._build_solver(start, goal, u, x, ca.vec(x - ca.horzcat(*ends)))
        rolled = [start]
        for i in range(N):
            rolled.append(F(rolled[-1], u[:, i], []))
        rolled = ca.horzcat(*rolled)
        soft = [row for row in self._rows(rolled, u) if row.bound.is_soft]
        beyond = [
            ca.fmax(ca.fmax(row.value - row.bound.highest, row.bound.lowest - row.value), 0)
            for row in soft
        ]
        cost = self._cost(rolled, u, goal) + _price(soft, beyond)
        self._value = ca.Function("value", [start, goal, u], [rolled, cost])

    def cost(self, start, goal, u):
        """Roll the inputs out.

        Args:
            start: (n_x,) state.
            goal: (n_x,) or (n_x, N+1) desired states.
            u: (n_u, N) inputs.

        Returns:
            Their cost, with the price of soft bounds.
        """
        return float(self._value(start, self._goals(goal), u)[1])

    def solve(self, start, goal, u=None):
        """Solve the problem by IPOPT.

        Args:
            start: (n_x,) state.
            goal: (n_x,) or (n_x, N+1) desired states.
            u: (n_u, N) inputs to begin from, rolled out; None: none, and a state that stays.

        Returns:
            Plan.
        """
        goals = self._goals(goal)
        x = np.tile(np.reshape(start, (-1, 1)), (1, self._N))
        if u is not None:
            x = self._value(start, goals, u)[0].full()[:, 1:]
        solver = self._solvers[u is not None]
        u = np.zeros(self._shape) if u is None else u
        guess = np.concatenate([np.ravel(u, "F"), np.ravel(x, "F"), np.zeros(self._n_excess)])
        found = solver(x0=guess, p=ca.veccat(start, goals), **self._limits)
        values = found["g"].full().ravel()
        away = np.minimum(values - self._limits["lbg"], self._limits["ubg"] - values)
        n_u = self._shape[0] * self._N
        return Plan(
            u=found["x"].full().ravel()[:n_u].reshape(self._shape, order="F"),
            cost=float(found["f"]),
            solved=solver.stats()["success"],
            active=bool(np.any(away[self._of_states] < _ACTIVE)),
        )

    def _goals(self, goal):
        """The goal of all nodes."""
        goal = np.asarray(goal, dtype=float)
        return goal if goal.ndim == 2 else np.tile(goal.reshape(-1, 1), (1, self._N + 1))

    def _build_solver(self, start, goal, u, x, gaps):
        """Build IPOPT's problem: gaps of the intervals, then rows with the excess of soft ones."""
        nodes = ca.horzcat(start, x)
        rows = self._rows(nodes, u)
        soft = [row for row in rows if row.bound.is_soft]
        excess = ca.SX.sym("t", len(soft))
        t = {id(row): each for row, each in zip(soft, ca.vertsplit(excess))}
        values = [gaps]
        lower = [0.0] * gaps.numel()
        upper = [0.0] * gaps.numel()
        self._of_states = []
        for row in rows:
            for value, low, high in _sides(row, t.get(id(row))):
                if not row.is_command:
                    self._of_states.append(len(lower))
                values.append(value)
                lower.append(low)
                upper.append(high)
        cost = self._cost(nodes, u, goal) + _price(soft, ca.vertsplit(excess))
        unknowns = ca.veccat(u, x, excess)
        problem = dict(x=unknowns, p=ca.veccat(start, goal), f=cost, g=ca.vertcat(*values))
        self._solvers = [
            ca.nlpsol("plan", "ipopt", problem, options) for options in (_STRICT, _NEAR)
        ]
        self._n_excess = len(soft)
        least = np.full(unknowns.numel(), -np.inf)
        least[len(least) - len(soft) :] = 0.0
        self._limits = dict(lbx=least, lbg=np.array(lower), ubg=np.array(upper))

    def _cost(self, nodes, u, goal):
        """The quadratic cost; before the horizon the commands were as near to 0 as allowed."""
        options = self._options
        N = self._N
        Q = np.array(options["q"])
        QN = np.array(options.get("qn", options.get("qn_factor", 10.0) * Q))
        off = (nodes - goal)[:, 1:] ** 2
        cost = ca.dot(ca.repmat(Q, 1, N), off) + ca.dot(QN - Q, off[:, -1])
        cost += ca.dot(ca.repmat(ca.DM(options["r"]), 1, N), u**2)
        none = (-np.inf, np.inf)
        pairs = [options["bounds"].get(name, none) for name in options["model"].inputs]
        before = ca.DM([np.clip(0.0, *pair) for pair in pairs])
        change = ca.diff(ca.horzcat(before, u), 1, 1)
        r_delta = ca.DM(options.get("r_delta", (0.0,) * len(pairs)))
        return (cost + ca.dot(ca.repmat(r_delta, 1, N), change**2)) / 2

    def _rows(self, nodes, u):
        """The bounded expressions of all nodes where they count."""
        model = self._options["model"]
        outputs = self._options.get("outputs") or {}
        rows = []
        for name, given in self._options["bounds"].items():
            bound = given if isinstance(given, Bound) else Bound(*given)
            if name in model.inputs:
                row = u[model.inputs.index(name), :]
            elif name in model.states:
                row = nodes[model.states.index(name), 1:]
            else:
                row = self._output(outputs, name, nodes, u)
            is_command = name in model.inputs
            rows += [_Row(value, bound, is_command) for value in ca.horzsplit(row)]
        return rows

    def _output(self, outputs, name, nodes, u):
        """An output at the nodes 1 … N, or 0 … N-1 if it depends on a command."""
        model = self._options["model"]
        x = ca.SX.sym("x", len(model.states))
        v = ca.SX.sym("v", len(model.inputs))
        if isinstance(outputs, dict):
            value = ca.SX(outputs[name](x, v, ca.SX(0, 1)))
        else:
            value = model.measurement(x, v, ca.SX(0, 1))[model.outputs.index(name)]
        h = ca.Function("h", [x, v], [value])
        if ca.depends_on(value, v):
            return h.map(self._N)(nodes[:, :-1], u)
        return h.map(self._N)(nodes[:, 1:], u)


def _sides(row, t):
    """(value, lower, upper) of a row; a soft one has a side for each bound."""
    lowest = row.bound.lowest
    highest = row.bound.highest
    if t is None:
        return [(row.value, lowest, highest)]
    return [(row.value - t, -np.inf, highest), (row.value + t, lowest, np.inf)]


def _price(rows, excess):
    """The price of what soft rows exceed."""
    prices = [row.bound.prices for row in rows]
    return sum(a * t + b * t**2 / 2 for (a, b), t in zip(prices, excess))
