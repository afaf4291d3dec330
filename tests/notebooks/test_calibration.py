"""Calibrated process noise: the likelihood of innovations on training seeds."""

import numpy as np
import pytest

import rhec
from notebooks.studies import calibration
from rhec.tracked_robot.tuning import SIGMA_W


@pytest.fixture(scope="module")
def runs():
    return [
        rhec.simulate(rhec.Scenario(estimator="oracle", seed=seed))
        for seed in calibration.TRAINING_SEEDS[:2]
    ]


@pytest.mark.parametrize("estimator", ["rhe", "ekf"])
def test_the_calibrated_noise_explains_the_training_runs_better_than_the_printed(estimator, runs):
    calibrated = calibration.deviance(estimator, SIGMA_W[estimator]["likelihood"], runs)
    assert calibrated < calibration.deviance(estimator, SIGMA_W[estimator]["printed"], runs) - 100
    for factor in (0.1, 10):  # and better than others near it, within the bounds of the search
        other = np.maximum(factor * np.array(SIGMA_W[estimator]["likelihood"]), calibration.LEAST)
        assert calibrated < calibration.deviance(estimator, other, runs)


def test_the_deviance_is_a_sum_over_runs(runs):
    sigma = SIGMA_W["ekf"]["likelihood"]
    each = [calibration.deviance("ekf", sigma, [run]) for run in runs]
    assert (
        calibration.deviance("ekf", sigma, runs) == pytest.approx(sum(each)) and each[0] != each[1]
    )


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


@pytest.mark.parametrize("estimator", calibration.UNKNOWNS)
def test_every_estimator_is_tuned_within_the_same_bounds_and_evaluations(estimator, monkeypatch):
    """What would be best lies beyond the bounds: the search ends at them."""
    driven = []

    def drive(**fields):
        scenario = rhec.Scenario(**fields)
        driven.append(scenario)
        return np.square(np.log(1e5) - np.log(scenario.sigma_w)).sum()

    monkeypatch.setattr(calibration, "tracking_error_m", drive)
    sigma, _ = calibration.tune_for_tracking(estimator)
    assert {scenario.estimator for scenario in driven} == {estimator}
    tried = np.array([scenario.sigma_w for scenario in driven])
    assert tried.min() > calibration.LEAST * 0.99 and tried.max() < calibration.MOST * 1.01
    at_most = np.isclose(sigma, calibration.MOST, rtol=0.1)
    assert at_most[[place for places in calibration.UNKNOWNS[estimator] for place in places]].all()
    assert len(driven) <= calibration.EVALUATIONS * len(calibration.UNKNOWNS[estimator])


def test_the_tracking_error_is_the_mean_of_single_runs():
    fields = dict(estimator="ekf", duration_s=30.0)
    alone = [rhec.simulate(rhec.Scenario(seed=s, **fields)) for s in (1000, 1001)]
    mean = np.mean([run.metrics["mean_error_true_m"] for run in alone])
    found = calibration.tracking_error_m(seeds=(1000, 1001), **fields)
    assert found == pytest.approx(mean, rel=1e-12)
