"""Strict validation; bad input gets one sentence: the parameter, its value, what it may be.

Pydantic does the checking.
"""

import functools
import importlib
import re
from collections.abc import Callable
from difflib import get_close_matches
from inspect import signature
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, dataclass_transform

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, ValidationError, validate_call
from pydantic.dataclasses import dataclass

from rhec.core._casadi.renamed import new_name, with_new_names

__all__ = ["checked", "numbers", "of_length", "optional", "shown", "validated"]
__all__ += ["Flag", "Intervals", "NotNegative", "NotNegatives", "Positive", "Positives", "Real"]
__all__ += ["Reals", "Slip", "Steps", "Traction", "Weights", "Whole"]
__all__ += ["ArrivalMean", "ProcessNoise", "Solver", "SpeedModel"]

_plain = BeforeValidator(lambda value: value.item() if isinstance(value, np.generic) else value)
# Squares of numbers, and sums of some, should be numbers, too.
Real = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e100, le=1e100), _plain]
Positive = Annotated[Real, Field(gt=0)]
NotNegative = Annotated[Real, Field(ge=0)]
Traction = Annotated[Real, Field(gt=0, le=1)]
_listed = BeforeValidator(
    lambda value: tuple(value.tolist()) if isinstance(value, np.ndarray) else value
)
Reals = Annotated[tuple[Real, ...], _listed]
Positives = Annotated[tuple[Positive, ...], _listed]
NotNegatives = Annotated[tuple[NotNegative, ...], _listed]
Whole = Annotated[int, Field(strict=True), _plain]
Steps = Annotated[Whole, Field(ge=0, le=1_000_000)]
Flag = Annotated[bool, Field(strict=True)]

# Choices that Scenario, RHE and RHC share; Scenario says what each means.
Weights = tuple[NotNegative, NotNegative, NotNegative]
Intervals = Annotated[Whole, Field(ge=2, le=240)]
Solver = Literal["structured", "daqp", "qpoases"]
ProcessNoise = Literal["printed", "calibrated", "consistent"]
SigmaV = tuple[Positive, Positive, Positive, Positive]
SpeedModel = Literal["parameter", "input", "slipping"]
Slip = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]
ArrivalMean = Literal["smoothed", "filtered"]


def _sentence(name, fields, error):
    """Say the first of a validation's errors: the parameter, its value, what it may be."""
    first = error.errors()[0]
    if first["type"] == "unexpected_keyword_argument":
        unknown = first["loc"][0]
        close = get_close_matches(unknown, fields, 1, 0.4)
        return f"{name} has no parameter {unknown!r}" + (
            f"; did you mean {close[0]!r}?" if close else ""
        )
    if not first["loc"]:  # a check across fields, which speaks for itself
        return str(first["ctx"]["error"])
    head = first["loc"][0]
    where = (fields[head] if isinstance(head, int) else str(head)) + "".join(
        f"[{place}]" for place in first["loc"][1:]
    )
    message = re.sub(r"\d{9,}", lambda digits: f"{float(digits[0]):g}", first["msg"])
    return f"{where} was {shown(first['input'])}; {message.replace('Input', 'it', 1)}"


def shown(value, length=200):
    """Return a value's repr in one line of a length that can be read."""
    text = " ".join(repr(value).split())
    return text if len(text) <= length else f"{text[:length]} …"


def of_length(name, values, wanted, of):
    """Refuse, in one sentence, values that are not as many as wanted, one for each `of`."""
    if len(values) != wanted:
        entries = f"{wanted} entries, one for each {of}"
        raise ValueError(f"{name} was {shown(values)}; it should have {entries}")


def numbers(name, value):
    """Return the value as an array of numbers, or say in one sentence why it is none."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it must be made of numbers") from None


def optional(module, purpose):
    """Import an optional package, or say in one sentence what to install."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise ImportError(
            f"{purpose} needs {module}, which is not installed: pip install {module}"
        ) from None


_P = ParamSpec("_P")
_T = TypeVar("_T")


def checked(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Check every argument of a function against its annotation (a decorator)."""
    returned = function.__annotations__.pop("return", Any)  # not pydantic's to resolve
    strict = validate_call(function, config=ConfigDict(arbitrary_types_allowed=True))
    function.__annotations__["return"] = returned
    names = list(signature(function).parameters)
    # The paper's robot has classes of its own behind RHE and RHC.
    called = function.__qualname__.removesuffix(".__init__").removeprefix("Paper")

    @functools.wraps(function)
    def call(*arguments: _P.args, **named: _P.kwargs) -> _T:
        try:
            return strict(*arguments, **with_new_names(named, names))
        except ValidationError as error:
            raise ValueError(_sentence(called, names, error)) from None

    return call


@dataclass_transform(kw_only_default=True, frozen_default=True)
def validated(cls: type[_T]) -> type[_T]:
    """Make a frozen dataclass whose constructor checks every field strictly (a decorator)."""
    cls = dataclass(
        frozen=True, kw_only=True, config=ConfigDict(arbitrary_types_allowed=True, extra="forbid")
    )(cls)
    construct = cls.__init__

    def __init__(self, **fields):
        try:
            construct(self, **with_new_names(fields, cls.__dataclass_fields__))
        except ValidationError as error:
            raise ValueError(
                _sentence(cls.__name__, list(cls.__dataclass_fields__), error)
            ) from None

    def __getattr__(self, name):
        new = new_name(name, cls.__dataclass_fields__)
        if new is None:
            raise AttributeError(f"{cls.__name__!r} object has no attribute {name!r}")
        return getattr(self, new)

    cls.__init__ = __init__
    cls.__getattr__ = __getattr__
    return cls
