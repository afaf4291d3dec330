"""Calibration of a recorded robot by its log alone; what a replay says of its log."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log
from spoilt_logs import four_headings, late

import rhec
from rhec.logs import calibration
from rhec.logs.causes import tried
from rhec.logs.filtering import OUTLIER
from rhec.logs.likelihood import Likelihood
from rhec.logs.recording import prepare

ARM_M = (0.25, -0.1)
# What is printed of a log with this antenna.
PRINTED = """
                               value      low     high    unit  determined
noise of the position        0.03162  0.02966  0.03372       m        True
noise of ν                  0.008842 0.002563  0.03051     m/s       False
noise of ω                  0.005458 0.001345  0.02215   rad/s       False
walk of μ                   0.003523 0.002177 0.005704    1/√m       False
walk of κ                   0.005531 0.003428 0.008925    1/√m       False
slip ahead, share of ν        0.0366  0.02206  0.06072       -        True
slip in turning, share of ω  0.03007   0.0114  0.07934       -       False
slip sideways, share of bω   0.08382  0.02395   0.2934       -       False
bumps                       0.006812 0.002791  0.01663  rad/√m       False
side slip                     0.0144        0  0.03222       s        True
antenna ahead                 0.2396   0.2262   0.2529       m        True
antenna left                 -0.1009  -0.1123 -0.08943       m        True
delay of the positions       0.00901 -0.04757  0.06559       s        True
"""


@pytest.fixture(scope="module")
def calibrated():
    """A log, the antenna off the centre, and its calibration."""
    log = recorded_log(5.0, 80.0, noise_m=0.03, seed=3, arm_m=ARM_M)
    return log, rhec.calibrate(log)


def test_hubers_loss_shrinks_a_deviation_as_the_report_corrects():
    distances = np.sqrt(np.random.default_rng(0).chisquare(2, 1_000_000))
    u = distances / calibration._HUBER_SHRINKS
    assert np.minimum(u**2, OUTLIER * u).mean() == pytest.approx(2, rel=3e-3)


@pytest.mark.nightly
def test_positions_are_never_taken_to_be_better_than_receivers_are():
    """Positions of a log may have been smoothed; what is wrong with them then is no slip."""
    found = rhec.calibrate(recorded_log(5.0, 60.0, arm_m=ARM_M))
    told = found.report.loc["noise of the position"]
    # What is assumed at least was not measured, and the report says so.
    assert told["value"] == 0.02 and told["low"] == 0 and not told["determined"]
    assert "does not determine: noise of the position" in str(found)
    assert found["slip"][0] < 0.1 and found["slip"][2] < 0.06


@pytest.mark.nightly
def test_calibration_finds_the_noise_of_a_gyro():
    log = recorded_log(5.0, 120.0, noise_m=0.03)
    noise = 0.03 * np.random.default_rng(2).standard_normal(len(log))
    found = rhec.calibrate(log.assign(gyro_radps=log["yaw_rate_true_radps"] + noise))
    told = found.report.loc["noise of the gyro"]
    # At 5 Hz a sample's mean is that of two readings.
    assert told["determined"] and told["value"] == pytest.approx(0.03 / np.sqrt(2), rel=0.2)


def test_a_calibration_prints_what_is_documented_here(calibrated):
    """Many of its numbers were tuned: whoever changes one sees here what follows for a user.

    They are compared to a tenth, because a search ends elsewhere on other processors.
    """
    _, found = calibrated
    printed, _ = str(found).split("\nThe log does not determine: ")
    for one, other in zip(printed.split(), PRINTED.split(), strict=True):
        assert one == other or float(one) == pytest.approx(float(other), rel=0.1, abs=5e-4)
    assert found["sigma_v"][0] == pytest.approx(0.047, rel=0.1)
    np.testing.assert_allclose(found["lever_arm_m"], ARM_M, atol=0.03)


def test_replay_takes_a_calibration_and_is_better_for_it(calibrated):
    log, found = calibrated
    errors = [
        (result["theta_hat_rad"] - result["theta_rad"])[len(log) // 4 :].abs().mean()
        for result in (rhec.replay(log, first_yaw_rad=0.4, **how) for how in ({}, found))
    ]
    assert errors[1] < errors[0]


def test_a_hypothesis_that_holds_takes_the_place_of_what_was_assumed():
    hypotheses = (
        lambda log, best: (best + log, "more"),
        lambda log, best: None,
        lambda log, best: (10 * best, "ten times"),
    )
    assert [*tried(hypotheses, 2, 1)] == [(3, "more"), (30, "ten times")]


# {hypothesis: {its case: whether it holds}}, in the order of `calibration`
HYPOTHESES = {
    "late [s], σ [s]": {(0.11, 0.05): True, (0.09, 0.01): False, (0.2, 0.11): False},
    "wander [s], noise [times]": {(157.0, 1.52): True, (157.0, 1.48): False, (155.0, 1.52): False},
    "worse [times], errors": {(1.167, 6): True, (1.158, 6): False, (1.5, 5): False},
}


@pytest.mark.parametrize("what", HYPOTHESES)
def test_a_hypothesis_holds_from_an_amount_on(what, monkeypatch):
    """The search finds the middle of the priors and, where few positions count, so much noise.

    The errors of hidden positions are 2 cm by the defaults, and scatter by a tenth.
    """
    hypothesis = dict(zip(HYPOTHESES, calibration._HYPOTHESES))[what]

    def likeliest(each):
        few_count = np.isfinite(each.segments[0][:, 0]).mean() < 0.5
        return np.eye(len(each.unknowns))[0] * few_count * np.log(other) / np.log(3.0)

    monkeypatch.setattr(Likelihood, "most_likely", likeliest)
    monkeypatch.setattr(calibration, "hidden_errors", lambda *_: next(errors))
    for (amount, other), holds in HYPOTHESES[what].items():
        duration_s = amount if "wander" in what else 20.0
        recording = prepare(recorded_log(5.0, duration_s, noise_m=0.02))
        scatter = 0.02 + 0.002 * (-1.0) ** np.arange(int(other))
        errors = (
            pd.DataFrame(dict(error_m=each)) for each in (amount * scatter, [0.02] * int(other))
        )
        log = calibration._Log(recording, [0.4], 0.0, 0.0, (amount, other))
        found = hypothesis(log, calibration._fitted(log, 0.0))
        assert (found is not None) == holds, (amount, other)
        if found:
            keeps_defaults = "sigma_v" not in calibration._arguments(log, found[0])
            assert keeps_defaults == ("worse" in what)


def test_a_sample_that_does_not_count_may_have_no_loss():
    """As where an estimator has not found its way yet."""
    recorded = [dict(loss=np.array([np.nan, 2.0])), dict(loss=np.array([np.inf, 3.0]))]
    counts = [np.array([False, True])] * 2
    searched = SimpleNamespace(filtered=lambda x: recorded, counts=counts)
    assert [each.tolist() for each in Likelihood.losses(searched, None)] == [[0, 2], [0, 3]]


# Without the search, which takes long


@pytest.fixture
def without_a_search(monkeypatch):
    """A calibration whose noise does not count takes the middle of the priors for the likeliest."""
    monkeypatch.setattr(Likelihood, "most_likely", lambda each: np.zeros(len(each.unknowns)))
    with four_headings():
        yield


@pytest.mark.usefixtures("without_a_search")
def test_a_gyro_is_calibrated_with_the_rest():
    log = recorded_log(10.0, 150.0, noise_m=0.02, seed=3)[:300]
    gyro = log["yaw_rate_true_radps"] + 0.005 * np.random.default_rng(0).standard_normal(300)
    summary = rhec.log(log.assign(gyro_radps=gyro), calibrate=True, trust_log=True)
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
    assert {"gyro bias", "noise of the position"} <= {*summary.parameters.index}
    assert all(line in summary.details for line in str(found).splitlines())


@pytest.mark.usefixtures("without_a_search")
def test_a_delay_is_measured_and_made_up_for():
    log = recorded_log(10.0, 60.0, noise_m=0.02, seed=5, arm_m=(0.6, -0.2))
    summary = rhec.log(late(log, 3), calibrate=True, trust_log=True)
    found = summary.calibration
    assert summary.judged.first.lever_arm_m == found["lever_arm_m"]
    off_m = np.hypot(*(summary.estimates[f"{name}_hat_m"] - log[f"{name}_true_m"] for name in "xy"))
    assert off_m.median() < 0.05
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
