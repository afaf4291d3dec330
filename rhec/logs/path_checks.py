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
from rhec.logs.finding import Finding, Severity, refused
from rhec.logs.recording import POSITION_AGE
from rhec.simulation.columns import MEASUREMENTS

_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
# Lengths of the intervals. The shortest one in which motion exceeds the noise is used.
_LENGTHS_S = (0.6, 1.2, 2.4)
_DELAYS_S = np.arange(-20, 21) / 10  # that are tried
_NO_DELAY = 20  # its place among these
# The motion explains the path if it explains more than this share of the squares.
_CLEAR_SHARE = 0.5
_LEAST_GAIN = 0.005  # of that share, by a delay
_SURE = 4.0  # standard deviations by which a delay must differ from 0
_LATE_S = 0.25  # shorter delays are not reported
_LEAST_ROWS = 50
_LEAST_INTERVALS = 60
_STANDING = 0.3  # a robot that drove and turned less than this [m, rad] never moved
_SIGMA_C = 0.02  # prior standard deviation of c [m²], for positions accurate to 0.1 m
_SHARPEST_PER_M = 2.0  # curvature w/n of an interval beyond which the course says little
# Another clock: path and encoders are compared over a minute either way, in steps of a second.
_OFFSETS_S = np.arange(-60, 61)
_LEAST_OVERLAP_S = 60
_SAME_SPEED = 0.8  # correlation of both speeds by one clock
_OTHER_SPEED = 0.6  # and by two
_GPS_AHEAD_S = 18  # of UTC, since 2017
# A slope counts as out of range if it is this many standard errors outside. The limit is
# high because correlated errors of neighbouring intervals make the standard errors too small.
_STANDARD_ERRORS = 9.0
_MOST_TRACTION = 1.05  # a larger μ or κ is none
_ERRORS = 5.0  # standard errors by which it must be larger


class _Check(NamedTuple):
    """The plausible range of a slope, and the causes of slopes outside it."""

    measured: str  # sentence that states the slope `times`
    least_share: float  # of the squares that the slope must explain to be judged
    causes: dict  # {upper limit of the slope: cause}; None for the range that is plausible


class _Slope(NamedTuple):
    """A least-squares slope, its standard error, and the share of the squares it explains."""

    value: float
    sigma: float
    share: float


_MU = _Check(
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
)
_KAPPA = _Check(
    "the path of {place} turns {times:.3g} times as far as {yaw_rate} says",
    0.1,
    {
        0.0: "{yaw_rate} may be counted clockwise and should be counter-clockwise, or {place} may "
        "be swapped",
        0.12: "{yaw_rate} may be in degrees per second and should be in rad/s",
        1.7: None,
        np.inf: "{yaw_rate} may be in another unit and should be in rad/s",
    },
)


class _Track(NamedTuple):
    """The path of one segment, and the motion by the encoders."""

    t: np.ndarray  # (n,) times of the positions [s]
    position: np.ndarray  # (n,) x + iy [m]
    t_encoders: np.ndarray  # (m,) times of the encoder measurements [s]
    driven: np.ndarray  # (m,) distance driven until then [m]
    turned: np.ndarray  # (m,) angle turned until then [rad]


def _tracks(rows):
    """The _Track of each segment that has three positions and three encoder measurements."""
    tracks = []
    for _, part in rows.groupby("segment"):
        positions = part[["t_s", *_POSITION]]
        if POSITION_AGE in part:
            positions = positions.assign(t_s=part["t_s"] - part[POSITION_AGE])
        positions = positions.dropna()
        speeds = part[["t_s", *_ENCODERS]].dropna()
        if min(len(positions), len(speeds)) >= 3:
            t, x, y = positions.to_numpy().T
            t_encoders = speeds["t_s"].to_numpy()
            motion = cumulative_trapezoid(speeds[_ENCODERS], t_encoders, axis=0, initial=0)
            tracks.append(_Track(t, x + 1j * y, t_encoders, *motion.T))
    return tracks


