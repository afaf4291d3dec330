"""An estimator of one's own in the place of the paper's, for `Scenario.estimator`."""

import functools
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from rhec.core.own_step import MEMORY, OwnStep, check_sizes, inputs_of, results_of
from rhec.tracked_robot import choice, tuning
from rhec.tracked_robot.kinematics import QUANTITIES

_ONE = (1, 1)
_INPUTS = MEMORY, "z_N"
_RESULTS = MEMORY, "estimate"


@dataclass(frozen=True, eq=False, repr=False)
class Estimator(OwnStep):
    """An estimator of one's own: one sample as a CasADi Function, and its first memory.

    The first two inputs of `step` are its memory and the measurement z = (x, y, ν, ω), its first
    two results the next memory and the estimate (x, y, θ, ν, μ, κ), whatever they are called. What
    it may have besides goes by name. It may take

    - `V` (4): the variances of the measurement noise, from the Scenario's `sigma_v`,
    - `truth` (6): the true (x, y, θ, ν, μ, κ), which no recorded log and no robot has,

    and it may return

    - `covariance` (n, n): of its states, which a controller may take,
    - `accepted` (4): whether it used each entry of z (by default, each valid one),
    - `ok`: whether it solved its problem (by default 1), and `kkt`, how well (by default NaN),
    - `deviance`, of the innovation, and `restart`, whether it began anew, for the log.

    Args:
        step: The Function.
        memory: The first memory, numbers, behind the first guess of the estimate, with which it
            begins; numbers that are left out are 0.

    Raises:
        ValueError: If names or lengths do not fit; one sentence.
    """

    signals: ClassVar[dict] = dict(z_N=(4, 1), V=(4, 1), truth=(6, 1))
    results: ClassVar[dict] = dict(estimate=(6, 1), covariance=None, accepted=(4, 1), ok=_ONE)
    results |= dict(kkt=_ONE, deviance=_ONE, restart=_ONE)

    def __post_init__(self):
        if isinstance(self.step, ca.Function):
            object.__setattr__(self, "step", _named(self.step))
        super().__post_init__()
        size = self.step.size_in(MEMORY)
        check_sizes("input", {MEMORY: size}, {MEMORY: (size[0], 1)})
        check_sizes("result", results_of(self.step), {MEMORY: size})
        room = max(0, size[0] - len(QUANTITIES))
        if len(self.memory) > room:
            raise ValueError(
                f"memory had {len(self.memory)} numbers; behind the first guess the memory of step "
                f"has room for {room}"
            )

    @functools.cached_property
    def row(self):
        """What a loop must know of it."""
        n, _ = results_of(self.step).get("covariance", (0, 0))
        has_truth = "truth" in inputs_of(self.step)
        return choice.EstimatorRecord(
            build_step=lambda choice: self.step,
            init=self._init,
            settings=lambda scenario: dict(V=np.square(tuning.sigma_v_of(scenario))),
            states=lambda choice: tuple(f"state {k}" for k in range(n)),
            told=("truth",) if has_truth else (),
        )

    def _init(self, choice, guess, sigma=None):
        length = self.step.numel_in(MEMORY)
        begin = [*guess.values()][: len(QUANTITIES)]
        return {MEMORY: np.concatenate([begin, self.memory, np.zeros(length)])[:length]}


def _named(step):
    """A step whose first two inputs and results have the names of the robot's estimators."""
    if step.n_in() < 2 or step.n_out() < 2:
        raise ValueError(
            f"step had {step.n_in()} inputs and {step.n_out()} results; it should have a memory "
            "and a measurement, and the next memory and an estimate"
        )
    inputs = step.mx_in()
    names = [*_INPUTS, *step.name_in()[2:]], [*_RESULTS, *step.name_out()[2:]]
    options = {"allow_duplicate_io_names": True}
    return ca.Function(step.name(), inputs, step.call(inputs), *names, options)
