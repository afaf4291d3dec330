"""The record of a sensor fault; `fault_signals` applies it to measurements. Not in the paper."""

from dataclasses import fields
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rhec import paper
from rhec.core._casadi.validation import NotNegative, Positive, Real, validated
from rhec.tracked_robot.sensors import SENSORS

DELAY_MAX_S = 1.0
PAST = round(DELAY_MAX_S / paper.DT_S)  # earlier measurements that the closed loop stores


def memory_shapes(n_sensors):
    """Shapes of what faulty sensors remember, by name; with `n_sensors` of SENSORS."""
    return dict(past=(4 + n_sensors, PAST), held=(4 + n_sensors, 1))


def stream_shapes(n_sensors):
    """Shapes of what happens to one sample, by name."""
    n = 2 + n_sensors
    return dict(age=(n, 1), hold=(n, 1), dead=(n, 1), added=(4 + n_sensors, 1))


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
# The sensors that not every robot has are channels, too. They follow those, and belong to "all".
_ALL_CHANNELS = (*CHANNELS, "left", "right", *SENSORS)


def as_python(record):
    """A Scenario or a Fault as one line of Python, without what is as by default.

    An object of the user, such as a path, stands there by the name of its parameter.
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
            "dead": the encoder of a track, or one of Scenario's `sensors`, measures 0.
        channel: "gnss", "encoders", "all" or one of Scenario's `sensors`; for "dead" "left",
            "right", "encoders" or one of Scenario's `sensors`; for "outliers" and "jump" "gnss".
        start_s: When it begins [s].
        duration_s: How long it lasts [s].
        size_m: Size of outliers and jumps [m].
        delay_s: Delay of "latency" [s], at most 1.
        rate_hz: Rate of "rate" [Hz].

    Raises:
        ValueError: If an argument is invalid or does not belong to the kind; one sentence.
    """

    kind: Literal[KINDS]
    channel: Literal[_ALL_CHANNELS] = "gnss"
    start_s: Real = 0.0
    duration_s: NotNegative = 1e9
    size_m: NotNegative | None = None
    delay_s: Annotated[NotNegative, Field(le=DELAY_MAX_S)] | None = None
    rate_hz: Positive | None = None

    __repr__ = as_python

    def __post_init__(self):
        allowed = OWN_CHANNELS.get(self.kind, tuple(CHANNELS))
        if "encoders" in allowed:
            allowed = (*allowed, *SENSORS)
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


def init(n_sensors):
    """Memory before the first sample. Ages do not reach beyond it, so it is never delivered."""
    return {name: np.zeros(shape) for name, shape in memory_shapes(n_sensors).items()}
