"""ROS 1 and ROS 2 bags (.bag, .db3, .mcap) as a table: each row what was measured at one time."""

import re

import numpy as np
import pandas as pd

from rhec.simulation.columns import TRACKS

__all__ = ["SUFFIXES", "read_bag"]

SUFFIXES = (".bag", ".db3", ".mcap")
_POSITION = ["x_m", "y_m"]
_SPEEDS = ["speed_mps", "yaw_rate_radps"]
_SIDES = [re.compile(rf"{side}|(^|_)[fmrb]?{side[0]}(_|$)") for side in ("left", "right")]


def _fix(message):
    place = message.latitude, message.longitude, message.altitude
    return place if message.status.status >= 0 else (np.nan,) * 3  # no fix


def _pose(message):
    place = getattr(message.pose, "pose", message.pose).position  # with a covariance, or without
    return place.x, place.y


def _twist(message):
    twist = getattr(message.twist, "twist", message.twist)
    return twist.linear.x, twist.angular.z


def _wheels(message):
    """Mean speeds of the wheels on the left and on the right [rad/s]."""
    speeds = [
        [speed for name, speed in zip(message.name, message.velocity) if side.search(name.lower())]
        for side in _SIDES
    ]
    return tuple(np.mean(each) if each else np.nan for each in speeds)


# What is read of each type of message, the preferred first; a role's first type in a bag is used.
_ROLES = {
    "positions": {
        "sensor_msgs/msg/NavSatFix": (["latitude", "longitude", "altitude"], _fix),
        "geometry_msgs/msg/PoseStamped": (_POSITION, _pose),
        "geometry_msgs/msg/PoseWithCovarianceStamped": (_POSITION, _pose),
        "nav_msgs/msg/Odometry": (_POSITION, _pose),
    },
    "encoders": {
        "sensor_msgs/msg/JointState": (TRACKS, _wheels),
        "geometry_msgs/msg/TwistStamped": (_SPEEDS, _twist),
        "nav_msgs/msg/Odometry": (_SPEEDS, _twist),
    },
}


def _choose(types, topics, role):
    """The topic of {topic: type} that has a role."""
    kinds = [*_ROLES[role]]
    able = [name for name in topics or types if types[name] in kinds]
    if not able:
        had = ", ".join(f"{name} ({kind})" for name, kind in types.items())
        known = ", ".join(kind.rsplit("/", 1)[1] for kind in kinds)
        raise ValueError(f"no topic for {role} ({known}) among {had or 'none'}")
    best = min((types[name] for name in able), key=kinds.index)
    able = [name for name in able if types[name] == best]
    if topics is None and len(able) > 1:
        raise ValueError(f"several topics for {role}, {', '.join(able)}; topics should name one")
    return able[0 if role == "positions" else -1]


def _read(reader, topics, wheel_radius_m):
    """The table of an open bag: its rows sorted by the time in the messages' headers (by that of
    the recorder where they have none), one for each time.
    """
    types = {name: topic.msgtype for name, topic in reader.topics.items()}
    unknown = [name for name in topics or () if name not in types]
    if unknown:
        raise ValueError(f"topics named {unknown[0]!r}; the bag has {', '.join(types)}")
    chosen = {role: _choose(types, topics, role) for role in _ROLES}
    if types[chosen["encoders"]].endswith("JointState") and wheel_radius_m is None:
        raise ValueError(f"wheel_radius_m was None; {chosen['encoders']} has wheel speeds in rad/s")
    stamps = {role: [] for role in _ROLES}
    values = {role: [] for role in _ROLES}
    wanted = [each for each in reader.connections if each.topic in chosen.values()]
    for connection, received_ns, raw in reader.messages(wanted):
        message = reader.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp
        for role, topic in chosen.items():
            if topic == connection.topic:
                stamps[role].append(stamp.sec * 10**9 + stamp.nanosec or received_ns)
                values[role].append(_ROLES[role][connection.msgtype][1](message))
    tables = []
    found = {}
    for role, topic in chosen.items():
        columns = _ROLES[role][types[topic]][0]
        table = pd.DataFrame(values[role], index=stamps[role], columns=columns, dtype=float)
        disorder = int((np.diff(table.index) < 0).sum())
        found[role] = f"{topic}, {types[topic]}, {len(table)} messages, {disorder} out of order"
        if columns is TRACKS:
            table *= wheel_radius_m
        tables.append(table[~table.index.duplicated()].sort_index())
    table = tables[0].join(tables[1], how="outer")
    table.insert(0, "t_s", (table.index - table.index[0]) * 1e-9)
    return table.reset_index(drop=True), found


def read_bag(file, topics, wheel_radius_m):
    """A bag's table, and what was found in it."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError:
        raise ValueError("a bag needs the package rosbags: pip install 'rhec[bags]'") from None
    try:
        with AnyReader([file], default_typestore=get_typestore(Stores.LATEST)) as reader:
            return _read(reader, topics, wheel_radius_m)
    except ValueError:
        raise
    except Exception as error:  # whatever the parser of a broken file comes to
        raise ValueError(f"{type(error).__name__}: {error}") from None
