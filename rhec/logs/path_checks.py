"""Checks of a log for wrong units, signs and axes, for late positions and for another clock.

The checks compare the path of the positions with the encoders over intervals of one length. While
the tracks drive a distance n and turn by w, the antenna moves by d, with
d² = μ² n² + a w² + b n w + c. The lever arm determines a and b; the position noise determines c.
The course turns by κ w + e Δ(w/n), where Δ is the change from one interval to the next: an antenna
ahead of the centre turns earlier, which is no delay. No estimator and no yaw are needed.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from rhec.logs import minimum
from rhec.logs.finding import note, passed, refused, warning
from rhec.simulation.columns import MEASUREMENTS

_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
# Lengths of the intervals. The shortest one in which motion exceeds the noise is used.
LENGTHS_S = (0.6, 1.2, 2.4)
_DELAYS_S = np.arange(-20, 21) / 10  # that are tried
# The motion explains the path if it explains more than this share of the squares.
_CLEAR_SHARE = 0.5
_LEAST_GAIN = 0.005  # of that share, by a delay
_SURE = 4.0  # standard deviations by which a delay must differ from 0
_LATE_S = 0.25  # shorter delays are not reported
_LEAST_INTERVALS = 60
_SIGMA_C = 0.02  # prior standard deviation of c [m²], for positions accurate to 0.1 m
_SHARPEST_PER_M = 2.0  # curvature w/n of an interval beyond which the course says little
# Another clock: path and encoders are compared over a minute either way, in steps of a second.
_OFFSETS_S = range(-60, 61)
_BY_ONE_CLOCK_S = range(-2, 3)  # offsets at which both may have the same clock
_SAME_CLOCK = 0.64  # share of the squares of the distances that is explained by one clock
_OTHER_CLOCK = 0.36  # and by two
_GPS_AHEAD_S = 18  # of UTC, since 2017
# A slope counts as out of range if it is this many standard errors outside. The limit is
# high because correlated errors of neighbouring intervals make the standard errors too small.
_STANDARD_ERRORS = 9.0
_MOST_TRACTION = 1.05  # a larger μ or κ is none
_LEAST_TRACTION = 0.55  # a smaller μ is hardly slip: a knot is 0.51 m/s, a mile an hour 0.45 m/s
_ERRORS = 5.0  # standard errors by which it must be larger or smaller
# Positions that are the integral of the encoders are explained by them so well.
_OWN_SHARE = 0.999
_OWN_SLOPE = 0.003  # difference of μ and κ from 1


class _Check(NamedTuple):
    """What a slope measures, its plausible range, and what is said beyond it."""

    measured: str  # sentence that states the slope `times`
    least_share: float  # of the squares that the slope must explain to be judged
    causes: dict  # {upper limit of the slope: cause}; None for the range that is plausible
    above: tuple  # code, fact and remedy of a slope above 1
    least: float = -np.inf  # a smaller slope is in doubt


_CHECKS = (
    _Check(
        "the path of {place} is {times:.3g} times as long as {speed} says",
        0.3,
        {
            5e-5: "{place} may be longitude and latitude and should be in m",
            1.5e-3: "{speed} may be in mm/s and should be in m/s",
            0.02: "{speed} may be in cm/s and should be in m/s",
            0.31: "{speed} may be in km/h and should be in m/s",
            1.4: None,
            10.0: "{place} may be in feet and should be in m",
            200.0: "{place} may be in cm and should be in m",
            np.inf: "{place} may be in mm and should be in m",
        },
        (
            "scale_of_speed",
            "the positions go {times:.3g} times as far as the encoders say; tracks only slip the "
            "other way",
            "The wheel radius or the encoders' scale is too small.",
        ),
        _LEAST_TRACTION,
    ),
    _Check(
        "the path of {place} turns {times:.3g} times as far as {yaw_rate} says",
        0.1,
        {
            0.0: "{yaw_rate} may be counted clockwise and should be counter-clockwise, or {place} "
            "or left and right may be swapped",
            0.12: "{yaw_rate} may be in degrees per second and should be in rad/s",
            1.7: None,
            np.inf: "{yaw_rate} may be in another unit and should be in rad/s",
        },
        (
            "corrected_yaw_rate",
            "the course turns {times:.3g} times as far as the encoders say, so that κ is at its "
            "bound 1",
            "The driver may already correct the yaw rate: {multiplier} undoes it, or use the track "
            "speeds with their geometric distance, {width}.",
        ),
    ),
)


class _Slope(NamedTuple):
    """A least-squares slope, its standard error, and the share of the squares it explains."""

    value: float
    sigma: float
    share: float


class _Motion(NamedTuple):
    """What the path says of the encoders, with positions at their stamps and by their delay."""

    delay_s: float  # the likeliest delay of the positions
    sigma_s: float  # its standard deviation
    in_time: tuple  # slopes (μ, κ) without a delay
    late: tuple  # and with this delay


class _Track(NamedTuple):
    """The path of one segment, and the motion by the encoders."""

    t: np.ndarray  # (n,) times of the positions [s]
    position: np.ndarray  # (n,) x + iy [m]
    t_encoders: np.ndarray  # (m,) times of the encoder measurements [s]
    motion: np.ndarray  # (m,) distance driven + i angle turned until then [m, rad]


def tracks_of(rows):
    """The _Track of each segment that has three positions and three encoder measurements."""
    tracks = []
    segments = rows["segment"].to_numpy()
    columns = rows[["t_s", *_POSITION, *_ENCODERS]].to_numpy()
    for segment in np.unique(segments):
        part = columns[segments == segment]
        t, x, y = part[np.isfinite(part[:, 1:3]).all(axis=1), :3].T
        t_encoders, nu, omega = part[np.isfinite(part[:, 3:]).all(axis=1)][:, [0, 3, 4]].T
        if min(len(t), len(t_encoders)) >= 3:
            motion = cumulative_trapezoid(nu + 1j * omega, t_encoders, initial=0)
            tracks.append(_Track(t, x + 1j * y, t_encoders, motion))
    return tracks


class _Intervals(NamedTuple):
    """The path of a _Track over m intervals of one length, each of which begins in the one before.

    An interval, the next one and the interval between both use five instants.
    """

    track: _Track
    at: np.ndarray  # (m + 4,) instants, half an interval apart [s]
    path: tuple  # (m,) each: how far the antenna moves, the turn to the next interval, its weight
    is_dense: np.ndarray  # (m,) whether there are positions throughout


def intervals_of(tracks, length_s):
    """The _Intervals of the tracks that have any."""
    found = []
    for track in tracks:
        at = np.arange(track.t[0], track.t[-1], length_s / 2)
        if len(at) < 5:
            continue
        p = np.interp(at, track.t, track.position)
        step = p[2:] - p[:-2]
        turned = step[2:] * step[:-2].conj()
        gap_s = np.interp(at, track.t[1:], np.diff(track.t))
        longest_s = np.lib.stride_tricks.sliding_window_view(gap_s, 5).max(axis=1)
        path = np.abs(step[:-2]), np.angle(turned), np.abs(turned)
        found.append(_Intervals(track, at, path, longest_s < length_s))
    return found


def _moves(intervals, delay_s):
    """Motion of antenna and tracks in all _Intervals, for late positions, (7, intervals).

    These are d, the turn of the course to the next interval and its weight; n, w, w between the two
    intervals, and the change of w/n from one to the other.
    """
    parts = [np.zeros((7, 0))]
    for track, at, (d, turn, weight), is_dense in intervals:
        motion = np.interp(at - delay_s, track.t_encoders, track.motion)
        step = motion[2:] - motion[:-2]
        n, w = step.real, step.imag
        curvature = _curvature(w, n)
        keeps_direction = n[:-2] * n[2:] > 0  # forwards or backwards
        bend = curvature[2:] - curvature[:-2]
        moves = [d, turn, weight * keeps_direction, n[:-2], w[:-2], w[1:-1], bend]
        parts.append(np.array(moves)[:, is_dense])
    return np.concatenate(parts, axis=1)


def _curvature(w, n):
    """w/n [rad/m] within ±_SHARPEST_PER_M, 0 where the robot stands."""
    ratio = np.divide(w, n, out=np.zeros_like(w), where=n != 0)
    return np.clip(ratio, -_SHARPEST_PER_M, _SHARPEST_PER_M)


class _Fit(NamedTuple):
    """The least-squares fit y = x b."""

    x: np.ndarray  # (n, m)
    y: np.ndarray  # (n,)
    b: np.ndarray  # (m,)
    left: np.ndarray  # (n,) squares that it leaves

    @property
    def sigma(self):
        """The standard error of b_0."""
        variance = self.left.mean() * np.linalg.pinv(self.x.T @ self.x)[0, 0]
        return np.sqrt(max(variance, 0))


def _fit(x, y):
    b = np.linalg.lstsq(x, y)[0]
    return _Fit(x, y, b, (y - x @ b) ** 2)


class Comparison(NamedTuple):
    """Path and encoders over intervals of one length, for late positions."""

    distances: _Fit  # d² = μ² n² + a w² + b n w + c
    turns: _Fit  # of the course, κ w + e Δ(w/n), by the root of their weights
    share: float  # of the squares of the distances that the encoders explain
    unexplained: np.ndarray  # how much of each motion and turn is not, as shares of the squares

    @property
    def slopes(self):
        """The _Slope of distance by positions over encoders, μ, and of turns, κ."""
        x, y, _, left = self.distances
        # At a constant speed the intervals do not determine c, so a prior is added.
        prior = np.sqrt(left.mean()) / _SIGMA_C * np.eye(4)[3:]
        known = _fit(np.append(x, prior, axis=0), np.append(y, 0))
        mu = np.sqrt(max(known.b[0], 1e-14))
        without = _fit(self.turns.x[:, 1:], self.turns.y).left
        share = 1 - self.turns.left.sum() / without.sum() if without.any() else 0.0
        kappa = _Slope(self.turns.b[0], self.turns.sigma, share)
        return _Slope(mu, known.sigma / (2 * mu), self.share), kappa


def compare(intervals, delay_s):
    """The Comparison of path and encoders over _Intervals; None for few of them."""
    d, turn, weight, n, w, w_turn, bend = _moves(intervals, delay_s)
    if len(d) < _LEAST_INTERVALS:
        return None
    root = np.sqrt(weight)
    y = d**2
    distances = _fit(np.stack([n**2, w**2, n * w, np.ones_like(n)], axis=1), y)
    turns = _fit(root[:, None] * np.stack([w_turn, bend], axis=1), root * turn)
    squares = max(np.sum((y - y.mean()) ** 2), distances.left.sum(), 1e-300)
    of_turns = max(weight @ turn**2, 1e-300)
    unexplained = distances.left / squares + turns.left / of_turns
    return Comparison(distances, turns, 1 - distances.left.sum() / squares, unexplained)


@np.errstate(all="ignore")
def _motion(rows):
    """The _Motion of a log; None if it is too short."""
    tracks = tracks_of(rows)
    usable = None
    for length_s in LENGTHS_S:
        intervals = intervals_of(tracks, length_s)
        # Where positions are sparse, only longer intervals are enough of them.
        if compare(intervals, 0.0) is None:
            continue
        usable = intervals
        compared = (compare(usable, delay_s) for delay_s in _DELAYS_S)
        shares, losses = zip(*((each.share, each.unexplained) for each in compared))
        if max(shares) > _CLEAR_SHARE:
            break
    if usable is None:
        return None
    delay_s, sigma_s = minimum.least(_DELAYS_S, np.array(losses))
    in_time, late = (compare(usable, each).slopes for each in (0.0, delay_s))
    return _Motion(delay_s, sigma_s, in_time, late)


def likeliest_delay(recording):
    """Delay of a Recording's positions [s] by its path alone, which is 0 for a short log."""
    motion = _motion(recording.rows)
    return motion.delay_s if motion else 0.0


