"""Published frames as logs that `rhec.replay` takes, 10 rows a second.

There are two forms: one row each 50 ms, as recorded (`raw_dataframe`), and windows of 40 such
rows, each with its pose relative to where it begins (`torch_ready_dataframe`). The pose is that of
lidar odometry, which is late, and so are the encoders; by how much (cross-correlation with the
gyro) is in recordings.toml. Positions and wheel speeds count where they change, linear between.
The truth is the pose, smoothed by polynomials over 0.75 s, and its derivative by such over 1.05 s.
"""

import re
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

__all__ = ["convert"]

# between rows of a log and of a frame; rows of a window
_DT_S = 0.1
_FAST_S = 0.05
_N = 40
_SETTLED_S = 1.0
_TRIMMED_S = 0.2
_BREAK_S = 0.3
# wheels that change later stood before; positions missing
_HELD_S = 0.25
_POSE_GAP_S = 0.35
_SMOOTH = 15
_SLOPE = 21
_DEGREE = 2
_DIGITS = 5
_ATTITUDE = ("roll", "pitch", "yaw")


class _Piece(NamedTuple):
    """What was recorded without a break: times t (n,) [s] with wheel speeds (left, right) [rad/s],
    gyro [rad/s] and command (speed, yaw rate); poses (x, y, yaw) where they change.
    """

    t: np.ndarray
    wheels: np.ndarray
    gyro: np.ndarray
    command: np.ndarray
    t_pose: np.ndarray
    pose: np.ndarray


def _rows(frame, source):
    """The one piece of a frame of rows. Its first three rows are from before the recording."""
    frame = frame.iloc[3:]
    t = frame["ros_time"].astype(np.int64).to_numpy()
    t = (t - t[0]) * 1e-9

    def column(*names):
        return frame[[*names]].apply(pd.to_numeric).to_numpy(float)

    index = column("icp_index")[:, 0]
    new = (np.diff(index, prepend=0) != 0) & (index > 0)
    new &= t >= t[new][0] + _SETTLED_S
    yaw = Rotation.from_quat(column(*(f"icp_quat_{axis}" for axis in "xyzw"))[new]).as_euler("ZYX")
    place = column("icp_pos_x", "icp_pos_y")[new]
    yield _Piece(
        t,
        column("meas_left_vel", "meas_right_vel"),
        column("imu_z")[:, 0],
        column("cmd_vel_x", "cmd_vel_omega"),
        t[new],
        np.column_stack([place, yaw[:, 0]]),
    )


def _poses(frame, tilted):
    """Poses (x, y, yaw) of all windows' rows in one frame, (rows,) each. tilted: the pose at the
    beginning of a window counts with its roll and pitch.
    """
    columns = [
        np.stack([frame[f"icp_{name}_{k}"] for k in range(_N)], axis=1)
        for name in ("x", "y", "z", *_ATTITUDE)
    ]
    begin = frame[[f"init_tf_pose_{name}" for name in ("x", "y", "z", *_ATTITUDE)]].to_numpy()
    begin = begin * ([1, 1, 1, tilted, tilted, 1])
    turned = Rotation.from_euler("xyz", begin[:, 3:]).as_matrix()
    place = np.einsum("nij,nkj->nki", turned, np.stack(columns[:3], axis=-1)) + begin[:, None, :3]
    yaw = columns[5] + begin[:, 5:]
    if tilted:
        local = Rotation.from_euler("xyz", np.stack(columns[3:], axis=-1).reshape(-1, 3))
        whole = Rotation.from_matrix(np.repeat(turned, _N, axis=0)) * local
        yaw = whole.as_euler("xyz")[:, 2]
    return place[..., 0].ravel(), place[..., 1].ravel(), yaw.ravel()


def _windows(frame, source):
    """The pieces of a frame of windows; where two overlap, one of them counts."""
    begin = frame["start_time"].to_numpy()
    t = (begin[:, None] + _FAST_S * np.arange(_N)).ravel()
    zero = begin[0] if source["from_first_window"] else 0.0
    before = np.maximum.accumulate(np.append(-np.inf, t[:-1]))
    kept = t > before + 0.2 * _FAST_S
    if source["later_counts"]:
        kept = t < np.repeat(np.append(begin[1:], np.inf), _N) - 0.2 * _FAST_S
    names = ("left_wheel_vel", "right_wheel_vel", "imu_yaw", "cmd_left", "cmd_right")
    left, right, gyro, *command = (
        frame[[f"{name}_{k}" for k in range(_N)]].to_numpy().ravel()[kept] for name in names
    )
    radius_m = source["command_wheel_radius_m"]
    width_m = source["command_track_width_m"]
    command = radius_m * np.stack([sum(command) / 2, (command[1] - command[0]) / width_m], axis=1)
    gyro *= source["gyro_sign"]
    pose = np.column_stack(_poses(frame, source["tilted"]))[kept]
    t = t[kept] - zero
    edges = [0, *(1 + np.flatnonzero(np.diff(t) > _BREAK_S)), len(t)]
    for first, end in zip(edges, edges[1:]):
        part = np.arange(first, end)
        part = part[t[part] <= t[first] + source["longest_s"]]
        new = part[np.append(True, (np.diff(pose[part, :2], axis=0) != 0).any(axis=1))]
        wheels = np.column_stack([left, right])[part]
        yield _Piece(t[part], wheels, gyro[part], command[part], t[new], pose[new])


