"""Replay of recorded logs: columns and rows, resampling, faults of sensors and clocks, accuracy of
the estimates, scores.
"""

import pickle

import make_example_log
import numpy as np
import pandas as pd
import pytest
from helpers import KAPPA, MU, TRACK_WIDTH_M, Bomb, may_be_unsure, recorded_log
from spoilt_logs import another_future

import rhec
from notebooks.further.recorded import scores
from rhec import paper
from rhec.logs import recording
from rhec.logs.course import SIGMA_BY_COURSE
from rhec.logs.outputs import write_estimates
from rhec.logs.replay import InitialGuess, estimate_samples, replay_scenario
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, RECORDED_TRUTH, SIGMA

LOG = recorded_log(noise_m=0.02)


@pytest.fixture(scope="module")
def estimates():
    return rhec.replay(LOG, first_yaw_rad=0.4)


def errors(result):
    off_m = np.hypot(result["x_hat_m"] - result["x_m"], result["y_hat_m"] - result["y_m"])
    return off_m, scores.yaw_error(result).abs()


# Estimates


def test_each_row_of_the_log_gets_its_estimate(estimates):
    log = LOG.set_index(pd.Index(np.arange(len(LOG))[::-1], name="row"))
    result = rhec.replay(log, first_yaw_rad=0.4)
    pd.testing.assert_index_equal(result.index, log.index)
    np.testing.assert_array_equal(result["t_s"], log["t_s"])
    np.testing.assert_array_equal(result[ESTIMATE], estimates[ESTIMATE])
    assert np.isfinite(result[ESTIMATE]).all(axis=None) and result["ok"].all()
    assert result[["mu_hat", "kappa_hat"]].stack().between(0, 1).all()


@may_be_unsure
def test_without_encoders_a_robot_goes_on_between_the_samples_as_at_them():
    """On a circle without noise, so that the yaw is wrong by the same amount in all rows."""
    yaw = 0.075 * np.arange(200)
    log = pd.DataFrame(dict(t_s=0.05 * np.arange(200), speed_mps=0.5, yaw_rate_radps=1.5))
    log = log.assign(x_m=np.sin(yaw) / 3, y_m=-np.cos(yaw) / 3)
    log.loc[100:119, ["speed_mps", "yaw_rate_radps"]] = np.nan
    result = rhec.replay(log, first_yaw_rad=0.0, smooth=False)
    assert np.ptp((result["theta_hat_rad"] - yaw)[100:120]) < 0.01


def test_replaying_the_log_of_a_run_gives_its_estimates(run):
    given = dict(
        process_noise="prediction",
        sigma_v=paper.SIGMA_V,
        speed_model="parameter",
        first_yaw_rad=float(run.log["theta_rad"][0]),
        sigma_yaw_rad=0.1,
    )
    result = rhec.replay(run.log, **given)
    np.testing.assert_allclose(result[ESTIMATE][50:], run.log[ESTIMATE][50:], atol=2e-3)
    np.testing.assert_array_equal(result[["x_m", "theta_rad"]], run.log[["x_m", "theta_rad"]])


def test_the_live_estimator_agrees():
    prepared = recording.prepare(LOG)
    fields = dict(process_noise="prediction", sigma_v=paper.SIGMA_V, speed_model="input")
    samples = estimate_samples(
        prepared, replay_scenario("rhe", prepared, fields), InitialGuess((0.4,), 0.1)
    )
    z = samples[MEASUREMENTS].to_numpy()
    live = rhec.RHE(**fields, guess=(*z[0, :2], 0.4, z[0, 2], 1.0, 1.0))
    sigmas = ["sigma_x_m", "sigma_y_m", "sigma_theta_rad", "sigma_mu", "sigma_kappa"]
    for k in range(len(z)):
        live.prepare()
        estimate = live.feedback(z[k])
        np.testing.assert_allclose(estimate[:6], samples[ESTIMATE].iloc[k], atol=1e-8)
        sigma = dict(zip(sigmas, np.sqrt(np.diag(estimate.covariance)), strict=True))
        assert sigma == pytest.approx(dict(samples[sigmas].iloc[k]), rel=1e-6)
    assert sigma["sigma_kappa"] > 1.1 * sigma["sigma_mu"]  # so that no two are alike


