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
    """The newest transforms of a bag, as matrices T (4, 4) = [[R, t], [0, 1]]."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}  # {frame: (its parent, T)}

    def __str__(self) -> str:
        return ", ".join(f"{above} → {frame}" for frame, (above, _) in self._parents.items())

    def add(self, message: Any) -> None:
        """Take the transforms of a TFMessage."""
        for each in message.transforms:
            q = each.transform.rotation
            turn = np.array([q.x, q.y, q.z, q.w])
            place = each.transform.translation
            T = np.eye(4)
            if turn.any():
                T[:3, :3] = Rotation.from_quat(turn).as_matrix()
            T[:3, 3] = place.x, place.y, place.z
            self._parents[_plain(each.child_frame_id)] = (_plain(each.header.frame_id), T)

    @property
    def base(self) -> str | None:
        """The frame of the robot: base_link or base_footprint, with or without a prefix."""
        frames = {*self._parents, *(parent for parent, _ in self._parents.values())}
        for name in _BASES:
            named = [frame for frame in frames if frame.rsplit("/", 1)[-1] == name]
            if named:
                return min(named, key=len)
        return None

    def _in_root(self, frame):
        """The root of a frame's tree, and T of the frame in it."""
        T = np.eye(4)
        seen = set()
        while frame in self._parents and frame not in seen:  # transforms may go in a circle
            seen.add(frame)
            frame, T_parent = self._parents[frame]
            T = T_parent @ T
        return frame, T

    def pose(self, parent: str | None, frame: str) -> np.ndarray | None:
        """T (4, 4) of a frame in another one, T = T_parent⁻¹ T_frame; None if it is unknown."""
        if parent is None:
            return None
        root, T_frame = self._in_root(_plain(frame))
        root_of_parent, T_parent = self._in_root(_plain(parent))
        return np.linalg.solve(T_parent, T_frame) if root == root_of_parent else None


def moved(frames: Frames, named: tuple[str, str], message: Any) -> list[tuple[int, list]]:
    """Times [ns] and places (x, y) [m] of the robot at the transforms of a message that move it.

    Only a transform from the frame in which the robot is counts: between these an odometry goes on
    by the encoders alone, which is no measurement.

    Args:
        frames: The Frames, with those of this message.
        named: The frame in which the robot is, and that of the robot.
        message: A TFMessage.
    """
    T = frames.pose(*named)
    moves = [
        each for each in message.transforms if _plain(each.header.frame_id) == _plain(named[0])
    ]
    return [] if T is None else [(stamp_ns(each), [*T[:2, 3]]) for each in moves]
