"""Files that loggers, editors and bags have spoilt, and all that is said of each.

`test_findings` has the logs whose numbers are wrong, however they are written.
"""

from functools import partial

import numpy as np
import pytest
from helpers import TRACK_WIDTH_M, recorded_log
from spoilt_logs import in_rows_of_their_own
from written_bags import START_NS, fix, joint_state, odometry, twist, write_bag

import rhec

LOG = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)
TRACKS = ["v_left_mps", "v_right_mps"]
SPEEDS = ["speed_mps", "yaw_rate_radps"]
TABLE = LOG[["t_s", "x_m", "y_m", *SPEEDS]]
AGAIN = TABLE.assign(x_m=TABLE["x_m"] + 20.0)
RADIUS_M = 0.1
ROBOT = dict(wheel_radius_m=RADIUS_M, track_width_m=TRACK_WIDTH_M)


def csv(log, **how):
    return log.to_csv(index=False, **how)


BACK = "; what follows counts as another drive."
MISSING = "The log had no column {}; it should have t_s, x_m, y_m, speed_mps, yaw_rate_radps"
# name: (the file's text, [all that is said])
TABLES = {
    "as UTF-16": (csv(TABLE).encode("utf-16"), []),
    "in Latin-1, with a remark": (csv(TABLE.assign(remark="grün")).encode("latin-1"), []),
    "with a row of units": (csv(TABLE).replace("\n", "\ns,m,m,m/s,rad/s\n", 1), []),
    "cut in its last line": (csv(TABLE)[:-20], []),
    "of sensors in rows of their own": (csv(in_rows_of_their_own(TABLE)), []),
    "without rows": (csv(TABLE[:0]), ["Log was DataFrame without rows; it should be a DataFrame "
                                      "with rows."]),
    "without a header": (
        csv(TABLE, header=False),
        [f"{MISSING.format('t_s, x_m, y_m, speed_mps, yaw_rate_radps')}; it has 0, 1, 2, 3, 4 "
         "(header: none, the names of the columns are 0, 1, 2 …); columns={'t_s': 'NAME'} of "
         "rhec.logs.read renames one."],
    ),
    "pasted without the header": (
        csv(TABLE) + csv(AGAIN, header=False), [f"The time falls back by 149.9 s{BACK}"]
    ),
    "steps from row to row": (
        csv(TABLE.rename(columns=dict(speed_mps="delta_s", yaw_rate_radps="delta_theta"))),
        [f"{MISSING.format('speed_mps, yaw_rate_radps')}; it has t_s, x_m, y_m, delta_s, "
         "delta_theta; delta_s, delta_theta may be steps from row to row: divided by the time "
         "between rows they are speeds; columns={'speed_mps': 'NAME'} of rhec.logs.read "
         "renames one."],
    ),
    "other names of the wheels' speeds": (
        csv(LOG[["t_s", "x_m", "y_m", *TRACKS]].set_axis(
            ["t_s", "x_m", "y_m", "left_wheel_speed", "right_wheel_speed"], axis=1)),
        [f"{MISSING.format('speed_mps, yaw_rate_radps')}; it has t_s, x_m, y_m, left_wheel_speed, "
         "right_wheel_speed: did you mean columns={'v_left_mps': 'left_wheel_speed', "
         "'v_right_mps': 'right_wheel_speed'} of rhec.logs.read?"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_all_that_is_said_of_a_spoilt_table(tmp_path, name):
    content, sentences = TABLES[name]
    file = tmp_path / "log.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert [finding.sentence for finding in rhec.doctor(file).findings] == sentences


def test_one_track_in_both_columns_is_named():
    log = LOG[["t_s", "x_m", "y_m", *TRACKS]].assign(v_right_mps=LOG["v_left_mps"])
    (said,) = rhec.doctor(log, track_width_m=TRACK_WIDTH_M).findings
    assert said.fact.startswith("the log's v_left_mps, v_right_mps are as fast as each other in a")


def test_a_track_width_in_cm_is_named():
    log = LOG[["t_s", "x_m", "y_m", *TRACKS]]
    (said,) = rhec.doctor(log, track_width_m=100 * TRACK_WIDTH_M).findings
    assert "v_right_mps by track_width_m may be in another unit" in said.fact


def drive(fix_ahead_s=0.0, is_stamped=True, no_fix=()):
    """Messages of a receiver and of joints, at 5 Hz."""
    messages = []
    for row in LOG.iloc[::2].itertuples():
        stamp = (START_NS + round(1e9 * row.t_s)) * is_stamped
        latitude = 46.78 + np.rad2deg(row.y_m / 6.3716e6)
        longitude = -71.27 + np.rad2deg(row.x_m / (6.3895e6 * np.cos(np.deg2rad(46.78))))
        status = -1 if no_fix and no_fix[0] < row.t_s < no_fix[1] else 0
        at = stamp + round(1e9 * fix_ahead_s) * is_stamped
        place = fix(latitude, longitude, status)
        wheels = joint_state(row.v_left_mps / RADIUS_M, row.v_right_mps / RADIUS_M)
        messages += [("/fix", at, place), ("/joints", stamp, wheels)]
    return messages


def of_odometry(kind):
    messages = []
    for row in LOG.iloc[::2].itertuples():
        stamp = START_NS + round(1e9 * row.t_s)
        speeds = (row.speed_mps, row.yaw_rate_radps)
        odom = ("/odom", stamp, odometry(row.x_m, row.y_m, *speeds))
        messages.append(odom if kind == "odom" else ("/cmd_vel", stamp, twist(*speeds)))
    return messages


# name: (function of messages, options, [all that is said, or the end of the refusal])
BAGS = {
    "as it should be": (drive, ROBOT, []),
    "headers without stamps": (partial(drive, is_stamped=False), ROBOT, []),
    "10 s without a fix": (
        partial(drive, no_fix=(60.0, 70.0)),
        ROBOT,
        ["The positions are missing for up to 10.0 s while the robot moves."],
    ),
    "positions by GPS time": (
        partial(drive, fix_ahead_s=18.0),
        ROBOT,
        [],  # the recorder's clock is one
    ),
    "no radius": (
        drive,
        dict(track_width_m=TRACK_WIDTH_M),
        "wheel_radius_m was None; /joints has wheel speeds in rad/s, which need it and then "
        "track_width_m",
    ),
    "no track width": (
        drive,
        dict(wheel_radius_m=RADIUS_M),
        [f"{MISSING.format('speed_mps, yaw_rate_radps')}, or give track_width_m for v_left_mps, "
         "v_right_mps; it has t_s, latitude, longitude, altitude, v_left_mps, v_right_mps, x_m, "
         "y_m."],
    ),
    "odometry alone": (
        partial(of_odometry, "odom"),
        {},
        "the bag's only positions are those of /odom, which are the integral of its own speeds; "
        "record a receiver, or topics=('/odom',) reads them as real positions",
    ),
    "commands alone": (
        partial(of_odometry, "cmd"),
        {},
        "no topic for positions (NavSatFix, PoseStamped, PoseWithCovarianceStamped, Odometry) "
        "among /cmd_vel (geometry_msgs/msg/Twist); columns={'x_m': '/topic.field'} of "
        "rhec.logs.read reads fields of any type",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAGS)
def test_all_that_is_said_of_a_spoilt_bag(tmp_path, name):
    messages, options, said = BAGS[name]
    file = write_bag(tmp_path, "mcap", messages(), period_ns=10**8)
    options = dict(options)
    width_m = options.pop("track_width_m", None)
    if isinstance(said, str):
        with pytest.raises(ValueError) as refused:
            rhec.logs.read(file, **options)
        assert str(refused.value) == f"log was {str(file)!r}, which cannot be read: {said}"
        return
    log = rhec.logs.read(file, **options)
    found = rhec.doctor(log, track_width_m=width_m).findings
    assert [finding.sentence for finding in found] == said
    clock = {
        "headers without stamps": "by the recorder, because 750 of 750 headers of /fix have no",
        "positions by GPS time": "by the recorder, because the headers of /fix and /joints have",
    }
    assert log.attrs["inferred"]["time"].startswith(clock.get(name, "by the headers"))
