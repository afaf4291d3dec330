"""The σ of a yaw is honest: it is large where the robot slips sideways, and small where not.

The oracle is simulated: a robot whose velocity follows that of its tracks with a delay, as on ice.
"""

import numpy as np
import pandas as pd
import pytest
from helpers import may_be_unsure, recorded_log, warns_of_an_unknown_yaw

import rhec
from rhec.logs import course
from rhec.logs.position_noise import position_sigma_m
from rhec.logs.recording import prepare
from rhec.logs.replay import estimate_samples, replay_scenario

UNSURE_RAD = 0.25
DT_S = 0.01


def on_ice(follows_s, seed, duration_s=240.0):
    """A log at 5 Hz of a robot that gets to the velocity of its tracks after follows_s [s]."""
    generator = np.random.default_rng(seed)
    n = round(duration_s / DT_S)
    held = round(6.0 / DT_S)
    speed, yaw_rate = (
        np.repeat(generator.uniform(*limits, n // held + 1), held)[:n]
        for limits in ((-0.5, 2.0), (-1.2, 1.2))
    )
    yaw, place, velocity, turning, nu, omega = 0.3, 0j, 0j, 0.0, 0.0, 0.0
    rows = []
    for k in range(n):
        nu += DT_S / 0.5 * (speed[k] - nu)
        omega += DT_S / 0.5 * (yaw_rate[k] - omega)
        if k % 20 == 0:
            rows.append((k * DT_S, place.real, place.imag, nu, omega, yaw))
        velocity += DT_S / follows_s * (0.95 * nu * np.exp(1j * yaw) - velocity)
        turning += DT_S / (follows_s / 2) * (0.5 * omega - turning)
        place += DT_S * velocity
        yaw += DT_S * turning
    names = ["t_s", "x_m", "y_m", "speed_mps", "yaw_rate_radps", "yaw_true_rad"]
    log = pd.DataFrame(rows, columns=names)
    log[["x_m", "y_m"]] += 0.02 * generator.standard_normal((len(log), 2))
    return log


def yaw_error(estimates):
    difference = estimates["theta_hat_rad"] - estimates["theta_rad"]
    return ((difference + np.pi) % (2 * np.pi) - np.pi).abs()


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("follows_s, seed", [(2.0, 21), (1.0, 20), (4.0, 22)])
def test_on_ice_a_wrong_yaw_is_an_uncertain_one(follows_s, seed, smooth):
    with pytest.warns(UserWarning, match="^The yaw is not known to .* slips sideways"):
        result = rhec.replay(on_ice(follows_s, seed), smooth=smooth, trust_log=True)
    error = yaw_error(result)
    is_bad = error > 0.5
    flagged = (result["sigma_theta_rad"] > UNSURE_RAD) | ~result["ok"]
    assert is_bad.sum() > 30 and flagged[is_bad].mean() > 0.95
    assert (error < 1.96 * result["sigma_theta_rad"]).mean() > 0.9


@may_be_unsure  # before the antenna's place is known
@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("noise_m", [0.003, 0.03])
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("arm_m", [(0.3, -0.1), (0.0, 0.0)])
def test_a_robot_that_does_not_slip_is_not_doubted(seed, noise_m, arm_m):
    """As with PPK, also off the centre of turning, where the antenna swings."""
    log = recorded_log(5.0, 120.0, noise_m=noise_m, seed=seed, arm_m=arm_m)
    result = rhec.replay(log, smooth=False)
    good = yaw_error(result) < 0.2
    assert good.mean() > 0.95
    assert (result["sigma_theta_rad"][good] > UNSURE_RAD).mean() < 0.15
    assert (result["sigma_by_course_rad"] == 0)[log["t_s"] > 30].mean() > 0.9


def test_noise_of_positions_is_no_side_slip():
    log = recorded_log(5.0, 120.0, noise_m=0.3, seed=4)
    result = rhec.replay(log, first_yaw_rad=0.4, smooth=False)
    assert (result["sigma_by_course_rad"] == 0).mean() > 0.8


@may_be_unsure
def test_a_heading_is_believed_on_ice():
    log = on_ice(2.0, 21, duration_s=120.0).assign(heading_rad=lambda each: each["yaw_true_rad"])
    result = rhec.replay(log, trust_log=True, smooth=False)
    assert (result["sigma_by_course_rad"] == 0).all()
    assert yaw_error(result).max() < 0.5


@pytest.mark.parametrize("turned", [0.0, np.pi])
def test_a_yaw_held_for_sure_is_doubted_where_it_is_wrong(turned):
    """By half a turn: it is unknown until it is found, and the right one never is."""
    given = dict(first_yaw_rad=0.4 + turned, sigma_yaw_rad=0.01, smooth=False)
    log = recorded_log(noise_m=0.02)
    if not turned:
        result = rhec.replay(log, **given)  # without a warning
        assert (result["sigma_theta_rad"] < UNSURE_RAD).all()
        return
    with warns_of_an_unknown_yaw():
        result = rhec.replay(log, **given)
    flagged = (result["sigma_theta_rad"] > UNSURE_RAD) | ~result["ok"]
    assert flagged[yaw_error(result) > 0.5].mean() > 0.5
    assert yaw_error(result).iloc[-1] < 0.1


@pytest.fixture(scope="module")
def on_its_way():
    """{whether the robot slips: samples of a replay, and the noise of the positions [m]}."""
    logs = {True: on_ice(2.0, 21), False: recorded_log(5.0, 120.0, noise_m=0.03, seed=1)}
    found = {}
    for slips, log in logs.items():
        recording = prepare(log)
        samples = estimate_samples(recording, replay_scenario("rhe", recording, {}))
        found[slips] = samples, position_sigma_m(recording.rows)
    return found


@may_be_unsure
@pytest.mark.nightly
@pytest.mark.parametrize("times", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("name", course.Tuned._fields)
def test_no_number_of_the_course_is_tuned_finely(on_its_way, monkeypatch, name, times):
    tuned = course.Tuned()
    changed = type(getattr(tuned, name))(times * getattr(tuned, name))
    monkeypatch.setattr(course, "TUNED", tuned._replace(**{name: changed}))
    for slips, (samples, noise_m) in on_its_way.items():
        sigma = course.yaw_sigma_rad(samples, noise_m)
        error = yaw_error(samples)
        if slips:
            assert (sigma[error > 0.5] > UNSURE_RAD).mean() > 0.9
        else:
            assert (sigma[error < 0.2] > UNSURE_RAD).mean() < 0.15


def test_some_outliers_are_no_side_slip():
    log = recorded_log(noise_m=0.02)
    log.loc[200:280:8, ["x_m", "y_m"]] += 2.0
    assert (rhec.replay(log, first_yaw_rad=0.4)["sigma_theta_rad"] < UNSURE_RAD).all()


@may_be_unsure
def test_what_comes_later_changes_no_sigma():
    log = on_ice(2.0, 23, 120.0)
    given = dict(first_yaw_rad=0.3, smooth=False, trust_log=True)
    whole = rhec.replay(log, **given)["sigma_theta_rad"]
    part = rhec.replay(log[:400], **given)["sigma_theta_rad"]
    np.testing.assert_array_equal(part, whole[:400])
