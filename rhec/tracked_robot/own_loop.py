"""The paper's RHE and RHC as objects, for a control loop that a user writes.

They are those of any Model, in the words of the paper. `rhec.RHE()` and `rhec.RHC()` make them.
"""

from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from rhec import paper
from rhec.core._casadi import validation as valid
from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.core.estimator.estimate import with_deviations
from rhec.tracked_robot import options, tuning
from rhec.tracked_robot.estimators import Choice
from rhec.tracked_robot.kinematics import QUANTITIES, YAW_DRIFT
from rhec.tracked_robot.paper_rhc import options_of, with_full_steps
from rhec.tracked_robot.paper_rhe import SIGMA_START, init, settings_of, window_of
from rhec.tracked_robot.sensors import rows_of_yaws
from rhec.tracked_robot.speed_models import refuse_drift_with, speed_model_of
from rhec.tracked_robot.yaw_disturbance import disturbance_of


class Estimate(NamedTuple):
    """Pose [m, m, rad], speed [m/s], traction, and the covariance of the joint state.

    The joint state is (x, y, θ, ν, μ, κ), without ν where that is an input. With tracks that slip
    (x, y) is the antenna's place, and the joint state is (x, y, θ, l_f, l_l, μ, κ). The covariance
    does not take the bounds of μ and κ into account. The yaw drift δ [rad/m] is None where it is
    not estimated; where it is, it ends the joint state.
    """

    x: float
    y: float
    theta: float
    nu: float
    mu: float
    kappa: float
    covariance: np.ndarray
    yaw_drift: float | None = None

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
        drift = [] if self.yaw_drift is None else [self.yaw_drift]
        of_paper, of_drift = np.split(sigma, [len(sigma) - len(drift)])
        sigma_nu = of_paper[3] if len(of_paper) == 6 else np.nan  # otherwise ν is an input
        deviations = [*of_paper[:3], sigma_nu, *of_paper[-2:], *of_drift]
        return with_deviations((*QUANTITIES, YAW_DRIFT), [*self[:6], *drift], deviations)


class RHE(rhe.RHE):
    """The paper's estimator for a user's control loop: `prepare()`, then `feedback(z)`, eq. (10).

    A measurement is z = (x, y, ν, ω) [m, m, m/s, rad/s], eq. (8), then those of the sensors: the
    yaw rate of the gyro, as a mean over the sample [rad/s], and the heading [rad]. `feedback`
    returns an Estimate. `solve` takes full steps, all of them.

    Args:
        dt: Length of a sample [s].
        horizon: Intervals of the window.
        process_noise: The rule that picked W and V, see Scenario.
        sigma_w: Standard deviations of the process noise; None: those of `process_noise`.
        sigma_v: Standard deviations of z; None: those of `process_noise`.
        speed_model: "parameter", "input" or "slipping", see Scenario.
        slip: How tracks slip, for the speed model "slipping", see Scenario.
        arrival_mean: "filtered" or "smoothed", see Scenario.
        sensors: What the robot has besides GNSS and encoders: ("gyro",), ("heading",) or both.
        sigma_gyro: Noise of the gyro: constant [rad/s], and as a share of ω, see Scenario.
        sigma_heading: Standard deviation of the heading [rad].
        track_width_m: b [m].
        yaw_drift: Whether the yaw drift is estimated, too, see Scenario and `RHC.disturbance`.
        guess: First (x, y, θ, ν, μ, κ). By default the first measurement's position and speed, yaw
            0 and no slip, with a standard deviation of the yaw of a right angle.
        model: None; with a Model, rhec.RHE is another class.

    Raises:
        ValueError: If an argument is invalid.
    """

    @valid.checked
    def __init__(
        self,
        *,
        dt: valid.Positive = paper.DT_S,
        horizon: valid.Intervals = paper.HORIZON,
        process_noise: options.ProcessNoise = tuning.DEFAULT_RULE,
        sigma_w: valid.NotNegatives | None = None,
        sigma_v: options.SigmaV | None = None,
        speed_model: options.SpeedModel = "parameter",
        slip: options.Slip | None = None,
        arrival_mean: rhe.ArrivalMean = "filtered",
        sensors: options.Sensors = (),
        sigma_gyro: options.SigmaGyro | None = None,
        sigma_heading: valid.Positive | None = None,
        track_width_m: valid.Positive = paper.TRACK_WIDTH_M,
        yaw_drift: valid.Flag = False,
        guess: tuple[valid.Real, valid.Real, valid.Real, valid.Real, valid.Real, valid.Real]
        | None = None,
        model: None = None,
    ):
        if yaw_drift:
            refuse_drift_with(speed_model)
        n_w = speed_model_of(speed_model, yaw_drift=yaw_drift).n_sigma_w
        if sigma_w is not None and len(sigma_w) != n_w:
            expected = f"with speed_model {speed_model!r} it should have {n_w} entries"
            raise ValueError(f"sigma_w was {sigma_w!r}; {expected}")
        # By the names of a Scenario's parameters.
        given = SimpleNamespace(
            estimator="rhe",
            estimation_horizon=horizon,
            process_noise=process_noise,
            sigma_w=sigma_w,
            sigma_v=sigma_v,
            speed_model=speed_model,
            slip=slip,
            arrival_mean=arrival_mean,
            sensors=sensors,
            sigma_gyro=sigma_gyro,
            sigma_heading=sigma_heading,
            track_width_m=track_width_m,
            yaw_drift=yaw_drift,
        )
        window = window_of(Choice.of(given)._replace(dt_s=dt))
        self._guess = guess
        self._rows_of_yaws = rows_of_yaws(sensors)
        self._load(rhe.build_live_phases, window, settings_of(given, dt))

    def _start(self):
        z = self._inputs["z"]
        plausible = np.abs(z) <= self.model.limits
        guess = self._guess
        sigma = SIGMA_START
        if guess is None:
            x, y, nu = np.where(plausible, z, 0.0)[:3]
            yaws = [z[row] for row in self._rows_of_yaws if plausible[row]]
            guess = (x, y, yaws[0] if yaws else 0.0, nu, 1.0, 1.0)
            # One measurement says nothing of the yaw, unless it is one of the yaw, which follows.
            sigma = sigma | dict(theta_rad=np.pi / 2)
        memory = init(self.window, dict(zip(QUANTITIES, guess)), sigma)
        self.iteration.start(memory | dict(age=0.0))
        # Without a position there is no first guess: start again with the next measurement.
        self.iteration.started = self._guess is not None or bool(plausible[:2].all())

    def _estimate(self):
        values, covariance = self._result
        estimate = values.tolist()  # it ends with the yaw drift, where that is estimated
        return Estimate(*estimate[:6], covariance.copy(), *estimate[6:])


