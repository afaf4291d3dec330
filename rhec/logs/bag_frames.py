"""Where sensors are mounted, by the static transforms (/tf_static) in a bag."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

TYPE = "tf2_msgs/msg/TFMessage"
_BASES = ("base_link", "base_footprint")


def _plain(frame):
    return frame.lstrip("/")


class Frames:
    """The static transforms of a bag: {frame: (parent, R (3, 3), t (3,))}."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray, np.ndarray]] = {}

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
