"""The paper's receding horizon estimator: RHE of the tracked robot, eq. (9)-(10), (14)-(15)."""

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core.estimator import rhe
from rhec.core.estimator.half_turn import HalfTurn
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimator_record import EstimatorRecord
from rhec.tracked_robot.kinematics import OUTPUTS, QUANTITIES, YAW_DRIFT
from rhec.tracked_robot.sensors import GUESS, SIGMA_GUESS, records, sigma_of_sensors
from rhec.tracked_robot.speed_models import constants_of, speed_model_of

# Start-up: the paper's W; next to nothing for other quantities that a model estimates.
SIGMA_START = dict(zip(QUANTITIES, paper.SIGMA_W_RHE)) | {YAW_DRIFT: tuning.SIGMA_YAW_DRIFT}
_SIGMA_KNOWN = 1e-3
_SIGMA_INPUT = 10.0  # of the last inputs of a model that holds them
# Where a window restarts, nothing slips and sensors are as they should be.
_RESTART = dict(mu=1.0, kappa=1.0) | GUESS

# Only positions are judged. A wild one would take the estimate with it. Encoders weigh too little
# for that, and where a robot stops suddenly, what they measure must not be rejected.
_POSITION = QUANTITIES[:2]
JUDGE = InnovationGate(
    _POSITION, OUTPUTS, doubts_model=False, half_turn=HalfTurn("theta_rad", "mu")
)


def window_of(choice):
    """The Window of a Choice."""
    return rhe.Window(
        speed_model_of(choice.speed_model, choice.sensors, choice.yaw_drift).model,
        choice.dt_s,
        choice.estimation_horizon,
        choice.arrival_mean,
        JUDGE,
        quantities=(*QUANTITIES, YAW_DRIFT) if choice.yaw_drift else QUANTITIES,
    )


def init(window, guess, sigma=SIGMA_START):
    """The memory before the first sample, {name: array}; quantities without a guess begin at 0.

    `guess` and `sigma` are {quantity: value} and {quantity: standard deviation}.
    """
    names = window.model.joint_names
    guess = GUESS | guess
    return rhe.init(
        window,
        np.array([guess.get(name, 0.0) for name in names]),
        sigma_start(window.model, sigma),
        [guess.get(name, 0.0) for name in window.model.inputs],
    )


def sigma_start(model, sigma=SIGMA_START):
    """Standard deviations of the joint state at the start, from those by name."""
    known = SIGMA_START | dict.fromkeys(model.held_inputs, _SIGMA_INPUT) | SIGMA_GUESS
    known |= dict(sigma)
    return np.array([known.get(name, _SIGMA_KNOWN) for name in model.joint_names])


def settings_of(scenario, dt_s=paper.DT_S):
    """The settings of the RHE, eq. (9), (15): variances V, W and P_0, and the noise's constants c.

    Args:
        scenario: A Scenario, or what has its parameters of the RHE.
        dt_s: Length of a sample [s].
    """
    speed_model = speed_model_of(scenario.speed_model, scenario.sensors, scenario.yaw_drift)
    noise = speed_model.noise or tuning.noise_of(tuning.name_of_noise(scenario), scenario)
    settings = dict(
        V=np.square((*(scenario.sigma_v or noise.sigma_v), *sigma_of_sensors(scenario))),
        W=np.square(_sigma_w(scenario, speed_model, dt_s)),
        P_0=np.square(sigma_start(speed_model.model)),
        m_0=np.array([_RESTART.get(name, 0.0) for name in speed_model.model.joint_names]),
    )
    if speed_model.model.motion_noise:
        constants = dict(speed_model.model.motion_noise.constants)
        constants |= dict(zip(tuning.SLIP, scenario.slip or ()))
        for sensor in records(scenario.sensors):
            constants |= constants_of(sensor, sensor.sigma_of(scenario))
        constants |= dict(track_width_m=scenario.track_width_m, dt_s=dt_s)
        settings["c"] = np.array([*constants.values()])
    return settings


def _sigma_w(scenario, speed_model, dt_s):
    """Standard deviations of the process noise of the joint state of a model with sensors.

    `sigma_w` of a scenario covers what the model without sensors estimates. What is unknown of a
    sensor may wander besides. Where the model has motion noise, its constants say how much.
    """
    plain = speed_model_of(scenario.speed_model, yaw_drift=scenario.yaw_drift)
    names = plain.model.joint_names
    sigma_w = scenario.sigma_w
    if sigma_w is None:
        noise = tuning.noise_of(tuning.name_of_noise(scenario), scenario)
        tuned = dict(zip((*QUANTITIES, YAW_DRIFT), noise.sigma_w))
        sigma_w = plain.noise.sigma_w if plain.noise else [tuned[name] for name in names]
    sigma = dict(zip(names[-len(sigma_w) :], sigma_w))
    if not speed_model.model.motion_noise:
        unknowns = (unknown for of in records(scenario.sensors) for unknown in of.unknowns)
        sigma |= {unknown.name: unknown.walk * dt_s**0.5 for unknown in unknowns}
    return [sigma.get(name, 0.0) for name in speed_model.model.joint_names]


def build_phases(choice):
    """The phases and the step of the RHE of a Choice."""
    return _phases_of(window_of(choice), choice)


def _phases_of(window, choice):
    """The phases and the step of a Window, with the yaw drift as a result of its own."""
    phases = rhe.build_phases(window)
    if not choice.yaw_drift:
        return phases
    return phases | {name: with_drift_apart(phases[name]) for name in ("feedback", "step")}


def with_drift_apart(phase):
    """A Function whose `estimate` ends with the yaw drift, with the result `yaw_drift` instead."""
    inputs = phase.mx_in()
    results = dict(zip(phase.name_out(), phase.call(inputs)))
    estimate = results["estimate"]
    results |= dict(estimate=estimate[:-1], yaw_drift=estimate[-1])
    options = {"allow_duplicate_io_names": True}
    return ca.Function(
        phase.name(), inputs, [*results.values()], phase.name_in(), [*results], options
    )


ESTIMATORS = {
    "rhe": EstimatorRecord(
        build_step=lambda choice: build_phases(choice)["step"],
        build_phases=build_phases,
        init=lambda choice, guess, sigma=SIGMA_START: init(window_of(choice), guess, sigma),
        settings=settings_of,
        states=lambda choice: window_of(choice).model.joint_names,
        n_sigma_w=lambda choice: (
            speed_model_of(choice.speed_model, yaw_drift=choice.yaw_drift).n_sigma_w
        ),
        sensors=None,
        takes_yaw_drift=True,
        has_yaw_drift=lambda choice: choice.yaw_drift,
    )
}
