"""Robust handling of measurements: consistency checks and innovation gating. Not in the paper.

Each measurement in the window of an RHE has its own variance. It follows from what the sensors
say of one another, never from the estimate alone:

- *Noise*: the variance of positions is that of their second differences where this is clearly
  larger than the one told. Positions more scattered than noise can be count the less the farther
  they are from the prediction.
- *Stuck or improbable positions* are rejected. A receiver is stuck where it repeats its last
  position to the last digit. A position is improbable where its innovation y has
  y' S⁻¹ y > CHI2_GATE (Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and
  Navigation", 2001, Sec. 5.7), unless it follows smoothly on an accepted one.
- *Inconsistent encoders*: the path by the encoders is registered with the last positions, turned
  and scaled for the best fit (Kabsch, 1976). Where the positions are smooth and do not fit, the
  encoders are inconsistent until both agree again. Meanwhile the speed between positions replaces
  theirs. With `speed_model="parameter"` a jump of the encoders is inconsistent at once.
- *A gyro* is left out while it is absurd, stuck, dead or opposite to the tracks (`gyro_check`).
- *Restart*: where both agree, and the estimate has another yaw, or another position for long, the
  estimate is wrong, and its window restarts.

The estimator gets variances, not their reasons.
"""

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, packed_size, unpack
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import guard
from rhec.core.model.limits import MAX_MEASUREMENT, is_valid_measurement
from rhec.tracked_robot import gyro_check
from rhec.tracked_robot.sensors import GYRO, OUTPUTS
from rhec.tracked_robot.slipping import LEVER_ARM


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived.

    They were chosen on softer soil than the default world's, of a mean κ of 0.8
    (notebooks/further/faults.ipynb, which judges them on seeds 0 to 9); on which seeds is not
    recorded.
    """

    # name: value  # [unit] meaning
    chi2_gate: float = 13.8  # [1] two degrees of freedom: exceeded once in a thousand good ones

    # Noise of positions
    past: int = 13  # [samples] from which it is estimated
    noises_to_learn: float = 3.0  # [1] times the told noise, an estimate of so few samples counts
    largest_learned_m: float = 0.1  # [m] of x and of y; more than this are outliers, or a wrong yaw
    forgetting: float = 0.98  # [1] per sample, of the largest noise of late

    # Positions and encoders
    checked: int = 6  # [samples] over which they are compared
    max_bend_m: float = 0.25  # [m] second difference of positions that are still smooth
    max_bend_noises: float = 60.0  # [1] its square over the noise: 4.5 standard deviations
    max_checked_sigma_m: float = 0.045  # [m] noisier positions tell too little about the encoders
    late_s: float = 0.15  # [s] how far positions and encoders may be out of step
    noises_apart: float = 2.5  # [1] tolerated mean square distance of the paths, over the noise's
    share_apart: float = 0.15  # [1] tolerated rms distance of the two paths, over their size
    least_apart_m: float = 0.05  # [m] tolerated rms distance of the paths, such as after a spin
    least_traction: float = 0.4  # [1] of the distance by positions over that by encoders
    largest_traction: float = 1.1  # [1] of the same
    max_other_scale: float = 0.2  # [1] between that ratio and the estimated traction
    least_kappa: float = 0.3  # [1] by which the path by encoders turns

    # Encoders that are inconsistent
    sigma_jump_mps: float = 0.1  # [m/s] of the change of ν in one sample
    sigma_jump_radps: float = 0.3  # [rad/s] of the change of ω in one sample
    sigma_nu_mps: float = 0.15  # [m/s] of ν by positions, which replaces theirs
    sigma_omega_radps: float = 1.0  # [rad/s] of ω = 0, which replaces theirs
    least_way_noises: float = 14.0  # [1] square of a way over the noise: once in a thousand of a
    # standing robot

    # Positions that are probable
    dead_reckoning: float = 0.06  # [m/m] its error by the distance since the last accepted position
    reach_m: float = 3.0  # [m] an unchecked position farther off than this, and than
    reach_mps: float = 5.0  # [m/s] this speed explains, is an outlier
    # Scattered positions, noisier than can be learned, get a variance that grows with their
    # distance from the prediction: at once from the gate on, and after so long from so many times
    # it on. By then dead reckoning may be that far off, too.
    storm_s: float = 6.0  # [s]
    far_in_long_storm: float = 20.0  # [1]

    # Restart
    min_course_m: float = 0.1  # [m] rms size of a path below which it does not determine the yaw
    min_course_noises: float = 3.2  # [1] its square over the noise: the course is known to 0.15 rad
    min_heading_cosine: float = 0.7  # [1] course and yaw contradict each other beyond 45°
    mismatches: int = 5  # [samples] in a row in which they do, and the window restarts
    # A gyro or a heading holds the yaw where the robot slips sideways, which the course does not
    # show.
    mismatches_with_sensors: int = 25  # [samples] the same with a gyro or a heading
    max_rejection_s: float = 12.0  # [s] positions and encoders are rejected for at most this long


TUNED = Tuned()
_MAX_CHECKED_NOISE = 2 * TUNED.max_checked_sigma_m**2
# Of quantities at a restart, in their units; tuned, too.
SIGMA_RESTART = dict(x_m=0.05, y_m=0.05, theta_rad=0.15, nu_mps=0.05)
SIGMA_RESTART |= dict(gyro_bias_radps=0.02, gyro_scale=0.02)
_SIGMA_RESTART_OTHERS = 0.1
_NONE = ca.DM.nan(2)  # a pair of measurements that is missing


class _Before(NamedTuple):
    """The memory of the checks."""

    past: ca.SX  # (4, past) positions, NaN where missing, with the encoders' of these samples
    last: ca.SX  # (4,) the last position, and the encoder measurements last accepted
    since: ca.SX  # (2,) samples since a smooth position was accepted, and since encoders were
    contradicted: ca.SX  # how often in a row the course has contradicted the yaw
    doubt: ca.SX  # 1 while the encoders are inconsistent
    unseen: ca.SX  # (2,) samples since a position was accepted, and since one arrived
    largest: ca.SX  # [m²] the largest noise of late
    storm: ca.SX  # samples in a row in which positions have been too scattered for noise
    gyro_last: ca.SX  # [rad/s] the last measurement of the gyro
    gyro_turns: ca.SX  # (3,) the rest of a `gyro_check.Gyro`


_SHAPES = ((4, TUNED.past), (4, 1), (2, 1), (1, 1), (1, 1), (2, 1), (1, 1), (1, 1), (1, 1), (3, 1))
_NAN_AT_FIRST = ("past", "last", "gyro_last")
_MEMORY = dict(zip(_Before._fields, _SHAPES))


def _is_number(x):
    return is_valid_measurement(x, MAX_MEASUREMENT**2)


class _Sample(NamedTuple):
    """One measurement z, as far as its sensors deliver it."""

    has_gnss: ca.SX
    has_encoders: ca.SX
    has_position: ca.SX  # GNSS that is not stuck
    position: ca.SX  # (2,), NaN where there is none
    speeds_held: ca.SX  # (2,) (ν, ω), the last ones where encoders are silent
    past: ca.SX  # (4, past + 1) positions and speeds up to now

    @property
    def checked(self):
        """The columns of `past` over which positions and encoders are compared."""
        return self.past[:, -TUNED.checked - 1 :]


def _sample(z, limits, past, last):
    valid = [is_valid_measurement(z[row], limits[row]) for row in range(4)]
    has_gnss = valid[0] * valid[1]
    has_encoders = valid[2] * valid[3]
    has_position = has_gnss * (1 - (z[0] == last[0]) * (z[1] == last[1]))
    previous = ca.if_else(_is_number(past[2:, -1]), past[2:, -1], 0)
    speeds_held = ca.if_else(has_encoders, z[2:4], previous)
    position = ca.if_else(has_position, z[:2], _NONE)
    past = ca.horzcat(past, ca.vertcat(position, speeds_held))
    return _Sample(has_gnss, has_encoders, has_position, position, speeds_held, past)


def _turned_by_gyro(sample, gyro, m, names):
    """The _Sample with yaw rates over ground [rad/s] in place of those of the encoders.

    That is (gyro - β) / s, or κω where the gyro has no measurement.
    """
    bias, scale = (m[names.index(name)] for name in GYRO)
    by_encoders = m[names.index("kappa")] * sample.speeds_held[1]
    rate = ca.if_else(_is_number(gyro), (gyro - bias) / scale, by_encoders)
    past = ca.vertcat(sample.past[:3, :], ca.horzcat(sample.past[3, :-1], rate))
    return sample._replace(past=past)


def _without_bad_gyro(others, omega, names, before):
    """The measurements of gyro and heading, NaN for a gyro that is left out, and the memory."""
    if not set(GYRO) <= set(names):
        return others, before
    remembered = gyro_check.Gyro(before.gyro_last, *ca.vertsplit(before.gyro_turns))
    gyro, after = gyro_check.checked(others[0], omega, remembered)
    before = before._replace(gyro_last=after.last, gyro_turns=ca.vertcat(*after[1:]))
    return ca.vertcat(gyro, *ca.vertsplit(others)[1:]), before


class _Positions(NamedTuple):
    """What the positions tell without the encoders."""

    can_check: ca.SX  # 1 where none of the checked ones is missing, and their noise is low
    are_smooth: ca.SX  # 1 where none of the checked ones is missing or jumps
    newest_is_smooth: ca.SX
    noise: ca.SX  # [m²] variance of x and y together
    largest: ca.SX  # [m²] the largest one of late
    scatter: ca.SX  # [m²] the noise, where it is more than can be learned, else 0
    V: ca.SX  # (2,) [m²] variances to use


def _check_positions(past, V, largest):
    bend = past[:2, 2:] - 2 * past[:2, 1:-1] + past[:2, :-2]
    bends = ca.sum1(bend * bend)
    told = V[0] + V[1]
    noise = _noise_of_positions(bends)
    # A noise that is known too low would find fault with the encoders: it is forgotten slowly.
    largest = ca.fmin(ca.fmax(noise, TUNED.forgetting * largest), 4 * _MAX_CHECKED_NOISE)
    checked = ca.fmax(ca.fmax(told, noise), largest)
    largest_learned = 2 * TUNED.largest_learned_m**2
    learned = ca.fmax(ca.fmin(noise, largest_learned), told)
    used = ca.if_else(noise > TUNED.noises_to_learn * told, learned, told)
    learnable = TUNED.noises_to_learn * ca.fmax(told, largest_learned)
    max_bend = ca.fmax(TUNED.max_bend_m**2, TUNED.max_bend_noises * checked)
    are_dense = ca.mmin(_is_number(bends[1 - TUNED.checked :]))
    return _Positions(
        can_check=are_dense * (checked <= _MAX_CHECKED_NOISE),
        are_smooth=ca.mmin(bends[1 - TUNED.checked :] <= max_bend),
        newest_is_smooth=bends[-1] <= max_bend,
        noise=checked,
        largest=largest,
        scatter=ca.if_else(noise > learnable, noise, 0),
        V=V[:2] * (used / told),  # the same bits where nothing is learned
    )


def _noise_of_positions(bends):
    """Variance of positions, x and y together, from their squared second differences.

    White noise of variance σ² has second differences of 6σ² (von Neumann, 1941). The result is the
    smallest one of three parts, so that neither an outlier nor a jump, which show in three
    neighbouring differences, is taken for noise; 0 where data are missing.
    """
    parts = []
    third = bends.numel() // 3
    for part in ca.horzsplit(bends, [0, third, 2 * third, bends.numel()]):
        n = ca.sum2(_is_number(part))
        mean = ca.sum2(ca.if_else(_is_number(part), part, 0)) / ca.fmax(n, 1)
        parts.append(ca.if_else(n >= 3, mean / 6, 0))
    return ca.fmin(ca.fmin(parts[0], parts[1]), parts[2])


class _Agreement(NamedTuple):
    """How the path by the encoders fits the positions."""

    agree: ca.SX  # 1 where it does; never where the positions are not smooth
    contradict: ca.SX  # 1 where it does not, though the positions are smooth
    has_other_scale: ca.SX  # 1 where they agree with another traction than the estimated one
    yaw: ca.SX  # [rad] by which the path is turned: the yaw that the positions show
    has_course: ca.SX  # 1 where the path is long enough to determine the yaw


def _check_agreement(path, positions, m, names, dt_s):
    """Register the path by the encoders with the positions, both in `path` (4, checked + 1)."""
    arm = [m[names.index(name)] if name in names else 0 for name in LEVER_ARM]
    kappa = ca.fmin(ca.fmax(m[names.index("kappa")], TUNED.least_kappa), 1)
    if set(GYRO) <= set(names):
        kappa = 1  # the path has the yaw rates over ground
    driven = _dead_reckoned(path, arm, kappa, dt_s)
    yaw, mu, apart, size, size_driven = _registration(path[:2, :], driven)
    speed = ca.sumsqr(driven[:, 1:] - driven[:, :-1]) / (TUNED.checked * dt_s**2)
    tolerance = TUNED.noises_apart * positions.noise + TUNED.share_apart**2 * size
    tolerance += (2 * TUNED.late_s) ** 2 * speed
    tolerance += TUNED.least_apart_m**2
    fits = apart <= tolerance  # 0 where `apart` is NaN
    agree = positions.are_smooth * fits
    has_course = size_driven > ca.fmax(
        TUNED.min_course_m**2, TUNED.min_course_noises * positions.noise
    )
    is_apart = ca.fabs(mu - m[names.index("mu")]) > TUNED.max_other_scale
    return _Agreement(
        agree=agree,
        contradict=positions.can_check * positions.are_smooth * _is_number(apart) * (1 - fits),
        has_other_scale=agree * has_course * positions.can_check * is_apart,
        yaw=yaw,
        has_course=has_course,
    )


def _dead_reckoned(past, arm, kappa, dt_s):
    """Places (2, n) of the antenna by the encoders' `past` (4, n), seen from the newest pose."""
    places = [ca.SX.zeros(2)]
    yaw = 0
    for k in reversed(range(1, past.size2())):
        turn = kappa * past[3, k] * dt_s
        ahead = dt_s * past[2, k] - turn * arm[1]
        left = turn * arm[0]
        cos = ca.cos(yaw - turn / 2)
        sin = ca.sin(yaw - turn / 2)
        places.append(places[-1] - ca.vertcat(cos * ahead - sin * left, sin * ahead + cos * left))
        yaw = yaw - turn
    return ca.horzcat(*reversed(places))


