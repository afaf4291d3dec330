"""Functions that are joined by the names of their arrays.

A Function reads and writes *places*: symbols of another Function, NumPy arrays, or members of a
struct in C. Two arrays at the same place are one. What is read at a place before any Function has
written there comes from outside.
"""

from collections.abc import Mapping
from typing import NamedTuple

import casadi as ca


class Wired(NamedTuple):
    """A Function, and the places of its inputs and results, in their order."""

    function: ca.Function
    reads: dict[str, str]  # {input: place}
    writes: dict[str, str]  # {result: place}


def wired(function, reads: Mapping = {}, writes: Mapping = {}) -> Wired:
    """A Function whose places have the names of its inputs and results, but for those given."""
    return Wired(
        function,
        {name: reads.get(name, name) for name in function.name_in()},
        {name: writes.get(name, name) for name in function.name_out()},
    )


def in_two_memories(functions, memory) -> dict[str, Wired]:
    """The phases of a real-time iteration, whose memory exists twice.

    A Function must not write what it still reads. So `shift` reads "previous.m" and writes
    "current.m"; all other phases read "current.m", and write "previous.m".

    Args:
        functions: {phase: Function}.
        memory: Names of the memory's pieces, such as "m".
    """
    previous, current = ({name: f"{version}.{name}" for name in memory} for version in _VERSIONS)
    return {
        phase: wired(function, previous, current)
        if phase == "shift"
        else wired(function, current, previous)
        for phase, function in functions.items()
    }


_VERSIONS = "previous", "current"


def renamed(part: Wired, place_of) -> Wired:
    """A Function at other places: place_of(place) instead of each."""
    reads, writes = (
        {name: place_of(place) for name, place in places.items()} for places in part[1:]
    )
    return Wired(part.function, reads, writes)


def outside(parts) -> dict[str, tuple]:
    """What Functions, one after the other, read from outside.

    Returns:
        {place: (the first Function that reads it, its input there)}, in the order of reading.
    """
    found = {}
    known = set()
    for part in parts:
        for name, place in part.reads.items():
            if place not in known:
                found.setdefault(place, (part.function, name))
        known.update(part.writes.values())
    return found


def evaluated(parts, values) -> dict:
    """Evaluate Functions, one after the other, on expressions.

    Args:
        parts: Wired Functions.
        values: {place: expression} of what comes from outside.

    Returns:
        The values, and what the Functions have written last at each place.

    Raises:
        ValueError: If a value has another shape than a Function reads.
    """
    values = dict(values)
    for part in parts:
        for name, place in part.reads.items():
            _check_shape(part.function, name, place, values[place].shape)
        results = part.function.call([values[place] for place in part.reads.values()])
        values |= zip(part.writes.values(), results)
    return values


def _check_shape(function, name, place, shape):
    """Refuse another shape than the Function's; CasADi would repeat numbers to fill it."""
    if function.size_in(name) != shape:
        raise ValueError(
            f"{function.name()!r} reads {place!r} of shape {function.size_in(name)}; it has {shape}"
        )
