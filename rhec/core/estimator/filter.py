"""The Kalman filter of any Model. EKFs, oracles, calibrations and smoothers are its choices.

A sample has three steps: the state is predicted over the interval that ends at the sample, late
measurements are moved to the sample, and all measurements correct the prediction.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import every
from rhec.core.estimator import kalman
from rhec.core.model.robot_model import Interval
from rhec.core.solver.box_qp import box_qp
from rhec.core.solver.gauss_newton import symmetric


class Noise(NamedTuple):
    """The noise of a Model, as variances."""

    V: Any  # (n_z,) of the measurements
    W: Any  # (n_s,) of the process, per sample
    c: Any = None  # constants of the noise by motion, if the Model has any
    held: Any = None  # of an input that was not measured; None: as the Model says


class Sample(NamedTuple):
    """What the filter yields at a sample."""

    m: Any  # (n_s,) mean of the joint state, from all measurements so far
    P: Any  # (n_s, n_s) its covariance
    v: Any  # (n_v,) inputs of the interval that ends at the sample
    m_predicted: Any  # (n_s,) mean before the measurements of this sample
    P_predicted: Any  # (n_s, n_s)
    A: Any  # (n_s, n_s) slope of the interval
    deviance: Any  # how improbable the measurements were, as `correct` tells

    @property
    def memory(self):
        """The memory for the next sample, by the names of `Filter.memory_shapes`."""
        return dict(m=self.m, P=self.P, v=self.v, started=1)


class Filter(NamedTuple):
    """A Kalman filter of a Model, and what distinguishes it from others."""

    interval: Interval  # of the Model; `where_defined` is one for any Model
    dt_s: float  # length of a sample [s]
    # How the measurements correct the prediction: `kalman.update`, or a function with the same
    # arguments and result in which outliers count less.
    correct: Callable[..., kalman.Update] = kalman.update
    # {place in the joint state: (lowest, highest)} within which the mean is kept
    bounds: Mapping[int, tuple[float, float]] = {}

    @property
    def memory_shapes(self):
        """Shapes of mean, covariance and last inputs; `started` is 0 before the first sample."""
        n_s = self.interval.n_s
        return dict(m=(n_s, 1), P=(n_s, n_s), v=(self.interval.n_v, 1), started=(1, 1))

    def sample(self, z, noise, m, P, v, started, ages_s=None, trajectory=None):
        """The Sample at the measurements z (n_z,), which are NaN where there is none.

            m⁻ = F + A (m - s),  P⁻ = A P A' + B R B' + W,  then `correct`

        F is the end of the interval from s with the inputs v, which have the variances R; A and B
        are its slopes. A filter linearises at its own estimate, s = m. The first sample only
        corrects.

        Args:
            z: (n_z,) measurements.
            noise: The Noise.
            m: (n_s,) mean after the last sample.
            P: (n_s, n_s) its covariance.
            v: (n_v,) last inputs. Those that have no output of their own keep these values.
            started: 0 before the first sample, else 1.
            ages_s: (n_z,) ages of the measurements [s], if some are older than the sample.
            trajectory: The joint states (s_before, s_now) at both ends of the interval at which a
                smoother linearises; by default m and m⁻.
        """
        interval = self.interval
        v, R = interval.input_noise(z, v, noise.V, noise.c, noise.held)
        W = interval.process_noise(v, noise.W, self.dt_s, noise.c)
        s, s_now = trajectory or (m, None)
        F, D, B = interval.linearised(s, v, self.dt_s)
        A = interval.A_0 + D
        m_predicted = F + A @ (m - s)
        Q = symmetric(B @ ca.diag(R) @ B.T) + ca.diag(W)
        P_predicted = symmetric(A @ P @ A.T) + Q
        if ages_s is not None:
            z = self._at_sample(z, ages_s, s, F, v, started)
        m = ca.if_else(started, m_predicted, m)
        P = ca.if_else(started, P_predicted, P)
        at = m if s_now is None else s_now
        after = self.correct(m, P, z, noise.V, interval.outputs, at)
        bounded = within_bounds(self.bounds, after.m, after.P)
        return Sample(bounded, after.P, v, m, P, A, after.deviance)

    def _at_sample(self, z, ages_s, s, F, v, started):
        """The measurements z, each plus the change that the model predicts since it was made.

        z + h(F) - h(state at dt_s - age) of each output, in an interval from s to F.
        """
        moved = ca.vertsplit(z)
        for output in self.interval.outputs:
            age_s = ages_s[output.row]
            then = self.interval.step(s, v, self.dt_s - age_s)
            since = started * (output.value(F, z) - output.value(then, z))
            moved[output.row] += ca.if_else(age_s > 0, since, 0)
        return ca.vertcat(*moved)


def where_defined(interval):
    """The Interval of a Model that is not defined everywhere, such as one with √x.

    Where it has no finite end or slopes, the state is expected to stay as it is. Measurements can
    then take it back to where the Model is defined.
    """
    s = ca.SX.sym("s", interval.n_s)
    v = ca.SX.sym("v", interval.n_v)
    dt_s = ca.SX.sym("dt_s")
    F, D, B = interval.linearised(s, v, dt_s)
    is_defined = every(ca.fabs(ca.veccat(F, D, B)) < np.inf)
    F = ca.if_else(is_defined, F, s)
    A = ca.if_else(is_defined, interval.A_0 + D, ca.DM.eye(interval.n_s))
    B = ca.if_else(is_defined, B, 0)
    linearised = ca.Function("where_defined", [s, v, dt_s], [F, A, B], {"cse": True})
    return interval._replace(linearised=linearised, A_0=ca.DM(interval.n_s, interval.n_s))


def within_bounds(bounds, m, P):
    """The likeliest state within the bounds {place: (lowest, highest)} of a Gaussian (m, P).

    With q the bounded states and H = P_qq⁻¹: min ½ (q - m_q)' H (q - m_q) within the bounds; the
    other states are conditioned on q, m - P_xq H (m_q - q). P does not change, as in the RHE.
    """
    if not bounds:
        return m
    places = [*bounds]
    lower, upper = (ca.DM([bound[side] for bound in bounds.values()]) for side in (0, 1))
    # The information of q alone, with the other states marginalised.
    H = ca.inv_minor(P[places, places])
    q, _ = box_qp(len(places))(H, -H @ m[places], lower, upper)
    m = m - P[:, places] @ H @ (m[places] - q)
    m[places] = q  # exactly, without rounding
    return m
