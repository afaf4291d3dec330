"""The estimators of the tracked robot, by name, and what a loop must know of one."""

import importlib
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.tracked_robot import tuning
from rhec.tracked_robot.kinematics import QUANTITIES

__all__ = [
    "NAMES",
    "ROBUST_NAMES",
    "Choice",
    "Estimator",
    "build_phases",
    "build_step",
    "estimator_of",
]


class Choice(NamedTuple):
    """What decides the shape of an estimator of the paper's robot."""

    estimator: str  # one of NAMES, or a serialized Function
    estimation_horizon: int
    speed_model: str
    arrival_mean: str
    robust: bool
    dt_s: float = paper.DT_S

    @classmethod
    def of(cls, scenario):
        """The Choice of a Scenario."""
        name = scenario.estimator
        noise = scenario.process_noise
        noises = tuple(tuning.SIGMA_W.get(name, tuning.ARRIVAL_MEAN))
        if noise not in noises:
            wanted = f"for the estimator {name!r} it should be one of {noises}"
            raise ValueError(f"process_noise was {noise!r}; {wanted}")
        return cls(
            name.serialize() if isinstance(name, ca.Function) else name,
            scenario.estimation_horizon,
            scenario.speed_model,
            scenario.arrival_mean or tuning.ARRIVAL_MEAN[noise],
            scenario.robust,
        )


class Estimator(NamedTuple):
    """What a closed loop, a replay, a study or the C export must know of an estimator.

    Its step is a Function (memory, z_N, settings …) -> (memory, estimate, …), with estimate =
    (x, y, θ, ν, μ, κ); beyond settings it takes by name the `traction` (2,) that it is told, or all
    the `truth` (6,).
    """

    build_step: Callable[[Choice], ca.Function]
    # (choice, guess, sigma), both {quantity: value} -> the first memory, {name: array}
    init: Callable[[Choice, Any, Any], dict]
    settings: Callable[[Any], dict]  # of a Scenario: {name: array}
    build_phases: Callable[[Choice], dict] | None = None  # where its step has the four phases
    states: Callable[[Choice], tuple] = lambda choice: ()  # names that its covariance covers
    n_sigma_w: Callable[[Choice], int] = lambda choice: 0
    given: str = "nothing"  # or "field mean", "true traction", "truth"


# Where each is found, so that nothing here depends on what stands above; and with its
# measurements gated.
_HOME = {
    "rhe": "rhec.tracked_robot.rhe",
    "rhe_fixed_traction": "rhec.tracked_robot.rhe",
    "rhe_no_slip": "rhec.tracked_robot.rhe",
    "ekf": "rhec.tracked_robot.ekf",
    "augmented_ekf": "rhec.tracked_robot.ekf",
    "bounded_ekf": "rhec.tracked_robot.ekf",
    "fixed_traction": "rhec.tracked_robot.ekf",
    "dual": "rhec.extensions.dual",
    "oracle": "rhec.tracked_robot.estimators",
    "traction_oracle": "rhec.tracked_robot.ekf",
}
_ROBUST_HOME = {"rhe": "rhec.extensions.gating", "dual": "rhec.extensions.dual"}
NAMES = tuple(_HOME)
ROBUST_NAMES = tuple(_ROBUST_HOME)


def estimator_of(name, robust=False):
    """The Estimator of this name; for anything else that of a user's own Function."""
    if name not in NAMES:
        return _OWN
    if robust:
        return importlib.import_module(_ROBUST_HOME[name]).ROBUST[name]
    return importlib.import_module(_HOME[name]).ESTIMATORS[name]


def build_step(choice):
    """The step of a Choice's Estimator."""
    return estimator_of(choice.estimator, choice.robust).build_step(choice)


def build_phases(choice):
    """The phases and step of a Choice's Estimator."""
    return estimator_of(choice.estimator, choice.robust).build_phases(choice)


def _build_oracle(choice):
    memory = ca.SX.sym("memory", 6)
    z = ca.SX.sym("z_N", 4)
    truth = ca.SX.sym("truth", 6)
    names = ["memory", "z_N", "truth"], ["memory", "estimate"]
    options = {"allow_duplicate_io_names": True}
    return ca.Function("oracle", [memory, z, truth], [truth, truth], *names, options)


def _init_own(choice, guess, sigma=None):
    """A user's own Function begins with the first guess, then zeros."""
    length = ca.Function.deserialize(choice.estimator).numel_in(0)
    return dict(memory=np.append([*guess.values()][:6], np.zeros(length))[:length])


_OWN = Estimator(
    build_step=lambda choice: ca.Function.deserialize(choice.estimator),
    init=_init_own,
    settings=lambda scenario: dict(V=np.square(tuning.sigma_v_of(scenario)), W=np.zeros(1)),
)
ESTIMATORS = {
    "oracle": Estimator(
        build_step=_build_oracle,
        init=lambda choice, guess, sigma=None: dict(
            memory=np.array([guess[name] for name in QUANTITIES])
        ),
        settings=lambda scenario: {},
        given="truth",
    )
}
