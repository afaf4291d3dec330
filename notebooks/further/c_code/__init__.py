"""Measure an export of `rhec.export`: agreement with Python, memory, fuzzing, times."""
