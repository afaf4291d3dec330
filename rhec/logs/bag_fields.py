"""Fields of messages of any type, by paths such as `/odom.pose.pose.position.x`.

A path is a topic and, after it, names of fields behind points and places in arrays in brackets,
such as `/wheels.velocity[0]`. It should end at a number. A time is a number of seconds, and a
quaternion gives its yaw [rad].
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

    def value(self, message: Any) -> float:
        """The number at the path in a message; NaN where an array has no such place.

        Raises:
            ValueError: If the message has no such field, or if it is no number.
        """
        value = message
        for name, place in _STEP.findall(self.path):
            if name:
                if not hasattr(value, name):
                    raise ValueError(self._refused(f"has no {name!r} there: {_contents(value)}"))
                value = getattr(value, name)
                continue
            if not _is_array(value):
                raise ValueError(self._refused(f"has no array there: {_contents(value)}"))
            if not -len(value) <= int(place) < len(value):
                return np.nan
            value = value[int(place)]
        number = _number(value)
        if number is None:
            raise ValueError(self._refused(f"is no number: {_contents(value)}"))
        return number

    def _refused(self, problem):
        named = f"columns[{self.column!r}] was {self.topic + self.path!r}"
        return f"{named}; a {self.msgtype} {problem}"


def fields_of(columns: dict[str, str], types: dict[str, str]) -> list[Field]:
    """The fields among the columns that a user names.

    Args:
        columns: {column of a recording: path, or another column's name}.
        types: {topic: type of its messages} of a bag.

    Raises:
        ValueError: If a path names no topic of the bag, or is none.
    """
    fields = []
    for column, path in columns.items():
        topics = [name for name in types if re.match(re.escape(name) + r"[.\[]", path)]
        if not topics:
            if path.startswith("/"):
                raise ValueError(
                    f"columns[{column!r}] was {path!r}; it should begin with a topic and a point, "
                    f"and the bag has {listed(types)}"
                )
            continue
        topic = max(topics, key=len)
        rest = path[len(topic) :]
        if not re.fullmatch(f"({_STEP.pattern})+", rest):
            raise ValueError(
                f"columns[{column!r}] was {path!r}; after the topic it should have fields and "
                "places in arrays, such as .pose.position.x or .velocity[0]"
            )
        if column == "t_s":
            raise ValueError(
                f"columns['t_s'] was {path!r}; the time of a bag's rows is that of the headers of "
                "its messages, or else of their reception"
            )
        fields.append(Field(column, topic, rest, types[topic]))
    return fields


def listed(types: dict[str, str]) -> str:
    """The topics of a bag and their types, as part of a sentence."""
    texts = [f"{name} ({kind})" for name, kind in types.items()]
    more = [f"{len(texts) - _LONGEST} more"] if len(texts) > _LONGEST else []
    return ", ".join([*texts[:_LONGEST], *more]) or "none"


def _is_array(value):
    return isinstance(value, list | tuple | np.ndarray)


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
    if _is_array(value):
        return f"an array of {len(value)}, of which [0] is the first entry"
    names = _names(value)
    return f"it has {', '.join(names[:_LONGEST])}" if names else f"it is a {type(value).__name__}"
