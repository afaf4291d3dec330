"""The σ of a yaw is honest: it is large where the robot slips sideways, and small where not.

The oracle is simulated: a robot whose velocity follows that of its tracks with a delay, as on ice.
"""

import numpy as np
import pandas as pd
import pytest
from helpers import KAPPA, may_be_unsure, recorded_log, warns_of_an_unknown_yaw
from scipy.signal import lfilter

import rhec
from notebooks.further.recorded import verdicts
from rhec import paper
from rhec.logs import course
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS

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


@pytest.mark.nightly(keep=1)
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
@pytest.mark.nightly(keep=1)
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


def test_a_gyro_that_is_off_is_no_side_slip():
    """By its bias and its scale, which are estimated."""
    log = recorded_log(5.0, 120.0, noise_m=0.003, seed=1)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(len(log))
    log["gyro_radps"] = 1.2 * KAPPA * log["yaw_rate_radps"] + 0.03 + noise
    result = rhec.replay(log, smooth=False)
    assert result["gyro_accepted"].mean() > 0.9
    assert (result["sigma_by_course_rad"] == 0)[log["t_s"] > 30].mean() > 0.9


@may_be_unsure
def test_a_heading_is_believed_on_ice():
    log = on_ice(2.0, 21, duration_s=60.0).assign(heading_rad=lambda each: each["yaw_true_rad"])
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


def driven(sigma_rad, tau_s, noise_m, seed=0, speed_mps=0.6, duration_s=1200.0):
    """Samples of an estimator that takes the course for the yaw, of a robot that slips sideways.

    The slip is a Gauss-Markov process of deviation sigma_rad and time constant tau_s, and all of
    it is an error of the yaw.
    """
    rng = np.random.default_rng(seed)
    n = round(duration_s / paper.DT_S)
    turning = 0.3 * np.sin(0.05 * paper.DT_S * np.arange(n))
    yaw = np.cumsum(paper.DT_S * turning)
    a = np.exp(-paper.DT_S / tau_s)
    steps = sigma_rad * np.sqrt(1 - a**2) * rng.standard_normal(n)
    steps[0] /= np.sqrt(1 - a**2)
    slip = lfilter([1], [1, -a], steps)
    place = np.cumsum(paper.DT_S * speed_mps * np.exp(1j * (yaw + slip)))
    place = place + noise_m * (rng.standard_normal((2, n)).T @ [1, 1j])
    samples = pd.DataFrame(dict(zip(MEASUREMENTS, (place.real, place.imag, speed_mps, turning))))
    samples[ESTIMATE] = 1.0
    samples[ESTIMATE[2]] = yaw + slip
    return samples.assign(position_accepted=1), slip


@pytest.mark.nightly(keep=3)
@pytest.mark.parametrize(
    "sigma_rad, tau_s", [(0.2, 2.0), (0.4, 25.0), (0.4, 2.0), (0.2, 10.0), (0.4, 10.0)]
)
def test_side_slip_that_comes_and_goes_is_in_the_sigma(sigma_rad, tau_s):
    """Whether it lasts for seconds or for half a minute, of which pieces of the course show 8 %."""
    inside = []
    for seed in range(5):
        samples, slip = driven(sigma_rad, tau_s, 0.02, seed)
        sigma = course.yaw_sigma_rad(samples, 0.02)[600:]
        inside.append((np.abs(slip[600:]) <= 1.96 * sigma).mean())
        assert np.sqrt((sigma**2).mean()) < 4 * sigma_rad
    assert np.mean(inside) > 0.9


@pytest.mark.parametrize(
    "bumps_rad, noise_m, speed_mps",
    [(0.0, 0.02, 0.6), (0.0, 0.1, 0.6), (0.0, 0.3, 0.6), (0.0, 0.02, 0.1), (0.05, 0.02, 0.6)],
)
def test_white_noise_of_positions_and_bumps_are_no_side_slip(bumps_rad, noise_m, speed_mps):
    """Also where a piece of the path is hardly longer than the noise turns it."""
    for seed in range(3):
        samples, _ = driven(bumps_rad, 0.5, noise_m, seed, speed_mps)
        assert (course.yaw_sigma_rad(samples, noise_m) == 0).mean() > 0.95


@pytest.mark.parametrize("offset_rad, sigma_rad", [(0.7, 0.0), (1.5, 1.28)])
def test_a_yaw_that_is_not_along_the_course_is_doubted(offset_rad, sigma_rad):
    """By √(offset² - (π/4)²); an antenna or slip may explain less."""
    samples, _ = driven(0.0, 1.0, 0.02)
    samples[ESTIMATE[2]] += offset_rad
    sigma = course.yaw_sigma_rad(samples, 0.02)[600:]
    np.testing.assert_allclose(sigma, sigma_rad, atol=0.05)


def test_a_slip_that_begins_is_seen_within_a_minute():
    before, _ = driven(0.0, 10.0, 0.02, 0, duration_s=300.0)
    after, slip = driven(0.4, 10.0, 0.02, 1, duration_s=300.0)
    place = before[MEASUREMENTS[:2]].iloc[-1]
    after[MEASUREMENTS[:2]] += place.to_numpy()
    sigma = course.yaw_sigma_rad(pd.concat([before, after], ignore_index=True), 0.02)
    assert (sigma[:1500] == 0).all() and (sigma[1800:] > 0.25).mean() > 0.9


def test_a_robot_that_turns_back_does_not_slip_sideways():
    """Its way over 2 s is short there, and the course of that says nothing."""
    result = rhec.replay(verdicts.open_loop_log(560_004), smooth=False, trust_log=True)
    assert (result["sigma_by_course_rad"] > UNSURE_RAD).mean() < 0.02


def test_some_outliers_are_no_side_slip():
    log = recorded_log(noise_m=0.02)
    log.loc[200:280:8, ["x_m", "y_m"]] += 2.0
    assert (rhec.replay(log, first_yaw_rad=0.4)["sigma_theta_rad"] < UNSURE_RAD).all()
