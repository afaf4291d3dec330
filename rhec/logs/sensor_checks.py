"""Checks of what a log's sensors say of the yaw for a wrong sign, axis, unit or direction of zero.

The turns of the encoders are the reference for turns, and the course of the positions for the
direction. Both are rough, so that only what no robot explains is found.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs.finding import refused
from rhec.simulation.columns import MEASUREMENTS
from rhec.tracked_robot.sensors import YAW, YAW_RATE, records

_X, _Y, _SPEED, _YAW_RATE = MEASUREMENTS
_WINDOW = 10  # samples over which turns are compared
_TURNS_RAD = (0.1, 1.5)  # by the encoders in a window; in a larger one a heading jumps by 2π
_LEAST_WINDOWS = 50  # fewer tell nothing
# Limits of the turns by a sensor over those by the encoders. κ is between 0 and about 1.
_OTHER_AXIS = 0.1
_DEGREES = 10.0
_STRAIGHT_RAD = 0.3  # largest turn of a window that has a course
_COURSE_M = 0.25  # and the shortest way
_LARGEST_OFFSET_RAD = 0.5  # of the heading from the course
_LARGEST_SPREAD_RAD = 0.7  # of that offset, for a clear one


def check_sensors(recording):
    """Find a wrong sign, axis, unit or zero of the yaws and yaw rates of a Recording's sensors."""
    if not recording.sensors:
        return
    samples = pd.concat(recording.samples(), ignore_index=True)
    by_segment = samples.groupby("segment")
    turned = paper.DT_S * _sums(by_segment[_YAW_RATE])
    for sensor in records(recording.sensors):
        column = sensor.column
        if sensor.measures not in (YAW, YAW_RATE):
            continue
        is_rate = sensor.measures == YAW_RATE
        turns = (
            paper.DT_S * _sums(by_segment[column]) if is_rate else by_segment[column].diff(_WINDOW)
        )
        ratio = (turns / turned)[turned.abs().between(*_TURNS_RAD)].dropna()
        cause = _cause(ratio, "rad/s" if is_rate else "rad")
        if cause:
            yield refused(
                f"the log's {recording.columns[column]} {cause}: it turns {ratio.median():.3g} "
                f"times as far as {recording.columns[_YAW_RATE]} says"
            )
        elif not is_rate:
            yield from _check_offset(samples, turned, column, recording.columns[column])


def _sums(values):
    """Sums over windows of a column that is grouped by segments, in the order of its rows."""
    return values.rolling(_WINDOW).sum().droplevel(0).sort_index()


def _cause(ratio, unit):
    """What is wrong with a sensor, by its turns over those of the encoders; None if nothing is.

    Three quarters of the windows must say so, because a bias, slip and jumps of a heading by 2π
    spoil some of them.
    """
    if len(ratio) < _LEAST_WINDOWS:
        return None
    low, middle, high = ratio.quantile([0.25, 0.5, 0.75])
    if unit == "rad/s" and low < -_OTHER_AXIS < _OTHER_AXIS < high:
        return "may be by another clock, or of another drive"
    if abs(middle) < _OTHER_AXIS:
        return "may be of another axis and should be of the vertical one"
    if high < -_OTHER_AXIS:
        return "may be counted clockwise and should be counter-clockwise"
    if low > _DEGREES:
        return f"may be in degrees and should be in {unit}"
    return None


def _check_offset(samples, turned, column, column_of_log):
    """Find a heading that is not the direction in which the robot drives."""
    by_segment = samples.groupby("segment")
    heading = by_segment[column].shift(_WINDOW // 2)
    way = by_segment[[_X, _Y]].transform(pd.Series.interpolate).groupby(samples["segment"])
    way = way.diff(_WINDOW) @ [1, 1j]
    forward = _sums(by_segment[_SPEED])
    is_steady = forward.abs() > 0.99 * _sums(samples[_SPEED].abs().groupby(samples["segment"]))
    counts = is_steady & (turned.abs() < _STRAIGHT_RAD) & (way.abs() > _COURSE_M)
    offsets = (np.exp(1j * heading) / (way * np.sign(forward)))[counts].dropna()
    if len(offsets) < _LEAST_WINDOWS:
        return
    mean = (offsets / offsets.abs()).mean()
    spread = np.sqrt(-2 * np.log(max(abs(mean), 1e-12)))
    offset = float(np.angle(mean))
    if abs(offset) > _LARGEST_OFFSET_RAD and spread < _LARGEST_SPREAD_RAD:
        yield refused(
            f"the log's {column_of_log} is {offset:.3g} rad from the direction in which the robot "
            "drives; it may be counted from north and should be counted from the x axis"
        )
