"""NEES and NIS: estimators that know how sure they may be pass, others do not."""

import numpy as np
import pytest
from helpers import SIMPLE_WORLD
from scipy import stats

from notebooks.further import consistency
from notebooks.rivals import RIVALS
from notebooks.studies import calibration
from rhec import Scenario
from rhec.simulation import offline

RUNS, SAMPLES = 40, 60
A = np.array([[1, 0, 0, 0.2], [0, 1, 0, 0.1], [0, 0, 1, 0], [0, 0, 0, 1]])
H = np.eye(4)[[0, 1, 3]]
W, R = np.diag(np.square([0.02, 0.01, 0.005, 0.03])), np.diag(np.square([0.03, 0.04, 0.05]))


def kalman(rng, believed=1.0):
    """A textbook filter on a linear system it knows, but for a factor on its noise: errors, P,
    innovations, S, residuals after the update, HPH'.
    """
    P = np.diag([0.1, 0.2, 0.05, 0.1])
    truth, m = rng.multivariate_normal(np.zeros(4), P), np.zeros(4)
    steps, P = [], believed * P
    for _ in range(SAMPLES):
        truth = A @ truth + rng.multivariate_normal(np.zeros(4), W)
        m, P = A @ m, A @ P @ A.T + believed * W
        z, S = H @ truth + rng.multivariate_normal(np.zeros(3), R), H @ P @ H.T + believed * R
        y, K = z - H @ m, P @ H.T @ np.linalg.inv(S)
        m, P = m + K @ y, (np.eye(4) - K @ H) @ P
        steps.append((m - truth, P, y, S, z - H @ m, H @ P @ H.T))
    return [np.array(each) for each in zip(*steps)]


def test_nees_and_nis_of_a_kalman_filter_with_the_right_noise_are_chi_squared():
    rng = np.random.default_rng(0)
    runs = [kalman(rng) for _ in range(RUNS)]
    nees = np.array([consistency.normalised_squared(errors, P) for errors, P, *_ in runs])
    nis = np.array([consistency.normalised_squared(y, S) for _, _, y, S, _, _ in runs])
    for values, degrees in (
        (nees[:, ::20], 4),
        (nis, 3),
    ):  # estimation errors are correlated in time, innovations are not
        assert stats.kstest(values.ravel(), stats.chi2(degrees).cdf).pvalue > 0.01
        assert consistency.share_inside(values, degrees) > 0.85


@pytest.mark.parametrize("believed", [0.5, 2.0])
def test_nees_shows_an_overconfident_and_a_cautious_filter(believed):
    rng = np.random.default_rng(1)
    nees = np.array(
        [consistency.normalised_squared(*kalman(rng, believed)[:2]) for _ in range(RUNS)]
    )
    assert nees.mean() == pytest.approx(4 / believed, rel=0.15)
    assert consistency.share_inside(nees, 4) < 0.2


def test_innovations_are_recovered_from_residuals_after_the_update():
    _, _, y, S, residuals, HPH = kalman(np.random.default_rng(2))
    recovered, covariances = consistency.innovations(residuals, HPH, R)
    np.testing.assert_allclose(recovered, y, atol=1e-10)
    np.testing.assert_allclose(covariances, S, rtol=1e-9, atol=1e-12)


def test_bounds_hold_the_mean_as_often_as_they_say():
    rng = np.random.default_rng(3)
    low, high = consistency.bounds(20, 6)
    means = rng.chisquare(6, size=(20_000, 20)).mean(axis=1) / 6
    assert np.mean((low < means) & (means < high)) == pytest.approx(0.95, abs=0.005)
    assert low < 1 < high and consistency.bounds(200, 6)[0] > low


@pytest.fixture(scope="module")
def runs():
    return calibration.oracle_runs(range(3), **SIMPLE_WORLD, duration_s=60.0)


def test_the_traction_oracle_is_nearly_consistent_and_the_printed_ekf_is_not(runs):
    told = consistency.measure(Scenario(estimator=RIVALS["traction_oracle"]), runs)
    printed = consistency.measure(Scenario(estimator="ekf", process_noise="printed"), runs)
    later = told.t_s >= offline.SETTLED_S
    assert 0.6 < told.nees[:, later].mean() / 4 < 1.6
    assert 0.8 < told.nis_position[:, later].mean() / 2 < 1.2
    assert printed.nis_position[:, later].mean() / 2 < 0.1
    assert told.states == ("x", "y", "θ", "ν") and told.errors.shape == (3, 300, 4)


@pytest.fixture(scope="module")
def training_runs():
    return calibration.oracle_runs(calibration.TRAINING_SEEDS)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("estimator, most", [("ekf", 1.1), ("rhe", 1.5)])
def test_a_consistent_w_is_as_sure_as_it_may_be_in_each_state(estimator, most, training_runs):
    """Beside it the likeliest W is too sure: innovations do not tell."""
    nees = {}
    for name in ("consistent", "prediction"):
        found = consistency.measure(
            Scenario(estimator=estimator, process_noise=name), training_runs
        )
        (_, values, degrees), *_ = consistency.normalised(found)
        nees[name] = values.mean() / degrees
        if name == "consistent":
            ratios = np.sqrt(consistency.mean_square_errors(found).mean(axis=0))
            assert ((ratios > 0.75) & (ratios < 1.25)).all()
    assert 0.9 < nees["consistent"] < most and nees["prediction"] > 2 * most


def test_the_search_for_consistency_prices_what_lies_outside_its_band(monkeypatch):
    """The driven error is the same everywhere: the best is where NEES and all ratios are inside."""
    seen = []

    def made_up(scenario, runs):
        seen.append(scenario)
        factor = scenario.sigma_w[0] / 0.02  # too sure below, too cautious above
        t_s = np.array([0.0, 30.0])
        errors = np.full((1, 2, 6), 1 / factor)
        return consistency.Consistency(t_s, errors, np.full((1, 2), 6 / factor**2), None, None)

    monkeypatch.setattr(consistency, "measure", made_up)
    monkeypatch.setattr(consistency, "normalised", lambda found: [("NEES", found.nees[:, 1:], 6)])
    monkeypatch.setattr(calibration, "oracle_runs", lambda seeds: [])
    monkeypatch.setattr(calibration, "tracking_error_m", lambda **fields: 0.03)
    sigma, least = consistency.tune("rhe")
    assert sigma[0] == pytest.approx(0.02, rel=0.06)
    assert least == pytest.approx(np.log(0.03), abs=1e-3)
    assert {scenario.arrival_mean for scenario in seen} == {"filtered"}
