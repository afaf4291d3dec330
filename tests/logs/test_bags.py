"""Bags: fields of any message, one clock for all topics, recordings that were cut off."""

import re
import shutil
import sqlite3
from contextlib import closing

import numpy as np
import pytest
from written_bags import (
    START_NS,
    drive,
    fix,
    imu,
    joint_state,
    odometry,
    pose_stamped,
    text,
    write_bag,
)

import rhec
from rhec.logs import bag_files

KINDS = ["bag", "folder", "mcap"]
N = 40


def at(row):
    return START_NS + row * 10**8


def driven():
    """Messages of a type of one's own, and of an odometry."""
    messages = []
    for row in range(N):
        messages.append(("/drive", at(row), drive([row, 2, 3, 4 + row], 0.5 * row)))
        messages.append(("/odom", at(row), odometry(row, -row, 9.0, 9.0)))
    return messages


# Fields


@pytest.mark.parametrize("kind", KINDS)
def test_fields_of_any_type_become_columns(tmp_path, kind):
    """Of messages with the same stamp the one that comes first counts."""
    columns = {
        "x_m": "/odom.pose.pose.position.x",
        "y_m": "/odom.pose.pose.position.y",
        "v_left_mps": "/drive.speeds[0]",
        "v_right_mps": "/drive.speeds[-1]",
        "gyro_radps": "/drive.yaw_rate",
        "heading_rad": "/odom.pose.pose.orientation",
        "sent_s": "/odom.header.stamp",
        "again_m": "y_m",  # no field, but a column that is one
        "none": "/drive.speeds[7]",  # beyond the array
    }
    again = [("/drive", at(row), drive([99, 99, 99, 99], 99)) for row in range(N)]
    again += [("/odom", at(row), odometry(99, 99, 99, 99)) for row in range(N)]
    log = rhec.logs.read(write_bag(tmp_path, kind, driven() + again), columns=columns)
    rows = np.arange(N)
    expected = dict(t_s=0.1 * rows, x_m=rows, y_m=-rows, v_left_mps=rows, v_right_mps=4 + rows)
    expected |= dict(gyro_radps=0.5 * rows, heading_rad=0, again_m=-rows, none=np.nan)
    expected |= dict(sent_s=1e-9 * START_NS + 0.1 * rows)
    assert {*log} == {"t_s", *columns}
    for name, values in expected.items():
        np.testing.assert_allclose(log[name], values, atol=1e-6)
    assert log.attrs["inferred"]["x_m, y_m, heading_rad, sent_s"].startswith("/odom, nav_msgs")


def test_a_bag_with_too_many_values_is_refused(tmp_path, monkeypatch):
    """Those of two fields, and of positions with their variances."""
    file = write_bag(tmp_path, "mcap", driven())
    columns = dict(wheel="/drive.speeds[0]", east="/odom.pose.pose.position.x")
    monkeypatch.setattr("rhec.logs.bags.MOST_VALUES", 6 * N)
    assert len(rhec.logs.read(file, columns=columns)) == N
    monkeypatch.setattr("rhec.logs.bags.MOST_VALUES", 6 * N - 1)
    with pytest.raises(ValueError, match=f"its topics have more than {6 * N - 1} values"):
        rhec.logs.read(file, columns=columns)


def test_of_two_topics_of_a_type_the_first_has_the_positions_and_the_last_the_speeds(tmp_path):
    of_topic = {"/receiver": (1.0, 2.0, 3.0, 4.0), "/wheels": (5.0, 6.0, 7.0, 8.0)}
    messages = [
        (topic, at(row), odometry(*numbers))
        for row in range(N)
        for topic, numbers in of_topic.items()
    ]
    file = write_bag(tmp_path, "mcap", messages)
    for first, last in (("/receiver", "/wheels"), ("/wheels", "/receiver")):
        log = rhec.logs.read(file, topics=(first, last))
        found = log[["x_m", "y_m", "speed_mps", "yaw_rate_radps"]].iloc[0]
        assert tuple(found) == (*of_topic[first][:2], *of_topic[last][2:])
        assert "gyro" not in log.attrs["inferred"]  # which none of the topics is for


DECLARED = [((0.04, 0.16), 0.1**0.5), ((2.5e4, 2.5e4), np.nan), ((-1.0, -1.0), np.nan)]


