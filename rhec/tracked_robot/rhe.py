"""The paper's receding horizon estimator: RHE of the tracked robot, eq. (9)-(10), (14)-(15)."""

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core.estimator import rhe
from rhec.core.estimator.half_turn import HalfTurn
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.core.model.base import Model
from rhec.tracked_robot import tuning
from rhec.tracked_robot.choice import EstimatorRecord, TractionInput
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f
from rhec.tracked_robot.sensors import GYRO_GUESS, speed_model_of

# Start-up: the paper's W; next to nothing for other quantities that a model estimates.
SIGMA_START = dict(zip(QUANTITIES, paper.SIGMA_W_RHE))
_SIGMA_KNOWN = 1e-3
# A gyro's bias and scale; and the last inputs of a model that holds them.
_SIGMA_GYRO_START = {"gyro_bias_radps": 0.05, "gyro_scale": 0.03}
_SIGMA_INPUT = 10.0
# Where a window restarts, nothing slips and the gyro is as it should be.
_RESTART = dict(mu=1.0, kappa=1.0) | GYRO_GUESS

# Only positions are judged. A wild one would take the estimate with it. Encoders weigh too little
# for that, and where a robot stops suddenly, what they measure must not be rejected.
_POSITION = QUANTITIES[:2]
JUDGE = InnovationGate(
    _POSITION,
    (*_POSITION, "nu_mps", "omega_radps"),
    doubts_model=False,
    half_turn=HalfTurn("theta_rad", "mu"),
)

# An RHE that is told the traction shows what estimating it is worth. Here (μ, κ) are inputs that
# are measured almost exactly.
_SIGMA_HELD = 1e-6
_HELD = Model(
    states=QUANTITIES[:3],
    inputs=("omega_radps", "mu", "kappa"),
    parameters={"nu_mps": None},
    outputs=("x_m", "y_m", "nu_mps", "omega_radps", "mu", "kappa"),
    f=lambda xi, u, p: f(xi, u[0], ca.vertcat(p, u[1:])),
    max_measurement=(*SPEED_MODELS["parameter"].model.limits, 2.0, 2.0),
    sigma_held=dict.fromkeys(("mu", "kappa"), 1.0) | SPEED_MODELS["parameter"].model.sigma_held,
)


def window_of(choice):
    """The Window of a Choice; the RHE within other estimators has the paper's speed model."""
    model = speed_model_of("parameter").model
    if choice.estimator == "rhe":
        model = speed_model_of(choice.speed_model, choice.sensors).model
    return _window(model, choice)


def _window(model, choice):
    return rhe.Window(
        model,
        choice.dt_s,
        choice.estimation_horizon,
        choice.arrival_mean,
        JUDGE,
        quantities=QUANTITIES,
    )


def init(window, guess, sigma=SIGMA_START):
    """The memory before the first sample, {name: array}; quantities without a guess begin at 0.

    `guess` and `sigma` are {quantity: value} and {quantity: standard deviation}.
    """
    names = window.model.joint_names
    guess = GYRO_GUESS | guess
    return rhe.init(
        window,
        np.array([guess.get(name, 0.0) for name in names]),
        sigma_start(window.model, sigma),
        [guess.get(name, 0.0) for name in window.model.inputs],
    )


def sigma_start(model, sigma=SIGMA_START):
    """Standard deviations of the joint state at the start, from those by name."""
    known = dict.fromkeys(model.held_inputs, _SIGMA_INPUT) | _SIGMA_GYRO_START | dict(sigma)
    return np.array([known.get(name, _SIGMA_KNOWN) for name in model.joint_names])