def test_no_estimate_sees_the_truth(estimates):
    blind = rhec.replay(LOG.assign(**dict.fromkeys(RECORDED_TRUTH.values(), 7)), first_yaw_rad=0.4)
    np.testing.assert_array_equal(blind[ESTIMATE], estimates[ESTIMATE])


@may_be_unsure
def test_what_gating_rejects_is_in_the_replay():
    """True where a position was used, False where it is missing, rejected or another row's.

    The RHE rejects the first three after a leap and restarts at the fourth.
    """
    log = LOG.copy()
    log.loc[300:310, ["x_m", "y_m"]] += 5.0
    log.loc[400:410, ["x_m", "y_m"]] = np.nan
    given = dict(
        first_yaw_rad=0.4, process_noise="prediction", sigma_v=paper.SIGMA_V, speed_model="input"
    )
    accepted = rhec.replay(log, **given)["position_accepted"]
    unused = {*range(300, 306), *range(312, 318), *range(402, 412)}
    # The estimator's samples are every other row.
    assert accepted.tolist() == [i % 2 == 0 and i not in unused for i in log.index]


# Causality


JITTER_S = np.random.default_rng(3).uniform(-0.06, 0.06, 200)
GNSS = {  # times of positions [s]
    "5 Hz": np.arange(0, 40, 0.2),
    "5 Hz, out of phase": np.arange(0.1, 40, 0.2),
    "4 Hz": np.arange(0, 40, 0.25),
    "7 Hz": np.arange(0, 40, 1 / 7),
    "5 Hz, jittered": np.abs(np.arange(0, 40, 0.2) + JITTER_S),
}


def merged(gnss, noise_m=0.0):
    """A log whose positions and encoder measurements come each at times of its own."""
    log = recorded_log(1000.0, noise_m=noise_m)[:40_000]
    log = log.drop(columns=["v_left_mps", "v_right_mps"])  # the whole log is asked for its width
    has_position = log.index.isin(np.round(1000 * GNSS[gnss]))
    has_encoders = log.index % 100 == 0
    log.loc[~has_position, ["x_m", "y_m"]] = np.nan
    log.loc[~has_encoders, ["speed_mps", "yaw_rate_radps"]] = np.nan
    return log[has_position | has_encoders].reset_index(drop=True)


@may_be_unsure
@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "gnss, first_yaw_rad", [("5 Hz, jittered", None), *((each, 0.4) for each in GNSS)]
)
def test_the_future_changes_no_estimate_before_it(gnss, first_yaw_rad):
    """Nor does its absence: wherever the log ends or changes, what was said remains."""
    log, generator = merged(gnss, noise_m=0.02), np.random.default_rng(7)
    # Without a σ_v the whole log is asked for the noise of its positions.
    given = dict(sigma_v=(0.03, 0.03, 0.1, 0.1), process_noise="prediction")
    given |= dict(first_yaw_rad=first_yaw_rad, trust_log=True, smooth=False)
    whole = rhec.replay(log, **given)
    columns = [*ESTIMATE, *SIGMA[:6], SIGMA_BY_COURSE, "innovation_x_m", "ok"]
    for from_s in generator.uniform(1.0, 39.0, 2):
        past = log[log["t_s"] <= from_s]
        for other in (past, another_future(log, from_s, generator)):
            said = rhec.replay(other, **given)
            np.testing.assert_array_equal(
                *(each[: len(past)][columns].to_numpy(float) for each in (said, whole))
            )


