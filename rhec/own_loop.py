"""`rhec.RHE` and `rhec.RHC`: estimator and controller of a control loop that a user writes.

With a `model` they are those of that rhec.Model, without one those of the paper's robot.
"""

from typing import TYPE_CHECKING, Any, overload

from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.core.model.base import Model

if TYPE_CHECKING:
    from rhec.tracked_robot import own_loop


@overload
def RHE(*, model: Model, **options: Any) -> rhe.RHE: ...


@overload
def RHE(*, model: None = None, **options: Any) -> "own_loop.RHE": ...


def RHE(*, model: Model | None = None, **options: Any) -> rhe.RHE:
    """Moving horizon estimation in a user's own loop: `prepare()`, then `feedback(z)`, each sample.

    Args:
        model: The robot, a rhec.Model. None: the paper's robot.
        options: With a model those of `rhec.core.estimator.rhe.RHE`: dt, horizon, sigma_v, sigma_w,
            guess, sigma_guess, arrival_mean, noise_in_window and outliers. Without one those of
            `rhec.tracked_robot.own_loop.RHE`: dt, horizon, process_noise, sigma_w, sigma_v,
            speed_model, slip, arrival_mean, sensors, sigma_gyro, sigma_heading,
            track_width_m, yaw_drift and guess.

    Returns:
        An object of that class, whose `help` explains options and methods.

    Raises:
        ValueError: If an option is invalid.
    """
    if model is not None:
        return rhe.RHE(model=model, **options)
    # Imported here, because a Model needs nothing of the paper's robot.
    from rhec.tracked_robot import own_loop

    return own_loop.RHE(**options)


@overload
def RHC(*, model: Model, **options: Any) -> rhc.RHC: ...


@overload
def RHC(*, model: None = None, **options: Any) -> "own_loop.RHC": ...


def RHC(*, model: Model | None = None, **options: Any) -> rhc.RHC:
    """Model predictive control in a user's own loop: `prepare()`, then `feedback(…)`, each sample.

    Args:
        model: The robot, a rhec.Model. None: the paper's robot.
        options: With a model those of `rhec.core.controller.rhc.RHC`: command, q, r, dt, horizon,
            bounds, qn_factor, qn, outputs, q_y, qn_y, r_delta, delta_bounds and terminal_bounds.
            Without one those of `rhec.tracked_robot.own_loop.RHC`: q, r, qn_factor, omega_max, dt,
            horizon and qp.

    Returns:
        An object of that class, whose `help` explains options and methods.

    Raises:
        ValueError: If an option is invalid.
    """
    if model is not None:
        return rhc.RHC(model=model, **options)
    from rhec.tracked_robot import own_loop

    return own_loop.RHC(**options)
