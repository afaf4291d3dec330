"""ROS bags written with the library that reads them."""

import functools
from typing import NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_722_264_375_000_000_000
# A type that no distribution of ROS has.
DRIVE = "fpn_msgs/msg/Drive"
DRIVE_DEFINITION = "std_msgs/Header header\nfloat64[4] speeds\nfloat32 yaw_rate\nstring mode\n"


@functools.cache
def store_of(kind):
    """The types of a kind of bag. A store compiles each type that it writes, so it is kept."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.LATEST)
    store.register(get_types_from_msg(DRIVE_DEFINITION, DRIVE))
    return store


class Message(NamedTuple):
    """A message whose fields are 0 or empty but for these."""

    type: str
    fields: dict  # {path: value}

    def made(self, store, stamp):
        """The message in the types of a store, with a stamp [ns] in its header if it has one."""
        message = empty(store, self.type)
        fields = {"header.stamp.sec": stamp // 10**9, "header.stamp.nanosec": stamp % 10**9}
        for path, value in ((fields if hasattr(message, "header") else {}) | self.fields).items():
            *parents, last = path.split(".")
            setattr(functools.reduce(getattr, parents, message), last, value)
        return message


def empty(store, name):
    """A message of a type with nothing in it."""
    _, fields = store.fielddefs[name]
    return store.types[name](**{field: nothing(store, *form) for field, form in fields})


def nothing(store, form, of):
    """What stands in an empty field of a form, which is that of a type, a number or an array."""
    if form == Nodetype.NAME:
        return empty(store, of)
    if form == Nodetype.BASE:
        return "" if of[0] == "string" else 0
    (_, (kind, _)), n = of
    return [] if kind == "string" else np.zeros(n, kind)


def write_bag(folder, kind, messages, packed=None, period_ns=10**6):
    """A bag of (topic, stamp [ns], Message) in this order, each received a period later.

    packed: "BZ2" or "LZ4" for a .bag, "STORAGE" (of chunks) or "MESSAGE" for the others.
    """
    store = store_of(kind)
    types = {topic: message.type for topic, _, message in messages}
    if kind == "bag":
        file, writer = folder / "log.bag", Writer1(folder / "log.bag")
    else:
        file = folder / f"log_{kind}"
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer2(file, version=9, storage_plugin=plugin)
    serialize = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
    if packed and kind == "bag":
        writer.set_compression(Writer1.CompressionFormat[packed])
    elif packed:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with writer:
        lines = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in types.items()
        }
        for row, (topic, stamp, message) in enumerate(messages):
            content = serialize(message.made(store, stamp), message.type)
            writer.write(lines[topic], START_NS + row * period_ns, content)
    return next(file.glob("*.mcap")) if kind == "mcap" else file


def of_pose(before, x, y):
    fields = {"position.x": x, "position.y": y, "orientation.w": 1.0}
    return {f"{before}.{path}": value for path, value in fields.items()}


def of_twist(before, speed, yaw_rate):
    return {f"{before}linear.x": speed, f"{before}angular.z": yaw_rate}


def odometry(x, y, speed, yaw_rate, variances=(0.0, 0.0)):
    covariance = np.diag([*variances, 0.0, 0.0, 0.0, 0.0]).ravel()
    fields = of_pose("pose.pose", x, y) | of_twist("twist.twist.", speed, yaw_rate)
    return Message("nav_msgs/msg/Odometry", fields | {"pose.covariance": covariance})


def joint_state(left, right):
    names = ["front_left_wheel", "front_right_wheel", "rl_wheel", "rr_wheel", "mast"]
    speeds = np.array([left, right, left, right, 7.0])
    return Message("sensor_msgs/msg/JointState", dict(name=names, velocity=speeds))


def fix(latitude, longitude, status=0, variances=None):
    """A NavSatFix that declares the variances (east, north) [m²] of its position, or none."""
    east, north = variances or (0.5, 0.5)  # what no receiver declares is none of it
    fields = dict(latitude=latitude, longitude=longitude, altitude=100.0)
    fields |= dict(position_covariance=np.diag([east, north, 0.0]).ravel())
    fields |= {"position_covariance_type": 2 if variances else 0, "status.status": status}
    return Message("sensor_msgs/msg/NavSatFix", fields)


def imu(rate, force):
    """An Imu with these yaw rates and specific forces in its own axes."""
    fields = {f"angular_velocity.{axis}": value for axis, value in zip("xyz", rate)}
    fields |= {f"linear_acceleration.{axis}": value for axis, value in zip("xyz", force)}
    return Message("sensor_msgs/msg/Imu", fields)


def pose_stamped(x, y):
    return Message("geometry_msgs/msg/PoseStamped", of_pose("pose", x, y))


def twist_stamped(speed, yaw_rate):
    return Message("geometry_msgs/msg/TwistStamped", of_twist("twist.", speed, yaw_rate))


def drive(speeds, yaw_rate):
    """A message of a type of one's own."""
    return Message(DRIVE, dict(speeds=np.array(speeds, float), yaw_rate=yaw_rate, mode="auto"))


def text(content):
    return Message("std_msgs/msg/String", dict(data=content))
