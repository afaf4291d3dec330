"""Files of logs: what is found in a table's text, and ROS bags written with the library that reads
them."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from helpers import recorded_log
from written_bags import START_NS, fix, odometry, pose_stamped, twist_stamped, write_bag

import rhec

ROOT = Path(rhec.__file__).parents[1]
T = np.arange(0, 20, 0.1).round(3)
LOG = pd.DataFrame(
    dict(t_s=T, x_m=0.5 * T, y_m=np.sin(T), speed_mps=0.5, yaw_rate_radps=0.1 * np.cos(T))
)


def written(tmp_path, log, **how):
    file = tmp_path / "log.csv"
    log.to_csv(file, index=False, **how)
    return file


# Tables


@pytest.mark.parametrize("separator", ["\t", ";", "|", ",", " "])
@pytest.mark.parametrize("decimal", [".", ","])
def test_the_separators_of_a_table_are_found_and_told(tmp_path, separator, decimal):
    if separator == decimal:
        pytest.skip("no number could be told from two")
    log = rhec.logs.read(written(tmp_path, LOG, sep=separator, decimal=decimal))
    pd.testing.assert_frame_equal(log, LOG)
    names = {"\t": "tab", ";": "semicolon", "|": "bar", ",": "comma", " ": "space"}
    assert log.attrs["inferred"]["separator"] == names[separator]
    assert log.attrs["inferred"]["decimal"] == {".": "point", ",": "comma"}[decimal]


@pytest.mark.parametrize(
    "name, of_seconds, told",
    [
        ("t_s", lambda t: t + 1.7e9, "s"),
        ("t_s", lambda t: 1e3 * t, "ms"),  # the name is wrong
        ("t_us", lambda t: 1e6 * t, "us"),
        ("stamp", lambda t: 1e6 * t, "us"),
        ("time_ns", lambda t: START_NS + np.round(1e9 * t).astype(np.int64), "ns"),
        ("t", lambda t: START_NS + np.round(1e9 * t).astype(np.int64), "ns"),
        ("time", lambda t: pd.to_datetime(START_NS + np.round(1e9 * t).astype(int)), "ISO 8601"),
        (  # at the end of summer time
            "t",
            lambda t: [
                f"2024-10-27T02:59:{s + 40:06.3f}+02:00"
                if s < 15
                else f"2024-10-27T01:59:{s + 40:06.3f}+01:00"
                for s in t
            ],
            "ISO 8601",
        ),
    ],
)
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_the_unit_of_the_time_is_found_and_told(tmp_path, name, of_seconds, told, suffix):
    file, other = tmp_path / f"log.{suffix}", LOG.drop(columns="t_s")
    other.insert(0, name, of_seconds(T))
    if suffix == "parquet" and told == "ISO 8601":
        other[name] = pd.to_datetime(other[name], format="ISO8601", utc=True)
    (other.to_csv(file, index=False) if suffix == "csv" else other.to_parquet(file))
    log = rhec.logs.read(file)
    assert log.attrs["inferred"]["time"] == f"{told}, column {name}"
    np.testing.assert_allclose(log["t_s"] - log["t_s"][0], T, atol=1e-6)


@pytest.mark.parametrize("name, step_s", [("t_ms", 1e-3), ("t", 1.0)])
def test_a_unit_in_the_name_tells_a_fast_log_from_a_slow_one(tmp_path, name, step_s):
    rows = np.arange(len(LOG))
    LOG.drop(columns="t_s").assign(**{name: rows}).to_csv(tmp_path / "log.csv", index=False)
    log = rhec.logs.read(tmp_path / "log.csv")
    np.testing.assert_allclose(log["t_s"], step_s * rows)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_table_with_too_many_values_is_refused(tmp_path, monkeypatch, suffix):
    """Of Parquet the columns of numbers count, and no words."""
    file = tmp_path / f"log.{suffix}"
    if suffix == "csv":
        LOG.to_csv(file, index=False)
    else:
        LOG.assign(words="a").to_parquet(file)
    monkeypatch.setattr("rhec.logs.reader.MOST_VALUES", LOG.size)
    pd.testing.assert_frame_equal(rhec.logs.read(file), LOG)
    monkeypatch.setattr("rhec.logs.reader.MOST_VALUES", LOG.size - 1)
    with pytest.raises(ValueError, match=f"should have at most {LOG.size - 1}"):
        rhec.logs.read(file)


TEXT = recorded_log(noise_m=0.02).assign(remark="grün").to_csv(index=False)
# {what a logger or an editor did to a table: its bytes}
SPOILT = {
    "UTF-16": TEXT.encode("utf-16"),
    "Latin-1": TEXT.encode("latin-1"),
    "a row of units": TEXT.replace("\n", "\ns,m,m,m/s,rad/s\n", 1).encode(),
    "a last line that was cut": TEXT[:-20].encode(),
}


@pytest.mark.parametrize("how", SPOILT)
def test_a_table_that_was_spoilt_is_read(tmp_path, how):
    (tmp_path / "log.csv").write_bytes(SPOILT[how])
    assert rhec.doctor(tmp_path / "log.csv").ok


STEERING = "\x1b]0:owned\x07 \x9b31m \u202etxet"  # a terminal's title, colour and direction


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_nothing_in_a_log_steers_a_terminal(tmp_path, suffix):
    file, log = tmp_path / f"log.{suffix}", LOG.rename(columns=dict(t_s=f"more{STEERING}"))
    log.to_csv(file, index=False) if suffix == "csv" else log.to_parquet(file)
    read = rhec.logs.read(file)
    assert read.columns[0].startswith("more\\x1b]0:owned")
    np.testing.assert_array_equal(read, LOG)
    with pytest.raises(ValueError, match="no column t_s") as refused:
        rhec.replay(read)
    assert str(refused.value).isprintable()


def test_nothing_in_a_bag_steers_a_terminal(tmp_path):
    messages = [(STEERING, START_NS, pose_stamped(0, 0))]
    file = write_bag(tmp_path, "mcap", messages)
    with pytest.raises(ValueError, match="no topic for encoders.*owned") as refused:
        rhec.logs.read(file)
    assert str(refused.value).isprintable()


@pytest.mark.parametrize("metadata", [b"{}", b"[]", b"nonsense", b'{"index_columns": [3]}'])
def test_a_parquet_file_with_odd_metadata_is_refused_in_a_sentence(tmp_path, metadata):
    table = pa.table(dict(t_s=[0.0, 0.2], x_m=[0.0, 0.1]))
    pq.write_table(table.replace_schema_metadata({b"pandas": metadata}), tmp_path / "log.parquet")
    with pytest.raises(ValueError, match="^log was .*, which cannot be read: "):
        rhec.logs.read(tmp_path / "log.parquet")


def test_a_slow_log_in_seconds_is_not_a_fast_one_in_milliseconds(tmp_path):
    log = rhec.logs.read(written(tmp_path, LOG.assign(t_s=10 * T)))
    assert log.attrs["inferred"]["time"] == "s, column t_s"


def degrees_of(log, latitude):
    """Latitude and longitude of metres by the ellipsoid's radii of curvature: good to 1e-4."""
    phi, a, e2 = np.deg2rad(latitude), 6378137.0, 0.00669437999014
    w2 = 1 - e2 * np.sin(phi) ** 2
    return dict(
        latitude=latitude + np.rad2deg(log["y_m"] * w2**1.5 / (a * (1 - e2))),
        longitude=11.0 + np.rad2deg(log["x_m"] * np.sqrt(w2) / (a * np.cos(phi))),
    )


