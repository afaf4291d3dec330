"""ROS 1 and ROS 2 bags (.bag, .db3, .mcap) as a table with one row for each time stamp."""

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from rhec.logs.bag_fields import fields_of, listed
from rhec.logs.bag_files import files_of, messages, opened
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
    """Yaw rate [rad/s] of an Imu about its z axis."""
    return (message.angular_velocity.z,)


# The message types of each role, in order of preference: the first one in the bag is read. A type
# has the columns that it fills, and the function that reads their values.
_ROLES = {
    "positions": {
        "sensor_msgs/msg/NavSatFix": (
            ["latitude", "longitude", "altitude", "position_sigma_m"],
            _fix,
        ),
        "geometry_msgs/msg/PoseStamped": (_POSITION, _position),
        "geometry_msgs/msg/PoseWithCovarianceStamped": (_POSITION, _position),
        "nav_msgs/msg/Odometry": (_POSITION, _position),
    },
    "encoders": {
        "sensor_msgs/msg/JointState": (TRACKS, _wheels),
        "geometry_msgs/msg/TwistStamped": (_SPEEDS, _twist),
        "nav_msgs/msg/Odometry": (_SPEEDS, _twist),
    },
    "gyro": {"sensor_msgs/msg/Imu": (["gyro_radps"], _imu)},
}
_OPTIONAL = ("gyro",)
# The columns of which any pair, given as fields, fills a role.
_FILLED_BY = {
    "positions": (_POSITION[:2], ["latitude", "longitude"]),
    "encoders": (_SPEEDS, TRACKS),
    "gyro": (["gyro_radps"],),
}
_FIELDS_HELP = "--columns x_m=/topic.field reads fields of any type"
_ONE_CLOCK_S = 1.0  # headers of one clock are received as late as each other, but for this


@dataclass
class _Reading:
    """What is read from the messages of a topic."""

    name: str  # a role, or the columns that fields fill
    topic: str
    columns: list
    values: Callable  # message -> the values of the columns
    stamps_ns: list = field(default_factory=list)  # by headers, 0 where one has no stamp
    received_ns: list = field(default_factory=list)  # by the recorder
    rows: list = field(default_factory=list)  # the values of each message

    def take(self, message, received_ns):
        """Append the values of a message and its times."""
        self.stamps_ns.append(_stamp_ns(message))
        self.received_ns.append(received_ns)
        self.rows.append(self.values(message))

    def table(self, times_ns, wheel_radius_m):
        """The values as a table, indexed by time [ns]."""
        table = pd.DataFrame(self.rows, times_ns, self.columns, dtype=float)
        if wheel_radius_m is not None:
            table[table.columns.intersection(TRACKS)] *= wheel_radius_m
        return table


