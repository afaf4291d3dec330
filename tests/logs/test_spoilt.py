"""What loggers, bags and tools do to a log: each is named as what it is, once; and true logs pass.

The logs are simulated, with an antenna that may be away from the centre.
"""

import warnings

import make_example_log
import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log
from spoilt_logs import four_headings, late

import rhec
from notebooks.further.recorded.scores import yaw_error
from rhec import paper
from rhec.logs.likelihood import Likelihood
from rhec.simulation.columns import ESTIMATE

EXAMPLE = pd.read_csv(make_example_log.FILE)
LOG = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)


def with_imu(log, rate_hz=60.0):
    """A log with a row of its own for each sample of an IMU, as a bag has it."""
    t = np.arange(0.003, log["t_s"].iloc[-1], 1 / rate_hz)
    gyro = np.interp(t, log["t_s"], log["yaw_rate_true_radps"])
    gyro += 0.005 * np.random.default_rng(0).standard_normal(len(t))
    return pd.concat([log, pd.DataFrame(dict(t_s=t, gyro_radps=gyro))]).sort_values("t_s")


@pytest.fixture
def without_a_search(monkeypatch):
    """A calibration whose noise does not count takes the middle of the priors for the likeliest."""
    monkeypatch.setattr(Likelihood, "most_likely", lambda each: np.zeros(len(each.unknowns)))
    with four_headings():
        yield


@pytest.mark.usefixtures("without_a_search")
def test_a_bag_with_an_imu_is_calibrated():
    summary = rhec.log(with_imu(LOG[:300], 30.0), calibrate=True, trust_log=True)
    found = summary.calibration
    told = found.report["value"]
    # All are as many times as large, so that the gains are those of the likeliest noise.
    ratios = [
        found["sigma_gyro"][0] / told["noise of the gyro"],
        found["sigma_v"][2] / told["noise of ν"],
        found["sigma_w"][1] / told["walk of κ"],
        found["slip"][1] / told["slip in turning, share of ω"],
    ]
    assert ratios == pytest.approx([ratios[0]] * 4) and ratios[0] > 1
    assert found["slip"][-1] == told["side slip"]
    assert all(line in summary.details for line in str(found).splitlines())


@pytest.mark.usefixtures("without_a_search")
def test_the_delay_is_measured_without_the_noise():
    log = recorded_log(10.0, 60.0, noise_m=0.02, seed=5, arm_m=(0.6, -0.2))
    found = rhec.calibrate(late(log, 3), trust_log=True)
    row = found.report.loc["delay of the positions"]
    assert any("position_delay_s" in remark for remark in found.remarks)
    assert row["low"] < 0.3 < row["high"]
    assert row["value"] == pytest.approx(0.3, abs=0.05)


@pytest.mark.usefixtures("without_a_search")
def test_noise_that_the_receiver_declares_is_the_noise_that_ros_gets():
    """Its errors wander for minutes, which no log shows: 0.02 m of them is white noise."""
    log = recorded_log(5.0, 75.0, noise_m=0.02, seed=3).assign(position_sigma_m=0.8)
    found = rhec.calibrate(log)
    assert found.report.loc["noise of the position", "value"] == pytest.approx(0.8)
    assert found["sigma_v"][0] == pytest.approx(0.8, rel=0.01)


# Gaps and delays of the example log


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


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("silence_s", [60.0, 5.0])
def test_a_silence_keeps_the_traction_and_the_yaw(silence_s):
    """While the robot stands the log is off: after it, nothing begins anew."""
    stands = EXAMPLE.query("segment == 0 and 33.9 < t_s < 34.6").index
    before, after = EXAMPLE[: stands[0]], EXAMPLE[stands[-1] : stands[-1] + 200]
    after = after.assign(t_s=after["t_s"] + silence_s)
    result = rhec.replay(pd.concat([before, after], ignore_index=True), smooth=False)
    assert result["segment"].nunique() == 1 and np.isfinite(result[ESTIMATE]).all(axis=None)
    last, first = result.iloc[len(before) - 1], result.iloc[len(before) + 2]
    assert abs(first["mu_hat"] - last["mu_hat"]) < 0.02
    assert abs(first["kappa_hat"] - last["kappa_hat"]) < 0.05
    assert first["sigma_kappa"] < 0.5 * result["sigma_kappa"].iloc[0]
    error = yaw_error(result)
    assert abs(error.iloc[len(before) + 2]) < 2 * first["sigma_theta_rad"]
    assert error.iloc[-50:].abs().max() < 0.1
