"""Fixed-interval smoother: the estimate of each sample from all measurements, also later ones.

It is the receding horizon estimator with the whole segment as its window, without bounds: iterated
Gauss-Newton steps, each of which is a Kalman filter forwards and a Rauch-Tung-Striebel smoother
backwards, linearised at the previous trajectory (Särkkä, "Bayesian Filtering and Smoothing", 2013,
Sec. 9.1). The first trajectory is that of the replay, which also decides which measurements count.
"""

import numpy as np

from rhec.logs import filtering
from rhec.logs.filtering import Loss

_ITERATIONS = 3
# Errors of recorded positions and slip last longer than a sample. A smoother averages over more
# samples than a filter does, so that its standard deviations have to be larger by this factor.
_CORRELATED = 1.4
_LEAST_VARIANCE = 1e-14  # of predicted states, so that their covariance has an inverse


def smoothed(model, dt_s, settings, sigma_first, trajectory, stream):
    """Smoothed joint states of a segment and their standard deviations, both (n, n_s).

    Args:
        model: The Model.
        dt_s: Length of a sample [s].
        settings: Its noise, {name: array}.
        sigma_first: (n_s,) standard deviations of the first joint state of the trajectory.
        trajectory: (n, n_s) joint states at which to begin.
        stream: (n, 2 n_z), as of `recording.with_ages`; NaN where a measurement does not count.
    """
    first = (trajectory[0], sigma_first)
    s = trajectory
    for _ in range(_ITERATIONS):
        recorded = filtering.run(model, dt_s, Loss.SQUARE, stream, first, settings, s)
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
