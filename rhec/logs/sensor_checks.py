"""Checks of a log's gyro and heading for a wrong sign, axis, unit or direction of zero.

The turns of the encoders are the reference for turns, and the course of the positions for the
direction. Both are rough, so that only what no robot explains is found.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs.finding import refused
from rhec.simulation.columns import MEASUREMENTS, SENSORS

_GYRO = SENSORS["gyro"]
_HEADING = SENSORS["heading"]
_X, _Y, _SPEED, _YAW_RATE = MEASUREMENTS
_LEAST_SAMPLES = 50
_WINDOW = 10  # samples over which the turns of a heading are added up
_LEAST_TURNED_RAD = 3.0  # a robot that turns less does not show a sign
_TURNING_RAD = 0.02  # in one sample
_LEAST_SHARE = 0.25  # of the squares that the encoders' turns must explain
# Limits of the turns by a sensor over those by the encoders. κ is between 0 and about 1.
_OPPOSITE = -0.1
_OTHER_AXIS = 0.1
_DEGREES = 10.0
_COURSE_M = 0.5  # length of the pieces of a path that have a course
_LEAST_PIECES = 10
_LARGEST_OFFSET_RAD = 0.5  # of the heading from the course
_LARGEST_SPREAD_RAD = 0.7  # of that offset, for a clear one


def check_sensors(recording):
    """Yield a Finding for each wrong sign, axis, unit or zero of a Recording's gyro and heading."""
    parts = recording.samples() if recording.sensors else []
    if "gyro" in recording.sensors:
        turns = np.concatenate([part[[_YAW_RATE, _GYRO]].to_numpy() for part in parts])
        yield from _check_turns(paper.DT_S * turns, recording, _GYRO, "rad/s")
    if "heading" in recording.sensors:
        turns = np.concatenate([_turns_of_heading(part) for part in parts])
        in_degrees = [*_check_degrees(parts, recording)]
        yield from in_degrees
        yield from () if in_degrees else _check_turns(turns, recording, _HEADING, "rad")
        yield from _check_offset(parts, recording)


def _turns_of_heading(part):
    """Turns of encoders and heading [rad] over _WINDOW samples, (n - 1, 2); NaN at the beginning.

    From sample to sample the noise of a heading is larger than the turns of a slow robot.
    """
    turn = np.diff(part[_HEADING].to_numpy())
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    turns = np.stack([paper.DT_S * part[_YAW_RATE].to_numpy()[1:], turn], axis=1)
    return pd.DataFrame(turns).rolling(_WINDOW).sum().to_numpy()


def _check_turns(turns, recording, sensor, unit):
    """Find turns (n, 2) of encoders and sensor [rad] that do not belong together.

    A gyro's bias is a constant of the fit.
    """
    turns = turns[np.isfinite(turns).all(axis=1)]
    if len(turns) < _LEAST_SAMPLES or np.abs(turns[:, 0]).sum() < _LEAST_TURNED_RAD:
        return
    by_encoders, by_sensor = (turns - turns.mean(axis=0)).T
    slope = by_encoders @ by_sensor / (by_encoders @ by_encoders)
    share = (by_encoders @ by_sensor) ** 2 / max(
        (by_encoders @ by_encoders) * (by_sensor @ by_sensor), 1e-300
    )
    column = recording.columns[sensor]
    cause = None
    if abs(slope) < _OTHER_AXIS:
        cause = f"{column} may be of another axis and should be of the vertical one"
    elif share > _LEAST_SHARE and slope < _OPPOSITE:
        cause = f"{column} may be counted clockwise and should be counter-clockwise"
    elif share > _LEAST_SHARE and slope > _DEGREES:
        cause = f"{column} may be in degrees and should be in {unit}"
    if cause:
        yield refused(
            f"the log's {cause}: it turns {slope:.3g} times as far as "
            f"{recording.columns[_YAW_RATE]} says"
        )


def _check_degrees(parts, recording):
    """Find a heading in degrees, by the median of its steps while turning."""
    steps = [
        part[[_YAW_RATE, _HEADING]].assign(**{_HEADING: part[_HEADING].diff()}) for part in parts
    ]
    turns = np.abs(np.concatenate(steps)) * (paper.DT_S, 1.0)
    turns = turns[np.isfinite(turns).all(axis=1) & (turns[:, 0] > _TURNING_RAD)]
    if len(turns) < _LEAST_SAMPLES:
        return
    ratio = np.median(turns[:, 1] / turns[:, 0])
    if ratio > _DEGREES:
        column = recording.columns[_HEADING]
        yield refused(
            f"the log's {column} may be in degrees and should be in rad: it turns {ratio:.3g} "
            f"times as far as {recording.columns[_YAW_RATE]} says"
        )


def _check_offset(parts, recording):
    """Find a heading that is not the direction in which the robot drives."""
    offsets = np.concatenate([_offsets(part) for part in parts])
    if len(offsets) < _LEAST_PIECES:
        return
    mean = np.exp(1j * offsets).mean()
    spread = np.sqrt(-2 * np.log(max(abs(mean), 1e-12)))
    offset = float(np.angle(mean))
    if abs(offset) > _LARGEST_OFFSET_RAD and spread < _LARGEST_SPREAD_RAD:
        column = recording.columns[_HEADING]
        yield refused(
            f"the log's {column} is {offset:.3g} rad from the direction in which the robot drives; "
            "it may be counted from north and should be counted from the x axis"
        )


def _offsets(part):
    """Heading minus course [rad] of pieces of the path of about _COURSE_M, (pieces,)."""
    part = part[[_X, _Y, _SPEED, _HEADING]].dropna()
    x, y, speed, heading = part.to_numpy().T
    piece = np.floor(np.cumsum(np.abs(speed)) * paper.DT_S / _COURSE_M)
    begins = np.flatnonzero(np.diff(piece, prepend=-1))
    offsets = []
    for begin, end in zip(begins, begins[1:]):
        way = (x[end] - x[begin]) + 1j * (y[end] - y[begin])
        middle = np.exp(1j * heading[begin : end + 1]).mean()
        keeps_direction = abs(np.sign(speed[begin:end]).sum()) == end - begin
        if abs(way) > _COURSE_M / 2 and keeps_direction and abs(middle) > 0.95:
            offsets.append(np.angle(middle / (way * np.sign(speed[begin]))))
    return np.array(offsets)
