"""The tracked robot's estimators, by the name that a Scenario gives them, and what it chooses."""

from typing import Any, Literal, NamedTuple, get_args

import casadi as ca

from rhec import paper
from rhec.tracked_robot import filters, paper_rhe, tuning
from rhec.tracked_robot.kinematics import OUTPUTS
from rhec.tracked_robot.own_estimator import Estimator

# In the order of menus and messages.
EstimatorName = Literal["rhe", "ekf", "bounded_ekf", "oracle"]
NAMES = get_args(EstimatorName)


class Choice(NamedTuple):
    """The parameters of a Scenario that decide the shape of its estimator's Functions."""

    estimator: Any  # one of NAMES, or an own_estimator.Estimator
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


def _oracle_step(sensors=()):
    """The step of an estimator whose estimate is the true state, of a robot with these sensors."""
    memory = ca.SX.sym("memory", 6)
    z = ca.SX.sym("z_N", len(OUTPUTS) + len(sensors))
    truth = ca.SX.sym("truth", 6)
    names = ["memory", "z_N", "truth"], ["memory", "estimate"]
    options = {"allow_duplicate_io_names": True}
    return ca.Function("oracle", [memory, z, truth], [truth, truth], *names, options)


_ORACLE = Estimator(_oracle_step()).row._replace(
    build_step=lambda choice: _oracle_step(choice.sensors), sensors=None
)
_ESTIMATORS = paper_rhe.ESTIMATORS | filters.ESTIMATORS | {"oracle": _ORACLE}


def estimator_of(estimator):
    """The EstimatorRecord of a name; one of the user's own brings it along."""
    return _ESTIMATORS[estimator] if isinstance(estimator, str) else estimator.row


def states_of(scenario):
    """Names of what the covariance of a Scenario's estimator covers, in its order."""
    choice = Choice.of(scenario)
    return tuple(estimator_of(choice.estimator).states(choice))


def build_step(choice):
    """Build the step of a Choice's Estimator."""
    return estimator_of(choice.estimator).build_step(choice)