@pytest.mark.parametrize("latitude", [-63.0, 0.0, 46.78])
def test_latitude_and_longitude_become_metres(tmp_path, latitude):
    log = LOG.assign(x_m=4 * LOG["x_m"], y_m=40 * LOG["y_m"])
    degrees = log.drop(columns=["x_m", "y_m"]).assign(**degrees_of(log, latitude), altitude=np.nan)
    read = rhec.logs.read(written(tmp_path, degrees))
    np.testing.assert_allclose(read[["x_m", "y_m"]], log[["x_m", "y_m"]], atol=2e-3)
    assert f"latitude {latitude:.7f}, longitude 11.0" in read.attrs["inferred"]["position"]


def with_angles(latitude, longitude):
    log = LOG.drop(columns=["x_m", "y_m"])
    return log.assign(latitude=latitude, longitude=longitude)


def test_a_receiver_without_a_fix_gives_no_origin(tmp_path):
    latitude = np.where(T < 2, 0.0, 52.1 + 1e-6 * T)
    longitude = np.where(T < 2, 0.0, 4.3)
    log = rhec.logs.read(written(tmp_path, with_angles(latitude, longitude)))
    assert log["x_m"][T < 2].isna().all()
    assert log["y_m"].abs().max() < 100


def test_texts_and_lists_of_a_parquet_file_are_left_aside_or_refused_by_name(tmp_path):
    """A small file may have gigabytes of them."""
    table = pd.DataFrame(dict(t_s=[0.0, 0.1], x_m=[0.1, 0.2], phase=list("ab")))
    table = table.assign(time=pd.to_datetime(1e9 * np.arange(2)), rows=[[0.1], [0.2, 0.3]])
    table.to_parquet(tmp_path / "log.parquet")
    assert [*rhec.logs.read(tmp_path / "log.parquet")] == ["t_s", "x_m", "time"]
    table.assign(x_m=["0.1", "0.2"]).to_parquet(tmp_path / "log.parquet")
    with pytest.raises(ValueError, match="its column x_m is of type .*string; it should be numb"):
        rhec.logs.read(tmp_path / "log.parquet")


