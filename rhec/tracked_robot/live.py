"""The paper's RHE and RHC as objects, for a control loop that a user writes."""

from typing import Any, ClassVar, NamedTuple

import numpy as np

from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core.controller import rhc
from rhec.core.controller.options import Problem
from rhec.core.estimator import rhe
from rhec.core.solver.rti import RealTimeIteration
from rhec.tracked_robot import estimators, options, tuning
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.rhc import horizon_of
from rhec.tracked_robot.rhe import SIGMA_START, settings_of, window_of
from rhec.tracked_robot.sensors import OUTPUTS
from rhec.tracked_robot.speed_models import speed_model_of


class PaperEstimate(NamedTuple):
    """Pose [m, m, rad], speed [m/s], traction, and the covariance of the joint state.

    The joint state is (x, y, θ, ν, μ, κ), without ν where that is an input. With tracks that slip
    (x, y) is the antenna's place, and the joint state is (x, y, θ, l_f, l_l, μ, κ). The covariance
    does not take the bounds of μ and κ into account.
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

    def __repr__(self):
        sigma = np.sqrt(np.diag(self.covariance))
        sigma_nu = sigma[3:4] if len(sigma) == 6 else ()  # otherwise ν is an input
        parts = []
        for name, value, deviation, unit in (
            ("x", self.x, sigma[:1], " m"),
            ("y", self.y, sigma[1:2], " m"),
            ("theta", self.theta, sigma[2:3], " rad"),
            ("nu", self.nu, sigma_nu, " m/s"),
            ("mu", self.mu, sigma[-2:-1], ""),
            ("kappa", self.kappa, sigma[-1:], ""),
        ):
            tolerance = "".join(f" ± {number:.2g}" for number in deviation)
            parts.append(f"{name} = {value:.4g}{tolerance}{unit}")
        return f"{type(self).__name__}({', '.join(parts)})"


class PaperRHE(rhe.RHE):
    """The paper's estimator for a user's control loop: `prepare()`, then `feedback(z)`, eq. (10).

    A measurement is z = (x, y, ν, ω) [m, m, m/s, rad/s], eq. (8), then those of the sensors: the
    yaw rate of the gyro, as a mean over the sample [rad/s], and the heading [rad].

    Args:
        dt: Length of a sample [s].
        horizon: Intervals of the window.
        process_noise: "printed", "calibrated" or "consistent", see Scenario.
        sigma_w: Standard deviations of the process noise; None: those of `process_noise`.
        sigma_v: Standard deviations of z; None: those of `process_noise`.
        speed_model: "parameter", "input" or "slipping", see Scenario.
        slip: How tracks slip, for the speed model "slipping", see Scenario.
        arrival_mean: "smoothed" or "filtered"; None: that of `process_noise`.
        sensors: What the robot has besides GNSS and encoders: ("gyro",), ("heading",) or both.
        sigma_gyro: Noise of the gyro: constant [rad/s], and as a share of ω, see Scenario.
        sigma_heading: Standard deviation of the heading [rad].
        track_width_m: b [m].
        guess: First (x, y, θ, ν, μ, κ). By default the first measurement's position and speed, yaw
            0 and no slip, with a standard deviation of the yaw of a right angle.

    Raises:
        ValueError: if an argument is invalid.
    """

    @valid.checked
    def __init__(
        self,
        *,
        dt: valid.Positive = paper.DT_S,
        horizon: valid.Intervals = paper.HORIZON,
        process_noise: options.ProcessNoise = "printed",
        sigma_w: valid.NotNegatives | None = None,
        sigma_v: options.SigmaV | None = None,
        speed_model: options.SpeedModel = "parameter",
        slip: options.Slip | None = None,
        arrival_mean: rhe.ArrivalMean | None = None,
        sensors: options.Sensors = (),
        sigma_gyro: options.SigmaGyro | None = None,
        sigma_heading: valid.Positive | None = None,
        track_width_m: valid.Positive = paper.TRACK_WIDTH_M,
        guess: tuple[valid.Real, valid.Real, valid.Real, valid.Real, valid.Real, valid.Real]
        | None = None,
    ):
        n_w = speed_model_of(speed_model).n_sigma_w
        if sigma_w is not None and len(sigma_w) != n_w:
            expected = f"with speed_model {speed_model!r} it should have {n_w} entries"
            raise ValueError(f"sigma_w was {sigma_w!r}; {expected}")
        arrival_mean = arrival_mean or tuning.ARRIVAL_MEAN[process_noise]
        sigma_v = sigma_v or tuning.SIGMA_V[process_noise]
        sensors = tuple(name for name in OUTPUTS if name in sensors)
        self._choice = Choice("rhe", horizon, speed_model, arrival_mean, dt, sensors=sensors)
        self._estimator = estimators.estimator_of("rhe")
        self._guess = guess
        self._tuning = process_noise
        self.window = window_of(self._choice)
        self.model = self.window.model
        constants = dict(track_width_m=track_width_m, dt_s=dt)
        constants |= tuning.gyro_constants(sensors, sigma_gyro)
        sigma_v = (*sigma_v, *tuning.sigma_of_sensors(sensors, sigma_gyro, sigma_heading))
        noise = (process_noise, sigma_w, sigma_v, slip, sensors)
        self.settings = settings_of(speed_model, *noise, **constants)
        functions = compiled.load(estimators.build_phases, self._choice)
        memory = self._estimator.init(self._choice, dict.fromkeys(QUANTITIES, 0.0))
        self.iteration = RealTimeIteration(functions, memory, rhe.UNKNOWNS, **self.settings)
        arrays = self.iteration.arrays
        n_s = self.model.n_s
        self._inputs = dict(z=arrays["z_N"])
        # Views of the result, made once: reshaping takes longer than the QP of the feedback.
        self._result = (arrays["estimate"], arrays["covariance"].reshape(n_s, n_s))

    def __repr__(self):
        sigmas = {name: np.array2string(np.sqrt(self.settings[name])) for name in "VW"}
        choice = self._choice
        return (
            f"{type(self).__name__}: {self.window.N} intervals of {self.window.dt_s:g} s, "
            f"speed model {choice.speed_model}, arrival mean {choice.arrival_mean}\n"
            f"  process noise {self._tuning}: sigma of ({', '.join(self.model.joint_names)}) "
            f"{sigmas['W']}\n"
            f"  measurements: sigma of ({', '.join(self.model.outputs)}) {sigmas['V']}"
        )

    def _start(self):
        z = self._inputs["z"]
        plausible = np.abs(z) <= self.model.limits
        guess = self._guess
        sigma = SIGMA_START
        if guess is None:
            x, y, nu = np.where(plausible, z, 0.0)[:3]
            heading = z[-1] if "heading" in self._choice.sensors and plausible[-1] else 0.0
            guess = (x, y, heading, nu, 1.0, 1.0)
            # One measurement says nothing of the yaw, unless it is a heading, which follows.
            sigma = sigma | dict(theta_rad=np.pi / 2)
        memory = self._estimator.init(self._choice, dict(zip(QUANTITIES, guess)), sigma)
        self.iteration.start(memory | dict(age=0.0))
        # Without a position there is no first guess: start again with the next measurement.
        self.iteration.started = self._guess is not None or bool(plausible[:2].all())

    def _estimate(self):
        estimate, covariance = self._result
        return PaperEstimate(*estimate.tolist(), covariance.copy())


class PaperRHC(rhc.RHC):
    """The paper's controller for a user's control loop: `prepare()`, then `feedback(…)`, eq. (12).

    Args:
        q: Weights Q_k of (x, y, θ).
        r: Weight R of ω, eq. (22).
        qn_factor: Q_N = qn_factor · Q_k.
        omega_max: Bound on ω [rad/s], eq. (16).
        dt: Length of a sample [s].
        horizon: Intervals of the prediction.

    Raises:
        ValueError: if an argument is invalid.
    """

    qp: ClassVar[Any] = None  # of a subclass: the QP's solver, see `Horizon.qp`

    @valid.checked
    def __init__(
        self,
        *,
        q: options.Weights = paper.Q3,
        r: valid.Positive = paper.R,
        qn_factor: valid.NotNegative = paper.QN_FACTOR,
        omega_max: valid.Positive = paper.OMEGA_MAX_RADPS,
        dt: valid.Positive = paper.DT_S,
        horizon: valid.Intervals = paper.HORIZON,
    ):
        problem = horizon_of(horizon, dt_s=dt)._replace(qp=self.qp)
        Q = np.array(q)
        settings = dict(Q=Q, QN=qn_factor * Q, R=np.array([r]))
        settings |= dict(lower=np.array([-omega_max]), upper=np.array([omega_max]))
        self._compile(Problem(problem, problem, settings))
        pose, p, xi_ref, (omega_ref,) = self._inputs.values()
        self._inputs = dict(pose=pose, p=p, xi_ref=xi_ref, omega_ref=omega_ref)
        # A memoryview returns a float faster than an array does.
        self._plan = memoryview(self.iteration.arrays["u_plan"])

    def feedback(self, pose: Any, p: Any, xi_ref: Any, omega_ref: Any) -> float:
        """Yaw rate [rad/s] to command, by one Gauss-Newton step, eq. (13).

        Args:
            pose: (3,) estimated (x, y, θ).
            p: (3,) estimated (ν, μ, κ).
            xi_ref: (3, N+1) desired poses, eq. (17)-(18); node 0 is now and has no weight.
            omega_ref: (N,) desired yaw rates.

        Returns:
            The first of the planned yaw rates.
        """
        self._set_inputs(pose=pose, p=p, xi_ref=xi_ref, omega_ref=omega_ref)
        self.iteration.feedback()
        return self._plan[0]

    def solve(self, pose: Any, p: Any, xi_ref: Any, omega_ref: Any, iterations: int = 20) -> float:
        """Iterate to convergence on the nonlinear problem.

        Args:
            pose: (3,) estimated (x, y, θ).
            p: (3,) estimated (ν, μ, κ).
            xi_ref: (3, N+1) desired poses.
            omega_ref: (N,) desired yaw rates.
            iterations: Gauss-Newton steps.

        Returns:
            The first of the planned yaw rates.
        """
        self._set_inputs(pose=pose, p=p, xi_ref=xi_ref, omega_ref=omega_ref)
        self.iteration.solve(iterations)
        return self._plan[0]

    @property
    def omega_plan(self) -> np.ndarray:
        """Planned yaw rates (N,) [rad/s]."""
        return self.iteration.arrays["u_plan"].copy()

    @property
    def xi_plan(self) -> np.ndarray:
        """Predicted poses (3, N+1)."""
        return self.x_plan
