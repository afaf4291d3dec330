"""What a check says of a log: one record for the doctor, for `rhec.replay` and for the command."""

from enum import StrEnum
from typing import NamedTuple


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
