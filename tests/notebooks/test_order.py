"""The order of RHE and EKF under one variation at a time: what varies, and how it is told."""

import re

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import unknowns
from notebooks.studies import interpretations, order


def numbers_of(value):
    """All numbers in a field of a Scenario."""
    if isinstance(value, tuple):
        return {number for entry in value for number in numbers_of(entry)}
    if isinstance(value, rhec.Fault):
        return numbers_of((value.size_m, value.delay_s))
    return {value} if isinstance(value, int | float) else set()


# All that is varied, by what it is called.
NAMED = order.VARIATIONS | unknowns.WORLDS
NAMED |= {words: of for words, of, *_ in interpretations.INTERPRETATIONS.values()}


@pytest.mark.parametrize("name", NAMED)
def test_what_is_varied_is_what_its_name_says(name):
    of = NAMED[name]
    said = {float(number) for number in re.findall(r"[\d.]+", name)}
    found = {number for value in of.values() for number in numbers_of(value)}
    assert said <= {abs(number) for number in found}
    is_negative = name != "wet patches" and min(found, default=0) < 0
    assert is_negative == bool(re.search("−|= -|behind|start on the right", name))


@pytest.mark.parametrize("name", order.VARIATIONS)
def test_both_estimators_can_drive_a_variation(name):
    """A window is the RHE's alone."""
    of = order.VARIATIONS[name]
    scenarios = [
        rhec.Scenario(estimator=each, **order._fields(of, each)) for each in ("rhe", "ekf")
    ]
    is_default = [each == rhec.Scenario(estimator=each.estimator) for each in scenarios]
    assert is_default == [name == "as by default", name.startswith(("as by", "window"))]


def test_the_table_is_the_paired_difference_of_both_in_each_field(monkeypatch):
    """The EKF is 10 mm behind in three of four fields, and lost with one rule."""

    def drive(scenarios, folder):
        found = {}
        for key, of in scenarios.items():
            _, estimator, rule = key
            error_m = np.array([0.05, 0.06, 0.07, 0.08])[: len(of)]
            if estimator == "ekf":
                error_m += (0.01, 0.011, 0.012, -0.001)
            is_lost = estimator == "ekf" and rule == "tracking"
            found[key] = pd.DataFrame(
                dict(mean_error_m=error_m + is_lost, mean_error_true_m=error_m + 9 * is_lost)
            )
        return found

    monkeypatch.setattr(order.run_sets, "drive", drive)
    monkeypatch.setattr(order, "VARIATIONS", {"one": {}, "other": dict(turns="left")})
    table = order.one_variation_at_a_time(4)
    assert [*table["variation"]] == ["one"] * 3 + ["other"] * 3
    row = table.iloc[0]
    assert (row["rhe_m"], row["ekf_m"], row["mean"]) == pytest.approx((0.065, 0.073, -0.008))
    half = 3.182 * np.std([0.01, 0.011, 0.012, -0.001], ddof=1) / 2  # t of 3 degrees of freedom
    assert (row["low"], row["high"]) == pytest.approx((-0.008 - half, -0.008 + half), rel=1e-3)
    assert row["share"] == 0.75 and row["n"] == 4
    assert [*table["verdict"]] == ["undecided", "undecided", "its rival is lost"] * 2
    shown = order.readable_order(table)
    assert shown.loc["one", "consistent"] == f"0.0650 / 0.0730, −8.0 ± {1e3 * half:.1f}"
    assert shown.loc["other", "tracking"] == "0.0650 / lost"
    words = order.in_words(table)
    assert words.startswith("Of 4 cells in which the EKF is not lost")
    assert "in 0, the larger one in 0, and 4 are undecided (4 fields each)." in words
    assert words.endswith("other, W prediction: −8.0 mm.")
