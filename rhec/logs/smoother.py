"""Fixed-interval smoother: the estimate of each sample from all measurements, also later ones.

It is the receding horizon estimator with the whole segment as its window, without bounds: iterated
Gauss-Newton steps, each of which is a Kalman filter forwards and a Rauch-Tung-Striebel smoother
backwards, linearised at the previous trajectory (Särkkä, "Bayesian Filtering and Smoothing", 2013,
Sec. 9.1). The first trajectory is that of the replay, which also decides which measurements count.
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core._casadi.build import with_packed_memory
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator.base import noise_shapes
from rhec.core.estimator.filter import Filter, Noise
from rhec.core.model import base
from rhec.tracked_robot.sensors import with_sensors

_ITERATIONS = 3
# Errors of recorded positions and slip last longer than a sample. A smoother averages over more
# samples than a filter does, so that its standard deviations have to be larger by this factor.
_CORRELATED = 1.4
_LEAST_VARIANCE = 1e-14  # of predicted states, so that their covariance has an inverse


def ages_of(age_s, n_z):
    """Ages (n_z,) of the measurements, of which only the position is late, by age_s [s]."""
    return ca.vertcat(age_s, age_s, ca.SX.zeros(n_z - 2))


def _build_filter(speed_model, names):
    """The scan of a Kalman filter that is linearised at a given trajectory.

    Its step takes the measurements z, with the age of the position [s] as last entry; the settings
    V, c, W; and the joint states s_before and s_now of the trajectory at both ends of the interval.
    """
    model = with_sensors(speed_model, names).model
    n_z = len(model.outputs)
    kalman = Filter(base.interval(model), paper.DT_S)
    streamed = dict.fromkeys(["s_before", "s_now"], (model.n_s, 1))
    shapes = dict(z_N=(n_z + 1, 1), noise=noise_shapes(model), W=(model.n_s, 1), **streamed)

    @with_packed_memory("smoothed", kalman.memory_shapes, ca.SX, **shapes)
    def step(z_N, noise, W, s_before, s_now, **memory):
        ages_s = ages_of(z_N[n_z], n_z)
        noise = Noise(W=W, **noise)
        after = kalman.sample(
            z_N[:n_z], noise, **memory, ages_s=ages_s, trajectory=(s_before, s_now)
        )
        predicted = dict(m_predicted=after.m_predicted, P_predicted=after.P_predicted, A=after.A)
        return dict(estimate=after.m, covariance=after.P) | predicted | after.memory

    outputs = ["estimate", "covariance", "m_predicted", "P_predicted", "A"]
    return runner.build_recorded(step, outputs, [*streamed])


def smoothed(choice, settings, sigma_first, trajectory, z, age_s):
    """Smoothed joint states of a segment and their standard deviations, both (n, n_s).

    Args:
        choice: The Choice of the replay.
        settings: Its settings, {name: array}.
        sigma_first: (n_s,) standard deviations of the first joint state of the trajectory.
        trajectory: (n, n_s) joint states at which to begin.
        z: (n, n_z) measurements, NaN where they do not count.
        age_s: (n,) ages of the positions [s].
    """
    functions = compiled.load(_build_filter, choice.speed_model, choice.sensors)
    model = with_sensors(choice.speed_model, choice.sensors).model
    P_first = np.diag(np.square(sigma_first))
    begin = dict(m=trajectory[0], P=P_first, v=np.zeros(len(model.inputs)), started=0.0)
    s = trajectory
    for _ in range(_ITERATIONS):
        stream = np.column_stack([z, age_s, np.vstack([s[:1], s[:-1]]), s])
        recorded = runner.record(functions, pack_array(begin), stream, settings)
        s, P = _backwards(recorded)
    return s, _CORRELATED * np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0))


def _backwards(recorded):
    """The Rauch-Tung-Striebel smoother.

    s_k = m_k + G (s_{k+1} - m⁻_{k+1}),  P_k^s = P_k + G (P^s_{k+1} - P⁻_{k+1}) G',
    G = P_k A' (P⁻_{k+1})⁻¹
    """
    s = recorded["estimate"].copy()
    P = recorded["covariance"].copy()
    m_predicted = recorded["m_predicted"]
    P_predicted = recorded["P_predicted"]
    scale = np.sqrt(np.maximum(np.diagonal(P_predicted, axis1=1, axis2=2), _LEAST_VARIANCE))
    normalised = P_predicted / (scale[:, :, None] * scale[:, None, :])
    normalised += 1e-12 * np.eye(s.shape[1])
    inverse = np.linalg.inv(normalised) / (scale[:, :, None] * scale[:, None, :])
    gains = P[:-1] @ recorded["A"][1:].swapaxes(1, 2) @ inverse[1:]
    for k in range(len(s) - 2, -1, -1):
        G = gains[k]
        s[k] += G @ (s[k + 1] - m_predicted[k + 1])
        P[k] += G @ (P[k + 1] - P_predicted[k + 1]) @ G.T
    return s, P
