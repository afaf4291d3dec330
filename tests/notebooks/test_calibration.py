"""Tuned noises: what each rule asks for, on training seeds alone, and alike for every estimator."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.studies import calibration
from rhec.tracked_robot import tuning
from rhec.tracked_robot.tuning import NOISES


def test_prediction_finds_the_noise_of_the_measurements_that_the_world_has():
    """The white part of the position's error, and of the speed the encoders' beside the common."""
    world = rhec.Scenario()
    white_m = world.gnss_sigma_m * np.sqrt(1 - world.gnss_slow_share)
    for estimator in ("rhe", "ekf"):
        x, y, nu, _ = NOISES[estimator]["prediction"].sigma_v
        assert x == y == pytest.approx(white_m, rel=0.1)
        assert nu == pytest.approx(world.speed_sigma_mps, rel=0.15)


@pytest.fixture
def bowl(monkeypatch):
    """Every rule's objective is least where all that it may set is 0.0123; what it was asked."""
    asked = []

    def objective(fields, **world):
        def value(sigma_w, sigma_v):
            asked.append((sigma_w, sigma_v))
            return np.square(np.log(np.divide((*sigma_w, *sigma_v), 0.0123))).sum()

        return value

    monkeypatch.setattr(calibration, "RULES", dict.fromkeys(calibration.RULES, objective))
    return asked


CASES = [(name, rule) for name, tuned in calibration.ESTIMATORS.items() for rule in tuned.rules]


@pytest.mark.parametrize("estimator", calibration.ESTIMATORS)
def test_a_rule_sets_all_that_the_estimator_uses_of_w_and_v(estimator, bowl, monkeypatch):
    """A filter does not use the noise of the yaw rate: it stays as printed. Its row says the seeds
    of the one that is shipped.
    """

    def search(evaluate, unknowns, known):
        evaluate(calibration.sigma_of(np.log([0.0123] * len(unknowns)), unknowns))

    monkeypatch.setattr(calibration, "search", search)
    shipped = calibration.read_rows(calibration.file_of(estimator))
    for rule in calibration.ESTIMATORS[estimator].rules:
        row = calibration.calibrate(estimator, rule)
        assert row["seeds"] == shipped[estimator, rule]["seeds"]
    fields = calibration.ESTIMATORS[estimator].fields
    scenario = rhec.Scenario(sigma_w=row["sigma_w"], sigma_v=row["sigma_v"], **fields)
    np.testing.assert_allclose(scenario.sigma_w, 0.0123)
    of_yaw_rate = 0.0123 if "rhe" in estimator else rhec.paper.SIGMA_V[3]
    np.testing.assert_allclose(scenario.sigma_v, (*[0.0123] * 3, of_yaw_rate))


def test_rhe_and_ekf_are_tuned_with_equal_care(bowl):
    """The same bounds, and as many evaluations for each unknown."""
    spent = {}
    for name in ("rhe", "ekf"):
        bowl.clear()
        row = calibration.calibrate(name, "tracking")
        tried = np.array([(*sigma_w, *sigma_v) for sigma_w, sigma_v in bowl])
        assert len(tried) == row["evaluations"] and row["objective"] < 0.13  # of the yaw rate
        free = tried.min(axis=0) < tried.max(axis=0)
        assert tried[:, free].min() >= calibration.LEAST and tried.max() <= calibration.MOST
        spent[name] = len(tried) / (free.sum() - 2)  # x and y are one unknown, in W and in V
    assert spent["rhe"] == pytest.approx(spent["ekf"], rel=0.35)


