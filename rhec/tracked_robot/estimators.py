"""The registry of the tracked robot's estimators, by the name that a Scenario gives them."""

from typing import Literal, get_args

import casadi as ca
import numpy as np

from rhec.tracked_robot import filters, rhe
from rhec.tracked_robot.choice import EstimatorRecord, TractionInput
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


_ORACLE = EstimatorRecord(
    build_step=_build_oracle,
    init=lambda choice, guess, sigma=None: dict(
        memory=np.array([guess[name] for name in QUANTITIES])
    ),
    settings=lambda scenario: {},
    traction_input=TractionInput.FULL_STATE,
)


_ESTIMATORS = rhe.ESTIMATORS | filters.ESTIMATORS | {"oracle": _ORACLE}


def estimator_of(estimator):
    """The Estimator of a name; one of the user's own brings it along."""
    return _ESTIMATORS[estimator] if isinstance(estimator, str) else estimator.row


def build_step(choice):
    """Build the step of a Choice's Estimator."""
    return estimator_of(choice.estimator).build_step(choice)
