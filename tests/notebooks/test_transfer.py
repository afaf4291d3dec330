"""The table of recorded robots, each left out once, and the rivals in it."""

import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log

from notebooks.further import transfer
from notebooks.further.recorded import rivals, scores
from rhec import paper
from rhec.tracked_robot.kinematics import SPEED_MODELS


def test_equal_tracks_and_a_centre_at_the_antenna_are_the_papers_model():
    """α of both tracks is μ; they roll about ±b/2 · μ/κ."""
    mu, kappa, b = 0.9, 0.6, 0.5
    y = b / 2 * mu / kappa
    model = SPEED_MODELS["input"].model
    rng = np.random.default_rng(0)
    for xi, (nu, omega) in zip(rng.normal(size=(5, 3)), rng.normal(size=(5, 2))):
        expected = model.dynamics(xi, [nu, omega], [mu, kappa])
        found = rivals.f(xi, [nu, omega, 0.0, 0.0, 0.0], [y, -y, 0.0, mu, mu, b / 2])
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_the_robot_turns_about_its_centres():
    """Over ground, the point x_v ahead has no side slip, and the left track's centre runs with the
    left track.
    """
    p, (nu, delta) = [0.4, -0.3, 0.2, 0.9, 0.8, 0.25], (0.7, 0.2)
    v = [nu, delta / 0.25, 0.0, 0.0, 0.0]
    ahead, side, turning = np.array(rivals.f([0.0, 0.0, 0.0], v, p)).ravel()
    assert side + 0.2 * turning == pytest.approx(0)
    assert ahead - 0.4 * turning == pytest.approx(0.9 * (nu - delta))
    assert ahead + 0.3 * turning == pytest.approx(0.8 * (nu + delta))


@pytest.mark.parametrize("name", rivals.RIVALS)
def test_the_traction_of_a_rival_is_the_speed_ahead_by_nu_and_the_turning_by_omega(name):
    """Of its own model, at the origin, also with unlike tracks."""
    rival = rivals.RIVALS[name]
    p = np.array([0.4, -0.3, 0.7, 0.9, 0.8, 0.25])[: len(rival.model.parameters)]
    by_nu, by_omega = (
        np.array(rival.model.dynamics([0.0] * 3, inputs, p)).ravel() for inputs in np.eye(5)[:2]
    )
    mu, kappa = rival.traction(p[None])
    assert (*mu, *kappa) == pytest.approx((by_nu[0], by_omega[2])) and mu != kappa


@pytest.mark.parametrize("angle_rad", [0.0, 0.04, -0.04])
def test_the_angle_of_a_reference_is_that_between_its_yaw_and_the_way(angle_rad):
    """On a straight, forwards and backwards; side slip in turns does not count."""
    log = recorded_log(5.0, 120.0)
    turned = log.assign(yaw_true_rad=log["yaw_true_rad"] - angle_rad)
    assert scores.mounting_angle_rad(turned) == pytest.approx(angle_rad, abs=2e-3)


@pytest.mark.nightly
def test_a_perturbed_replay_refuses_nonsense_as_a_replay_does():
    log = recorded_log(noise_m=0.0).assign(speed_mps=lambda log: 3.6 * log["speed_mps"])
    with pytest.raises(ValueError, match="km/h"):
        scores.perturbed_replay(log, 0)
    scores.perturbed_replay(log, 0, trust_log=True)


@pytest.mark.nightly
def test_each_robot_is_left_out_once():
    logs = {
        name: recorded_log(5.0, 30.0, seed=seed, arm_m=arm)
        for name, seed, arm in (("one", 1, (0.0, 0.0)), ("other", 2, (0.2, 0.0)))
    }
    rows = transfer.trials(logs, range(2))
    counted = rows.groupby(["log", "estimator", "tuned"])["seed"].nunique()
    assert (counted == 2).all() and len(counted) == 2 * (3 + 3 + 2 + 2)
    assert rows["yaw_rms_rad"].between(0, 0.3).all()
    own = rows.query("log == 'one' and estimator == 'RHE' and tuned == 'itself'")
    told = transfer.of_the_page(rows).set_index(["log", "estimator", "tuned"])
    row = told.loc[("one", "RHE", "itself")]
    for name in transfer._SCORES:
        assert row[name] == pytest.approx(own[name].mean(), nan_ok=True)
    assert row["low"] < row["yaw_rms_rad"] < row["high"]


def test_a_search_finds_the_least_value_within_its_evaluations():
    """Of a bowl, whose places are set together where one unknown sets them."""
    asked = []

    def bowl(sigma):
        asked.append(sigma)
        return np.square(np.log(np.divide(sigma, (0.02, 0.02, 0.5)))).sum()

    found = transfer._search(bowl, [(0, 1), (2,)])
    assert found == pytest.approx((0.02, 0.02, 0.5), rel=0.05) and len(asked) <= 80
    assert all(f"{value:.2g}" == f"{value:g}" for value in found)