@pytest.mark.nightly(keep=5)
@pytest.mark.parametrize("times", [5.0, 8.0, 50.0, *reversed(GNSS)])
def test_without_noise_the_estimates_find_the_truth(times):
    """At every rate of the log, which may be no multiple of the samples', and between the samples.

    A position that was measured between two samples is carried on over its age.
    """
    log = recorded_log(times) if isinstance(times, float) else merged(times)
    # A W by likelihood on soil that slips and differs as this log's does.
    noise = dict(sigma_v=paper.SIGMA_V, sigma_w=(0.001, 0.001, 0.001, 0.0033, 0.001))
    given = dict(first_yaw_rad=0.4, speed_model="input", process_noise="prediction")
    result = rhec.replay(log, **given | noise)
    late = result["t_s"] > 15
    position, yaw = errors(result[late])
    assert len(result) == len(log) and position.max() < 0.02 and yaw.max() < 0.02
    assert result["mu_hat"][late].median() == pytest.approx(MU, abs=0.01)
    assert result["kappa_hat"][late].median() == pytest.approx(KAPPA, abs=0.02)


def test_the_first_estimate_is_as_unsure_as_a_guess_is():
    """Of yaw, traction and the place of the antenna one position says nothing."""
    first = rhec.replay(LOG[:50], first_yaw_rad=0.4, smooth=False, trust_log=True).iloc[0]
    told = first[["sigma_theta_rad", "sigma_mu", "sigma_kappa", "sigma_arm_forward_m"]]
    assert [*told] == pytest.approx([0.3, *paper.SIGMA_W_RHE[4:], 0.1], rel=0.02)


@may_be_unsure
def test_a_log_of_one_row_has_one_estimate():
    assert rhec.replay(LOG[:1])[ESTIMATE].notna().all(axis=None)


def test_an_unknown_first_yaw_is_found():
    log = recorded_log(start_rad=-2.9, noise_m=0.02)
    result = rhec.replay(log, smooth=False)
    assert scores.yaw_error(result)[result["t_s"] > 15].abs().max() < 0.15


@may_be_unsure
def test_a_receiver_that_declares_more_noise_is_believed(estimates):
    declared = rhec.replay(LOG.assign(position_sigma_m=1.0), first_yaw_rad=0.4)
    assert declared["sigma_x_m"].iloc[-1] > 3 * estimates["sigma_x_m"].iloc[-1]


def test_nothing_is_said_before_the_first_position():
    log = LOG.assign(x_m=LOG["x_m"].where(LOG["t_s"] > 3.0))
    result = rhec.replay(log, first_yaw_rad=0.4)
    said = result[ESTIMATE].notna().all(axis=1)
    assert not said[log["t_s"] < 3.1].any() and said[log["t_s"] > 3.3].all()


# Columns and rows


@pytest.mark.parametrize("rate_hz", [5.0, 8.0, 50.0])
def test_encoder_measurements_of_a_sample_are_means_over_the_interval_that_ends_there(rate_hz):
    log = recorded_log(rate_hz)
    (samples,) = recording.prepare(log).samples()
    fine = recorded_log(1000.0)
    for reading, column in (("nu_meas_mps", "speed_mps"), ("omega_meas_radps", "yaw_rate_radps")):
        expected = fine[column].to_numpy()[1:59_801].reshape(-1, 200).mean(axis=1)
        # the newest is held until the sample, as long as the next one is not there
        np.testing.assert_allclose(samples[reading][1:], expected[: len(samples) - 1], atol=0.015)


@pytest.mark.parametrize("until_s, is_known", [(1.88, True), (1.93, False)])
def test_a_mean_is_known_where_half_of_its_interval_is(until_s, is_known):
    """Encoders are silent from 1 s on, until some time in the sample that ends at 2 s."""
    t = np.append(np.arange(0, 1.001, 0.01), np.arange(until_s, 3.0, 0.01)).round(3)
    log = pd.DataFrame(dict(t_s=t, x_m=0.0, y_m=0.0, speed_mps=1.0, yaw_rate_radps=0.0))
    (samples,) = recording.prepare(log).samples()
    assert np.isfinite(samples["nu_meas_mps"][10]) == is_known
    assert np.isnan(samples["nu_meas_mps"][9]) and np.isfinite(samples["nu_meas_mps"][11])