def _stamp_ns(message):
    """The time in a message's header [ns]; 0 without one, as in a header without a stamp."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return stamp.sec * 10**9 + stamp.nanosec if stamp else 0


def _why_recorder(readings):
    """Why the times of all topics are those of the recorder; "" where headers have one clock."""
    readings = [each for each in readings if each.rows]
    for each in readings:
        unstamped = each.stamps_ns.count(0)
        if unstamped:
            return f"{unstamped} of {len(each.rows)} headers of {each.topic} have no stamp"
    late_s = {
        each.topic: float(np.median(np.subtract(each.received_ns, each.stamps_ns))) * 1e-9
        for each in readings
    }
    apart_s = max(late_s.values(), default=0.0) - min(late_s.values(), default=0.0)
    if apart_s > _ONE_CLOCK_S:
        return f"the headers of {' and '.join(late_s)} have clocks {apart_s:.3g} s apart"
    return ""


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


def _refuse_chosen(types, chosen, are_named, wheel_radius_m):
    """Raise a ValueError for positions made of the encoders, and for wheels of unknown radius."""
    positions = chosen.get("positions", "")
    encoders = chosen.get("encoders", "")
    only = f"the bag's only positions are those of {positions}"
    if positions and positions == encoders and not are_named:
        raise ValueError(
            f"{only}, which are the integral of its own speeds; record a receiver, or "
            f"topics=({positions!r},) reads them as real positions"
        )
    if _FILTERED in positions and not are_named:
        raise ValueError(
            f"{only}, an estimate that has seen the encoders; record its receiver, or name topics "
            "if these are real positions"
        )
    if encoders and types[encoders].endswith("JointState") and wheel_radius_m is None:
        raise ValueError(
            f"wheel_radius_m was None; {encoders} has wheel speeds in rad/s, which need the "
            "wheel_radius_m and then the track_width_m (--wheel-radius-m, --track-width-m)"
        )


def _choose(types, topics, fields, wheel_radius_m):
    """{role: topic}, and {role: remark} where no topic has a role.

    Where a user names fields, these may be all that is wanted: what else cannot be chosen is left
    out then.
    """
    unknown = [name for name in topics or () if name not in types]
    if unknown:
        raise ValueError(f"topics named {unknown[0]!r}; the bag has {', '.join(types)}")
    given = {each.column for each in fields}
    chosen = {}
    remarks = {}
    for role, filling in _FILLED_BY.items():
        if any(given.issuperset(columns) for columns in filling):
            continue
        if role in _OPTIONAL and not any(types[name] in _ROLES[role] for name in topics or types):
            continue
        try:
            chosen[role] = _topic_for(types, topics, role)
            _refuse_chosen(types, chosen, topics is not None, wheel_radius_m)
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
        readings.append(_Reading(role, topic, *_ROLES[role][types[topic]]))
    for topic in dict.fromkeys(each.topic for each in fields):
        of_topic = [each for each in fields if each.topic == topic]
        columns = [each.column for each in of_topic]
        readings.append(_Reading(", ".join(columns), topic, columns, partial(_values_of, of_topic)))
    return readings


def _values_of(fields, message):
    """The values of fields of a message."""
    return [each.value(message) for each in fields]


# How its messages are read


def _take_messages(bag, readings):
    """Fill the readings from an open bag."""
    n_values = 0
    for topic, received_ns, message in messages(bag, {reading.topic for reading in readings}):
        for reading in readings:
            if reading.topic == topic:  # an Odometry may have several roles
                reading.take(message, received_ns)
                n_values += len(reading.columns)
        if n_values > MOST_VALUES:
            raise ValueError(f"its topics have more than {MOST_VALUES} values")


def _read(bag, topics, columns, wheel_radius_m):
    """The table of an open bag, with the columns of fields in its attrs, and what was inferred."""
    types = {name: topic.msgtype or "" for name, topic in bag.topics.items()}
    fields = fields_of(columns, types)
    chosen, inferred = _choose(types, topics, fields, wheel_radius_m)
    readings = _readings(types, chosen, fields)
    _take_messages(bag, readings)
    why = _why_recorder(readings)
    inferred["time"] = f"by the recorder, because {why}" if why else "by the headers"
    table = pd.DataFrame()
    for reading in readings:
        times_ns = reading.received_ns if why else reading.stamps_ns
        read = reading.table(times_ns, wheel_radius_m)
        disorder = int((np.diff(times_ns) < 0).sum())
        kind = types[reading.topic]
        inferred[reading.name] = (
            f"{reading.topic}, {kind}, {len(read)} messages, {disorder} out of order"
        )
        table = table.join(read[~read.index.duplicated()], how="outer")
    if not len(table):
        raise ValueError(f"no message on {', '.join(each.topic for each in readings)}")
    if "position_sigma_m" in table and table["position_sigma_m"].isna().all():
        table = table.drop(columns="position_sigma_m")
    table.insert(0, "t_s", (table.index - table.index[0]) * 1e-9)
    table = table.reset_index(drop=True)
    table.attrs["fields"] = [each.column for each in fields]
    read_topics = {reading.topic for reading in readings}
    unread = {name: kind for name, kind in types.items() if name not in read_topics}
    if unread:
        inferred["other topics"] = listed(unread)
    return table, inferred


# Files


def read_bag(
    file: Path,
    topics: tuple[str, ...] | None,
    wheel_radius_m: float | None,
    columns: dict[str, str],
) -> tuple[pd.DataFrame, dict[str, str]]:
    """The table of a bag, and {property: inferred value}.

    `.attrs["fields"]` of the table lists the columns that are fields of messages.

    Args:
        file: Path of the bag.
        topics, wheel_radius_m, columns: As in `rhec.logs.read`. Columns that are no fields
            of messages are not looked at.

    Raises:
        ValueError: If rosbags is not installed, or if the bag cannot be read.
    """
    files = files_of(file)
    try:
        with opened(files) as bag:
            return _read(bag, topics, columns, wheel_radius_m)
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
