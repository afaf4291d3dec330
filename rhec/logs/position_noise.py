"""The white noise of a log's positions, estimated from the log itself.

Two estimates are made, each of which motion can only increase; the smaller one counts:

- *Third differences* of successive positions. White noise of variance σ² has third differences of
  variance 20 σ² (von Neumann, 1941), and a smooth path has hardly any at 5 Hz.
- *Registration*: the path by the encoders is turned, scaled and moved for the best fit with a few
  successive positions, together with the place of the antenna. What is left is noise, and slip
  within seconds. It serves where positions are rare.

Errors that wander over seconds are in neither. A receiver's own covariance tells them:
`declared_m`.
"""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.stats import chi2

from rhec import paper
from rhec.logs.recording import DECLARED
from rhec.simulation.columns import MEASUREMENTS

LEAST_M = paper.SIGMA_V[0]  # a smaller noise is not told apart from the errors of the model
_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
_MOVING = 0.05  # encoder speed of a moving robot [m/s, rad/s]
_MOST_APART = 2.5  # a gap of the positions, over their median period
_WINDOW = 7  # positions in a registration
_KAPPAS = (0.4, 0.55, 0.7, 0.85, 1.0)
_LEAST = 20  # differences or windows; fewer tell nothing


def position_sigma_m(rows):
    """Standard deviation of the white noise of positions.

    Args:
        rows: Rows of a Recording.

    Returns:
        The standard deviation of x and of y [m], at least LEAST_M, which is also the answer where
        a log has too few positions.
    """
    paths = [_path(part) for _, part in rows.groupby("segment")]
    paths = [path for path in paths if len(path[0]) > _WINDOW]
    estimates = [_by_third_differences(paths), *(_by_registration(paths, k) for k in _KAPPAS)]
    known = [estimate for estimate in estimates if np.isfinite(estimate)]
    return max(min(known, default=LEAST_M), LEAST_M)


def declared_m(rows):
    """Standard deviation of the positions by their receiver [m], 0 if it declares none.

    Errors that wander for minutes show there, but not in the positions themselves.

    Args:
        rows: Rows of a Recording.
    """
    declared = rows[DECLARED].median() if DECLARED in rows else 0.0
    return float(declared) if declared > 0 else 0.0


def _path(rows):
    """Times [s], positions x + iy [m], distance and turn by the encoders, and whether it moves."""
    t = rows["t_s"].to_numpy()
    speeds = rows[_ENCODERS].interpolate(limit_direction="both").fillna(0.0).to_numpy()
    driven, turned = cumulative_trapezoid(speeds, t, axis=0, initial=0).T
    x, y = rows[_POSITION].to_numpy().T
    known = np.isfinite(x + y)
    moves = (np.abs(speeds) > _MOVING).any(axis=1)
    return t[known], (x + 1j * y)[known], driven[known], turned[known], moves[known]


def _windows(paths, n):
    """Views (windows, n) of times, positions, distances and turns of n successive positions.

    Windows with a gap, or in which the robot stands, are left out.
    """
    parts = []
    for path in paths:
        views = [np.lib.stride_tricks.sliding_window_view(column, n) for column in path]
        longest = np.diff(views[0], axis=1).max(axis=1)
        is_dense = longest <= _MOST_APART * np.median(np.diff(path[0]))
        counts = is_dense & views[4].all(axis=1)
        parts.append([view[counts] for view in views[:4]])
    return [np.concatenate(columns) for columns in zip(*parts)] if parts else [np.zeros((0, n))] * 4


def _sigma(squares, degrees):
    """σ from sums of squares with so many degrees of freedom each, by their median."""
    if len(squares) < _LEAST:
        return np.nan
    return float(np.sqrt(np.median(squares) / chi2.median(degrees)))


def _by_third_differences(paths):
    _, positions, *_ = _windows(paths, 4)
    return _sigma(np.abs(np.diff(positions, 3, axis=1)[:, 0]) ** 2 / 20, 2)


def _by_registration(paths, kappa):
    """σ of what is left of the positions p = c + s D + a e^{iθ}, with θ and D by the encoders.

    The place c, the turn and scale s, and the antenna's place a are fitted in each window.
    """
    _, p, driven, turned = _windows(paths, _WINDOW)
    theta = kappa * (turned - turned[:, :1])
    middle = np.exp(0.5j * (theta[:, 1:] + theta[:, :-1]))
    steps = np.diff(driven, axis=1) * middle
    D = np.concatenate([np.zeros((len(p), 1)), np.cumsum(steps, axis=1)], axis=1)
    x = np.stack([np.ones_like(D), D, np.exp(1j * theta)], axis=2)
    q = np.linalg.qr(x)[0]
    left = p[:, :, None] - q @ (q.conj().swapaxes(1, 2) @ p[:, :, None])
    return _sigma(np.sum(np.abs(left[:, :, 0]) ** 2, axis=1), 2 * (_WINDOW - x.shape[2]))
