"""The cases of faults, and how a run with a fault is judged."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest

import rhec
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


def test_a_course_tells_where_it_is_wet_and_whether_all_is_within_bounds():
    patch = (5.0, 0.0, 2.0, 0.9, 0.3)
    run = rhec.simulate(rhec.Scenario(duration_s=20.0, patches=(patch,)))
    c = run.columns
    found = faults.course_of(run)
    assert found.in_bounds and found.error_m is c["error_true_m"]
    is_wet = np.hypot(c["x_m"] - 5.0, c["y_m"]) < 2.0
    assert is_wet.any() and np.array_equal(found.is_wet, is_wet)
    for name, value in (
        ("omega_cmd_radps", 0.11),
        ("omega_cmd_radps", -0.11),
        ("mu_hat", 1.1),
        ("kappa_hat", -0.1),
        ("x_hat_m", np.inf),
        ("theta_hat_rad", np.nan),
        ("nu_hat_mps", np.nan),
    ):
        spoilt = c | {name: np.append(c[name][:-1], value)}
        assert not faults.course_of(dataclasses.replace(run, columns=spoilt)).in_bounds, name


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


@pytest.mark.parametrize(
    "family, name", [(family, name) for family, cases in faults.CASES.items() for name in cases]
)
def test_a_case_is_what_its_name_says_and_drives_on_after_it(family, name):
    """A fault from 50 s on; wet soil begins where the robot is then."""
    case = faults.CASES[family][name]
    said = {float(number) for number in re.findall(r"[\d.]+", f"{faults.FAMILIES[family]} {name}")}
    of = case.get("fault") or case.get("patch") or {}
    numbers = {value for value in of.values() if isinstance(value, float)}
    assert said - {90, 180, 5} <= numbers
    driven = faults.scenario(case, 50.0, rhec.Scenario())
    if case.get("fault"):
        (fault,) = driven.faults
        assert fault.start_s == 50 and driven.duration_s == pytest.approx(fault.end_s + 60)
    elif "patch" in case:
        ((x, y, radius, mu, kappa),) = driven.patches
        path = rhec.simulate(driven).path
        run = rhec.simulate(dataclasses.replace(driven, patches=()))
        before = run.columns["t_s"].searchsorted(50.0) - 1
        (distance,), (s,) = path.project([[x, y]])
        assert distance == pytest.approx(0, abs=1e-9)
        assert s == pytest.approx(run.columns["s_m"][before] + radius, abs=0.1)
        assert (mu, kappa) == (0.9, 0.3) and driven.duration_s > 50 + 60
    else:
        assert not driven.faults and driven.duration_s > 100


def test_the_table_counts_seeds_that_recovered_in_time():
    """A wrong start may take a minute, anything else 20 s."""
    families = ["outage"] * 3 + ["start"] * 3
    runs = pd.DataFrame(dict(family=families, case="one", estimator="RHE", max_during_m=2.0))
    runs = runs.assign(max_after_m=0.5, in_bounds=[True, True, False] * 2)
    for recovery_s, back, verdicts in (
        (30.0, 3, ["does not hold", "holds"]),
        ([0.0, 30.0, np.nan] * 2, 2, ["does not hold"] * 2),
    ):
        table = faults.fault_table(runs.assign(recovery_s=recovery_s))
        assert [*table["aim_s"]] == [20, 60] and [*table["verdict"]] == verdicts
        assert (table["back"] == back).all() and (table["recovery_s_largest"] == 30).all()
        shown = faults.readable_fault_table(table)
        assert [*shown["recovered, RHE"]] == [f"{back} of 3"] * 2
        counts = faults.verdict_counts(table).loc["RHE"]
        assert counts["does not hold"] == verdicts.count("does not hold")
        assert counts[["cases", "runs", "in_bounds"]].tolist() == [2, 6, 4]
