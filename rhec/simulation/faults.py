"""Sensor faults: what a failing receiver or encoder does to the measurements z = (x, y, ν, ω).

Not in the paper. Every kind of fault does at most three things to a sample:

    source_s   the measurement that arrives is the one of an earlier time
    dead       the encoder of a track measures 0
    added      something is added: an offset, or NaN where nothing arrives

`_schedule` says what happens when; `corrupted` applies it to a recorded stream, `deliver` to the
closed loop, sample by sample.
"""

from dataclasses import fields
from typing import Annotated, Literal, NamedTuple

import casadi as ca
import numpy as np
from pydantic import Field

from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.validation import NotNegative, Positive, Real
from rhec.simulation.validated import validated

__all__ = [
    "CHANNELS",
    "DELAY_MAX_S",
    "Fault",
    "KINDS",
    "MEMORY",
    "OWN_CHANNELS",
    "SIZES",
    "STREAM",
    "as_python",
    "corrupted",
    "deliver",
    "init",
    "stream",
]

_PAST = 5  # earlier measurements that the closed loop stores
DELAY_MAX_S = 1.0
KINDS = (
    "missing",
    "infinite",
    "outliers",
    "jump",
    "stuck",
    "duplicates",
    "disorder",
    "latency",
    "rate",
    "dead",
)
# The argument that a kind needs; every other kind must leave it out.
SIZES = {"jump": "size_m", "outliers": "size_m", "latency": "delay_s", "rate": "rate_hz"}
# Columns of source_s that a channel stands for: 0 is the position, 1 are the track speeds.
CHANNELS = {"gnss": (0,), "encoders": (1,), "all": (0, 1)}
# Channels of the kinds that cannot be on each of these
OWN_CHANNELS = {"outliers": ("gnss",), "jump": ("gnss",), "dead": ("left", "right", "encoders")}
_DEAD_TRACKS = {"left": (1, 0), "right": (0, 1), "encoders": (1, 1)}
# A time that rounds to the start or end of a fault counts as that time.
_ROUNDING_S = 1e-6

MEMORY = dict(past=(4, _PAST), held=(4, 1))
STREAM = dict(age=(2, 1), hold=(2, 1), dead=(2, 1), added=(4, 1))  # one sample


def as_python(record):
    """A Scenario or a Fault as one line of Python, without the fields that are as by default.

    An object of the user, such as a path, stands there by the name of its field.
    """
    arguments = [
        f"{field.name}={_value_as_python(getattr(record, field.name), field.name)}"
        for field in fields(record)
        if getattr(record, field.name) != field.default
    ]
    return f"rhec.{type(record).__name__}({', '.join(arguments)})"


def _value_as_python(value, name):
    if isinstance(value, tuple):
        entries = ", ".join(_value_as_python(entry, name) for entry in value)
        return f"({entries}{',' if len(value) == 1 else ''})"
    return repr(value) if isinstance(value, bool | int | float | str | Fault) else name


@validated
class Fault:
    """A sensor fault, from start_s for duration_s.

    Args:
        kind: One of
            "missing": there is no measurement (NaN);
            "infinite": measurements are Inf;
            "outliers": each position is off by size_m, in a random direction each time;
            "jump": all positions are off by size_m in the same random direction;
            "stuck": the last measurement is repeated;
            "duplicates": every other measurement is the previous one again;
            "disorder": time runs backwards every other sample: 2, 1, 4, 3, …;
            "latency": measurements arrive late by delay_s;
            "rate": only rate_hz measurements a second arrive;
            "dead": the encoder of a track measures 0.
        channel: "gnss", "encoders" or "all"; for "dead" "left", "right" or "encoders"; for
            "outliers" and "jump" "gnss".
        start_s: When it begins [s].
        duration_s: How long it lasts [s].
        size_m: Size of outliers and jumps [m].
        delay_s: Delay of "latency" [s], at most 1.
        rate_hz: Rate of "rate" [Hz].

    Raises:
        ValueError: If an argument is invalid or does not belong to the kind; one sentence.
    """

    kind: Literal[KINDS]
    channel: Literal["gnss", "encoders", "all", "left", "right"] = "gnss"
    start_s: Real = 0.0
    duration_s: NotNegative = 1e9
    size_m: NotNegative | None = None
    delay_s: Annotated[NotNegative, Field(le=DELAY_MAX_S)] | None = None
    rate_hz: Positive | None = None

    __repr__ = as_python

    def __post_init__(self):
        allowed = OWN_CHANNELS.get(self.kind, tuple(CHANNELS))
        if self.channel not in allowed:
            raise ValueError(
                f"channel was {self.channel!r}; for the kind {self.kind!r} it should be one of "
                f"{allowed}"
            )
        for name in ("size_m", "delay_s", "rate_hz"):
            value = getattr(self, name)
            needed = SIZES.get(self.kind) == name
            if needed != (value is not None):
                raise ValueError(
                    f"{name} was {value!r}; for the kind {self.kind!r} it should be "
                    f"{'given' if needed else 'None'}"
                )

    @property
    def end_s(self) -> float:
        """When it ends [s]."""
        return self.start_s + self.duration_s


class _Schedule(NamedTuple):
    """Effects of faults on samples taken at the times t_s (n,) [s].

    Attributes:
        source_s: (n, 2) when the position and the track speeds that arrive were measured [s].
        stuck: (n, 2) whether the last measurement is repeated instead.
        dead: (n, 2) 1 where the left, the right encoder is dead.
        added: (n, 4) offsets of (x, y, ν, ω).
    """

    source_s: np.ndarray
    stuck: np.ndarray
    dead: np.ndarray
    added: np.ndarray


