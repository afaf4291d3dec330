"""How far a robot drives and turns by its encoders, and how often its sensors measure."""

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
    there = rows[rows[column].notna()]
    step_s = there.groupby("segment")["t_s"].diff().clip(upper=1.0)
    moves = there[column] * step_s
    if window_s:
        moves = moves.groupby([there["segment"], there["t_s"] // window_s]).sum()
    return float(moves.abs().sum())


def turned_rad(rows):
    """How far the tracks turn a robot in all, to the left and to the right, without their noise."""
    return travelled(rows, _ENCODERS[1], _TURNING_S)


def period_s(rows, column):
    """Median time between the measurements of a column [s]; 0 with fewer than two."""
    step_s = rows[rows[column].notna()].groupby("segment")["t_s"].diff()
    return float(step_s.median()) if step_s.notna().any() else 0.0
