"""Nonlinear receding horizon control (model predictive control, MPC), eq. (12).

    min  ½ Σ_{i=1..N-1} ‖x_r,i - x_i‖²_{Q_k} + ½ ‖x_r,N - x_N‖²_{Q_N}
         + ½ Σ_{i=0..N-1} ‖u_r,i - u_i‖²_R
    s.t. x_0 = x̂, x_{i+1} = F(x_i, u_i, p̂), lower ≤ u_i ≤ upper        eq. (11), (16)

The states are eliminated, which leaves a QP in the commanded inputs. Everything that does not
depend on the newest sample belongs to the preparation phase. The estimate (x̂, p̂) and the
references enter in the feedback phase only: they move the gradient, through the linearised dynamics
of the joint state s = (x, p).
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from pydantic import SkipValidation

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.controller import constrained, relaxation
from rhec.core.controller.bounds import Bound
from rhec.core.controller.exact_hessian import ExactQP
from rhec.core.controller.horizon import (
    active_before,
    build_roll_out,
    commanded_stages,
    finite_or,
    for_all_samples,
    init,
    plain_stages,
    planned,
    row_of_commands,
    states_after,
)
from rhec.core.controller.initial_plan import InitialPlan, initial_plan
from rhec.core.controller.options import Hessian, Options, problem_of
from rhec.core.model.base import Model
from rhec.core.model.integration import refuse_start
from rhec.core.solver import gauss_newton
from rhec.core.solver.box_lq import box_lq
from rhec.core.solver.line_search import PENALTY, line_search
from rhec.core.solver.rti import IMPROVE, RealTimeIteration, RealTimeLoop, run_phases

FIRST_ITERATIONS = 100  # at most, on the first sample, for which there is no previous plan

# `options` checks these.
Weights = SkipValidation[tuple[float, ...] | np.ndarray]
OptionalWeights = SkipValidation[tuple[float, ...] | np.ndarray | None]
Bounds = SkipValidation[dict[str, tuple[float, float] | Bound] | None]
OutputsByName = SkipValidation[tuple[str, ...] | dict[str, Callable] | None]


def build_phases(horizon):
    """Build the RHC as {name: Function}: shift, linearise, feedback, expand (see `rti`) and step.

    `step` runs all phases; it maps (memory, weights, references) to (memory, kkt, command, ok).
    """
    qp = horizon.qp.build(horizon) if horizon.qp else StagewiseQP(horizon)
    qp = ExactQP(horizon, qp) if horizon.exact else qp
    roll_out = build_roll_out(horizon)
    gradient = _build_gradient(horizon, roll_out)
    shift, linearise = _build_preparation(horizon, qp)
    feedback = _build_feedback(horizon, linearise, gradient, qp)
    expand = _build_expand(horizon, feedback, roll_out)
    phases = dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand)
    if horizon.damped:
        phases[IMPROVE] = _build_improve(horizon, phases)
    return phases | dict(step=_build_step(horizon, phases))


class StagewiseQP:
    """The QP in the commanded inputs by a Riccati recursion over its stages (`box_lq`)."""

    def __init__(self, horizon):
        self.horizon = horizon
        shape = (horizon.N, *plain_stages(horizon))
        self._solve = box_lq(*shape, horizon.loops, horizon.doublings)

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
        stages |= {name: inputs[name] for name in self.horizon.weights}
        bounds = dict(lower=step["least"], upper=step["most"])
        active = active_before(self.horizon, inputs)
        solution = self._solve(**stages, g=step["g"], **bounds, active=active)
        return solution["x"], solution["multipliers"], solution["ok"]


def _build_preparation(horizon, qp):
    """The plan moved on by one sample; the dynamics along it, and what the QP can prepare."""
    N = horizon.N

    @casadi_function("rhc_shift", **horizon.memory)
    def shift(s, u):
        s, u = gauss_newton.shift(horizon.interval, s, u, horizon.dt_s)
        return dict(s=s, u=u)

    @casadi_function("rhc_linearise", horizon.loops, **horizon.memory, **horizon.weights)
    def linearise(s, u, Q, QN, R):
        dt_s = ca.repmat(ca.DM(horizon.dt_s), 1, N)
        # Each interval is linearised at its own node, whether or not the nodes are connected.
        F, D, B = horizon.interval.linearised.map(N)(s[:, :N], u, dt_s)
        return dict(F=F, D=D, B=B) | qp.prepare(D, B, Q, QN, R)

    return shift, linearise


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
        after = dict(adjoint_after=ca.densify(adjoint)) if horizon.exact else {}
        return dict(g=g, **after, adjoint_before=(horizon.interval.A_0 + D).T @ adjoint)

    return backward


def _build_gradient(horizon, roll_out):
    """The gradient of the cost at the previous plan, rolled out from the new estimate."""
    N = horizon.N
    command = list(horizon.command)
    backward = _build_backward(horizon)
    shapes = horizon.memory | horizon.dynamics | horizon.weights | horizon.references

    @casadi_function("rhc_gradient", horizon.loops, **shapes)
    def gradient(s, u, F, D, B, Q, QN, R, s_0, x_ref, u_ref, lower, upper):
        plan = planned(horizon, [u[place, :] for place in command], u_ref)
        nodes = roll_out(s, u, F, D, B, s_0, plan)
        D = ca.horzsplit(D, horizon.n_s)
        B = ca.horzsplit(B, horizon.n_u)
        ref, u, u_ref = map(ca.horzsplit, (x_ref, plan, u_ref))
        adjoint = ca.DM.zeros(horizon.n_s)  # λ_N
        g = [None] * N
        adjoints = [()] * N  # λ' of each interval, where an exact Hessian needs them
        weight = QN  # of node N; node 0 has none, since no input moves it
        for i in reversed(range(N)):
            end = nodes[i + 1], ref[i + 1]
            result = backward(adjoint, D[i], B[i], weight, *end, u[i], u_ref[i], R)
            g[i], *adjoints[i], adjoint = result
            weight = Q
        u = row_of_commands(plan, horizon)
        least = for_all_samples(lower, horizon) - u
        most = for_all_samples(upper, horizon) - u
        step = dict(g=ca.vertcat(*g).T, least=least, most=most)
        if horizon.exact:
            step["adjoints"] = ca.horzcat(*(after for (after,) in adjoints))
        return step

    return gradient


def _build_feedback(horizon, linearise, gradient, qp):
    """The estimate and the references move the gradient; the QP then gives the new plan."""
    prepared = {name: linearise.sparsity_out(name) for name in linearise.name_out()}
    shapes = prepared | horizon.memory | horizon.weights | horizon.references

    @casadi_function("rhc_feedback", ca.MX, **shapes)
    def feedback(**inputs):
        step = gradient(**select_inputs(gradient, inputs))
        change, multipliers, ok = qp.solve(step, inputs)
        u = row_of_commands(inputs["u"], horizon) + change
        # Rounding may take u + (upper - u) past the bound, which is a hard one.
        u = ca.fmax(u, for_all_samples(inputs["lower"], horizon))
        u = ca.fmin(u, for_all_samples(inputs["upper"], horizon))
        commands = ca.vertsplit(ca.reshape(u, len(horizon.command), horizon.N))
        # With a reference that is not finite there is no step, and the last plan goes on.
        u_plan = planned(horizon, commands, finite_or(inputs["u_ref"], inputs["u"]))
        step.pop("adjoints", None)
        return dict(u_plan=u_plan, multipliers=multipliers, ok=ok, **step)

    return feedback


def _build_expand(horizon, feedback, roll_out):
    """The predicted states of the new plan, and the KKT tolerance of the linearisation point."""
    command = list(horizon.command)
    results = ("u_plan", "g", "least", "most", "multipliers", "ok")
    shapes = horizon.memory | horizon.dynamics
    shapes |= {name: horizon.references[name] for name in ("s_0", "u_ref")}
    shapes |= {name: feedback.sparsity_out(name) for name in results}

    @short_cut("ok")
    @casadi_function("rhc_expand", horizon.loops, **shapes)
    def expand(s, u, F, D, B, s_0, u_ref, u_plan, g, least, most, multipliers, ok):
        before = planned(horizon, [u[place, :] for place in command], u_ref)
        change = row_of_commands(u_plan - before, horizon).T
        kkt = gauss_newton.kkt_tolerance(ca.dot(g.T, change), multipliers, least, most)
        kkt = ca.if_else(ok, kkt, ca.DM.nan())
        predicted = ca.horzcat(*roll_out(s, u, F, D, B, s_0, u_plan))
        return dict(s=states_after(horizon, ok, predicted, s, s_0), u=u_plan, kkt=kkt)

    return expand


def _build_step(horizon, phases):
    """All phases of one sample as one Function, as a closed loop calls it."""
    memory = horizon.memory

    @with_packed_memory("rhc_step", memory, ca.MX, **horizon.weights, **horizon.references)
    def step(**values):
        values = run_phases(phases, values)
        command = values["u_plan"][:, 0]  # eq. (13)
        outputs = dict(kkt=values["kkt"], command=command, ok=values["ok"])
        return outputs | {name: values[name] for name in memory}

    return step


def _build_cost_and_gaps(horizon):
    """The cost of nodes s and inputs u, eq. (12), and Σ |x̂ - s_0|, |F(s_i, u_i) - s_{i+1}|."""
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

    return cost_and_gaps, horizon.weights | data


def _build_improve(horizon, phases):
    """One iteration without shift: linearise, feedback, expand, and a line search."""
    search = line_search("rhc_search", horizon.memory, *reversed(_build_cost_and_gaps(horizon)))
    shapes = horizon.memory | horizon.weights | horizon.references

    @casadi_function("rhc_improve", ca.MX, **shapes, penalty=PENALTY)
    def improve(penalty, **inputs):
        values = dict(inputs)
        for name in ("linearise", "feedback", "expand"):
            full = phases[name](**select_inputs(phases[name], values))
            values |= full if name != "expand" else {}
        steps = {f"{name}_full": full[name] for name in horizon.memory}
        chosen = search(**select_inputs(search, inputs | steps), penalty=penalty)
        ok = values["ok"]
        plan = {name: ca.if_else(ok, chosen[name], full[name]) for name in horizon.memory}
        outputs = {name: values[name] for name in phases["feedback"].name_out()}
        outputs |= dict(kkt=full["kkt"], converged=chosen["converged"] * ok)
        outputs["done"] = chosen["done"] * ok
        return outputs | plan | dict(u_plan=plan["u"], penalty_after=chosen["penalty_after"])

    return improve


class RHC(RealTimeLoop):
    """Model predictive control for a user's control loop: `prepare()`, then `feedback(…)`.

    Without `model` it is the paper's controller, `rhec.tracked_robot.live.PaperRHC`.

    Args:
        model: The robot, a rhec.Model.
        command: Names of the inputs that are commanded; the others follow their reference.
        q: Weights Q of the states, or the matrix Q (n_x, n_x).
        r: Weights R of the commanded inputs, in the order of `command`, or the matrix R. 0 is
            allowed where other weights decide the command.
        dt: Length of a sample [s].
        horizon: Intervals N of the prediction.
        bounds: (lowest, highest) or a rhec.Bound of commanded inputs, states and outputs, by name;
            what has no entry is free. States are bounded from the next sample on.
        qn_factor: Q_N = qn_factor · Q, for states and outputs.
        qn: Weights Q_N of the states at the end of the horizon, instead of qn_factor · Q.
        outputs: Quantities that are weighed or bounded: names of the model's outputs, or a dict
            {name: function of (x, u, p)} with a CasADi expression as its result.
        q_y: Weights of the outputs, or a matrix. By default 0.
        qn_y: Weights of the outputs at the end of the horizon, instead of qn_factor · q_y.
        r_delta: Weights of the changes u_i - u_{i-1} of the commanded inputs, or a matrix. Before
            the first sample the commands were 0, or the nearest number within their bounds.
        delta_bounds: Bounds of the changes, by the name of the commanded input.
        terminal_bounds: Bounds of states and outputs at the horizon's end, instead of `bounds`.
        hessian: "gauss_newton", or "exact" for the Hessian of the Lagrangian wherever it has a
            minimum: bounds of commands and diagonal weights only.

    Raises:
        ValueError: if an argument is invalid.
    """

    _options: Options | None = None  # none of the paper's controller
    _initial: InitialPlan | None = None

    if TYPE_CHECKING:  # without a model, the options are those of the paper's robot

        def __init__(self, *, model: Model | None = None, **options: Any) -> None: ...

    @valid.checked  # type: ignore[no-redef]
    def __init__(
        self,
        *,
        model: Model,
        command: tuple[str, ...],
        q: Weights,
        r: Weights,
        dt: valid.Positive,
        horizon: valid.Intervals,
        bounds: Bounds = None,
        qn_factor: valid.NotNegative = 10.0,
        qn: OptionalWeights = None,
        outputs: OutputsByName = None,
        q_y: OptionalWeights = None,
        qn_y: OptionalWeights = None,
        r_delta: OptionalWeights = None,
        delta_bounds: Bounds = None,
        terminal_bounds: Bounds = None,
        hessian: Hessian = "gauss_newton",
    ):
        weights = dict(q=q, r=r, qn_factor=qn_factor, qn=qn, q_y=q_y, qn_y=qn_y, r_delta=r_delta)
        limits = dict(bounds=bounds, delta_bounds=delta_bounds, terminal_bounds=terminal_bounds)
        given = dict(model=model, command=command, dt=dt, horizon=horizon, outputs=outputs)
        given |= dict(hessian=hessian)
        self._options = Options(**given, **weights, **limits)
        self._compile(problem_of(self._options))

    def _compile(self, problem):
        """Load the compiled phases and name views of their input arrays."""
        self.problem = problem.plain
        self.horizon = problem.plain.N
        self.structure = problem.structure
        self.settings = problem.settings
        # All that a step improves is unknown: predicted states and planned inputs.
        unknowns = tuple(problem.plain.memory)
        memory = tuple(problem.structure.memory)
        self._build = build_phases if problem.is_plain else relaxation.build_phases
        functions = compiled.load(self._build, problem.structure)
        self.iteration = RealTimeIteration(functions, memory, unknowns, **self.settings)
        arrays = self.iteration.arrays
        n_x = problem.plain.n_x
        self._inputs = dict(
            x=arrays["s_0"][:n_x],
            p=arrays["s_0"][n_x:],
            x_ref=arrays["x_ref"].reshape((n_x, -1), order="F"),
            u_ref=arrays["u_ref"].reshape((problem.plain.n_u, -1), order="F"),
        )
        if "y_ref" in arrays:
            n_y = len(problem.structure.outputs.names)
            columns = (n_y, problem.plain.N + 1)
            self._inputs["y_ref"] = arrays["y_ref"].reshape(columns, order="F")

    def build(self) -> dict:
        """The phases of a sample as CasADi Functions, by name, not compiled."""
        return self._build(self.structure)

    def first_memory(self, x: Any, p: Any) -> dict:
        """The memory before the first sample: the robot stays at x, and nothing is planned.

        Args:
            x: (n_x,) state.
            p: (n_p,) parameters.

        Returns:
            The memory's arrays by name.
        """
        if self._build is build_phases:
            return init(self.structure, x, p)
        before = np.clip(0.0, *self._command_bounds())
        return constrained.init(self.structure, x, p, before)

    def _command_bounds(self):
        """Lowest and highest commands, (n_c,) each."""
        n_c = len(self.problem.command)  # they are the first rows of all that are bounded
        return self.settings["lower"][:n_c], self.settings["upper"][:n_c]

    def restart(self, u_plan: Any = None, x_plan: Any = None) -> None:
        """Begin anew: the next sample is the first, and improves this plan.

        Without a plan it starts from a robot that stays where it is, with no inputs.

        Args:
            u_plan: (n_u, N) or (n_u,) planned inputs. Commands beyond a bound begin at it, and
                inputs that are not commanded follow `u_ref`.
            x_plan: (n_x, N+1) or (n_x,) predicted states, which need not follow from the inputs;
                node 0 gets the state of the sample. None: those to which the inputs lead.

        Raises:
            ValueError: If a plan has another shape, or an entry that is no number.
        """
        self._initial = initial_plan(self.problem, u_plan, x_plan)
        self.iteration.restart()

    def update(self, **changes: Any) -> None:
        """Change weights, bounds or prices from the next feedback on; nothing is compiled.

        Args:
            changes: Parameters of rhec.RHC with their new values, such as `q` or `bounds`. What has
                a bound or a price has to keep one, and what has none can get none; a bound of inf
                is none.

        Raises:
            ValueError: If a value is invalid, or if it needs another controller.
        """
        given = self._given_options()
        unknown = [name for name in changes if name not in given._fields]
        if unknown:
            valid.refuse("update had", unknown[0], f"it may have {given._fields}")
        options = given._replace(**changes)
        problem = problem_of(options)
        if problem.structure != self.structure:
            raise ValueError(
                f"update had {', '.join(changes)}, which changes what is weighed or bounded; that "
                "needs a new rhec.RHC"
            )
        self._options = options
        self.settings = problem.settings
        self.iteration.set(self.iteration.arrays, self.settings)

    @property
    def bounds(self) -> dict:
        """Bounds by name, as they were given last."""
        return dict(self._given_options().bounds or {})

    def _given_options(self):
        """The options of a Model's controller."""
        if self._options is None:
            raise ValueError(
                "the controller was the paper's; bounds and update need a rhec.RHC with a model"
            )
        return self._options

    def __repr__(self):
        problem = self.problem
        commands = ", ".join(problem.model.inputs[place] for place in problem.command)
        qp = problem.qp or ("by stages" if self._build is build_phases else "by interior point")
        head = f"{type(self).__name__}: {problem.N} intervals of {problem.dt_s:g} s, QP {qp}"
        states = f"  states   {', '.join(problem.model.states)}"
        if self._build is not build_phases:
            outputs = ", ".join(self.structure.outputs.names) or "none"
            return f"{head}\n{states}\n  outputs  {outputs}\n  commands {commands}"
        numbers = {name: np.array2string(value) for name, value in self.settings.items()}
        return (
            f"{head}\n{states}: Q {numbers['Q']}, QN {numbers['QN']}\n"
            f"  commands {commands}: "
            f"R {numbers['R']}, bounds {numbers['lower']} to {numbers['upper']}"
        )

    def feedback(self, x: Any, p: Any, x_ref: Any, u_ref: Any, y_ref: Any = None) -> Any:
        """Inputs to apply now, by one Gauss-Newton step, eq. (13).

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) desired states; node 0 is now and has no weight. Or (n_x,), if they
                are the same at all nodes.
            u_ref: (n_u, N) or (n_u,) desired inputs. Inputs that are not commanded are expected to
                follow it, such as known signals. Where an entry is not finite, the last plan goes
                on, and `ok` is False.
            y_ref: (n_y, N+1) or (n_y,) desired outputs; None: the last ones, at first 0.

        Returns:
            (n_u,) inputs of the first interval.
        """
        is_first = not self.iteration.started
        self._set_problem(x, p, x_ref, u_ref, y_ref)
        if is_first:
            self.iteration.improve_first(FIRST_ITERATIONS)
        self.iteration.feedback()
        return self.u_plan[:, 0]

    def solve(
        self, x: Any, p: Any, x_ref: Any, u_ref: Any, iterations: int = 20, y_ref: Any = None
    ) -> Any:
        """Iterate to convergence on the nonlinear problem.

        A Model's steps are shortened, by a line search or, with constraints, by what the last two
        steps have shown, and end once `converged`. The paper's controller takes full steps, all of
        them.

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) or (n_x,) desired states.
            u_ref: (n_u, N) or (n_u,) desired inputs.
            iterations: Gauss-Newton steps, at most.
            y_ref: (n_y, N+1) or (n_y,) desired outputs; None: the last ones, at first 0.

        Returns:
            (n_u,) inputs of the first interval.
        """
        self._set_problem(x, p, x_ref, u_ref, y_ref)
        self.iteration.solve(iterations)
        return self.u_plan[:, 0]

    def _set_problem(self, x, p, x_ref, u_ref, y_ref):
        """Copy the new data in; references that are constant are repeated along the horizon."""
        given = dict(x=x, p=p, x_ref=x_ref, u_ref=u_ref)
        if y_ref is not None:
            if "y_ref" not in self._inputs:
                valid.refuse("y_ref was", y_ref, "it should be None, since there are no outputs")
            given["y_ref"] = y_ref
        for name, value in given.items():
            array = self._inputs[name]
            if array.ndim == 2 and np.shape(value) == array.shape[:1]:
                given[name] = np.repeat(np.reshape(value, (-1, 1)), array.shape[1], axis=1)
        self._set_inputs(**given)

    def _start(self):
        # There is no previous plan: start from a given one, or a robot that stays where it is.
        x, p = list(self._inputs.values())[:2]
        u_ref = self.iteration.arrays["u_ref"][: self.problem.n_u]
        u = np.where(np.isfinite(u_ref), u_ref, 0.0)
        refuse_start(self.problem.model, x, u, p, self.problem.dt_s)
        memory = self.first_memory(x, p)
        if self._initial:
            # A line search would refuse the way back to the bounds, where it raises the cost.
            within = self._initial.clipped(self.problem.command, *self._command_bounds())
            memory |= within.memory(self.problem, x, p)
        self.iteration.start(memory)

    @property
    def u_plan(self) -> np.ndarray:
        """Planned inputs (n_u, N)."""
        return self.iteration.arrays["u_plan"].reshape((self.problem.n_u, -1), order="F").copy()

    @property
    def x_plan(self) -> np.ndarray:
        """Predicted states (n_x, N+1)."""
        # The states are not needed for the command, so feedback leaves them to expand.
        self.iteration.expand()
        s = self.iteration.previous["s"].reshape((self.problem.n_s, -1), order="F")
        return s[: self.problem.n_x].copy()