def positions_are_late(motion):
    """Whether positions are clearly late: the delay explains more of distances and of turns."""
    gains = [late.share - each.share for late, each in zip(motion.late, motion.in_time)]
    is_clear = motion.late[0].share > _CLEAR_SHARE and min(gains) >= 0 and sum(gains) > _LEAST_GAIN
    return is_clear and abs(motion.delay_s) > max(_LATE_S, _SURE * motion.sigma_s)


def _cause(slope, check):
    """The cause of a _Slope that is significantly out of range; None if it is in range."""
    high = next(limit for limit in check.causes if check.causes[limit] is None)
    low = max(limit for limit in check.causes if limit < high)
    error = _STANDARD_ERRORS * slope.sigma
    is_outside = slope.value + error <= low or slope.value - error > high
    if slope.share < check.least_share or not is_outside:
        return None
    return next(check.causes[limit] for limit in check.causes if slope.value <= limit)


def check_path(recording):
    """Find wrong units, signs and axes, and positions that are late by up to two seconds."""
    columns = recording.columns
    speed, yaw_rate = (columns[name] for name in _ENCODERS)
    speeds = ", ".join(dict.fromkeys([speed, yaw_rate]))
    if yaw_rate == speed:
        yaw_rate += f" by {passed('track_width_m')}"
    place = ", ".join(columns[name] for name in _POSITION)
    motion = _motion(recording.rows)
    if motion is None:
        return
    is_late = positions_are_late(motion)
    slopes = motion.late if is_late else motion.in_time
    helps = dict(multiplier=passed("wheel_separation_multiplier"), width=passed("track_width_m"))
    for slope, check in zip(slopes, _CHECKS):
        named = dict(times=slope.value, place=place, speed=speed, yaw_rate=yaw_rate) | helps
        cause = _cause(slope, check)
        if cause:
            yield refused(f"the log's {cause}: {check.measured}".format(**named))
        elif slope.share > 0.3 and slope.value - _ERRORS * slope.sigma > _MOST_TRACTION:
            yield note(*(text.format(**named) for text in check.above))
        elif slope.share > 0.3 and slope.value + _ERRORS * slope.sigma < check.least:
            yield warning(
                "scale_of_speed",
                f"the positions go only {slope.value:.3g} times as far as {speed} says",
                "Half of it would be slip: see whether it is in knots or miles an hour, or of "
                "wheels that are smaller than was assumed.",
            )
    if is_late and motion.delay_s > 0:
        yield warning(
            "late_positions",
            f"the log's {place} come {motion.delay_s:.2f} ± {2 * motion.sigma_s:.2f} s later than "
            f"{speeds}",
            f"{passed('calibrate', True)} measures the delay and makes up for it; "
            f"{passed('position_delay_s', round(motion.delay_s, 2))} alone does the latter.",
        )
    elif is_late:
        yield note(
            "early_positions",
            f"the log's {speeds} seem to come {-motion.delay_s:.2f} ± {2 * motion.sigma_s:.2f} s "
            f"later than {place}",
            "Either they do, or the robot was steered by its positions, so that its speeds answer "
            "them: then nothing is to be done.",
        )
    if slopes[0].share > _OWN_SHARE and all(abs(each.value - 1) < _OWN_SLOPE for each in slopes):
        yield warning(
            "own_integral",
            "the positions are the integral of the encoders: μ and κ are 1 all the time",
            "An odometry's pose is no measurement: take positions from a receiver.",
        )


