"""The white noise of a log's positions, estimated from the log itself.

White noise of variance σ² has third differences of variance 20 σ² (von Neumann, 1941), and a smooth
path has hardly any at 5 Hz: motion can only increase the estimate. Errors that wander over seconds
are not in it. A receiver's own covariance tells them.
"""

import numpy as np
from scipy.stats import chi2

from rhec import paper
from rhec.simulation.columns import MEASUREMENTS

LEAST_M = paper.SIGMA_V[0]  # a smaller noise is not told apart from the errors of the model
_MOVING = 0.05  # encoder speed of a moving robot [m/s, rad/s]
_MOST_APART = 2.5  # a gap of the positions, over their median period
_LEAST = 20  # differences; fewer tell nothing


def position_sigma_m(rows):
    """Standard deviation of the white noise of positions.

    Args:
        rows: Rows of a Recording.

    Returns:
        The standard deviation of x and of y [m], at least LEAST_M, which is also the answer where
        a log has too few positions.
    """
    parts = [_third_differences(part) for _, part in rows.groupby("segment")] or [np.zeros(0)]
    squares = np.concatenate(parts) ** 2 / 20
    if len(squares) < _LEAST:
        return LEAST_M
    return max(float(np.sqrt(np.median(squares) / chi2.median(2))), LEAST_M)


def _third_differences(rows):
    """Sizes of the third differences [m] of positions without a gap, while the robot moves."""
    speeds = rows[MEASUREMENTS[2:]].interpolate(limit_direction="both")
    x, y = rows[MEASUREMENTS[:2]].to_numpy().T
    known = np.isfinite(x + y)
    moves = (speeds.abs() > _MOVING).any(axis=1).to_numpy()[known]
    step_s = np.diff(rows["t_s"].to_numpy()[known])
    if len(step_s) < 3:
        return np.zeros(0)
    is_dense = step_s <= _MOST_APART * np.median(step_s)
    counts = is_dense[2:] & is_dense[1:-1] & is_dense[:-2]
    counts &= moves[3:] & moves[2:-1] & moves[1:-2] & moves[:-3]
    return np.abs(np.diff((x + 1j * y)[known], 3))[counts]
