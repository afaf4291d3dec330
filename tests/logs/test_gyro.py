"""Gyro and heading in a recorded log: what they gain, what faults cost, what is refused."""

import numpy as np
import pandas as pd
import pytest
from helpers import TRACK_WIDTH_M, may_be_unsure, recorded_log

import rhec
from rhec.simulation.columns import ESTIMATE
from rhec.tracked_robot.sensors import are_accepted

LOG = recorded_log(5.0, 120.0, noise_m=0.05, seed=1)
START = dict(first_yaw_rad=0.7)  # 0.3 rad wrong


def with_gyro(scale=1.0, bias=0.0, sigma=0.01, log=LOG):
    noise = sigma * np.random.default_rng(2).standard_normal(len(log))
    return log.assign(gyro_radps=scale * log["yaw_rate_true_radps"] + bias + noise)


def with_heading(log):
    noise = 0.02 * np.random.default_rng(3).standard_normal(len(log))
    heading = log["yaw_true_rad"] + noise
    return log.assign(heading_rad=(heading + np.pi) % (2 * np.pi) - np.pi)


def rms_of(result):
    error = (result["theta_hat_rad"] - result["theta_rad"])[result["t_s"] > 20]
    return np.sqrt(np.mean(error**2))


def yaw_rms(log, **arguments):
    return rms_of(rhec.replay(log, **START | arguments))


@pytest.fixture(scope="module")
def without():
    return yaw_rms(LOG)


@pytest.fixture(scope="module")
def with_a_good_one():
    return yaw_rms(with_gyro())


def test_a_sensor_without_measurements_changes_nothing():
    """Not one bit, nor does one that the user switches off."""
    plain = rhec.replay(LOG, **START)
    silent = rhec.replay(LOG.assign(gyro_radps=np.nan, heading_rad=np.inf), **START)
    pd.testing.assert_frame_equal(silent, plain)
    off = rhec.replay(with_gyro(), sensors=(), **START)
    np.testing.assert_array_equal(off[ESTIMATE], plain[ESTIMATE])


def test_a_gyro_makes_the_yaw_better(with_a_good_one, without):
    # 0.72 here; 0.72 to 0.81 on ten other logs.
    assert with_a_good_one < 0.8 * without


def test_bias_and_scale_of_a_gyro_are_estimated(with_a_good_one):
    result = rhec.replay(with_gyro(scale=0.95, bias=-0.05), **START)
    last = result.iloc[-1]
    assert abs(last["gyro_bias_hat_radps"] + 0.05) < min(3 * last["sigma_gyro_bias_radps"], 0.005)
    assert abs(last["gyro_scale_hat"] - 0.95) < 3 * last["sigma_gyro_scale"]
    assert rms_of(result) < 1.1 * with_a_good_one


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
def test_a_gyro_that_fails_in_mid_log_is_left_out(kind, begin_s, without):
    """It costs hardly more than to have no gyro."""
    log = with_gyro(bias=0.02)
    fails = log["t_s"].between(begin_s, begin_s + 30)
    gyro = log["gyro_radps"]
    values = dict(dead=0.0, stuck=gyro[fails].iloc[0], wild=gyro + 5.0, silent=np.nan)
    log["gyro_radps"] = gyro.mask(fails, values[kind])
    result = rhec.replay(log, **START)
    assert rms_of(result) < 1.1 * without + 0.01
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
    log = with_heading(log=recorded_log(5.0, 60.0, start_rad=3.0, noise_m=0.05))
    result = rhec.replay(log)
    error = (result["theta_hat_rad"] - result["theta_rad"] + np.pi) % (2 * np.pi) - np.pi
    assert error.abs().max() < 0.1 and np.sqrt(np.mean(error**2)) < 0.02
    assert result["theta_hat_rad"].diff().abs().max() < 0.5
