"""The error message for a log that lacks columns, with suggestions from the columns it has."""

import re

from rhec.simulation.columns import RECORDED, TRACKS

# Names that other loggers use, in lower case and without the unit; the most likely name first.
OTHER_NAMES = {
    "t_s": ("t", "time", "stamp", "timestamp", "seconds"),
    "x_m": ("x", "east", "easting", "utm_e", "utm_x", "pos_x", "position_x", "px"),
    "y_m": ("y", "north", "northing", "utm_n", "utm_y", "pos_y", "position_y", "py"),
    "speed_mps": ("speed", "v", "vel", "velocity", "v_x", "vel_x", "linear_x", "odom_v"),
    "yaw_rate_radps": ("yaw_rate", "yawrate", "omega", "w", "wz", "angular_z", "gyro_z", "gyro"),
    "v_left_mps": ("v_left", "v_l", "vl", "left_speed", "speed_left", "left_wheel_speed"),
    "v_right_mps": ("v_right", "v_r", "vr", "right_speed", "speed_right", "right_wheel_speed"),
}
_UNIT = re.compile(r"[ _(\[]+(m|s|ms|us|ns|m/s|mps|rad/s|radps|rad_s|deg/s|dps)[)\]]*$")
_LONGEST = 300  # characters of a list of columns in a message


def _plain_name(column):
    """A column's name in lower case and without its unit."""
    return _UNIT.sub("", str(column).strip().lower()).replace(" ", "_")


def _suggestions(missing, columns):
    """{missing column: the column of the log that probably holds the same quantity}."""
    by_plain_name = {_plain_name(column): str(column) for column in reversed(columns)}
    suggestions = {}
    for name in missing:
        for other in (_plain_name(name), *OTHER_NAMES.get(name, ())):
            if other in by_plain_name:
                suggestions[name] = by_plain_name.pop(other)
                break
    return suggestions


def missing_columns(log, required):
    """The message for a log that lacks columns; None if it has all of them.

    Args:
        log: DataFrame.
        required: {name in a run's log: column} of the columns that the log needs.
    """
    columns = list(log.columns)
    missing = [column for column in required.values() if column not in log]
    if not missing:
        return None
    listed = ", ".join(map(str, columns))
    if len(listed) > _LONGEST:
        listed = f"{listed[:_LONGEST]} …"
    sentence = (
        f"the log had no column {', '.join(missing)}; it should have {', '.join(required.values())}"
    )
    is_robots = RECORDED.items() <= required.items()
    if is_robots and set(TRACKS) <= set(columns):
        sentence += f", or give a track_width_m (--track-width-m) for {', '.join(TRACKS)}"
    elif is_robots:
        missing += TRACKS  # may stand there by another name
    sentence += f"; it has {listed}; columns= of rhec.logs.read renames them"
    inferred = log.attrs.get("inferred", {})
    left_out = [f"{role}: {told}" for role, told in inferred.items() if told.startswith("none")]
    sentence += f" ({'; '.join(left_out)})" if left_out else ""
    free = [column for column in columns if column not in required.values()]
    suggested = [f"{name}={column}" for name, column in _suggestions(missing, free).items()]
    return sentence + (f": did you mean {', '.join(suggested)}?" if suggested else "")
