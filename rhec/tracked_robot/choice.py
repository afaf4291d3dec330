"""The records that describe an estimator of the tracked robot to those who run one."""

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from rhec import paper
from rhec.tracked_robot import tuning

# What an estimator may be told, by the names of the loop's signals: the mean traction (μ, κ) of the
# field, which one may know; the true one, and the true state, which no robot knows.
TOLD = dict(mean_traction=(2, 1), traction=(2, 1), yaw_drift=(1, 1), truth=(6, 1))


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
        noises = tuple(tuning.noises_of(tuning.name_of_noise(scenario)))
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
    (x, y, θ, ν, μ, κ). Beyond its settings the step may have inputs of TOLD.
    """

    build_step: Callable[[Choice], ca.Function]
    # (choice, guess, sigma), both {quantity: value} -> the first memory, {name: array}
    init: Callable[[Choice, Any, Any], dict]
    settings: Callable[[Any], dict]  # of a Scenario: {name: array}
    build_phases: Callable[[Choice], dict] | None = None  # where its step has the four phases
    states: Callable[[Choice], tuple] = lambda choice: ()  # names that its covariance covers
    n_sigma_w: Callable[[Choice], int] = lambda choice: 0
    told: tuple[str, ...] = ()  # names of TOLD that its step takes
    # Names of the sensors that it reads besides GNSS and encoders; None: all that the robot has.
    sensors: tuple[str, ...] | None = ()
    takes_yaw_drift: bool = False  # whether a Scenario's `yaw_drift` may be True
    # whether its step has a result `yaw_drift`
    has_yaw_drift: Callable[[Choice], bool] = lambda choice: False
