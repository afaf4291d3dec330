"""`rhec.RHE` and `rhec.RHC`: estimator and controller of a control loop that a user writes.

With a `model` they are those of that rhec.Model. Without one they make those of the paper's robot,
which are imported then, because a Model needs nothing of that robot. Those know nothing of these
classes, but count as theirs: `isinstance` asks for what both derive from.
"""

from abc import ABCMeta
from typing import TYPE_CHECKING, Any, overload

from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.core.model.robot_model import Model

if TYPE_CHECKING:
    from rhec.tracked_robot import own_loop


class RHE(rhe.RHE, metaclass=ABCMeta):
    """Moving horizon estimation in a user's own loop: `prepare()`, then `feedback(z)`, each sample.

    Args:
        model: The robot, a rhec.Model. None: the paper's robot.
        options: With a model those of `rhec.core.estimator.rhe.RHE`: dt, horizon, sigma_v, sigma_w,
            guess, sigma_guess, arrival_mean, noise_in_window and outliers. Without one those of
            `rhec.tracked_robot.own_loop.RHE`: dt, horizon, process_noise, sigma_w, sigma_v,
            speed_model, slip, arrival_mean, sensors, sigma_gyro, sigma_heading,
            track_width_m, yaw_drift and guess.

    Raises:
        ValueError: If an option is invalid.
    """

    @overload
    def __new__(cls, *, model: Model, **options: Any) -> "RHE": ...

    @overload
    def __new__(cls, *, model: None = None, **options: Any) -> "own_loop.RHE": ...

    def __new__(cls, *, model: Model | None = None, **options: Any) -> Any:
        """An RHE of the model, or of the paper's robot."""
        if cls is not RHE or model is not None:
            return super().__new__(cls)
        from rhec.tracked_robot import own_loop

        return own_loop.RHE(**options)

    @classmethod
    def __subclasshook__(cls, other):
        return issubclass(other, rhe.RHE) if cls is RHE else NotImplemented


class RHC(rhc.RHC, metaclass=ABCMeta):
    """Model predictive control in a user's own loop: `prepare()`, then `feedback(…)`, each sample.

    Args:
        model: The robot, a rhec.Model. None: the paper's robot.
        options: With a model those of `rhec.core.controller.rhc.RHC`: command, q, r, dt, horizon,
            bounds, qn_factor, qn, outputs, q_y, qn_y, r_delta, delta_bounds and terminal_bounds.
            Without one those of `rhec.tracked_robot.own_loop.RHC`: q, r, qn_factor, omega_max, dt,
            horizon and qp.

    Raises:
        ValueError: If an option is invalid.
    """

    @overload
    def __new__(cls, *, model: Model, **options: Any) -> "RHC": ...

    @overload
    def __new__(cls, *, model: None = None, **options: Any) -> "own_loop.RHC": ...

    def __new__(cls, *, model: Model | None = None, **options: Any) -> Any:
        """An RHC of the model, or of the paper's robot."""
        if cls is not RHC or model is not None:
            return super().__new__(cls)
        from rhec.tracked_robot import own_loop

        return own_loop.RHC(**options)

    @classmethod
    def __subclasshook__(cls, other):
        return issubclass(other, rhc.RHC) if cls is RHC else NotImplemented
