"""What explains a log better than what was assumed of it: hypotheses, tried one after the other.

`calibration` tries what may be true of a healthy log. The faults here are of its columns: each is
undone, and is named if the motion without it explains nearly all of the path's squares where the
log as it is does not, so that a robot that only slips is never accused. `path_checks` says what is
explained.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rhec.logs.finding import passed, refused
from rhec.logs.path_checks import LENGTHS_S, compare, intervals_of, tracks_of
from rhec.logs.recording import Recording
from rhec.simulation.columns import MEASUREMENTS

_X, _Y, _NU, _OMEGA = MEASUREMENTS
_GOOD = 0.9  # share of the squares that an explanation explains,
_BETTER = 3.0  # and by how much smaller the share is that it leaves
_EMPTY = 0.01  # range of a yaw rate, or of the tracks' difference, that never changes [rad/s, m/s]
_TURNS_RAD = 2.0  # range of the course that needs a yaw rate
_VERTEX_M = 0.5  # between places of which a course is taken, and at least so many σ of these:
_VERTEX_SIGMAS = 12.0
_FORWARDS = 0.05  # of the largest speed: a speed never below minus this one has no sign
_STANDS_S = 1.5  # about a cusp, within which the robot changes its direction
_OUTLIER = 3.0  # times the farthest way by the encoders


def tried(hypotheses: tuple[Callable, ...], log: Any, best: Any) -> Iterator[tuple[Any, Any]]:
    """The hypotheses that hold, one after the other: what explains the log then, and what is said.

    Args:
        hypotheses: Functions of the log and of what explains it best until then. They return what
            explains it better and what is said of that, or None if they do not hold.
        log: What is to be explained.
        best: What explains it without a hypothesis.
    """
    for hypothesis in hypotheses:
        found = hypothesis(log, best)
        if found:
            best, said = found
            yield best, said


class _Log(NamedTuple):
    """What is to be explained."""

    recording: Recording
    kappa: float  # of the log as it is, at least 0
    share: float  # of the path's squares that the log as it is explains

    @property
    def rows(self):
        """The rows of the Recording."""
        return self.recording.rows


def explained(rows):
    """The slope κ of the path on the encoders and the share that both explain of the squares.

    Of the lengths of intervals that counts which explains most. None for a short log.
    """
    tracks = tracks_of(rows)
    compared = [compare(intervals_of(tracks, length_s), 0.0) for length_s in LENGTHS_S]
    shares = [(each.turns.b[0], 1 - each.unexplained.sum() / 2) for each in filter(None, compared)]
    return max(shares, key=lambda each: each[1], default=None)


# Faults that can be undone


def _one_side(sign):
    """Undoes a left (1) or right (-1) encoder that counts backwards: ν and ω change places.

    The half track width by which they differ is part of the slopes, whatever it is.
    """

    def undone(log):
        turned = {_NU: sign * log.rows[_OMEGA], _OMEGA: sign * log.rows[_NU]}
        return log.rows.assign(**turned)

    return undone


def _with_sign(log):
    """The rows with a speed that changes its sign where the path turns back."""
    nu = log.rows[_NU]
    if not nu.min() >= -_FORWARDS * nu.max():
        return None
    cusps = _vertices(log).query("is_cusp")
    if cusps.empty:
        return None
    t_s = log.rows["t_s"].to_numpy()
    sign = np.ones(len(t_s))
    for cusp_s in cusps["t_s"]:
        near = (np.abs(t_s - cusp_s) < _STANDS_S) & nu.notna()
        if near.any():  # the robot turns back where it is slowest
            sign[t_s >= t_s[nu[near].idxmin()]] *= -1
    return log.rows.assign(**{_NU: sign * nu})


def _turn_with_sign(log):
    """The rows with a yaw rate that has the sign by which the course turns."""
    omega = log.rows[_OMEGA]
    if not omega.min() >= -_FORWARDS * omega.max():
        return None
    vertices = _vertices(log)
    if not (vertices["turn"] < 0).any():
        return None
    sign = np.sign(vertices["turn"].rolling(3, center=True, min_periods=1).sum())
    at = np.interp(log.rows["t_s"], vertices["t_s"], sign.fillna(0.0))
    return log.rows.assign(**{_OMEGA: np.sign(at) * omega})


def _rates(*names):
    """Undoes sums since the beginning, such as a yaw, in the place of these rates."""

    def undone(log):
        rows = log.rows
        for name in names:
            there = rows[rows[name].notna()].groupby("segment")
            step = there[name].diff()
            if name == _OMEGA:
                step = (step + np.pi) % (2 * np.pi) - np.pi  # a yaw may be wrapped
            rows = rows.assign(**{name: step / there["t_s"].diff()})
        return rows

    return undone


# The path alone


def _vertices(log):
    """The corners of the path as a polygon, a DataFrame: segment, t_s, turn, is_cusp.

    `turn` is that of the course at a corner [rad]. At a cusp the robot changes its direction: there
    the course turns by half a turn more or less than the robot does by its encoders.
    """
    least_m = max(_VERTEX_M, _VERTEX_SIGMAS * log.recording.noise_m)
    parts = []
    for track in tracks_of(log.rows):
        kept = [0]
        for k in range(1, len(track.t)):
            if abs(track.position[k] - track.position[kept[-1]]) >= least_m:
                kept.append(k)
        t_s = track.t[kept]
        step = np.diff(track.position[kept])
        middle_s = (t_s[1:] + t_s[:-1]) / 2
        turned = log.kappa * np.diff(np.interp(middle_s, track.t_encoders, track.motion.imag))
        turn = np.angle(step[1:] * step[:-1].conj())
        is_cusp = np.cos(turn - turned) < 0
        corners = dict(segment=len(parts), t_s=t_s[1:-1], turn=turn, is_cusp=is_cusp)
        parts.append(pd.DataFrame(corners))
    return pd.concat(parts, ignore_index=True)


def _never_turns(log, share):
    """A yaw rate that never changes while the path turns."""
    omega = log.rows[_OMEGA].dropna()
    are_tracks = log.recording.columns[_OMEGA] == log.recording.columns[_NU]
    # That of tracks is their difference over a width that may be wrong.
    if np.ptp(omega) * (log.recording.track_width_m if are_tracks else 1.0) > _EMPTY:
        return None
    if log.rows[_NU].abs().max() < _EMPTY:  # a robot that stands
        return None
    vertices = _vertices(log)
    course = vertices["turn"].where(~vertices["is_cusp"], 0.0).groupby(vertices["segment"]).cumsum()
    turns_rad = float(course.groupby(vertices["segment"]).agg(np.ptp).max()) if len(course) else 0.0
    if turns_rad < _TURNS_RAD:
        return None
    column = log.recording.columns[_OMEGA]
    but = f"in all rows, but the path turns by {turns_rad:.2g} rad"
    if are_tracks:
        fact = f"the log's {column} are as fast as each other {but}: both are of one track"
        remedy = "Look where the log is written for the column of the other track."
    else:
        fact = f"the log's {column} is {omega.median():.3g} {but}: nothing fills this column"
        remedy = (
            f"Take {column} from another topic, or from the speeds of both tracks with their "
            f"distance, {passed('track_width_m')}."
        )
    return share, refused(fact, "empty_yaw_rate", remedy)


def _of_the_map(log, share):
    """A speed that is that along an axis of the map, not along the robot."""
    parts = []
    for track in tracks_of(log.rows):
        at = np.arange(track.t[0], track.t[-1], LENGTHS_S[1])
        place = np.interp(at, track.t, track.position)
        driven = np.interp(at, track.t_encoders, track.motion.real)
        parts.append(np.column_stack([np.diff(place).real, np.diff(place).imag, np.diff(driven)]))
    steps = np.concatenate(parts)
    # Outliers go farther than the robot.
    is_driven = np.hypot(steps[:, 0], steps[:, 1]) < _OUTLIER * np.abs(steps[:, 2]).max()
    dx, dy, n = steps[is_driven].T
    way = np.hypot(dx, dy)
    squares = n @ n
    b, left, *_ = np.linalg.lstsq(np.column_stack([dx, dy]), n)
    # Of a speed ahead the way explains all, whatever the course is.
    of_way = 1 - (np.abs(n) @ way) ** 2 / (squares * (way @ way))
    if not len(left) or left[0] > min((1 - _GOOD) * squares, of_way * squares / _BETTER):
        return None
    return share, refused(
        f"the log's {log.recording.columns[_NU]} is the speed along a fixed direction of the map, "
        f"{np.angle(b[0] + 1j * b[1]):.2g} rad from the x axis, not the speed ahead",
        "twist_of_the_map",
        "Log the twist in the frame of the robot (its child_frame_id), or turn it by the yaw.",
    )


def _undone(undo, fact, remedy):
    """The hypothesis of a fault of the encoders.

    Args:
        undo: _Log -> rows without the fault, or None where it cannot be.
        fact, remedy: What is said of it, with {speed}, {yaw_rate}.
    """

    def hypothesis(log, share):
        rows = undo(log)
        found = None if rows is None else explained(rows)
        if not found or found[0] <= 0 or found[1] <= max(_GOOD, 1 - (1 - share) / _BETTER):
            return None
        named = fact.format(
            speed=log.recording.columns[_NU], yaw_rate=log.recording.columns[_OMEGA]
        )
        told = (
            f"{named}: so the encoders explain {found[1]:.0%} of the path, and as they are "
            f"{max(log.share, 0):.0%}"
        )
        return found[1], refused(told, "sign", remedy)

    return hypothesis


_HYPOTHESES = (
    _never_turns,
    _of_the_map,
    _undone(
        _one_side(1.0),
        "the left encoder may count backwards",
        "Turn the sign of the left encoder where the log is written. The columns of speed and yaw "
        "rate may also have been exchanged.",
    ),
    _undone(
        _one_side(-1.0),
        "the right encoder may count backwards",
        "Turn the sign of the right encoder where the log is written.",
    ),
    _undone(
        _with_sign,
        "the log's {speed} has no sign: the robot drives backwards, too, and it is never negative",
        "Log the signed speed, or give it the sign of the command.",
    ),
    _undone(
        _turn_with_sign,
        "the log's {yaw_rate} has no sign: the path turns to both sides, and it is never negative",
        "Log the signed yaw rate, counter-clockwise.",
    ),
    *(
        _undone(_rates(*names), f"the log's {what} since the beginning", f"Log {remedy}.")
        for names, what, remedy in (
            ((_OMEGA,), "{yaw_rate} is the angle", "the yaw rate, or the change of the angle"),
            ((_NU,), "{speed} is the way", "the speed, or the change of the way"),
            ((_NU, _OMEGA), "{speed} and {yaw_rate} are way and angle", "speeds, or their changes"),
        )
    ),
)


def find(recording):
    """The Findings of the fault that explains a Recording, of which there is at most one.

    Nothing is tried where the encoders explain the path as they are.
    """
    with np.errstate(all="ignore"):
        as_it_is = explained(recording.rows)
        if as_it_is is None:
            return
        kappa, share = as_it_is
        if share > _GOOD:
            return
        log = _Log(recording, max(kappa, 0.0), share)
        # A later one that holds leaves a third of what the one before it leaves.
        found = [finding for _, finding in tried(_HYPOTHESES, log, share)]
    yield from found[-1:]