def _moves(tracks, length_s, delay_s):
    """Motion of antenna and tracks in intervals of one length, for late positions, (intervals, 6).

    The columns are d, n, w, the turn of the course to the next interval, w between the two
    intervals, the change of w/n from one to the other, and the weight of that turn.
    """
    parts = [np.zeros((0, 7))]
    for track in tracks:
        # Each row uses five instants k, …, k + 4 that are half an interval apart.
        at = np.arange(track.t[0], track.t[-1], length_s / 2)
        p = np.interp(at, track.t, track.position)
        n = np.interp(at - delay_s, track.t_encoders, track.driven)
        w = np.interp(at - delay_s, track.t_encoders, track.turned)
        step = p[2:-2] - p[:-4]
        next_step = p[4:] - p[2:-2]
        n_step = n[2:-2] - n[:-4]
        n_next = n[4:] - n[2:-2]
        w_step = w[2:-2] - w[:-4]
        w_next = w[4:] - w[2:-2]
        keeps_direction = n_step * n_next > 0  # forwards or backwards
        columns = [
            np.abs(step),
            n_step,
            w_step,
            np.angle(next_step * step.conj()),
            w[3:-1] - w[1:-3],
            _curvature(w_next, n_next) - _curvature(w_step, n_step),
            np.abs(next_step * step) * keeps_direction,
        ]
        gap_s = np.interp(at, track.t[1:], np.diff(track.t))
        is_dense = [gap_s[first : len(at) - 4 + first] < length_s for first in range(5)]
        parts.append(np.transpose(columns)[np.all(is_dense, axis=0)])
    return np.concatenate(parts)


def _curvature(w, n):
    """w/n [rad/m] within ±_SHARPEST_PER_M, 0 where the robot stands."""
    ratio = np.divide(w, n, out=np.zeros_like(w), where=n != 0)
    return np.clip(ratio, -_SHARPEST_PER_M, _SHARPEST_PER_M)


def _left(x, y):
    """What the least-squares fit y = x b leaves of y."""
    return y - x @ np.linalg.lstsq(x, y)[0]


def _slope(x, y):
    """The _Slope b_0 of the least-squares fit y = x b; its share is that beyond the others'."""
    b = np.linalg.lstsq(x, y)[0]
    residual = np.sum((y - x @ b) ** 2)
    sigma = np.sqrt(residual / len(y) * max(np.linalg.pinv(x.T @ x)[0, 0], 0))
    without = np.sum(_left(x[:, 1:], y) ** 2) if x.shape[1] > 1 else y @ y
    return _Slope(b[0], sigma, 1 - residual / without if without else 0.0)


def _compare(tracks, length_s, delay_s):
    """Compare path and encoders over intervals of one length, for late positions.

    Returns:
        The _Slope of distance by positions over encoders, μ, and of turns, κ, and how much of its
        motion and its turn is not explained, (intervals,), as shares of the squares in all. None
        for few intervals.
    """
    moves = _moves(tracks, length_s, delay_s)
    if len(moves) < _LEAST_INTERVALS:
        return None
    d, n, w, turn, w_turn, bend, weight = moves.T
    # d² = μ² n² + a w² + b n w + c
    x = np.stack([n**2, w**2, n * w, 1 + 0 * n], axis=1)
    y = d**2
    left = _left(x, y) ** 2
    residual = left.sum()
    # At a constant speed the intervals do not determine c, so a prior is added.
    prior = np.sqrt(residual / len(y)) / _SIGMA_C * np.eye(4)[3:]
    mu2, sigma, *_ = _slope(np.append(x, prior, axis=0), np.append(y, 0))
    mu = np.sqrt(max(mu2, 1e-14))
    squares = max(np.sum((y - y.mean()) ** 2), residual, 1e-300)
    root = np.sqrt(weight)
    turned = root * turn
    x = root[:, None] * np.stack([w_turn, bend], axis=1)
    unexplained = left / squares + _left(x, turned) ** 2 / max(turned @ turned, 1e-300)
    mu = _Slope(mu, sigma / (2 * mu), 1 - residual / squares)
    return mu, _slope(x, turned), unexplained


