"""Estimators with the yaw drift δ [rad/m] as one more state. Not in the paper.

The paper's model turns by its yaw rate alone. On soil that differs between the tracks the robot
also turns on a straight, in proportion to the way that it goes (left and right slip, or the lateral
offset of the instantaneous centre of rotation; Pentzer, Brennan and Reichard, 2014):

    θ̇ = κω + μνδ,  δ = (μ_r - μ_l) / (b μ)

δ is estimated like the traction, as a random walk, but without bounds. The steps have one result
more than other estimators: `yaw_drift`, by which the controller corrects its command
(`rhec.tracked_robot.yaw_disturbance`). An oracle, an EKF of the pose that is passed the true
(μ, κ, δ), shows what is left to gain.
"""

import casadi as ca
import numpy as np

from rhec.core.estimator import rhe
from rhec.core.model.base import Model, rk4
from rhec.tracked_robot import ekf, tuning
from rhec.tracked_robot import rhe as paper_rhe
from rhec.tracked_robot.choice import Estimator, TractionInput
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f_with_drift, h

_WITHOUT_DRIFT = SPEED_MODELS["parameter"].model
STATES = (*QUANTITIES, "yaw_drift_radpm")
# At the start the yaw drift is unknown: 0.05 rad/m are two per cent of slip between the tracks.
_SIGMA_START = paper_rhe.SIGMA_START | dict(yaw_drift_radpm=0.05)


MODEL = Model(
    states=_WITHOUT_DRIFT.states,
    inputs=_WITHOUT_DRIFT.inputs,
    parameters=_WITHOUT_DRIFT.parameters | dict(yaw_drift_radpm=None),
    outputs=_WITHOUT_DRIFT.outputs,
    f=f_with_drift,
    h=h,
    max_measurement=_WITHOUT_DRIFT.limits,
)


def _with_drift_apart(name, step):
    """A step whose estimate has seven entries, with the last one as the result `yaw_drift`."""
    inputs = step.mx_in()
    results = dict(zip(step.name_out(), step.call(inputs)))
    results["estimate"], results["yaw_drift"] = ca.vertsplit(results["estimate"], [0, 6, 7])
    options = {"allow_duplicate_io_names": True}
    names = step.name_in(), [*results]
    return ca.Function(name, inputs, [*results.values()], *names, options)


def _build_ekf_step(choice):
    step = ekf.build_joint_step(MODEL, choice.dt_s, bounded=True)
    return _with_drift_apart("yaw_drift_ekf", step)


def _move_with_drift(m, omega, traction, dt_s):
    """The pose and speed m one interval later, on soil of which (μ, κ, δ) are known."""
    return ca.vertcat(rk4(f_with_drift, m[:3], omega, ca.vertcat(m[3], traction), dt_s), m[3])


def _build_oracle_step(choice):
    step = ekf.build_step(choice.dt_s, _move_with_drift, n_traction=3)
    return _with_drift_apart("drift_oracle", step)


def _init_oracle(choice, guess, sigma=_SIGMA_START):
    memory = ekf.init(QUANTITIES[:4], guess, sigma)
    # No interval ends at the first sample, so that its traction has no effect.
    return memory | dict(last_traction=np.array([1.0, 1.0, 0.0]))


def _window_of(choice):
    return rhe.Window(MODEL, choice.dt_s, choice.estimation_horizon, choice.arrival_mean)


def _build_rhe_step(choice):
    step = paper_rhe.checked_phases(_window_of(choice), STATES)["step"]
    return _with_drift_apart("yaw_drift_rhe", step)


def _start(guess, sigma):
    """The first guess and its standard deviations, with defaults for the yaw drift."""
    return dict(yaw_drift_radpm=0.0) | guess, _SIGMA_START | sigma


def _init_ekf(choice, guess, sigma=_SIGMA_START):
    guess, sigma = _start(guess, sigma)
    return ekf.init(STATES, guess, sigma)


def _init_rhe(choice, guess, sigma=_SIGMA_START):
    guess, sigma = _start(guess, sigma)
    return paper_rhe.checked_init(_window_of(choice), guess, sigma)


def _rhe_settings(scenario):
    P_0 = np.square([_SIGMA_START[name] for name in STATES])
    return tuning.variances_of("yaw_drift_rhe", scenario) | dict(P_0=P_0)


ESTIMATORS = {
    "yaw_drift_ekf": Estimator(
        build_step=_build_ekf_step,
        init=_init_ekf,
        settings=lambda scenario: tuning.variances_of("yaw_drift_ekf", scenario),
        states=lambda choice: STATES,
        n_sigma_w=lambda choice: len(STATES),
        has_yaw_drift=True,
    ),
    "yaw_drift_rhe": Estimator(
        build_step=_build_rhe_step,
        init=_init_rhe,
        settings=_rhe_settings,
        states=lambda choice: STATES,
        n_sigma_w=lambda choice: len(STATES),
        has_yaw_drift=True,
    ),
    "drift_oracle": Estimator(
        build_step=_build_oracle_step,
        init=_init_oracle,
        settings=lambda scenario: tuning.variances_of("drift_oracle", scenario),
        states=lambda choice: QUANTITIES[:4],
        n_sigma_w=lambda choice: 4,
        traction_input=TractionInput.TRUE_WITH_DRIFT,
        has_yaw_drift=True,
    ),
}
