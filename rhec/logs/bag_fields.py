"""Fields of messages of any type, by paths such as `/odom.pose.pose.position.x`.

A path is a topic and, after it, names of fields behind points and places in arrays in brackets,
such as `/wheels.velocity[0]`. It should end at a number. A time is a number of seconds, and a
quaternion gives its yaw [rad]. A minus before the topic turns the sign, as for an IMU that is
mounted upside down.
"""

import re
from typing import Any, NamedTuple

import numpy as np

_STEP = re.compile(r"\.(\w+)|\[(-?\d+)\]")
_LONGEST = 12  # fields or topics that a message lists


class Field(NamedTuple):
    """A field of the messages of a topic, as a column of a log."""

    column: str
    topic: str
    path: str  # what follows the topic
    msgtype: str
    sign: int = 1

    def value(self, message: Any) -> float:
        """The number at the path in a message; NaN where an array has no such place.

        Raises:
            ValueError: If the message has no such field, or if it is no number.
        """
        value = message
        for name, place in _STEP.findall(self.path):
            try:
                value = getattr(value, name) if name else value[int(place)]
            except IndexError:
                return np.nan
            except (AttributeError, TypeError):
                lacks = f"has no {repr(name) if name else 'array'} there"
                raise ValueError(self._refused(lacks, value)) from None
        number = _number(value)
        if number is None:
            raise ValueError(self._refused("is no number", value))
        return self.sign * number

    def _refused(self, problem, value):
        named = f"columns[{self.column!r}] was {self.topic + self.path!r}"
        return f"{named}; a {self.msgtype} {problem}: {_contents(value)}"


def fields_of(columns: dict[str, str], types: dict[str, str]) -> list[Field]:
    """The fields among the columns that a user names.

    Args:
        columns: {column of a recording: path, or another column's name}.
        types: {topic: type of its messages} of a bag.

    Raises:
        ValueError: If a path names no topic of the bag, or is none.
    """
    fields = []
    for column, given in columns.items():
        path = given.removeprefix("-") if given.startswith("-/") else given
        topic = next((name for name in types if path.startswith((f"{name}.", f"{name}["))), "")
        rest = path[len(topic) :]
        if not topic and not path.startswith("/"):
            continue
        if not topic:
            wanted = f"begin with a topic and a point, and the bag has {listed(types)}"
        elif not re.fullmatch(f"({_STEP.pattern})+", rest):
            wanted = "end in fields and places in arrays, such as .pose.position.x or .velocity[0]"
        elif column == "t_s":
            wanted = "not be given: the time of a bag's rows is that of its messages"
        else:
            sign = 1 if path == given else -1
            fields.append(Field(column, topic, rest, types[topic], sign))
            continue
        raise ValueError(f"columns[{column!r}] was {given!r}; it should {wanted}")
    return fields


def listed(types: dict[str, str]) -> str:
    """The topics of a bag and their types, as part of a sentence."""
    texts = [f"{name} ({kind})" for name, kind in types.items()]
    more = [f"{len(texts) - _LONGEST} more"] if len(texts) > _LONGEST else []
    return ", ".join([*texts[:_LONGEST], *more]) or "none"


def _number(value):
    """A number, a time [s] or the yaw of a quaternion [rad]; None for anything else."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        return float(value)
    names = {*_names(value)}
    if {"sec", "nanosec"} <= names:
        return value.sec + 1e-9 * value.nanosec
    if {"x", "y", "z", "w"} <= names:
        sine = 2 * (value.w * value.z + value.x * value.y)
        return float(np.arctan2(sine, 1 - 2 * (value.y**2 + value.z**2)))
    return None


def _names(value):
    return [name for name in getattr(value, "__annotations__", {}) if not name.startswith("__")]


def _contents(value):
    """What there is instead, as the end of a sentence."""
    if isinstance(value, list | tuple | np.ndarray):
        return f"an array of {len(value)}, of which [0] is the first entry"
    names = _names(value)
    return f"it has {', '.join(names[:_LONGEST])}" if names else f"it is a {type(value).__name__}"
