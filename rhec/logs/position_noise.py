"""The white noise of a log's positions, estimated from the log itself.

White noise of variance σ² has third differences of variance 20 σ² (von Neumann, 1941), and a smooth
path has hardly any at 5 Hz. Errors that wander over seconds do not show there. A receiver's own
covariance tells them: `declared_m`.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import chdtri

from rhec import paper
from rhec.logs.column_names import DECLARED
from rhec.logs.motion import moves
from rhec.simulation.columns import MEASUREMENTS

LEAST_M = paper.SIGMA_V[0]  # a smaller noise is not told apart from the errors of the model
_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
_MOST_APART = 1.5  # time between two positions, over its median
_POINTS = 4  # of a third difference
_LEAST = 20  # differences; fewer tell nothing


def position_sigma_m(rows):
    """Standard deviation of the white noise of positions.

    Args:
        rows: Rows of a Recording.

    Returns:
        The standard deviation of x and of y [m], at least LEAST_M, which is also the answer where
        a log has too few positions.
    """
    squares = np.concatenate([_squares(part) for _, part in rows.groupby("segment")])
    if len(squares) < _LEAST:
        return LEAST_M
    return max(float(np.sqrt(np.median(squares) / chdtri(2, 0.5))), LEAST_M)


def _squares(part):
    """Squares of the third differences of a segment over 20 [m²], of a robot that moves."""
    has_position = part[_POSITION[0]].notna().to_numpy()
    if has_position.sum() < _POINTS:
        return np.empty(0)
    speeds = part[_ENCODERS].interpolate(limit_direction="both")
    drives = moves(speeds).to_numpy()[has_position]
    step_s = np.diff(part["t_s"].to_numpy()[has_position])
    is_dense = step_s <= _MOST_APART * np.median(step_s)
    dense_throughout = sliding_window_view(is_dense, _POINTS - 1).all(axis=1)
    drives_throughout = sliding_window_view(drives, _POINTS).all(axis=1)
    thirds = np.diff(part[_POSITION].to_numpy()[has_position], n=_POINTS - 1, axis=0)
    return (thirds**2).sum(axis=1)[dense_throughout & drives_throughout] / 20


def declared_m(rows):
    """Standard deviation of the positions by their receiver [m], 0 if it declares none.

    Errors that wander for minutes show there, but not in the positions themselves.

    Args:
        rows: Rows of a Recording.
    """
    declared = rows[DECLARED].median() if DECLARED in rows else 0.0
    return float(declared) if declared > 0 else 0.0
