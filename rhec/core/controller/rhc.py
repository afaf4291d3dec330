"""Nonlinear receding horizon control (model predictive control, MPC), eq. (12).

    min  ½ Σ_{i=1..N-1} ‖x_r,i - x_i‖²_{Q_k} + ½ ‖x_r,N - x_N‖²_{Q_N}
         + ½ Σ_{i=0..N-1} ‖u_r,i - u_i‖²_R
    s.t. x_0 = x̂, x_{i+1} = F(x_i, u_i, p̂), lower ≤ u_i ≤ upper        eq. (11), (16)

The states are eliminated, which leaves a QP in the commanded inputs. Everything that does not
depend on the newest sample belongs to the preparation phase. The estimate (x̂, p̂) and the
references enter in the feedback phase only: they move the gradient, through the linearised dynamics
of the joint state s = (x, p).
"""

from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.model.base import Model, interval
from rhec.core.model.integration import refuse_unstable_step
from rhec.core.model.limits import MAX_QP_ENTRY, is_plausible
from rhec.core.solver import gauss_newton
from rhec.core.solver.box_lq import box_lq
from rhec.core.solver.line_search import PENALTY, line_search
from rhec.core.solver.rti import IMPROVE, RealTimeIteration, RealTimeLoop, run_phases

FIRST_ITERATIONS = 100  # at most, on the first sample, for which there is no previous plan


class Horizon(NamedTuple):
    """The structure of an RHC, which decides the shapes of its Functions."""

    model: Model
    command: tuple[int, ...]  # places of the commanded inputs in `model.inputs`
    dt_s: float  # length of an interval [s]
    N: int  # intervals of the prediction
    # None for the QP by its stages, or an object such as `rhec.core.solver.condensed.Condensed`,
    # whose `build(horizon)` returns a solver with the methods of StagewiseQP.
    qp: Any = None
    damped: bool = False  # whether an iteration with a line search is built, too

    @property
    def n_x(self):
        """Length of the state x."""
        return len(self.model.states)

    @property
    def n_u(self):
        """Length of the input u, whether commanded or not."""
        return len(self.model.inputs)

    @property
    def n_s(self):
        """Length of the joint state s = (x, p)."""
        return self.n_x + len(self.model.parameters)

    @property
    def interval(self):
        """The model's shooting interval."""
        return interval(self.model, measured=False)

    @property
    def memory(self):
        """Shapes of the predicted joint states s and of the planned inputs u."""
        return dict(s=(self.n_s, self.N + 1), u=(self.n_u, self.N))

    @property
    def weights(self):
        """Shapes of the diagonals of Q and QN (states) and of R (commanded inputs)."""
        return dict(Q=(self.n_x, 1), QN=(self.n_x, 1), R=(len(self.command), 1))

    @property
    def references(self):
        """Shapes of the estimate s_0, the references, and the bounds of the commanded inputs."""
        bound = (len(self.command), 1)
        references = dict(s_0=(self.n_s, 1), x_ref=(self.n_x, self.N + 1), u_ref=(self.n_u, self.N))
        return references | dict(lower=bound, upper=bound)

    @property
    def dynamics(self):
        """Sparsities of F, D and B of all intervals, side by side."""
        return {name: ca.repmat(part, 1, self.N) for name, part in self.interval.sparsities.items()}

    @property
    def loops(self):
        """SX or MX, for Functions that repeat an interval."""
        # In one piece, a step takes two thirds of the time, and a long horizon 7 s to compile. The
        # paper's horizon has 15 intervals, one command and six joint states.
        is_long = self.N > 15 or self.N * len(self.command) * self.n_s > 100
        return compiled.loop_symbols() if self.qp is None and is_long else ca.SX


