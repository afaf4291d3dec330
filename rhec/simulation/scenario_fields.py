"""What each parameter of Scenario means: its group, text, unit and range, for help and menus.

They stand in Scenario, in the annotations of its parameters. No run imports this module.
"""

import functools
import re
import textwrap
from types import NoneType
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from pydantic.fields import FieldInfo

from rhec.core._casadi.validation import Doc


class Field(NamedTuple):
    """What one parameter of Scenario is.

    Attributes:
        group: Its group, such as "the estimator".
        text: What it means, without unit and range.
        unit: Its unit, "" where it has none.
        lowest: Least value of it, or of each of its entries; None where there is none.
        highest: Largest value, likewise.
        choices: The values of a choice of a few, else ().
        above_lowest: Whether it must be above `lowest`.
    """

    group: str
    text: str
    unit: str
    lowest: float | None
    highest: float | None
    choices: tuple
    above_lowest: bool


@functools.cache
def fields_of(scenario_class):
    """{name: Field} of Scenario, from each parameter's Doc and the limits that pydantic checks."""
    fields = {}
    for name, info in scenario_class.__pydantic_fields__.items():
        (doc,) = (each for each in info.metadata if isinstance(each, Doc))
        text = " ".join(doc.text.split())
        fields[name] = Field(doc.group, text, doc.unit, *_values_of(info))
    return fields


def groups_of(scenario_class):
    """The groups of Scenario's parameters, in their order."""
    return [*dict.fromkeys(field.group for field in fields_of(scenario_class).values())]


def _values_of(info):
    """(lowest, highest, choices, above_lowest) of a pydantic FieldInfo."""
    annotation = _entry(info.annotation)
    limits = [*_flat(getattr(annotation, "__metadata__", ())), *info.metadata]
    # Limits of ±1e100 only keep squares finite (`validation.Real`).
    above = max((limit.gt for limit in limits if hasattr(limit, "gt")), default=None)
    lowest = max((x.ge for x in limits if hasattr(x, "ge") and x.ge > -1e100), default=None)
    highest = min((x.le for x in limits if hasattr(x, "le") and x.le < 1e100), default=None)
    choices = get_args(annotation) if get_origin(annotation) is Literal else ()
    if annotation is bool:
        choices = (False, True)
    if lowest is None:
        return above, highest, choices, above is not None
    return lowest, highest, choices, False


def _entry(annotation):
    """What one entry of a tuple is; of alternatives the first; else the annotation itself."""
    parts = [part for part in get_args(annotation) if part not in (NoneType, Ellipsis)]
    if get_origin(annotation) is tuple:
        return parts[0] if all(part is parts[0] for part in parts) else Any
    # What has parts and is neither of these is a union, by either of Python's two spellings.
    if parts and get_origin(annotation) not in (Literal, Annotated):
        return _entry(parts[0])
    return annotation


def _flat(metadata):
    """Limits one by one, out of the pydantic Fields that hold them."""
    for item in metadata:
        yield from item.metadata if isinstance(item, FieldInfo) else (item,)


def _described(name, field):
    """An entry of the docstring: unit and range follow the first sentence of the text."""
    # "eq. (22)" does not end a sentence.
    first, *rest = re.split(r"(?<!eq)\. ", field.text, maxsplit=1)
    unit = f" [{field.unit}]" if field.unit else ""
    limits = ""
    if field.lowest is not None and field.highest is not None:
        limits = f", {field.lowest:g} to {field.highest:g}"
    elif field.lowest is not None:
        limits = f", {'above' if field.above_lowest else 'at least'} {field.lowest:g}"
    sentences = [f"{name}: {first.removesuffix('.')}{unit}{limits}.", *rest]
    indents = dict(initial_indent=" " * 4, subsequent_indent=" " * 8)
    return textwrap.fill(" ".join(sentences), 92, **indents)


def docstring(scenario_class):
    """Scenario's docstring: one entry for each parameter, by groups."""
    groups = groups_of(scenario_class)
    *others, last = groups
    entries = {group: [] for group in groups}
    for name, field in fields_of(scenario_class).items():
        entries[field.group].append(_described(name, field))
    return f"""One closed-loop run. SI units; angles in radians.

The parameters below are in groups: {", ".join(others)},
{last}.
G1 to G18 are the interpretations of the paper in docs/interpretations.md. `dataclasses.replace`
returns a Scenario that differs in some parameters.
`Scenario.describe()` has them as a table.

Args:
{(2 * chr(10)).join(map(chr(10).join, entries.values()))}

Raises:
    ValueError: If a parameter is unknown or invalid; the message is one sentence.
"""