def test_how_long_speeds_and_a_truth_are_held_and_from_when_on_a_robot_stands():
    log = recorded_log(10.0, 60.0)
    for gap_s, stands in ((2.9, False), (3.3, True)):
        there = ~log["t_s"].between(10.05, 9.95 + gap_s)
        (samples,) = recording.prepare(log[there]).samples()
        assert (samples["nu_meas_mps"][50:67] == 0).any() == stands
    for column, name, held_s in (("speed_mps", "nu_meas_mps", 0.6), ("x_true_m", "x_m", 0.3)):
        for gap_s, is_known in ((held_s, True), (held_s + 0.2, False)):
            there = ~log["t_s"].between(10.05, 9.95 + gap_s)
            silent = log.assign(**{column: log[column].where(there)})
            (samples,) = recording.prepare(silent).samples()
            assert samples[name].notna().all() == is_known, (name, gap_s)


def test_a_truth_that_wraps_goes_on_over_its_jumps():
    """Between rows, too, where a mean of both sides of a jump would be half a turn off."""
    log = recorded_log(8.0, start_rad=3.0)
    wrapped = log.assign(yaw_true_rad=np.angle(np.exp(1j * log["yaw_true_rad"])))
    assert wrapped["yaw_true_rad"].diff().abs().max() > 6
    yaws = [recording.prepare(each).samples()[0]["theta_rad"] for each in (log, wrapped)]
    np.testing.assert_allclose(*(np.exp(1j * yaw) for yaw in yaws), atol=1e-9)


def test_track_speeds_and_width_replace_speed_and_yaw_rate(estimates):
    tracks = LOG.drop(columns=["speed_mps", "yaw_rate_radps"])
    same = rhec.replay(tracks, first_yaw_rad=0.4, track_width_m=TRACK_WIDTH_M)
    np.testing.assert_allclose(same[ESTIMATE], estimates[ESTIMATE], atol=1e-6)


@may_be_unsure
def test_the_lever_arm_can_be_given_or_estimated():
    log = recorded_log(arm_m=(0.3, -0.2), noise_m=0.01, duration_s=120.0)
    told, found = (
        rhec.replay(log, first_yaw_rad=0.4, lever_arm_m=arm) for arm in ((0.3, -0.2), None)
    )
    place = ["arm_forward_hat_m", "arm_left_hat_m"]
    np.testing.assert_allclose(told[place][900:] - [0.3, -0.2], 0, atol=0.02)
    np.testing.assert_allclose(found[place].iloc[-1], (0.3, -0.2), atol=0.08)
    sigma = found["sigma_arm_left_m"]
    assert told["sigma_arm_left_m"].iloc[-1] < sigma.iloc[-1] < sigma.iloc[0]


def test_segments_are_independent(estimates):
    second = recorded_log(start_rad=2.0, noise_m=0.02, seed=1)
    later = second.assign(segment="b", t_s=second["t_s"] + 60.0)
    both = pd.concat([LOG.assign(segment="a"), later], ignore_index=True)
    result = rhec.replay(both, first_yaw_rad=(0.4, 2.0))[ESTIMATE]
    alone = rhec.replay(second, first_yaw_rad=2.0)[ESTIMATE]
    np.testing.assert_allclose(result, pd.concat([estimates[ESTIMATE], alone]), atol=1e-9)


@pytest.mark.parametrize("gap_s, segments", [(590.0, 1), (610.0, 2), (-0.9, 1), (-1.5, 2)])
def test_a_gap_of_ten_minutes_or_a_clock_that_is_set_back_begins_a_segment(gap_s, segments):
    """Set back by more than a second."""
    later = LOG.assign(t_s=LOG["t_s"] + LOG["t_s"].iloc[-1] + gap_s)
    both = pd.concat([LOG, later], ignore_index=True)
    assert len(recording.prepare(both).samples()) == segments


# Faults


