"""A controller of one's own in the place of the paper's, for `Scenario.controller`."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import refuse, shown
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.options import numbers
from rhec.tracked_robot.path import path_of

_ONE = (1, 1)
_MEMORY = "memory"
# What the loop tells a controller besides its memory, by the names of the step's inputs.
_SIGNALS = (
    "s_0",
    "x_ref",
    "u_ref",
    "lower",
    "upper",
    "Q",
    "QN",
    "R",
    "s",
    "covariance",
    "segments",
    "period_m",
    "speed_mps",
    "disturbance",
)
# What a controller may answer besides its next memory; `closed_loop` has defaults for all but one.
_COMMAND = "command"
_RESULTS = (_COMMAND, "kkt", "ok", "speed_mps")


@dataclass(frozen=True, eq=False, repr=False)
class Controller:
    """A controller of one's own: one sample as a CasADi Function, and its first memory.

    The loop finds the inputs of `step` by their names. It may have any of these:

    - `memory`: what it returned as `memory` one sample ago.
    - `s_0`: the estimate (x, y, θ, ν, μ, κ).
    - `x_ref` (3, N+1) and `u_ref` (1, N): desired poses and yaw rates, N = `prediction_horizon`.
    - `lower` and `upper`: bounds of the yaw rate [rad/s].
    - `Q` (3), `QN` (3) and `R`: the Scenario's weights `q`, `qn_factor` · `q` and `r`.
    - `s`: arc length of the path's point closest to the estimate [m].
    - `covariance` (n, n): of the estimator's states; n is 0 where it has none.
    - `segments` (5, M): those of the path, with columns (s, x, y, θ, 1/radius).
    - `period_m`: arc length after which the path repeats itself [m].
    - `speed_mps`: the set speed, negative backwards [m/s].
    - `disturbance`: the yaw rate d that an estimated yaw drift adds to that of the tracks [rad/s];
      0 where the estimator knows none. A step that takes it has to cancel it. For any other step
      the loop does: it moves `lower` and `upper` by d, and takes d off the command.

    It returns `command`, the yaw rate [rad/s], and its next `memory`. It may also return
    `speed_mps`, the speed to drive at instead of the set one, `ok`, whether it solved its problem
    (by default 1), and `kkt`, how well (by default 0).

    Args:
        step: The Function.
        memory: The memory before the first sample, numbers; empty for a step without one.

    Raises:
        ValueError: If names or lengths do not fit; one sentence.
    """

    step: ca.Function
    memory: Sequence[float] = ()

    def __post_init__(self):
        if not isinstance(self.step, ca.Function):
            refuse("step was", self.step, "it should be a CasADi Function")
        memory = numbers(_MEMORY, self.memory)
        if memory.ndim != 1 or not np.isfinite(memory).all():
            refuse("memory was", self.memory, "it should be a sequence of finite numbers")
        object.__setattr__(self, _MEMORY, tuple(memory.tolist()))
        _check_names("input", self.step.name_in(), _SIGNALS)
        _check_names("result", self.step.name_out(), _RESULTS)
        if _COMMAND not in self.step.name_out():
            raise ValueError(f"step has no result {_COMMAND!r}; it should have one")
        _check_sizes("result", _results_of(self.step), dict.fromkeys(_RESULTS, _ONE))
        self._check_memory()
        self._check_storage()

    def _check_memory(self):
        size = (len(self.memory), 1)
        for kind, sizes in (("input", _inputs_of(self.step)), ("result", _results_of(self.step))):
            if self.memory and _MEMORY not in sizes:
                raise ValueError(
                    f"step has no {kind} {_MEMORY!r}; for a first memory of {size[0]} numbers it "
                    "should have one"
                )
            _check_sizes(kind, sizes, {_MEMORY: size})

    def _check_storage(self):
        # A Callback can be written, but not read: no other process could run it.
        try:
            ca.Function.deserialize(self.compared_step.key)
        except RuntimeError:
            refuse("step was", self.step, "it should be made of what CasADi can store")

    @functools.cached_property
    def compared_step(self) -> "Step":
        """The step as the structure of a loop has it."""
        return Step(self.step, self.step.serialize())

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Controller):
            return NotImplemented
        return (self.compared_step, self.memory) == (other.compared_step, other.memory)

    def __hash__(self) -> int:
        return hash((self.compared_step, self.memory))

    def __repr__(self) -> str:
        return f"Controller({self.step.name()!r}, memory of {len(self.memory)})"

    # The text travels, because CasADi may write a Function that it has read in another way.
    def __reduce__(self):
        return _restored, (self.compared_step.key, self.memory)


def _restored(serialized, memory):
    controller = Controller(ca.Function.deserialize(serialized), memory)
    vars(controller)["compared_step"] = Step(controller.step, serialized)
    return controller


class Step:
    """A CasADi Function that equals another one of the same text; Functions alone never do.

    Attributes:
        function: The Function.
        key: Its text, which names compiled code.
    """

    def __init__(self, function, key):
        self.function = function
        self.key = key

    def __eq__(self, other):
        return isinstance(other, Step) and self.key == other.key

    def __hash__(self):
        return hash(self.key)


def own_controller(scenario):
    """The Controller of a Scenario; None where that is the paper's RHC."""
    return scenario.controller if isinstance(scenario.controller, Controller) else None


def check_fits(scenario):
    """Refuse a Scenario's Controller whose inputs have other shapes than the loop's signals."""
    # Imported here, since only those who have a controller of their own need it.
    from rhec.tracked_robot.rhc import horizon_of

    horizon = horizon_of(scenario.prediction_horizon)
    shapes = dict.fromkeys(_SIGNALS, _ONE) | horizon.weights | horizon.references
    shapes |= dict(
        covariance=_shape_of_covariance(scenario), segments=(5, len(path_of(scenario).segments))
    )
    _check_sizes("input", _inputs_of(scenario.controller.step), shapes)


def _shape_of_covariance(scenario):
    estimator = scenario.estimator
    if isinstance(estimator, ca.Function):
        return _results_of(estimator).get("covariance", (0, 0))
    states = estimator_of(estimator).states(Choice.of(scenario))
    return len(states), len(states)


def _inputs_of(step):
    return {name: step.size_in(name) for name in step.name_in()}


def _results_of(step):
    return {name: step.size_out(name) for name in step.name_out()}


def _check_names(kind, names, known):
    for name in names:
        if name not in (_MEMORY, *known):
            raise ValueError(
                f"step has the {kind} {shown(name)}; it should be one of "
                f"{', '.join((_MEMORY, *known))}"
            )


def _check_sizes(kind, sizes, wanted):
    for name, size in sizes.items():
        if name in wanted and size != wanted[name]:
            raise ValueError(
                f"step has the {kind} {name!r} of shape {size}; it should have {wanted[name]}"
            )
