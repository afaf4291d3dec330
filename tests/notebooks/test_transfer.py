"""The table of recorded robots, each left out once, and the rivals in it."""

import numpy as np
import pandas as pd
import pytest
from helpers import KAPPA, MU, TRACK_WIDTH_M, in_a_mirror, later, moved, recorded_log, turned
from scipy import stats

import rhec
from notebooks.further import transfer
from notebooks.further.recorded import page, rivals, scores
from notebooks.studies.answer import RESULTS
from rhec import paper
from rhec.logs.recording import prepare
from rhec.simulation.columns import ESTIMATE, TRUTH

HALF_M = TRACK_WIDTH_M / 2
EXACT = dict(V=[1e-8] * 4, W=[0.0] * 7, c=[0.0, 0.0, 0.0, 0.0, 0.0, TRACK_WIDTH_M, paper.DT_S])


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


def test_straight_seconds_are_counted_by_the_way_that_the_robot_drives():
    """It goes ahead, slides sideways for 4 s, turns on the way back, and creeps at the end."""
    v = np.repeat([0.4, -0.5, -0.5, 0.2], [150, 100, 50, 50])
    turning = np.repeat([0.0, 0.0, 0.3, 0.0], [150, 100, 50, 50])
    yaw = 0.2 * np.cumsum(turning) - 2.0
    slides = 1j * 0.3 * (np.abs(np.arange(350) - 75) < 10)
    place = np.cumsum(0.2 * (v + slides) * np.exp(1j * yaw))
    log = pd.DataFrame(dict(t_s=0.2 * np.arange(350), x_m=place.real, y_m=place.imag))
    log = log.assign(x_true_m=place.real, y_true_m=place.imag, yaw_true_rad=yaw - 0.03)
    log = log.assign(speed_mps=v, yaw_rate_radps=turning)
    (row,) = page.mounting(dict(made=log)).to_dict("records")
    assert row["log"] == "made" and row["angle_rad"] == pytest.approx(0.03, abs=1e-6)
    # A second has five samples, and the first ones after a change are of both ways.
    for way, n in (("forwards", 150), ("backwards", 100)):
        assert row[f"{way}_rad"] == pytest.approx(0.03, abs=1e-6)
        assert n - 6 <= row[f"{way}_n"] <= n
    aligned = page.aligned(log)["yaw_true_rad"]
    np.testing.assert_allclose(aligned, yaw, atol=1e-6)
    creeping = log.assign(x_m=0.5 * log["x_m"], y_m=0.5 * log["y_m"])
    for name in "xy":
        creeping[f"{name}_true_m"] = creeping[f"{name}_m"]
    assert scores.mounting_angle_rad(creeping) == 0


def test_a_perturbed_replay_refuses_nonsense_as_a_replay_does():
    log = recorded_log(noise_m=0.0).assign(speed_mps=lambda log: 3.6 * log["speed_mps"])
    with pytest.raises(ValueError, match="km/h"):
        scores.perturbed_replay(log, 0)
    scores.perturbed_replay(log, 0, trust_log=True)


def test_an_estimator_knows_of_the_noise_that_is_added_to_its_log():
    """With noise of 0.03 m and positions that were good to 0.04 m they are good to 0.05 m."""
    log = recorded_log(5.0, 30.0, noise_m=0.01)
    noise = 0.03 * np.random.default_rng(7).standard_normal((len(log), 2))
    noisy = log.assign(x_m=log["x_m"] + noise[:, 0], y_m=log["y_m"] + noise[:, 1])
    how = dict(estimator="ekf", process_noise="prediction", trust_log=True)
    found = scores.perturbed_replay(log, 7, 0.03, sigma_v=(0.04, 0.04, *paper.SIGMA_V[2:]), **how)
    same = scores.perturbed_replay(noisy, 7, 0.0, sigma_v=(0.05, 0.05, *paper.SIGMA_V[2:]), **how)
    np.testing.assert_allclose(found[ESTIMATE], same[ESTIMATE], atol=1e-9)


def told(name, p):
    """A rival that knows its parameters, and settings without noise."""
    rival = rivals.RIVALS[name]._replace(first=lambda half_m: (p, [0.0] * len(p)))
    walks = len(rival.model.joint_names)
    return rival, EXACT | dict(W=[0.0] * walks)