def _registration(q, e):
    """Turn and scale the path e (2, n) for the best fit with the positions q (2, n), both centred.

    The results are the angle of the turn [rad], the scale, the mean square distance that is left,
    and the mean squares of q and e, all [m²].
    """
    q, e = (path - ca.repmat(ca.sum2(path) / path.size2(), 1, path.size2()) for path in (q, e))
    dot = ca.sum2(ca.sum1(q * e))
    cross = ca.sum2(q[1, :] * e[0, :] - q[0, :] * e[1, :])
    fit = ca.sqrt(dot**2 + cross**2)
    sizes = (ca.sumsqr(q), ca.sumsqr(e))
    mu = ca.fmin(
        ca.fmax(fit / ca.fmax(sizes[1], 1e-9), TUNED.least_traction), TUNED.largest_traction
    )
    apart = sizes[0] - 2 * mu * fit + mu**2 * sizes[1]
    return ca.atan2(cross, dot), mu, *(square / q.size2() for square in (apart, *sizes))


def _are_encoders_inconsistent(z, before, agreement, names, may_reject):
    """1 from a contradiction, or a jump, until positions and encoders agree again."""
    sigma = ca.DM([TUNED.sigma_jump_mps, TUNED.sigma_jump_radps])
    # Without a last measurement the change is NaN, which is no jump.
    change = ca.sumsqr((z[2:4] - before.last[2:]) / sigma)
    jump = change > TUNED.chi2_gate if "nu_mps" in names else 0
    # A path of dead encoders may fit, at another scale than that of the estimated traction.
    cleared = agreement.agree * (1 - agreement.has_other_scale)
    stays = ca.logic_or(jump, before.doubt * (1 - cleared)) * may_reject
    return ca.logic_or(agreement.contradict, stays)


