"""Strict validation. Invalid input gets one sentence: the parameter, its value, and what it may be.

Pydantic does the checking.
"""

import functools
from collections.abc import Callable
from difflib import get_close_matches
from inspect import signature
from typing import (
    Annotated,
    Any,
    NamedTuple,
    ParamSpec,
    TypeVar,
    dataclass_transform,
    get_type_hints,
)

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, validate_call
from pydantic.dataclasses import dataclass

# NumPy's numbers and arrays are accepted where Python's numbers and tuples are.
_plain = BeforeValidator(lambda value: value.item() if isinstance(value, np.generic) else value)
_listed = BeforeValidator(
    lambda value: tuple(value.tolist()) if isinstance(value, np.ndarray) else value
)
# The limits keep squares, and sums of them, finite.
Real = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e100, le=1e100), _plain]
Positive = Annotated[Real, Field(gt=0)]
NotNegative = Annotated[Real, Field(ge=0)]
Reals = Annotated[tuple[Real, ...], _listed]
Positives = Annotated[tuple[Positive, ...], _listed]
NotNegatives = Annotated[tuple[NotNegative, ...], _listed]
_one_or_more = BeforeValidator(lambda value: (value,) if isinstance(value, str) else value)
Names = Annotated[tuple[str, ...], _one_or_more]  # one name need not be in a tuple
Whole = Annotated[int, Field(strict=True), _plain]
Steps = Annotated[Whole, Field(ge=0, le=1_000_000)]
Flag = Annotated[bool, Field(strict=True)]
Intervals = Annotated[Whole, Field(ge=2, le=240)]


def _sentence_of(name, fields, error, instead=None):
    """One of a validation's errors: the parameter, its value, and what it may be.

    `instead` says for names that are no parameters what to write.
    """
    unknown = "unexpected_keyword_argument"
    # A misspelt name first, because it explains why another parameter is missing.
    errors = sorted(error.errors(), key=lambda each: each["type"] != unknown)
    first = errors[0]
    kind = first["type"]
    place = first["loc"]
    if kind == unknown:
        close = get_close_matches(place[0], fields, 1, 0.5)
        advice = f"did you mean {close[0]!r}?" if close else f"help(rhec.{name}) lists them"
        if instead and place[0] in instead:
            advice = instead[place[0]]
        return f"{name} has no parameter {place[0]!r}; {advice}"
    if not place:  # a check across parameters, which has a sentence of its own
        return str(first["ctx"]["error"])
    parameter = fields[place[0]] if isinstance(place[0], int) else str(place[0])
    inner = place[1:]
    if kind.startswith("missing") and not inner:
        return f"{parameter} was not given; {name} needs it"
    if kind in ("missing", "too_long"):  # of a tuple's entries
        if kind == "missing":
            inner = inner[:-1]
            wanted = 1 + max(e["loc"][-1] for e in errors if e["loc"][:-1] == place[:-1])
        else:
            wanted = first["ctx"]["max_length"]
        message = f"it should have {wanted} entries"
    else:
        message = _expected(first)
    where = parameter + "".join(f"[{entry}]" for entry in inner)
    return f"{where} was {shown(first['input'])}; {message}"


# What pydantic's kinds of errors ask for, with the numbers and words of their context.
_EXPECTED = {
    "bool_type": "True or False",
    "dataclass_type": "a {class_name}",
    "dict_type": "a dict",
    "finite_number": "a finite number",
    "float_type": "a number",
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "int_type": "a whole number",
    "is_instance_of": "a {class}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
    "string_type": "text",
    "tuple_type": "a tuple or a list",
}


def _expected(error):
    """What a value should be, as a clause."""
    if error["type"] == "value_error":  # a check of our own, which says so itself
        return str(error["ctx"]["error"])
    if error["type"] not in _EXPECTED:
        return error["msg"].replace("Input", "it", 1)
    words = {
        # Large limits are easier to read as powers of ten.
        name: f"{value:.12g}" if isinstance(value, float) and abs(value) >= 1e9 else value
        for name, value in error.get("ctx", {}).items()
    }
    return f"it should be {_EXPECTED[error['type']].format(**words)}"


def shown(value):
    """Return a value's repr in one line of a length that can be read."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 200 else f"{text[:200]} …"


def refuse(what, value, expected):
    """Raise a ValueError of one sentence: what was given, its value, and what it may be."""
    raise ValueError(f"{what} {shown(value)}; {expected}")


def numbers(name, value):
    """The value as an array of numbers; a ValueError of one sentence if it is none."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it should be made of numbers") from None


def of_length(name, values, wanted, of):
    """Refuse, in one sentence, values that are not as many as wanted, one for each `of`."""
    if len(values) != wanted:
        refuse(f"{name} was", values, f"it should have {wanted} entries, one for each {of}")


class Doc(NamedTuple):
    """What a parameter means: `Annotated[Positive, Doc("Length of the run.", unit="s")]`.

    Attributes:
        text: Sentences, without unit and range; each space in them may be a line break.
        unit: The parameter's unit, "" where it has none.
        group: The group of parameters that it belongs to.
    """

    text: str
    unit: str = ""
    group: str = ""


_P = ParamSpec("_P")
_T = TypeVar("_T")


def _plain_signature(function, hints):
    """The signature with plain types: `float` for an Annotated float with its limits."""
    full = signature(function)
    parameters = full.parameters.values()
    plain = [p.replace(annotation=hints.get(p.name, p.annotation)) for p in parameters]
    return full.replace(parameters=plain)


def checked(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Check every argument of a function against its annotation (a decorator)."""
    returned = function.__annotations__.pop("return", Any)  # not pydantic's to resolve
    strict = validate_call(function, config=ConfigDict(arbitrary_types_allowed=True))
    hints = get_type_hints(function)  # without what is Annotated
    function.__annotations__["return"] = returned
    names = list(signature(function).parameters)
    called = function.__qualname__.removesuffix(".__init__")

    @functools.wraps(function)
    def call(*arguments: _P.args, **named: _P.kwargs) -> _T:
        try:
            return strict(*arguments, **named)
        except ValidationError as error:
            raise ValueError(_sentence_of(called, names, error)) from None

    call.__annotations__ = hints | {"return": returned}
    call.__signature__ = _plain_signature(function, hints)  # type: ignore[attr-defined]
    return call


@dataclass_transform(kw_only_default=True, frozen_default=True)
def validated(cls: type[_T]) -> type[_T]:
    """Make a frozen dataclass whose constructor checks every parameter strictly (a decorator)."""
    cls = dataclass(
        frozen=True, kw_only=True, config=ConfigDict(arbitrary_types_allowed=True, extra="forbid")
    )(cls)
    construct = cls.__init__
    names = list(cls.__dataclass_fields__)
    plain = _plain_signature(cls, get_type_hints(cls))

    def __init__(self, *unnamed, **fields):
        if unnamed:
            name = cls.__name__
            raise TypeError(
                f"{name} takes its parameters by name, as in {name}({names[0]}=…); it was given "
                f"{shown(unnamed[0])} without one"
            )
        try:
            construct(self, **fields)
        except ValidationError as error:
            instead = getattr(cls, "INSTEAD", None)
            raise ValueError(_sentence_of(cls.__name__, names, error, instead)) from None

    cls.__init__ = __init__
    cls.__signature__ = plain
    return cls
