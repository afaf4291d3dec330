"""Recordings are fetched from where they are published, as they were, and read as data."""

import contextlib
import functools
import hashlib
import http.server
import pickle
import re
import threading

import fetch_recordings
import numpy as np
import pandas as pd
import pytest
from convert_recordings import convert
from helpers import Bomb, may_be_unsure
from scipy.integrate import cumulative_trapezoid
from written_bags import START_NS, odometry, write_bag

import rhec
from notebooks.rivals import RIVALS

FRAME = pd.DataFrame(dict(t_ns=np.arange(5) * 50_000_000, left=np.linspace(0, 1, 5)))


@contextlib.contextmanager
def published(frame, tmp_path, **about):
    """A host that publishes a frame, and the table that says so."""
    file = tmp_path / "served" / "someone" / "robots" / "c0ffee" / "to add" / "frame.pkl"
    file.parent.mkdir(parents=True)
    columns = pd.Index(frame.columns, dtype=object)  # as older pandas wrote names
    frame.set_axis(columns, axis=1).to_pickle(file)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    source = dict(repository="someone/robots", commit="c0ffee", path="to add/frame.pkl")
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=tmp_path / "served")
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        table = dict(small=source | dict(sha256=digest, citation="by hand") | about)
        yield f"http://127.0.0.1:{running.server_port}", table
        running.shutdown()


@pytest.fixture
def server(tmp_path):
    with published(FRAME, tmp_path) as result:
        yield result


def test_a_recording_is_fetched_once_and_read(server, tmp_path):
    host, table = server
    file = fetch_recordings.fetch("small", tmp_path / "here", host, table)
    read = fetch_recordings.read_frame(file)
    pd.testing.assert_frame_equal(read, FRAME, check_column_type=False)
    again = fetch_recordings.fetch("small", tmp_path / "here", "http://127.0.0.1:1", table)
    assert again == file


@pytest.mark.parametrize(
    "name, changes, most_bytes, told",
    [
        ("small", dict(sha256="0" * 64), 10_000, "has the hash"),
        ("small", {}, 100, "has more than 100 bytes"),
        ("../outside", {}, 10_000, "should have a plain name"),
        ("/tmp/outside", {}, 10_000, "should have a plain name"),
    ],
)
def test_what_is_not_as_listed_is_not_kept(
    server, tmp_path, monkeypatch, name, changes, most_bytes, told
):
    host, table = server
    monkeypatch.setattr(fetch_recordings, "_MOST_BYTES", most_bytes)
    with pytest.raises(ValueError, match=told):
        fetch_recordings.fetch(name, tmp_path / "here", host, {name: table["small"] | changes})
    assert not [*tmp_path.glob("here/*"), *tmp_path.glob("*.pkl")]


FOREIGN = [Bomb(), pd.DataFrame(dict(a=[Bomb()])), [print], re.compile("a")]


@pytest.mark.parametrize(
    "content, told",
    [
        *((pickle.dumps(each), "the pickle asks for") for each in FOREIGN),
        (pickle.dumps([1, 2]), "bad.pkl has a list"),
        (b"no pickle", "bad.pkl is no pickle"),
    ],
)
def test_nothing_but_a_frame_of_numbers_is_unpickled(tmp_path, content, told):
    (tmp_path / "bad.pkl").write_bytes(content)
    with pytest.raises(ValueError, match=told):
        fetch_recordings.read_frame(tmp_path / "bad.pkl")


def test_the_columns_of_a_recording_that_is_not_run_fit_its_documented_topics(tmp_path):
    """CitrusFarm's two files of a sequence in one folder, as documented, become a log."""
    source = fetch_recordings.RECORDINGS["citrusfarm"]
    assert len(source["sequences"]) == 7
    for topic, name, row in zip(source["topics"], ("gt", "odom"), ((1, 2, 0, 0), (9, 9, 0.5, 0.1))):
        message = odometry(*row)
        assert message.type == source["topics"][topic]
        messages = [(topic, START_NS + k * 10**8, message) for k in range(5)]
        (tmp_path / name).mkdir()
        file = write_bag(tmp_path / name, "bag", messages)
        file.rename(tmp_path / f"{name}.bag")
        (tmp_path / name).rmdir()
    log = rhec.logs.read(tmp_path, columns=source["columns"])
    columns = ["x_m", "y_m", "speed_mps", "yaw_rate_radps"]
    np.testing.assert_array_equal(log[columns], [[1, 2, 0.5, 0.1]] * 5)


# Conversion: a robot whose speed and yaw rate swing, its poses 0.3 s late, its encoders 0.1 s

LATE, R_M, B_M = dict(pose_late_s=0.3, encoders_late_s=0.1), 0.2, 0.6
FORM = dict(LATE, wheel_radius_m=R_M, track_width_m=B_M, margins_s=[0.3, 0.1])
FINE = np.arange(-1.0, 61.0, 0.001)
SPEEDS = 0.8 + 0.2 * np.sin(0.9 * FINE), 0.4 * np.cos(0.7 * FINE)
YAW = cumulative_trapezoid(SPEEDS[1], FINE, initial=0)
PLACE = [cumulative_trapezoid(SPEEDS[0] * each(YAW), FINE, initial=0) for each in (np.cos, np.sin)]


