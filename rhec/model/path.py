"""The target path and the references on it (paper, Sec. Experimental Results: space-based
trajectory; eq. (mpc_ref), (mpc_ref_ya)).

A path is a row of segments, each a line or an arc: (s, x, y, θ, c) where it begins at arc length s
[m], pose (x, y, θ), with curvature c [1/m].
"""

from dataclasses import dataclass
from math import pi

import casadi as ca
import numpy as np

from rhec._casadi.build import casadi_function
from rhec._casadi.validation import Flag, Positive, Real, checked, numbers, shown

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
    ):
        """From [(length [m], curvature [1/m]), …], the first beginning at the pose `start`; a
        closed path ends there.
        """
        length_m = sum(length for length, _ in pieces)
        if not 0 < length_m <= LONGEST_M:
            raise ValueError(
                f"pieces was {shown(pieces)}; it must be a list of (length, curvature) with at least one entry, at most {LONGEST_M:g} m in all"
            )
        s, pose, table = 0.0, start, []
        for length, curvature in pieces:
            table.append((s, *pose, curvature))
            s, pose = s + length, advance(*pose, curvature, length, np)
        gap = (
            np.hypot(pose[0] - start[0], pose[1] - start[1]),
            abs(np.remainder(pose[2] - start[2] + pi, 2 * pi) - pi),
        )
        if closed and not max(gap) <= CLOSED * max(1, *map(abs, start), length_m):
            raise ValueError(
                f"closed was True; the path ends {gap[0]:.3g} m and {gap[1]:.3g} rad from where it begins, so it should be False"
            )
        return cls(np.array(table, dtype=float), s, closed)

    def __post_init__(self):
        segments = numbers("segments", self.segments)
        if (
            segments.ndim != 2
            or segments.shape[1] != 5
            or not len(segments)
            or not np.isfinite(segments).all()
        ):
            raise ValueError(
                f"segments was {shown(self.segments)}; it must be rows of five finite numbers (s, x, y, θ, c)"
            )
        if numbers("length_m", self.length_m).shape or not 0 < self.length_m <= LONGEST_M:
            raise ValueError(
                f"length_m was {shown(self.length_m)}; it must be above 0 and at most {LONGEST_M:g} m"
            )
        object.__setattr__(self, "segments", segments)

    @classmethod
    @checked
    def racetrack(cls, row_length_m: Positive, radius_m: Positive):
        """Two rows, joined by half circles on the headlands."""
        return cls.from_segments(
            [(row_length_m, 0.0), (pi * radius_m, 1 / radius_m)] * 2, closed=True
        )

    @property
    def period_m(self):
        return self.length_m if self.closed else OPEN

    def poses(self, s):
        """Poses (n, 3) and curvatures (n,) at arc lengths s (n,) [m]."""
        s = np.asarray(s) % self.length_m if self.closed else np.asarray(s)
        row = self.segments[
            np.clip(np.searchsorted(self.segments[:, 0], s, side="right") - 1, 0, None)
        ]
        return np.column_stack(advance(*row[:, 1:4].T, row[:, 4], s - row[:, 0], np)), row[:, 4]

    def project(self, xy):
        """The closest point of the whole path to each of xy (n, 2) [m]: distance (n,) [m] and arc
        length (n,) [m]; both NaN where xy is.
        """
        xy = np.asarray(xy, dtype=float)
        best_distance, best_s = np.full(len(xy), np.inf), np.zeros(len(xy))
        lengths = np.diff(np.append(self.segments[:, 0], self.length_m))
        for (s, x, y, theta, c), length in zip(self.segments, lengths):
            along = (xy - (x, y)) @ (np.cos(theta), np.sin(theta))
            left = (xy - (x, y)) @ (-np.sin(theta), np.cos(theta))
            if c:
                along = np.arctan2(abs(c) * along, 1 - c * left) % (2 * pi) / abs(c)
            for candidate in (np.clip(along, 0, length), 0.0)[
                : 2 if c else 1
            ]:  # beyond an arc its beginning may be closer than its end
                px, py, _ = advance(x, y, theta, c, candidate, np)
                distance = np.hypot(xy[:, 0] - px, xy[:, 1] - py)
                better = distance < best_distance - 1e-9  # of equals, the first
                best_distance, best_s = (
                    np.where(better, distance, best_distance),
                    np.where(better, s + candidate, best_s),
                )
        nowhere = np.isnan(xy).any(axis=1)
        return np.where(nowhere, np.nan, best_distance), np.where(nowhere, np.nan, best_s)


