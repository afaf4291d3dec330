"""What a failing receiver, encoder or further sensor does to the measurements (x, y, ν, ω, …).

Not in the paper. Every kind of Fault does at most three things to a sample:

    source_s   the measurement that arrives is the one of an earlier time
    dead       the encoder of a track, or a further sensor, measures 0
    added      something is added: an offset, or NaN where nothing arrives

`_schedule` says what happens when; `corrupted` applies it to a recorded stream, `deliver` to the
closed loop, sample by sample. A run without faults does not import this module.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function
from rhec.simulation.faults import CHANNELS, PAST, memory_shapes, stream_shapes
from rhec.tracked_robot.sensors import rows_of_yaws

_DEAD_TRACKS = {"left": (1, 0), "right": (0, 1), "encoders": (1, 1)}
# A time that rounds to the start or end of a fault counts as that time.
_ROUNDING_S = 1e-6


class _Schedule(NamedTuple):
    """Effects of faults on samples taken at the times t_s (n,) [s], with m further sensors.

    Attributes:
        source_s: (n, 2 + m) when the position, the track speeds and the measurements of the further
            sensors that arrive were measured [s].
        stuck: (n, 2 + m) whether the last measurement is repeated instead.
        dead: (n, 2 + m) 1 where the left, the right encoder or a further sensor is dead.
        added: (n, 4 + m) offsets of (x, y, ν, ω, …).
    """

    source_s: np.ndarray
    stuck: np.ndarray
    dead: np.ndarray
    added: np.ndarray


def _schedule(faults, t_s, seed, sensors):
    """The _Schedule of faults at rising times t_s (n,) [s], of a robot with these `sensors`.

    The seed fixes the directions of outliers; the first rows do not depend on how many there are.
    """
    t_s = np.asarray(t_s, dtype=float)
    n = len(t_s)
    m = 2 + len(sensors)
    plan = _Schedule(
        np.tile(t_s[:, None], m),
        np.zeros((n, m), dtype=bool),
        np.zeros((n, m)),
        np.zeros((n, 2 + m)),
    )
    for number, fault in enumerate(faults):
        active = _active(fault, t_s)
        if fault.kind in ("outliers", "jump"):
            plan.added[:, :2] += active[:, None] * _offsets(fault, n, (seed, 2, number))
        elif fault.kind == "dead":
            plan.dead[active] = np.maximum(plan.dead[active], _dead(fault.channel, sensors))
        elif fault.kind in ("missing", "infinite", "rate"):
            _leave_out(plan, fault, t_s, active, sensors)
        elif fault.kind == "stuck":
            plan.stuck[:, _channels(fault.channel, sensors)] |= active[:, None]
        else:
            _delay(plan, fault, t_s, active, sensors)
    # A stuck sample repeats the last one before it that was not.
    last = np.maximum.accumulate(np.where(plan.stuck, 0, np.arange(n)[:, None]), axis=0)
    return plan._replace(source_s=np.take_along_axis(plan.source_s, last, axis=0))


def _channels(channel, sensors):
    """Columns of `source_s` that a channel stands for."""
    if channel in sensors:
        return (2 + sensors.index(channel),)
    further = tuple(range(2, 2 + len(sensors))) if channel == "all" else ()
    return (*CHANNELS.get(channel, ()), *further)


def _dead(channel, sensors):
    """1 for the left track, the right track and each sensor that a dead channel stands for."""
    tracks = _DEAD_TRACKS.get(channel, (0, 0))
    return np.array([*tracks, *(name == channel for name in sensors)], dtype=float)


def _active(fault, t_s):
    """Whether each of the times t_s (n,) lies in the fault's interval."""
    return (t_s > fault.start_s - _ROUNDING_S) & (t_s < fault.end_s - _ROUNDING_S)


def _offsets(fault, n, seed):
    """Offsets (n, 2) [m] of outliers, or of a jump: all the same."""
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    angle = generator.uniform(0, 2 * np.pi, n)
    if fault.kind == "jump":
        angle = np.full(n, angle[:1])
    return fault.size_m * np.column_stack([np.cos(angle), np.sin(angle)])


def _leave_out(plan, fault, t_s, active, sensors):
    """Measurements that do not arrive, or are infinite."""
    value = np.inf if fault.kind == "infinite" else np.nan
    if fault.kind == "rate":
        # How many measurements are due by now; one arrives where this number rises.
        due = np.floor((t_s - fault.start_s) * fault.rate_hz + _ROUNDING_S)
        is_first = np.cumsum(active) == 1
        active = active & (np.diff(due, prepend=-1.0) < 1) & ~is_first
    for channel in _channels(fault.channel, sensors):
        plan.added[active, _entries(channel)] += value