def test_flagged_repeated_and_implausible_positions_are_missing(estimates):
    bad = np.random.default_rng(0).random(len(LOG)) < 0.1
    silent = LOG.copy()
    silent.loc[bad, ["x_m", "y_m"]] = np.nan
    expected = rhec.replay(silent, first_yaw_rad=0.4)[ESTIMATE]
    kind = np.where(bad, LOG.index % 4, -1)
    wrong = LOG.assign(pos_ok=np.where(kind == 0, 0, 1))
    wrong.loc[kind == 0, ["x_m", "y_m"]] = 1e5
    wrong.loc[kind == 1, ["x_m", "y_m"]] = np.inf, -1e300
    wrong.loc[kind == 3, ["x_m", "y_m"]] = silent.ffill()
    wrong = wrong.assign(x_m=wrong["x_m"].astype(object).where(kind != 2, "lost"))
    result = rhec.replay(wrong, first_yaw_rad=0.4)
    np.testing.assert_array_equal(result[ESTIMATE], expected)
    assert result.attrs["faults"]["positions_held"] == (kind == 3).sum()
    assert not np.array_equal(expected, estimates[ESTIMATE])


def test_rows_out_of_time_change_nothing(estimates):
    """Duplicates, older rows and implausible times have the estimate of the row before."""
    wrong = LOG.iloc[[100, 50, 200, 201]].assign(t_s=[10.0, 9.85, 1e9, np.nan], x_m=77.0, y_m=-77.0)
    order = np.concatenate(
        [np.arange(101), [600, 601], np.arange(101, 201), [602, 603], np.arange(201, 600)]
    )
    log = pd.concat([LOG, wrong], ignore_index=True).iloc[order]
    result = rhec.replay(log, first_yaw_rad=0.4)
    np.testing.assert_array_equal(result.index, order)
    np.testing.assert_array_equal(result.drop(index=range(600, 604))[ESTIMATE], estimates[ESTIMATE])
    before = estimates.loc[[100, 100], ESTIMATE]
    np.testing.assert_array_equal(result.loc[[600, 601], ESTIMATE], before)
    assert result.attrs["faults"]["unusable_times"] == 4


# Files


def test_a_replay_leaves_tables_and_paths(estimates, tmp_path):
    write_estimates(estimates, tmp_path / "new")
    for table in (
        pd.read_csv(tmp_path / "new" / "estimates.csv"),
        pd.read_parquet(tmp_path / "new" / "estimates.parquet"),
    ):
        np.testing.assert_allclose(table["theta_hat_rad"], estimates["theta_hat_rad"])
    t, x, y, *nothing, qz, qw = np.loadtxt(tmp_path / "new" / "estimated.tum").T
    np.testing.assert_allclose([t, x, y], estimates[["t_s", *ESTIMATE[:2]]].T, atol=1e-8)
    turn = 2 * np.arctan2(qz, qw) - estimates["theta_hat_rad"]
    np.testing.assert_allclose(np.cos(turn), 1.0, atol=1e-9)
    assert not np.any(nothing)
    measured = np.loadtxt(tmp_path / "new" / "measured.tum")
    np.testing.assert_allclose(measured[:, 0], LOG["t_s"][LOG["x_m"].notna()])
    # A path has one pose at a time, also where sensors have rows of their own.
    twice = pd.concat([estimates, estimates[100:103]]).sort_values("t_s", kind="stable")
    write_estimates(twice, tmp_path / "twice")
    for name in ("estimated.tum", "measured.tum"):
        assert (tmp_path / "twice" / name).read_text() == (tmp_path / "new" / name).read_text()


def test_nothing_in_a_file_is_executed(tmp_path):
    bomb = pickle.dumps(Bomb())
    for name in ("log.csv", "log.parquet", "log.pkl"):
        (tmp_path / name).write_bytes(bomb)
        with pytest.raises(ValueError):
            rhec.replay(rhec.logs.read(tmp_path / name))


# The shipped log


def test_the_shipped_log_is_reproducible():
    shipped = rhec.logs.read(make_example_log.FILE)
    pd.testing.assert_frame_equal(make_example_log.example_log(), shipped, rtol=0, atol=2e-4)
    assert make_example_log.FILE.stat().st_size < 300_000
