"""The paper's receding horizon estimator: RHE of the tracked robot, eq. (9)-(10), (14)-(15)."""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core.estimator import rhe
from rhec.core.model.base import Model
from rhec.core.solver.rti import RealTimeIteration
from rhec.tracked_robot import estimators, tuning
from rhec.tracked_robot.estimators import Choice, Estimator
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f, speed_model_of

__all__ = ["ESTIMATORS", "PaperEstimate", "PaperRHE", "SIGMA_START", "init", "window_of"]

# Before the first sample: the paper's W; of what else a model may estimate, next to nothing.
SIGMA_START = dict(zip(QUANTITIES, paper.SIGMA_W_RHE))
_SIGMA_KNOWN = 1e-3


# Held at what the RHE is told: inputs, measured all but exactly. What is estimating them worth?
_SIGMA_TOLD = 1e-6
_HELD = Model(
    states=QUANTITIES[:3],
    inputs=("omega_radps", "mu", "kappa"),
    parameters={"nu_mps": None},
    outputs=("x_m", "y_m", "nu_mps", "omega_radps", "mu", "kappa"),
    f=lambda xi, u, p: f(xi, u[0], ca.vertcat(p, u[1:])),
    max_measurement=(*SPEED_MODELS["parameter"].model.limits, 2.0, 2.0),
)


class PaperEstimate(NamedTuple):
    """Pose [m, m, rad], speed [m/s], traction, and the covariance of the joint state.

    The joint state is (x, y, θ, ν, μ, κ), without ν where that is an input; with tracks that slip
    (x, y) is the antenna's place, and the joint state (x, y, θ, l_f, l_l, μ, κ). The covariance
    leaves the bounds aside.
    """

    x: float
    y: float
    theta: float
    nu: float
    mu: float
    kappa: float
    covariance: np.ndarray

    @property
    def pose(self) -> tuple[float, float, float]:
        """ξ̂ = (x, y, θ)."""
        return self[:3]

    @property
    def p(self) -> tuple[float, float, float]:
        """p̂ = (ν, μ, κ)."""
        return self[3:6]


def window_of(choice):
    """The Window of a Choice; the RHE within other estimators has the paper's speed model."""
    model = speed_model_of(choice.speed_model if choice.estimator == "rhe" else "parameter").model
    return rhe.Window(
        model, choice.dt_s, choice.estimation_horizon, choice.arrival_mean, choice.robust
    )


def init(window, guess, sigma=SIGMA_START):
    """Memory before the first sample, from a guess and its standard deviations by quantity."""
    names = window.model.joint_names
    return rhe.init(
        window,
        np.array([guess.get(name, 0.0) for name in names]),
        np.array([sigma.get(name, _SIGMA_KNOWN) for name in names]),
        [guess.get(name, 0.0) for name in window.model.inputs],
    )


def _settings_of(speed_model, process_noise, sigma_w, sigma_v, slip, **constants):
    """Settings V, W, P_0 and c of the RHE; sigma_w None: that of `process_noise`."""
    kind = speed_model_of(speed_model)
    names = kind.model.joint_names
    n_w = kind.n_sigma_w
    if sigma_w is None:
        tuned = dict(zip(QUANTITIES, tuning.SIGMA_W["rhe"][process_noise]))
        sigma_w = kind.sigma_w or [tuned[name] for name in names]
    settings = dict(
        V=np.square(sigma_v),
        W=np.square([*(0.0,) * (len(names) - n_w), *sigma_w]),
        P_0=np.square([SIGMA_START.get(name, _SIGMA_KNOWN) for name in names]),
    )
    if kind.model.motion_noise:
        tuned = kind.model.motion_noise.constants
        constants |= dict(zip(tuned, slip or ()))
        settings["c"] = np.array([*(tuned | constants).values()])
    return settings


def _settings(scenario):
    return _settings_of(
        scenario.speed_model,
        scenario.process_noise,
        scenario.sigma_w,
        tuning.sigma_v_of(scenario),
        scenario.slip,
        track_width_m=scenario.track_width_m,
    )


def _build_phases(choice):
    return rhe.build_phases(window_of(choice), QUANTITIES)


def _window_held(choice):
    return rhe.Window(_HELD, choice.dt_s, choice.estimation_horizon, choice.arrival_mean)


def _build_held_step(choice):
    """The RHE with the traction held, as a Function (memory, z_N, V, W, P_0, traction)."""
    step = rhe.build_phases(_window_held(choice), QUANTITIES)["step"]
    names = ["memory", "z_N", "V", "W", "P_0"]
    given = {name: ca.MX.sym(name, step.sparsity_in(name)) for name in names}
    given |= {name: ca.MX.sym(name, 4) for name in ("z_N", "V")} | dict(traction=ca.MX.sym("p", 2))
    z_N = ca.vertcat(given["z_N"], given["traction"])
    V = [given["V"], *[_SIGMA_TOLD**2] * 2]
    known = given | dict(z_N=z_N, V=ca.vertcat(*V))
    results = step.call([known[name] for name in step.name_in()])
    options = {"allow_duplicate_io_names": True}
    return ca.Function("held", [*given.values()], results, [*given], step.name_out(), options)


