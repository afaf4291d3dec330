"""The target path: lines and arcs (paper, Sec. Experimental Results: space-based trajectory).

A path is a row of segments, each a line or an arc: (s, x, y, θ, c) where it begins at arc length s
[m], pose (x, y, θ), with curvature c [1/m].
"""

import functools
from dataclasses import dataclass
from math import pi

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import Flag, Positive, Real, checked, numbers, shown

__all__ = ["OPEN", "Path", "advance", "closest"]

OPEN = 1e9  # the "period" of a path that does not close [m]
LONGEST_M = 1e6  # a path: its field is made of points, and must fit into memory
CLOSED = 1e-6  # how far its end may be from its beginning [m, rad], for a path to close


def advance(x, y, theta, curvature, length, lib):
    """The pose after `length` on a line or arc that begins at (x, y, θ); lib is casadi or numpy."""
    half = curvature * length / 2
    chord = (
        length * lib.sinc(half / pi)
        if lib is np
        else length * ca.if_else(ca.fabs(half) < 1e-8, 1, ca.sin(half) / half)
    )
    return x + chord * lib.cos(theta + half), y + chord * lib.sin(theta + half), theta + 2 * half


@dataclass(frozen=True)
class Path:
    """Lines and arcs one after the other; build it with `from_segments`, `racetrack` or `rows`.

    segments: (M, 5) rows (s, x, y, θ, c) as above. length_m: arc length of all. closed: the end is
    the beginning.
    """

    segments: np.ndarray
    length_m: float
    closed: bool = False

    @classmethod
    @checked
    def from_segments(
        cls,
        pieces: list[tuple[Positive, Real]],
        start: tuple[Real, Real, Real] = (0.0, 0.0, 0.0),
        closed: Flag = False,
    ) -> "Path":
        """Path of [(length [m], curvature [1/m]), …] from the pose `start`.

        Args:
            pieces: Length [m] and curvature [1/m] of each line or arc.
            start: Pose (x, y, θ) [m, m, rad] of the beginning.
            closed: Whether the end is the beginning.

        Returns:
            The Path.

        Raises:
            ValueError: In one sentence, for pieces that make no path.
        """
        length_m = sum(length for length, _ in pieces)
        if not 0 < length_m <= LONGEST_M:
            wanted = "it must be a list of (length, curvature) with at least one entry"
            raise ValueError(
                f"pieces was {shown(pieces)}; {wanted}, at most {LONGEST_M:g} m in all"
            )
        s = 0.0
        pose = start
        table = []
        for length, curvature in pieces:
            table.append((s, *pose, curvature))
            s = s + length
            pose = advance(*pose, curvature, length, np)
        gap = (
            np.hypot(pose[0] - start[0], pose[1] - start[1]),
            abs(np.remainder(pose[2] - start[2] + pi, 2 * pi) - pi),
        )
        if closed and not max(gap) <= CLOSED * max(1, *map(abs, start), length_m):
            ends = f"the path ends {gap[0]:.3g} m and {gap[1]:.3g} rad from where it begins"
            raise ValueError(f"closed was True; {ends}, so it should be False")
        return cls(np.array(table, dtype=float), s, closed)

    def __post_init__(self):
        segments = numbers("segments", self.segments)
        if (
            segments.ndim != 2
            or segments.shape[1] != 5
            or not len(segments)
            or not np.isfinite(segments).all()
        ):
            wanted = "it must be rows of five finite numbers (s, x, y, θ, c)"
            raise ValueError(f"segments was {shown(self.segments)}; {wanted}")
        if numbers("length_m", self.length_m).shape or not 0 < self.length_m <= LONGEST_M:
            wanted = f"it must be above 0 and at most {LONGEST_M:g} m"
            raise ValueError(f"length_m was {shown(self.length_m)}; {wanted}")
        object.__setattr__(self, "segments", segments)

    @classmethod
    @checked
    def racetrack(cls, row_length_m: Positive, radius_m: Positive) -> "Path":
        """Two rows, joined by half circles on the headlands.

        Args:
            row_length_m: Length of a row [m].
            radius_m: Radius of the half circles [m].

        Returns:
            The Path.
        """
        return _racetrack(row_length_m, radius_m)

    @property
    def period_m(self) -> float:
        return self.length_m if self.closed else OPEN

    @functools.cached_property
    def box(self) -> tuple[float, float, float, float]:
        """Where the path is, (x_min, x_max, y_min, y_max) [m], seen every half metre."""
        x, y, _ = self.poses(np.arange(0, self.length_m, 0.5))[0].T
        return x.min(), x.max(), y.min(), y.max()

    def poses(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses and curvatures at arc lengths.

        Args:
            s: (n,) arc lengths [m].

        Returns:
            Poses (n, 3) [m, m, rad] and curvatures (n,) [1/m].
        """
        s = np.asarray(s) % self.length_m if self.closed else np.asarray(s)
        row = self.segments[
            np.clip(np.searchsorted(self.segments[:, 0], s, side="right") - 1, 0, None)
        ]
        return np.column_stack(advance(*row[:, 1:4].T, row[:, 4], s - row[:, 0], np)), row[:, 4]

    def project(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Closest point of the whole path.

        Args:
            xy: (n, 2) points [m].

        Returns:
            Distances (n,) and arc lengths (n,) [m]; both NaN where xy is.
        """
        xy = np.asarray(xy, dtype=float)
        distance, s = closest(self, *xy.T, np)
        nowhere = np.isnan(xy).any(axis=1)
        return np.where(nowhere, np.nan, distance), np.where(nowhere, np.nan, s)


def closest(path, x, y, lib):
    """`Path.project` of coordinates in the library `lib`, casadi or numpy."""
    where = np.where if lib is np else ca.if_else
    best_distance = np.inf
    best_s = 0.0
    ends = [*path.segments[1:, 0], path.length_m]
    for (s, x_0, y_0, theta, c), end in zip(path.segments, ends):
        dx = x - x_0
        dy = y - y_0
        along = dx * np.cos(theta) + dy * np.sin(theta)
        left = dy * np.cos(theta) - dx * np.sin(theta)
        arguments = (along, left, c, end - s, lib) if c else (along, left, end - s, lib)
        for distance, candidate in (_on_arc if c else _on_line)(*arguments):
            better = distance < best_distance - 1e-9  # of equals, the first
            best_distance = where(better, distance, best_distance)
            best_s = where(better, s + candidate, best_s)
    return best_distance, best_s


@functools.lru_cache(maxsize=16)  # what runs of a campaign have in common
def _racetrack(row_length_m, radius_m):
    pieces = [(row_length_m, 0.0), (pi * radius_m, 1 / radius_m)]
    return Path.from_segments(pieces * 2, closed=True)


def _on_line(along, left, length, lib):
    """Distance and place on a line of the point closest to (along, left) of its beginning."""
    place = lib.fmin(lib.fmax(along, 0), length)
    yield lib.sqrt((along - place) ** 2 + left**2), place


def _on_arc(along, left, c, length, lib):
    """The same on an arc of curvature c; beyond it its beginning may be closer than its end."""
    where = np.where if lib is np else ca.if_else
    to_centre = lib.sqrt(along**2 + (1 / c - left) ** 2)
    place = lib.arctan2(abs(c) * along, 1 - c * left)
    place = where(place < 0, place + 2 * pi, place) / abs(c)
    # |to_centre - 1 / |c||, without the difference of two numbers that may be large and near
    beside = lib.fabs(along**2 + left**2 - 2 * left / c) / (to_centre + 1 / abs(c))
    x, y, _ = advance(0.0, 0.0, 0.0, c, length, np)
    beyond = lib.sqrt((along - x) ** 2 + (left - y) ** 2)
    yield where(place <= length, beside, beyond), lib.fmin(place, length)
    yield lib.sqrt(along**2 + left**2), 0.0
