"""Nonlinear receding horizon control (model predictive control, MPC), eq. (12).

    min  ½ Σ_{i=1..N-1} ‖x_r,i - x_i‖²_{Q_k} + ½ ‖x_r,N - x_N‖²_{Q_N}
         + ½ Σ_{i=0..N-1} ‖u_r,i - u_i‖²_R
    s.t. x_0 = x̂, x_{i+1} = F(x_i, u_i, p̂), lower ≤ u_i ≤ upper

The states are eliminated; the QP is in the commanded inputs. What does not depend on the newest
sample belongs to the preparation phase. The estimate (x̂, p̂) and the references enter in the
feedback phase only: they move the gradient, through the linearised dynamics of the joint state
s = (x, p).
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.model.base import Model, interval
from rhec.core.model.limits import MAX_QP_ENTRY, is_plausible
from rhec.core.solver import condensed, gauss_newton
from rhec.core.solver.box_lq import box_lq
from rhec.core.solver.rti import PHASES, RealTimeIteration, RealTimeLoop, copy_checked

__all__ = ["RHC", "Horizon", "build_phases", "init"]


class Horizon(NamedTuple):
    """What decides the shape of the Functions: N intervals of dt_s, which inputs are commanded.

    qp: "structured", by stages, or the condensed QP by "daqp" or "qpoases".
    """

    model: Model
    command: tuple[int, ...]
    dt_s: float
    N: int
    qp: str = "structured"

    @property
    def memory(self):
        """s predicted joint states, u planned inputs."""
        return dict(s=(self.n_s, self.N + 1), u=(len(self.model.inputs), self.N))

    @property
    def weights(self):
        """Diagonals Q, QN of the states, R of the commands."""
        n_x = len(self.model.states)
        return dict(Q=(n_x, 1), QN=(n_x, 1), R=(len(self.command), 1))

    @property
    def references(self):
        """The estimate s_0; x_ref, of which node 0 has no weight; u_ref; bounds of the commands."""
        n_x = len(self.model.states)
        n_u = len(self.model.inputs)
        column = (len(self.command), 1)
        return dict(
            s_0=(self.n_s, 1),
            x_ref=(n_x, self.N + 1),
            u_ref=(n_u, self.N),
            lower=column,
            upper=column,
        )

    @property
    def n_s(self):
        """Length of the joint state (x, p)."""
        return len(self.model.states) + len(self.model.parameters)


def build_phases(horizon):
    """The RHC as CasADi Functions shift, linearise, feedback, expand (see `rti`) and step, all.

    Args:
        horizon: The Horizon.

    Returns:
        {name: Function}. `step` maps (memory, weights, references) to (memory, kkt, command, ok).
    """
    N = horizon.N
    model = horizon.model
    command = list(horizon.command)
    n_x = len(model.states)
    n_u = len(model.inputs)
    n_c = len(command)
    n_s = horizon.n_s
    iv = interval(model, measured=False)
    structured = horizon.qp == "structured"
    # A short horizon is faster in one piece.
    loops = compiled.loop_symbols() if structured and N > 30 else ca.SX
    memory = horizon.memory
    weights = horizon.weights
    references = horizon.references
    state = (n_s, 1)
    inputs = (n_u, 1)
    linearised = {name: iv.linearised.sparsity_out(i) for i, name in enumerate("FDB")}

    @casadi_function("rhc_shift", **memory)
    def shift(s, u):
        s, u = gauss_newton.shift(iv, s, u, horizon.dt_s)
        return dict(s=s, u=u)

    @casadi_function("rhc_linearise", loops, **memory, **weights)
    def linearise(s, u, Q, QN, R):
        dt_s = ca.repmat(ca.DM(horizon.dt_s), 1, N)
        F, D, B = iv.linearised.map(N)(s[:, :N], u, dt_s)
        dynamics = dict(F=F, D=D, B=B)
        if structured:
            return dynamics
        # The parameters have no weight.
        Q, QN = (ca.diag(ca.vertcat(weight, ca.SX(n_s - n_x, 1))) for weight in (Q, QN))
        A = [iv.A_0 + part for part in ca.horzsplit(D, n_s)]
        B = [part[:, command] for part in ca.horzsplit(B, n_u)]
        H = condensed.condensed_hessian(A, B, [Q] * (N - 1) + [QN], ca.diag(R))
        return dynamics | dict(H=H)

    @casadi_function("rhc_forward", **linearised, s=state, u=inputs, s_new=state, u_new=inputs)
    def forward(F, D, B, s, u, s_new, u_new):
        """s_{i+1} = F_i + A_i (s_i - s̄_i) + B_i (u_i - ū_i)."""
        return dict(s_after=F + (iv.A_0 + D) @ (s_new - s) + B @ (u_new - u))

    @casadi_function(
        "rhc_backward",
        adjoint=state,
        D=linearised["D"],
        B=linearised["B"],
        weight=(n_x, 1),
        s=state,
        ref=(n_x, 1),
        u=inputs,
        u_ref=inputs,
        R=(n_c, 1),
    )
    def backward(adjoint, D, B, weight, s, ref, u, u_ref, R):
        """Gradient in an interval's commands from the adjoint after it; the adjoint before it."""
        adjoint = adjoint + ca.vertcat(weight * (s[:n_x] - ref), ca.SX(n_s - n_x, 1))
        g = R * (u - u_ref)[command] + B[:, command].T @ adjoint
        return dict(g=g, adjoint_before=(iv.A_0 + D).T @ adjoint)

    def rollout(s, u, F, D, B, s_0, u_new):
        """The linearised trajectory from s_0; the gaps of multiple shooting close here."""
        nodes = [s_0]
        along = map(ca.horzsplit, (F, D, B, s, u, u_new), (1, n_s, n_u, 1, 1, 1))
        for F_i, D_i, B_i, s_i, u_i, new_i in zip(*along):
            nodes.append(forward(F_i, D_i, B_i, s_i, u_i, nodes[-1], new_i))
        return nodes

    def commanded(u, u_ref):
        """The plan with inputs that are not commanded as their references say."""
        rows = ca.vertsplit(u_ref)
        for place in command:
            rows[place] = u[place, :]
        return ca.vertcat(*rows)

    dynamics = {name: linearise.sparsity_out(name) for name in "FDB"}

    @casadi_function("rhc_gradient", loops, **memory, **dynamics, **weights, **references)
    def gradient(s, u, F, D, B, Q, QN, R, s_0, x_ref, u_ref, lower, upper):
        """Gradient of the cost in the commands at the previous plan, and what is left to bounds.

        The plan is rolled out from the new estimate.
        """
        plan = commanded(u, u_ref)
        nodes = rollout(s, u, F, D, B, s_0, plan)
        ref = ca.horzsplit(x_ref)
        D = ca.horzsplit(D, n_s)
        B = ca.horzsplit(B, n_u)
        u, u_ref = map(ca.horzsplit, (plan, u_ref))
        adjoint = ca.DM.zeros(n_s)
        g = [None] * N
        weight = QN
        for i in reversed(range(N)):
            g[i], adjoint = backward(
                adjoint, D[i], B[i], weight, nodes[i + 1], ref[i + 1], u[i], u_ref[i], R
            )
            weight = Q
        u = ca.vec(plan[command, :]).T
        return dict(
            g=ca.vertcat(*g).T,
            least=ca.repmat(lower, N, 1).T - u,
            most=ca.repmat(upper, N, 1).T - u,
        )

    if structured:
        # The parameters do not move: in x alone the stages are half as large.
        x = list(range(n_x))
        D_x = linearised["D"].sub(x, x)[0]
        B_x = linearised["B"].sub(x, command)[0]
        stages = box_lq(N, iv.A_0[x, x], D_x, B_x, loops)
    else:
        solve_condensed = condensed.box_qp_by_library(N * n_c, horizon.qp)

    def solve(g, least, most, u, lower, upper, Q, QN, R, D, B, H=None):
        if not structured:
            found = solve_condensed(H=H, g=g.T, lb=least.T, ub=most.T)
            return found["x"].T, found["multipliers"].T, found["ok"]
        D = ca.horzcat(*(part[:n_x, :n_x] for part in ca.horzsplit(D, n_s)))
        B = ca.horzcat(*(part[:n_x, command] for part in ca.horzsplit(B, n_u)))
        # Where the previous plan was at its bounds.
        active = (u >= ca.repmat(upper, N, 1).T) - (u <= ca.repmat(lower, N, 1).T)
        found = stages(D=D, B=B, Q=Q, QN=QN, R=R, g=g, lower=least, upper=most, active=active)
        return found["x"], found["multipliers"], found["ok"]

    prepared = {name: linearise.sparsity_out(name) for name in linearise.name_out()}

    @casadi_function("rhc_feedback", ca.MX, **prepared, **memory, **weights, **references)
    def feedback(lower, upper, **inputs):
        local = gradient(**select_inputs(gradient, inputs), lower=lower, upper=upper)
        u = ca.vec(inputs["u"][command, :]).T
        known = {name: inputs[name] for name in ("Q", "QN", "R", "D", "B", "H") if name in inputs}
        x, multipliers, ok = solve(**local, u=u, lower=lower, upper=upper, **known)
        # u + (upper - u) may round past the bound.
        plan = ca.fmin(ca.fmax(u + x, ca.repmat(lower, N, 1).T), ca.repmat(upper, N, 1).T)
        rows = ca.vertsplit(inputs["u_ref"])
        for place, row in zip(command, ca.vertsplit(ca.reshape(plan, n_c, N))):
            rows[place] = row
        return dict(u_plan=ca.vertcat(*rows), multipliers=multipliers, ok=ok, **local)

    result = {
        name: feedback.sparsity_out(name)
        for name in ("u_plan", "g", "least", "most", "multipliers", "ok")
    }

    @short_cut("ok")
    @casadi_function(
        "rhc_expand", loops, **memory, **dynamics, s_0=state, u_ref=references["u_ref"], **result
    )
    def expand(s, u, F, D, B, s_0, u_ref, u_plan, g, least, most, multipliers, ok):
        """The predicted states of the new plan, and the KKT tolerance of the linearisation point.

        A step that failed leaves the shifted inputs; the next linearisation begins at the estimate,
        if that is one: what made the step fail may be in the states, and would stay.
        """
        change = ca.vec((u_plan - commanded(u, u_ref))[command, :])
        kkt = gauss_newton.kkt_tolerance(ca.dot(g.T, change), multipliers, least, most)
        predicted = ca.horzcat(*rollout(s, u, F, D, B, s_0, u_plan))
        anew = ca.if_else(is_plausible(s_0), ca.repmat(s_0, 1, N + 1), s)
        return dict(s=ca.if_else(ok, predicted, anew), u=u_plan, kkt=kkt)

    phases = dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand)

    @with_packed_memory("rhc_step", memory, ca.MX, **weights, **references)
    def step(**known):
        for name in PHASES:
            known |= phases[name](**select_inputs(phases[name], known))
        told = dict(kkt=known["kkt"], command=known["u_plan"][:, 0], ok=known["ok"])
        return told | {name: known[name] for name in memory}

    return phases | dict(step=step)


