"""Replay and calibration of any Model, by logs of robots that were simulated as it says."""

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from helpers import assert_refused
from scipy.integrate import cumulative_trapezoid

import rhec
from rhec.logs.likelihood import Likelihood

# Replay

UNICYCLE = rhec.Model(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("speed_mps", "yaw_rate_radps"),
    parameters={},
    outputs=("x_m", "y_m", "speed_mps", "yaw_rate_radps"),
    f=lambda x, u, p: ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1]),
)
OF_UNICYCLE = dict(
    model=UNICYCLE,
    dt=0.5,
    horizon=6,
    sigma_v=(0.02, 0.02, 0.01, 0.01),
    sigma_w=(0.001, 0.001, 0.001),
    guess=(0.0, 0.0, 0.4),
    sigma_guess=(0.1, 0.1, 0.2),
)


def curve(rate_hz):
    """A log of a unicycle in a curve, faster and slower, with means of its speed between rows."""
    fine_s = np.arange(0, 20, 0.001)
    yaw = 0.4 + 0.1 * fine_s
    speed = 0.5 + 0.3 * np.sin(0.8 * fine_s)
    way = cumulative_trapezoid(speed, fine_s, initial=0)
    place = cumulative_trapezoid(speed * np.exp(1j * yaw), fine_s, initial=0)
    t = np.arange(0, 20, 1 / rate_hz)
    x, y, yaw, way = (np.interp(t, fine_s, each) for each in (place.real, place.imag, yaw, way))
    means = np.diff(way, prepend=-0.5 / rate_hz) * rate_hz
    return pd.DataFrame(dict(t_s=t, x_m=x, y_m=y, speed_mps=means, yaw_rate_radps=0.1, yaw=yaw))


@pytest.mark.parametrize("estimator", ["ekf", "rhe"])
@pytest.mark.parametrize(
    "rate_hz, every, delays_s",
    [
        (5.0, {}, {}),
        (8.0, {}, {}),
        (42.0, dict(speed_mps=6, yaw_rate_radps=84, x_m=14, y_m=14), {}),
        (20.0, {}, dict(x_m=0.7, y_m=0.7)),
        (20.0, {}, dict(speed_mps=1.2, y_m=-0.3)),
    ],
)
def test_a_models_estimates_are_at_each_rows_own_time(estimator, rate_hz, every, delays_s):
    """Whatever rate each output has, and whatever its delay is if that is told."""
    truth = curve(rate_hz)
    log = truth.copy()
    for name, delay_s in delays_s.items():
        log[name] = np.interp(truth["t_s"] - delay_s, truth["t_s"], truth[name])
    for name, rows in every.items():
        log[name] = log[name].where(log.index % rows == 0)
    given = {name: value for name, value in OF_UNICYCLE.items() if name != "horizon"}
    given = OF_UNICYCLE if estimator == "rhe" else given
    result = rhec.replay(log, estimator, delays_s=delays_s, **given)
    late = truth["t_s"].between(5, 18)
    for name, column in (("x_m", "x_m"), ("y_m", "y_m"), ("theta_rad", "yaw")):
        np.testing.assert_allclose(result[f"{name}_hat"][late], truth[column][late], atol=0.02)
    assert result["ok"].all() and (result["theta_rad_sigma"][late] < 0.2).all()


def test_arguments_of_a_models_replay():
    rows = [
        (dict(delays_s=dict(x=0.1)), "delays_s named 'x'; the model has the outputs x_m, y_m, sp"),
        (dict(delays_s=dict(x_m="late")), "delays_s"),
        (dict(estimator="bounded_ekf"), "estimator was 'bounded_ekf'; for a model it should be"),
        (dict(track_width_m=0.4), "track_width_m was 0.4; a replay with a model does not take it"),
        (dict(guess=(0.0,)), "guess was"),
        (dict(speed_model="input"), "…speed_model"),
        (dict(log=curve(2.0).drop(columns="speed_mps")), "the log had no column speed_mps"),
        (dict(log=curve(1.0)), "the log had rows 1 s apart …at most 0.5 s"),
        (dict(model="unicycle"), "model was 'unicycle'"),
    ]
    given = dict(log=curve(2.0)) | OF_UNICYCLE
    assert_refused(lambda **wrong: rhec.replay(**given | wrong), rows)