def _changes(t, value):
    """When a wheel's speed changes and to what, with the end of each time that it stood."""
    new = np.append(True, np.diff(value) != 0)
    t = t[new]
    value = value[new]
    late = 1 + np.flatnonzero(np.diff(t) > _HELD_S)
    return np.insert(t, late, t[late] - _HELD_S), np.insert(value, late, value[late - 1])


def _log(piece, source, pose_late_s, encoders_late_s):
    """The rows of a piece, its position not yet from the first row on."""
    t_pose, after_s, before_s = piece.t_pose - pose_late_s, *source["margins_s"]
    begin = np.ceil((t_pose[0] + after_s) / _DT_S) * _DT_S
    fast = begin + _FAST_S * np.arange(int((t_pose[-1] - before_s - begin) / _FAST_S + 1e-6) + 1)
    pose = np.column_stack([piece.pose[:, :2], np.unwrap(piece.pose[:, 2])])
    pose = np.stack([np.interp(fast, t_pose, each) for each in pose.T])
    smooth = savgol_filter(pose, _SMOOTH, _DEGREE)
    slope = savgol_filter(pose, _SLOPE, _DEGREE, deriv=1, delta=_FAST_S)
    cut = round(_TRIMMED_S / _FAST_S)
    rows = slice(cut, len(fast) - cut, round(_DT_S / _FAST_S))
    t = fast[rows]
    pose = pose[:, rows]
    smooth = smooth[:, rows]
    slope = slope[:, rows]
    cos = np.cos(smooth[2])
    sin = np.sin(smooth[2])
    left, right = (
        source["wheel_radius_m"] * np.interp(t + encoders_late_s, *_changes(piece.t, wheel))
        for wheel in piece.wheels.T
    )
    after = np.clip(np.searchsorted(t_pose, t, side="right"), 1, len(t_pose) - 1)
    command = piece.command[np.searchsorted(piece.t, t, side="right") - 1]
    return pd.DataFrame(
        dict(
            t_s=t,
            x_m=pose[0],
            y_m=pose[1],
            pos_ok=(t_pose[after] - t_pose[after - 1] <= _POSE_GAP_S).astype(int),
            speed_mps=(left + right) / 2,
            yaw_rate_radps=(right - left) / source["track_width_m"],
            v_left_mps=left,
            v_right_mps=right,
            gyro_radps=np.interp(t, piece.t, piece.gyro),
            cmd_v_mps=command[:, 0],
            cmd_w_radps=command[:, 1],
            yaw_true_rad=smooth[2],
            x_true_m=smooth[0],
            y_true_m=smooth[1],
            v_true_mps=slope[0] * cos + slope[1] * sin,
            v_lat_true_mps=-slope[0] * sin + slope[1] * cos,
            yaw_rate_true_radps=slope[2],
        )
    )


def convert(frame, source):
    """The log in a published frame.

    Args:
        frame: DataFrame, as published.
        source: Its table in recordings.toml.

    Returns:
        DataFrame with the columns of a recording (`rhec.simulation.columns`), a segment without a break.
    """
    form = _rows if "ros_time" in frame else _windows
    parts = []
    for number, piece in enumerate(form(frame, source)):
        if piece.t[-1] - piece.t[0] >= source.get("shortest_s", 0.0):
            late = (np.ravel(source[name]) for name in ("pose_late_s", "encoders_late_s"))
            late = [each[min(len(parts), len(each) - 1)] for each in late]
            part = _log(piece, source, *late)
            part.insert(0, "segment", number)
            parts.append(part)
    log = pd.concat(parts, ignore_index=True)
    first = log.loc[0, ["t_s", "x_m", "y_m"]]
    for name in log.columns:
        of = re.sub("_true", "", name)
        if of in first:
            log[name] -= first[of]
    return log.round(_DIGITS)