@pytest.mark.parametrize("variances, sigma_m", [*DECLARED, (None, np.nan)])
def test_the_noise_that_a_receiver_declares_is_a_column(tmp_path, variances, sigma_m):
    """Of x and y in the mean; NaN where it is unknown, or as large as what means that."""
    messages = []
    for row in range(N):
        told = variances if row % 2 else (0.01, 0.01)
        place = fix(46.78, 11.0 + 1e-6 * row, variances=told)
        speeds = odometry(row, 0.0, 0.5, 0.1, told or (0.0, 0.0))
        messages.append(("/fix", at(row), place))
        messages.append(("/odom", at(row), speeds))
    bag = write_bag(tmp_path, "mcap", messages)
    for topics in (("/fix", "/odom"), ("/odom",)):
        declared = rhec.logs.read(bag, topics=topics)["position_sigma_m"]
        np.testing.assert_allclose(declared[::2], 0.1)
        np.testing.assert_allclose(declared[1::2], sigma_m)


def test_a_user_may_name_the_joints_of_a_side(tmp_path):
    """A wheel radius makes speeds of wheels those of tracks; positions come from their topic."""
    bag, _ = recorded(tmp_path, "mcap", rows=20)
    with pytest.raises(ValueError, match="wheel_radius_m was None; /joints has wheel speeds in"):
        rhec.logs.read(bag)
    columns = dict(v_left_mps="-/joints.velocity[left]", v_right_mps="/joints.velocity[right]")
    log = rhec.logs.read(bag, columns=columns, wheel_radius_m=0.5)
    np.testing.assert_array_equal(log["v_left_mps"], -0.5 * np.arange(20))
    np.testing.assert_array_equal(log["v_right_mps"], np.arange(20))
    np.testing.assert_array_equal(log["y_m"], -np.arange(20))


# Axes and clocks


def with_imu(late_s=0.0, unstamped=()):
    """Messages of a receiver, an odometry and an IMU, whose clock may be another one."""
    messages = []
    for row in range(N):
        own = 0 if row in unstamped else at(row) + round(late_s * 1e9)
        messages += [
            ("/fix", at(row), fix(46.78, 11.0 + 1e-6 * row)),
            ("/odom", at(row), odometry(0, 0, 0.5, 0.1)),
            ("/imu", own, imu((0.3, 0, -0.1), (0, 0, -9.81))),
        ]
    return messages


def test_a_gyro_is_about_its_z_axis_or_as_a_field_says(tmp_path):
    """Here the IMU is mounted upside down, and a minus turns the sign."""
    file = write_bag(tmp_path, "mcap", with_imu())
    np.testing.assert_allclose(rhec.logs.read(file)["gyro_radps"], -0.1)
    for path, rate in (("-/imu.angular_velocity.z", 0.1), ("/imu.angular_velocity.x", 0.3)):
        log = rhec.logs.read(file, columns={"gyro_radps": path})
        np.testing.assert_allclose(log["gyro_radps"], rate)


