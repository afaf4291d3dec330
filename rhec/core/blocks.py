"""A loop as a list of blocks, which read and write signals by name.

In one sample the blocks act in their order. A signal that is read before any block has written it
comes from outside: it is *remembered*, with its value of one sample ago; or *drawn*, from a stream
with a new value for each sample; or else a *setting*, which stays the same over a run. So a block
more or less changes nothing else, and what is compiled is named by the blocks themselves. A Part
is a block with the first values, settings and streams that it needs.

    blocks = (
        Block(build_plant, (0.1,), remembers=("x",), draws=("noise",)),
        Block(build_controller, reads=dict(measured="z")),
    )
    step = sample(blocks, settings=("gain",), row=("x", "u"))
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca

from rhec.core import wiring
from rhec.core._casadi import compiled
from rhec.core._casadi.build import OPTIONS, casadi_function, packed_size, unpack

_LAST = "@last"


@dataclass(frozen=True, eq=False)
class Block:
    """One part of a loop: how to build its Function, and which signals that reads and writes.

    A block is only built where a loop is compiled, not where a compiled loop is run. So it says
    what it remembers and draws; `sample` checks that.

    Attributes:
        build: A function of a module, build(*arguments) -> CasADi Function.
        arguments: Strings, numbers, tuples of these, and objects with a `key` that tells them
            apart. Together with `build` they name what is compiled.
        reads: {input: signal}, where the names differ. "signal@last" is its value a sample ago,
            even after a block has written it.
        writes: {result: signal}, where the names differ; None for a result that nobody may read.
        remembers: Signals that this block writes for the next sample.
        draws: Signals that it takes from the stream.
    """

    build: Callable[..., ca.Function]
    arguments: tuple = ()
    reads: Mapping[str, str] = field(default_factory=dict)
    writes: Mapping[str, str | None] = field(default_factory=dict)
    remembers: tuple[str, ...] = ()
    draws: tuple[str, ...] = ()

    @functools.cached_property
    def key(self) -> tuple:
        """What tells this block from others, in this process and in any other."""
        wires = tuple(self.reads.items()), tuple(self.writes.items()), self.remembers, self.draws
        module = self.build.__module__
        code = module, self.build.__qualname__, compiled.source_digest(module)
        return *code, compiled.key_of(self.arguments), *wires

    def __eq__(self, other):
        return self is other or (isinstance(other, Block) and self.key == other.key)

    def __hash__(self):
        return self._hash

    @functools.cached_property
    def _hash(self):
        return hash(self.key)

    # What is cached stays behind: texts have other hashes in another process.
    def __reduce__(self):
        return Block, tuple(getattr(self, of.name) for of in fields(self))

    @property
    def function(self) -> ca.Function:
        """Its Function, built once in a process."""
        return _built(compiled.loop_symbols(), self.build, self.arguments)

    @property
    def wired(self) -> wiring.Wired:
        """Its Function, and the signals that this reads and writes."""
        return wiring.wired(self.function, self.reads, self.writes)


class Part(NamedTuple):
    """A Block, and what it brings along, so that nobody else has to know its inside."""

    block: Block
    first: Mapping[str, Any] = MappingProxyType({})  # {remembered signal: its first value}
    settings: Mapping[str, Any] = MappingProxyType({})  # {setting: value}
    # {drawn signal: function of (seed, samples, faults) that returns its rows (samples, n)}
    streams: Mapping[str, Callable] = MappingProxyType({})


def brought(parts, what) -> dict:
    """What all Parts bring: their "first", "settings" or "streams", by name.

    Raises:
        ValueError: If two parts bring one name along.
    """
    found: dict = {}
    for part in parts:
        brings = getattr(part, what)
        twice = found.keys() & brings.keys()
        if twice:
            raise ValueError(f"two parts bring {min(twice)!r} among their {what}")
        found |= brings
    return found


def block_of(
    build,
    *arguments,
    reads=MappingProxyType({}),
    writes=MappingProxyType({}),
    remembers=(),
    draws=(),
) -> Block:
    """A Block, made once for its arguments: loops that are equal then share theirs."""
    return _block(build, arguments, tuple(reads.items()), tuple(writes.items()), remembers, draws)


@functools.lru_cache(maxsize=1024)
def _block(build, arguments, reads, writes, remembers, draws):
    return Block(build, arguments, dict(reads), dict(writes), remembers, draws)


# Loops that differ in one block share the others, which take a third of a second to build.
@functools.lru_cache
def _built(symbols, build, arguments):
    """build(*arguments); `symbols` are SX or MX, which a compiler decides."""
    return build(*arguments)


def split(name, shapes):
    """The Function of a block that takes a vector of this name apart.

    Args:
        name: Of the vector.
        shapes: Pairs (name, shape) of the matrices that it holds, column by column.
    """
    shapes = dict(shapes)

    @casadi_function(f"split_{name}", **{name: (packed_size(shapes), 1)})
    def split(**vector):
        return unpack(vector[name], shapes)

    return split


def remembered(blocks):
    """Names of the signals that the next sample gets from this one, in order."""
    return tuple(dict.fromkeys(name for block in blocks for name in block.remembers))


def drawn(blocks):
    """Names of the signals that come from the stream, in order."""
    return tuple(dict.fromkeys(name for block in blocks for name in block.draws))


def sample(blocks, settings, row, others=()):
    """One sample of a loop as a Function (memory, noise, settings …) -> (memory, row, others …).

    Args:
        blocks: Blocks, in the order in which they act.
        settings: Names of the signals that stay the same over a run; those that no block reads are
            left out.
        row: Signals whose values become a row of the log.
        others: Further signals to return.

    Returns:
        The Function. `memory` has what is `remembered` and `noise` what is `drawn`, each matrix
        column by column.

    Raises:
        ValueError: If a signal comes from nowhere, or is remembered or drawn in vain; one sentence.
    """
    parts = [block.wired for block in blocks]
    outside = {}
    for place, (function, name) in wiring.outside(parts).items():
        outside.setdefault(place.removesuffix(_LAST), (function.size_in(name), function.name()))
    written = {signal for part in parts for signal in part.writes.values()}
    memory = {name: _outside(outside, name, "remembers") for name in remembered(blocks)}
    stream = {name: _outside(outside, name, "draws") for name in drawn(blocks)}
    for name in memory:
        if name not in written:
            raise ValueError(f"no block writes {name!r}, which is remembered")
    constant = {name: shape for name, (shape, _) in outside.items() if name not in memory | stream}
    symbols = {name: ca.MX.sym(name, *shape) for name, shape in constant.items()}
    for name in symbols:
        if name not in settings:
            reader = outside[name][1]
            raise ValueError(f"no block before {reader!r} writes {name!r}, and it is no setting")
    packed = dict(
        memory=ca.MX.sym("memory", packed_size(memory)),
        noise=ca.MX.sym("noise", packed_size(stream)),
    )
    last = unpack(packed["memory"], memory)
    signals = symbols | unpack(packed["noise"], stream) | last
    signals |= {name + _LAST: value for name, value in last.items()}
    signals = wiring.evaluated(parts, signals)
    results = dict(
        memory=ca.veccat(*(signals[name] for name in memory)),
        row=ca.veccat(*(signals[name] for name in row)),
    )
    results |= {name: signals[name] for name in others}
    inputs = packed | symbols
    # A scan or log reads every entry, so that results must have no structural zeros.
    outputs = [ca.densify(value) for value in results.values()]
    names = [*inputs], [*results]
    return ca.Function("sample", [*inputs.values()], outputs, *names, OPTIONS[ca.MX])


def _outside(outside, name, verb):
    """The shape of a signal that a block remembers or draws."""
    if name not in outside:
        raise ValueError(f"a block {verb} {name!r}, but none reads it before it is written")
    return outside[name][0]
