"""What a check says of a log: one record for the doctor, for `rhec.replay` and for the command.

Sentences name what a user may pass by `passed`, as it is written in Python or in a shell.
"""

from contextvars import ContextVar
from enum import StrEnum
from typing import Any, NamedTuple

# Whose argument it is, where other functions say that it helps.
_OF = dict(columns="rhec.logs.read", calibrate="rhec.log")


def _in_python(argument, value=None):
    if argument == "output":  # of the command alone
        return "its attribute yaml, and rhec.export"
    if value is None:
        return argument
    of = f" of {_OF[argument]}" if argument in _OF else ""
    return f"{argument}={value!r}{of}"


# How an argument is written, with its value if there is one; `rhec.cli` sets it to its options.
PASSED = ContextVar("PASSED", default=_in_python)


def passed(argument: str, value: Any = None) -> str:
    """An argument that a user may pass, in the words of the user, such as `--track-width-m`."""
    return PASSED.get()(argument, value)


class Severity(StrEnum):
    """What follows from a Finding."""

    ERROR = "error"  # `rhec.replay` and `rhec.calibrate` refuse the log
    WARNING = "warning"  # they warn, and `rhec.log` does not trust it
    NOTE = "note"  # only `rhec.doctor` and `rhec.log` tell it


class Finding(NamedTuple):
    """One thing that is wrong with a log."""

    severity: Severity
    code: str  # such as "late_positions"
    fact: str  # what was found, with its number; part of a sentence
    remedy: str  # what helps, a sentence

    @property
    def sentence(self) -> str:
        """The fact as a sentence."""
        end = "" if self.fact.endswith("?") else "."
        return f"{self.fact[0].upper()}{self.fact[1:]}{end}"


def note(code: str, fact: str, remedy: str) -> Finding:
    """The Finding of something that does not keep the log from being used."""
    return Finding(Severity.NOTE, code, fact, remedy)


def warning(code: str, fact: str, remedy: str) -> Finding:
    """The Finding of something for which the estimates are not to be trusted."""
    return Finding(Severity.WARNING, code, fact, remedy)


def refused(
    fact: str, code: str = "implausible", remedy: str = "Correct it where the log is read."
) -> Finding:
    """The Finding of a log that cannot be used, or of a column that is not what its name says."""
    return Finding(Severity.ERROR, code, fact, remedy)
