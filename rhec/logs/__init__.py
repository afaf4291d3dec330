"""Recorded logs: files of them, and what their replay needs."""

from rhec.logs.reader import read

__all__ = ["read"]
