"""ROS 1 and ROS 2 bags (.bag, .db3, .mcap) as a table with one row for each time stamp."""

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.simulation.columns import TRACKS

SUFFIXES = (".bag", ".db3", ".mcap")
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
# The specific force of a body at rest points up, with the size of gravity [m/s²].
_GRAVITY = (8.0, 11.5)


def _optional_topic(types, topics, role):
    """The only topic of a role that a bag may lack, and a remark where none can be chosen."""
    suitable = [name for name in topics or types if types[name] in _ROLES[role]]
    if len(suitable) == 1:
        return suitable[0], None
    if suitable:
        return None, f"none of {', '.join(suitable)}: topics should name one"
    return None, None


def _about_vertical(table):
    """The yaw rate about the vertical in a table of `_imu`, and how its axis was found."""
    rate = table.to_numpy()[:, :3]
    force = np.nanmean(table.to_numpy()[:, 3:], axis=0)
    size = float(np.linalg.norm(force))
    if not _GRAVITY[0] < size < _GRAVITY[1]:
        return rate[:, 2], "about its z axis, because it measures no gravity"
    up = force / size
    axis = ", ".join(f"{entry:.2f}" for entry in up)
    return rate @ up, f"about the vertical by gravity, ({axis}) in its axes"


def _choose(types, topics, role):
    """The topic of {topic: type} that has a role, among `topics` if the user passes some."""
    kinds = [*_ROLES[role]]
    suitable = [name for name in topics or types if types[name] in kinds]
    if not suitable:
        present = ", ".join(f"{name} ({kind})" for name, kind in types.items())
        readable = ", ".join(kind.rsplit("/", 1)[1] for kind in kinds)
        raise ValueError(f"no topic for {role} ({readable}) among {present or 'none'}")
    best = min((types[name] for name in suitable), key=kinds.index)
    suitable = [name for name in suitable if types[name] == best]
    if topics is None and len(suitable) > 1:
        raise ValueError(
            f"several topics for {role}, {', '.join(suitable)}; topics should name one"
        )
    # If two topics have the same type, the user lists the topic of the positions first.
    return suitable[0 if role == "positions" else -1]


def _refuse_own_positions(chosen):
    """Raise a ValueError for positions that were made of the encoders."""
    topic = chosen["positions"]
    if topic == chosen["encoders"]:
        raise ValueError(
            f"the bag's only positions are those of {topic}, which are the integral of its own "
            f"speeds; record a receiver, or topics=({topic!r},) reads them as real positions"
        )
    if _FILTERED in topic:
        raise ValueError(
            f"the bag's only positions are those of {topic}, an estimate that has seen the "
            "encoders; record its receiver, or name topics if these are real positions"
        )


def _read(reader, topics, wheel_radius_m):
    """The table of an open bag, and {property: inferred value}."""
    types = {name: topic.msgtype for name, topic in reader.topics.items()}
    unknown = [name for name in topics or () if name not in types]
    if unknown:
        raise ValueError(f"topics named {unknown[0]!r}; the bag has {', '.join(types)}")
    chosen = {role: _choose(types, topics, role) for role in _ROLES if role not in _OPTIONAL}
    optional = {role: _optional_topic(types, topics, role) for role in _OPTIONAL}
    chosen |= {role: topic for role, (topic, _) in optional.items() if topic}
    if topics is None:
        _refuse_own_positions(chosen)
    encoders = chosen["encoders"]
    if types[encoders].endswith("JointState") and wheel_radius_m is None:
        raise ValueError(f"wheel_radius_m was None; {encoders} has wheel speeds in rad/s")
    messages = _messages(reader, types, chosen)
    tables = []
    inferred = {role: remark for role, (_, remark) in optional.items() if remark}
    for role, topic in chosen.items():
        source = _ROLES[role][types[topic]]
        stamps_ns, values = messages[role]
        table = pd.DataFrame(values, index=stamps_ns, columns=source.columns, dtype=float)
        disorder = int((np.diff(table.index) < 0).sum())
        inferred[role] = f"{topic}, {types[topic]}, {len(table)} messages, {disorder} out of order"
        if source.columns is TRACKS:
            table *= wheel_radius_m
        if role == "gyro":
            rate, axis = _about_vertical(table)
            table = pd.DataFrame(dict(gyro_radps=rate), index=table.index)
            inferred[role] += f", {axis}"
        tables.append(table[~table.index.duplicated()].sort_index())
    table = tables[0]
    for other in tables[1:]:
        table = table.join(other, how="outer")
    if table["position_sigma_m"].isna().all():
        table = table.drop(columns="position_sigma_m")
    table.insert(0, "t_s", (table.index - table.index[0]) * 1e-9)
    return table.reset_index(drop=True), inferred


def _messages(reader, types, chosen):
    """{role: (time stamps [ns], values)} of the chosen topics {role: topic} of an open bag."""
    messages = {role: ([], []) for role in chosen}
    topics = set(chosen.values())
    connections = [connection for connection in reader.connections if connection.topic in topics]
    for connection, received_ns, raw in reader.messages(connections):
        message = reader.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp
        for role, topic in chosen.items():
            if topic == connection.topic:  # an Odometry may have both roles
                stamps_ns, values = messages[role]
                # A header without a stamp has zeros; the recorder's time replaces it.
                stamps_ns.append(stamp.sec * 10**9 + stamp.nanosec or received_ns)
                values.append(_ROLES[role][types[topic]].values(message))
    return messages


def read_bag(file, topics, wheel_radius_m):
    """The table of a bag, and {property: inferred value}.

    Args:
        file: Path of the bag.
        topics, wheel_radius_m: As in `rhec.logs.read`.

    Raises:
        ValueError: If rosbags is not installed, or if the bag cannot be read.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise ValueError("a bag needs the package rosbags: pip install 'rhec[logs]'") from None
    try:
        with AnyReader([file], default_typestore=get_typestore(Stores.LATEST)) as reader:
            return _read(reader, topics, wheel_radius_m)
    except ValueError:
        raise
    except Exception as error:  # any error that a parser raises for a broken file
        raise ValueError(f"{type(error).__name__}: {error}{_remedy(file)}") from None


def _remedy(file):
    """What repairs a bag whose recording was cut off, as the end of a sentence."""
    commands = {".mcap": "mcap recover", ".bag": "rosbag reindex", ".db3": "ros2 bag reindex"}
    inside = next((path.suffix for path in sorted(file.glob("*.[md]*"))), "")
    command = commands.get(file.suffix) or commands.get(inside)
    return f"; if the recording was cut off, {command} may repair it" if command else ""