def moved(t):
    """Pose (n, 3), wheel speeds (n, 2) [rad/s] and yaw rate of the robot as read at times t [s]."""
    pose = np.stack([np.interp(t - LATE["pose_late_s"], FINE, each) for each in (*PLACE, YAW)])
    nu, omega = (np.interp(t - LATE["encoders_late_s"], FINE, each) for each in SPEEDS)
    wheels = np.stack([nu - B_M / 2 * omega, nu + B_M / 2 * omega]) / R_M
    return pose.T, wheels.T, np.interp(t, FINE, SPEEDS[1])


def rows_frame():
    t = 0.05 * np.arange(1000)
    pose, wheels, gyro = moved(np.where(t > 0.12, t, 0.0))
    index = np.where(t > 0.12, np.arange(1000) // 2, 0)  # a pose every other row
    pose = pose[np.maximum(2 * index, 3)]
    frame = pd.DataFrame(
        dict(
            ros_time=(1.7e18 + 1e9 * t).astype(np.int64), icp_index=index,
            icp_pos_x=pose[:, 0], icp_pos_y=pose[:, 1], icp_quat_x=0.0, icp_quat_y=0.0,
            icp_quat_z=np.sin(pose[:, 2] / 2), icp_quat_w=np.cos(pose[:, 2] / 2),
            meas_left_vel=wheels[:, 0], meas_right_vel=wheels[:, 1], imu_z=gyro,
            cmd_vel_x=0.8, cmd_vel_omega=0.0,
        )
    )  # fmt: skip
    return frame, FORM


def windows_frame():
    """Windows that meet, overlap or leave a row out; after the tenth nothing for 10 s."""
    begin = np.cumsum([0.5, *np.tile([2.0, 1.95, 2.05], 3), 12.0, *np.tile([2.0, 2.0, 1.95], 3)])
    t = begin[:, None] + 0.05 * np.arange(40)
    pose, wheels, gyro = (each.reshape(len(begin), 40, -1) for each in moved(t.ravel()))
    first, frame = pose[:, :1], dict(start_time=begin)
    step, turned = pose - first, np.exp(-1j * first[..., 2])
    local = (step[..., 0] + 1j * step[..., 1]) * turned
    columns = dict(
        icp_x=local.real, icp_y=local.imag, icp_yaw=step[..., 2], left_wheel_vel=wheels[..., 0],
        right_wheel_vel=wheels[..., 1], imu_yaw=-gyro[..., 0],
    )  # fmt: skip
    columns |= dict.fromkeys(
        ("icp_z", "icp_roll", "icp_pitch", "cmd_left", "cmd_right"), np.zeros((len(begin), 40))
    )
    frame |= {f"{name}_{k}": of[:, k] for name, of in columns.items() for k in range(40)}
    known = dict(zip(("x", "y", "yaw"), first[:, 0].T))
    frame |= {f"init_tf_pose_{name}": known.get(name, np.zeros(len(begin)))
              for name in ("x", "y", "z", "roll", "pitch", "yaw")}  # fmt: skip
    source = FORM | dict(
        command_wheel_radius_m=R_M, command_track_width_m=B_M, gyro_sign=-1, longest_s=400.0,
        from_first_window=False,
    )  # fmt: skip
    return pd.DataFrame(frame), source


@pytest.mark.parametrize(
    "form, options, segments",
    [(rows_frame, {}, 1)]
    + [(windows_frame, dict(tilted=t, later_counts=t), 2) for t in (False, True)],
)
def test_a_published_frame_becomes_a_log(form, options, segments):
    frame, source = form()
    log = convert(frame, source | options)
    np.testing.assert_allclose(log.groupby("segment")["t_s"].diff().dropna(), 0.1, atol=1e-9)
    assert log["segment"].nunique() == segments and (log["pos_ok"] == 1).all()
    assert log.loc[0, ["t_s", "x_m", "y_m"]].tolist() == [0, 0, 0]
    # What was late is at its time: all speeds and yaw rates agree.
    for one, other in (("v_true_mps", "speed_mps"), ("yaw_rate_true_radps", "yaw_rate_radps"),
                       ("yaw_rate_true_radps", "gyro_radps")):  # fmt: skip
        np.testing.assert_allclose(log[one], log[other], atol=0.012)
    np.testing.assert_allclose(log["v_lat_true_mps"], 0, atol=0.012)
    np.testing.assert_allclose(log[["x_true_m", "y_true_m"]], log[["x_m", "y_m"]], atol=0.01)
    turned = log["yaw_true_rad"].iloc[99] - log["yaw_true_rad"].iloc[0]
    assert turned == pytest.approx(np.trapezoid(log["gyro_radps"].iloc[:100], dx=0.1), abs=0.01)


@may_be_unsure
def test_a_converted_recording_can_be_replayed(tmp_path, capsys):
    frame, source = rows_frame()
    with published(frame.astype(object), tmp_path, **source) as (host, table):
        fetch_recordings.main(host, tmp_path / "here", table)
        assert "by hand" in capsys.readouterr().out
        del table["small"]["sha256"]
        with pytest.raises(SystemExit, match="small: its table should have"):
            fetch_recordings.main(host, tmp_path / "there", table)
    log = rhec.logs.read(tmp_path / "here" / "small.csv")
    last = rhec.replay(log, estimator=RIVALS["augmented_ekf"], first_yaw_rad=log["yaw_true_rad"][0])
    assert last["mu_hat"].iloc[-1] == pytest.approx(1.0, abs=0.03)
