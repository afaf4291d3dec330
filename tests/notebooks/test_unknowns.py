"""What each unknown is worth: who drives what, what a table says of errors that are made up."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import unknowns
from notebooks.rivals import RIVALS

SEEDS = 12
EVERY_WORLD = [*unknowns.WORLDS, unknowns.POSTERIOR]


def made_up(factor_of, lost=()):
    """Errors by a function of (robot, weights) times a field's own; `lost` are worlds."""
    fields = np.random.default_rng(0).uniform(0.02, 0.03, SEEDS)
    return {
        (world, robot, weights): fields * (10 if world in lost else factor_of(robot, weights))
        for world in EVERY_WORLD
        for robot in unknowns.ROBOTS
        for weights in (unknowns.AS_PRINTED, unknowns.TUNED)
    }


def drift_pays(robot, weights):
    has_drift = robot in (unknowns.DRIFT, unknowns.BOTH, unknowns.ALL)
    return (0.5 if has_drift else 1.0) * (0.8 if weights == unknowns.TUNED else 1.0)


def test_every_robot_is_a_scenario_and_has_what_its_name_says():
    for name, fields in unknowns.ROBOTS.items():
        scenario = rhec.Scenario(**fields)
        is_told = "told" in name or name == unknowns.ORACLE
        assert ("gyro" in name) == (scenario.sensors == ("gyro",))
        if not is_told:
            drifting = [RIVALS[name] for name in ("yaw_drift_ekf", "rhe_no_slip_yaw_drift")]
            drifts = scenario.yaw_drift or scenario.estimator in drifting
            assert drifts == ("yaw drift" in name or "both" in name)


def test_each_robot_drives_every_world_with_the_r_of_its_training_fields(monkeypatch):
    driven = []

    def errors(groups):
        driven.append(groups)
        best = {"rhe": 0.1, "ekf": 0.3}
        return {
            name: np.array(
                [abs(np.log(each.r / best.get(each.estimator, 1.0))) for each in scenarios]
            )
            for name, scenarios in groups.items()
        }

    monkeypatch.setattr(unknowns, "true_errors", errors)
    unknowns.drive(range(2), 3, 4)
    tried, chosen = driven
    assert {name[0] for name in chosen} == {*EVERY_WORLD}
    for (world, robot, weights), scenarios in chosen.items():
        expected = {"rhe": 0.1, "ekf": 0.3}.get(scenarios[0].estimator, 1.0)
        assert {each.r for each in scenarios} == {
            10.0 if weights == unknowns.AS_PRINTED else expected
        }
        assert len(scenarios) == (4 if world == unknowns.POSTERIOR else 2)
        fields = unknowns.ROBOTS[robot] | unknowns.WORLDS.get(world, {})
        assert all(getattr(scenarios[0], name) == value for name, value in fields.items())
    used = [{(each.seed, each.slip_difference) for each in group} for group in tried.values()]
    tests = [{(each.seed, each.slip_difference) for each in group} for group in chosen.values()]
    assert not set.union(*used) & set.union(*tests)


def test_a_ratio_is_at_equal_seeds():
    errors = made_up(drift_pays)
    by_rule = {
        (unknowns.DEFAULT, robot, "printed"): errors[unknowns.DEFAULT, robot, unknowns.AS_PRINTED]
        for robot in unknowns._BY_RULE
    }
    for table, what in (
        (unknowns.worth_table(errors), "the yaw drift"),
        (unknowns.rule_table(by_rule), "the yaw drift, beside the traction"),
    ):
        rows = table[(table["robot"] == what) & (table["world"] == unknowns.DEFAULT)]
        np.testing.assert_allclose(rows[["mean", "low", "high"]], 0.5)
        assert (table["n"] == SEEDS).all()


def test_each_robot_has_a_row_with_its_errors_in_millimetres():
    shown = unknowns.readable_errors(unknowns.worth_table(made_up(drift_pays)))
    assert [*shown.columns] == EVERY_WORLD and len(shown) == 2 * len(unknowns.ROBOTS)
    mean_mm = 1e3 * made_up(drift_pays)["d = 0", unknowns.ORACLE, unknowns.TUNED].mean()
    text = shown.loc[(unknowns.TUNED, unknowns.ORACLE), "d = 0"]
    assert text.startswith(f"{mean_mm:.1f} [") and len(set(shown.iloc[0])) == 1


@pytest.mark.parametrize(
    "ratios, words",
    [([0.5], "50 %"), ([0.7, 0.9], "10 to 30 %"), ([0.9, 1.2], "0 to 10 %"), ([1.0], "nothing")],
)
def test_what_is_taken_off_is_a_range_over_the_worlds(ratios, words):
    assert unknowns._taken_off(pd.Series(ratios)) == words


def test_a_world_where_an_oracle_is_lost_does_not_count():
    table = unknowns.worth_table(made_up(drift_pays, lost=(unknowns.SOFT,)))
    assert unknowns.drivable(table) == [name for name in EVERY_WORLD if name != unknowns.SOFT]


def test_worlds_of_the_posterior_are_driven_as_they_were_drawn():
    drawn = pd.DataFrame([dict(rhec.WORLDS["firm"], slip_difference=-0.003, duration_s=100.0)] * 2)
    made = unknowns._drawn(drawn.assign(w_rhe="printed"))
    expected = rhec.Scenario(**rhec.WORLDS["firm"], slip_difference=-0.003)
    assert made == [dataclasses.replace(expected, seed=seed) for seed in (0, 1)]


def test_by_each_rule_the_robot_has_its_noise(monkeypatch):
    driven = {}
    monkeypatch.setattr(unknowns, "true_errors", driven.update)
    unknowns.drive_by_rule(range(2))
    for (world, robot, rule), scenarios in driven.items():
        expected = unknowns.ROBOTS[robot] | unknowns.WORLDS[world] | dict(process_noise=rule)
        assert scenarios == [rhec.Scenario(**expected, seed=seed) for seed in (0, 1)]
