"""Sensor faults: what a receiver or an encoder does to its readings z = (x, y, ν, ω) when it does
not behave.

A fault is data, and what faults do is the same three things at every sample: each reading is the
one of an earlier time (`source_s`), a track's encoder may be dead (`dead`), and something may be
added (`added`: an outlier, or NaN where nothing arrives). `schedule` says which; `corrupted` does
it to a recorded stream, `deliver` to the closed loop, sample by sample.
"""

from typing import Annotated, Literal

import casadi as ca
import numpy as np
from pydantic import Field

from rhec._casadi.build import casadi_function
from rhec._casadi.validation import NotNegative, Positive, Real, validated

PAST = 5  # earlier measurements that the closed loop keeps
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
SIZES = {
    "jump": "size_m",
    "outliers": "size_m",
    "latency": "delay_s",
    "rate": "rate_hz",
}  # what a kind must be told
CHANNELS = {"gnss": (0,), "encoders": (1,), "all": (0, 1)}  # position, track speeds
OWN_CHANNELS = {
    "outliers": ("gnss",),
    "jump": ("gnss",),
    "dead": ("left", "right", "encoders"),
}  # of kinds that cannot hit every one of these

MEMORY = dict(past=(4, PAST), held=(4, 1))
STREAM = dict(age=(2, 1), hold=(2, 1), dead=(2, 1), added=(4, 1))  # one sample