def pose_at(s, segments, period_m):
    """Pose (3,) and curvature at arc length s, as CasADi expressions; segments (5, M). Beyond an
    open end that end's segment goes on.
    """
    s = ca.if_else(
        period_m < OPEN, s - period_m * ca.floor(s / period_m), s
    )  # before an open path's beginning is not after its end
    rows = ca.horzsplit(segments)
    row = rows[0]
    for before, after in zip(rows, rows[1:]):
        row = row + (s >= after[0]) * (after - before)
    return ca.vertcat(*advance(row[1], row[2], row[3], row[4], s - row[0], ca)), row[4]


def closest(xy, s, segments, period_m, iterations=2):
    """Arc length of the point closest to xy (2,), by Newton's method from the guess s: r'(s)·(r(s)
    - xy) = 0.
    """
    for _ in range(iterations):
        pose, c = pose_at(s, segments, period_m)
        off = xy - pose[:2]
        along = ca.cos(pose[2]) * off[0] + ca.sin(pose[2]) * off[1]
        left = ca.cos(pose[2]) * off[1] - ca.sin(pose[2]) * off[0]
        s = s + along / ca.fmax(
            1 - c * left, 0.2
        )  # near an arc's centre every point is equally close
    return s


def build_references(dt_s, horizon, n_segments, input_reference="measured"):
    """{references}: from the last arc length s () and the estimate (6,) to the closest point and
    the desired points over the horizon.

    The points begin `look_ahead_m` beyond the closest one and lie one sample of the robot's own
    estimated speed apart, so that the path, not a clock, leads. Yaw reference: eq. (mpc_ref_ya)
    with λ = `backwards`, in the turn nearest to the estimate (reading R9). Input reference: the
    measured yaw rate held over the horizon, as in the paper, or what the path's curvature asks for
    (`"curvature"`, reading R8).
    """

    def references(s, estimate, omega_measured, segments, period_m, look_ahead_m, backwards):
        x, y, theta, nu, mu, kappa = ca.vertsplit(estimate)
        pace = ca.fabs(mu * nu) * dt_s
        s = closest(ca.vertcat(x, y), s + pace, segments, period_m)
        poses, curvatures = zip(
            *(pose_at(s + look_ahead_m + i * pace, segments, period_m) for i in range(horizon + 1))
        )
        _, curvature = pose_at(s, segments, period_m)
        xi_ref = ca.horzcat(*poses)
        yaw = ca.horzcat(*(along_turn(pose[2] + backwards * ca.pi, theta) for pose in poses))
        if input_reference == "measured":
            omega_ref = ca.repmat(omega_measured, 1, horizon)
        else:
            omega_ref = ca.horzcat(*curvatures[:-1]) * ca.fabs(mu * nu) / ca.fmax(kappa, 0.1)
        return dict(
            s=s, xi_ref=ca.vertcat(xi_ref[:2, :], yaw), omega_ref=omega_ref, curvature=curvature
        )

    return dict(
        references=casadi_function(
            "references",
            references,
            dict(
                s=(1, 1),
                estimate=(6, 1),
                omega_measured=(1, 1),
                segments=(5, n_segments),
                period_m=(1, 1),
                look_ahead_m=(1, 1),
                backwards=(1, 1),
            ),
        )
    )


def along_turn(angle, near):
    """The angle, moved by full turns to within π of `near` [rad]."""
    return angle + 2 * ca.pi * ca.floor((near - angle) / (2 * ca.pi) + 0.5)
