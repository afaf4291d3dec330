"""The smoother of a replay, delays of positions, and a calibration in the terms of ROS."""

import dataclasses
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from helpers import recorded_log
from scipy.signal import lfilter

import rhec
from notebooks.further.recorded.scores import yaw_error
from rhec.core.estimator.estimate import noise_of
from rhec.logs import filtering, smoother
from rhec.logs.recording import prepare
from rhec.logs.replay import estimate_samples, replay_scenario
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS

LOG = recorded_log(5.0, 120.0, noise_m=0.05, seed=1)
START = dict(first_yaw_rad=0.7)  # 0.3 rad wrong


def errors(result):
    """RMS errors of yaw [rad] and position [m]."""
    position = np.hypot(result["x_hat_m"] - result["x_m"], result["y_hat_m"] - result["y_m"])
    return np.sqrt(np.mean(yaw_error(result) ** 2)), np.sqrt(np.mean(position**2))


@pytest.fixture(scope="module")
def smoothed():
    return rhec.replay(LOG, **START)


def test_later_measurements_make_an_estimate_better(smoothed):
    filtered = errors(rhec.replay(LOG, smooth=False, **START))
    assert np.all(np.array(errors(smoothed)) < 0.85 * np.array(filtered))


def test_the_covariance_of_the_smoother_is_consistent(smoothed):
    error = yaw_error(smoothed)
    sigma = smoothed["sigma_theta_rad"]
    assert 0.2 < np.mean(error**2 / sigma**2) < 1.5
    assert (error.abs() < 1.96 * sigma).mean() > 0.9


def test_a_smoothed_estimate_depends_on_later_measurements(smoothed):
    """And the first ones do not depend on the last ones, beyond what the robot forgets."""
    changed = LOG.copy()
    changed.loc[LOG["t_s"] > 100, "y_m"] += 0.2
    later = rhec.replay(changed, smooth=True, **START)
    difference = (later[ESTIMATE[1]] - smoothed[ESTIMATE[1]]).abs()
    assert difference[LOG["t_s"].between(98, 100)].max() > 0.005
    assert difference[LOG["t_s"] < 60].max() < 0.005


@pytest.mark.parametrize("pair", [MEASUREMENTS[:2], MEASUREMENTS[2:]])
def test_what_the_estimator_rejects_is_missing_for_the_smoother(pair):
    """Each row of this log is a sample, whose encoders are means since the one before."""
    recording = dataclasses.replace(prepare(LOG), averaged=True)
    scenario = replay_scenario("rhe", recording, {})

    def estimates(error):
        rows = recording.rows.copy()
        rows.loc[[300, 301, 400], pair] += error
        return estimate_samples(recording.with_rows(rows), scenario, smooth=True)[ESTIMATE]

    np.testing.assert_allclose(estimates(5.0), estimates(np.nan), atol=1e-6)


def delayed_replay(delay_s, told_s):
    """Rows 0.2 s apart whose positions are late: RMS error [m], and positions that are used."""
    log = recorded_log(100.0, 60.0)
    at = np.arange(100, 5900, 20)
    late = log.iloc[at].reset_index(drop=True)
    late[["x_m", "y_m"]] = log.iloc[at - round(delay_s * 100)][["x_m", "y_m"]].to_numpy()
    result = rhec.replay(late, position_delay_s=told_s, first_yaw_rad=late["yaw_true_rad"][0])
    return errors(result[result["t_s"] > 20])[1], result["x_meas_m"].notna().sum()


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("delay_s", [0.25, 0.1, -0.1])
def test_a_delay_of_a_fraction_of_a_row_is_made_up_for(delay_s):
    error, positions = delayed_replay(delay_s, delay_s)
    without, all_positions = delayed_replay(0.0, 0.0)
    assert error < 1.3 * without + 0.002 < delayed_replay(delay_s, 0.0)[0]
    assert positions >= all_positions - 2


def test_the_sigma_of_a_smoother_is_that_of_errors_that_last_longer_than_a_sample():
    """The mean of n measurements, of which neighbours have errors correlated by ρ = 1/3.

    Its variance is (1 + ρ)/(1 - ρ) σ²/n = 2 σ²/n. Of 400 such means 95 % are within 1.96 σ.
    """
    model = rhec.Model(
        states=("x_m", "y_m"),
        inputs=("speed_mps",),
        parameters={},
        outputs=("x_m", "y_m", "speed_mps"),
        f=lambda x, u, p: ca.vertcat(u, u),
    )
    rng = np.random.default_rng(0)
    noise = noise_of(model, (1.0, 1.0, 1e-6), (1e-6, 1e-6))
    n, rho, ratios = 40, 1 / 3, []
    for _ in range(200):
        steps = np.sqrt(1 - rho**2) * rng.standard_normal((n, 2))
        steps[0] /= np.sqrt(1 - rho**2)
        z = np.column_stack([lfilter([1], [1, -rho], steps, axis=0), np.zeros((n, 4))])
        unknown = np.full(2, 100.0)
        s, sigma = smoother.smoothed(model, 0.2, noise, unknown, np.zeros((n, 2)), z)
        ratios.append(np.abs(s[n // 2]) / sigma[n // 2])
    assert 0.92 < (np.array(ratios) < 1.96).mean() < 0.98


def test_the_last_estimates_of_segments_are_weighed_by_their_variances():
    """1 ± 0.1 and 4 ± 0.2 are 1.6 ± 0.0894 together."""
    segments = [
        dict(estimate=np.array([[9.0], [mean]]), variances=np.array([[9.0], [sigma**2]]))
        for mean, sigma in ((1.0, 0.1), (4.0, 0.2))
    ]
    found = filtering.last_estimates(SimpleNamespace(joint_names=("arm",)), segments)
    np.testing.assert_allclose(found["arm"], (1.6, 0.1 * np.sqrt(0.8)))