def _speeds_by_positions(path, m, noise, names, dt_s):
    """(ν, 0) [m/s, rad/s] of the tracks, from the first and the last position of a path.

    A way that is no longer than the `noise` [m²] of the positions is that of a standing robot.
    """
    way = path[:2, -1] - path[:2, 0]
    way = ca.if_else(ca.sumsqr(way) > TUNED.least_way_noises * noise, way, 0)
    sign = ca.if_else(ca.cos(m[2]) * way[0] + ca.sin(m[2]) * way[1] < 0, -1, 1)
    mu = ca.fmax(m[names.index("mu")], TUNED.least_traction)
    return ca.vertcat(sign * ca.norm_2(way) / (TUNED.checked * dt_s * mu), 0)


def _distance(y, yaw, P, V, nu, drift):
    """Squared distance y' S⁻¹ y of the innovation gating, over that of the gate.

    S is the covariance of the innovation y (2,): that of prediction P and measurement V, of being
    out of step at speed ν, and of the drift [m] of dead reckoning.
    """
    late = TUNED.late_s * ca.fabs(nu) * ca.vertcat(ca.cos(yaw), ca.sin(yaw))
    S = P[:2, :2] + ca.diag(V) + late @ late.T + drift**2 * ca.SX.eye(2)
    return ca.bilin(ca.inv_minor(S), y, y) / TUNED.chi2_gate


