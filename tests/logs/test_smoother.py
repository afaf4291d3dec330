"""What a replay makes of a log with hindsight, with delays told, with a gyro or with a heading."""

import dataclasses
import warnings
from types import SimpleNamespace

import casadi as ca
import make_example_log
import numpy as np
import pandas as pd
import pytest
from helpers import TRACK_WIDTH_M, may_be_unsure, recorded_log
from scipy.signal import lfilter

import rhec
from notebooks.further.recorded.scores import yaw_error
from rhec import paper
from rhec.core.estimator.estimate import noise_of
from rhec.logs import filtering, smoother
from rhec.logs.recording import prepare
from rhec.logs.replay import estimate_samples, replay_scenario
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS
from rhec.tracked_robot.sensors import are_accepted

LOG = recorded_log(5.0, 120.0, noise_m=0.05, seed=1)
EXAMPLE = pd.read_csv(make_example_log.FILE)
START = dict(first_yaw_rad=0.7)  # 0.3 rad wrong


def errors(result):
    """RMS errors of yaw [rad] and position [m] after 20 s."""
    result = result[result["t_s"] > 20]
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


# Delays and gaps


def test_a_delay_that_is_told_is_made_up_for():
    given = dict(
        process_noise="prediction",
        sigma_v=paper.SIGMA_V,
        speed_model="input",
        first_yaw_rad=(0.4, -2.0),
    )
    fresh = rhec.replay(EXAMPLE, **given)
    late = EXAMPLE.groupby("segment")[["x_m", "y_m", "pos_ok"]].shift(4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        told = rhec.replay(EXAMPLE.assign(**late), position_delay_s=0.4, **given)
    whole = EXAMPLE.groupby("segment").cumcount(ascending=False) >= 10  # the last have no position
    np.testing.assert_allclose(told[ESTIMATE][whole], fresh[ESTIMATE][whole], atol=1e-6)


@pytest.mark.parametrize("delay_s", [0.25, -0.1])
def test_a_delay_of_a_fraction_of_a_row_is_made_up_for(delay_s):
    fine = recorded_log(100.0, 60.0)
    late = fine[["x_m", "y_m"]].shift(round(100 * delay_s))
    log = fine.assign(x_m=late["x_m"], y_m=late["y_m"])[100:5900:20]
    result = rhec.replay(log, position_delay_s=delay_s, first_yaw_rad=log["yaw_true_rad"].iloc[0])
    assert errors(result)[1] < 0.01


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("silence_s", [60.0, 5.0])
def test_a_silence_keeps_the_traction_and_the_yaw(silence_s):
    """While the robot stands the log is off: after it, nothing begins anew."""
    stands = EXAMPLE.query("segment == 0 and 33.9 < t_s < 34.6").index
    before = EXAMPLE[: stands[0]]
    after = EXAMPLE[stands[-1] : stands[-1] + 200]
    after = after.assign(t_s=after["t_s"] + silence_s)
    result = rhec.replay(pd.concat([before, after], ignore_index=True), smooth=False)
    assert result["segment"].nunique() == 1 and np.isfinite(result[ESTIMATE]).all(axis=None)
    last = result.iloc[len(before) - 1]
    first = result.iloc[len(before) + 2]
    assert abs(first["mu_hat"] - last["mu_hat"]) < 0.02
    assert abs(first["kappa_hat"] - last["kappa_hat"]) < 0.05
    assert first["sigma_kappa"] < 0.5 * result["sigma_kappa"].iloc[0]
    error = yaw_error(result)
    assert abs(error.iloc[len(before) + 2]) < 2 * first["sigma_theta_rad"]
    assert error.iloc[-50:].abs().max() < 0.1


# A gyro, or a heading


def with_gyro(scale=1.0, bias=0.0):
    noise = 0.01 * np.random.default_rng(2).standard_normal(len(LOG))
    return LOG.assign(gyro_radps=scale * LOG["yaw_rate_true_radps"] + bias + noise)


@pytest.fixture(scope="module")
def with_a_good_one():
    return errors(rhec.replay(with_gyro(), **START))[0]


def test_a_sensor_without_measurements_changes_nothing(smoothed):
    """Not one bit, nor does one that the user switches off."""
    silent = rhec.replay(LOG.assign(gyro_radps=np.nan, heading_rad=np.inf), **START)
    pd.testing.assert_frame_equal(silent, smoothed)
    off = rhec.replay(with_gyro(), sensors=(), **START)
    np.testing.assert_array_equal(off[ESTIMATE], smoothed[ESTIMATE])


def test_a_gyro_makes_the_yaw_better(with_a_good_one, smoothed):
    # 0.72 here; 0.72 to 0.81 on ten other logs.
    assert with_a_good_one < 0.8 * errors(smoothed)[0]


def test_bias_and_scale_of_a_gyro_are_estimated(with_a_good_one):
    result = rhec.replay(with_gyro(scale=0.95, bias=-0.05), **START)
    last = result.iloc[-1]
    assert abs(last["gyro_bias_hat_radps"] + 0.05) < min(3 * last["sigma_gyro_bias_radps"], 0.005)
    assert abs(last["gyro_scale_hat"] - 0.95) < 3 * last["sigma_gyro_scale"]
    assert errors(result)[0] < 1.1 * with_a_good_one


@may_be_unsure
def test_a_window_that_restarts_keeps_a_gyro_of_scale_one():
    """Positions that move for good make it restart, which is no fault of the gyro."""
    log = with_gyro()
    log.loc[log["t_s"] > 60, "x_m"] += 3.0
    result = rhec.replay(log, smooth=False, **START)
    assert result["restarted"].any()
    assert result["gyro_scale_hat"].between(0.95, 1.05).all()


@may_be_unsure
@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize(
    "kind, begin_s", [("stuck", 63.0), ("wild", 30.0), ("dead", 30.0), ("silent", 63.0)]
)
def test_a_gyro_that_fails_in_mid_log_is_left_out(kind, begin_s, smoothed):
    """It costs hardly more than to have no gyro."""
    log = with_gyro(bias=0.02)
    fails = log["t_s"].between(begin_s, begin_s + 30)
    gyro = log["gyro_radps"]
    values = dict(dead=0.0, stuck=gyro[fails].iloc[0], wild=gyro + 5.0, silent=np.nan)
    log["gyro_radps"] = gyro.mask(fails, values[kind])
    result = rhec.replay(log, **START)
    assert errors(result)[0] < 1.1 * errors(smoothed)[0] + 0.01
    used = result["gyro_accepted"]
    assert used[fails].mean() < 0.15
    assert used[log["t_s"] > begin_s + 40].mean() > 0.98


def test_a_sample_that_repeats_itself_or_is_absurd_is_left_out():
    gyro = pd.Series([0.1, 0.1, np.nan, 0.1, 0.2, 2.2, 2.2001, 0.3])
    tracks = pd.Series([0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.7, 0.5])
    expected = [True, False, False, False, True, False, True, True]
    assert are_accepted(gyro, tracks).tolist() == expected


def test_a_gyro_carries_the_yaw_where_positions_are_missing():
    """On soil where the tracks turn the robot less than before, which only a gyro tells.

    Encoders of this log have no noise. On the same soil as before they are as good as a gyro.
    """
    log = with_gyro()
    missing = log["t_s"].between(60, 80)
    log.loc[missing, ["x_m", "y_m"]] = np.nan
    turned = 0.3 * log["yaw_rate_radps"] * missing
    log["yaw_rate_radps"] += turned
    log["v_left_mps"] -= TRACK_WIDTH_M / 2 * turned
    log["v_right_mps"] += TRACK_WIDTH_M / 2 * turned
    causal = START | dict(smooth=False)
    results = [rhec.replay(log, **causal | more) for more in ({}, dict(sensors=()))]
    truth = log[["x_true_m", "y_true_m"]].to_numpy()
    errors = [np.hypot(*(each[["x_hat_m", "y_hat_m"]] - truth).to_numpy().T) for each in results]
    gap = log["t_s"].between(75, 80)
    assert errors[0][gap].mean() < 0.2 * errors[1][gap].mean()


def test_a_heading_gives_the_yaw_from_the_first_sample():
    """Also where it jumps by full turns, and without a guess of the first yaw."""
    log = recorded_log(5.0, 60.0, start_rad=3.0, noise_m=0.05)
    heading = log["yaw_true_rad"] + 0.02 * np.random.default_rng(3).standard_normal(len(log))
    result = rhec.replay(log.assign(heading_rad=np.angle(np.exp(1j * heading))))
    error = yaw_error(result)
    assert error.abs().max() < 0.1 and np.sqrt(np.mean(error**2)) < 0.02
    assert result["theta_hat_rad"].diff().abs().max() < 0.5
