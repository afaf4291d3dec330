"""The registry of the tracked robot's estimators, by the name that a Scenario gives them."""

from typing import Literal, get_args

import casadi as ca
import numpy as np

from rhec.tracked_robot import filters, rhe, tuning
from rhec.tracked_robot.choice import Estimator, TractionInput
from rhec.tracked_robot.kinematics import QUANTITIES

# In the order of menus and messages.
EstimatorName = Literal[
    "rhe",
    "rhe_fixed_traction",
    "rhe_no_slip",
    "ekf",
    "augmented_ekf",
    "bounded_ekf",
    "fixed_traction",
    "yaw_drift_ekf",
    "oracle",
    "traction_oracle",
    "drift_oracle",
]
NAMES = get_args(EstimatorName)


def _build_oracle(choice):
    """An estimator whose estimate is the true state."""
    memory = ca.SX.sym("memory", 6)
    z = ca.SX.sym("z_N", 4)
    truth = ca.SX.sym("truth", 6)
    names = ["memory", "z_N", "truth"], ["memory", "estimate"]
    options = {"allow_duplicate_io_names": True}
    return ca.Function("oracle", [memory, z, truth], [truth, truth], *names, options)


_ORACLE = Estimator(
    build_step=_build_oracle,
    init=lambda choice, guess, sigma=None: dict(
        memory=np.array([guess[name] for name in QUANTITIES])
    ),
    settings=lambda scenario: {},
    traction_input=TractionInput.FULL_STATE,
)


def _init_user_function(choice, guess, sigma=None):
    """The memory of a user's Function begins with the first guess, followed by zeros."""
    length = ca.Function.deserialize(choice.estimator).numel_in(0)
    return dict(memory=np.append([*guess.values()][:6], np.zeros(length))[:length])


_USER_FUNCTION = Estimator(
    build_step=lambda choice: ca.Function.deserialize(choice.estimator),
    init=_init_user_function,
    settings=lambda scenario: dict(V=np.square(tuning.sigma_v_of(scenario)), W=np.zeros(1)),
)

_ESTIMATORS = rhe.ESTIMATORS | filters.ESTIMATORS | {"oracle": _ORACLE}


def estimator_of(name):
    """The Estimator of a name; any name that is not in NAMES stands for a user's Function."""
    return _ESTIMATORS.get(name, _USER_FUNCTION)


def build_step(choice):
    """Build the step of a Choice's Estimator."""
    return estimator_of(choice.estimator).build_step(choice)