@pytest.mark.parametrize(
    "name, p",
    [
        ("EKF of (μ, κ)", [0.2, 0.0, MU, KAPPA]),
        ("EKF of ICR", [HALF_M * MU / KAPPA, -HALF_M * MU / KAPPA, -0.2, MU, MU, HALF_M]),
    ],
)
def test_a_rival_that_is_told_the_truth_has_no_error(name, p):
    """On a log without noise of an antenna ahead, from its true yaw on; its score says so."""
    log = recorded_log(5.0, 60.0, arm_m=(0.2, 0.0))
    (part,) = prepare(log).samples()
    samples = rivals.run(*told(name, p), part, HALF_M, log["yaw_true_rad"].iloc[0])
    np.testing.assert_allclose(samples[[*ESTIMATE[:3]]], samples[[*TRUTH[:3]]], atol=2e-3)
    np.testing.assert_allclose(samples[[*ESTIMATE[4:]]], [(MU, KAPPA)] * len(samples))
    found = scores.score(samples.assign(ok=True))
    way_m = np.cumsum(0.2 * log["speed_mps"].abs())
    assert found["samples"] == (way_m >= 8.0).sum()
    for error in ("yaw_rms_rad", "yaw_rms_slow_rad", "position_rms_m", "innovation_rms_m"):
        assert found[error] < 2e-3
    assert (found["mu_difference"], found["kappa_difference"]) == pytest.approx((0, 0), abs=1e-3)
    assert found["outside"] == found["not_good"] == found["good_unsure"] == 0


@pytest.mark.parametrize("name", rivals.RIVALS)
def test_the_deviance_of_a_robot_that_stands_is_that_of_its_positions(name):
    """Oracle: positions with a common place, of which 1 m was known, and white errors."""
    n = 40
    sigma_m = 0.1
    positions = sigma_m * np.random.default_rng(1).standard_normal((n, 2))
    log = pd.DataFrame(dict(t_s=0.2 * np.arange(n), v_left_mps=0.0, v_right_mps=0.0))
    log = log.assign(x_m=positions[:, 0], y_m=positions[:, 1])
    (part,) = prepare(log, TRACK_WIDTH_M).samples()
    first = rivals.RIVALS[name].first(HALF_M)[0]
    rival, settings = told(name, first)
    differences = []
    for sigma in (sigma_m, 0.3):
        settings = settings | dict(V=[sigma**2, sigma**2, 1e-8, 1e-8])
        found = rivals.deviances(rival, settings, part, HALF_M, 0.0).sum()
        cov = sigma**2 * np.eye(n) + 1.0
        expected = sum(
            -2 * stats.multivariate_normal.logpdf(column, np.full(n, column[0]), cov)
            for column in positions.T
        )
        differences.append(found - expected)
    # Up to a constant, which does not depend on the noise.
    assert differences[0] == pytest.approx(differences[1], abs=0.05)


@pytest.mark.parametrize(
    "name, bumps, sigma_m", [("EKF of (μ, κ)", 11, 0.02), ("EKF of ICR", 13, 0.08)]
)
def test_a_rival_is_tuned_to_the_noise_that_there_is(name, bumps, sigma_m, monkeypatch):
    """Of positions with white errors, by all that is driven after the first metres."""
    monkeypatch.setitem(transfer._SEARCHED, name, [(0, 1), (bumps,)])
    found = transfer._tuned(name, recorded_log(5.0, 200.0, noise_m=sigma_m, seed=2))
    assert found[0] == found[1] == pytest.approx(sigma_m, rel=0.1)


@pytest.fixture
def at_once(monkeypatch):
    """Trials in this process, of estimators that are tuned to numbers of their log's length."""
    monkeypatch.setattr(transfer, "parallel_map", lambda *arguments: [*map(*arguments)])

    def calibrated(log):
        sigma_w = 1e-4 * len(log)
        return dict(sigma_v=(0.02,) * 4, sigma_w=(sigma_w,) * 2, slip=(0.02,) * 5)

    monkeypatch.setattr(transfer, "calibrate", calibrated)
    monkeypatch.setattr(transfer, "_tuned", lambda title, log: of_rival(title, 1e-4 * len(log)))


def of_rival(title, sigma):
    """The standard deviations of a rival: those of what is measured, and all others."""
    entries = {"EKF of (μ, κ)": 12, "EKF of ICR": 14}
    return (0.02,) * 4 + (sigma,) * (entries[title] - 4)


@pytest.fixture(scope="module")
def logs():
    """Those of two robots, the second with a gyro."""
    one, other = (recorded_log(5.0, duration_s, seed=1) for duration_s in (30.0, 40.0))
    return dict(one=one, other=other.assign(gyro_radps=other["yaw_rate_true_radps"] + 0.01))


