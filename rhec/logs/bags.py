"""ROS 1 and ROS 2 bags (.bag, .db3, .mcap) as a table with one row for each time stamp."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.logs import bag_frames
from rhec.logs.bag_fields import fields_of, listed
from rhec.logs.bag_files import files_of, opened
from rhec.simulation.columns import TRACKS

MOST_VALUES = 20_000_000  # of a log; more would take minutes and gigabytes
_POSITION = ["x_m", "y_m", "position_sigma_m"]
_UNKNOWN_VARIANCE = 1e4  # [m²] variances as large stand for "unknown"
_FILTERED = "filtered"  # in the name of a topic: an estimate that has seen the encoders
_SPEEDS = ["speed_mps", "yaw_rate_radps"]
# Names of joints on the left and on the right, such as front_left_wheel, rl_wheel or l.
_LEFT = re.compile(r"left|(^|_)[fmrb]?l(_|$)")
_RIGHT = re.compile(r"right|(^|_)[fmrb]?r(_|$)")


def _fix(message):
    """Latitude, longitude [deg], altitude and standard deviation [m] of a NavSatFix.

    All are NaN without a fix; the last is NaN where the receiver does not know it.
    """
    if message.status.status < 0:
        return np.nan, np.nan, np.nan, np.nan
    covariance = message.position_covariance
    is_known = message.position_covariance_type > 0
    sigma_m = _sigma(covariance[0], covariance[4]) if is_known else np.nan
    return message.latitude, message.longitude, message.altitude, sigma_m


def _position(message):
    """Position (x, y) and standard deviation [m] of a pose with or without a covariance."""
    position = getattr(message.pose, "pose", message.pose).position
    covariance = getattr(message.pose, "covariance", None)
    sigma_m = np.nan if covariance is None else _sigma(covariance[0], covariance[7])
    return position.x, position.y, sigma_m


def _sigma(variance_x, variance_y):
    """Standard deviation [m] of either coordinate; NaN for variances that no sensor has."""
    variance = (variance_x + variance_y) / 2
    return float(np.sqrt(variance)) if 0 < variance < _UNKNOWN_VARIANCE else np.nan


def _twist(message):
    """Speed [m/s] and yaw rate [rad/s] of a twist with or without a covariance."""
    twist = getattr(message.twist, "twist", message.twist)
    return twist.linear.x, twist.angular.z


def _wheels(message):
    """Mean speeds of the wheels on the left and on the right [rad/s]."""
    means = []
    for side in (_LEFT, _RIGHT):
        joints = zip(message.name, message.velocity)
        speeds = [speed for name, speed in joints if side.search(name.lower())]
        means.append(np.mean(speeds) if speeds else np.nan)
    return tuple(means)


def _imu(message):
    """Yaw rates [rad/s] and specific forces [m/s²] of an Imu about and along its three axes."""
    rate = message.angular_velocity
    force = message.linear_acceleration
    return rate.x, rate.y, rate.z, force.x, force.y, force.z


class _Source(NamedTuple):
    """The columns that a type of message fills, and the function that reads their values."""

    columns: list
    values: Callable


# The message types of each role, in order of preference: the first one in the bag is read.
_ROLES = {
    "positions": {
        "sensor_msgs/msg/NavSatFix": _Source(
            ["latitude", "longitude", "altitude", "position_sigma_m"], _fix
        ),
        "geometry_msgs/msg/PoseStamped": _Source(_POSITION, _position),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _Source(_POSITION, _position),
        "nav_msgs/msg/Odometry": _Source(_POSITION, _position),
    },
    "encoders": {
        "sensor_msgs/msg/JointState": _Source(TRACKS, _wheels),
        "geometry_msgs/msg/TwistStamped": _Source(_SPEEDS, _twist),
        "nav_msgs/msg/Odometry": _Source(_SPEEDS, _twist),
    },
    "gyro": {"sensor_msgs/msg/Imu": _Source([*"abcdef"], _imu)},
}
_OPTIONAL = ("gyro",)
_OF_TRANSFORMS = _Source(_POSITION[:2], None)  # which one message does not tell
# The columns of which any pair, given as fields, fills a role.
_FILLED_BY = {
    "positions": (_POSITION[:2], ["latitude", "longitude"]),
    "encoders": (_SPEEDS, TRACKS),
    "gyro": (["gyro_radps"],),
}
# The specific force of a body at rest points up, with the size of gravity [m/s²].
_GRAVITY = (8.0, 11.5)
_SAME_AXIS = np.cos(np.deg2rad(30.0))  # of an axis by /tf_static and of one by gravity
_FIELDS_HELP = "columns={'x_m': '/topic.field', …} reads fields of any type"


class _Reading(NamedTuple):
    """What is read from the messages of a topic."""

    name: str  # a role, or the columns that fields fill
    topic: str
    msgtype: str
    columns: list
    values: Callable  # message -> the values of the columns


# How its topics are chosen


def _topic_for(types, topics, role):
    """The topic of {topic: type} that has a role, among `topics` if the user passes some."""
    kinds = [*_ROLES[role]]
    suitable = [name for name in topics or types if types[name] in kinds]
    if not suitable:
        readable = ", ".join(kind.rsplit("/", 1)[1] for kind in kinds)
        raise ValueError(f"no topic for {role} ({readable}) among {listed(types)}; {_FIELDS_HELP}")
    best = min((types[name] for name in suitable), key=kinds.index)
    suitable = [name for name in suitable if types[name] == best]
    if topics is None and len(suitable) > 1:
        raise ValueError(
            f"several topics for {role}, {', '.join(suitable)}; topics should name one"
        )
    # If two topics have the same type, the user lists the topic of the positions first.
    return suitable[0 if role == "positions" else -1]


def _topic_of_transforms(types, frames):
    """The topic of transforms that change."""
    for name, kind in types.items():
        if kind == bag_frames.TYPE and not name.endswith("static"):
            return name
    raise ValueError(f"frames was {frames!r}; the bag has no /tf among {listed(types)}")


def _refuse_own_positions(chosen):
    """Raise a ValueError for positions that were made of the encoders."""
    topic = chosen.get("positions", "")
    if topic and topic == chosen.get("encoders"):
        raise ValueError(
            f"the bag's only positions are those of {topic}, which are the integral of its own "
            f"speeds; record a receiver, or topics=({topic!r},) reads them as real positions"
        )
    if _FILTERED in topic:
        raise ValueError(
            f"the bag's only positions are those of {topic}, an estimate that has seen the "
            "encoders; record its receiver, or name topics if these are real positions"
        )


def _refuse_without_radius(types, chosen, wheel_radius_m):
    encoders = chosen.get("encoders")
    if encoders and types[encoders].endswith("JointState") and wheel_radius_m is None:
        raise ValueError(
            f"wheel_radius_m was None; {encoders} has wheel speeds in rad/s, which need the "
            "wheel_radius_m and then the track_width_m (--wheel-radius-m, --track-width-m)"
        )


def _choose(types, topics, frames, fields, wheel_radius_m):
    """{role: topic}, and {role: remark} where no topic has a role.

    Where a user names fields, these may be all that is wanted: what else cannot be chosen is left
    out then.
    """
    unknown = [name for name in topics or () if name not in types]
    if unknown:
        raise ValueError(f"topics named {unknown[0]!r}; the bag has {', '.join(types)}")
    given = {field.column for field in fields}
    chosen = {}
    remarks = {}
    for role, filling in _FILLED_BY.items():
        if any(given.issuperset(columns) for columns in filling):
            continue
        if role == "positions" and frames:
            chosen[role] = _topic_of_transforms(types, frames)
            continue
        if role in _OPTIONAL and not any(types[name] in _ROLES[role] for name in topics or types):
            continue
        try:
            chosen[role] = _topic_for(types, topics, role)
            if topics is None:
                _refuse_own_positions(chosen)
            _refuse_without_radius(types, chosen, wheel_radius_m)
        except ValueError as refused:
            if not fields and role not in _OPTIONAL:
                raise
            chosen.pop(role, None)
            remarks[role] = f"none: {refused}"
    return chosen, remarks


def _readings(types, chosen, fields):
    """The _Readings of {role: topic} and of the fields."""
    readings = []
    for role, topic in chosen.items():
        kind = types[topic]
        source = _OF_TRANSFORMS if kind == bag_frames.TYPE else _ROLES[role][kind]
        readings.append(_Reading(role, topic, types[topic], source.columns, source.values))
    for topic in dict.fromkeys(field.topic for field in fields):
        of_topic = [field for field in fields if field.topic == topic]
        columns = [field.column for field in of_topic]
        values = _values_of(of_topic)
        readings.append(_Reading(", ".join(columns), topic, types[topic], columns, values))
    return readings


def _values_of(fields):
    """The function message -> values of these fields."""
    return lambda message: [field.value(message) for field in fields]


# How its messages are read


class _Messages(NamedTuple):
    """The messages of a bag."""

    stamps_ns: dict  # {name of a reading: [time stamps]}
    by_header: dict  # {name of a reading: how many of these are of headers}
    values: dict  # {name of a reading: [values]}
    sensor_frames: dict  # {name of a reading: frame of its first message}
    frames: bag_frames.Frames


def _frame(message):
    """The frame in which a sensor measures; of a pose it is that of the body."""
    header = getattr(message, "header", None)
    if hasattr(message, "pose"):
        return getattr(message, "child_frame_id", "")
    return getattr(header, "frame_id", "")


def _messages(bag, readings, named):
    """The _Messages of the readings, from an open bag, with the frames that a user named."""
    names = [reading.name for reading in readings]
    messages = _Messages(
        {name: [] for name in names},
        dict.fromkeys(names, 0),
        {name: [] for name in names},
        {},
        bag_frames.Frames(),
    )
    static = {name for name, kind in bag.types.items() if kind == bag_frames.TYPE}
    static = {name for name in static if name.endswith("static")}
    topics = {reading.topic for reading in readings}
    n_values = 0
    for topic, received_ns, message in bag.messages(topics | static):
        if topic in static:
            messages.frames.add(message)
            continue
        if named and bag.types[topic] == bag_frames.TYPE:
            messages.frames.add(message)
            for stamp_ns, place in bag_frames.moved(messages.frames, named, message):
                messages.stamps_ns["positions"].append(stamp_ns or received_ns)
                messages.by_header["positions"] += stamp_ns > 0
                messages.values["positions"].append(place)
            messages.sensor_frames["positions"] = named[1]
            continue
        for reading in readings:
            if reading.topic == topic:  # an Odometry may have several roles
                stamp_ns = bag_frames.stamp_ns(message)
                messages.stamps_ns[reading.name].append(stamp_ns or received_ns)
                messages.by_header[reading.name] += stamp_ns > 0
                messages.values[reading.name].append(reading.values(message))
                messages.sensor_frames.setdefault(reading.name, _frame(message))
                n_values += len(reading.columns)
        if n_values > MOST_VALUES:
            raise ValueError(f"its topics have more than {MOST_VALUES} values")
    if named and not messages.values.get("positions", True):
        raise ValueError(f"frames was {named!r}; the bag has {messages.frames}")
    return messages


def _read(bag, topics, frames, columns, wheel_radius_m):
    """The table of an open bag, with the columns of fields in its attrs, and what was inferred."""
    fields = fields_of(columns, bag.types)
    chosen, inferred = _choose(bag.types, topics, frames, fields, wheel_radius_m)
    readings = _readings(bag.types, chosen, fields)
    messages = _messages(bag, readings, frames)
    tables = []
    for reading in readings:
        table, told = _table(reading, messages, wheel_radius_m)
        inferred[reading.name] = f"{reading.topic}, {reading.msgtype}, {told}"
        tables.append(table[~table.index.duplicated()].sort_index())
    table = tables[0]
    for other in tables[1:]:
        table = table.join(other, how="outer")
    if not len(table):
        raise ValueError(f"no message on {', '.join(each.topic for each in readings)}")
    if "position_sigma_m" in table and table["position_sigma_m"].isna().all():
        table = table.drop(columns="position_sigma_m")
    table.insert(0, "t_s", (table.index - table.index[0]) * 1e-9)
    table = table.reset_index(drop=True)
    _add_lever_arm(table, messages, inferred)
    table.attrs["fields"] = [field.column for field in fields]
    unread = {name: kind for name, kind in bag.types.items() if name not in _topics_of(readings)}
    if unread:
        inferred["other topics"] = listed(unread)
    return table, inferred


def _topics_of(readings):
    return {reading.topic for reading in readings}


def _table(reading, messages, wheel_radius_m):
    """The table of a reading, indexed by time [ns], and what it consists of, as text."""
    stamps_ns = messages.stamps_ns[reading.name]
    values = messages.values[reading.name]
    table = pd.DataFrame(values, index=stamps_ns, columns=reading.columns, dtype=float)
    disorder = int((np.diff(table.index) < 0).sum())
    told = f"{len(table)} messages, {disorder} out of order"
    clock = "the headers"
    if messages.by_header[reading.name] < len(table):
        clock = "the recorder, because headers have no stamp"
    told += f", times by {clock}"
    if wheel_radius_m is not None:
        tracks = [name for name in TRACKS if name in table]
        table[tracks] *= wheel_radius_m
    if reading.name == "gyro":
        rate, axis = _about_vertical(table, messages)
        table = pd.DataFrame(dict(gyro_radps=rate), index=table.index)
        told += f", {axis}"
    return table, told


# Where its sensors are


def _about_vertical(table, messages):
    """The yaw rate about the vertical in a table of `_imu`, and how its axis was found."""
    rate = table.to_numpy()[:, :3]
    force = np.nanmean(table.to_numpy()[:, 3:], axis=0)
    size = float(np.linalg.norm(force))
    measures_gravity = _GRAVITY[0] < size < _GRAVITY[1]
    pose = messages.frames.pose(messages.sensor_frames["gyro"])
    if pose is not None:
        up = pose[0][2]
        if not measures_gravity or abs(up @ force) >= _SAME_AXIS * size:
            return rate @ up, f"about the z axis of {messages.frames.base} by /tf_static"
    if not measures_gravity:
        return rate[:, 2], "about its z axis, because it measures no gravity"
    up = force / size
    axis = ", ".join(f"{entry:.2f}" for entry in up)
    against = "" if pose is None else ", which contradicts /tf_static"
    return rate @ up, f"about the vertical by gravity, ({axis}) in its axes{against}"


def _add_lever_arm(table, messages, inferred):
    """Note the place of the antenna in the robot's frame, if the bag has transforms to it."""
    pose = messages.frames.pose(messages.sensor_frames.get("positions", ""))
    if pose is None:
        return
    ahead, left = map(float, pose[1][:2])
    table.attrs["lever_arm_m"] = (ahead, left)
    base = messages.frames.base
    inferred["lever arm"] = f"{ahead:.3f} m ahead, {left:.3f} m left of {base}, by /tf_static"


