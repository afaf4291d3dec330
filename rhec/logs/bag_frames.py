"""Where sensors are mounted and where the robot is, by the transforms /tf_static and /tf."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

TYPE = "tf2_msgs/msg/TFMessage"
_BASES = ("base_link", "base_footprint")


def _plain(frame):
    return frame.lstrip("/")


def stamp_ns(message: Any) -> int:
    """The time in a message's header [ns]; 0 without one, as in a header without a stamp."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return stamp.sec * 10**9 + stamp.nanosec if stamp else 0


class Frames:
    """The newest transforms of a bag: {frame: (parent, R (3, 3), t (3,))}."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}

    def __str__(self) -> str:
        return ", ".join(f"{above} → {frame}" for frame, (above, *_) in self._parents.items())

    def add(self, message: Any) -> None:
        """Take the transforms of a TFMessage."""
        for each in message.transforms:
            q = each.transform.rotation
            turn = np.array([q.x, q.y, q.z, q.w])
            R = Rotation.from_quat(turn).as_matrix() if turn.any() else np.eye(3)
            t = each.transform.translation
            place = np.array([t.x, t.y, t.z])
            self._parents[_plain(each.child_frame_id)] = (_plain(each.header.frame_id), R, place)

    @property
    def base(self) -> str | None:
        """The frame of the robot: base_link or base_footprint, with or without a prefix."""
        frames = {*self._parents, *(parent for parent, *_ in self._parents.values())}
        for name in _BASES:
            named = [frame for frame in frames if frame.rsplit("/", 1)[-1] == name]
            if named:
                return min(named, key=len)
        return None

    def _above(self, frame):
        """{ancestor: (R, t) of the frame in it}, of the frame itself first."""
        R = np.eye(3)
        t = np.zeros(3)
        above = {frame: (R, t)}
        while frame in self._parents:
            frame, R_parent, t_parent = self._parents[frame]
            if frame in above:  # transforms in a circle
                break
            R = R_parent @ R
            t = R_parent @ t + t_parent
            above[frame] = (R, t)
        return above

    def pose_in(self, parent: str, frame: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Rotation and place of a frame in another one above it; None if there is no way up."""
        return self._above(_plain(frame)).get(_plain(parent))

    def pose(self, frame: str) -> tuple[np.ndarray, np.ndarray] | None:
        """Rotation R (3, 3) and place t (3,) [m] of a frame in the base; None if unknown.

        With the poses (R_f, t_f) of the frame and (R_b, t_b) of the base in a common ancestor,

            R = R_b' R_f,  t = R_b' (t_f - t_b).
        """
        if self.base is None:
            return None
        of_frame = self._above(_plain(frame))
        of_base = self._above(self.base)
        common = next((name for name in of_frame if name in of_base), None)
        if common is None:
            return None
        R_f, t_f = of_frame[common]
        R_b, t_b = of_base[common]
        return R_b.T @ R_f, R_b.T @ (t_f - t_b)


def moved(frames: Frames, named: tuple[str, str], message: Any) -> list[tuple[int, list]]:
    """Times [ns] and places (x, y) [m] of the robot at the transforms of a message that move it.

    Only a transform from the frame in which the robot is counts: between these an odometry goes on
    by the encoders alone, which is no measurement.

    Args:
        frames: The Frames, with those of this message.
        named: The frame in which the robot is, and that of the robot.
        message: A TFMessage.
    """
    pose = frames.pose_in(*named)
    moves = [
        each for each in message.transforms if _plain(each.header.frame_id) == _plain(named[0])
    ]
    return [(stamp_ns(each), [*pose[1][:2]]) for each in moves] if pose else []