def test_a_trial_has_the_noise_and_the_rate_that_it_says():
    log = recorded_log(25.0, 60.0, noise_m=0.0)
    one, other = (transfer._noisy(log, seed) for seed in (1, 2))
    clean = log.iloc[::5].reset_index(drop=True)
    np.testing.assert_array_equal(one["t_s"], clean["t_s"])
    for name in ("x_m", "y_m"):
        noise = one[name] - clean[name]
        assert noise.std() == pytest.approx(0.02, rel=0.1) and not (one[name] == other[name]).any()
    slow = log.iloc[::10]  # 2.5 Hz: every sample is taken
    assert len(transfer._noisy(slow, 1)) == len(slow)


def test_what_a_rival_knows_does_not_walk():
    sigma = np.arange(1.0, 13.0)
    settings = transfer._settings("EKF of (μ, κ)", 0.3, sigma)
    assert [*settings["V"]] == [1, 4, 9, 16]
    assert [*settings["W"]] == [0, 0, 0, 0, 0, 49, 64]
    assert settings["c"] == [9, 10, 11, 12, 0, 0.6, paper.DT_S]


def test_calibrations_meet_in_their_geometric_mean():
    """One that kept the defaults does not count; the side slip may be 0."""
    one = dict(sigma_v=(0.01, 4.0), sigma_w=(0.1,), slip=(0.02, 0.3), track_width_m=1.0)
    other = dict(sigma_v=(0.04, 1.0), sigma_w=(0.4,), slip=(0.08, 0.0))
    middle = transfer._middle([one, {}, other])
    assert middle["sigma_v"] == pytest.approx((0.02, 2.0))
    assert middle["sigma_w"] == pytest.approx((0.2,))
    assert middle["slip"] == pytest.approx((0.04, 0.15)) and len(middle) == 3


def test_the_page_leaves_out_a_calibration_that_kept_the_defaults():
    scores_of = dict.fromkeys(transfer._SHARES, 0.9)
    rows = [
        dict(log=log, estimator="RHE", tuned=tuned, seed=seed, yaw_rms_rad=rms + 0.01 * seed)
        for log, own in (("kept", 0.2), ("tuned", 0.1))
        for tuned, rms in (("itself", own), ("shipped", 0.2))
        for seed in range(3)
    ]
    told = transfer.of_the_page(pd.DataFrame(rows).assign(**scores_of))
    kept = [*zip(told["log"], told["tuned"])]
    assert kept == [("kept", "shipped"), ("tuned", "itself"), ("tuned", "shipped")]
    assert [*told["yaw_rms_rad"]] == pytest.approx([0.21, 0.11, 0.21])
    # Of three values the interval of the mean is 4.30 deviations over √3 to either side.
    assert [*(told["high"] - told["low"])] == pytest.approx(
        [2 * 4.303 * 0.01 / 3**0.5] * 3, rel=1e-3
    )


def test_a_yaw_is_unsure_by_its_sigma_or_a_failed_step():
    """Of three bad yaws two are unsure, of four good ones one, and one of 0.3 rad is neither.

    A sample without an estimate counts in neither, and is not outside of [0, 1].
    """
    n = 9
    error = [0.6, -0.6, 0.7, 0.1, np.nan, 0.0, -0.1, 2 * np.pi, 0.3]
    samples = pd.DataFrame(
        dict(
            segment=np.zeros(n, int),
            nu_meas_mps=100.0,  # far enough from the first sample on
            omega_meas_radps=0.0,
            theta_rad=0.2,
            theta_hat_rad=np.add(0.2, error),
            sigma_theta_rad=[0.3, 0.2, 0.2, 0.3, np.nan, 0.2, 0.2, 0.2, 0.3],
            ok=[True, False, True, True, True, True, True, True, True],
            mu_hat=[0.9, 0.0, 1.0, 1.1, np.nan, 0.9, 0.9, 0.9, 0.9],
            kappa_hat=[0.9, 1.0, 0.0, 0.9, np.nan, -0.1, 0.9, 0.9, 0.9],
            innovation_x_m=0.0,
            innovation_y_m=0.0,
        )
    )
    values = scores.score(samples)
    assert values["outside"] == 2 and values["not_ok"] == 1
    assert values["bad_unsure"] == pytest.approx(2 / 3)
    assert values["good_unsure"] == pytest.approx(1 / 4)
    assert np.isnan(scores.score(samples[3:])["bad_unsure"])