class RHC(rhc.RHC):
    """The paper's controller for a user's control loop: `prepare()`, then `feedback(…)`, eq. (12).

    Args:
        q: Weights Q_k of (x, y, θ).
        r: Weight R of ω, eq. (22).
        qn_factor: Q_N = qn_factor · Q_k.
        omega_max: Bound on ω [rad/s], eq. (16).
        dt: Length of a sample [s].
        horizon: Intervals of the prediction.
        qp: What solves the QP, see `rhec.core.controller.stages.Stages`; None: an active set.
        model: None; with a Model, rhec.RHC is another class.

    Raises:
        ValueError: If an argument is invalid.
    """

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
        qp: Any = None,
        model: None = None,
    ):
        self._qp = qp
        weights = dict(q=q, r=r, qn_factor=qn_factor)
        super().__init__(**options_of(**weights, omega_max=omega_max, dt=dt, horizon=horizon))
        pose, p, xi_ref, (omega_ref,), _ = self._inputs.values()
        self._inputs = dict(pose=pose, p=p, xi_ref=xi_ref, omega_ref=omega_ref)
        # A memoryview returns a float faster than an array does.
        self._plan = memoryview(self.iteration.arrays["u_plan"])
        self._disturbance = 0.0

    def _problem_of(self, options):
        return with_full_steps(super()._problem_of(options), self._qp)

    def disturbance(self, estimate: Estimate) -> float:
        """The yaw rate d [rad/s] that the soil adds to that of the tracks, θ' = κ (ω + d).

        `references` of a PathTracker takes ω + d as the measured yaw rate, and `feedback` takes d.
        At most half of omega_max is d, which leaves the rest for steering.

        Args:
            estimate: The Estimate of a rhec.RHE.

        Returns:
            d = μνδ/κ of the estimated yaw drift δ; 0 where that is not estimated.
        """
        if estimate.yaw_drift is None:
            return 0.0
        upper = self.settings["upper"].item()
        return float(disturbance_of(*estimate.p, estimate.yaw_drift, upper))

    def feedback(
        self, pose: Any, p: Any, xi_ref: Any, omega_ref: Any, disturbance: float = 0.0
    ) -> float:
        """Yaw rate [rad/s] to command, by one Gauss-Newton step, eq. (13).

        Args:
            pose: (3,) estimated (x, y, θ).
            p: (3,) estimated (ν, μ, κ).
            xi_ref: (3, N+1) desired poses, eq. (17)-(18); node 0 is now and has no weight.
            omega_ref: (N,) desired yaw rates.
            disturbance: d [rad/s], that of the method `disturbance`. The plan is of ω + d, within
                bounds moved by d.

        Returns:
            The first of the planned yaw rates, less d.
        """
        self._set_inputs(pose=pose, p=p, xi_ref=xi_ref, omega_ref=omega_ref)
        self._count_in(disturbance)
        self.iteration.feedback()
        return self._plan[0] - disturbance

    def solve(
        self,
        pose: Any,
        p: Any,
        xi_ref: Any,
        omega_ref: Any,
        iterations: int = 20,
        disturbance: float = 0.0,
    ) -> float:
        """Iterate to convergence on the nonlinear problem, by full steps, all of them.

        Args:
            pose: (3,) estimated (x, y, θ).
            p: (3,) estimated (ν, μ, κ).
            xi_ref: (3, N+1) desired poses.
            omega_ref: (N,) desired yaw rates.
            iterations: Gauss-Newton steps.
            disturbance: d [rad/s], as in `feedback`.

        Returns:
            The first of the planned yaw rates, less d.
        """
        self._set_inputs(pose=pose, p=p, xi_ref=xi_ref, omega_ref=omega_ref)
        self._count_in(disturbance)
        self.iteration.solve(iterations)
        return self._plan[0] - disturbance

    def _count_in(self, disturbance):
        """Move the bounds by a disturbance."""
        if disturbance or self._disturbance:
            for name in ("lower", "upper"):
                self.iteration.arrays[name][:] = self.settings[name] + disturbance
            self._disturbance = disturbance

    @property
    def omega_plan(self) -> np.ndarray:
        """Planned yaw rates (N,) [rad/s]."""
        return self.u_plan[0] - self._disturbance

    @property
    def xi_plan(self) -> np.ndarray:
        """Predicted poses (3, N+1)."""
        return self.x_plan
