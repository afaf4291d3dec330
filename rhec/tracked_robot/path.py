"""The target path: lines and arcs (paper, Sec. Experimental Results: space-based trajectory).

A path is a row of segments, each a line or an arc. A segment is (s, x, y, θ, c): it begins at the
arc length s [m] with the pose (x, y, θ) and has the curvature c [1/m].
"""

import functools
from dataclasses import dataclass
from math import atan2, pi
from typing import Literal

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import Flag, Positive, Real, checked, numbers, shown

# Which way a path turns at the ends of its rows (interpretation G18), in the order of menus.
Turns = Literal["alternate", "left", "right", "figure_of_eight"]
_BESIDE = 0.25  # of a turn's radius: how far the way back of a field passes beside its turns

OPEN = 1e9  # the "period" of a path that does not close [m]
LONGEST_M = 1e6  # the random field around a longer path would not fit into memory
CLOSED = 1e-6  # a path may be called closed if its ends are as near as this [m, rad]
SAME_M = 1e-9  # of two points whose distances differ by less, the first one counts as closest


def advance(x, y, theta, curvature, length, lib):
    """The pose (x, y, θ) after a length l [m] on a line or an arc of curvature c [1/m].

    The chord has the length l · sin(cl/2) / (cl/2) and the direction θ + cl/2. `lib` is numpy or
    casadi, by what the others are.
    """
    half = curvature * length / 2
    if lib is np:
        chord = length * np.sinc(half / pi)
    else:
        chord = length * ca.if_else(ca.fabs(half) < 1e-8, 1, ca.sin(half) / half)
    return x + chord * lib.cos(theta + half), y + chord * lib.sin(theta + half), theta + 2 * half


def ahead_and_left(dx, dy, theta, lib):
    """(dx, dy) seen along θ: ahead cos θ · dx + sin θ · dy, to the left cos θ · dy - sin θ · dx."""
    cos = lib.cos(theta)
    sin = lib.sin(theta)
    return cos * dx + sin * dy, cos * dy - sin * dx


