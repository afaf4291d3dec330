"""What an estimator of the tracked robot is to those who run one."""

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

# What an estimator may be told, by the names of the loop's signals: the mean traction (μ, κ) of the
# field, which one may know; the true one, and the true state, which no robot knows.
TOLD = dict(mean_traction=(2, 1), traction=(2, 1), yaw_drift=(1, 1), truth=(6, 1))


class EstimatorRecord(NamedTuple):
    """What a closed loop, a replay, a study or the C export must know of an estimator.

    Its functions take a Choice (`rhec.tracked_robot.estimators`). Its step is a Function (memory,
    z_N, settings …) -> (memory, estimate, …), with estimate = (x, y, θ, ν, μ, κ). Beyond its
    settings the step may have inputs of TOLD.
    """

    build_step: Callable[[Any], ca.Function]
    # (choice, guess, sigma), both {quantity: value} -> the first memory, {name: array}
    init: Callable[[Any, Any, Any], dict]
    settings: Callable[[Any], dict]  # of a Scenario: {name: array}
    build_phases: Callable[[Any], dict] | None = None  # where its step has the four phases
    states: Callable[[Any], tuple] = lambda choice: ()  # names that its covariance covers
    n_sigma_w: Callable[[Any], int] = lambda choice: 0
    told: tuple[str, ...] = ()  # names of TOLD that its step takes
    # Names of the sensors that it reads besides GNSS and encoders; None: all that the robot has.
    sensors: tuple[str, ...] | None = ()
    takes_yaw_drift: bool = False  # whether a Scenario's `yaw_drift` may be True
    # whether its step has a result `yaw_drift`
    has_yaw_drift: Callable[[Any], bool] = lambda choice: False
