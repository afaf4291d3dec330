"""The Kalman filter of a recorded log, of any Model: calibrations and the smoother are its choices.

It is scanned over the samples of a segment. How far a measurement may count is a `Loss`.
"""

from enum import Enum

import casadi as ca
import numpy as np
from scipy.special import chdtri

from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core._casadi.build import with_packed_memory
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import kalman
from rhec.core.estimator.estimate import noise_shapes
from rhec.core.estimator.filter import Filter, Noise
from rhec.core.model import robot_model

OUTLIER = 1.5  # standard deviations from which on a position counts less
_OUTLIERS = 1e-3  # share of good samples that count less by the logarithm


class Loss(Enum):
    """By what an innovation counts in the likelihood of a log."""

    SQUARE = "every measurement as it is"
    HUBER = "positions far away in proportion to their distance"
    LOGARITHM = "samples far away by the logarithm of their distance"


def _correct_robustly(n, limit, tail):
    """`kalman.update` in which the first n outputs may be an outlier together.

    With d = y' S⁻¹ y of these their deviance is c ρ(d/c) + log det S, with the limit c of d, ρ(r)
    = r up to 1, and then tail(r). The other outputs, which count as they are, correct first.
    """

    def correct(m, P, z, V, outputs, s_bar):
        before = kalman.update(m, P, z, V, outputs[n:], s_bar)
        plain = kalman.update(before.m, before.P, z, V, outputs[:n], before.m)
        far = plain.distance / limit
        loss = limit * ca.if_else(far < 1, far, tail(ca.fmax(far, 1)))
        loss += plain.deviance - plain.distance + before.deviance
        # Such a loss gives an outlier the weight of a measurement with a variance larger by d/c.
        updated = kalman.update(before.m, before.P, z, V * ca.fmax(far, 1), outputs[:n], before.m)
        return updated._replace(deviance=loss)

    return correct


def _correction(loss, n):
    """How a Filter with n outputs corrects by its measurements."""
    if loss is Loss.SQUARE:
        return kalman.update
    if loss is Loss.HUBER:
        return _correct_robustly(2, OUTLIER**2, lambda far: 2 * ca.sqrt(far) - 1)
    limit = float(chdtri(max(n, 1), _OUTLIERS))
    return _correct_robustly(n, limit, lambda far: 1 + ca.log(far))


_FILTERED = ("estimate", "variances", "loss")
_SMOOTHED = ("estimate", "covariance", "m_predicted", "P_predicted", "A")


def build(model, dt_s, loss, along_trajectory=False):
    """The scan of a Model's Kalman filter over samples of a log.

    A row of its stream is that of `recording.with_ages`. The filter records _FILTERED: the mean
    of the joint state, its variances and the loss. Or it is linearised along a given trajectory,
    whose joint states s_before and s_now at both ends of the interval follow in the stream, and
    records _SMOOTHED, which a smoother needs.
    """
    n_z = len(model.outputs)
    recorded = _SMOOTHED if along_trajectory else _FILTERED
    interval = robot_model.interval(model)
    kalman_filter = Filter(interval, dt_s, _correction(loss, len(interval.outputs)))
    streamed = dict.fromkeys(["s_before", "s_now"] if along_trajectory else [], (model.n_s, 1))
    shapes = dict(z_N=(2 * n_z, 1), noise=noise_shapes(model), W=(model.n_s, 1), **streamed)

    @with_packed_memory("filtered", kalman_filter.memory_shapes, ca.SX, **shapes)
    def step(z_N, noise, W, s_before=None, s_now=None, **memory):
        trajectory = (s_before, s_now) if along_trajectory else None
        noise = Noise(W=W, **noise)
        after = kalman_filter.sample(
            z_N[:n_z], noise, **memory, ages_s=z_N[n_z:], trajectory=trajectory
        )
        results = dict(estimate=after.m, variances=ca.diag(after.P), loss=after.deviance)
        results |= dict(covariance=after.P, A=after.A)
        results |= dict(m_predicted=after.m_predicted, P_predicted=after.P_predicted)
        return {name: results[name] for name in recorded} | after.memory

    return runner.build_recorded(step, recorded, [*streamed])


def run(model, dt_s, loss, stream, first, settings, trajectory=None):
    """What the filter of `build` records in a segment, {name: array}.

    Args:
        model: The Model.
        dt_s: Length of a sample [s].
        loss: The Loss.
        stream: (n, 2 n_z), as of `recording.with_ages`.
        first: Mean and standard deviations, (n_s,) each, of the joint state before the first
            sample.
        settings: {name: array}: V, W, and c if the Model has noise by motion.
        trajectory: (n, n_s) joint states at which to linearise; by default the filter's own.
    """
    mean, sigma = first
    begin = dict(m=mean, P=np.diag(np.square(sigma)), v=np.zeros(len(model.inputs)), started=0.0)
    functions = compiled.load(build, model, dt_s, loss, trajectory is not None)
    if trajectory is not None:
        before = np.vstack([trajectory[:1], trajectory[:-1]])
        stream = np.column_stack([stream, before, trajectory])
    return runner.record(functions, pack_array(begin), stream, settings)


def last_estimates(model, segments):
    """{name: (mean, standard deviation)} of the joint state at the end of a log.

    They are means over the last samples of all segments, weighted by their inverse variances.

    Args:
        model: The Model.
        segments: What `run` returns, of each segment.
    """
    means = np.array([recorded["estimate"][-1] for recorded in segments])
    variances = np.array([recorded["variances"][-1] for recorded in segments])
    variance = 1 / (1 / variances).sum(axis=0)
    mean = variance * (means / variances).sum(axis=0)
    return dict(zip(model.joint_names, zip(mean, np.sqrt(variance))))
