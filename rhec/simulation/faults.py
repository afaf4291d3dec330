"""Sensor faults: what a receiver or an encoder does to its measurements z = (x, y, ν, ω) when it
fails. Not in the paper.

All kinds of faults do three things at a sample: each measurement is the one of an earlier time
(`source_s`), a track's encoder may be dead (`dead`), and something may be added (`added`: an
outlier, or NaN where nothing arrives). `_schedule` says which; `corrupted` applies it to a recorded
stream, `deliver` to the closed loop, sample by sample.
"""

from typing import Annotated, Literal

import casadi as ca
import numpy as np
from pydantic import Field

from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.validation import NotNegative, Positive, Real, validated

__all__ = [
    "CHANNELS",
    "DELAY_MAX_S",
    "Fault",
    "KINDS",
    "MEMORY",
    "OWN_CHANNELS",
    "SIZES",
    "STREAM",
    "corrupted",
    "deliver",
    "init",
    "stream",
]

_PAST = 5  # earlier measurements that the closed loop keeps
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
# Argument that a kind needs
SIZES = {"jump": "size_m", "outliers": "size_m", "latency": "delay_s", "rate": "rate_hz"}
CHANNELS = {"gnss": (0,), "encoders": (1,), "all": (0, 1)}  # position, track speeds
# Channels of the kinds that cannot be on each of these
OWN_CHANNELS = {"outliers": ("gnss",), "jump": ("gnss",), "dead": ("left", "right", "encoders")}
_DEAD_TRACKS = {"left": (1, 0), "right": (0, 1), "encoders": (1, 1)}

MEMORY = dict(past=(4, _PAST), held=(4, 1))
STREAM = dict(age=(2, 1), hold=(2, 1), dead=(2, 1), added=(4, 1))  # one sample


@validated
class Fault:
    """A sensor fault, from start_s for duration_s.

    Args:
        kind: One of
            "missing": there is no measurement (NaN);
            "infinite": measurements are Inf;
            "outliers": each position is size_m off, in a direction of its own;
            "jump": all positions are size_m off in the same random direction;
            "stuck": the last measurement is repeated;
            "duplicates": every other measurement is the one before it again;
            "disorder": time runs backwards every other sample: 2, 1, 4, 3, …;
            "latency": measurements arrive delay_s late;
            "rate": only rate_hz measurements a second arrive;
            "dead": a track's encoder measures 0.
        channel: "gnss", "encoders" or "all"; for "dead" "left", "right" or "encoders"; for
            "outliers" and "jump" "gnss".
        start_s: When it begins [s].
        duration_s: How long it lasts [s].
        size_m: Of outliers and jumps [m].
        delay_s: Of latency [s], at most 1.
        rate_hz: Of rate [Hz].

    Raises:
        ValueError: In one sentence, for a bad value or one that does not belong to the kind.
    """

    kind: Literal[KINDS]
    channel: Literal["gnss", "encoders", "all", "left", "right"] = "gnss"
    start_s: Real = 0.0
    duration_s: NotNegative = 1e9
    size_m: NotNegative | None = None
    delay_s: Annotated[NotNegative, Field(le=DELAY_MAX_S)] | None = None
    rate_hz: Positive | None = None

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


def _active(fault, t_s):
    """Whether each of the times t_s (n,) lies in the fault's interval; one that rounds to its start
    or end counts as on it.
    """
    return (t_s > fault.start_s - 1e-6) & (t_s < fault.end_s - 1e-6)