def _schedule(faults, t_s, seed=0):
    """The _Schedule of faults at rising times t_s (n,) [s].

    The seed fixes the directions of outliers; the first rows do not depend on how many there are.
    """
    t_s = np.asarray(t_s, dtype=float)
    n = len(t_s)
    plan = _Schedule(
        np.column_stack([t_s, t_s]),
        np.zeros((n, 2), dtype=bool),
        np.zeros((n, 2)),
        np.zeros((n, 4)),
    )
    for number, fault in enumerate(faults):
        active = _active(fault, t_s)
        if fault.kind in ("outliers", "jump"):
            plan.added[:, :2] += active[:, None] * _offsets(fault, n, (seed, 2, number))
        elif fault.kind == "dead":
            plan.dead[active] = np.maximum(plan.dead[active], _DEAD_TRACKS[fault.channel])
        elif fault.kind in ("missing", "infinite", "rate"):
            _leave_out(plan, fault, t_s, active)
        elif fault.kind == "stuck":
            plan.stuck[:, CHANNELS[fault.channel]] |= active[:, None]
        else:
            _delay(plan, fault, t_s, active)
    # A stuck sample repeats the last one before it that was not.
    last = np.maximum.accumulate(np.where(plan.stuck, 0, np.arange(n)[:, None]), axis=0)
    return plan._replace(source_s=np.take_along_axis(plan.source_s, last, axis=0))


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


def _leave_out(plan, fault, t_s, active):
    """Measurements that do not arrive, or are infinite."""
    value = np.inf if fault.kind == "infinite" else np.nan
    if fault.kind == "rate":
        # How many measurements are due by now; one arrives where this number rises.
        due = np.floor((t_s - fault.start_s) * fault.rate_hz + _ROUNDING_S)
        is_first = np.cumsum(active) == 1
        active = active & (np.diff(due, prepend=-1.0) < 1) & ~is_first
    for channel in CHANNELS[fault.channel]:
        plan.added[active, 2 * channel : 2 * channel + 2] += value


def _delay(plan, fault, t_s, active):
    """Measurements that arrive late: once more, in the wrong order, or by a latency."""
    sample = np.arange(len(t_s))
    is_odd = (np.cumsum(active) - 1) % 2  # every other sample since the fault began
    if fault.kind == "duplicates":
        measured_s = t_s[np.maximum(sample - is_odd, 0)]
    elif fault.kind == "disorder":
        measured_s = t_s[np.maximum(sample - 2 * is_odd, 0)]
    else:
        measured_s = t_s - fault.delay_s
    for channel in CHANNELS[fault.channel]:
        # Nothing was measured before the first sample, and faults before this one delay, too.
        late = np.minimum(plan.source_s[:, channel], np.maximum(measured_s, t_s[:1]))
        plan.source_s[:, channel] = np.where(active, late, plan.source_s[:, channel])


def _without_dead_tracks(nu, omega, dead, track_width_m):
    """ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b, where encoders with dead = 1 measure 0."""
    left = dead[0] * (nu - omega * track_width_m / 2)
    right = dead[1] * (nu + omega * track_width_m / 2)
    return nu - (left + right) / 2, omega - (right - left) / track_width_m


def corrupted(z, faults, t_s, track_width_m, seed=0):
    """A recorded stream of measurements as it arrives with faults.

    Args:
        z: (n, 4) measurements (x, y, ν, ω); linear between the samples.
        faults: Faults.
        t_s: (n,) times of the samples, rising [s].
        track_width_m: b [m].
        seed: Fixes the directions of outliers.

    Returns:
        (n, 4) measurements.
    """
    z = np.asarray(z, dtype=float)
    plan = _schedule(faults, t_s, seed)
    x, y, nu, omega = (np.interp(plan.source_s[:, row // 2], t_s, z[:, row]) for row in range(4))
    nu, omega = _without_dead_tracks(nu, omega, plan.dead.T, track_width_m)
    return np.column_stack([x, y, nu, omega]) + plan.added


def stream(faults, samples, dt_s, seed):
    """The schedule as the closed loop reads it, (samples, n): STREAM in rows, ages in samples."""
    t_s = np.arange(samples) * dt_s
    plan = _schedule(faults, t_s, seed)
    age = (t_s[:, None] - plan.source_s) / dt_s
    hold = np.diff(plan.source_s, axis=0, prepend=np.nan) == 0
    return np.hstack([age, hold, plan.dead, plan.added])


def init():
    """Memory before the first sample. Ages do not reach beyond it, so it is never delivered."""
    return {name: np.zeros(shape) for name, shape in MEMORY.items()}


def deliver():
    """The Function (z, past, held, age, hold, dead, added) -> (z, past, held) of one sample.

    The measurement z (4,) becomes the one that arrives. past (4, _PAST) holds the measurements
    before it, the newest first. Where `hold` is 1 the last one delivered is delivered again.
    """

    @casadi_function("deliver", z=(4, 1), **MEMORY, **STREAM, track_width_m=(1, 1))
    def deliver(z, past, held, age, hold, dead, added, track_width_m):
        newest_first = ca.horzcat(z, past)
        ages = ca.DM(range(_PAST + 1))
        # Weights that interpolate linearly between the two samples around each age.
        weights = [ca.fmax(1 - ca.fabs(channel - ages), 0) for channel in ca.vertsplit(age)]
        source = ca.vertcat(newest_first[:2, :] @ weights[0], newest_first[2:, :] @ weights[1])
        source = ca.if_else(ca.vertcat(hold[0], hold[0], hold[1], hold[1]), held, source)
        encoders = _without_dead_tracks(source[2], source[3], dead, track_width_m)
        z = ca.vertcat(source[:2], *encoders) + added
        return dict(z=z, past=newest_first[:, :_PAST], held=source)

    return deliver
