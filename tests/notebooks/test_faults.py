"""The cases of faults, and how a run with a fault is judged."""

import re

import numpy as np
import pytest

from notebooks.further import faults

T_S = 0.2 * np.arange(400)


def course(**errors_m):
    """A Course whose error is 0 but at the samples that are named s0, s1, …"""
    error = np.zeros(len(T_S))
    for name, value in errors_m.items():
        error[int(name[1:])] = value
    return faults.Course(T_S, error, (T_S > 30) & (T_S < 40), True)


def test_a_response_counts_errors_while_the_fault_lasts_and_those_after_it():
    """A fault from 20 to 30 s, before it 5 m, in it 2 m, and 0.5 m at 32 s."""
    found = faults.response(course(s10=5.0, s120=2.0, s160=0.5), 20.0, 30.0)
    assert (found["max_during_m"], found["max_after_m"]) == (2.0, 0.5)
    # From the next sample on it stays within the tolerance for 5 s.
    assert found["recovery_s"] == pytest.approx(0.2 * 161 - 30)
    assert faults.response(course(s120=2.0), 20.0, 30.0)["recovery_s"] == pytest.approx(0)
    late = course(**{f"s{sample}": 1.0 for sample in range(160, 400, 20)})
    assert np.isnan(faults.response(late, 20.0, 30.0)["recovery_s"])


def test_a_fault_lasts_as_its_case_says():
    assert faults.interval_s(course(), dict(fault=dict(duration_s=5.0)), 20.0) == (20.0, 25.0)
    assert faults.interval_s(course(), dict(patch=dict(radius_m=3.0)), 20.0) == pytest.approx(
        (30.2, 39.8)
    )
    assert faults.interval_s(course(), dict(fault=None), 20.0) == (20.0, 20.0)
    assert faults.interval_s(course(), dict(guess_yaw_rad=1.0), 20.0) == (0.0, 0.0)


def test_a_wrong_start_is_as_wrong_as_its_name_says():
    ways = {"yaw (.*)° wrong": ("guess_yaw_rad", np.pi / 180), "(.*) m off": ("start_offset_m", 1)}
    said = 0
    for name, case in faults.CASES["start"].items():
        for pattern, (field, unit) in ways.items():
            if number := re.fullmatch(pattern, name):
                assert case == {field: pytest.approx(float(number[1]) * unit)}
                said += 1
    assert said == len(faults.CASES["start"]) - 1  # the reversed path has no number