def _doubt(far, positions, storm_s):
    """Factor of the variance of a position `far` from its prediction.

    It is that of Cauchy's weights, but no larger than what the scatter of the positions shows. Thus
    smooth positions keep their weight where dead encoders have led the prediction astray.
    """
    far = far / ca.if_else(storm_s < TUNED.storm_s, 1, TUNED.far_in_long_storm)
    scatter = positions.scatter / ca.sum1(positions.V)
    return ca.fmax(ca.fmin(far, scatter), 1)


def _are_positions_better(agreement):
    """Whether smooth positions contradict the encoders, or their scale."""
    return ca.logic_or(agreement.contradict, agreement.has_other_scale)


def _is_within_reach(y, step, P, V, unseen_s):
    """Whether a position that nothing checks is where a robot with failed encoders may be.

    Its innovation y, or its step from the last position, is no longer than the way a robot goes
    since the last accepted position, or since the last one, `unseen_s` (2,) [s], and the noise.
    """
    noise = ca.trace(P[:2, :2]) + V[0] + V[1]
    within = [
        ca.sumsqr(way) <= (TUNED.reach_m + TUNED.reach_mps * time_s) ** 2 + TUNED.chi2_gate * noise
        for way, time_s in zip((y, step), ca.vertsplit(unseen_s))
    ]
    return ca.logic_or(*within)