def build_phases(horizon):
    """Build the RHC as {name: Function}: shift, linearise, feedback, expand (see `rti`) and step.

    `step` runs all phases; it maps (memory, weights, references) to (memory, kkt, command, ok).
    """
    qp = horizon.qp.build(horizon) if horizon.qp else StagewiseQP(horizon)
    roll_out = _build_roll_out(horizon)
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
        self._command = list(horizon.command)
        # The parameters do not move: with x alone the stages are half as large.
        x = list(range(horizon.n_x))
        D = horizon.interval.sparsities["D"].sub(x, x)[0]
        B = horizon.interval.sparsities["B"].sub(x, self._command)[0]
        self._solve = box_lq(horizon.N, horizon.interval.A_0[x, x], D, B, horizon.loops)

    def prepare(self, D, B, Q, QN, R):
        """Return no outputs: the recursion needs the active set, so there is nothing to prepare."""
        return {}

    def solve(self, step, inputs):
        """Solve min ½ Δu'HΔu + g'Δu, least ≤ Δu ≤ most, where the stages imply H.

        `step` holds the gradient g and the bounds least and most of the commands' change Δu, as
        rows; `inputs` are those of the feedback phase. Returns the rows Δu and its multipliers, and
        whether they are the solution.
        """
        n_x = self.horizon.n_x
        D = ca.horzsplit(inputs["D"], self.horizon.n_s)
        B = ca.horzsplit(inputs["B"], self.horizon.n_u)
        # The active set is first guessed to be the bounds at which the previous plan was.
        u = _row_of_commands(inputs["u"], self.horizon)
        at_upper = u >= _for_all_samples(inputs["upper"], self.horizon)
        at_lower = u <= _for_all_samples(inputs["lower"], self.horizon)
        stages = dict(
            D=ca.horzcat(*(part[:n_x, :n_x] for part in D)),
            B=ca.horzcat(*(part[:n_x, self._command] for part in B)),
            **{name: inputs[name] for name in self.horizon.weights},
        )
        bounds = dict(lower=step["least"], upper=step["most"])
        solution = self._solve(**stages, g=step["g"], **bounds, active=at_upper - at_lower)
        return solution["x"], solution["multipliers"], solution["ok"]


def _row_of_commands(u, horizon):
    """The commanded rows of inputs (n_u, N) as one row, sample by sample: (1, N·n_c)."""
    return ca.vec(u[list(horizon.command), :]).T


def _for_all_samples(bound, horizon):
    """Repeat the bounds (n_c, 1) of one sample for all: (1, N·n_c)."""
    return ca.repmat(bound, horizon.N, 1).T


def _planned(horizon, commands, u_ref):
    """The plan (n_u, N) from the rows of its commanded inputs; the others follow u_ref."""
    rows = ca.vertsplit(u_ref)
    for place, row in zip(horizon.command, commands):
        rows[place] = row
    return ca.vertcat(*rows)


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


def _build_roll_out(horizon):
    """A function that rolls the linearised dynamics out from s_0 under new inputs.

    s_{i+1} = F_i + A_i (s_i - s̄_i) + B_i (u_i - ū_i), with (s̄, ū) from the previous plan. The gaps
    that multiple shooting leaves between the intervals close here.
    """
    n_s = horizon.n_s
    n_u = horizon.n_u
    s_i = (n_s, 1)
    u_i = (n_u, 1)
    F_i, D_i, B_i = horizon.interval.sparsities.values()

    @casadi_function("rhc_forward")
    def forward(F: F_i, D: D_i, B: B_i, s: s_i, u: u_i, s_new: s_i, u_new: u_i):
        A = horizon.interval.A_0 + D
        return dict(s_after=F + A @ (s_new - s) + B @ (u_new - u))

    def roll_out(s, u, F, D, B, s_0, u_new):
        nodes = [s_0]
        intervals = map(ca.horzsplit, (F, D, B, s, u, u_new), (1, n_s, n_u, 1, 1, 1))
        for *previous, u_new_i in zip(*intervals):
            nodes.append(forward(*previous, nodes[-1], u_new_i))
        return nodes

    return roll_out


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

    @casadi_function("rhc_gradient", horizon.loops, **shapes)
    def gradient(s, u, F, D, B, Q, QN, R, s_0, x_ref, u_ref, lower, upper):
        plan = _planned(horizon, [u[place, :] for place in command], u_ref)
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
        u = _row_of_commands(plan, horizon)
        least = _for_all_samples(lower, horizon) - u
        most = _for_all_samples(upper, horizon) - u
        return dict(g=ca.vertcat(*g).T, least=least, most=most)

    return gradient


