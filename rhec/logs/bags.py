"""ROS 1 and ROS 2 bags (.bag, .db3, .mcap) as a table with one row for each time stamp.

A column is a field of messages, by a path such as `/odom.pose.pose.position.x`: a topic and, after
it, names of fields behind points and places in arrays in brackets, such as `/wheels.velocity[0]`;
`[left]` and `[right]` are the mean of the joints whose names are on that side. A path should end at
a number. A time is a number of seconds, and a quaternion gives its yaw [rad]. A minus before the
topic turns the sign, as for an IMU that is mounted upside down.

What a user does not name is read from the topics whose types have a role, by the paths in _ROLES.
"""

import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rhec.logs.bag_files import files_of, messages, opened
from rhec.logs.finding import passed
from rhec.simulation.columns import TRACKS

MOST_VALUES = 20_000_000  # of a log; more would take minutes and gigabytes
_UNKNOWN_VARIANCE = 1e4  # [m²] variances as large stand for "unknown"
_FILTERED = "filtered"  # in the name of a topic: an estimate that has seen the encoders
_ONE_CLOCK_S = 1.0  # headers of one clock are received as late as each other, but for this
_STEP = re.compile(r"\.(\w+)|\[(-?\d+|left|right)\]")
_LONGEST = 12  # fields or topics that a message lists
# Names of joints on the left and on the right, such as front_left_wheel, rl_wheel or l.
_SIDES = dict(
    left=re.compile(r"left|(^|_)[fmrb]?l(_|$)"), right=re.compile(r"right|(^|_)[fmrb]?r(_|$)")
)
# Columns that become others: the status of a receiver, and the variances of x and y [m²].
_STATUS, _VARIANCES, _IS_KNOWN = "status", ["variance_x", "variance_y"], "has_variances"
_FIX = dict(
    latitude=".latitude",
    longitude=".longitude",
    altitude=".altitude",
    status=".status.status",
    variance_x=".position_covariance[0]",
    variance_y=".position_covariance[4]",
    has_variances=".position_covariance_type",
)
_POSE = dict(
    x_m=".pose.pose.position.x",
    y_m=".pose.pose.position.y",
    variance_x=".pose.covariance[0]",
    variance_y=".pose.covariance[7]",
)
_SPEEDS = ["speed_mps", "yaw_rate_radps"]
_TWIST = dict(zip(_SPEEDS, (".twist.linear.x", ".twist.angular.z")))
# {role: {type of message: {column: path}}}; the first type that is in the bag is read.
_ROLES = {
    "positions": {
        "sensor_msgs/msg/NavSatFix": _FIX,
        "geometry_msgs/msg/PoseStamped": dict(x_m=".pose.position.x", y_m=".pose.position.y"),
        "geometry_msgs/msg/PoseWithCovarianceStamped": _POSE,
        "nav_msgs/msg/Odometry": _POSE,
    },
    "encoders": {
        "sensor_msgs/msg/JointState": dict(zip(TRACKS, (".velocity[left]", ".velocity[right]"))),
        "geometry_msgs/msg/TwistStamped": _TWIST,
        "nav_msgs/msg/Odometry": {name: f".twist{path}" for name, path in _TWIST.items()},
    },
    "gyro": {"sensor_msgs/msg/Imu": dict(gyro_radps=".angular_velocity.z")},
}
_OPTIONAL = ("gyro",)
# The columns of which any pair, named by a user, fills a role.
_FILLED_BY = {
    "positions": (["x_m", "y_m"], ["latitude", "longitude"]),
    "encoders": (_SPEEDS, TRACKS),
    "gyro": (["gyro_radps"],),
}


# Fields


class _Field(NamedTuple):
    """A field of the messages of a topic, as a column of a log."""

    column: str
    path: str  # what follows the topic
    named: str  # topic and path, as the user gave them
    msgtype: str
    sign: int = 1

    def value(self, message: Any) -> float:
        """The number at the path in a message; NaN where an array has no such place.

        Raises:
            ValueError: If the message has no such field, or if it is no number.
        """
        value = message
        for name, place in _STEP.findall(self.path):
            try:
                if name:
                    value = getattr(value, name)
                elif place in _SIDES:
                    value = _mean_on(_SIDES[place], message.name, value)
                else:
                    value = value[int(place)]
            except IndexError:
                return np.nan
            except (AttributeError, TypeError):
                lacks = f"has no {repr(name) if name else 'array'} there"
                raise ValueError(self._refused(lacks, value)) from None
        number = _number(value)
        if number is None:
            raise ValueError(self._refused("is no number", value))
        return self.sign * number

    def _refused(self, problem, value):
        named = f"{passed(f'columns[{self.column!r}]')} was {self.named!r}"
        return f"{named}; a {self.msgtype} {problem}: {_contents(value)}"


