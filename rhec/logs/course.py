"""How far a yaw may be off, by what the course over ground says of it.

The estimators take the course for the yaw: their robot slips sideways only a little, and at once.
A robot on ice slips for seconds, and an estimator that is told no heading follows its course, sure
of a wrong yaw, with small innovations. What shows it is that the course turns where neither the
encoders nor a gyro do. With the course γ of a piece of the path in a frame that turns as the robot
does, and pieces of which every other one is compared, the side slip has at least the variance

    s² = ½ mean ((γ_k - γ_{k-1})² - noise),

which a robot without side slip has, too, up to `quiet_rad` by bumps and by errors of κ. A side slip
that lasts shows only in part, and the yaw drifts with it: factor² (s² - quiet²) is added to the
variance of the yaw. So is what the course is away from the estimated yaw, if that is more than a
robot's antenna and slip explain.

A side slip that stays the same all the time is not seen: without a heading nothing in a log tells
it from a yaw.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs.motion import MOVING
from rhec.simulation.columns import ACCEPTED, ESTIMATE, LEVER_ARM, MEASUREMENTS, SIGMA
from rhec.tracked_robot.sensors import GYRO

SIGMA_BY_COURSE = "sigma_by_course_rad"  # of a sample: what its yaw's σ has by the course
UNSURE_YAW_RAD = 0.25  # standard deviation of a yaw that is not known
_OFTEN = 0.1  # share of the samples
_SPEEDS = MEASUREMENTS[2:]


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived, on four robots' logs and on simulated ice.

    What they are for is tested with a side slip β that is known (tests/logs/test_course.py). One of
    deviation σ that lasts for a time τ shows as s² = σ² (1 - exp(-2 piece_s / τ)), and with these
    numbers 0.4 rad are in the σ of the yaw up to τ = 25 s, and 0.2 rad up to 10 s. Half of each
    fails there, and so does twice of `quiet_rad`, `noise` and `factor`.
    """

    # name: value  # [unit] meaning
    piece_s: float = 2.0  # [s] length of a piece of the path; every other one is compared
    least: float = 4.0  # [standard deviations of a position] a shorter piece has no course
    pieces: int = 100  # [1] over which is averaged; before a tenth of them nothing is said
    quiet_rad: float = 0.07  # [rad] of a course that swings without side slip
    noise: float = 1.5  # [1] of the positions, times its variance, which lengthens pieces, too
    factor: float = 3.5  # [1] of what swings more


TUNED = Tuned()
_ASIDE_RAD = np.pi / 4  # a yaw farther from the course is none of a robot that drives along it


def _turned(samples):
    """How far the robot has turned until each sample, by its gyro or its encoders and κ [rad]."""
    rate = samples[_SPEEDS[1]] * samples[ESTIMATE[5]]
    accepted = ACCEPTED[GYRO.name]
    hats = [unknown.hat for unknown in GYRO.unknowns]
    if accepted in samples and set(hats) <= set(samples):
        bias, scale = (samples[name] for name in hats)
        gyro = (samples[GYRO.column] - bias) / scale
        rate = gyro.where(samples[accepted] & gyro.notna(), rate)
    return paper.DT_S * np.cumsum(rate.fillna(0.0).to_numpy())


def _courses(samples, psi, sigma_m):
    """Courses of the pieces of a segment's path that have one, a DataFrame.

    Its index are the places of the samples at which the pieces end. `course` is a complex number of
    length 1, the direction of the piece in the frame that turns with the robot, `weight` the length
    of the piece, at most 1 [m], and `noise` the variance that the positions' noise gives it [rad²].
    """
    arm = samples.reindex(columns=LEVER_ARM).fillna(0.0).to_numpy() @ (1, 1j)
    speed = (samples[_SPEEDS[0]] * samples[ESTIMATE[4]]).fillna(0.0).to_numpy()
    middle = psi - np.diff(psi, prepend=psi[:1]) / 2
    # The way of the antenna that the tracks tell, from a yaw of 0 on.
    told = np.cumsum(paper.DT_S * speed * np.exp(1j * middle)) + arm * np.exp(1j * psi)
    place = samples[MEASUREMENTS[:2]].to_numpy() @ (1, 1j)
    end = np.flatnonzero((samples["position_accepted"] == 1) & np.isfinite(place))
    begin = _earlier(end, TUNED.piece_s)
    end = end[begin >= 0]
    begin = begin[begin >= 0]
    way = place[end] - place[begin]
    told = told[end] - told[begin]
    length = np.minimum(np.abs(way), np.abs(told))
    has_course = length > TUNED.least * sigma_m
    course = (way * told.conj())[has_course]
    length = length[has_course]
    return pd.DataFrame(
        dict(
            course=course / np.abs(course),
            weight=np.minimum(length, 1.0),
            # Noise of variance σ² at both ends turns a piece by 2 σ²/length².
            noise=2 * TUNED.noise * (sigma_m / length) ** 2,
        ),
        index=end[has_course],
    )