@validated
class Fault:
    """Something wrong with a sensor from start_s for duration_s.

    kind       "missing": no reading (NaN); "infinite": readings are Inf "outliers": each position
               is size_m off, in a direction of its own; "jump": all are size_m off in the same
               random direction "stuck": the last reading is repeated; "duplicates": every other
               reading is the one before it again "disorder": time runs backwards every other
               sample: 2, 1, 4, 3, … "latency": readings arrive delay_s late, 1 s at most; "rate":
               only rate_hz readings a second arrive "dead": a track's encoder reads 0
    channel    "gnss", "encoders" or "all"; for "dead" it is "left", "right" or "encoders", and
               outliers and jumps are the GNSS's alone
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
                f"channel was {self.channel!r}; for the kind {self.kind!r} it should be one of {allowed}"
            )
        for name in ("size_m", "delay_s", "rate_hz"):
            value, needed = getattr(self, name), SIZES.get(self.kind) == name
            if needed != (value is not None):
                raise ValueError(
                    f"{name} was {value!r}; for the kind {self.kind!r} it should be {'given' if needed else 'None'}"
                )

    @property
    def end_s(self):
        return self.start_s + self.duration_s


def active(fault, t_s):
    """Where the times t_s (n,) lie in the fault's interval; a start or an end falls between samples
    or on one, whatever it rounds to.
    """
    return (t_s > fault.start_s - 1e-6) & (t_s < fault.end_s - 1e-6)


def schedule(faults, t_s, seed=0):
    """What the faults do at each of the times t_s (n,), rising: a dict of

    source_s (n, 2): when the position and the track speeds delivered now were read; dead (n, 2): 1
    where the left, the right encoder reads 0; added (n, 4): to (x, y, ν, ω). The seed fixes the
    directions of outliers; the first rows do not depend on how many there are.
    """
    t_s = np.asarray(t_s, dtype=float)
    n, place = len(t_s), np.arange(len(t_s))
    source, stuck, dead, added = (
        np.column_stack([t_s, t_s]),
        np.zeros((n, 2), dtype=bool),
        np.zeros((n, 2)),
        np.zeros((n, 4)),
    )
    earlier = t_s[
        np.maximum(place[:, None] - (0, 1, 2), 0)
    ]  # this sample's time and the two before it
    for number, fault in enumerate(faults):
        now = active(fault, t_s)
        count = np.cumsum(now) - 1  # samples since it began
        directions = np.random.Generator(
            np.random.Philox(np.random.SeedSequence((seed, 2, number)))
        ).uniform(0, 2 * np.pi, n)
        if fault.kind in ("outliers", "jump"):
            angle = directions if fault.kind == "outliers" else directions[:1]
            added[:, :2] += (
                now[:, None]
                * fault.size_m
                * np.column_stack(np.broadcast_arrays(np.cos(angle), np.sin(angle), now)[:2])
            )
        elif fault.kind == "dead":
            dead[now] = np.maximum(
                dead[now], {"left": (1, 0), "right": (0, 1), "encoders": (1, 1)}[fault.channel]
            )
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
                    "duplicates": earlier[place, count % 2],
                    "disorder": earlier[place, count % 2 * 2],
                }.get(fault.kind, t_s - (fault.delay_s or 0.0))
                source[:, channel] = np.where(
                    now,
                    np.minimum(source[:, channel], np.maximum(late, t_s[:1])),
                    source[:, channel],
                )
    last = np.maximum.accumulate(np.where(stuck, 0, place[:, None]), axis=0)
    return dict(source_s=np.take_along_axis(source, last, axis=0), dead=dead, added=added)


def without_dead_tracks(nu, omega, dead, track_width_m):
    """ν = (ν_l + ν_r)/2 and ω = (ν_r - ν_l)/b from encoders of which those with dead = 1 read 0."""
    left, right = (
        dead[0] * (nu - omega * track_width_m / 2),
        dead[1] * (nu + omega * track_width_m / 2),
    )
    return nu - (left + right) / 2, omega - (right - left) / track_width_m


def corrupted(z, faults, t_s, track_width_m, seed=0):
    """The stream z (n, 4) of readings (x, y, ν, ω) taken at the times t_s (n,) [s], rising, as it
    arrives with these faults; between samples linear.
    """
    z, plan = np.asarray(z, dtype=float), schedule(faults, t_s, seed)
    x, y, nu, omega = (np.interp(plan["source_s"][:, row // 2], t_s, z[:, row]) for row in range(4))
    return (
        np.column_stack([x, y, *without_dead_tracks(nu, omega, plan["dead"].T, track_width_m)])
        + plan["added"]
    )


def stream(faults, samples, dt_s, seed):
    """The schedule as the closed loop reads it: (samples, n) rows, as in STREAM; ages are in
    samples.
    """
    t_s = np.arange(samples) * dt_s
    plan = schedule(faults, t_s, seed)
    source = plan["source_s"]
    hold = np.diff(source, axis=0, prepend=np.nan) == 0
    return np.hstack([(t_s[:, None] - source) / dt_s, hold, plan["dead"], plan["added"]])


def init():
    """Memory before the first sample: ages do not reach back beyond it, so what is there is never
    delivered.
    """
    return {name: np.zeros(shape) for name, shape in MEMORY.items()}


def deliver():
    """(z, past, held, age, hold, dead, added) -> (z, past, held): the measurement z (4,) of now, as
    it arrives.

    past (4, PAST) holds the measurements before it, the newest first; where `hold` is 1 what was
    delivered last is delivered again.
    """

    @casadi_function("deliver", z=(4, 1), **MEMORY, **STREAM, track_width_m=(1, 1))
    def deliver(z, past, held, age, hold, dead, added, track_width_m):
        known = ca.horzcat(z, past)
        linear = [
            ca.fmax(1 - ca.fabs(channel - ca.DM(range(PAST + 1))), 0)
            for channel in ca.vertsplit(age)
        ]  # between the two samples around it
        source = ca.vertcat(known[:2, :] @ linear[0], known[2:, :] @ linear[1])
        source = ca.if_else(ca.vertcat(hold[0], hold[0], hold[1], hold[1]), held, source)
        arrives = (
            ca.vertcat(source[:2], *without_dead_tracks(source[2], source[3], dead, track_width_m))
            + added
        )
        return dict(z=arrives, past=known[:, :PAST], held=source)

    return deliver
