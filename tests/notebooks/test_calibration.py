"""Calibrated process noise: the likelihood of innovations on training seeds."""

import numpy as np
import pytest

import rhec
from notebooks.studies import calibration
from rhec.tracked_robot.tuning import NOISES


@pytest.fixture(scope="module")
def runs():
    return [
        rhec.simulate(rhec.Scenario(estimator="oracle", seed=seed))
        for seed in calibration.TRAINING_SEEDS[:2]
    ]


@pytest.mark.parametrize("estimator", ["rhe", "ekf"])
def test_the_calibrated_noise_explains_the_training_runs_better_than_the_printed(estimator, runs):
    calibrated = calibration.deviance(estimator, NOISES[estimator]["prediction"].sigma_w, runs)
    assert (
        calibrated
        < calibration.deviance(estimator, NOISES[estimator]["printed"].sigma_w, runs) - 100
    )
    for factor in (0.1, 10):  # and better than others near it, within the bounds of the search
        other = np.maximum(
            factor * np.array(NOISES[estimator]["prediction"].sigma_w), calibration.LEAST
        )
        assert calibrated < calibration.deviance(estimator, other, runs)


@pytest.mark.parametrize("estimator, entries", [("rhe", 6), ("ekf", 4)])
def test_calibration_sees_training_seeds_alone_and_no_estimator_in_the_loop(
    estimator, entries, monkeypatch
):
    seen, tried = [], []
    monkeypatch.setattr(calibration, "simulate", seen.extend)

    def off_by(estimator, sigma_w, runs):
        tried.append(sigma_w)
        return np.square(np.log(np.divide(sigma_w, 0.0123))).sum()

    monkeypatch.setattr(calibration, "deviance", off_by)
    sigma, _ = calibration.calibrate(estimator)
    np.testing.assert_allclose(sigma, (0.012,) * entries, rtol=0.1)
    assert len(seen) >= 10 and min(scenario.seed for scenario in seen) >= 1000
    assert {scenario.estimator for scenario in seen} == {"oracle"}


@pytest.mark.parametrize("estimator", calibration.OF_ERRORS)
def test_w_by_tracking_is_found_within_its_bounds_wherever_the_least_error_is(
    estimator, monkeypatch
):
    """One minimum is inside, and a shallower one is nearer to where a search would begin."""
    driven = []

    def drive(**fields):
        scenario = rhec.Scenario(**fields)
        driven.append(scenario)
        away = np.log(np.divide(scenario.sigma_w[:4], 0.1))
        return min(np.square(away).sum(), 0.5 + np.square(away - np.log(0.02)).sum())

    monkeypatch.setattr(calibration, "tracking_error_m", drive)
    sigma, least = calibration.tune_for_tracking(estimator)
    assert {scenario.estimator for scenario in driven} == {estimator}
    np.testing.assert_allclose(sigma[:4], 0.1, rtol=0.3)
    assert least < 0.2
    tried = np.array([scenario.sigma_w for scenario in driven])
    assert tried.min() > calibration.LEAST * 0.99 and tried.max() < 1.01
    assert {scenario.sigma_v is not None for scenario in driven} == {estimator == "rhe"}
