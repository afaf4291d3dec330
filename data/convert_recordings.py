"""Published frames as logs that `rhec.replay` takes, 10 rows a second.

There are two forms: one row every 50 ms, as recorded (`raw_dataframe`), and windows of 40 such
rows, each with its pose relative to where it begins (`torch_ready_dataframe`). The pose is that of
lidar odometry, which is late, and so are the encoders. recordings.toml says by how much, found by
cross-correlation with the gyro. Positions and wheel speeds count where they change; between changes
they are linear. The truth is the pose, smoothed by polynomials over 0.75 s, and the derivative of
such polynomials over 1.05 s.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

__all__ = ["convert"]

_DT_S = 0.1  # between rows of a log
_FAST_S = 0.05  # between rows of a frame
_N = 40  # rows of a window
_SETTLED_S = 1.0  # poses before are left out
_TRIMMED_S = 0.2  # at both ends of a piece, where the smoothing polynomials are not centred
_BREAK_S = 0.3  # a longer step between rows begins a new piece
_HELD_S = 0.25  # a wheel whose speed changes later than this stood at one speed before
_POSE_GAP_S = 0.35  # a position between poses further apart is missing
_SMOOTH = 15  # rows of the polynomials of the pose
_SLOPE = 21  # and of those of its derivative
_DEGREE = 2
_DIGITS = 5
_ATTITUDE = ("roll", "pitch", "yaw")


class _Piece(NamedTuple):
    """What was recorded without a break."""

    t: np.ndarray  # (n,) times [s]
    wheels: np.ndarray  # (n, 2) speeds of the left and the right wheels [rad/s]
    gyro: np.ndarray  # (n,) yaw rate by the gyro [rad/s]
    command: np.ndarray  # (n, 2) commanded speed [m/s] and yaw rate [rad/s]
    t_pose: np.ndarray  # (m,) times at which the pose changes [s]
    pose: np.ndarray  # (m, 3) pose from then on [m, m, rad]


def _pieces_of_rows(frame, source):
    """The one _Piece of a frame of rows, whose first three rows are from before the recording."""
    frame = frame.iloc[3:]
    t = frame["ros_time"].astype(np.int64).to_numpy()
    t = (t - t[0]) * 1e-9

    def columns(*names):
        return frame[[*names]].apply(pd.to_numeric).to_numpy(float)

    index = columns("icp_index")[:, 0]
    is_new = (np.diff(index, prepend=0) != 0) & (index > 0)
    is_new &= t >= t[is_new][0] + _SETTLED_S
    quaternion = columns("icp_quat_x", "icp_quat_y", "icp_quat_z", "icp_quat_w")[is_new]
    yaw = Rotation.from_quat(quaternion).as_euler("ZYX")[:, 0]
    position = columns("icp_pos_x", "icp_pos_y")[is_new]
    yield _Piece(
        t,
        columns("meas_left_vel", "meas_right_vel"),
        columns("imu_z")[:, 0],
        columns("cmd_vel_x", "cmd_vel_omega"),
        t[is_new],
        np.column_stack([position, yaw]),
    )


def _poses(frame, tilted):
    """Poses (x, y, yaw) of the rows of all windows in one coordinate frame, (rows,) each.

    tilted: whether the pose at the beginning of a window counts with its roll and pitch.
    """
    columns = [
        np.stack([frame[f"icp_{name}_{k}"] for k in range(_N)], axis=1)
        for name in ("x", "y", "z", *_ATTITUDE)
    ]
    begin = frame[[f"init_tf_pose_{name}" for name in ("x", "y", "z", *_ATTITUDE)]].to_numpy()
    begin = begin * ([1, 1, 1, tilted, tilted, 1])
    R = Rotation.from_euler("xyz", begin[:, 3:]).as_matrix()
    # p = R p_local + p_begin, for each window n and each of its rows k.
    position = np.einsum("nij,nkj->nki", R, np.stack(columns[:3], axis=-1)) + begin[:, None, :3]
    yaw = columns[5] + begin[:, 5:]
    if tilted:
        local = Rotation.from_euler("xyz", np.stack(columns[3:], axis=-1).reshape(-1, 3))
        whole = Rotation.from_matrix(np.repeat(R, _N, axis=0)) * local
        yaw = whole.as_euler("xyz")[:, 2]
    return position[..., 0].ravel(), position[..., 1].ravel(), yaw.ravel()


def _pieces_of_windows(frame, source):
    """The _Pieces of a frame of windows; where two windows overlap, one of them counts."""
    begin = frame["start_time"].to_numpy()
    t = (begin[:, None] + _FAST_S * np.arange(_N)).ravel()
    zero = begin[0] if source["from_first_window"] else 0.0
    if source["later_counts"]:
        counts = t < np.repeat(np.append(begin[1:], np.inf), _N) - 0.2 * _FAST_S
    else:
        latest = np.maximum.accumulate(np.append(-np.inf, t[:-1]))
        counts = t > latest + 0.2 * _FAST_S

    def signal(name):
        return frame[[f"{name}_{k}" for k in range(_N)]].to_numpy().ravel()[counts]

    wheels = np.column_stack([signal("left_wheel_vel"), signal("right_wheel_vel")])
    gyro = source["gyro_sign"] * signal("imu_yaw")
    left = signal("cmd_left")
    right = signal("cmd_right")
    # Speed R (ω_l + ω_r) / 2 and yaw rate R (ω_r - ω_l) / b, by the robot's own R and b.
    width_m = source["command_track_width_m"]
    command = np.stack([(left + right) / 2, (right - left) / width_m], axis=1)
    command = source["command_wheel_radius_m"] * command
    pose = np.column_stack(_poses(frame, source["tilted"]))[counts]
    t = t[counts] - zero
    edges = [0, *(1 + np.flatnonzero(np.diff(t) > _BREAK_S)), len(t)]
    for first, end in zip(edges, edges[1:]):
        part = np.arange(first, end)
        part = part[t[part] <= t[first] + source["longest_s"]]
        is_new = np.append(True, (np.diff(pose[part, :2], axis=0) != 0).any(axis=1))
        new = part[is_new]
        yield _Piece(t[part], wheels[part], gyro[part], command[part], t[new], pose[new])


def _changes(t, value):
    """When a wheel's speed changes and to what.

    Where it stood at one speed for longer than _HELD_S, the end of that time is one more change.
    """
    is_new = np.append(True, np.diff(value) != 0)
    t = t[is_new]
    value = value[is_new]
    late = 1 + np.flatnonzero(np.diff(t) > _HELD_S)
    return np.insert(t, late, t[late] - _HELD_S), np.insert(value, late, value[late - 1])


def _truth(piece, t_pose, source):
    """Times of a log's rows, and there the pose, the smoothed pose and its derivative, (3, n)."""
    after_s, before_s = source["margins_s"]
    begin = np.ceil((t_pose[0] + after_s) / _DT_S) * _DT_S
    fast = begin + _FAST_S * np.arange(int((t_pose[-1] - before_s - begin) / _FAST_S + 1e-6) + 1)
    pose = np.column_stack([piece.pose[:, :2], np.unwrap(piece.pose[:, 2])])
    pose = np.stack([np.interp(fast, t_pose, component) for component in pose.T])
    smooth = savgol_filter(pose, _SMOOTH, _DEGREE)
    slope = savgol_filter(pose, _SLOPE, _DEGREE, deriv=1, delta=_FAST_S)
    cut = round(_TRIMMED_S / _FAST_S)
    rows = slice(cut, len(fast) - cut, round(_DT_S / _FAST_S))
    return fast[rows], pose[:, rows], smooth[:, rows], slope[:, rows]


