"""How far a robot drives and turns by its encoders, and how often its sensors measure."""

import numpy as np
import pandas as pd

from rhec.simulation.columns import MEASUREMENTS

_ENCODERS = MEASUREMENTS[2:]
LEAST_TURNED_RAD = 6.0  # by the encoders; a log that turns less does not determine κ
_TURNING_S = 4.0  # turns are summed over such windows, in which the encoders' noise cancels
MOVING = 0.05  # encoder speed of a moving robot [m/s, rad/s]


def moves(rows):
    """Whether the robot moves by its encoders in each row or sample, a Series."""
    return (rows[_ENCODERS].abs() > MOVING).any(axis=1)


def travelled(rows, column, window_s=None):
    """How far a robot moves in a log: Σ |speed · time|, or of the sums over windows.

    The time is that since the last row in which this sensor measured, at most a second: rows of
    other sensors in between do not count.

    Args:
        rows: Rows of a Recording.
        column: Name of a speed [m/s] or yaw rate [rad/s].
        window_s: Length of the windows [s], in which noise and motion to and fro cancel.
    """
    segment, t_s, speed, step_s = _measured(rows, column)
    moves = np.nan_to_num(speed * np.minimum(step_s, 1.0))
    if window_s:
        windows = np.array([segment, t_s // window_s])
        begins = (np.diff(windows, prepend=np.nan) != 0).any(axis=0)
        moves = np.add.reduceat(moves, np.flatnonzero(begins))
    return float(np.abs(moves).sum())


def turned_rad(rows):
    """How far the tracks turn a robot in all, to the left and to the right, without their noise."""
    return travelled(rows, _ENCODERS[1], _TURNING_S)


def period_s(rows, column):
    """Median time between the measurements of a column [s]; NaN with fewer than two."""
    *_, step_s = _measured(rows, column)
    return float(pd.Series(step_s).median())


def _measured(rows, column):
    """Segments, times [s] and numbers of a column, and times since the one before, (n,) each."""
    columns = rows[["segment", "t_s", column]].to_numpy()
    segment, t_s, number = columns[np.isfinite(columns[:, 2])].T
    is_next = np.diff(segment, prepend=np.nan) == 0
    return segment, t_s, number, np.where(is_next, np.diff(t_s, prepend=np.nan), np.nan)