def _build_feedback(horizon, linearise, gradient, qp):
    """The estimate and the references move the gradient; the QP then gives the new plan."""
    prepared = {name: linearise.sparsity_out(name) for name in linearise.name_out()}
    shapes = prepared | horizon.memory | horizon.weights | horizon.references

    @casadi_function("rhc_feedback", ca.MX, **shapes)
    def feedback(**inputs):
        step = gradient(**select_inputs(gradient, inputs))
        change, multipliers, ok = qp.solve(step, inputs)
        u = _row_of_commands(inputs["u"], horizon) + change
        # Rounding may take u + (upper - u) past the bound, which is a hard one.
        u = ca.fmax(u, _for_all_samples(inputs["lower"], horizon))
        u = ca.fmin(u, _for_all_samples(inputs["upper"], horizon))
        commands = ca.vertsplit(ca.reshape(u, len(horizon.command), horizon.N))
        u_plan = _planned(horizon, commands, inputs["u_ref"])
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
        before = _planned(horizon, [u[place, :] for place in command], u_ref)
        change = _row_of_commands(u_plan - before, horizon).T
        kkt = gauss_newton.kkt_tolerance(ca.dot(g.T, change), multipliers, least, most)
        kkt = ca.if_else(ok, kkt, ca.DM.nan())
        predicted = ca.horzcat(*roll_out(s, u, F, D, B, s_0, u_plan))
        # A step that failed leaves the shifted inputs. Its states may be the cause, and would
        # stay: the next linearisation starts from the estimate, if that is plausible.
        restarted = ca.if_else(is_plausible(s_0), ca.repmat(s_0, 1, horizon.N + 1), s)
        return dict(s=ca.if_else(ok, predicted, restarted), u=u_plan, kkt=kkt)

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
        return dict(cost=ca.sum1(squares) / 2, gaps=ca.norm_1(gaps))

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


def init(horizon, x, p):
    """Memory before the first sample: the robot stays at x, with parameters p, nothing planned."""
    s = np.tile([*x, *p], (horizon.N + 1, 1)).T
    return dict(s=s, u=np.zeros((horizon.n_u, horizon.N)))


