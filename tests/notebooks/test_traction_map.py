"""The map of what estimating the traction is worth: who is told what, who is best, what is said."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import traction_map
from notebooks.rivals import RIVALS
from rhec.tracked_robot.path import path_of
from rhec.tracked_robot.terrain import random_for

SEEDS = 20
MEANS = (0.96, 0.9, 0.8, 0.65, 0.5)  # of κ


def made_up(ratio_of):
    """Errors of every loop by a function of (κ, variation, loop), times a field's own."""
    fields = np.random.default_rng(0).uniform(0.02, 0.04, SEEDS)
    return {
        (kappa, variation, loop): fields / ratio_of(kappa, variation, loop)
        for kappa in MEANS
        for variation in traction_map.VARIATIONS
        for loop in traction_map.loops(kappa)
    }


def test_no_robot_is_told_of_more_traction_than_there_can_be():
    for kappa in MEANS:
        errors = [loop for loop in traction_map.loops(kappa) if isinstance(loop, float)]
        assert 0.0 in errors and max(errors) <= 1 - kappa + 1e-6


@pytest.mark.parametrize("told, expected", [(-0.2, (0.78, 0.6)), ("no slip model", (1, 1))])
def test_a_robot_drives_by_what_it_is_told(told, expected):
    """On even soil a robot that is told its traction is the one that was told these constants."""
    scenario = rhec.Scenario(
        estimator=RIVALS["fixed_traction"], duration_s=5.0, mu_mean=0.88, mu_deviation=0.0,
        kappa_mean=0.8, kappa_deviation=0.0,
    )  # fmt: skip
    soil = random_for(scenario, path_of(scenario))
    run = rhec.simulate(dataclasses.replace(scenario, terrain=traction_map.told_soil(soil, told)))
    np.testing.assert_allclose(run.log[["mu_hat", "kappa_hat"]], [expected] * len(run.log))
    np.testing.assert_allclose(run.log[["mu", "kappa"]], [(0.88, 0.8)] * len(run.log))


def test_the_best_settings_of_the_training_fields_are_driven(monkeypatch):
    """Each loop is driven with the R and W that had the least error on training fields alone."""
    monkeypatch.setattr(traction_map, "VARIATIONS", (0.1,))
    driven = []

    def errors(groups):
        driven.append(groups)
        return {
            name: np.array([abs(np.log(each.r / 0.04)) + each.sigma_w[2] for each in group])
            for name, group in groups.items()
        }

    monkeypatch.setattr(traction_map, "true_errors", errors)
    traction_map.drive([0.8], range(2), 3)
    tried, chosen = driven
    assert {each.seed for group in tried.values() for each in group} == {1000, 1001, 1002}
    for each in (group[0] for group in (*tried.values(), *chosen.values())):
        # μ slips and varies half as much as κ, which varies by a tenth of its slip.
        slips = 1 - each.mu_mean, 1 - each.kappa_mean, each.mu_deviation, each.kappa_deviation
        assert slips == pytest.approx((0.1, 0.2, 0.01, 0.02))
        driven_m = each.mu_mean * each.speed_mps * each.duration_s
        _, curvatures = path_of(each).poses(np.arange(0, driven_m, 0.1))
        assert curvatures.min() < 0 < curvatures.max()  # a turn to either side
    for (_, _, loop), group in chosen.items():
        assert [each.seed for each in group] == [0, 1]
        assert {each.r for each in group} == {10.0 if loop == traction_map.WITH_PAPERS_R else 0.04}
        assert {each.sigma_w[2] for each in group} == {0.01}


def test_ratios_are_at_equal_seeds_and_lost_soils_do_not_count():
    errors = made_up(lambda kappa, *_: 0.01 if kappa == 0.5 else 1.0)
    errors = {
        name: values * (1.5 if name[-1] == "no slip model" else 1.0)
        for name, values in errors.items()
    }
    table = traction_map.worth_map(errors)
    none = table[table["told"] == "no slip model"]
    np.testing.assert_allclose(none[["mean", "low", "high"]], 1 / 1.5)
    counts = traction_map.counts(table).set_index("told")
    row = counts.loc["no slip model"]
    soils = (len(MEANS) - 1) * len(traction_map.VARIATIONS)
    assert row["pays"] == row["soils"] == soils
    assert row["ratio"] == pytest.approx(1 / 1.5)


def test_a_soil_that_is_half_and_one_that_is_twice_as_good_are_as_good_in_the_mean():
    ratios = dict(told="no slip model", mean=[0.5, 2.0], high=[0.6, 2.1], error_m=0.03)
    assert traction_map.counts(pd.DataFrame(ratios))["ratio"].tolist() == pytest.approx([1.0])


@pytest.mark.parametrize(
    "costly, said",
    [
        (0.2, "κ too high by 0.2 (6 of 6 soils). Against"),
        (0.2, "only where the mean κ is 0.8 or less"),
        (0.2, "guess low: a constant κ too low by 0.2 has 1.00 times the error of the right"),
        (-0.2, " A constant κ too low by 0.2 has 1.25 times the error of the right one ("),
        (None, "Two constants do as well"),
    ],
)
def test_the_rule_of_thumb_can_come_out_either_way(costly, said):
    table = traction_map.worth_map(made_up(lambda *loop: 0.8 if loop[-1] == costly else 1.0))
    assert said in traction_map.against_constants(table)
