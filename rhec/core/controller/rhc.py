"""Nonlinear receding horizon control (model predictive control, MPC), eq. (12).

    min  ½ Σ_{i=1..N-1} ‖x_r,i - x_i‖²_{Q_k} + ½ ‖x_r,N - x_N‖²_{Q_N}
         + ½ Σ_{i=0..N-1} ‖u_r,i - u_i‖²_R
    s.t. x_0 = x̂, x_{i+1} = F(x_i, u_i, p̂), lower ≤ u_i ≤ upper        eq. (11), (16)

`stages` has that as one list of quantities, which a user may extend. Everything that does not
depend on the newest sample belongs to the preparation phase. The estimate (x̂, p̂) and the
references enter in the feedback phase only: they move the gradient, through the linearised dynamics
of the joint state s = (x, p).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from pydantic import SkipValidation

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core.controller.bounds import Bound
from rhec.core.controller.initial_plan import checked_plan, planned_memory
from rhec.core.controller.phases import build_phases, init
from rhec.core.controller.problem import Options, problem_of
from rhec.core.model.integration import refuse_unstable_step
from rhec.core.model.known import checked_known
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE
from rhec.core.model.robot_model import Model
from rhec.core.solver.rti import RealTimeIteration, RealTimeLoop, copy_checked

FIRST_ITERATIONS = 100  # at most, on the first sample, for which there is no previous plan

# Not checked by pydantic: `options` checks them, and says more.
Weights = SkipValidation[tuple[float, ...] | np.ndarray]
OptionalWeights = SkipValidation[tuple[float, ...] | np.ndarray | None]
Bounds = SkipValidation[dict[str, tuple[float, float] | Bound] | None]
OutputsByName = SkipValidation[tuple[str, ...] | dict[str, Callable] | None]


class RHC(RealTimeLoop):
    """Model predictive control for a user's control loop: `prepare()`, then `feedback(…)`.

    Args:
        model: The robot, a rhec.Model.
        command: Names of the inputs that are commanded; the others follow their reference. None:
            all inputs.
        q: Weights Q of the states, or the matrix Q (n_x, n_x).
        r: Weights R of the commanded inputs, in the order of `command`, or the matrix R. 0 is
            allowed where other weights decide the command.
        dt: Length of a sample [s].
        horizon: Intervals N of the prediction.
        bounds: (lowest, highest) or a rhec.Bound of commanded inputs, states and outputs, by name;
            what has no entry is free, but for the model's `state_bounds`. States are bounded from
            the next sample on. Bounds of commands are always kept. Where other hard ones cannot
            be, the plan exceeds them by as little as it can, and `ok` is False.
        qn_factor: Q_N = qn_factor · Q, for states and outputs.
        qn: Weights Q_N of the states at the end of the horizon, instead of qn_factor · Q.
        outputs: Quantities that are weighed or bounded: names of the model's outputs, or a dict
            {name: function of (x, u, p)} with a CasADi expression as its result.
        q_y: Weights of the outputs, or a matrix. By default 0.
        qn_y: Weights of the outputs at the end of the horizon, instead of qn_factor · q_y.
        r_delta: Weights of the changes u_i - u_{i-1} of the commanded inputs, or a matrix. Before
            the first sample the commands were 0, or the nearest number within their bounds, unless
            `feedback` or `restart` says `u_before`.
        delta_bounds: Bounds of the changes, by the name of the commanded input.
        terminal_bounds: Bounds of states and outputs at the horizon's end, instead of `bounds`.

    Raises:
        ValueError: If an argument is invalid.
    """

    _unsolved = "the QP was not solved; the plan before goes on"
    _initial: tuple | None = None  # the plan (u, x) that `restart` was given
    _before: np.ndarray | None = None  # the commands before the first sample, as `restart` was told

    @valid.checked
    def __init__(
        self,
        *,
        model: Model,
        command: valid.Names | None = None,
        q: Weights,
        r: Weights,
        dt: valid.Positive,
        horizon: valid.Intervals,
        bounds: Bounds = None,
        qn_factor: valid.NotNegative = 1.0,
        qn: OptionalWeights = None,
        outputs: OutputsByName = None,
        q_y: OptionalWeights = None,
        qn_y: OptionalWeights = None,
        r_delta: OptionalWeights = None,
        delta_bounds: Bounds = None,
        terminal_bounds: Bounds = None,
    ):
        weights = dict(q=q, r=r, qn_factor=qn_factor, qn=qn, q_y=q_y, qn_y=qn_y, r_delta=r_delta)
        limits = dict(bounds=bounds, delta_bounds=delta_bounds, terminal_bounds=terminal_bounds)
        command = model.inputs if command is None else command
        given = dict(model=model, command=command, dt=dt, horizon=horizon, outputs=outputs)
        self._options = Options(**given, **weights, **limits)
        self._load(self._problem_of(self._options))

    def _problem_of(self, options):
        """The Problem that the Options describe."""
        return problem_of(options)

    def _load(self, problem):
        """Load the compiled phases of a Problem, and name views of their input arrays."""
        stages = self.stages = problem.stages
        self.horizon = stages.N
        self.settings = problem.settings
        functions = compiled.load(build_phases, stages)
        self.iteration = RealTimeIteration(
            functions, tuple(stages.memory), tuple(stages.unknowns), **self.settings
        )
        arrays = self.iteration.arrays
        self._inputs = dict(x=arrays["s_0"][: stages.n_x], p=arrays["s_0"][stages.n_x :])
        self._inputs |= {
            name: arrays[name].reshape(shape, order="F")
            for name, shape in stages.references.items()
            if name != "s_0"
        }
        # What is known acts like an input that is not commanded, and follows its reference.
        n_u = len(stages.model.inputs)
        self._known = self._inputs["u_ref"][n_u:]
        self._known[:] = np.nan
        self._inputs |= dict(u_ref=self._inputs["u_ref"][:n_u], known=self._known)

    def first_memory(self, x: Any, p: Any) -> dict:
        """The memory before the first sample: the robot stays at x, and nothing is planned.

        Args:
            x: (n_x,) state.
            p: (n_p,) parameters.

        Returns:
            The memory's arrays by name.
        """
        return init(self.stages, x, p, self.settings)

    def restart(self, u_plan: Any = None, x_plan: Any = None, u_before: Any = None) -> None:
        """Begin anew: the next sample is the first, and improves this plan.

        Without a plan it starts from a robot that stays where it is, with commands of 0, or the
        nearest number within their bounds. References are 0 until they are given again.

        Args:
            u_plan: (n_u, N) or (n_u,) planned inputs. Commands beyond a bound begin at it, and
                inputs that are not commanded follow `u_ref`.
            x_plan: (n_x, N+1) or (n_x,) predicted states, which need not follow from the inputs;
                node 0 gets the state of the sample. None: those to which the inputs lead.
            u_before: (n_u,) inputs before the next sample, from which the changes are counted.

        Raises:
            ValueError: If an argument has another shape, or an entry that is no number.
        """
        before = self._commands_before(u_before)
        self._initial = checked_plan(self.stages, u_plan, x_plan)
        self._before = before
        for name in ("x_ref", "y_ref"):
            if name in self._inputs:
                self._inputs[name][:] = 0
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
        fields = self._options._fields
        unknown = [name for name in changes if name not in fields]
        if unknown:
            valid.refuse("update had", unknown[0], f"it may have {fields}")
        options = self._options._replace(**changes)
        problem = self._problem_of(options)
        if problem.stages != self.stages:
            raise ValueError(
                f"update had {', '.join(changes)}, which changes what is weighed or bounded; that "
                "needs a new rhec.RHC"
            )
        self._options = options
        self.settings = problem.settings
        self.iteration.set(self.iteration.arrays, self.settings)

    @property
    def status(self) -> str:
        """Why the last step was not `ok`, as a sentence; empty if it was."""
        for name, excess in zip(self.stages.soft_names, self.iteration.arrays.get("excess", ())):
            if excess:
                return f"the bounds of {name} cannot be kept; the plan exceeds them by {excess:.3g}"
        return super().status

    @property
    def bounds(self) -> dict:
        """Bounds by name, as they were given last."""
        return dict(self._options.bounds or {})

    def __repr__(self):
        stages = self.stages
        commands = ", ".join(stages.model.inputs[place] for place in stages.command)
        qp = stages.qp or ("by interior point" if stages.is_general else "by active set")
        head = f"{type(self).__name__}: {stages.N} intervals of {stages.dt_s:g} s, QP {qp}"
        states = f"  states   {', '.join(stages.model.states)}"
        if stages.is_general:
            outputs = ", ".join(stages.outputs.names) or "none"
            return f"{head}\n{states}\n  outputs  {outputs}\n  commands {commands}"
        numbers = {name: np.array2string(value) for name, value in self.settings.items()}
        return (
            f"{head}\n{states}: Q {numbers['Q']}, QN {numbers['QN']}\n"
            f"  commands {commands}: "
            f"R {numbers['R']}, bounds {numbers['lower']} to {numbers['upper']}"
        )

    def feedback(
        self,
        x: Any,
        p: Any = (),
        x_ref: Any = None,
        u_ref: Any = 0.0,
        y_ref: Any = None,
        u_before: Any = None,
        known: Any = None,
    ) -> Any:
        """Inputs to apply now, by one Gauss-Newton step, eq. (13).

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: (n_x, N+1) desired states; node 0 is now and has no weight. Or (n_x,), if they
                are the same at all nodes, or one number for all. None: the last ones, at first 0.
            u_ref: (n_u, N), (n_u,) or one desired input. Inputs that are not commanded are expected
                to follow it, such as known signals. Where an entry is not finite, the last plan
                goes on, and `ok` is False.
            y_ref: (n_y, N+1), (n_y,) or one desired output; None: the last ones, at first 0.
            u_before: (n_u,) inputs that were applied in the interval before, from which changes are
                counted. None, or an entry that is not finite: the first ones of the last plan.
            known: {name: number, or (N,) numbers} of the Model's known signals in the intervals of
                the horizon; what is not given, or is not finite, is as at the last sample.

        Returns:
            (n_u,) inputs of the first interval.

        Raises:
            ValueError: If an argument has another shape.
        """
        is_first = not self.iteration.started
        self._set_problem(x, p, x_ref, u_ref, y_ref, u_before, known)
        if is_first:
            self.iteration.improve_first(FIRST_ITERATIONS)
        self.iteration.feedback()
        return self.u_plan[:, 0]

    def solve(
        self,
        x: Any,
        p: Any = (),
        x_ref: Any = None,
        u_ref: Any = 0.0,
        iterations: int = 20,
        y_ref: Any = None,
        u_before: Any = None,
        known: Any = None,
    ) -> Any:
        """Iterate to convergence on the nonlinear problem.

        Steps are shortened, by a line search or, with constraints, by what the last two steps have
        shown and by a merit of cost, hard bounds and dynamics. They end once `converged`.

        Args:
            x: (n_x,) estimated state.
            p: (n_p,) estimated parameters.
            x_ref: Desired states, as in `feedback`.
            u_ref: Desired inputs, as in `feedback`.
            iterations: Gauss-Newton steps, at most.
            y_ref: Desired outputs, as in `feedback`.
            u_before: Inputs of the interval before, as in `feedback`.
            known: Known signals, as in `feedback`.

        Returns:
            (n_u,) inputs of the first interval.

        Raises:
            ValueError: If an argument has another shape.
        """
        self._set_problem(x, p, x_ref, u_ref, y_ref, u_before, known)
        self.iteration.solve(iterations)
        return self.u_plan[:, 0]

    def _set_problem(self, x, p, x_ref, u_ref, y_ref, u_before, known):
        """Copy the new data in; references that are constant are repeated along the horizon."""
        known = checked_known(self.stages.model.known, known, self._known)
        before = self._before if u_before is None else self._commands_before(u_before)
        given = dict(x=x, p=p, u_ref=u_ref)
        given |= {k: v for k, v in dict(x_ref=x_ref, y_ref=y_ref).items() if v is not None}
        if "y_ref" in given and "y_ref" not in self._inputs:
            valid.refuse("y_ref was", y_ref, "it should be None, since there are no outputs")
        for name, value in given.items():
            array = self._inputs[name]
            if array.ndim == 2 and np.shape(value) in ((), array.shape[:1]):
                given[name] = np.broadcast_to(np.reshape(value, (-1, 1)), array.shape)
        self._set_inputs(**given, known=known)
        if self.stages.model.heading is not None:
            self._take_up_to_turns()
        if before is not None:
            is_number = np.abs(before) <= MAX_PLAUSIBLE_STATE
            np.copyto(self.iteration.current["before"], before, where=is_number)
            self._before = None

    def _take_up_to_turns(self):
        """Add full turns to the heading and its references, so that they follow on each other.

        The heading is then near the plan's, its first reference near it, and each of the others
        near the one before.
        """
        place = self.stages.model.states.index(self.stages.model.heading)
        x = self._inputs["x"]
        planned = self.iteration.current["s"][place]  # of node 0
        x[place] += 2 * np.pi * np.round((planned - x[place]) / (2 * np.pi))
        wanted = self._inputs["x_ref"][place]
        wanted[:] = np.unwrap([x[place], *wanted])[1:]

    def _set_inputs(self, **values):
        try:
            super()._set_inputs(**values)
        except ValueError as error:
            if not any(self._has_other_horizon(*each) for each in values.items()):
                raise
            hint = f"the controller's horizon is {self.horizon}, and a PathTracker's must be, too"
            raise ValueError(f"{error}; {hint}") from None

    def _has_other_horizon(self, name, value):
        """Whether a reference has a row for each quantity, but another number of columns."""
        try:
            rows, *columns = np.shape(value) or (0,)
        except ValueError:  # rows of unequal lengths
            return False
        wanted = self._inputs[name].shape
        return len(wanted) == 2 and rows == wanted[0] and columns not in ([], [wanted[1]])

    def _commands_before(self, u_before):
        """The commands (n_c,) among the inputs (n_u,) that were applied before, or None."""
        if u_before is None:
            return None
        if not self.stages.has_changes:
            expected = "it should be None, since changes have neither weights nor bounds"
            valid.refuse("u_before was", u_before, expected)
        u = np.zeros(len(self.stages.model.inputs))
        copy_checked("u_before", u_before, u)
        return u[list(self.stages.command)]

    def _start(self):
        # There is no previous plan: start from a given one, or a robot that stays where it is.
        # By their places, because a subclass may have other names for them.
        x, p = list(self._inputs.values())[:2]
        u_ref = self.iteration.arrays["u_ref"][: self.stages.n_u]
        u = np.where(np.isfinite(u_ref), u_ref, 0.0)
        refuse_unstable_step(self.stages.model, x, u, p, self.stages.dt_s)
        memory = self.first_memory(x, p)
        memory["u"][len(self.stages.model.inputs) :] = self._known
        if self._initial:
            # The bounds of commands are the first of all.
            bounds = (self.settings[name][: self.stages.n_c] for name in ("lower", "upper"))
            planned = planned_memory(self.stages, self._initial, *bounds, x, p, self._known)
            memory |= planned
        self.iteration.start(memory)

    @property
    def u_plan(self) -> np.ndarray:
        """Planned inputs (n_u, N)."""
        u = self.iteration.arrays["u_plan"].reshape((self.stages.n_u, -1), order="F")
        return u[: len(self.stages.model.inputs)].copy()

    @property
    def x_plan(self) -> np.ndarray:
        """Predicted states (n_x, N+1)."""
        # The states are not needed for the command, so feedback leaves them to expand.
        self.iteration.expand()
        s = self.iteration.previous["s"].reshape((self.stages.n_s, -1), order="F")
        return s[: self.stages.n_x].copy()
