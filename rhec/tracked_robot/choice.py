"""The records that describe an estimator of the tracked robot to those who run one."""

from collections.abc import Callable
from enum import Enum
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.tracked_robot import tuning


class TractionInput(Enum):
    """What an estimator is passed of the true traction coefficients (μ, κ)."""

    NONE = "nothing"
    FIELD_MEAN = "field mean"
    TRUE = "true traction"
    TRUE_WITH_DRIFT = "true traction and yaw drift"
    FULL_STATE = "truth"  # pose and speed, too

    def select_traction(self, field_mean, true, true_with_drift=None):
        """The traction (μ, κ) that the estimator is passed: the field's mean or the true one.

        The true one may have the yaw drift as a third entry. An estimator that is passed neither
        gets (1, 1), no slip.
        """
        passed = {
            TractionInput.FIELD_MEAN: field_mean,
            TractionInput.TRUE: true,
            TractionInput.TRUE_WITH_DRIFT: true_with_drift,
        }
        return passed.get(self, np.ones(2))


class Choice(NamedTuple):
    """The parameters of a Scenario that decide the shape of its estimator's Functions."""

    estimator: Any  # one of `estimators.NAMES`, or an own_estimator.Estimator
    estimation_horizon: int
    speed_model: str
    arrival_mean: str
    dt_s: float = paper.DT_S
    sensors: tuple[str, ...] = ()
    yaw_drift: bool = False

    @classmethod
    def of(cls, scenario):
        """Make the Choice of a Scenario.

        Raises:
            ValueError: if the estimator is not tuned for the scenario's process noise.
        """
        name = scenario.estimator
        noise = scenario.process_noise
        noises = tuple(tuning.NOISES.get(tuning.name_of_noise(scenario), {}))
        if noises and noise is not None and noise not in noises:
            expected = f"for the estimator {name!r} it should be None or one of {noises}"
            raise ValueError(f"process_noise was {noise!r}; {expected}")
        return cls(
            name,
            scenario.estimation_horizon,
            scenario.speed_model,
            scenario.arrival_mean,
            sensors=scenario.sensors,
            yaw_drift=scenario.yaw_drift,
        )


class EstimatorRecord(NamedTuple):
    """What a closed loop, a replay, a study or the C export must know of an estimator.

    Its step is a Function (memory, z_N, settings …) -> (memory, estimate, …), with estimate =
    (x, y, θ, ν, μ, κ). Beyond its settings the step may have an input `traction` (2,) or
    `truth` (6,), which `traction_input` describes.
    """

    build_step: Callable[[Choice], ca.Function]
    # (choice, guess, sigma), both {quantity: value} -> the first memory, {name: array}
    init: Callable[[Choice, Any, Any], dict]
    settings: Callable[[Any], dict]  # of a Scenario: {name: array}
    build_phases: Callable[[Choice], dict] | None = None  # where its step has the four phases
    states: Callable[[Choice], tuple] = lambda choice: ()  # names that its covariance covers
    n_sigma_w: Callable[[Choice], int] = lambda choice: 0
    traction_input: TractionInput = TractionInput.NONE
    takes_yaw_drift: bool = False  # whether a Scenario's `yaw_drift` may be True
    # whether its step has a result `yaw_drift`
    has_yaw_drift: Callable[[Choice], bool] = lambda choice: False