@pytest.mark.parametrize(
    "messages, time",
    [
        (with_imu(), "by the headers"),
        (with_imu(-0.3), "by the headers"),  # slow, but by the same clock
        (with_imu(-2e8), "by the recorder, because the headers of .* have clocks 2e.08 s apart"),
        (with_imu(18.0), "by the recorder, because .* have clocks 18 s apart"),
        (with_imu(unstamped=range(0, N, 7)), "because 6 of 40 headers of /imu have no stamp"),
    ],
)
def test_a_bag_has_one_clock(tmp_path, messages, time):
    """That of the headers if there is one, else that of the recorder for all topics."""
    log = rhec.logs.read(write_bag(tmp_path, "mcap", messages, period_ns=10**8 // 3))
    assert re.search(time, log.attrs["inferred"]["time"])
    assert log["t_s"].max() == pytest.approx(0.1 * (N - 1), abs=0.5)


# Recordings that were cut off


def recorded(tmp_path, kind, rows=3000):
    """A bag of more than a megabyte, which has several chunks or pages, and its file."""
    messages = []
    for row in range(rows):
        messages += [
            ("/pose", at(row), pose_stamped(row, -row)),
            ("/joints", at(row), joint_state(row, 2 * row)),
        ]
    bag = write_bag(tmp_path, kind, messages)
    return bag, next(bag.glob("*.db3")) if bag.is_dir() else bag


REMEDIES = dict(
    bag="rosbag reindex {file}", folder="ros2 bag reindex {bag}", mcap="mcap recover {file} -o NEW"
)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("share", [0.0, 0.001, 0.5, 0.9])
def test_a_bag_that_was_cut_off_is_refused_with_the_command_that_repairs_it(tmp_path, kind, share):
    bag, file = recorded(tmp_path, kind)
    content = file.read_bytes()
    file.write_bytes(content[: int(share * len(content))])
    remedy = REMEDIES[kind].format(bag=bag, file=file)
    with pytest.raises(ValueError, match=f"; if the recording was cut off, {re.escape(remedy)}"):
        rhec.logs.read(bag, wheel_radius_m=0.5)


def test_a_folder_without_its_metadata_is_read(tmp_path):
    bag, file = recorded(tmp_path, "folder", rows=20)
    whole = rhec.logs.read(bag, wheel_radius_m=0.5)
    (bag / "metadata.yaml").unlink()
    np.testing.assert_array_equal(rhec.logs.read(bag, wheel_radius_m=0.5), whole)
    shutil.copy(file, bag / "log_1.db3")  # the second file of a bag that was split
    twice = rhec.logs.read(bag, wheel_radius_m=0.5)
    np.testing.assert_array_equal(twice, whole)  # equal stamps are the same messages


def test_a_bag_may_have_letters_of_a_uri_in_its_name(tmp_path):
    """In that of its folder, and in that of the file alone."""
    bag, file = recorded(tmp_path, "folder", rows=20)
    expected = rhec.logs.read(bag, wheel_radius_m=0.5)
    for name in ("log #3", "what?", "my%20log", "a#?b%c"):
        bag = bag.rename(tmp_path / name)
        file = (bag / file.name).rename(bag / f"{name}.db3")
        for path in (bag, file):
            np.testing.assert_array_equal(rhec.logs.read(path, wheel_radius_m=0.5), expected)


# Bags that were made to do harm


PACKED = [("bag", "LZ4"), ("mcap", "STORAGE"), ("folder", "MESSAGE"), ("mcap", "MESSAGE")]
PACKED += [("bag", "BZ2")]


def packed(tmp_path, kind, how, length):
    """A packed bag with a drive, and a message that unpacks to this length."""
    junk = ("/drive_state", at(0), text("0" * length))
    return write_bag(tmp_path, kind, [*driven(), junk], how)


@pytest.mark.parametrize("kind, how", PACKED)
def test_packed_bags_are_read(tmp_path, kind, how):
    (tmp_path / "plain").mkdir()
    columns = dict(east="/odom.pose.pose.position.x", wheel="/drive.speeds[3]")
    expected = rhec.logs.read(write_bag(tmp_path / "plain", kind, driven()), columns=columns)
    log = rhec.logs.read(packed(tmp_path, kind, how, 1000), columns=columns)
    np.testing.assert_array_equal(log, expected)


@pytest.mark.parametrize("kind, how", PACKED)
def test_a_bag_that_unpacks_to_far_more_than_its_size_is_refused(tmp_path, kind, how, monkeypatch):
    """To more than 64 MB; for all but one kind to more than 64 kB, which takes less time."""
    is_large = how == "LZ4"
    if not is_large:
        monkeypatch.setattr(bag_files, "_LARGEST_CHUNK", 2**16)
    bag = packed(tmp_path, kind, how, 70_000_000 if is_large else 70_000)
    columns = dict(east="/odom.pose.pose.position.x", junk="/drive_state.data")
    with pytest.raises(ValueError, match="unpack to far more than those of a recording"):
        rhec.logs.read(bag, columns=columns)


@pytest.mark.parametrize(
    "sql",
    [
        "CREATE VIEW schema AS WITH RECURSIVE n(schema_version) AS "
        "(SELECT 1 UNION ALL SELECT schema_version + 1 FROM n) SELECT max(schema_version) "
        "AS schema_version FROM n",
        "CREATE TABLE more(id INTEGER, data BLOB AS (zeroblob(1000000000)))",
    ],
)
def test_sql_of_a_bag_is_not_executed(tmp_path, sql):
    bag = write_bag(tmp_path, "folder", driven())
    with closing(sqlite3.connect(next(bag.glob("*.db3")))) as database:
        if "schema" in sql:
            database.execute("DROP TABLE schema")
        database.execute(sql)
        database.commit()
    with pytest.raises(ValueError, match="in it is no plain table"):
        rhec.logs.read(bag, columns=dict(east="/odom.pose.pose.position.x"))