def _schedule(faults, t_s, seed=0):
    """Effects of the faults at each of the times t_s (n,) [s], rising, as a dict.

    source_s (n, 2): when the position and the track speeds that arrive now were measured; dead
    (n, 2): 1 where the left, the right encoder is dead; added (n, 4): to (x, y, ν, ω). The seed
    fixes the directions of outliers; the first rows do not depend on how many there are.
    """
    t_s = np.asarray(t_s, dtype=float)
    n = len(t_s)
    place = np.arange(len(t_s))
    source = np.column_stack([t_s, t_s])
    stuck = np.zeros((n, 2), dtype=bool)
    dead = np.zeros((n, 2))
    added = np.zeros((n, 4))
    # times of this sample and of the two before it
    recent = t_s[np.maximum(place[:, None] - (0, 1, 2), 0)]
    for number, fault in enumerate(faults):
        now = _active(fault, t_s)
        count = np.cumsum(now) - 1  # samples since it began
        if fault.kind in ("outliers", "jump"):
            added[:, :2] += now[:, None] * _offsets(fault, n, (seed, 2, number))
        elif fault.kind == "dead":
            dead[now] = np.maximum(dead[now], _DEAD_TRACKS[fault.channel])
        for channel in CHANNELS.get(fault.channel, ()):
            entries = slice(2 * channel, 2 * channel + 2)
            if fault.kind in ("missing", "infinite"):
                added[now, entries] += np.nan if fault.kind == "missing" else np.inf
            elif fault.kind == "rate":
                due = np.floor((t_s - fault.start_s) * fault.rate_hz + 1e-6)
                added[now & (np.diff(due, prepend=-1.0) < 1) & (count > 0), entries] = np.nan
            elif fault.kind == "stuck":
                stuck[:, channel] |= now
            elif fault.kind in ("duplicates", "disorder", "latency"):
                late = {
                    "duplicates": recent[place, count % 2],
                    "disorder": recent[place, count % 2 * 2],
                }.get(fault.kind, t_s - (fault.delay_s or 0.0))
                late = np.minimum(source[:, channel], np.maximum(late, t_s[:1]))
                source[:, channel] = np.where(now, late, source[:, channel])
    last = np.maximum.accumulate(np.where(stuck, 0, place[:, None]), axis=0)
    return dict(source_s=np.take_along_axis(source, last, axis=0), dead=dead, added=added)


def _offsets(fault, n, seed):
    """Offsets (n, 2) [m] of outliers, or of a jump: all the same."""
    generator = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed)))
    angle = generator.uniform(0, 2 * np.pi, n)
    if fault.kind == "jump":
        angle = np.full(n, angle[:1])
    return fault.size_m * np.column_stack([np.cos(angle), np.sin(angle)])


def _without_dead_tracks(nu, omega, dead, track_width_m):
    """ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b, where encoders with dead = 1 measure 0."""
    left = dead[0] * (nu - omega * track_width_m / 2)
    right = dead[1] * (nu + omega * track_width_m / 2)
    return nu - (left + right) / 2, omega - (right - left) / track_width_m


def corrupted(z, faults, t_s, track_width_m, seed=0):
    """The stream z (n, 4) of measurements (x, y, ν, ω) taken at the times t_s (n,) [s], rising, as
    it arrives with these faults; between samples linear.
    """
    z = np.asarray(z, dtype=float)
    plan = _schedule(faults, t_s, seed)
    x, y, nu, omega = (np.interp(plan["source_s"][:, row // 2], t_s, z[:, row]) for row in range(4))
    nu, omega = _without_dead_tracks(nu, omega, plan["dead"].T, track_width_m)
    return np.column_stack([x, y, nu, omega]) + plan["added"]


def stream(faults, samples, dt_s, seed):
    """The schedule as the closed loop reads it, (samples, n): STREAM in rows, ages in samples."""
    t_s = np.arange(samples) * dt_s
    plan = _schedule(faults, t_s, seed)
    source = plan["source_s"]
    hold = np.diff(source, axis=0, prepend=np.nan) == 0
    return np.hstack([(t_s[:, None] - source) / dt_s, hold, plan["dead"], plan["added"]])


def init():
    """Memory before the first sample. Ages do not reach beyond it, so it is never delivered."""
    return {name: np.zeros(shape) for name, shape in MEMORY.items()}


def deliver():
    """(z, past, held, age, hold, dead, added) -> (z, past, held): the measurement z (4,) as it
    arrives now.

    past (4, _PAST) holds the measurements before it, the newest first; where `hold` is 1 the last
    one delivered is delivered again.
    """

    @casadi_function("deliver", z=(4, 1), **MEMORY, **STREAM, track_width_m=(1, 1))
    def deliver(z, past, held, age, hold, dead, added, track_width_m):
        known = ca.horzcat(z, past)
        ages = ca.DM(range(_PAST + 1))
        # linear between the two samples around each age
        shares = [ca.fmax(1 - ca.fabs(channel - ages), 0) for channel in ca.vertsplit(age)]
        source = ca.vertcat(known[:2, :] @ shares[0], known[2:, :] @ shares[1])
        source = ca.if_else(ca.vertcat(hold[0], hold[0], hold[1], hold[1]), held, source)
        encoders = _without_dead_tracks(source[2], source[3], dead, track_width_m)
        z = ca.vertcat(source[:2], *encoders) + added
        return dict(z=z, past=known[:, :_PAST], held=source)

    return deliver