def _check(z, limits, memory, predict, V, names, first, dt_s):
    """Check one measurement z (n_z,) against `limits`, earlier ones and the prediction.

    Of the entries after the first four, those of gyro and heading, only that of the gyro is
    checked.

    `predict` is (z, V) -> mean (n,) and covariance (n, n) of the joint state `names`, by the
    encoders in z; `first` is 1 before any measurement. The results by name: which measurements are
    `accepted`; `z_used` and `V_used`; whether to `restart` and at which `pose`; whether to
    `replace` inconsistent measurements in the window, and what they are `replaced` by; the memory
    after, `gate_after`.
    """
    before = _Before(*memory.values())
    may_reject = before.since * dt_s < TUNED.max_rejection_s
    sample = _sample(z, limits, before.past, before.last)
    positions = _check_positions(sample.past, V, before.largest)

    # Gyro and heading are the entries of z after the first four.
    others, before = _without_bad_gyro(z[4:], sample.speeds_held[1], names, before)
    encoders = ca.if_else(sample.has_encoders, z[2:4], _NONE)
    m, _ = predict(ca.vertcat(sample.position, encoders, others), V)
    if set(GYRO) <= set(names):
        sample = _turned_by_gyro(sample, others[[*OUTPUTS].index("gyro")], m, names)
    agreement = _check_agreement(sample.checked, positions, m, names, dt_s)
    inconsistent = _are_encoders_inconsistent(z, before, agreement, names, may_reject[1])
    speeds, V_speeds = _speeds(z, V, sample, positions, inconsistent, m, names, dt_s)
    V_used = ca.vertcat(positions.V, V_speeds, V[4:])

    m, P = predict(ca.vertcat(sample.position, speeds, others), V_used)
    is_usable, far = _is_usable(z, sample, positions, agreement, before, m, P, dt_s)
    is_doubted = (1 - first) * (1 - _are_positions_better(agreement))
    V_used[:2] *= ca.if_else(is_doubted, _doubt(far, positions, before.storm * dt_s), 1)
    position = sample.has_position * ca.logic_or(first, is_usable)
    most = TUNED.mismatches_with_sensors if others.numel() else TUNED.mismatches
    judged = _check_estimate(agreement, before.contradicted, most, m[2], position, may_reject[0])
    contradicted, restart, yaw = judged
    encoders = sample.has_encoders * (1 - inconsistent)
    accepted = ca.logic_or(position, restart)
    after = _remember(z, sample, positions, before, accepted, restart, encoders)
    after = after._replace(contradicted=contradicted, doubt=inconsistent)
    return dict(
        accepted=ca.vertcat(accepted, accepted, encoders, encoders),
        z_used=ca.vertcat(ca.if_else(accepted, z[:2], _NONE), speeds, others),
        V_used=V_used,
        restart=restart,
        pose=ca.vertcat(z[:2], yaw),
        replace=agreement.contradict,
        replaced=ca.vertcat(sample.checked[:2, 1:], ca.repmat(speeds, 1, TUNED.checked)),
        gate_after=ca.veccat(*after),
    )