def _earlier(places, before_s):
    """For each of these samples the last one at least before_s earlier, or -1.

    It is -1, too, where that one is as much earlier once more.
    """
    n = round(before_s / paper.DT_S)
    at = np.searchsorted(places, places - n, side="right") - 1
    found = np.where(at >= 0, places[np.maximum(at, 0)], -1)
    return np.where(places - found < 2 * n, found, -1)


def _mean(values, weights, places, n):
    """Mean (n,) until each sample of values (k,) at these places, which forgets old ones."""
    sums = pd.DataFrame(dict(values=values * weights, weights=weights), index=places)
    sums = sums.ewm(alpha=1 / TUNED.pieces, min_periods=max(TUNED.pieces // 10, 1)).mean()
    return (sums["values"] / sums["weights"]).reindex(range(n)).ffill().fillna(0.0).to_numpy()


def yaw_sigma_rad(samples, sigma_m):
    """The standard deviation of the yaw at each sample of a segment by its course (n,) [rad].

    It is 0 for a course without doubt, and as long as there is none. Later samples do not count.

    Args:
        samples: DataFrame of one segment's samples.
        sigma_m: Standard deviation of the white noise of the positions [m].
    """
    psi = _turned(samples)
    pieces = _courses(samples, psi, sigma_m)
    before = _earlier(pieces.index.to_numpy(), 2 * TUNED.piece_s)
    now = pieces[before >= 0]
    before = pieces.loc[before[before >= 0]]
    change = np.angle(now["course"].to_numpy() * before["course"].to_numpy().conj())
    noise = now["noise"].to_numpy() + before["noise"].to_numpy()
    weight = np.minimum(now["weight"].to_numpy(), before["weight"].to_numpy())
    swing = _mean((change**2 - noise) / 2, weight, now.index, len(samples))
    yaw = (samples[ESTIMATE[2]].to_numpy() - psi)[pieces.index]
    away = np.angle(pieces["course"].to_numpy() * np.exp(-1j * yaw))
    away = _mean(away**2, pieces["weight"].to_numpy(), pieces.index, len(samples))
    variance = TUNED.factor**2 * np.maximum(swing - TUNED.quiet_rad**2, 0)
    return np.sqrt(variance + np.maximum(away - _ASIDE_RAD**2, 0))


def unknown_yaw(samples):
    """In which share of the drive the yaw is not known, and why, as a sentence; or None.

    Args:
        samples: DataFrame of a replay's samples.
    """
    moving = samples[samples[MEASUREMENTS[2]].abs() > MOVING]
    is_unsure = moving[SIGMA[2]] > UNSURE_YAW_RAD
    if not is_unsure.mean() > _OFTEN:
        return None
    by_course = (moving[SIGMA_BY_COURSE] > UNSURE_YAW_RAD)[is_unsure].mean() > 0.5
    why = "positions and encoders say little of it"
    if by_course:
        why = (
            "the course turns where encoders and gyro do not, or is not along the yaw: the robot "
            "slips sideways, positions wander, or a sensor is wrong"
        )
    told = "a heading" if by_course else "a gyro or a heading"
    return (
        f"The yaw is not known to {UNSURE_YAW_RAD} rad in {is_unsure.mean():.1%} of the drive, "
        f"because {why}; {told} in the log would tell it."
    )
