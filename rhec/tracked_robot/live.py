"""The paper's RHE and RHC as objects, for a control loop that a user writes."""

from typing import Any, NamedTuple

import numpy as np

from rhec import paper
from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.core.solver.rti import RealTimeIteration, copy_checked
from rhec.tracked_robot import estimators, tuning
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.rhc import horizon_of
from rhec.tracked_robot.rhe import SIGMA_START, settings_of, window_of
from rhec.tracked_robot.speed_models import speed_model_of

__all__ = ["PaperEstimate", "PaperRHC", "PaperRHE"]


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
        self.settings = settings_of(speed_model, process_noise, sigma_w, sigma_v, slip, **constants)
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


class PaperRHC(rhc.RHC):
    """The controller for a loop of one's own: `prepare()`, then `feedback(…)`.

    Args:
        q: valid.Weights Q_k of (x, y, θ).
        r: Weight R of ω.
        qn_factor: Q_N = qn_factor · Q_k.
        omega_max: Bound on ω [rad/s], eq. (16).
        dt: Length of a sample [s].
        horizon: valid.Intervals of the prediction.
        qp: valid.Solver of the QP, see Scenario.

    Raises:
        ValueError: In one sentence, for an argument that cannot be.
    """

    @valid.checked
    def __init__(
        self,
        *,
        q: valid.Weights = paper.Q3,
        r: valid.Positive = paper.R,
        qn_factor: valid.NotNegative = paper.QN_FACTOR,
        omega_max: valid.Positive = paper.OMEGA_MAX_RADPS,
        dt: valid.Positive = paper.DT_S,
        horizon: valid.Intervals = paper.HORIZON,
        qp: valid.Solver = "structured",
    ):
        horizon_ = horizon_of(horizon, qp, dt)
        limits = dict(lower=(-omega_max,), upper=(omega_max,))
        self._begin(horizon_, q, (r,), qn_factor, limits)
        x, p, x_ref, (omega_ref,) = self._inputs.values()
        self._given = x, p, x_ref, omega_ref
        self._plan = memoryview(self.iteration.arrays["u_plan"])  # whose entries are floats at once

    def feedback(self, pose: Any, p: Any, xi_ref: Any, omega_ref: Any) -> float:
        """Yaw rate [rad/s] to command, eq. (13).

        Args:
            pose: (3,) estimated (x, y, θ).
            p: (3,) estimated (ν, μ, κ).
            xi_ref: (3, N+1) desired poses, eq. (17)-(18); node 0 is now and has no weight.
            omega_ref: (N,) desired yaw rates.

        Returns:
            The first of the planned yaw rates.
        """
        self._give_pose(pose, p, xi_ref, omega_ref)
        self.iteration.feedback()
        return self._plan[0]

    def solve(self, pose: Any, p: Any, xi_ref: Any, omega_ref: Any, iterations: int = 20) -> float:
        """`feedback`, iterated to convergence on the nonlinear problem.

        Args:
            pose: (3,) estimated (x, y, θ).
            p: (3,) estimated (ν, μ, κ).
            xi_ref: (3, N+1) desired poses.
            omega_ref: (N,) desired yaw rates.
            iterations: Gauss-Newton steps.

        Returns:
            The first of the planned yaw rates.
        """
        self._give_pose(pose, p, xi_ref, omega_ref)
        self.iteration.solve(iterations)
        return self._plan[0]

    def _give_pose(self, pose, p, xi_ref, omega_ref):
        x, p_hat, x_ref, u_ref = self._given
        copy_checked("pose", pose, x)
        copy_checked("p", p, p_hat)
        copy_checked("xi_ref", xi_ref, x_ref)
        copy_checked("omega_ref", omega_ref, u_ref)
        self._start_once()

    @property
    def omega_plan(self) -> np.ndarray:
        """Planned yaw rates (N,) [rad/s]."""
        return self.iteration.arrays["u_plan"].copy()

    @property
    def xi_plan(self) -> np.ndarray:
        """Predicted poses (3, N+1)."""
        return self.x_plan