def _mean_on(side, names, values):
    """The mean of the values whose names are on a side; NaN without one."""
    chosen = [value for name, value in zip(names, values) if side.search(name.lower())]
    return np.mean(chosen) if chosen else np.nan


def _number(value):
    """A number, a time [s] or the yaw of a quaternion [rad]; None for anything else."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        return float(value)
    names = {*_names(value)}
    if {"sec", "nanosec"} <= names:
        return value.sec + 1e-9 * value.nanosec
    if {"x", "y", "z", "w"} <= names:
        sine = 2 * (value.w * value.z + value.x * value.y)
        return float(np.arctan2(sine, 1 - 2 * (value.y**2 + value.z**2)))
    return None


def _names(value):
    return [name for name in getattr(value, "__annotations__", {}) if not name.startswith("__")]


def _contents(value):
    """What there is instead, as the end of a sentence."""
    if isinstance(value, list | tuple | np.ndarray):
        return f"an array of {len(value)}, of which [0] is the first entry"
    names = _names(value)
    return f"it has {', '.join(names[:_LONGEST])}" if names else f"it is a {type(value).__name__}"


def _listed(types):
    """The topics of a bag and their types, as part of a sentence."""
    texts = [f"{name} ({kind})" for name, kind in types.items()]
    more = [f"{len(texts) - _LONGEST} more"] if len(texts) > _LONGEST else []
    return ", ".join([*texts[:_LONGEST], *more]) or "none"


def _fields_by_topic(columns, types):
    """{topic: its _Fields} among the columns that a user names.

    Args:
        columns: {column of a recording: path, or another column's name}.
        types: {topic: type of its messages} of a bag.

    Raises:
        ValueError: If a path names no topic of the bag, or is none.
    """
    fields = {}
    for column, given in columns.items():
        path = given.removeprefix("-") if given.startswith("-/") else given
        topic = next((name for name in types if path.startswith((f"{name}.", f"{name}["))), "")
        rest = path[len(topic) :]
        if not topic and not path.startswith("/"):
            continue
        if not topic:
            wanted = f"begin with a topic and a point, and the bag has {_listed(types)}"
        elif not re.fullmatch(f"({_STEP.pattern})+", rest):
            wanted = "end in fields and places in arrays, such as .pose.position.x or .velocity[0]"
        elif column == "t_s":
            wanted = "not be given: the time of a bag's rows is that of its messages"
        else:
            sign = 1 if path == given else -1
            field = _Field(column, rest, path, types[topic], sign)
            fields.setdefault(topic, []).append(field)
            continue
        raise ValueError(f"{passed(f'columns[{column!r}]')} was {given!r}; it should {wanted}")
    return fields


# How topics are chosen for the roles


def _topic_for(types, topics, role):
    """The topic of {topic: type} that has a role, among `topics` if the user passes some."""
    kinds = [*_ROLES[role]]
    suitable = [name for name in topics or types if types[name] in kinds]
    if not suitable:
        readable = ", ".join(kind.rsplit("/", 1)[1] for kind in kinds)
        raise ValueError(
            f"no topic for {role} ({readable}) among {_listed(types)}; "
            f"{passed('columns', {'x_m': '/topic.field'})} reads fields of any type"
        )
    best = min((types[name] for name in suitable), key=kinds.index)
    suitable = [name for name in suitable if types[name] == best]
    if topics is None and len(suitable) > 1:
        raise ValueError(
            f"several topics for {role}, {', '.join(suitable)}; {passed('topics')} should name one"
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
            f"{passed('topics', (positions,))} reads them as real positions"
        )
    if _FILTERED in positions and not are_named:
        raise ValueError(
            f"{only}, an estimate that has seen the encoders; record its receiver, or name it by "
            f"{passed('topics')} if these are real positions"
        )
    if encoders and types[encoders].endswith("JointState") and wheel_radius_m is None:
        raise ValueError(
            f"{passed('wheel_radius_m')} was None; {encoders} has wheel speeds in rad/s, which "
            f"need it and then {passed('track_width_m')}"
        )


def _choose(types, topics, given, wheel_radius_m):
    """{role: topic}, and {role: remark} where no topic has a role.

    Where a user names fields, these may be all that is wanted: what else cannot be chosen is left
    out then.

    Args:
        types: {topic: type of its messages}.
        topics, wheel_radius_m: As in `rhec.logs.read`.
        given: The columns that fields fill.
    """
    unknown = [name for name in topics or () if name not in types]
    if unknown:
        raise ValueError(f"{passed('topics')} named {unknown[0]!r}; the bag has {', '.join(types)}")
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
            if not given and role not in _OPTIONAL:
                raise
            chosen.pop(role, None)
            remarks[role] = f"none: {refused}"
    return chosen, remarks


# How messages are read


class _Reading(NamedTuple):
    """What is read from the messages of a topic."""

    name: str  # a role, or the columns that fields fill
    topic: str
    fields: list
    stamps_ns: list  # by headers, 0 where one has no stamp
    received_ns: list  # by the recorder
    rows: list  # the values of each message

    def table(self, times_ns, wheel_radius_m):
        """The values as a table, indexed by time [ns]; of equal times the first one counts."""
        columns = [field.column for field in self.fields]
        table = pd.DataFrame(self.rows, times_ns, columns, dtype=float)
        if wheel_radius_m is not None:
            table[table.columns.intersection(TRACKS)] *= wheel_radius_m
        if self.name in _ROLES:
            table = _with_sigma(table)
        return table[~table.index.duplicated()]


def _with_sigma(table):
    """A table of positions without those of no fix, and with σ [m] in place of variances."""
    if _STATUS in table:
        table[table[_STATUS] < 0] = np.nan
        table.loc[~(table.pop(_IS_KNOWN) > 0), _VARIANCES] = np.nan
        table = table.drop(columns=_STATUS)
    if _VARIANCES[0] in table:
        variance = table[_VARIANCES].mean(axis=1, skipna=False)
        is_one = (variance > 0) & (variance < _UNKNOWN_VARIANCE)
        table = table.drop(columns=_VARIANCES)
        table["position_sigma_m"] = np.sqrt(variance.where(is_one))
    return table


def _stamp_ns(message):
    """The time in a message's header [ns]; 0 without one, as in a header without a stamp."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return stamp.sec * 10**9 + stamp.nanosec if stamp else 0


def _why_recorder(readings):
    """Why the times of all topics are those of the recorder; "" where headers have one clock."""
    late_s = {}
    for each in readings:
        if unstamped := each.stamps_ns.count(0):
            return f"{unstamped} of {len(each.rows)} headers of {each.topic} have no stamp"
        if each.rows:
            late_ns = np.subtract(each.received_ns, each.stamps_ns)
            late_s[each.topic] = 1e-9 * float(np.median(late_ns))
    apart_s = np.ptp([*late_s.values()] or [0.0])
    if apart_s > _ONE_CLOCK_S:
        return f"the headers of {' and '.join(late_s)} have clocks {apart_s:.3g} s apart"
    return ""


def _take_messages(bag, readings):
    """Fill the readings from an open bag."""
    n_values = 0
    for topic, received_ns, message in messages(bag, {reading.topic for reading in readings}):
        for reading in readings:
            if reading.topic == topic:  # an Odometry may have several roles
                reading.stamps_ns.append(_stamp_ns(message))
                reading.received_ns.append(received_ns)
                reading.rows.append([field.value(message) for field in reading.fields])
                n_values += len(reading.fields)
        if n_values > MOST_VALUES:
            raise ValueError(f"its topics have more than {MOST_VALUES} values")


def _read(bag, topics, columns, wheel_radius_m):
    """The table of an open bag, with the columns of fields in its attrs, and what was inferred."""
    types = {name: topic.msgtype or "" for name, topic in bag.topics.items()}
    by_topic = _fields_by_topic(columns, types)
    given = [field.column for fields in by_topic.values() for field in fields]
    chosen, inferred = _choose(types, topics, {*given}, wheel_radius_m)
    readings = []
    for role, topic in chosen.items():
        paths = _ROLES[role][types[topic]]
        fields = [_Field(name, path, topic + path, types[topic]) for name, path in paths.items()]
        readings.append(_Reading(role, topic, fields, [], [], []))
    for topic, fields in by_topic.items():
        name = ", ".join(field.column for field in fields)
        readings.append(_Reading(name, topic, fields, [], [], []))
    _take_messages(bag, readings)
    why = _why_recorder(readings)
    inferred["time"] = f"by the recorder, because {why}" if why else "by the headers"
    table = pd.DataFrame()
    for each in readings:
        times_ns = each.received_ns if why else each.stamps_ns
        disorder = int((np.diff(times_ns) < 0).sum())
        told = f"{types[each.topic]}, {len(times_ns)} messages, {disorder} out of order"
        inferred[each.name] = f"{each.topic}, {told}"
        table = table.join(each.table(times_ns, wheel_radius_m), how="outer")
    if not len(table):
        raise ValueError(f"no message on {', '.join(each.topic for each in readings)}")
    if "position_sigma_m" in table and table["position_sigma_m"].isna().all():
        table = table.drop(columns="position_sigma_m")
    table.insert(0, "t_s", (table.index - table.index[0]) * 1e-9)
    table = table.reset_index(drop=True)
    table.attrs["fields"] = given
    read_topics = {reading.topic for reading in readings}
    unread = {name: kind for name, kind in types.items() if name not in read_topics}
    if unread:
        inferred["other topics"] = _listed(unread)
    return table, inferred


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
