"""Records whose parameters are checked as `rhec.core._casadi.validation` checks arguments."""

from typing import TypeVar, dataclass_transform, get_type_hints

from pydantic import ConfigDict, ValidationError
from pydantic.dataclasses import dataclass

from rhec.core._casadi.validation import plain_signature, sentence_of

_T = TypeVar("_T")


@dataclass_transform(kw_only_default=True, frozen_default=True)
def validated(cls: type[_T]) -> type[_T]:
    """Make a frozen dataclass whose constructor checks every parameter strictly (a decorator)."""
    cls = dataclass(
        frozen=True, kw_only=True, config=ConfigDict(arbitrary_types_allowed=True, extra="forbid")
    )(cls)
    construct = cls.__init__
    names = list(cls.__dataclass_fields__)
    plain = plain_signature(cls, get_type_hints(cls))

    def __init__(self, **fields):
        try:
            construct(self, **fields)
        except ValidationError as error:
            raise ValueError(sentence_of(cls.__name__, names, error)) from None

    cls.__init__ = __init__
    cls.__signature__ = plain
    return cls
