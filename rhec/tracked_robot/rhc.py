"""The paper's receding horizon controller of the tracked robot, eq. (11)-(13), (16), (19)-(22)."""

from typing import Any

import numpy as np

from rhec import paper
from rhec.core._casadi.validation import Intervals, NotNegative, Positive, Solver, Weights, checked
from rhec.core.controller import rhc
from rhec.tracked_robot.kinematics import SPEED_MODELS

__all__ = ["PaperRHC", "horizon_of"]


def horizon_of(N, qp="structured", dt_s=paper.DT_S):
    """The Horizon of the paper's problem: the yaw rate is commanded."""
    return rhc.Horizon(SPEED_MODELS["parameter"].model, (0,), dt_s, N, qp)


class PaperRHC(rhc.RHC):
    """The controller for a loop of one's own: `prepare()`, then `feedback(…)`.

    Args:
        q: Weights Q_k of (x, y, θ).
        r: Weight R of ω.
        qn_factor: Q_N = qn_factor · Q_k.
        omega_max: Bound on ω [rad/s], eq. (16).
        dt: Length of a sample [s].
        horizon: Intervals of the prediction.
        qp: Solver of the QP, see Scenario.

    Raises:
        ValueError: In one sentence, for an argument that cannot be.
    """

    @checked
    def __init__(
        self,
        *,
        q: Weights = paper.Q3,
        r: Positive = paper.R,
        qn_factor: NotNegative = paper.QN_FACTOR,
        omega_max: Positive = paper.OMEGA_MAX_RADPS,
        dt: Positive = paper.DT_S,
        horizon: Intervals = paper.HORIZON,
        qp: Solver = "structured",
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
        rhc.copy_checked("pose", pose, x)
        rhc.copy_checked("p", p, p_hat)
        rhc.copy_checked("xi_ref", xi_ref, x_ref)
        rhc.copy_checked("omega_ref", omega_ref, u_ref)
        self._start_once()

    @property
    def omega_plan(self) -> np.ndarray:
        """Planned yaw rates (N,) [rad/s]."""
        return self.iteration.arrays["u_plan"].copy()

    @property
    def xi_plan(self) -> np.ndarray:
        """Predicted poses (3, N+1)."""
        return self.x_plan