class RHC(RealTimeLoop):
    """Model predictive control for a user's control loop: `prepare()`, then `feedback(…)`.

    Without `model` it is the paper's controller, `rhec.tracked_robot.live.PaperRHC`.

    Args:
        model: The robot, a rhec.Model.
        command: Names of the inputs that are commanded; the others follow their reference.
        bounds: (lowest, highest) of commanded inputs, by name; inputs without an entry are free.
        q: Weights Q_k of the states.
        r: Weights R of the commanded inputs, in the order of `command`.
        qn_factor: Q_N = qn_factor · Q_k.
        dt: Length of a sample [s].
        horizon: Intervals of the prediction.

    Raises:
        ValueError: if an argument is invalid.
    """

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
        bounds = bounds or {}
        _check_command(model, command, bounds)
        valid.of_length("q", q, len(model.states), "state")
        valid.of_length("r", r, len(command), "commanded input")
        places = tuple(model.inputs.index(name) for name in command)
        lower, upper = zip(*(bounds.get(name, (-np.inf, np.inf)) for name in command))
        structure = Horizon(model, places, dt, horizon, damped=True)
        self._compile(structure, q, r, qn_factor, lower, upper)

    def _compile(self, horizon, q, r, qn_factor, lower, upper):
        """Load the compiled phases and name views of their input arrays."""
        self.problem = horizon
        self.horizon = horizon.N
        lower, upper = np.clip((lower, upper), -MAX_QP_ENTRY, MAX_QP_ENTRY)
        Q = np.array(q)
        self.settings = dict(Q=Q, QN=qn_factor * Q, R=np.array(r), lower=lower, upper=upper)
        # All of the memory is unknown to the problem: predicted states and planned inputs.
        memory = tuple(horizon.memory)
        functions = compiled.load(build_phases, horizon)
        self.iteration = RealTimeIteration(functions, memory, memory, **self.settings)
        arrays = self.iteration.arrays
        n_x = horizon.n_x
        self._inputs = dict(
            x=arrays["s_0"][:n_x],
            p=arrays["s_0"][n_x:],
            x_ref=arrays["x_ref"].reshape((n_x, -1), order="F"),
            u_ref=arrays["u_ref"].reshape((horizon.n_u, -1), order="F"),
        )

    def __repr__(self):
        problem = self.problem
        numbers = {name: np.array2string(value) for name, value in self.settings.items()}
        return (
            f"{type(self).__name__}: {problem.N} intervals of {problem.dt_s:g} s, "
            f"QP {problem.qp or 'by stages'}\n"
            f"  states   {', '.join(problem.model.states)}: Q {numbers['Q']}, QN {numbers['QN']}\n"
            f"  commands {', '.join(problem.model.inputs[place] for place in problem.command)}: "
            f"R {numbers['R']}, bounds {numbers['lower']} to {numbers['upper']}"
        )

    def feedback(self, x: Any, p: Any, x_ref: Any, u_ref: Any) -> Any:
        """Inputs to apply now, by one Gauss-Newton step, eq. (13).

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) desired states; node 0 is now and has no weight.
            u_ref: (n_u, N) desired inputs.

        Returns:
            (n_u,) inputs of the first interval.
        """
        is_first = not self.iteration.started
        self._set_inputs(x=x, p=p, x_ref=x_ref, u_ref=u_ref)
        if is_first:
            self.iteration.improve_first(FIRST_ITERATIONS)
        self.iteration.feedback()
        return self.u_plan[:, 0]

    def solve(self, x: Any, p: Any, x_ref: Any, u_ref: Any, iterations: int = 20) -> Any:
        """Iterate to convergence on the nonlinear problem.

        A Model's steps are shortened by a line search, so that the cost falls, and end once
        `converged`. The paper's controller takes full steps, all of them.

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) desired states.
            u_ref: (n_u, N) desired inputs.
            iterations: Gauss-Newton steps, at most.

        Returns:
            (n_u,) inputs of the first interval.
        """
        self._set_inputs(x=x, p=p, x_ref=x_ref, u_ref=u_ref)
        self.iteration.solve(iterations)
        return self.u_plan[:, 0]

    def _start(self):
        # There is no previous plan: start from a robot that stays where it is.
        x, p = list(self._inputs.values())[:2]
        u = self.iteration.arrays["u_ref"][: self.problem.n_u]
        refuse_unstable_step(self.problem.model, x, u, p, self.problem.dt_s)
        self.iteration.start(init(self.problem, x, p))

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


def _check_command(model, command, bounds):
    """Refuse names that are no inputs, and bounds in the wrong order."""
    if not command:
        raise ValueError(f"command was (); it should name some of {model.inputs}")
    choices = (("command", command, model.inputs), ("bounds", tuple(bounds), command))
    for field, names, allowed in choices:
        if not set(names) <= set(allowed) or len(set(names)) < len(names):
            valid.refuse(f"{field} was", names, f"it should name some of {allowed}, each once")
    for name, (lowest, highest) in bounds.items():
        if not lowest < highest:
            pair = (lowest, highest)
            valid.refuse(f"bounds of {name!r} were", pair, "the first should be below the second")