def init(horizon, x, p):
    """Memory before the first sample: the robot at x (n_x,) with p (n_p,), nothing planned."""
    s = np.tile([*x, *p], (horizon.N + 1, 1)).T
    return dict(s=s, u=np.zeros((len(horizon.model.inputs), horizon.N)))


class RHC(RealTimeLoop):
    """Model predictive control for a loop of one's own: `prepare()`, then `feedback(…)`.

    Without `model` it is the paper's controller, `rhec.tracked_robot.live.PaperRHC`.

    Args:
        model: The robot, a rhec.Model.
        command: Names of the inputs that are commanded; others follow their reference.
        bounds: (lowest, highest) of commanded inputs, by name; what is not named has none.
        q: Weights Q_k of the states.
        r: Weights R of the commanded inputs, in the order of `command`.
        qn_factor: Q_N = qn_factor · Q_k.
        dt: Length of a sample [s].
        horizon: Intervals of the prediction.

    Raises:
        ValueError: In one sentence, for an argument that cannot be.
    """

    # Returns the class that stands in where no model is passed; `rhec` sets it.
    paper_class: ClassVar[Callable[[], type["RHC"]] | None] = None

    def __new__(cls, *, model: Model | None = None, **options: Any) -> "RHC":
        if cls is RHC and model is None and cls.paper_class:
            cls = cls.paper_class()
        return super().__new__(cls)

    if TYPE_CHECKING:  # without a model, the options are those of the paper's robot

        def __init__(self, *, model: Model | None = None, **options: Any) -> None: ...

    @valid.checked  # type: ignore[no-redef]
    def __init__(
        self,
        *,
        model: Model,
        command: tuple[str, ...],
        q: valid.NotNegatives,
        r: valid.Positives,
        dt: valid.Positive,
        horizon: valid.Intervals,
        bounds: dict[str, tuple[float, float]] | None = None,
        qn_factor: valid.NotNegative = 10.0,
    ):
        _check_command(model, command, bounds or {})
        valid.of_length("q", q, len(model.states), "state")
        valid.of_length("r", r, len(command), "commanded input")
        places = tuple(model.inputs.index(name) for name in command)
        limits = [(bounds or {}).get(name, (-MAX_QP_ENTRY, MAX_QP_ENTRY)) for name in command]
        limits = dict(zip(("lower", "upper"), zip(*limits)))
        self._begin(Horizon(model, places, dt, horizon), q, r, qn_factor, limits)

    def _begin(self, horizon, q, r, qn_factor, limits):
        self.problem = horizon
        self.horizon = horizon.N
        weights = dict(Q=np.array(q), QN=qn_factor * np.array(q), R=np.array(r))
        limits = {name: np.clip(of, -MAX_QP_ENTRY, MAX_QP_ENTRY) for name, of in limits.items()}
        self.settings = weights | limits
        functions = compiled.load(build_phases, horizon)
        memory = tuple(horizon.memory)
        self.iteration = RealTimeIteration(functions, memory, memory, **self.settings)
        arrays = self.iteration.arrays
        n_x = len(horizon.model.states)
        n_u = len(horizon.model.inputs)
        shape = dict(order="F")
        self._inputs = dict(
            x=arrays["s_0"][:n_x],
            p=arrays["s_0"][n_x:],
            x_ref=arrays["x_ref"].reshape((n_x, -1), **shape),
            u_ref=arrays["u_ref"].reshape((n_u, -1), **shape),
        )

    def feedback(self, x: Any, p: Any, x_ref: Any, u_ref: Any) -> Any:
        """Inputs to apply now, by one Gauss-Newton step.

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) desired states; node 0 is now and has no weight.
            u_ref: (n_u, N) desired inputs.

        Returns:
            (n_u,) inputs of the first interval.
        """
        self._give(x=x, p=p, x_ref=x_ref, u_ref=u_ref)
        self.iteration.feedback()
        return self.u_plan[:, 0]

    def solve(self, x: Any, p: Any, x_ref: Any, u_ref: Any, iterations: int = 20) -> Any:
        """Iterate to convergence on the nonlinear problem.

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) desired states.
            u_ref: (n_u, N) desired inputs.
            iterations: Gauss-Newton steps.

        Returns:
            (n_u,) inputs of the first interval.
        """
        self._give(x=x, p=p, x_ref=x_ref, u_ref=u_ref)
        self.iteration.solve(iterations)
        return self.u_plan[:, 0]

    def _give(self, **values):
        for name, value in values.items():
            copy_checked(name, value, self._inputs[name])
        self._start_once()

    def _start_once(self):
        if not self.iteration.started:
            self.iteration.start(init(self.problem, self._inputs["x"], self._inputs["p"]))

    @property
    def u_plan(self) -> np.ndarray:
        """Planned inputs (n_u, N)."""
        n_u = len(self.problem.model.inputs)
        return self.iteration.arrays["u_plan"].reshape((n_u, -1), order="F").copy()

    @property
    def x_plan(self) -> np.ndarray:
        """Predicted states (n_x, N+1)."""
        self.iteration.expand()
        n_x = len(self.problem.model.states)
        s = self.iteration.previous["s"].reshape((self.problem.n_s, -1), order="F")
        return s[:n_x].copy()


def _check_command(model, command, bounds):
    if not command:
        raise ValueError(f"command was (); it should name some of {model.inputs}")
    for field, names, known in (
        ("command", command, model.inputs),
        ("bounds", tuple(bounds), command),
    ):
        for name in names:
            if name not in known or names.count(name) > 1:
                wanted = f"it should name some of {known}, each once"
                raise ValueError(f"{field} was {valid.shown(names)}; {wanted}")
    for name, (lowest, highest) in bounds.items():
        if not lowest < highest:
            wanted = "the first should be below the second"
            raise ValueError(f"bounds of {name!r} were ({lowest}, {highest}); {wanted}")
