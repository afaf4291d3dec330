"""A stand-in for `rhec.simulation.scenario.FIELDS`, until that is merged: then this file goes."""

from dataclasses import fields
from typing import NamedTuple

from rhec.simulation.scenario import Scenario

__all__ = ["FIELDS"]

_UNITS = {"m": "m", "s": "s", "rad": "rad", "mps": "m/s", "radps": "rad/s"}
_CHOICES = {
    "speed_model": ("parameter", "input", "slipping"),
    "arrival_mean": ("smoothed", "filtered"),
    "input_reference": ("measured", "curvature"),
    "command_delay": (0, 1),
    "robust": (False, True),
    "cautious": (False, True),
    "backwards": (False, True),
}


class _Field(NamedTuple):
    text: str
    unit: str
    choices: tuple


FIELDS = {
    field.name: _Field(
        field.name.replace("_", " "),
        _UNITS.get(field.name.rpartition("_")[2], ""),
        _CHOICES.get(field.name, ()),
    )
    for field in fields(Scenario)
}