# Files


def read_bag(
    file: Path,
    topics: tuple[str, ...] | None,
    frames: tuple[str, str] | None,
    wheel_radius_m: float | None,
    columns: dict[str, str],
) -> tuple[pd.DataFrame, dict[str, str]]:
    """The table of a bag, and {property: inferred value}.

    `.attrs["fields"]` of the table lists the columns that are fields of messages.

    Args:
        file: Path of the bag.
        topics, frames, wheel_radius_m, columns: As in `rhec.logs.read`. Columns that are no fields
            of messages are not looked at.

    Raises:
        ValueError: If rosbags is not installed, or if the bag cannot be read.
    """
    files = files_of(file)
    try:
        with opened(files) as bag:
            return _read(bag, topics, frames, columns, wheel_radius_m)
    except Exception as error:  # any error that a parser raises for a broken file
        if type(error) is ValueError:
            raise
        problem = f"{type(error).__name__}: {error}".rstrip(".")
        raise ValueError(f"{problem}; {_remedy(file, files)}") from None


def _remedy(file, files):
    """What repairs a bag whose recording was cut off, as the end of a sentence."""
    folder = shlex.quote(str(file if file.is_dir() else file.parent))
    last = shlex.quote(str(files[-1]))  # the file that was being written
    commands = {
        ".bag": f"rosbag reindex {last}",
        ".db3": f"ros2 bag reindex {folder}",
        ".mcap": f"mcap recover {last} -o NEW.mcap",
    }
    return f"if the recording was cut off, {commands[files[-1].suffix]} may repair it"