def _log(piece, source, pose_late_s, encoders_late_s):
    """The rows of a _Piece, with positions in the frame of the odometry."""
    t_pose = piece.t_pose - pose_late_s
    t, pose, smooth, slope = _truth(piece, t_pose, source)
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
        DataFrame with the columns of a recording (docs/log_columns.md). Each of its segments
        is without a break; times and positions begin at 0.
    """
    pieces = _pieces_of_rows if "ros_time" in frame else _pieces_of_windows
    parts = []
    for number, piece in enumerate(pieces(frame, source)):
        if piece.t[-1] - piece.t[0] >= source.get("shortest_s", 0.0):
            pose_late_s = _of_piece(source["pose_late_s"], len(parts))
            encoders_late_s = _of_piece(source["encoders_late_s"], len(parts))
            part = _log(piece, source, pose_late_s, encoders_late_s)
            part.insert(0, "segment", number)
            parts.append(part)
    log = pd.concat(parts, ignore_index=True)
    first = log.loc[0, ["t_s", "x_m", "y_m"]]
    for name in log.columns:
        measured = name.replace("_true", "")
        if measured in first:
            log[name] -= first[measured]
    return log.round(_DIGITS)


def _of_piece(values, number):
    """The value for a piece of this number, of one for all or one for each."""
    values = np.ravel(values)
    return values[min(number, len(values) - 1)]