# Bags


def test_columns_without_names_are_numbered(tmp_path):
    """As `ros2 topic echo --csv` writes them, with the two numbers of a stamp."""
    file = tmp_path / "echo.csv"
    lines = [f"{100 + row // 5},{row % 5 * 200_000_000},{0.1 * row},0.0" for row in range(10)]
    file.write_text("\n".join(lines), encoding="utf-8")
    for stamp in ("", "header.stamp."):
        columns = {f"{stamp}sec": "0", f"{stamp}nanosec": "1", "x_m": "2", "y_m": "3"}
        log = rhec.logs.read(file, columns=columns)
        np.testing.assert_allclose(log["t_s"], 0.2 * np.arange(10))
    assert len(log) == 10 and log["x_m"].iloc[-1] == 0.9
    with pytest.raises(ValueError, match="header: none, the names of the columns are 0, 1, 2"):
        rhec.replay(file)


RANDOM = np.random.default_rng(0)


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """A bag with all types, of 10 s; all but unstamped messages are late by up to 0.3 s."""
    t = np.arange(0, 10, 0.1)
    x, y, speed, yaw_rate = np.cumsum(RANDOM.normal(size=(4, len(t))), axis=1)
    x -= x[0]  # degrees become metres from the first position
    y -= y[0]
    degrees = degrees_of(pd.DataFrame(dict(x_m=x, y_m=y)), 46.78)
    messages = []
    for row, when in enumerate(t):
        stamp = START_NS + round(when * 1e9)
        place = degrees["latitude"][row], degrees["longitude"][row]
        messages += [
            ("/fix", stamp, fix(*place, -1 if row == 50 else 0)),
            ("/pose", stamp, pose_stamped(x[row], y[row])),
            ("/cmd", stamp, twist_stamped(0.1, 0.2)),
            ("/wheels", stamp, twist_stamped(speed[row], yaw_rate[row])),
            ("/odom", 0, odometry(-x[row], -y[row], speed[row], yaw_rate[row])),
        ]
    late_ns = RANDOM.uniform(0, 3e8, len(messages)) * [stamp > 0 for _, stamp, _ in messages]
    order = np.argsort(np.repeat(1e9 * t, 5) + late_ns, kind="stable")
    in_order = [messages[place] for place in order]
    return t, x, y, speed, write_bag(tmp_path_factory.mktemp("many"), "mcap", in_order)


