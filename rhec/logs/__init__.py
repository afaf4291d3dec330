"""Recorded logs: readers, plausibility checks, replay and calibration."""

from rhec.logs.reader import read

__all__ = ["read"]
