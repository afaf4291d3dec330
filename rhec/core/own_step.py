"""A part of a loop of one's own: one sample as a CasADi Function, and its first memory."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import refuse, shown

MEMORY = "memory"


@dataclass(frozen=True)
class OwnStep:
    """What an estimator and a controller of one's own have in common.

    Two of them are equal if their Functions have the same text and their memories the same numbers;
    Functions alone are equal only to themselves.

    Attributes:
        step: The Function.
        memory: Numbers of the memory before the first sample.
        signals: {input: shape} that a step may have besides its memory; None for any shape.
        results: {result: shape} that it may have besides its next memory, likewise.
    """

    step: ca.Function
    memory: Sequence[float] = ()

    _carried: ClassVar[tuple] = ()  # names of further attributes that another process needs
    signals: ClassVar[dict]
    results: ClassVar[dict]

    def __post_init__(self):
        if not isinstance(self.step, ca.Function):
            refuse("step was", self.step, "it should be a CasADi Function")
        try:
            memory = np.asarray(self.memory, dtype=float)
        except (TypeError, ValueError, OverflowError):
            memory = np.array(np.nan)
        if memory.ndim != 1 or not np.isfinite(memory).all():
            refuse("memory was", self.memory, "it should be a sequence of finite numbers")
        object.__setattr__(self, MEMORY, tuple(memory.tolist()))
        self._check_names("input", self.step.name_in(), self.signals)
        self._check_names("result", self.step.name_out(), self.results)
        check_sizes("input", inputs_of(self.step), self.signals)
        check_sizes("result", results_of(self.step), self.results)
        # A Callback can be written, but not read: no other process could run it.
        try:
            ca.Function.deserialize(self.key)
        except RuntimeError:
            refuse("step was", self.step, "it should be made of what CasADi can store")

    def _check_names(self, role, names, known):
        for name in names:
            if name not in (MEMORY, *known):
                raise ValueError(
                    f"step has the {role} {shown(name)}; it should be one of "
                    f"{', '.join((MEMORY, *known))}"
                )

    @functools.cached_property
    def key(self) -> str:
        """The text of the Function, which names compiled code."""
        return self.step.serialize()

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self.identity == other.identity

    def __hash__(self) -> int:
        return hash(self.identity)

    @property
    def identity(self) -> tuple[object, ...]:
        """All that tells it from others."""
        return self.key, self.memory

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.step.name()!r}, memory of {len(self.memory)})"

    # The text travels, because CasADi may write a Function that it has read in another way.
    def __reduce__(self):
        others = {name: getattr(self, name) for name in self._carried}
        return _restored, (type(self), self.key, self.memory, others)


def _restored(own_class, key, memory, others):
    own = object.__new__(own_class)
    vars(own).update(others, step=ca.Function.deserialize(key), memory=memory, key=key)
    return own


def inputs_of(step):
    """{input: shape} of a Function."""
    return {name: step.size_in(name) for name in step.name_in()}


def results_of(step):
    """{result: shape} of a Function."""
    return {name: step.size_out(name) for name in step.name_out()}


def check_sizes(role, sizes, wanted):
    """Refuse inputs or results (`role`) whose shapes are not as wanted; None is any shape."""
    for name, size in sizes.items():
        if wanted.get(name) not in (None, size):
            raise ValueError(
                f"step has the {role} {name!r} of shape {size}; it should have {wanted[name]}"
            )