def test_topics_are_chosen_or_found(many):
    t, x, y, speed, file = many
    log = rhec.logs.read(file, topics=("/fix", "/wheels"))
    np.testing.assert_allclose(
        log[["t_s", "x_m", "y_m"]].drop(index=50).T, np.delete([t, x, y], 50, 1), atol=2e-3
    )
    assert np.isnan(log["x_m"][50]) and (log["speed_mps"] == speed).all()
    told = log.attrs["inferred"]
    assert {*re.findall(r"/\w+(?= \()", told["other topics"])} == {"/cmd", "/odom", "/pose"}
    assert told["positions"].startswith("/fix, sensor_msgs/msg/NavSatFix, 100 messages, ")
    assert "0 out of order" not in told["positions"] + told["encoders"]
    log = rhec.logs.read(file, topics=["/pose", "/odom"])
    np.testing.assert_allclose(np.sort(log["x_m"].dropna()), np.sort(x), atol=1e-12)
    log = rhec.logs.read(file, topics=("/odom",))  # without stamps: the recorder's times
    np.testing.assert_allclose(log[["x_m", "speed_mps"]].T, [-x, speed], atol=1e-12)
    assert (log["t_s"].diff()[1:] > 0).all()


@pytest.mark.parametrize(
    "text, columns",
    [
        ("# robot 7, 3 May\n# t_s,x_m,y_m\n0.0,1.5,2\n# a remark\n0.1,2.5,3\n", None),
        ("#t_s x_m y_m\n0.0 1.5 2\n0.1 2.5 3\n", None),
        ("# made by hand\nt_s;x_m ;y_m\n0,0;1,5;2\n0,1;2,5;3\n", None),
        ("# made by hand\n0.0\t1.5\t2\n0.1\t2.5\t3\n", {"t_s": "0", "x_m": "1", "y_m": "2"}),
        (
            "__time,/gps/pose/position/x,y_m\n0.0,-1.5,2\n0.1,-2.5,3\n",
            {"x_m": "-/gps/pose/position/x"},
        ),
        # Where commas separate, a number with a comma stands in quotes.
        ('t_s,x_m,y_m,note\n"0,0","1,5",2,"3,4 m"\n"0,1","2,5",3,\n', None),
        ('t_s,x_m,y_m,note\n0.0,1.5,2,"3,4 m"\n0.1,2.5,3,\n', None),
        # A separator at the end of each row is no column.
        ("t_s,x_m,y_m\n0.0,1.5,2,\n0.1,2.5,3,\n", None),
        ("t_s;x_m;y_m;\n0.0;1.5;2;\n0.1;2.5;3;\n", None),
        ("t_s x_m y_m\n0.0 1.5 2 \n0.1 2.5 3 \n", None),
    ],
)
@pytest.mark.parametrize("suffix", ["csv", "dat", "txt"])
def test_a_table_of_any_logger_is_read(tmp_path, text, columns, suffix):
    (tmp_path / f"log.{suffix}").write_text(text)
    log = rhec.logs.read(tmp_path / f"log.{suffix}", columns=columns)
    np.testing.assert_allclose(log[["t_s", "x_m", "y_m"]], [[0.0, 1.5, 2], [0.1, 2.5, 3]])


@pytest.mark.parametrize("row", ["0.0;1,234.5;-12,345,678.25", "0,0;1.234,5;-12.345.678,25"])
def test_marks_of_thousands_are_read(tmp_path, row):
    (tmp_path / "log.csv").write_text(f"t_s;x_m;y_m\n{row}\n1;2;3\n")
    log = rhec.logs.read(tmp_path / "log.csv")
    np.testing.assert_allclose(log[["x_m", "y_m"]], [[1234.5, -12345678.25], [2, 3]])


