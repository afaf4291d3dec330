"""Extended Kalman filter of any Model: the joint state (x, p), parameters as random walks.

The filter does not keep the parameters within their bounds. The measurements of an interval's
inputs enter its prediction, with their noise. There is no gate: an outlier counts as any other
measurement. The RHE has one (`rhec.core.estimator.innovation_gate`).
"""

from typing import Any

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.build import with_packed_memory
from rhec.core._casadi.validation import NotNegatives, Positive, Positives, Reals, checked
from rhec.core.estimator.estimate import joint_estimate, joint_guess, noise_of, noise_shapes
from rhec.core.estimator.filter import Filter, Noise, where_defined
from rhec.core.model import robot_model
from rhec.core.model.integration import refuse_unstable_step
from rhec.core.model.known import checked_known
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE
from rhec.core.model.robot_model import Model
from rhec.core.solver.rti import NO_SAMPLE, OneCall, copy_checked


def build(model, dt_s):
    """The filter as {step: Function (memory, z_N, V, c, W) -> (memory, estimate, …)}."""
    kalman = Filter(where_defined(robot_model.interval(model)), dt_s)
    shapes = dict(z_N=(len(model.sampled), 1), noise=noise_shapes(model), W=(model.n_s, 1))

    @with_packed_memory("ekf_step", kalman.memory_shapes, ca.SX, **shapes)
    def step(z_N, noise, W, **memory):
        after = kalman.sample(z_N, Noise(W=W, **noise), **memory)
        values = dict(zip(model.inputs, ca.vertsplit(after.v)))
        values |= dict(zip(model.joint_names, ca.vertsplit(after.m)))
        estimate = ca.vertcat(*(values[name] for name in model.names))
        results = dict(estimate=estimate, covariance=after.P, deviance=after.deviance)
        # The interval that begins at this sample has the known signals of this sample.
        v = kalman.interval.with_known(after.v, z_N)
        return results | after.memory | dict(v=v)

    return dict(step=step)


class EKF(OneCall):
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
        u = np.zeros(len(model.acting))
        refuse_unstable_step(model, guess[:n_x], u, guess[n_x:], dt, sigma_guess[n_x:])
        self._call = compiled.BufferedFunction(compiled.load(build, model, dt)["step"])
        self.settings = noise_of(model, sigma_v, sigma_w)
        P = np.diag(np.square(sigma))
        self.first_memory = np.array([*m, *P.ravel(), *np.zeros(len(model.acting)), 0.0])
        self._call.set(**self.settings)
        n_z = len(model.outputs)
        self._z = self._call.arguments["z_N"][:n_z]
        self._known = self._call.arguments["z_N"][n_z:, None]
        self._known[:] = np.nan
        self.restart()

    def __repr__(self) -> str:
        return f"EKF, dt {self.dt_s:g} s\n{self.model}"

    def restart(self) -> None:
        """Let the next sample be the first, which corrects the first guess."""
        self._call.set(memory=self.first_memory)
        self._started = False

    def prepare(self) -> None:
        """Do nothing: the filter does all its work in `feedback`."""

    @property
    def ok(self) -> bool:
        """Whether the last estimate and its covariance are made of plausible numbers.

        Before the first sample there is no estimate.
        """
        if not self._started:
            return False
        results = self._call.results
        numbers = np.concatenate([results["estimate"], results["covariance"]])
        return bool(np.all(np.abs(numbers) <= MAX_PLAUSIBLE_STATE))

    @property
    def status(self) -> str:
        """Why the last estimate was not `ok`, as a sentence; empty if it was."""
        if self.ok:
            return ""
        if not self._started:
            return NO_SAMPLE
        return "the estimate or its covariance is not plausible; restart() starts from the guess"

    def feedback(self, z: Any, known: Any = None) -> Any:
        """Estimate from the newest measurement.

        Args:
            z: (n_z,) measurements; an entry that is not finite counts as missing.
            known: {name: number} of the Model's known signals; what is not given, or is no finite
                number, is as at the last sample.

        Returns:
            Estimate: x (n_x,), u (n_u,), p (n_p,), covariance of (x, p).
        """
        arguments = self._call.arguments
        results = self._call.results
        n_s = self.model.n_s
        known = checked_known(self.model.known, known, self._known)
        copy_checked("z", z, self._z)
        self._known[:] = known
        self._call.call()
        self._started = True
        arguments["memory"][:] = results["memory"]
        covariance = results["covariance"].reshape(n_s, n_s).copy()
        return joint_estimate(self.model, results["estimate"].copy(), covariance)
