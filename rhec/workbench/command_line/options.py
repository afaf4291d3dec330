"""Options of a command, made from a function's signature and docstring or a Scenario's fields."""

import argparse
import json
import re
from collections.abc import Callable
from inspect import Parameter, getdoc, signature
from typing import Any

__all__ = ["add_keywords", "add_scenario", "keywords", "scenario_of", "summary", "value_of"]

# Fields whose values are objects, which a shell cannot write.
_OBJECTS = ("terrain", "path", "faults", "soil_map")


def value_of(text: str) -> Any:
    """A value of the command line: JSON or, if it is not JSON, a string; a list becomes a tuple."""
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return tuple(value) if isinstance(value, list) else value


def summary(function: Callable) -> str:
    """The first sentence of a docstring."""
    return (getdoc(function) or "").partition("\n\n")[0].replace("\n", " ")


def described(function: Callable) -> dict[str, str]:
    """{parameter: its text} of a docstring's section Args, as Google's style sets it."""
    section = re.search(r"^Args:\n((?: .*\n|\n)*)", f"{getdoc(function)}\n", re.MULTILINE)
    entries = re.findall(r"^    \*{0,2}(\w+): (.*(?:\n     .*)*)", section[1], re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def _add(group, name, text, is_flag):
    """Add `--name`, which is left out of the result unless it is given."""
    action = argparse.BooleanOptionalAction if is_flag else "store"
    kind = {} if is_flag else dict(type=value_of, metavar="VALUE")
    group.add_argument(
        f"--{name.replace('_', '-')}",
        dest=name,
        action=action,
        default=argparse.SUPPRESS,
        help=text.replace("%", "%%"),
        **kind,
    )


def add_keywords(parser, function, skipped=()):
    """Add an option for each parameter of a function that is passed by its name.

    Args:
        parser: An argparse.ArgumentParser.
        function: The function, with a docstring in Google's style.
        skipped: Names of parameters that get no option here.
    """
    texts = described(function)
    for name, parameter in signature(function).parameters.items():
        if parameter.kind is Parameter.KEYWORD_ONLY and name not in skipped:
            _add(parser, name, texts[name], parameter.annotation in (bool, "bool"))


def keywords(given, function, skipped=()):
    """{name: value} of the options that `add_keywords` added and that were given."""
    parameters = signature(function).parameters.values()
    names = {each.name for each in parameters if each.kind is Parameter.KEYWORD_ONLY}
    return {name: value for name, value in vars(given).items() if name in names - {*skipped}}


def add_scenario(parser, names=None):
    """Add an option for each field of Scenario, or for some, by groups.

    Args:
        parser: An argparse.ArgumentParser.
        names: Names of fields. By default all whose values can be written in a shell.
    """
    from rhec.simulation.scenario_fields import FIELDS

    groups = {}
    for name, field in FIELDS.items():
        if name in _OBJECTS or names is not None and name not in names:
            continue
        if field.group not in groups:
            groups[field.group] = parser.add_argument_group(field.group)
        is_flag = any(isinstance(choice, bool) for choice in field.choices)
        _add(groups[field.group], name, f"{field.text}{_range(field)}", is_flag)


def _range(field):
    """Unit and limits of a field, as they follow its text."""
    parts = [field.unit] if field.unit else []
    if field.lowest is not None:
        parts.append(f"{'above' if field.above_lowest else 'at least'} {field.lowest:g}")
    if field.highest is not None:
        parts.append(f"at most {field.highest:g}")
    return f" [{'; '.join(parts)}]" if parts else ""


def scenario_of(given):
    """The Scenario of the options that `add_scenario` added, in the world that `--world` names."""
    from rhec.simulation.scenario import Scenario
    from rhec.simulation.scenario_fields import FIELDS
    from rhec.simulation.worlds import WORLDS

    if given.world not in WORLDS:
        raise ValueError(f"world was {given.world!r}; it should be one of {', '.join(WORLDS)}")
    fields = {name: value for name, value in vars(given).items() if name in FIELDS}
    return Scenario(**WORLDS[given.world] | fields)