def test_several_files_of_one_drive_are_put_together_by_their_clock(tmp_path):
    """One in ISO 8601, one in ms since 1970, which begins 0.1 s later, and one in s; none is asked
    for a name that only another has.
    """
    (tmp_path / "gps.csv").write_text(
        "time,east,y_m\n2024-05-03T10:00:00Z,1,2\n2024-05-03T10:00:01Z,3,4\n"
    )
    (tmp_path / "wheels.csv").write_text(
        "timestamp_ms,v,y_m\n1714730400100,5,0\n1714730400200,6,0\n"
    )
    (tmp_path / "gyro.csv").write_text("# t_s gyro_radps\n1714730400.3 7\n1714730400.4 8\n")
    files = [tmp_path / name for name in ("gps.csv", "wheels.csv", "gyro.csv")]
    log = rhec.logs.read(files, columns=dict(x_m="east", speed_mps="v"))
    t_s = log["t_s"] - log["t_s"][0]
    np.testing.assert_allclose(t_s, [0.0, 0.1, 0.2, 0.3, 0.4, 1.0], atol=1e-6)
    np.testing.assert_array_equal(log["x_m"], [1, *[np.nan] * 4, 3])
    np.testing.assert_array_equal(log["y_m"], [2, *[np.nan] * 4, 4])
    np.testing.assert_array_equal(log["speed_mps"], [np.nan, 5, 6, *[np.nan] * 3])
    np.testing.assert_array_equal(log["gyro_radps"], [*[np.nan] * 3, 7, 8, np.nan])
    with pytest.raises(ValueError, match="columns.'x_m'. was 'easting'; no file has it"):
        rhec.logs.read(files, columns=dict(x_m="easting"))


def test_the_attributes_of_a_file_are_not_those_of_its_log(tmp_path):
    log = LOG.copy()
    log.attrs |= dict(origin=[1.0, 2.0, 3.0], lever_arm_m=[9.0, 9.0])
    log.to_parquet(tmp_path / "log.parquet")
    assert {*rhec.logs.read(tmp_path / "log.parquet").attrs} == {"inferred"}


def test_an_estimate_that_has_seen_the_encoders_is_no_position(tmp_path):
    messages = [("/odometry/filtered", START_NS, pose_stamped(1, 2))]
    messages += [("/wheels", START_NS, twist_stamped(1, 2))]
    file = write_bag(tmp_path, "mcap", messages)
    with pytest.raises(ValueError, match="those of /odometry/filtered, an estimate that has seen"):
        rhec.logs.read(file)
    assert rhec.logs.read(file, topics=("/odometry/filtered", "/wheels"))["x_m"].tolist() == [1]
    fields = dict(speed_mps="/wheels.twist.linear.x", yaw_rate_radps="/wheels.twist.angular.z")
    speeds_alone = rhec.logs.read(file, columns=fields)
    assert [*speeds_alone] == ["t_s", *fields]
    assert "that has seen the encoders" in speeds_alone.attrs["inferred"]["positions"]


def test_a_path_serves_where_a_log_does(tmp_path):
    file = tmp_path / "drive.csv"
    recorded_log(5.0, 30.0, noise_m=0.02).to_csv(file, index=False)
    log = rhec.logs.read(file)
    given = dict(first_yaw_rad=0.4, smooth=False)
    pd.testing.assert_frame_equal(rhec.replay(file, **given), rhec.replay(log, **given))
    assert str(rhec.doctor(str(file))) == str(rhec.doctor(log))
    for takes in (rhec.replay, rhec.doctor, rhec.calibrate):
        with pytest.raises(ValueError, match="missing.csv'; it should be an existing"):
            takes(tmp_path / "missing.csv")


def test_the_multiplier_of_a_driver_is_undone(tmp_path):
    """Its yaw rate is that of the tracks by their true width, divided by the multiplier."""
    log = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)
    log = log[["t_s", "x_m", "y_m", "speed_mps", "yaw_rate_radps"]]
    corrected = log.assign(yaw_rate_radps=log["yaw_rate_radps"] / 2.0)
    file = written(tmp_path, corrected)
    assert [each.code for each in rhec.doctor(file).findings] == ["corrected_yaw_rate"]
    undone = rhec.logs.read(file, wheel_separation_multiplier=2.0)
    np.testing.assert_allclose(undone["yaw_rate_radps"], log["yaw_rate_radps"])
    assert rhec.doctor(undone).ok