def _held(name, given):
    def settings(scenario):
        tuned = tuning.SIGMA_W[name][scenario.process_noise]
        sigma_w = tuned if scenario.sigma_w is None else scenario.sigma_w
        P_0 = np.square([SIGMA_START[name] for name in _HELD.joint_names])
        return dict(V=np.square(tuning.sigma_v_of(scenario)), W=np.square(sigma_w), P_0=P_0)

    return Estimator(
        build_step=_build_held_step,
        init=lambda choice, guess, sigma=SIGMA_START: init(_window_held(choice), guess, sigma),
        settings=settings,
        states=lambda choice: _HELD.joint_names,
        n_sigma_w=lambda choice: 4,
        given=given,
    )


ESTIMATORS = {
    "rhe_fixed_traction": _held("rhe_fixed_traction", "field mean"),
    "rhe_no_slip": _held("rhe_no_slip", "nothing"),
    "rhe": Estimator(
        build_step=lambda choice: _build_phases(choice)["step"],
        build_phases=_build_phases,
        init=lambda choice, guess, sigma=SIGMA_START: init(window_of(choice), guess, sigma),
        settings=_settings,
        states=lambda choice: window_of(choice).model.joint_names,
        n_sigma_w=lambda choice: speed_model_of(choice.speed_model).n_sigma_w,
    ),
}


class PaperRHE(rhe.RHE):
    """The estimator for a loop of one's own: `prepare()`, then `feedback(z)`, z = (x, y, ν, ω).

    Args:
        dt: Length of a sample [s].
        horizon: Intervals of the window.
        process_noise: "printed", "calibrated" or "consistent", see Scenario.
        sigma_w: Standard deviations of the process noise instead of these.
        sigma_v: Standard deviations of (x, y [m], ν [m/s], ω [rad/s]); None: see Scenario.
        speed_model: "parameter", "input" or "slipping", see Scenario.
        slip: What tracks that slip do, see Scenario.
        arrival_mean: "smoothed" or "filtered"; None: see Scenario.
        robust: Trust measurements that others contradict less, see Scenario.
        track_width_m: b [m].
        guess: First (x, y, θ, ν, μ, κ). Without it the first measurement's position and speed, yaw
            0 and no slip, with a yaw that may be a right angle off.

    Raises:
        ValueError: In one sentence, for an argument that cannot be.
    """

    @valid.checked
    def __init__(
        self,
        *,
        dt: valid.Positive = paper.DT_S,
        horizon: valid.Intervals = paper.HORIZON,
        process_noise: valid.ProcessNoise = "printed",
        sigma_w: valid.NotNegatives | None = None,
        sigma_v: valid.SigmaV | None = None,
        speed_model: valid.SpeedModel = "parameter",
        slip: valid.Slip | None = None,
        arrival_mean: valid.ArrivalMean | None = None,
        robust: valid.Flag = False,
        track_width_m: valid.Positive = paper.TRACK_WIDTH_M,
        guess: tuple[valid.Real, valid.Real, valid.Real, valid.Real, valid.Real, valid.Real]
        | None = None,
    ):
        n_w = speed_model_of(speed_model).n_sigma_w
        if sigma_w is not None and len(sigma_w) != n_w:
            with_model = f"with speed_model {speed_model!r} it should have {n_w} entries"
            raise ValueError(f"sigma_w was {sigma_w!r}; {with_model}")
        arrival_mean = arrival_mean or tuning.ARRIVAL_MEAN[process_noise]
        sigma_v = sigma_v or tuning.SIGMA_V[process_noise]
        self._choice = Choice("rhe", horizon, speed_model, arrival_mean, robust, dt)
        self._guess = guess
        self.window = window_of(self._choice)
        self.model = self.window.model
        constants = dict(track_width_m=track_width_m, dt_s=dt)
        self.settings = _settings_of(
            speed_model, process_noise, sigma_w, sigma_v, slip, **constants
        )
        functions = compiled.load(estimators.build_phases, self._choice)
        memory = estimators.estimator_of("rhe", robust).init(
            self._choice, dict.fromkeys(QUANTITIES, 0.0)
        )
        self.iteration = RealTimeIteration(functions, memory, ("s", "v"), **self.settings)
        arrays = self.iteration.arrays
        n_s = self.model.n_s
        self._answer = arrays["estimate"], arrays["covariance"].reshape(n_s, n_s)

    def _start(self, z):
        readable = np.abs(z) <= self.model.limits
        guess = self._guess
        sigma = SIGMA_START
        if guess is None:
            x, y, nu, _ = np.where(readable, z, 0.0)
            guess = (x, y, 0.0, nu, 1.0, 1.0)
            sigma = sigma | dict(theta_rad=np.pi / 2)
        estimator = estimators.estimator_of("rhe", self._choice.robust)
        memory = estimator.init(self._choice, dict(zip(QUANTITIES, guess)), sigma)
        self.iteration.start(memory | dict(age=0.0))
        # Without a place, begin again with the next measurement.
        self.iteration.started = self._guess is not None or bool(readable[:2].all())

    def _estimate(self):
        estimate, covariance = self._answer
        return PaperEstimate(*estimate.tolist(), covariance.copy())
