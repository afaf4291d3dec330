"""Extended Kalman filter of any Model: the joint state (x, p), parameters as random walks.

The filter does not keep the parameters within their bounds. The measurements of an interval's
inputs enter its prediction, with their noise. There is no gate: an outlier counts as any other
measurement. The RHE has one (`rhec.core.estimator.innovation_gate`).
"""

from typing import Any

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.build import every, with_packed_memory
from rhec.core._casadi.validation import NotNegatives, Positive, Positives, Reals, checked
from rhec.core.estimator import kalman
from rhec.core.estimator.base import joint_estimate, joint_guess, noise_of
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.core.model.integration import refuse_start
from rhec.core.solver.gauss_newton import symmetric
from rhec.core.solver.rti import copy_checked


def predict_and_correct(m, P, predicted, A, Q, started, z, V, outputs):
    """One sample of a Kalman filter, eq. (24)-(26); the first sample only corrects.

        m⁻ = predicted,  P⁻ = A P A' + Q,  then `kalman.update` by z.

    Here m (n,) and P (n, n) are mean and covariance, `predicted` (n,) is the mean after the
    interval, and A and Q (n, n) are its transition and process noise. Measurements z have the
    variances V. Returns m, P, and the deviance of the measurements.
    """
    m = ca.if_else(started, predicted, m)
    P = ca.if_else(started, symmetric(A @ P @ A.T) + Q, P)
    updated = kalman.update(m, P, z, V, outputs, m)
    return updated.m, updated.P, updated.deviance


def _transition(interval, m, v, dt_s):
    """The state F after an interval, and its slopes A and B in m and v.

    Where the model has none, such as sqrt(x) for x < 0, the state is expected to stay as it is.
    Measurements can then take it back to where the model is defined.
    """
    F, D, B = interval.linearised(m, v, dt_s)
    is_defined = every(ca.fabs(ca.veccat(F, D, B)) < np.inf)
    F = ca.if_else(is_defined, F, m)
    A = ca.if_else(is_defined, interval.A_0 + D, ca.DM.eye(interval.n_s))
    B = ca.if_else(is_defined, B, 0)
    return F, A, B


def build(model, dt_s):
    """The filter as {step: Function (memory, z_N, V, c, W) -> (memory, estimate, …)}."""
    interval = base.interval(model)
    n_z = len(model.outputs)
    n_s = interval.n_s
    # v holds the last inputs.
    memory = dict(m=(n_s, 1), P=(n_s, n_s), v=(interval.n_v, 1), started=(1, 1))
    noise = dict(V=(n_z, 1))
    if model.motion_noise:
        noise["c"] = (len(model.motion_noise.constants), 1)

    @with_packed_memory("ekf_step", memory, ca.SX, z_N=(n_z, 1), noise=noise, W=(n_s, 1))
    def step(m, P, v, started, z_N, noise, W):
        v, R_v = interval.input_noise(z_N, v, **noise)
        F, A, B = _transition(interval, m, v, dt_s * started)
        Q = symmetric(B @ ca.diag(R_v) @ B.T)
        Q += ca.diag(interval.process_noise(v, W, dt_s, noise.get("c")))
        V = noise["V"]
        m, P, deviance = predict_and_correct(m, P, F, A, Q, started, z_N, V, interval.outputs)
        values = dict(zip(model.inputs, ca.vertsplit(v)))
        values |= dict(zip(model.joint_names, ca.vertsplit(m)))
        estimate = ca.vertcat(*(values[name] for name in model.names))
        return dict(estimate=estimate, covariance=P, deviance=deviance, m=m, P=P, v=v, started=1)

    return dict(step=step)


class EKF:
    """The filter in a user's own loop, with the methods of RHE: `prepare()`, `feedback(z)`.

    It has no innovation gating: an outlier counts as any other measurement. `rhec.RHE` gates.

    Args:
        model: The robot, a rhec.Model.
        dt: Length of a sample [s].
        sigma_v: Standard deviation of each output's measurement, in the output's unit.
        sigma_w: Standard deviations of the process noise per sample, of each state, then of each
            parameter.
        guess: First guess of each state, then of each parameter.
        sigma_guess: Standard deviations of the guess.

    Raises:
        ValueError: If an argument is invalid.
    """

    @checked
    def __init__(
        self,
        *,
        model: Model,
        dt: Positive,
        sigma_v: Positives,
        sigma_w: NotNegatives,
        guess: Reals,
        sigma_guess: Positives,
    ):
        self.model = model
        self.dt_s = dt
        m, sigma = joint_guess(model, guess, sigma_guess)
        n_x = len(model.states)
        refuse_start(model, guess[:n_x], np.zeros(len(model.inputs)), guess[n_x:], dt)
        self._call = compiled.BufferedFunction(compiled.load(build, model, dt)["step"])
        self.settings = noise_of(model, sigma_v, sigma_w)
        P = np.diag(np.square(sigma))
        self.first_memory = np.array([*m, *P.ravel(), *np.zeros(len(model.inputs)), 0.0])
        self._call.set(memory=self.first_memory, **self.settings)

    def __repr__(self) -> str:
        return f"EKF, dt {self.dt_s:g} s\n{self.model}"

    def prepare(self) -> None:
        """Do nothing: the filter does all its work in `feedback`."""

    def feedback(self, z: Any) -> Any:
        """Estimate from the newest measurement.

        Args:
            z: (n_z,) measurements; an entry that is not finite counts as missing.

        Returns:
            Estimate: x (n_x,), u (n_u,), p (n_p,), covariance of (x, p).
        """
        arguments = self._call.arguments
        results = self._call.results
        n_s = self.model.n_s
        copy_checked("z", z, arguments["z_N"])
        self._call.call()
        arguments["memory"][:] = results["memory"]
        covariance = results["covariance"].reshape(n_s, n_s).copy()
        return joint_estimate(self.model, results["estimate"].copy(), covariance)