def test_rules_see_training_seeds_alone_and_no_estimator_in_the_loop_but_for_tracking(monkeypatch):
    """Those that the shipped rows say; tracking drives by the estimator with the tried noise."""
    seen = []

    def drive(scenarios, **options):
        seen.extend(scenarios)
        return pd.DataFrame(dict(mean_error_true_m=np.arange(len(scenarios) + 1.0)))

    for name in ("simulate", "campaign"):
        monkeypatch.setattr(calibration, name, drive)
    monkeypatch.setattr(calibration.lanes, "load", lambda *structure: None)  # which takes long
    noise = NOISES["ekf"]["consistent"]._asdict()
    shipped = calibration.read_rows(tuning.FILE)
    for rule in ("consistent", "prediction", "soft_soil", "tracking"):
        seen.clear()
        objective = calibration.RULES[rule](dict(estimator="ekf"))
        if rule == "tracking":
            assert objective(**noise) == len(seen) / 2
        first, *_, last = seeds = [scenario.seed for scenario in seen]
        assert shipped["ekf", rule]["seeds"] == f"{first}-{last}"
        assert seeds == [*range(first, last + 1)] and 1000 <= first < last < 2000
        driver = dict(estimator="ekf") | noise if rule == "tracking" else dict(estimator="oracle")
        for scenario in seen:
            assert scenario.turns == "alternate" and vars(scenario).items() >= driver.items()


def test_the_search_finds_the_deeper_of_two_minima(monkeypatch):
    """That is near a bound; the shallower one has more room."""

    def two(fields):
        def value(sigma_w, sigma_v):
            away = np.log(np.divide((*sigma_w, *sigma_v[:3]), 0.1))
            return min(np.square(away).sum(), 0.5 + np.square(away - np.log(0.02)).sum())

        return value

    monkeypatch.setattr(calibration, "RULES", dict(tracking=two))
    row = calibration.calibrate("ekf", "tracking")
    np.testing.assert_allclose(row["sigma_w"], 0.1, rtol=0.1)
    assert row["objective"] < 0.1


def test_a_noise_with_which_an_estimator_diverges_is_never_the_best(monkeypatch):
    def diverges_above(fields):
        return lambda sigma_w, sigma_v: np.nan if sigma_w[0] > 0.02 else -sigma_w[0]

    monkeypatch.setattr(calibration, "RULES", dict(tracking=diverges_above))
    assert 0.01 < calibration.calibrate("ekf", "tracking")["sigma_w"][0] <= 0.02


# The table


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("estimator, rule", [("ekf", "soft_soil"), *CASES])
def test_the_shipped_objective_is_that_of_the_shipped_noise(estimator, rule):
    row = calibration.read_rows(calibration.file_of(estimator))[estimator, rule]
    fields = calibration.ESTIMATORS[estimator].fields
    noises = tuning.noises_of(tuning.name_of_noise(rhec.Scenario(**fields)))
    value = calibration.RULES[rule](fields)(**noises[rule]._asdict())
    assert value == pytest.approx(float(row["objective"]), rel=1e-6)


def test_rows_are_made_again_one_by_one_and_others_stay(tmp_path, monkeypatch):
    """Those of estimators that this command does not know stay, too."""
    file = tmp_path / "tuned.csv"
    rows = calibration.read_rows(tuning.FILE)
    rows["somebody", "prediction"] = rows["ekf", "prediction"] | dict(estimator="somebody")
    calibration.write_rows(file, rows)
    assert calibration.read_rows(file) == rows

    def made(estimator, rule):
        numbers = dict(sigma_w=(0.5, 0.25), sigma_v=(0.125,))
        about = dict(estimator=estimator, process_noise=rule)
        return about | numbers | dict(objective=1.5, evaluations=7, seeds="1000-1001")

    monkeypatch.setattr(calibration, "ProcessPoolExecutor", lambda mp_context: ThreadPoolExecutor())
    monkeypatch.setattr(calibration, "calibrate", made)
    monkeypatch.setattr(calibration, "file_of", lambda name: file)
    calibration.make_table(["ekf"], ["prediction", "tracking"])
    after = calibration.read_rows(file)
    changed = {key for key in rows if after[key] != rows[key]}
    assert changed == {("ekf", "prediction"), ("ekf", "tracking")} and [*after] == [*rows]
    assert after["ekf", "tracking"]["sigma_w"] == "0.5 0.25"


def test_an_estimator_that_is_not_tuned_is_refused_in_one_sentence(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["calibration", "oracle"])
    with pytest.raises(SystemExit):
        calibration.main()
    assert "estimator was 'oracle'; it should be one of ('rhe'" in capsys.readouterr().err