@dataclass(frozen=True)
class Path:
    """Lines and arcs one after the other; build it with `rows` or `from_segments`.

    Attributes:
        segments: (M, 5) rows (s, x, y, θ, c) as above.
        length_m: Arc length of all.
        closed: Whether the end is the beginning.
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
            ValueError: If the pieces make no path, or one that is not closed as said.
        """
        length_m = sum(length for length, _ in pieces)
        if not 0 < length_m <= LONGEST_M:
            expected = "it must be a list of (length, curvature) with at least one entry"
            raise ValueError(
                f"pieces was {shown(pieces)}; {expected}, at most {LONGEST_M:g} m in all"
            )
        s = 0.0
        pose = start
        rows = []
        for length, curvature in pieces:
            rows.append((s, *pose, curvature))
            s = s + length
            pose = advance(*pose, curvature, length, np)
        if closed:
            _check_closed(start, pose, length_m)
        return cls(np.array(rows, dtype=float), s, closed)

    def __post_init__(self):
        segments = numbers("segments", self.segments)
        is_table = segments.ndim == 2 and segments.shape[1] == 5 and len(segments)
        if not is_table or not np.isfinite(segments).all():
            expected = "it must be rows of five finite numbers (s, x, y, θ, c)"
            raise ValueError(f"segments was {shown(self.segments)}; {expected}")
        if numbers("length_m", self.length_m).shape or not 0 < self.length_m <= LONGEST_M:
            expected = f"it must be above 0 and at most {LONGEST_M:g} m"
            raise ValueError(f"length_m was {shown(self.length_m)}; {expected}")
        object.__setattr__(self, "segments", segments)

    def __repr__(self) -> str:
        kind = "closed" if self.closed else "open"
        return f"Path({len(self.segments)} lines and arcs, {self.length_m:.2f} m, {kind})"

    @classmethod
    @checked
    def rows(cls, row_length_m: Positive, radius_m: Positive, turns: Turns = "alternate") -> "Path":
        """Rows that are joined by turns; the first row runs along the x axis from the origin.

        "alternate": four rows and half circles to alternate sides, as a field is worked, to the
        left first; then back along the headland, so that any drive has a finite field. "left" and
        "right": two rows, and half circles to one side. "figure_of_eight": two rows that cross,
        and longer arcs to alternate sides.

        Args:
            row_length_m: Length of a row [m].
            radius_m: Radius of the turns [m].
            turns: Which way the path turns.

        Returns:
            The Path, which is closed.

        Raises:
            ValueError: If a length is not above 0, or the radius too small for its curvature.
        """
        if 1 / radius_m > 1e100:  # the largest Real
            raise ValueError(f"radius_m was {radius_m}; it must be at least 1e-100")
        return _rows(row_length_m, radius_m, turns)

    @classmethod
    def racetrack(cls, row_length_m: Positive, radius_m: Positive) -> "Path":
        """Two rows that half circles to the left join: `rows` with turns to the left.

        Args:
            row_length_m: Length of a row [m].
            radius_m: Radius of the half circles [m].

        Returns:
            The Path.

        Raises:
            ValueError: As `rows` does.
        """
        return cls.rows(row_length_m, radius_m, "left")

    @property
    def period_m(self) -> float:
        """Arc length after which the path repeats itself [m]; `OPEN` if it does not."""
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
        s = np.asarray(s)
        if self.closed:
            s = s % self.length_m
        # Before its beginning an open path goes on as its first segment does.
        place = np.searchsorted(self.segments[:, 0], s, side="right") - 1
        begin, x, y, theta, curvature = self.segments[np.clip(place, 0, None)].T
        return np.column_stack(advance(x, y, theta, curvature, s - begin, np)), curvature

    def project(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Closest point of the whole path.

        Args:
            xy: (n, 2) points [m].

        Returns:
            Distances (n,) and arc lengths (n,) [m]; both NaN where xy is.
        """
        xy = np.asarray(xy, dtype=float)
        x, y = xy.T
        best_distance = np.full(len(xy), np.inf)
        best_s = np.zeros(len(xy))
        ends = [*self.segments[1:, 0], self.length_m]
        for (s, x_0, y_0, theta, c), end in zip(self.segments, ends):
            ahead, left = ahead_and_left(x - x_0, y - y_0, theta, np)
            length = end - s
            if c:
                points = on_arc(ahead, left, c, length, np)
            else:
                points = on_line(ahead, left, length, np)
            for distance, place in points:
                better = distance < best_distance - SAME_M
                best_distance = np.where(better, distance, best_distance)
                best_s = np.where(better, s + place, best_s)
        unknown = np.isnan(xy).any(axis=1)
        return np.where(unknown, np.nan, best_distance), np.where(unknown, np.nan, best_s)


def _check_closed(start, end, length_m):
    """Refuse a path whose ends are apart by more than rounding errors."""
    gap_m = np.hypot(end[0] - start[0], end[1] - start[1])
    gap_rad = abs(np.remainder(end[2] - start[2] + pi, 2 * pi) - pi)
    rounding = CLOSED * max(1, *map(abs, start), length_m)
    if not (gap_m <= rounding and gap_rad <= rounding):
        ends = f"the path ends {gap_m:.3g} m and {gap_rad:.3g} rad from where it begins"
        raise ValueError(f"closed was True; {ends}, so it should be False")


def path_of(scenario):
    """The path that a Scenario's robot follows."""
    if scenario.path:
        return scenario.path
    return _rows(scenario.row_length_m, scenario.headland_radius_m, scenario.turns)


@functools.lru_cache  # the runs of a campaign share it
def _rows(row_length_m, radius_m, turns):
    """The path of `Path.rows`."""
    return Path.from_segments(_PIECES[turns](row_length_m, radius_m), closed=True)


def _turn(angle_rad, radius_m, side):
    """An arc of this angle to the left (side 1) or to the right (-1)."""
    return angle_rad * radius_m, side / radius_m


def _alternate(row_length_m, radius_m):
    """Four rows, the turns between them, and the way back: no two parts of it touch."""
    row = row_length_m, 0.0
    left = _turn(pi, radius_m, 1)
    right = _turn(pi, radius_m, -1)
    corner = _turn(pi / 2, radius_m, 1)
    beside_m = _BESIDE * radius_m
    # The rows are 2 R apart, and the corners take R at either end of the way back.
    back = [(beside_m, 0.0), corner, (4 * radius_m, 0.0), corner, (beside_m, 0.0)]
    return [row, left, row, right, row, left, row, *back]


def _one_sided(side):
    """Two rows and half circles to one side, as a function (row_length_m, radius_m)."""
    return lambda row_length_m, radius_m: [(row_length_m, 0.0), _turn(pi, radius_m, side)] * 2


def _figure_of_eight(row_length_m, radius_m):
    """Two rows that cross in their middles at the angle 2φ, tan φ = 2R / L; arcs turn by π + 2φ."""
    row = row_length_m, 0.0
    angle_rad = pi + 2 * atan2(2 * radius_m, row_length_m)
    return [row, _turn(angle_rad, radius_m, 1), row, _turn(angle_rad, radius_m, -1)]


_PIECES = {
    "alternate": _alternate,
    "left": _one_sided(1),
    "right": _one_sided(-1),
    "figure_of_eight": _figure_of_eight,
}


def on_line(ahead, left, length, lib):
    """The closest point on a line from offsets (n,) seen along it, as [(distance, place)] [m].

    `lib` is numpy or casadi, as in `advance`.
    """
    place = lib.fmin(lib.fmax(ahead, 0), length)
    return [(lib.sqrt((ahead - place) ** 2 + left**2), place)]


def on_arc(ahead, left, c, length, lib):
    """The candidates for the closest point on an arc of curvature c, as [(distance, place)] [m].

    The centre lies 1/c to the left of the beginning. The point is closest where the ray from the
    centre through it meets the circle: at the angle atan2(|c| · ahead, 1 - c · left), in [0, 2π).
    Beyond the arc its end is a candidate, and so is its beginning, which may be closer. `lib` is
    numpy or casadi, as in `advance`.
    """
    where = np.where if lib is np else ca.if_else
    to_centre = lib.sqrt(ahead**2 + (1 / c - left) ** 2)
    angle = lib.arctan2(abs(c) * ahead, 1 - c * left)
    place = where(angle < 0, angle + 2 * pi, angle) / abs(c)
    # |to_centre - 1 / |c||, but not as a difference of numbers that may be large and nearly equal
    radial = lib.fabs(ahead**2 + left**2 - 2 * left / c) / (to_centre + 1 / abs(c))
    x, y, _ = advance(0.0, 0.0, 0.0, c, length, lib)
    to_end = lib.sqrt((ahead - x) ** 2 + (left - y) ** 2)
    to_beginning = lib.sqrt(ahead**2 + left**2)
    return [(where(place <= length, radial, to_end), lib.fmin(place, length)), (to_beginning, 0.0)]
