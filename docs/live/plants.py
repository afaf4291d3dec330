"""Plants of both rows beside the path, for the live page's robot view."""

import numpy as np

from rhec import paper
from rhec.explorer.field_run import places_beside

_APART_M = 0.15  # a choice of the drawing
_FOLIAGE_M = 0.1  # radius of a plant
_HALF_FREE_M = paper.ROBOT_WIDTH_M / 2 + paper.TOLERANCE_M  # from the row's middle to the leaves


def plants_of(path):
    """Plants beside the rows of a Path: its straight parts, but for those across the first row.

    Returns:
        (n, 4) tip of the leaf that is nearest to the robot, and middle of the plant [m]; the tip is
        `paper.TOLERANCE_M` away from the side of a robot in the row's middle.
    """
    poses, curvatures = path.poses(np.arange(0, path.length_m, _APART_M))
    along = np.abs(np.cos(poses[:, 2] - poses[0, 2]))
    straight = poses[(curvatures == 0) & (along > 0.5)]
    rows = [
        np.column_stack(
            [
                places_beside(straight, side * _HALF_FREE_M),
                places_beside(straight, side * (_HALF_FREE_M + _FOLIAGE_M)),
            ]
        )
        for side in (1, -1)
    ]
    return np.concatenate(rows)
