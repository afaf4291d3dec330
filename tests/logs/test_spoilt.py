"""What loggers, bags and tools do to a log: each is named as what it is, once; and true logs pass.

The logs are simulated, with an antenna that may be away from the centre.
"""

import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log

import rhec
from rhec.logs import path_checks
from rhec.logs.recording import prepare, travelled

LOG = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)
STOPS = recorded_log(10.0, 150.0, noise_m=0.02, seed=4)


def codes(log, **arguments):
    return [finding.code for finding in rhec.doctor(log, **arguments).findings]


def with_imu(log, rate_hz=60.0):
    """A log with a row of its own for each sample of an IMU, as a bag has it."""
    t = np.arange(0.003, log["t_s"].iloc[-1], 1 / rate_hz)
    gyro = np.interp(t, log["t_s"], log["yaw_rate_true_radps"])
    gyro += 0.005 * np.random.default_rng(0).standard_normal(len(t))
    return pd.concat([log, pd.DataFrame(dict(t_s=t, gyro_radps=gyro))]).sort_values("t_s")


def in_pairs(log, offset_s):
    """A log whose positions stand in rows of their own, by a clock that is ahead."""
    encoders = log[["t_s", "speed_mps", "yaw_rate_radps"]]
    positions = log[["t_s", "x_m", "y_m"]].assign(t_s=log["t_s"] + offset_s)
    return pd.concat([encoders, positions]).sort_values("t_s", ignore_index=True)


def test_rows_of_other_sensors_do_not_shorten_the_drive():
    """A bag counts the metres and turns of its encoders, however often its IMU speaks."""
    alone, among = (prepare(log).rows for log in (LOG, with_imu(LOG)))
    for column in ("nu_meas_mps", "omega_meas_radps"):
        way = travelled(alone, column)
        assert way == pytest.approx(0.1 * alone[column].abs().sum(), rel=0.01)
        assert travelled(among, column) == pytest.approx(way, rel=1e-9)
    assert travelled(among, "omega_meas_radps", 4.0) > 10


def test_a_bag_with_an_imu_is_calibrated():
    found = rhec.calibrate(with_imu(LOG[:500], 30.0), trust_log=True)
    assert "noise of the gyro" in found.report.index


@pytest.mark.parametrize("offset_s", [18, -18, 37])
def test_positions_by_another_clock_are_used_with_its_offset(offset_s):
    spoilt = in_pairs(STOPS, offset_s)
    with pytest.raises(ValueError, match=f"position_delay_s={offset_s} corrects this$"):
        rhec.replay(spoilt)
    told = rhec.replay(spoilt, position_delay_s=offset_s, first_yaw_rad=0.4)
    assert told["kappa_hat"].iloc[-1] == pytest.approx(0.75, abs=0.05)


def test_a_clock_of_its_own_rate_of_rows_is_no_other_clock():
    assert "clock_offset" not in codes(in_pairs(STOPS, 0.05))


def test_two_files_pasted_together_are_two_drives():
    again = LOG.assign(x_m=LOG["x_m"] + 20.0)
    pasted = pd.concat([LOG, again], ignore_index=True)
    assert rhec.replay(pasted, trust_log=True)["segment"].nunique() == 2


@pytest.mark.parametrize("flag", ["pos_ok", "encoders_ok"])
def test_words_in_place_of_a_flag_are_named(flag):
    log = LOG.assign(**{flag: np.where(LOG.index % 3, "FIX", "SINGLE")})
    with pytest.raises(ValueError, match=f"{flag} had the words 'SINGLE', 'FIX'; it should be 1"):
        rhec.replay(log)
    assert codes(log) == ["unusable"]


def test_how_many_positions_count_is_always_said():
    assert rhec.doctor(LOG).facts["positions_usable"] == 1
    few = rhec.doctor(LOG.assign(pos_ok=LOG.index % 4 == 0))
    assert few.facts["positions_usable"] == pytest.approx(0.25, abs=0.01)
    assert [finding.code for finding in few.findings] == ["few_positions"]
    none = LOG.assign(pos_ok=0)
    assert "no_positions" in codes(none)
    with pytest.raises(ValueError, match="pos_ok is true in none of 1500 rows with a position"):
        rhec.replay(none)


def test_a_straight_path_is_not_interpolated():
    straight = LOG.assign(x_m=0.045 * LOG.index, y_m=0.0, yaw_rate_radps=0.0, speed_mps=0.5)
    assert "interpolated_positions" not in codes(straight)


@pytest.mark.parametrize("arm_m", [(0.0, 0.0), (0.6, 0.0), (-0.5, 0.2)])
@pytest.mark.parametrize("seed", [5, 6, 7])
def test_a_lever_arm_is_no_delay(arm_m, seed):
    log = recorded_log(10.0, 150.0, noise_m=0.02, seed=seed, arm_m=arm_m)
    assert codes(log) == []
    motion = path_checks._motion(prepare(log).rows)
    assert abs(motion.delay_s) < 0.1


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("delay_s", [0.3, 0.0])
def test_calibration_measures_the_delay_beside_the_lever_arm(delay_s):
    log = recorded_log(10.0, 150.0, noise_m=0.02, seed=5, arm_m=(0.6, -0.2))
    log[["x_m", "y_m"]] = log[["x_m", "y_m"]].shift(round(10 * delay_s))
    found = rhec.calibrate(log, trust_log=True)
    row = found.terms.loc["delay of the positions"]
    assert any("position_delay_s" in remark for remark in found.remarks) == (delay_s > 0)
    assert row["low"] < delay_s < row["high"] and row["high"] - row["low"] < 0.3
    assert row["value"] == pytest.approx(delay_s, abs=0.05)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_white_noise_does_not_wander(seed):
    """As that of PPK: all positions are used, and the lever arm is known by them."""
    log = recorded_log(5.0, 300.0, noise_m=0.02, seed=seed, arm_m=(0.6, -0.2))
    found = rhec.calibrate(log)
    assert not any("wander" in remark for remark in found.remarks)
    np.testing.assert_allclose(found["lever_arm_m"], (0.6, -0.2), atol=0.03)


def test_noise_that_the_receiver_declares_is_the_noise_that_ros_gets():
    """Its errors wander for minutes, which no log shows: 0.02 m of them is white noise."""
    log = recorded_log(5.0, 150.0, noise_m=0.02, seed=3).assign(position_sigma_m=0.8)
    found = rhec.calibrate(log)
    assert found.terms.loc["GNSS noise", "value"] == pytest.approx(0.8)
    assert found["sigma_v"][0] == pytest.approx(0.8, rel=0.01)
