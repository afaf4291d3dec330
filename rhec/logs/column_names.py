"""The columns of a recording: what others call them, and what is said of a log that lacks some."""

import re

from rhec.logs.finding import passed
from rhec.simulation.columns import RECORDED, RECORDED_SENSORS, RECORDED_TRUTH, TRACKS

# The columns of a recording, and names that other loggers use for them, in lower case and without
# the unit; the most likely name first. Those of the time and of latitude, longitude and altitude
# are read, the others are suggested.
OTHER_NAMES = {
    "t_s": ("t", "time", "stamp", "timestamp", "date_time", "datetime", "seconds", "__time"),
    "latitude": ("latitude", "lat"),
    "longitude": ("longitude", "lon", "lng"),
    "altitude": ("altitude", "alt"),
    "x_m": ("x", "east", "easting", "utm_e", "utm_x", "pos_x", "position_x", "px"),
    "y_m": ("y", "north", "northing", "utm_n", "utm_y", "pos_y", "position_y", "py"),
    "speed_mps": ("speed", "v", "vel", "velocity", "v_x", "vel_x", "linear_x", "odom_v"),
    "yaw_rate_radps": ("yaw_rate", "yawrate", "omega", "w", "wz", "angular_z"),
    "v_left_mps": ("v_left", "v_l", "vl", "left_speed", "speed_left", "left_wheel_speed"),
    "v_right_mps": ("v_right", "v_r", "vr", "right_speed", "speed_right", "right_wheel_speed"),
    **dict.fromkeys(("segment", "pos_ok", "encoders_ok", *RECORDED_SENSORS.values()), ()),
}
DECLARED = "position_sigma_m"  # standard deviation of a position by its receiver
KNOWN = (*OTHER_NAMES, "sec", "nanosec", DECLARED, *RECORDED_TRUTH.values())  # all that is read
_UNITS = "m|s|ms|us|ns|m/s|mps|km/h|kmh|kph|mph|knots|rad/s|radps|rad_s|deg/s|dps"
_UNIT = re.compile(rf"[ _(\[]+({_UNITS})[)\]]*$")
_RPM = re.compile(r"(^|_)rpm(_|$)")
_INCREMENT = re.compile(r"(^|_)(d|delta_?)(x|y|s|t|theta|yaw|dist\w*)(_|$)|^distance$|^odometer$")
_LONGEST = 300  # characters of a list of columns in a message


def unit_of(column):
    """The unit in a column's name, or ""."""
    unit = _UNIT.search(str(column).strip().lower())
    return unit[1] if unit else ""


def _plain_name(column):
    """A column's name in lower case, without its unit; what stood in a path is joined by _."""
    name = _UNIT.sub("", str(column).strip().lower())
    return re.sub(r"[ /.]+", "_", name).lstrip("_") if name != "__time" else name


def column_of(columns, name, endings=False):
    """The column that probably holds a quantity of OTHER_NAMES; None if there is none.

    Args:
        columns: Names of columns.
        name: The quantity.
        endings: Whether a path may also end so, as `/odom/twist/twist/linear/x` ends in linear_x.
    """
    by_plain_name = {_plain_name(column): str(column) for column in reversed(list(columns))}
    others = (_plain_name(name), *OTHER_NAMES.get(name, ()))
    for other in others:
        if other in by_plain_name:
            return by_plain_name[other]
    if not endings:
        return None
    paths = {plain: name for plain, name in by_plain_name.items() if re.search(r"\w[/.]\w", name)}
    for other in others:
        longer = [name for plain, name in paths.items() if plain.endswith(f"_{other}")]
        if longer and len(other) > 2:
            return longer[-1]
    return None


def _suggestions(missing, columns):
    """{missing column: the column of the log that probably holds the same quantity}."""
    suggestions = {}
    left = list(map(str, columns))
    for name in missing:
        if found := column_of(left, name, endings=True):
            suggestions[name] = found
            left.remove(found)
    return suggestions


def _made_of(columns):
    """How to make speeds of columns that hold something else, a sentence; "" for none."""
    rpm = [str(column) for column in columns if _RPM.search(_plain_name(column))]
    if rpm:
        return (
            f"; {', '.join(rpm)} are turns of wheels in a minute: v_left_mps and v_right_mps are "
            "their means on either side times 2 π/60 times the radius of the wheels"
        )
    steps = [
        str(column)
        for column in columns
        if any(map(_INCREMENT.search, (_plain_name(column), str(column).lower())))
    ]
    if steps:
        return (
            f"; {', '.join(steps)} may be steps from row to row: divided by the time between rows "
            "they are speeds"
        )
    return ""


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
    free = [column for column in columns if column not in required.values()]
    lacks_speeds = not {"speed_mps", "yaw_rate_radps"} <= set(columns)
    needs_width = is_robots and lacks_speeds and set(TRACKS) <= set(columns)
    if needs_width:
        sentence += f", or give {passed('track_width_m')} for {', '.join(TRACKS)}"
        missing = [name for name in missing if name not in ("speed_mps", "yaw_rate_radps")]
    elif is_robots and lacks_speeds:  # the speeds of tracks may stand there by another name
        missing += [name for name in TRACKS if name not in columns]
    sentence += f"; it has {listed}"
    inferred = log.attrs.get("inferred", {})
    left_out = [f"{role}: {told}" for role, told in inferred.items() if told.startswith("none")]
    sentence += f" ({'; '.join(left_out)})" if left_out else ""
    sentence += "" if needs_width else _made_of(free)
    if suggested := _suggestions(missing, free):
        return f"{sentence}: did you mean {passed('columns', suggested)}?"
    if needs_width:
        return sentence
    return f"{sentence}; {passed('columns', {missing[0]: 'NAME'})} renames one"