# Calibration, by a log with known noise and parameters

MU = 0.9
KAPPA = 0.8
DT_S = 0.25
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
    delays_s=dict(x_m=1.0, y_m=1.0),
)


def drive(seed, n=500, swing_radps=0.4):
    """A log with the noise SIGMA_V, positions stamped a second late, and the true ones (n, 2)."""
    noise = np.random.default_rng(seed).standard_normal((n, 4)) * SIGMA_V
    t = DT_S * np.arange(n)
    omega = swing_radps * np.sin(0.2 * t + seed)
    yaw = np.append(0.4, 0.4 + np.cumsum(KAPPA * omega[1:] * DT_S))
    middle = (yaw[1:] + yaw[:-1]) / 2
    step = MU * 0.6 * DT_S * np.exp(1j * middle)
    place = np.append(0, np.cumsum(step))
    truth = np.column_stack([place.real, place.imag])
    values = np.column_stack([truth, np.full(n, 0.6), omega]) + noise
    log = pd.DataFrame(values, columns=MODEL.outputs).assign(t_s=t)
    log[["x_m", "y_m"]] = log[["x_m", "y_m"]].shift(4)
    return log, truth


@pytest.fixture(scope="module")
def calibrated():
    """By a log with some outliers, which do not pass for noise."""
    log, _ = drive(0)
    random = np.random.default_rng(7)
    struck = random.choice(np.arange(20, len(log)), 8, replace=False)
    log.loc[struck, ["x_m", "y_m"]] += random.uniform(-5, 5, (8, 2))
    return rhec.calibrate(log, **GUESSED)


def test_the_noise_of_each_output_is_found(calibrated):
    np.testing.assert_allclose(calibrated["sigma_v"][:2], SIGMA_V[:2], rtol=0.2)
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


@pytest.mark.parametrize("swing_radps, is_determined", [(0.038, True), (0.032, False)])
def test_a_parameter_is_determined_where_the_log_halves_its_sigma(
    swing_radps, is_determined, monkeypatch
):
    """That of κ is 0.2 before the log, whose 50 samples are just enough. The noise is as given."""
    monkeypatch.setattr(Likelihood, "most_likely", lambda each: np.zeros(len(each.unknowns)))
    log, _ = drive(0, 54, swing_radps)
    row = rhec.calibrate(log, **GUESSED | dict(sigma_v=SIGMA_V)).report.loc["kappa"]
    sigma = (row["high"] - row["low"]) / (2 * 1.96)
    assert 0.08 < sigma < 0.12
    assert row["determined"] == is_determined == (sigma < 0.1)


def test_a_replay_takes_a_calibration_and_becomes_better(calibrated):
    log, truth = drive(1)
    guessed, better = (
        rhec.replay(log, "ekf", **given)[["x_m_hat", "y_m_hat"]] for given in (GUESSED, calibrated)
    )
    off = [np.sqrt(np.mean((each.to_numpy() - truth)[100:] ** 2)) for each in (guessed, better)]
    assert off[1] < 0.9 * off[0]


def test_what_cannot_be_calibrated_of_a_model():
    rows = [
        (dict(horizn=5), "calibrate has no parameter 'horizn'; with a model it takes dt, sigma_v"),
        (dict(sigma_v=(0.1,)), "sigma_v was"),
        (dict(model=None), "calibrate has no parameter 'dt' without a model"),
        (dict(log=drive(0, 53)[0]), "the log had 49 samples with a measurement of x_m, y"),
    ]
    given = dict(log=drive(0, 60)[0]) | GUESSED
    assert_refused(lambda **wrong: rhec.calibrate(**given | wrong), rows)