def _speeds(z, V, sample, positions, inconsistent, m, names, dt_s):
    """(ν, ω) to use and their variances: the encoders', or while inconsistent the positions'."""
    by_positions = _speeds_by_positions(sample.checked, m, positions.noise, names, dt_s)
    by_positions = ca.if_else(inconsistent * positions.are_smooth, by_positions, _NONE)
    is_replaced = sample.has_encoders * inconsistent
    is_used = sample.has_encoders * (1 - inconsistent)
    by_positions = ca.if_else(is_replaced, by_positions, _NONE)
    V_speeds = ca.if_else(
        is_replaced, ca.DM([TUNED.sigma_nu_mps, TUNED.sigma_omega_radps]) ** 2, V[2:4]
    )
    return ca.if_else(is_used, z[2:4], by_positions), V_speeds


def _is_usable(z, sample, positions, agreement, before, m, P, dt_s):
    """Whether a position follows smoothly on an accepted one, is probable, or within reach.

    The second result is its distance from the prediction, as by `_distance`.
    """
    y = z[:2] - m[:2]
    nu = sample.speeds_held[0]
    drift = TUNED.dead_reckoning * ca.fabs(nu) * dt_s * before.since[0] * agreement.agree
    far = _distance(y, m[2], P, positions.V, nu, drift)
    probable = far <= 1
    step = z[:2] - before.last[:2]
    within_reach = _is_within_reach(y, step, P, positions.V, before.unseen * dt_s)
    probable = ca.if_else(positions.can_check, probable, ca.logic_or(probable, within_reach))
    was_accepted = before.unseen[0] == before.unseen[1]
    better = _are_positions_better(agreement)
    follows = ca.logic_or(better, was_accepted * positions.newest_is_smooth)
    return ca.logic_or(probable, follows), far


def _remember(z, sample, positions, before, accepted, restart, encoders):
    """The memory after a sample with this position and these encoders accepted."""
    trusted = ca.logic_or(accepted * positions.are_smooth, restart)
    last = ca.vertcat(
        ca.if_else(sample.has_gnss, z[:2], before.last[:2]),
        ca.if_else(encoders, z[2:4], before.last[2:]),
    )
    return before._replace(
        past=sample.past[:, 1:],
        last=last,
        since=ca.if_else(ca.vertcat(trusted, encoders), 0, before.since + 1),
        unseen=ca.if_else(ca.vertcat(accepted, sample.has_gnss), 1, before.unseen + 1),
        largest=positions.largest,
        storm=ca.if_else(positions.scatter > 0, before.storm + 1, 0),
    )