def check_clock_offset(recording):
    """Find positions by another clock, seconds to a minute away from that of the encoders.

    Over that offset the encoders explain the distances of the path, and over none within two
    seconds they do.
    """
    tracks = tracks_of(recording.rows)
    # Nearly all logs have one clock and end here; the other offsets take long.
    if max(_shares(tracks, _BY_ONE_CLOCK_S).values(), default=1.0) > _OTHER_CLOCK:
        return
    shares = _shares(tracks, _OFFSETS_S)
    best_s = max(shares, key=shares.get)
    if shares[best_s] < _SAME_CLOCK:
        return
    place = ", ".join(recording.columns[name] for name in _POSITION)
    way = "ahead of" if best_s > 0 else "behind"
    why = ", as GPS time is ahead of UTC" if best_s == _GPS_AHEAD_S else ""
    yield refused(
        f"the log's {place} are by a clock about {abs(best_s)} s {way} that of "
        f"{recording.columns[_ENCODERS[0]]}{why}; "
        f"{passed('position_delay_s', best_s)} corrects this",
        "clock_offset",
        "Record all sensors by one clock, such as the computer's.",
    )


@np.errstate(all="ignore")
def _shares(tracks, offsets_s):
    """{offset of the clocks: share of the squares of the distances that the encoders explain}."""
    intervals = intervals_of(tracks, LENGTHS_S[-1])
    compared = {each: compare(intervals, each) for each in offsets_s}
    return {offset_s: each.share for offset_s, each in compared.items() if each}