def _entries(channel):
    """Entries of z that a column of `source_s` is for: two for each of the first two columns."""
    first = 2 * channel if channel < 2 else 2 + channel
    return slice(first, first + (2 if channel < 2 else 1))


def _delay(plan, fault, t_s, active, sensors):
    """Measurements that arrive late: once more, in the wrong order, or by a latency."""
    sample = np.arange(len(t_s))
    is_odd = (np.cumsum(active) - 1) % 2  # every other sample since the fault began
    if fault.kind == "duplicates":
        measured_s = t_s[np.maximum(sample - is_odd, 0)]
    elif fault.kind == "disorder":
        measured_s = t_s[np.maximum(sample - 2 * is_odd, 0)]
    else:
        measured_s = t_s - fault.delay_s
    for channel in _channels(fault.channel, sensors):
        # Nothing was measured before the first sample, and faults before this one delay, too.
        late = np.minimum(plan.source_s[:, channel], np.maximum(measured_s, t_s[:1]))
        plan.source_s[:, channel] = np.where(active, late, plan.source_s[:, channel])


def _without_dead_tracks(nu, omega, dead, track_width_m):
    """ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b, where encoders with dead = 1 measure 0."""
    left = dead[0] * (nu - omega * track_width_m / 2)
    right = dead[1] * (nu + omega * track_width_m / 2)
    return nu - (left + right) / 2, omega - (right - left) / track_width_m


def corrupted(z, faults, t_s, track_width_m, seed, sensors):
    """A recorded stream of measurements z (n, 4 + m) as it arrives with faults, (n, 4 + m).

    z = (x, y, ν, ω, …), with the m further `sensors` of the robot, is linear between its rising
    times t_s (n,) [s]. The seed fixes the directions of outliers.
    """
    z = np.array(z, dtype=float)
    for row in rows_of_yaws(sensors):
        is_number = np.isfinite(z[:, row])
        z[is_number, row] = np.unwrap(z[is_number, row])
    plan = _schedule(faults, t_s, seed, sensors)
    for channel, source_s in enumerate(plan.source_s.T):
        z[:, _entries(channel)] = _interpolated(source_s, t_s, z[:, _entries(channel)])
    z[:, 2:4] = np.column_stack(_without_dead_tracks(*z[:, 2:4].T, plan.dead.T, track_width_m))
    z[:, 4:] = np.where(plan.dead[:, 2:] == 1, 0.0, z[:, 4:])
    return z + plan.added


def _interpolated(at_s, t_s, columns):
    return np.column_stack([np.interp(at_s, t_s, column) for column in columns.T])


class FaultStream(NamedTuple):
    """How a loop draws the rows of `stream`, of a robot with these further sensors."""

    sensors: tuple
    dt_s: float

    def __call__(self, seed, samples, faults=()):
        """The rows of `stream`."""
        return stream(faults, samples, self.dt_s, seed, self.sensors)


def stream(faults, samples, dt_s, seed, sensors):
    """The schedule as the closed loop reads it, (samples, n): rows of `stream_shapes`, ages in
    samples, of a robot with these further `sensors`.
    """
    t_s = np.arange(samples) * dt_s
    plan = _schedule(faults, t_s, seed, sensors)
    age = (t_s[:, None] - plan.source_s) / dt_s
    hold = np.diff(plan.source_s, axis=0, prepend=np.nan) == 0
    return np.hstack([age, hold, plan.dead, plan.added])


def deliver(n_sensors):
    """The Function (z, past, held, age, hold, dead, added) -> (z, past, held) of one sample.

    The measurement z (4 + n_sensors,) becomes the one that arrives. past (4 + n_sensors, PAST)
    holds the measurements before it, the newest first. Where `hold` is 1 the last one delivered is
    delivered again.
    """
    shapes = memory_shapes(n_sensors) | stream_shapes(n_sensors)
    rows = [_entries(channel) for channel in range(2 + n_sensors)]

    @casadi_function("deliver", z=(4 + n_sensors, 1), **shapes, track_width_m=(1, 1))
    def deliver(z, past, held, age, hold, dead, added, track_width_m):
        newest_first = ca.horzcat(z, past)
        ages = ca.DM(range(PAST + 1))
        # Weights that interpolate linearly between the two samples around each age.
        weights = [ca.fmax(1 - ca.fabs(channel - ages), 0) for channel in ca.vertsplit(age)]
        source = ca.vertcat(*(newest_first[row, :] @ w for row, w in zip(rows, weights)))
        holds = ca.vertcat(hold[0], hold[0], hold[1], hold[1], hold[2:])
        source = ca.if_else(holds, held, source)
        encoders = _without_dead_tracks(source[2], source[3], dead, track_width_m)
        others = ca.if_else(dead[2:], 0, source[4:])
        z = ca.vertcat(source[:2], *encoders, others) + added
        return dict(z=z, past=newest_first[:, :PAST], held=source)

    return deliver
