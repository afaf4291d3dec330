"""Logs, files and arguments that cannot be used: each is refused in one sentence that names it.

`test_findings` has the logs whose numbers are not what their columns say.
"""

from functools import partial

import numpy as np
import pytest
from helpers import assert_refused, recorded_log
from written_bags import START_NS, odometry, pose_stamped, text, twist_stamped, write_bag

import rhec
from notebooks.rivals import RIVALS
from rhec.logs import calibration

LOG = recorded_log(noise_m=0.02)
FOREIGN = LOG.rename(
    columns=dict(x_m="Easting [m]", y_m="northing", speed_mps="vel", yaw_rate_radps="gyro")
)


def test_a_log_that_cannot_be_replayed():
    rows = [
        (LOG.drop(columns="x_m"), "the log had no column x_m…; columns={'x_m': 'NAME'} of rh"),
        (
            LOG.drop(columns=["t_s", "speed_mps"]),
            "the log had no column t_s, speed_mps;…or give track_width_m",
        ),
        (LOG.assign(t_s=np.nan), "the log's column t_s had no number"),
        (
            LOG.iloc[:, :5].assign(speed_mps=np.where(np.arange(len(LOG)) < 3, 1e9, np.nan)),
            "the log's positions…(from nan to nan s) have no time in common",
        ),
        (FOREIGN, "the log had no…it has t_s, Easting [m], northing, vel, gyro, v_left_mps"),
        (FOREIGN, "the log had no…did you mean columns={'x_m': 'Easting [m]', 'y_m': 'northing'}"),
        (FOREIGN.drop(columns="v_left_mps"), "the log had no…northing', 'speed_mps': 'vel'} of rh"),
        (
            LOG.iloc[:, :5].rename(columns=dict(speed_mps="/odom/twist/twist/linear/x")),
            "the log had no…did you mean columns={'speed_mps': '/odom/twist/twist/linear/x'}",
        ),
        (
            LOG.iloc[:, :5].rename(columns=dict(speed_mps="delta_s", yaw_rate_radps="left_rpm")),
            "the log had no…; left_rpm are turns of wheels in a minute",
        ),
        (LOG.iloc[:, :5].rename(columns=dict(speed_mps="delta_s")), "the log had no…; delta_s may"),
        (
            LOG.iloc[:, :5].rename(columns=dict(speed_mps="wind_speed")),
            "the log had no…s': 'NAME'}",
        ),
    ]
    assert_refused(rhec.replay, [((log,), sentence) for log, sentence in rows])


def test_arguments_of_a_replay():
    rows = [
        (dict(estimator="oracle"), "estimator was 'oracle'"),
        (dict(estimator=RIVALS["fixed_traction"]), "estimator was Estimator('fixed_traction_step'"),
        (dict(sed=1), "replay has no parameter 'sed'"),
        (dict(process_noise="bold"), "process_noise was 'bold'"),
        (dict(first_yaw_rad=(0.0, 1.0)), "first_yaw_rad had 2 entries"),
        (dict(lever_arm_m=(0.1, 0.0), speed_model="input"), "lever_arm_m was"),
        (dict(sigma_yaw_rad=0.0), "sigma_yaw_rad was 0.0"),
        (dict(delays_s=dict(x_m=0.1)), "delays_s was …no model: position_delay_s is that"),
        (dict(smooth=True, speed_model="parameter"), "smooth was True; only the estimator 'rhe'"),
        (dict(smooth=True, estimator="ekf"), "smooth was True; only the estimator 'rhe'"),
        (dict(sensors=("gyro",)), "sensors was …no numbers in a column gyro_radps"),
        (dict(sensors=("heading",), estimator="ekf"), "sensors was"),
    ]
    assert_refused(partial(rhec.replay, LOG, trust_log=True), rows)


def so_far(column, amount):
    """A minute of 300 rows, in which the encoders drive [m] or turn [rad] so far."""
    log = recorded_log(5.0, 60.0)
    times = amount / (0.2 * log[column].abs().sum())
    return log.assign(**{column: times * log[column]})


def some_positions(n):
    log = recorded_log(5.0, 60.0)
    return log.assign(x_m=log["x_m"].where(log.index < n))


def only_noise(sigma_radps):
    """A minute in which the encoders measure noise alone, which hardly turns the robot."""
    noise = sigma_radps * np.random.default_rng(0).standard_normal(300)
    return recorded_log(5.0, 60.0).assign(yaw_rate_radps=noise)


# {what: (a log of an amount, an amount that does not suffice, one that does, what is said)}
NEEDED = {
    "positions": (some_positions, 49, 50, "no segment with 50 positions over 6 m"),
    "way [m]": (partial(so_far, "speed_mps"), 5.8, 6.2, "no segment with 50 positions over 6 m"),
    "turns [rad]": (partial(so_far, "yaw_rate_radps"), 6.5, 6.8, "turns of"),
    "noise of turns [rad/s]": (only_noise, 0.3, 1.0, "turns of .* drive two figures of eight"),
}


@pytest.mark.parametrize("what", NEEDED)
def test_how_much_a_calibration_needs(what, monkeypatch):
    """With enough it begins with the yaw of each segment, where it is stopped here."""
    log_of, too_little, enough, said = NEEDED[what]
    monkeypatch.setattr(calibration, "_first_yaws", lambda recording: 1 / 0)
    with pytest.raises(ValueError, match=f"^the log had {said}"):
        rhec.calibrate(log_of(too_little), trust_log=True)
    with pytest.raises(ZeroDivisionError):
        rhec.calibrate(log_of(enough), trust_log=True)


# Files