def _check_estimate(agreement, contradicted, most, yaw, position, may_reject):
    """Where the sensors agree and the estimate contradicts them `most` times in a row, restart.

    The results are how often in a row the course has contradicted the yaw, whether to restart, and
    with which yaw [rad].
    """
    is_apart = ca.cos(agreement.yaw - yaw) < TUNED.min_heading_cosine
    mismatch = agreement.agree * agreement.has_course * is_apart
    contradicted = ca.if_else(mismatch, contradicted + 1, 0)
    restart = ca.logic_or(contradicted >= most, agreement.agree * (1 - position) * (1 - may_reject))
    # The yaw is not wrapped: choose the full turns that are nearest to the estimate.
    turns = ca.floor((agreement.yaw - yaw) / (2 * ca.pi) + 0.5)
    nearest = agreement.yaw - 2 * ca.pi * turns
    yaw = ca.if_else(agreement.has_course, nearest, yaw)
    return ca.if_else(restart, 0, contradicted), restart, yaw


@dataclass(frozen=True)
class RobustHandling(guard.Judge):
    """The judge that weighs each measurement, replaces inconsistent encoders, and restarts.

    `accepted` (4,) tells which of x, y, ν and ω are used.
    """

    weighs = True

    def memory(self, window):
        """The _Before, packed."""
        return dict(gate=(packed_size(_MEMORY), 1))

    def first(self, window):
        """Nothing is known."""
        first = {
            name: np.full(shape, np.nan if name in _NAN_AT_FIRST else 0.0)
            for name, shape in _MEMORY.items()
        }
        return dict(gate=pack_array(first))

    def build(self, window):
        """The Function that checks the newest measurement."""
        names = window.model.joint_names
        limits = window.model.limits
        shapes = window.prediction | window.noise | self.memory(window)
        shapes |= dict(z_N=(len(limits), 1), age=(1, 1))

        @casadi_function("robust_check", ca.SX, **shapes)
        def check(B_N, v_N, m_N, P_N, z_N, V, age, gate, **others):
            def predict(z, V):
                return window.predict_input(B_N, m_N, P_N, v_N, z, V=V, **others)

            before = unpack(gate, _MEMORY)
            return _check(z_N, limits, before, predict, V, names, age < 1, window.dt_s)

        return check

    def build_restarted(self, window):
        """Replace inconsistent encoders in the window, or restart it at a pose.

        A restart keeps the present speed and traction.
        """
        names = window.model.joint_names
        N = window.N
        newest = min(TUNED.checked, N)
        n_z = len(window.model.outputs)
        V_window = guard.noise_memory(window)["V_window"]
        shapes = window.pieces._asdict() | dict(V_window=V_window)
        shapes |= dict(goes_on=(1, 1), pose=(3, 1), replace=(1, 1), replaced=(4, TUNED.checked))
        shapes |= dict(z_used=(n_z, 1), V_used=(n_z, 1))
        P = ca.diag(np.square([SIGMA_RESTART.get(name, _SIGMA_RESTART_OTHERS) for name in names]))

        @casadi_function("restarted", ca.SX, **shapes)
        def restarted(goes_on, pose, replace, replaced, z_used, V_used, **memory):
            z = ca.vertcat(replaced[:, -newest:], memory["z"][4:, -newest:])
            replacements = dict(z=z, V_window=ca.repmat(V_used, 1, newest))
            for name, latest in replacements.items():
                with_latest = ca.horzcat(memory[name][:, :-newest], latest)
                memory[name] = ca.if_else(replace, with_latest, memory[name])
            s = ca.vertcat(pose, memory["s"][3:, N])
            for place, (lowest, highest) in window.interval.bounds.items():
                s[place] = ca.fmin(ca.fmax(s[place], lowest), highest)
            fresh = guard.fresh(window, memory, s, z_used, s, P)
            return {name: ca.if_else(goes_on, memory[name], fresh[name]) for name in memory}

        return restarted