class _Motion(NamedTuple):
    """What the path says of the encoders, with positions at their stamps and by their delay."""

    delay_s: float  # the likeliest delay of the positions
    sigma_s: float  # its standard deviation
    in_time: tuple  # (μ, κ) by `_compare` without a delay
    late: tuple  # and with this delay


def _motion(rows):
    """The _Motion of a log; None if it is too short."""
    tracks = _tracks(rows)
    for length_s in _LENGTHS_S:
        compared = [_compare(tracks, length_s, delay_s) for delay_s in _DELAYS_S]
        if compared[0] is None:
            return None
        if max(mu.share for mu, _, _ in compared) > _CLEAR_SHARE:
            break
    losses = np.array([unexplained for _, _, unexplained in compared])
    delay_s, sigma_s = minimum.least(_DELAYS_S, losses)
    late = _compare(tracks, length_s, delay_s)[:2]
    return _Motion(delay_s, sigma_s, compared[_NO_DELAY][:2], late)


def likeliest_delay(recording):
    """Delay of a Recording's positions [s] by its path alone, which is 0 for a short log."""
    with np.errstate(all="ignore"):
        motion = _motion(recording.rows)
    return motion.delay_s if motion else 0.0


def _is_late(motion):
    """Whether positions are clearly late: the delay explains more of distances and of turns."""
    gains = [late.share - each.share for late, each in zip(motion.late, motion.in_time)]
    is_clear = motion.late[0].share > _CLEAR_SHARE and min(gains) >= 0 and sum(gains) > _LEAST_GAIN
    return is_clear and abs(motion.delay_s) > max(_LATE_S, _SURE * motion.sigma_s)


def _cause(slope, check):
    """The cause of a _Slope that is significantly out of range; None if it is in range."""
    limits = [-np.inf, *check.causes]
    high = next(limit for limit in check.causes if check.causes[limit] is None)
    low = limits[limits.index(high) - 1]
    error = _STANDARD_ERRORS * slope.sigma
    is_outside = slope.value + error <= low or slope.value - error > high
    if slope.share < check.least_share or not is_outside:
        return None
    return next(check.causes[limit] for limit in check.causes if slope.value <= limit)


def _names(recording):
    """What the messages call the columns of a Recording."""
    columns = recording.columns
    return dict(
        speed=columns[_ENCODERS[0]],
        yaw_rate=columns[_ENCODERS[1]],
        speeds=", ".join(dict.fromkeys(columns[name] for name in _ENCODERS)),
        place=", ".join(columns[name] for name in _POSITION),
    )


def check_standing(recording):
    """Find a robot that never moves, and positions that never change although it does."""
    rows = recording.rows
    names = _names(recording)
    motion = rows[_ENCODERS].mul(rows.groupby("segment")["t_s"].diff(), axis=0).cumsum()
    farthest = (motion.max() - motion.min()).max()
    if len(rows) >= _LEAST_ROWS and farthest < _STANDING:
        yield refused(
            f"the log's {names['speeds']} should be of a robot that moves: it drove and turned "
            f"{farthest:.2g} m and rad at most"
        )
    n_held = recording.faults["positions_held"]
    if rows[_POSITION[0]].count() <= recording.faults["segments"] and n_held >= _LEAST_ROWS:
        yield refused(
            f"the log's {names['place']} should be of a robot that moves: they never change"
        )


