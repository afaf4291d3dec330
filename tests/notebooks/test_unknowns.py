"""What each unknown is worth: who drives what, what a table says of errors that are made up."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import traction_map, unknowns
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


def map_of_equals():
    """A map of soils on which no constant and no estimate is better than another."""
    fields = np.random.default_rng(0).uniform(0.02, 0.04, SEEDS)
    return traction_map.worth_map(
        {
            (kappa, variation, loop): fields
            for kappa in (0.8, 0.65)
            for variation in traction_map.VARIATIONS
            for loop in traction_map.loops(kappa)
        }
    )


def by_rule():
    """Errors by every rule, of which the yaw drift takes off the more the later the rule comes."""
    errors = {
        (world, robot, rule): made_up(drift_pays)[world, robot, unknowns.AS_PRINTED]
        * (0.9**place if robot == unknowns.BOTH else 1.0)
        for world in unknowns._ALIKE_OR_NOT
        for robot in unknowns._BY_RULE
        for place, rule in enumerate(unknowns.RULES)
    }
    return unknowns.rule_table(errors)


def drift_pays(robot, weights):
    has_drift = robot in (unknowns.DRIFT, unknowns.BOTH, unknowns.ALL)
    return (0.5 if has_drift else 1.0) * (0.8 if weights == unknowns.TUNED else 1.0)


def traction_pays(robot, weights):
    has_traction = robot in (unknowns.TRACTION, unknowns.BOTH, unknowns.GYRO, unknowns.ALL)
    return 0.7 if has_traction else 1.0


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
    table = unknowns.worth_table(made_up(drift_pays))
    rows = table[(table["robot"] == "the yaw drift") & (table["world"] == unknowns.DEFAULT)]
    np.testing.assert_allclose(rows[["mean", "low", "high"]], 0.5)
    of_errors = table[table["quantity"] == unknowns.ERROR]
    assert (of_errors["n"] == SEEDS).all() and (of_errors["lost"] == 0).all()


def test_each_robot_has_a_row_with_its_errors_in_millimetres():
    shown = unknowns.readable_errors(unknowns.worth_table(made_up(drift_pays)))
    assert [*shown.columns] == EVERY_WORLD and len(shown) == 2 * len(unknowns.ROBOTS)
    mean_mm = 1e3 * made_up(drift_pays)["d = 0", unknowns.ORACLE, unknowns.TUNED].mean()
    text = shown.loc[(unknowns.TUNED, unknowns.ORACLE), "d = 0"]
    assert text.startswith(f"{mean_mm:.1f} [") and len(set(shown.iloc[0])) == 1


@pytest.mark.parametrize(
    "factor_of, what, percent",
    [(drift_pays, "the yaw drift", "50 %"), (traction_pays, "the traction", "30 %")],
)
def test_the_words_name_what_pays(factor_of, what, percent):
    table = unknowns.worth_table(made_up(factor_of))
    words = unknowns.in_words(table, by_rule(), map_of_equals())
    n = len(EVERY_WORLD)
    assert words.startswith(f"**Tune R, and estimate {what}**")
    line = (
        f"- **T{what[1:]}**: {percent} with the paper's R, where it pays in {n}; {percent} with R"
    )
    assert line in words and ": nothing with the paper's R, where it pays nowhere; nothing" in words
    assert "Not counted" not in words
    assert "drift takes off: printed 50 %, consistent 55 %, prediction 60 %, tracking" in words


def test_a_world_where_an_oracle_is_lost_does_not_count():
    table = unknowns.worth_table(made_up(drift_pays, lost=(unknowns.SOFT,)))
    assert unknowns.drivable(table) == [name for name in EVERY_WORLD if name != unknowns.SOFT]
    # With R tuned it does not matter whether the oracle is lost.
    of_oracle = table["robot"] == unknowns.ORACLE
    other = table.assign(
        lost=table["lost"].mask(of_oracle & (table["weights"] == unknowns.TUNED), 1)
    )
    assert unknowns.drivable(other) == unknowns.drivable(table)
    words = unknowns.in_words(table, by_rule(), map_of_equals())
    assert "Not counted is the world 'soft', where the oracle is lost in 100 % of the" in words


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
