"""A controller of one's own in the place of the paper's, for `Scenario.controller`."""

from dataclasses import dataclass
from typing import ClassVar

from rhec.core.own_step import MEMORY, OwnStep, check_sizes, inputs_of, results_of
from rhec.tracked_robot.estimators import Choice, estimator_of
from rhec.tracked_robot.path import path_of

_ONE = (1, 1)
# What the loop tells a controller besides its memory. A Scenario decides the shapes.
_SIGNALS = """s_0 x_ref u_ref lower upper Q QN R s_m covariance segments period_m speed_mps
    disturbance"""
_COMMAND = "command"


@dataclass(frozen=True, eq=False, repr=False)
class Controller(OwnStep):
    """A controller of one's own: one sample as a CasADi Function, and its first memory.

    The loop finds the inputs of `step` by their names. It may have any of these:

    - `memory`: what it returned as `memory` one sample ago.
    - `s_0`: the estimate (x, y, θ, ν, μ, κ), the joint state of node 0.
    - `x_ref` (3, N+1) and `u_ref` (1, N): desired poses and yaw rates, N = `prediction_horizon`.
    - `lower` and `upper`: bounds of the yaw rate [rad/s].
    - `Q` (3), `QN` (3) and `R`: the Scenario's weights `q`, `qn_factor` · `q` and `r`.
    - `s_m`: arc length of the path's point closest to the estimate [m].
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

    # The loop has defaults for all results but the command.
    signals: ClassVar[dict] = dict.fromkeys(_SIGNALS.split())
    results: ClassVar[dict] = dict.fromkeys((_COMMAND, "kkt", "ok", "speed_mps"), _ONE)

    def __post_init__(self):
        super().__post_init__()
        if _COMMAND not in self.step.name_out():
            raise ValueError(f"step has no result {_COMMAND!r}; it should have one")
        size = (len(self.memory), 1)
        for role, sizes in (("input", inputs_of(self.step)), ("result", results_of(self.step))):
            if self.memory and MEMORY not in sizes:
                raise ValueError(
                    f"step has no {role} {MEMORY!r}; for a first memory of {size[0]} numbers it "
                    "should have one"
                )
            check_sizes(role, sizes, {MEMORY: size})


def check_fits(scenario):
    """Refuse a Scenario's Controller whose inputs have other shapes than the loop's signals."""
    # Imported here, since only those who have a controller of their own need it.
    from rhec.tracked_robot.paper_rhc import problem_of_scenario

    stages = problem_of_scenario(scenario).stages
    states = estimator_of(scenario.estimator).states(Choice.of(scenario))
    shapes = dict.fromkeys(Controller.signals, _ONE) | stages.weights | stages.data
    shapes |= dict(
        covariance=(len(states), len(states)), segments=(5, len(path_of(scenario).segments))
    )
    check_sizes("input", inputs_of(scenario.controller.step), shapes)