def check_path(recording):
    """Find wrong units, signs and axes, and positions that are late by up to two seconds."""
    names = _names(recording)
    rows = recording.rows
    with np.errstate(all="ignore"):
        motion = _motion(rows)
        if motion is None:
            return
        is_late = _is_late(motion)
        mu, kappa = motion.late if is_late else motion.in_time
    for slope, check in ((mu, _MU), (kappa, _KAPPA)):
        cause = _cause(slope, check)
        if cause:
            sentence = f"the log's {cause}: {check.measured}"
            yield refused(sentence.format(times=slope.value, **names))
    if is_late:
        delay_s = motion.delay_s
        way = "later" if delay_s > 0 else "earlier"
        late = f"{abs(delay_s):.2f} ± {2 * motion.sigma_s:.2f} s {way}"
        yield Finding(
            Severity.WARNING,
            "late_positions",
            f"the log's {names['place']} come {late} than {names['speeds']}; "
            f"position_delay_s={delay_s:.2f} corrects this",
            "rhec.calibrate measures the delay together with the place of the antenna.",
        )
    yield from _check_scale(mu, kappa)


def _check_scale(mu, kappa):
    """Find a motion over ground that is larger than slip allows, μ or κ above 1."""
    if mu.share > 0.5 and mu.value - _ERRORS * mu.sigma > _MOST_TRACTION:
        yield Finding(
            Severity.NOTE,
            "scale_of_speed",
            f"the positions go {mu.value:.3g} times as far as the encoders say; tracks only slip "
            "the other way",
            "The wheel radius or the encoders' scale is too small.",
        )
    if kappa.share > 0.3 and kappa.value - _ERRORS * kappa.sigma > _MOST_TRACTION:
        yield Finding(
            Severity.NOTE,
            "corrected_yaw_rate",
            f"the course turns {kappa.value:.3g} times as far as the encoders say, so that κ is at "
            "its bound 1",
            "The driver may already correct the yaw rate: rhec.logs.read undoes its "
            "wheel_separation_multiplier (--wheel-separation-multiplier), or use the track speeds "
            "with the geometric track_width_m.",
        )


def check_clock_offset(recording):
    """Find positions by another clock, seconds to a minute away from that of the encoders.

    Over an offset at which they belong together, the speed of the path correlates with that of
    the encoders.
    """
    parts = {offset_s: [np.zeros((0, 2))] for offset_s in _OFFSETS_S}
    for track in _tracks(recording.rows):
        at = np.arange(np.ceil(track.t[0]), track.t[-1])
        path_mps = np.abs(np.diff(np.interp(at, track.t, track.position)))
        for offset_s, pairs in parts.items():
            driven = np.interp(
                at - offset_s, track.t_encoders, track.driven, left=np.nan, right=np.nan
            )
            pair = np.column_stack([path_mps, np.abs(np.diff(driven))])
            pairs.append(pair[np.isfinite(pair).all(axis=1)])
    pairs = {offset_s: np.concatenate(of_tracks) for offset_s, of_tracks in parts.items()}
    with np.errstate(all="ignore"):
        alike = {
            offset_s: np.corrcoef(pair.T)[0, 1]
            for offset_s, pair in pairs.items()
            if len(pair) >= _LEAST_OVERLAP_S and (pair.std(axis=0) > 0).all()
        }
    if not alike:
        return
    best_s = int(max(alike, key=alike.get))
    near = max((value for offset_s, value in alike.items() if abs(offset_s) <= 2), default=0.0)
    if alike[best_s] > _SAME_SPEED and near < _OTHER_SPEED:
        names = _names(recording)
        why = ", as GPS time is ahead of UTC" if best_s == _GPS_AHEAD_S else ""
        late = f"{abs(best_s)} s {'ahead' if best_s > 0 else 'behind'}"
        yield Finding(
            Severity.ERROR,
            "clock_offset",
            f"the log's {names['place']} are by a clock about {late} of that of {names['speed']}"
            f"{why}; position_delay_s={best_s} corrects this",
            "Record all sensors by one clock, such as the computer's.",
        )