def test_each_robot_is_left_out_once(logs, at_once):
    """Oracle: the public replay of the same log."""
    rows = transfer.trials(logs, [3])
    of = rows.set_index(["log", "estimator", "tuned"])["yaw_rms_rad"]
    published = pd.read_csv(RESULTS / "table_recorded_yaw.csv")
    shown = {*zip(published["estimator"], published["tuned"])}
    assert {*zip(rows["estimator"], rows["tuned"])} == shown and (rows["seed"] == 3).all()
    assert len(of) == len({*of.index}) == len(shown) + sum("gyro" not in name for name, _ in shown)
    for name, estimator, way, length in (
        ("one", "RHE", "others", 200),
        ("one", "RHE, smoothed", "itself", 150),
        ("other", "RHE, gyro", "itself", 200),
        ("other", "RHE", "shipped", None),
    ):
        clean = page.aligned(logs[name])
        log = transfer._noisy(clean, 3)
        log = log if "gyro" in estimator else log.drop(columns="gyro_radps", errors="ignore")
        fields = transfer.calibrate(range(length)) if length else {}
        first_rad = clean["yaw_true_rad"].iloc[0] + 0.3
        options = dict(first_yaw_rad=first_rad, smooth="smoothed" in estimator)
        found = rhec.replay(log, **options, **fields, trust_log=True)
        late = np.cumsum(0.2 * log["speed_mps"].abs()) >= 8.0
        error = found["theta_hat_rad"] - clean["yaw_true_rad"]
        rms = np.sqrt(np.mean(error[late] ** 2))
        assert of[name, estimator, way] == pytest.approx(rms, rel=1e-6)
    # Both rivals are tuned to their log's length, or to the other's.
    is_rival = rows["estimator"].isin(rivals.RIVALS)
    by_way = rows[is_rival].pivot(index=["log", "estimator"], columns="tuned")
    assert (by_way["yaw_rms_rad", "itself"] != by_way["yaw_rms_rad", "others"]).all()


def test_scores_do_not_depend_on_where_a_log_was_recorded(logs, monkeypatch):
    """In a mirror, turned, elsewhere and later."""
    monkeypatch.setattr(transfer, "NOISE_M", 0.0)
    monkeypatch.setattr(transfer, "YAW_ERROR_RAD", 0.0)
    here = logs["other"]
    sigmas = {name: dict(itself=of_rival(name, 0.01)) for name in rivals.RIVALS}
    one, other = (
        transfer._tried("other", page.aligned(log), "RHE, gyro", dict(itself={}), sigmas, 0)
        for log in (here, later(moved(turned(in_a_mirror(here)))))
    )
    pd.testing.assert_frame_equal(pd.DataFrame(one), pd.DataFrame(other), rtol=1e-3, atol=1e-5)
    assert len(one) == 4


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


@pytest.mark.parametrize("name", rivals.RIVALS)
def test_each_standard_deviation_of_a_rival_is_searched_once_and_alike_on_both_sides(name):
    """Those of V, of the parameters' walk and of the slip, without the side slip and what is known:
    a place in x has that in y, and the left track that of the right one.
    """
    places = [place for unknown in transfer._SEARCHED[name] for place in unknown]
    names = [*"xyνω", *rivals.RIVALS[name].model.parameters, *"ahead turning side bumps".split()]
    known = {names.index("half_width_m")} if "half_width_m" in names else {4, 5}
    assert sorted([*places, *known]) == list(range(len(names)))
    assert {*transfer._NOT_SEARCHED[name]} == known
    pairs = [[names[place] for place in of] for of in transfer._SEARCHED[name] if len(of) > 1]
    both_sides = [["x", "y"], ["y_left_m", "y_right_m"], ["left", "right"]]
    assert pairs == [pair for pair in both_sides if pair[0] in names]


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


def test_a_yaw_is_unsure_by_its_sigma_or_a_failed_step(monkeypatch):
    """Of three bad yaws two are unsure, of four good ones one, and one of 0.3 rad is neither.

    Each score but their number is that of the samples with an estimate alone.
    """
    monkeypatch.setattr(scores, "FROM_M", 0.0)
    samples = scores.perturbed_replay(recorded_log(5.0, 10.0), 0)[:9]
    error = [0.6, -0.6, 0.7, 0.1, np.nan, 0.0, -0.1, 2 * np.pi, 0.3]
    samples = samples.assign(theta_hat_rad=samples["theta_rad"] + error)
    samples["sigma_theta_rad"] = [0.3, 0.2, 0.2, 0.3, np.nan, 0.2, 0.2, 0.2, 0.3]
    samples["ok"] = [True, False, True, True, True, True, True, True, True]
    estimates = [*samples.filter(regex="_hat|innovation")]
    samples.loc[samples.index[4], estimates] = np.nan
    values = scores.score(samples)
    known = scores.score(samples.drop(samples.index[4]))
    shares = [*known.keys() - {"samples", "mu_regression", "kappa_regression"}]
    assert {name: values[name] for name in shares} == pytest.approx(
        {name: known[name] for name in shares}, rel=1e-12
    )
    assert values["not_good"] == 0.5 and values["not_ok"] == 1
    assert values["bad_unsure"] == pytest.approx(2 / 3)
    assert values["good_unsure"] == pytest.approx(1 / 4)
    assert np.isnan(scores.score(samples[3:])["bad_unsure"])
