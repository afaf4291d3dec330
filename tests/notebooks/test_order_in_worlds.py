"""RHE or EKF in the posterior's worlds: files hold what is fitted and driven, and tables count as
they say.
"""

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.studies import interpretations, order_in_worlds, which_worlds
from rhec.simulation import offline
from rhec.tracked_robot import tuning


@pytest.fixture(scope="module")
def worlds():
    """Two worlds of the prior."""
    unit = which_worlds.first_round(2).unit
    return [
        which_worlds.fields_of(world) for world in which_worlds.worlds_at(unit).to_dict("records")
    ]


def drives_of(errors):
    """A table as of `drive_by_rule`, from {(turns, estimator): errors of the worlds}."""
    columns = {}
    for rule in order_in_worlds.RULES:
        for (turns, estimator), values in errors.items():
            for name in ("error", "violations"):
                columns[f"{turns} {estimator}_{rule}", name] = values
    n = len(next(iter(errors.values())))
    index = pd.MultiIndex.from_product([range(n), [0]], names=["world", "field"])
    return pd.DataFrame({name: np.asarray(of, float) for name, of in columns.items()}, index)


def same_on_all_paths(rhe, ekf):
    paths = (order_in_worlds.OWN, *order_in_worlds.PATTERNS)
    return {(turns, e): of for turns in paths for e, of in (("rhe", rhe), ("ekf", ekf))}


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("estimator", ["rhe", "ekf"])
def test_the_fit_predicts_better_than_the_noise_that_is_printed(estimator):
    runs = [rhec.simulate(rhec.Scenario(estimator="oracle", duration_s=8.0, seed=600_001))]
    noises = [order_in_worlds.fit_prediction(estimator, runs), tuning.NOISES[estimator]["printed"]]
    fitted, printed = offline.deviances(rhec.Scenario(estimator=estimator), noises, runs)
    assert fitted < printed


def test_deviances_are_those_of_each_run_by_itself():
    """Oracle: `offline.run_estimator`, one noise and run at a time."""
    runs = rhec.simulate(
        [rhec.Scenario(estimator="oracle", duration_s=9.0, seed=600_002 + k) for k in range(2)]
    )
    noises = [tuning.NOISES["rhe"][rule] for rule in ("printed", "prediction")]
    found = offline.deviances(rhec.Scenario(), noises, runs)
    for noise, of_noise in zip(noises, found):
        scenario = rhec.Scenario(**noise._asdict())
        for run, value in zip(runs, of_noise):
            alone = offline.run_estimator(scenario, run, "deviance")["deviance"].sum()
            assert value == pytest.approx(alone, rel=1e-9)


def test_each_world_is_fitted_on_drives_of_its_own(worlds, monkeypatch):
    driven = []
    monkeypatch.setattr(order_in_worlds, "simulate", driven.append)
    noise = tuning.Noise((1.0,), (2.0,))
    monkeypatch.setattr(order_in_worlds, "fit_prediction", lambda *given, **options: noise)
    for numbered in enumerate(worlds):
        order_in_worlds._fitted_in(numbered)
    seeds = [scenario.seed for scenarios in driven for scenario in scenarios]
    assert len({*seeds}) == len(seeds) == order_in_worlds._TRAINING_DRIVES * len(worlds)
    for world, scenarios in zip(worlds, driven, strict=True):
        duration_s = which_worlds.duration_s(order_in_worlds._TRAINING_ROWS, world)
        assert {scenario.duration_s for scenario in scenarios} == {duration_s}


def test_the_file_of_noises_holds_what_is_fitted(monkeypatch):
    """In the world whose drives are the shortest, for the EKF; the RHE takes seconds."""
    monkeypatch.setattr(order_in_worlds, "ESTIMATORS", ("ekf",))
    worlds = which_worlds.posterior_worlds()
    rows = order_in_worlds._TRAINING_ROWS
    numbered = min(enumerate(worlds), key=lambda each: which_worlds.duration_s(rows, each[1]))
    (found,) = order_in_worlds._fitted_in(numbered)
    stored = pd.read_csv(order_in_worlds.NOISES).set_index(["world", "estimator"])
    assert found == (numbered[0], "ekf", *stored.loc[(numbered[0], "ekf")])


def test_the_file_of_drives_holds_what_is_driven_by_each_rule(monkeypatch):
    """In the first of the worlds, on its own path and on another one.

    Where a sample is just accepted or just not, another compiler's rounding decides.
    """
    noises = pd.read_csv(order_in_worlds.NOISES).query("world == 0")
    worlds = order_in_worlds.with_noises(which_worlds.posterior_worlds()[:1], noises)
    monkeypatch.setattr(order_in_worlds, "PATTERNS", ("right",))
    now = order_in_worlds.drive_by_rule(worlds).astype(float)
    then = order_in_worlds.order_drives().loc[[0]]
    assert len(now.columns) == 40
    np.testing.assert_allclose(now, then[now.columns], rtol=0.02)


def test_shares_of_worlds_are_counted_by_their_means():
    """The RHE is the better in three of four worlds; in one of these the EKF is lost."""
    errors = same_on_all_paths([0.02, 0.04, 0.03, 0.05], [0.04, 0.08, 0.02, 10.0])
    table = order_in_worlds.rule_rows(drives_of(errors), 4)
    row = table.set_index(["rule for W", "turns"]).loc["tracking", "left"]
    assert row["RHE better"] == 0.75
    assert row["neither lost"] == 0.75
    assert row["RHE better, neither lost"] == pytest.approx(2 / 3, abs=1e-5)
    assert row["EKF / RHE"] == 2.0
    assert row["low"] < 0.75 < row["high"]
    share = f"0.750 [{row['low']:.3g}, {row['high']:.3g}]"
    ratios = np.quantile([2.0, 2.0, 2 / 3, 200.0], [0.05, 0.95])
    ratio = f"2.00 [{ratios[0]:.3g}, {ratios[1]:.0f}]"
    shown = order_in_worlds.readable_rules(table)
    assert shown.loc["tracking", "left"] == f"{share}; {ratio}"
    assert [*shown.index] == [*order_in_worlds.RULES]


def test_every_interpretation_is_a_scenario_and_another_one_than_the_default():
    for name, (_, fields, *_) in interpretations.INTERPRETATIONS.items():
        assert rhec.Scenario(**fields) != rhec.Scenario(), name
