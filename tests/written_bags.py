"""ROS bags written with the library that reads them."""

import functools

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_NS = 1_722_264_375_000_000_000
TF = "tf2_msgs/msg/TFMessage"
# A type that no distribution of ROS has.
DRIVE = "fpn_msgs/msg/Drive"
DRIVE_DEFINITION = "std_msgs/Header header\nfloat64[4] speeds\nfloat32 yaw_rate\nstring mode\n"


@functools.cache
def store_of(kind):
    """The types of a kind of bag. A store compiles each type that it writes, so it is kept."""
    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.LATEST)
    store.register(get_types_from_msg(DRIVE_DEFINITION, DRIVE))
    if TF not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))
    return store


def write_bag(folder, kind, messages, packed=None, period_ns=10**6):
    """A bag of (topic, type, stamp [ns], message) in this order, each received a period later.

    packed: "BZ2" or "LZ4" for a .bag, "STORAGE" (of chunks) or "MESSAGE" for the others.
    """
    store = store_of(kind)
    types = {topic: name for topic, name, *_ in messages}
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
        for row, (topic, name, stamp, message) in enumerate(messages):
            writer.write(
                lines[topic], START_NS + row * period_ns, serialize(message(store, stamp), name)
            )
    return next(file.glob("*.mcap")) if kind == "mcap" else file


def header(store, stamp, name="map"):
    time = store.types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
    made = store.types["std_msgs/msg/Header"]
    return made(0, time, name) if "seq" in made.__annotations__ else made(time, name)


def of(store, kind, /, **fields):
    return store.types[kind.replace("/", "/msg/")](**fields)


def xyz(store, name, x=0.0, y=0.0, z=0.0):
    return of(store, f"geometry_msgs/{name}", x=float(x), y=float(y), z=float(z))


def pose(store, x, y):
    turn = of(store, "geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    return of(store, "geometry_msgs/Pose", position=xyz(store, "Point", x, y), orientation=turn)


def twist(store, speed, yaw_rate):
    linear, angular = xyz(store, "Vector3", speed), xyz(store, "Vector3", z=yaw_rate)
    return of(store, "geometry_msgs/Twist", linear=linear, angular=angular)


def odometry(x, y, speed, yaw_rate, variances=(0.0, 0.0)):
    def message(store, stamp):
        nothing = np.zeros(36)
        of_pose = np.diag([*variances, 0.0, 0.0, 0.0, 0.0]).ravel()
        place = of(
            store, "geometry_msgs/PoseWithCovariance", pose=pose(store, x, y), covariance=of_pose
        )
        motion = of(
            store,
            "geometry_msgs/TwistWithCovariance",
            twist=twist(store, speed, yaw_rate),
            covariance=nothing,
        )
        return of(
            store,
            "nav_msgs/Odometry",
            header=header(store, stamp),
            child_frame_id="base",
            pose=place,
            twist=motion,
        )

    return message


def joint_state(left, right):
    def message(store, stamp):
        names = ["front_left_wheel", "front_right_wheel", "rl_wheel", "rr_wheel", "mast"]
        speeds = np.array([left, right, left, right, 7.0])
        return of(
            store,
            "sensor_msgs/JointState",
            header=header(store, stamp),
            name=names,
            position=np.zeros(5),
            velocity=speeds,
            effort=np.zeros(5),
        )

    return message


def fix(latitude, longitude, status=0, frame="map", variances=None):
    """A NavSatFix that declares the variances (east, north) [m²] of its position, or none."""
    east, north = variances or (0.5, 0.5)  # what no receiver declares is none of it

    def message(store, stamp):
        known = of(store, "sensor_msgs/NavSatStatus", status=status, service=1)
        return of(
            store,
            "sensor_msgs/NavSatFix",
            header=header(store, stamp, frame),
            status=known,
            latitude=latitude,
            longitude=longitude,
            altitude=100.0,
            position_covariance=np.diag([east, north, 0.0]).ravel(),
            position_covariance_type=2 if variances else 0,
        )

    return message


def imu(rate, force, frame="imu"):
    """An Imu with these yaw rates and specific forces in its own axes."""

    def message(store, stamp):
        turn = of(store, "geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
        covariances = (
            "orientation_covariance",
            "angular_velocity_covariance",
            "linear_acceleration_covariance",
        )
        return of(
            store,
            "sensor_msgs/Imu",
            header=header(store, stamp, frame),
            orientation=turn,
            angular_velocity=xyz(store, "Vector3", *rate),
            linear_acceleration=xyz(store, "Vector3", *force),
            **{name: np.zeros(9) for name in covariances},
        )

    return message


def pose_stamped(x, y):
    return lambda store, stamp: of(
        store, "geometry_msgs/PoseStamped", header=header(store, stamp), pose=pose(store, x, y)
    )


def twist_stamped(speed, yaw_rate):
    return lambda store, stamp: of(
        store,
        "geometry_msgs/TwistStamped",
        header=header(store, stamp),
        twist=twist(store, speed, yaw_rate),
    )


def transform(parent, child, place, turn=(0.0, 0.0, 0.0, 1.0)):
    """A static transform from a parent to a child at a place [m], turned by a quaternion xyzw."""

    def message(store, stamp):
        rotation = of(store, "geometry_msgs/Quaternion", **dict(zip("xyzw", map(float, turn))))
        there = of(
            store,
            "geometry_msgs/Transform",
            translation=xyz(store, "Vector3", *place),
            rotation=rotation,
        )
        stamped = of(
            store,
            "geometry_msgs/TransformStamped",
            header=header(store, stamp, parent),
            child_frame_id=child,
            transform=there,
        )
        return of(store, "tf2_msgs/TFMessage", transforms=[stamped])

    return message


def drive(speeds, yaw_rate):
    """A message of a type of one's own."""
    return lambda store, stamp: of(
        store,
        "fpn_msgs/Drive",
        header=header(store, stamp),
        speeds=np.array(speeds, dtype=float),
        yaw_rate=float(yaw_rate),
        mode="auto",
    )


def text(content):
    return lambda store, stamp: of(store, "std_msgs/String", data=content)
