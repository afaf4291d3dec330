"""Calibration of a Model by a log that was simulated with known noise and parameters."""

import casadi as ca
import numpy as np
import pandas as pd
import pytest

import rhec

MU, KAPPA, DT_S = 0.9, 0.8, 0.2
SIGMA_V = (0.03, 0.03, 0.04, 0.02)
MODEL = rhec.Model(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("speed_mps", "yaw_rate_radps"),
    parameters={"mu": (0, 1), "kappa": (0, 1)},
    outputs=("x_m", "y_m", "speed_mps", "yaw_rate_radps"),
    f=lambda x, u, p: ca.vertcat(
        p[0] * u[0] * ca.cos(x[2]), p[0] * u[0] * ca.sin(x[2]), p[1] * u[1]
    ),
)
GUESSED = dict(
    model=MODEL,
    dt=DT_S,
    sigma_v=(0.1, 0.01, 0.02, 0.05),
    sigma_w=(0.002, 0.002, 0.001, 0.0, 0.0),
    guess=(0.0, 0.0, 0.4, 1.0, 1.0),
    sigma_guess=(0.3, 0.3, 0.3, 0.2, 0.2),
)


def drive(seed, n=800):
    """A log with the noise SIGMA_V, and the true positions (n, 2)."""
    noise = np.random.default_rng(seed).standard_normal((n, 4)) * SIGMA_V
    t = DT_S * np.arange(n)
    omega = 0.4 * np.sin(0.2 * t + seed)
    yaw = np.append(0.4, 0.4 + np.cumsum(KAPPA * omega[1:] * DT_S))
    middle = (yaw[1:] + yaw[:-1]) / 2
    step = MU * 0.6 * DT_S * np.exp(1j * middle)
    place = np.append(0, np.cumsum(step))
    truth = np.column_stack([place.real, place.imag])
    values = np.column_stack([truth, np.full(n, 0.6), omega]) + noise
    return pd.DataFrame(values, columns=MODEL.outputs).assign(t_s=t), truth


@pytest.fixture(scope="module")
def calibrated():
    return rhec.calibrate(drive(0)[0], **GUESSED)


def test_the_noise_of_each_output_is_found(calibrated):
    np.testing.assert_allclose(calibrated["sigma_v"][:2], SIGMA_V[:2], rtol=0.15)
    report = calibrated.report
    for name, sigma in zip(MODEL.outputs, SIGMA_V):
        row = report.loc[f"noise of {name}"]
        assert row["low"] < row["value"] < row["high"]
        assert row["low"] / 1.1 < sigma < row["high"] * 1.1
    assert report.loc[["noise of x_m", "noise of y_m"], "determined"].all()


def test_parameters_are_reported_and_zeros_remain(calibrated):
    for name, true in (("mu", MU), ("kappa", KAPPA)):
        row = calibrated.report.loc[name]
        assert row["low"] - 0.01 < true < row["high"] + 0.01
        assert row["determined"]
    assert calibrated["sigma_w"][3:] == (0.0, 0.0)
    assert "process noise of mu" not in calibrated.report.index
    assert "noise of x_m" in str(calibrated)


def test_a_replay_takes_a_calibration_and_becomes_better(calibrated):
    log, truth = drive(1)
    guessed, better = (
        rhec.replay(log, "ekf", **given)[["x_m_hat", "y_m_hat"]] for given in (GUESSED, calibrated)
    )
    off = [np.sqrt(np.mean((each.to_numpy() - truth)[100:] ** 2)) for each in (guessed, better)]
    assert off[1] < 0.9 * off[0]


def test_outliers_do_not_pass_for_noise():
    log, _ = drive(2, 500)
    random = np.random.default_rng(7)
    struck = random.choice(np.arange(20, len(log)), 8, replace=False)
    log.loc[struck, ["x_m", "y_m"]] += random.uniform(-5, 5, (8, 2))
    found = rhec.calibrate(log, **GUESSED)
    np.testing.assert_allclose(found["sigma_v"][:2], SIGMA_V[:2], rtol=0.25)


def test_delays_are_told_to_calibration_and_replay():
    log, _ = drive(3, 500)
    log[["x_m", "y_m"]] = log[["x_m", "y_m"]].shift(5)
    found = rhec.calibrate(log, **GUESSED, delays_s=dict(x_m=1.0, y_m=1.0))
    np.testing.assert_allclose(found["sigma_v"][:2], SIGMA_V[:2], rtol=0.15)
    assert found["delays_s"] == dict(x_m=1.0, y_m=1.0)


@pytest.mark.parametrize(
    "given, sentence",
    [
        (dict(horizn=5), "^calibrate has no parameter 'horizn'; with a model it takes dt, sigma_v"),
        (dict(sigma_v=(0.1,)), "^sigma_v was"),
        (dict(track_width_m=0.5), "^track_width_m was 0.5; a replay with a model does not take it"),
        (dict(model=None), "^calibrate has no parameter 'dt' without a model"),
        (dict(delays_s=dict(x=1.0)), "^delays_s named 'x'"),
        (dict(log=drive(0, 30)[0]), "^the log had 30 samples with a measurement of x_m, y_m; "),
    ],
)
def test_what_cannot_be_calibrated_is_refused_in_a_sentence(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        rhec.calibrate(**dict(log=drive(0, 60)[0]) | GUESSED | given)