def settings_of(scenario, dt_s=paper.DT_S):
    """The settings of the RHE, eq. (9), (15): variances V, W and P_0, and the noise's constants c.

    Args:
        scenario: A Scenario, or what has its parameters of the RHE.
        dt_s: Length of a sample [s].
    """
    sensors = scenario.sensors
    speed_model = speed_model_of(scenario.speed_model, sensors)
    of_sensors = tuning.sigma_of_sensors(sensors, scenario.sigma_gyro, scenario.sigma_heading)
    settings = dict(
        V=np.square((*tuning.sigma_v_of(scenario), *of_sensors)),
        W=np.square(_sigma_w(scenario, speed_model, dt_s)),
        P_0=np.square(sigma_start(speed_model.model)),
        m_0=np.array([_RESTART.get(name, 0.0) for name in speed_model.model.joint_names]),
    )
    if speed_model.model.motion_noise:
        constants = dict(speed_model.model.motion_noise.constants)
        constants |= dict(zip(tuning.SLIP, scenario.slip or ()))
        constants |= tuning.gyro_constants(sensors, scenario.sigma_gyro)
        constants |= dict(track_width_m=scenario.track_width_m, dt_s=dt_s)
        settings["c"] = np.array([*constants.values()])
    return settings


def _sigma_w(scenario, speed_model, dt_s):
    """Standard deviations of the process noise of the joint state of a model with sensors.

    `sigma_w` of a scenario covers what the model without sensors estimates. The bias of a gyro
    wanders besides. Where the model has motion noise, its constants say how much.
    """
    plain = speed_model_of(scenario.speed_model)
    names = plain.model.joint_names
    sigma_w = scenario.sigma_w
    if sigma_w is None:
        tuned = dict(zip(QUANTITIES, tuning.SIGMA_W["rhe"][tuning.process_noise_of(scenario)]))
        sigma_w = plain.sigma_w or [tuned[name] for name in names]
    sigma = dict(zip(names[-plain.n_sigma_w :], sigma_w))
    if not speed_model.model.motion_noise:
        sigma |= dict(gyro_bias_radps=tuning.GYRO["gyro_bias_walk"] * dt_s**0.5)
    return [sigma.get(name, 0.0) for name in speed_model.model.joint_names]


def build_phases(choice):
    """The phases and the step of the RHE of a Choice."""
    return rhe.build_phases(window_of(choice))


def _window_held(choice):
    return _window(_HELD, choice)


def _build_held_step(choice):
    """The RHE with the traction held, as a Function (memory, z_N, V, W, m_0, P_0, traction)."""
    step = rhe.build_phases(_window_held(choice))["step"]
    names = ("memory", "z_N", "V", "W", "m_0", "P_0")
    inputs = {name: ca.MX.sym(name, step.sparsity_in(name)) for name in names}
    inputs |= dict(z_N=ca.MX.sym("z_N", 4), V=ca.MX.sym("V", 4), traction=ca.MX.sym("p", 2))
    # The traction is appended to the measurements.
    z_N = ca.vertcat(inputs["z_N"], inputs["traction"])
    V = ca.vertcat(inputs["V"], *[_SIGMA_HELD**2] * 2)
    values = inputs | dict(z_N=z_N, V=V)
    results = step.call([values[name] for name in step.name_in()])
    options = {"allow_duplicate_io_names": True}
    return ca.Function("held", [*inputs.values()], results, [*inputs], step.name_out(), options)


def _held(name, traction_input):
    return EstimatorRecord(
        build_step=_build_held_step,
        init=lambda choice, guess, sigma=SIGMA_START: init(_window_held(choice), guess, sigma),
        settings=lambda scenario: dict(
            **tuning.variances_of(name, scenario),
            P_0=np.square([SIGMA_START[state] for state in _HELD.joint_names]),
            m_0=np.zeros(_HELD.n_s),
        ),
        states=lambda choice: _HELD.joint_names,
        n_sigma_w=lambda choice: 4,
        traction_input=traction_input,
    )


ESTIMATORS = {
    "rhe": EstimatorRecord(
        build_step=lambda choice: build_phases(choice)["step"],
        build_phases=build_phases,
        init=lambda choice, guess, sigma=SIGMA_START: init(window_of(choice), guess, sigma),
        settings=settings_of,
        states=lambda choice: window_of(choice).model.joint_names,
        n_sigma_w=lambda choice: speed_model_of(choice.speed_model).n_sigma_w,
    ),
    "rhe_fixed_traction": _held("rhe_fixed_traction", TractionInput.FIELD_MEAN),
    "rhe_no_slip": _held("rhe_no_slip", TractionInput.NONE),
}