def test_files_that_are_none(tmp_path):
    contents = {
        "utf.csv": (b"\xff\xfe\x00 bytes", ""),
        "empty.csv": (b"", "the file is empty"),
        "remarks.csv": (b"# t_s\n\n", "the file is empty"),
        "picture.csv": (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR,1\n2", "it is no text"),
        "log.parquet": (b"PAR1", ""),
        "log.bag": (b"#ROSBAG V2.0\n junk", ""),
        "log.mcap": (b"\x89MCAP0\r\n junk", ""),
        "log.db3": (b"SQLite format 3\x00 junk", ""),
    }
    rows = []
    for name, (content, told) in contents.items():
        (tmp_path / name).write_bytes(content)
        rows.append(((tmp_path / name,), f"log was …cannot be read: {told}"))
    rows += [((path,), "log was …it should be a path") for path in (5, None, b"log.csv", [], ())]
    (tmp_path / "log.doc").write_bytes(b"t_s")
    existing = "log was …it should be an existing .csv, .txt, .dat, .tsv, .parquet, .bag, .db3, .mc"
    rows += [((tmp_path / "log.doc",), existing), ((tmp_path / "none.csv",), existing)]
    (tmp_path / "nothing").mkdir()
    rows += [((tmp_path / "nothing",), existing), (("https://example.org/log.csv",), existing)]
    # From 3.14 on, Python says that so long a path leads nowhere.
    rows += [(("a\0b.csv",), "log was"), (("a" * 5_000,), "log was")]
    assert_refused(rhec.logs.read, rows)


def test_tables_that_are_none(tmp_path):
    few = recorded_log(10.0, 20.0)[["t_s", "x_m", "y_m", "speed_mps", "yaw_rate_radps"]]

    def read(log, first=None, **how):
        names, *lines = log.to_csv(index=False).splitlines()
        if first is not None:
            lines[first:] = [f"{line},7" for line in lines[first:]]
        (tmp_path / "log.csv").write_text("\n".join([names, *lines]))
        return rhec.logs.read(tmp_path / "log.csv", **how)

    def angles(latitude, longitude):
        return few.drop(columns=["x_m", "y_m"]).assign(latitude=latitude, longitude=longitude)

    rows = [
        ((few, 0), "log was …cannot be read: …more entries than"),
        ((few, 60), "log was …cannot be read: …saw 6"),
        ((angles(5213.5, 4.3),), "the log's latitude is … should be in degrees"),
        ((angles(90.2, 4.3),), "the log's latitude is 90.2 (median)"),
        ((angles(52.1, 180.5),), "the log's longitude is 180.5 (median)"),
    ]
    assert_refused(read, rows)
    assert_refused(
        partial(read, few),
        [
            (dict(topics=("/odom",)), "topics was …; only a bag has topics"),
            (dict(columns=dict(x_m="north")), "columns['x_m'] was 'north'; the log has t_s, x_m"),
        ],
    )
    assert_refused(
        partial(read, few.drop(columns="yaw_rate_radps")),
        [(dict(wheel_separation_multiplier=2.0), "wheel_separation_multiplier was 2.0; it is of")],
    )


def test_topics_and_fields_that_a_bag_does_not_have(tmp_path):
    messages = [
        ("/cmd", START_NS, twist_stamped(0.1, 0.2)),
        ("/odom", START_NS, odometry(1, 2, 0.5, 0.1)),
        ("/pose", START_NS, pose_stamped(1, 2)),
        ("/wheels", START_NS, twist_stamped(0.1, 0.2)),
    ]
    bag = write_bag(tmp_path, "mcap", messages)
    read = "log was …cannot be read: "
    topics = {
        None: "several topics for encoders, /cmd, /wheels; topics should name one",
        ("/gps",): "topics named '/gps'; the bag has /cmd, /odom, /pose, /wheels",
        ("/pose",): "no topic for encoders (JointState, TwistStamped, Odometry) among /cmd (geom",
        ("/cmd",): "no topic for positions (NavSatFix, PoseStamped, ",
    }
    rows = [(dict(topics=names), read + told) for names, told in topics.items()]
    paths = {
        "/odm.pose.pose": "…begin with a topic and a point, and the bag has /cmd (geometry_msgs",
        "/odom.pose.position.x": "…a nav_msgs/msg/Odometry has no 'position' there: it has pose, c",
        "/odom.pose.pose.position": "…is no number: it has x, y, z",
        "/odom.child_frame_id": "…is no number: it is a str",
        "/odom.pose.covariance": "…is no number: an array of 36, of which [0] is the first",
        "/odom[0]": "…has no array there: it has header, child_frame_id, pose, twist",
        "/odom.pose..x": "…it should end in fields and places in arrays, such as .pose",
    }
    rows += [
        (dict(topics=("/odom",), columns=dict(x_m=path)), f"{read}columns['x_m'] was '{path}{told}")
        for path, told in paths.items()
    ]
    rows += [(dict(topics=("/odom",), columns=dict(x_m="north")), "columns['x_m'] was 'north'; th")]
    rows += [(dict(columns=dict(t_s="/odom.pose.pose.position.x")), f"{read}…not be given: the ti")]
    assert_refused(partial(rhec.logs.read, bag), rows)
    others = {
        "talk": (text("hello"), "no topic for positions (NavSatFix, …'x_m': "),
        "odom": (odometry(1, 2, 0.5, 0.1), "the bag's only positions are those of /odom, which"),
    }
    rows = []
    for name, (message, told) in others.items():
        (tmp_path / name).mkdir()
        bag = write_bag(tmp_path / name, "mcap", [(f"/{name}", START_NS, message)])
        rows.append(((bag,), read + told))
    assert_refused(rhec.logs.read, rows)
