"""Nonsense in a log, named before anything is estimated: units, signs and axes, late positions.

The path of the positions is held against the encoders over intervals of one length. An antenna is
moved there by d, d² = μ²n² + aw² + bnw + c where the tracks drive n and turn w (a, b: its lever
arm, c: noise), and the course turns by κw. That needs no estimator and no yaw.
"""

import warnings

import numpy as np
from scipy.integrate import cumulative_trapezoid

from rhec.simulation.columns import MEASUREMENTS

__all__ = ["refuse_nonsense"]

_POSITION = MEASUREMENTS[:2]
_ENCODERS = MEASUREMENTS[2:]
_LENGTHS_S = (0.6, 1.2, 2.4)  # of the intervals: the first that shows through the positions' noise
# tried; then about the best
_DELAYS_S = np.arange(-10, 11) / 5
_FINER_S = np.arange(-3, 4) / 20
# share explained, more than without; what is named
_CLEAR = 0.5
_BETTER = 0.05
_LATE_S = 0.25
_AGREE_S = 0.15  # to which the halves of a log agree
# at least; [m] or [rad] that a robot which moved has made
_ROWS = 50
_INTERVALS = 60
_STILL = 0.3
_SIGMA_C = 0.02  # [m²], before the log is seen: of positions good to 0.1 m
_SURE = 9.0  # standard errors from what can be: neighbours are not independent
_CLOCKWISE = "may be counted clockwise and should be counter-clockwise"
_MIRRORED = f"{{yaw_rate}} {_CLOCKWISE}", "{place} may be swapped"
# What is said of a log up to each μ, each κ and each turn of the true yaw by w; nothing, up to the
# number with None. First, what is measured, and what share of its squares must be explained.
_MU = (
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
_KAPPA = (
    "the path of {place} turns {times:.3g} times as far as {yaw_rate} says",
    0.1,
    {
        0.0: ", or ".join(_MIRRORED),
        0.12: "{yaw_rate} may be in degrees per second and should be in rad/s",
        1.7: None,
        np.inf: "{yaw_rate} may be in another unit and should be in rad/s",
    },
)
_TRUTH = (
    "{yaw} turns {times:.3g} times as far as {yaw_rate} says",
    0.1,
    {
        0.0: f"{{yaw}} {_CLOCKWISE}",
        10.0: None,
        np.inf: "{yaw} may be in degrees and should be in rad",
    },
)


def _driven(rows):
    """Of each segment: times and places of its positions, x + iy; times, and how far it had by then
    driven and turned by its encoders, (samples, 2).
    """
    for _, part in rows.groupby("segment"):
        place, speeds = (part[["t_s", *names]].dropna() for names in (_POSITION, _ENCODERS))
        if min(len(place), len(speeds)) >= 3:
            (t, x, y) = place.to_numpy().T
            known = speeds["t_s"].to_numpy()
            made = cumulative_trapezoid(speeds[_ENCODERS], known, axis=0, initial=0)
            yield t, x + 1j * y, known, made


def _moves(segments, length_s, delay_s):
    """Over intervals of this length: d, n, w, the turn of the course from each to the next, w then,
    and how much that turn weighs; (intervals, 6). Positions are taken to be late by delay_s.
    """
    parts = [np.zeros((0, 6))]
    for t, place, known, made in segments:
        at = np.arange(t[0], t[-1], length_s / 2)
        p = np.interp(at, t, place)
        gap_s = np.interp(at, t[1:], np.diff(t))
        n, w = (np.interp(at - delay_s, known, each) for each in made.T)
        now = p[2:-2] - p[:-4]
        then = p[4:] - p[2:-2]
        one_way = (n[2:-2] - n[:-4]) * (n[4:] - n[2:-2]) > 0  # forwards or backwards
        columns = [np.abs(now), n[2:-2] - n[:-4], w[2:-2] - w[:-4], np.angle(then * now.conj())]
        columns += [w[3:-1] - w[1:-3], np.abs(then * now) * one_way]
        near = [gap_s[first : len(at) - 4 + first] < length_s for first in range(5)]
        parts.append(np.transpose(columns)[np.all(near, axis=0)])
    return np.concatenate(parts)


def _slope(x, y):
    """Least squares y = x b: b_0, its standard error, and the share of the squares explained."""
    b = np.linalg.lstsq(x, y)[0]
    rest = np.sum((y - x @ b) ** 2)
    sigma = np.sqrt(rest / len(y) * max(np.linalg.pinv(x.T @ x)[0, 0], 0))
    return b[0], sigma, 1 - rest / (y @ y) if y.any() else 0.0


def _compare(segments, length_s, delay_s):
    """μ and κ as the path has them, each as a `_slope`; None where too little is known."""
    moves = _moves(segments, length_s, delay_s)
    if len(moves) < _INTERVALS:
        return None
    d, n, w, turn, w_turn, weight = moves.T
    x = np.stack([n**2, w**2, n * w, 1 + 0 * n], axis=1)
    y = d**2
    root = np.sqrt(weight)
    rest = np.sum((y - x @ np.linalg.lstsq(x, y)[0]) ** 2)
    prior = np.sqrt(rest / len(y)) / _SIGMA_C * np.eye(4)[3:]  # at a constant speed c is not seen
    mu2, sigma, _ = _slope(np.append(x, prior, axis=0), np.append(y, 0))
    mu = np.sqrt(max(mu2, 1e-14))
    of_mu = mu, sigma / (2 * mu), 1 - rest / max(np.sum((y - y.mean()) ** 2), rest, 1e-300)
    return of_mu, _slope((root * w_turn)[:, None], root * turn)


def _best(rows):
    """How much later than encoder measurements positions come [s], as far as that can be told, and
    the `_compare` where they agree best.
    """
    segments = [*_driven(rows)]

    def explained(delay_s):
        return sum(share for *_, share in _compare(segments, length_s, delay_s))

    for length_s in _LENGTHS_S:
        if _compare(segments, length_s, 0.0) is None:
            return 0.0, None
        best = max(_DELAYS_S, key=explained)
        if _compare(segments, length_s, best)[0][2] > _CLEAR:
            break
    best = max(best + _FINER_S, key=explained)
    found = _compare(segments, length_s, best)
    told = found[0][2] > _CLEAR and explained(best) > explained(0.0) + _BETTER
    return best if told else 0.0, found


def _late_twice(rows, delay_s):
    """Whether a half of a log says what all of it does, and the other nothing else; where the
    positions are only noisy they do not.
    """
    halves = [_best(half)[0] for half in (rows[: len(rows) // 2], rows[len(rows) // 2 :])]
    return any(halves) and all(not half or abs(half - delay_s) <= _AGREE_S for half in halves)


def _said(slope, table):
    """What a table says of a `_slope`, without the names of columns; None if nothing."""
    (b, sigma, share) = slope
    (measured, clear, said) = table
    limits = [-np.inf, *said]
    high = next(limit for limit in said if said[limit] is None)
    low = limits[limits.index(high) - 1]
    sure = share >= clear and (b + _SURE * sigma <= low or b - _SURE * sigma > high)
    return f"{next(said[limit] for limit in said if b <= limit)}: {measured}" if sure else None


def _true_turn(rows):
    """How far the true yaw turns between rows, by the encoders, as a `_slope`."""
    step = rows.groupby("segment")[["t_s", "theta_rad"]].diff()
    step = step.assign(w=rows[_ENCODERS[1]] * step["t_s"]).dropna()
    steady = step["t_s"] < 2 * step["t_s"].median()
    step = step[steady & (step["theta_rad"].abs() < 3)]  # without silences and jumps of 2π
    return _slope(step[["w"]].to_numpy(), step["theta_rad"].to_numpy())


def refuse_nonsense(recording):
    """Say in a sentence what in a Recording cannot be what its log calls it.

    Raises:
        ValueError: for a robot that never moves, for wrong units, signs and axes. Positions that
            come late are a UserWarning that names the argument which makes up for that.
    """
    rows = recording.rows
    columns = recording.columns
    names = dict(zip(("speed", "yaw_rate", "yaw"), map(columns.get, [*_ENCODERS, "theta_rad"])))
    names["place"] = ", ".join(columns[name] for name in _POSITION)
    made = rows[_ENCODERS].mul(rows.groupby("segment")["t_s"].diff(), axis=0).cumsum()
    farthest = (made.max() - made.min()).max()
    if len(rows) >= _ROWS and farthest < _STILL:
        raise ValueError(
            f"the log's {names['speed']} and {names['yaw_rate']} should be of a robot that moves: "
            f"it drove and turned {farthest:.2g} m and rad at most"
        )
    delay_s, compared = _best(rows)
    if compared is None:
        return
    mu, kappa = compared
    found = [(mu, _MU), (kappa, _KAPPA)]
    if "theta_rad" in rows:
        truth = _true_turn(rows)
        found.append((truth, _TRUTH))
    for slope, table in found:
        said = _said(slope, table)
        if said and table is _KAPPA and kappa[0] < 0 and len(found) > 2:
            said = said.replace(_KAPPA[2][0.0], _MIRRORED[int(truth[0] > 0)])
        if said:
            raise ValueError("the log's " + said.format(times=slope[0], **names))
    if abs(delay_s) >= _LATE_S and _late_twice(rows, delay_s):
        late = f"{abs(delay_s):.2g} s {'later' if delay_s > 0 else 'earlier'}"
        warnings.warn(
            f"the log's {names['place']} come {late} than {names['speed']}, {names['yaw_rate']}; "
            f"position_delay_s={delay_s:.2f} makes up for that",
            stacklevel=3,
        )
