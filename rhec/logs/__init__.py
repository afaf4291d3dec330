"""Recorded logs: readers, plausibility checks, replay, calibration and scores."""

from rhec.logs.reader import read

__all__ = ["read"]
