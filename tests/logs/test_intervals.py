"""What is said of a log holds: noise, traction, intervals and covariances, each with an oracle.

The drives are simulated, in closed loop and in open loop (`notebooks.further.recorded.verdicts`).
"""

import itertools

import numpy as np
import pandas as pd
import pytest
import yaml
from helpers import recorded_log
from spoilt_logs import four_headings

import rhec
from notebooks.further.recorded import verdicts
from notebooks.studies.statistics import share_interval
from rhec.logs import terms
from rhec.logs.position_noise import LEAST_M, position_sigma_m
from rhec.logs.recording import prepare
from rhec.simulation.columns import MEASUREMENTS


@pytest.fixture(scope="module")
def learnt():
    """What is said of a robot in open loop."""
    with four_headings():
        return rhec.log(verdicts.open_loop_log(1))


@pytest.mark.parametrize("sigma_m", [0.05, 0.4])
def test_white_noise_on_a_straight_drive_has_its_deviation(sigma_m):
    """In the mean over 50 seeds within 3 %, whose own standard error is below 1 %."""
    t = np.arange(0, 240, 0.2)
    straight = pd.DataFrame(dict(t_s=t, x_m=0.5 * t, y_m=0.0, speed_mps=0.5, yaw_rate_radps=0.0))
    rows = prepare(straight).rows
    found = []
    for seed in range(50):
        noise = sigma_m * np.random.default_rng(seed).standard_normal((len(rows), 2))
        found.append(position_sigma_m(rows.assign(**rows[MEASUREMENTS[:2]] + noise)))
    assert np.std(found) / np.sqrt(50) < 0.01 * sigma_m
    assert np.mean(found) == pytest.approx(sigma_m, rel=0.03)


def test_positions_that_are_missing_and_a_robot_that_stands_do_not_hide_the_noise():
    """While it stands, a receiver may smooth its positions."""
    log = recorded_log(10.0, 200.0)
    log[["x_m", "y_m", "speed_mps"]] *= 5.0
    rng = np.random.default_rng(0)
    log[["x_m", "y_m"]] += 0.05 * rng.standard_normal((len(log), 2))
    log.loc[rng.random(len(log)) < 0.3, ["x_m", "y_m"]] = np.nan
    stands = log.iloc[[900] * 4000].assign(speed_mps=0.0, yaw_rate_radps=0.0)
    stands[["x_m", "y_m"]] = 1e-4 * rng.standard_normal((len(stands), 2))
    both = pd.concat([log, stands], ignore_index=True)
    both["t_s"] = 0.1 * both.index
    assert position_sigma_m(prepare(both).rows) == pytest.approx(0.05, rel=0.15)


def test_no_noise_and_few_positions_give_the_least():
    for log in (recorded_log(), recorded_log(duration_s=2.0, noise_m=0.5)):
        assert position_sigma_m(prepare(log).rows) == LEAST_M


def test_the_sigma_of_a_regression_is_that_of_many_drives():
    """Of 200 regressions with white errors the slopes scatter as the jackknife says, to a tenth."""
    rng = np.random.default_rng(0)
    x = np.column_stack([np.sin(0.1 * np.arange(400)), np.ones(400)])
    found = [
        terms._jackknife(x, x @ (0.7, 0.1) + rng.standard_normal(400), np.arange(400) // 20)
        for _ in range(200)
    ]
    for of_one in zip(*found):
        values, sigmas = np.transpose(of_one)
        assert np.sqrt(np.mean(sigmas**2)) == pytest.approx(values.std(), rel=0.1)


def dead_reckoned(told, pieces):
    """Errors (n, 3) and covariances of the pose at the ends of n pieces of logs (n, rows, 6).

    They are of filters with the YAML's noise. The columns of a piece are time, true pose, speeds.

    Each is an EKF as that of robot_localization: pose and velocities (x, y, θ, u, v, w), of which
    the velocities walk, and twists of the driver, with its covariance. It begins at a true pose.
    Errors and covariances are ahead and left of the true pose, and of the yaw.
    """
    driver = told["diff_drive_controller"]["ros__parameters"]
    radius = driver["left_wheel_radius_multiplier"]
    turns = radius / driver["wheel_separation_multiplier"]
    R = np.diag(np.array(driver["twist_covariance_diagonal"])[[0, 1, 5]])
    process = told["ekf_filter_node"]["ros__parameters"]["process_noise_covariance"]
    q = np.diag(np.reshape(process, (15, 15)))[[0, 1, 5, 6, 7, 11]]
    t_s, truth, nu, omega = np.split(pieces, [1, 4, 5], axis=2)
    z = np.concatenate([radius * nu, np.zeros_like(nu), turns * omega], axis=2)
    m = np.column_stack([truth[:, 0], z[:, 0]])
    P = np.zeros((len(pieces), 6, 6))
    P[:, 3:, 3:] = R
    H = np.eye(6)[3:]
    for k in range(1, pieces.shape[1]):
        dt_s = t_s[:, k, 0] - t_s[:, k - 1, 0]
        # The twist is a mean over the interval: it corrects the velocities that move the pose.
        P[:, range(3, 6), range(3, 6)] += dt_s[:, None] * q[3:]
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        m = m + times(K, z[:, k] - m[:, 3:])
        P = (np.eye(6) - K @ H) @ P
        middle = m[:, 2] + m[:, 5] * dt_s / 2
        velocity = np.column_stack([times(turns_by(middle), m[:, 3:5]), m[:, 5]])
        A = np.tile(np.eye(6), (len(pieces), 1, 1))
        A[:, :2, 3:5] = dt_s[:, None, None] * turns_by(middle)
        A[:, 0, 2] = -dt_s * velocity[:, 1]
        A[:, 1, 2] = dt_s * velocity[:, 0]
        A[:, 2, 5] = dt_s
        m[:, :3] += dt_s[:, None] * velocity
        P = A @ P @ A.transpose(0, 2, 1)
        P[:, range(3), range(3)] += dt_s[:, None] * q[:3]
    to_robot = np.tile(np.eye(3), (len(pieces), 1, 1))
    to_robot[:, :2, :2] = turns_by(-truth[:, -1, 2])
    errors = times(to_robot, m[:, :3] - truth[:, -1])
    return errors, to_robot @ P[:, :3, :3] @ to_robot.transpose(0, 2, 1)


def times(matrices, vectors):
    """The product of each matrix (n, i, j) with its vector (n, j)."""
    return (matrices @ vectors[..., None])[..., 0]


def turns_by(angles):
    """Matrices (n, 2, 2) that turn by these angles to the left."""
    cos = np.cos(angles)
    sin = np.sin(angles)
    return np.array([[cos, -sin], [sin, cos]]).transpose(2, 0, 1)


def test_the_covariances_of_the_yaml_make_a_consistent_filter(learnt):
    """On other drives of the same robot 95 % of its errors after 15 s are within 1.96 σ."""
    logs = (verdicts.open_loop_log(seed, 240.0) for seed in range(10, 22))
    columns = ["t_s", "x_true_m", "y_true_m", "yaw_true_rad", "speed_mps", "yaw_rate_radps"]
    rows = np.arange(50, 2200, 200)[:, None] + np.arange(151)
    pieces = np.concatenate([log[columns].to_numpy()[rows] for log in logs])
    errors, P = dead_reckoned(yaml.safe_load(learnt.yaml), pieces)
    inside = np.abs(errors) <= 1.96 * np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    squares = (errors * times(np.linalg.inv(P), errors)).sum(axis=1)
    assert (inside.mean(axis=0) > 0.85).all() and 0.5 < squares.mean() / 3 < 2


# Intervals: how many of them hold the truth


def is_plausible(k, n, least=0.90, most=0.99):
    """Whether k of n intervals may hold the truth in `least` to `most` of all cases."""
    low, high = share_interval(k, n)
    return high >= least and low <= most


KNOWN = [verdicts.MU, verdicts.KAPPA, 0.0]  # of the robots in open loop


def assert_hold_the_truth(rows):
    """Those of the yaw may hold it more often: a robot may slip less than the defaults expect."""
    rows = pd.DataFrame(rows)
    for name in ("μ", "κ", "drift"):
        held = rows[f"{name}_true"].between(rows[f"{name}_low"], rows[f"{name}_high"]).sum()
        assert is_plausible(int(held), len(rows)), (name, len(rows))
    assert rows["way_in_95"].mean() > 0.9 and rows["smoothed_in_95"].mean() > 0.9


def test_intervals_hold_the_truth_in_open_and_in_closed_loop(learnt):
    closed = verdicts.closed_loop_log("soft", (), 800)
    with four_headings():
        steered = verdicts.judged(closed)
    assert_hold_the_truth([verdicts.of_summary(learnt, KNOWN), steered])


@pytest.mark.nightly
def test_intervals_hold_the_truth_of_many_robots_in_open_loop():
    logs = (verdicts.open_loop_log(seed, duration_s=120.0) for seed in range(810, 850))
    assert_hold_the_truth(verdicts.judged(log, KNOWN) for log in logs)


@pytest.mark.nightly
def test_intervals_hold_the_truth_in_all_worlds():
    drives = itertools.product(rhec.WORLDS, range(850, 858))
    logs = (verdicts.closed_loop_log(world, (), seed) for world, seed in drives)
    assert_hold_the_truth(map(verdicts.judged, logs))


@pytest.mark.nightly
def test_intervals_of_a_calibration_hold_the_truth():
    """Of the noise and the delay of the positions, and of the place of the antenna."""
    arm_m, noise_m, n = (0.25, -0.1), 0.05, 40
    held = dict.fromkeys(("noise of the position", "antenna ahead", "antenna left"), 0)
    held["delay of the positions"] = 0
    truth = dict(zip(held, (noise_m, *arm_m, 0.0)))
    for seed in range(n):
        log = recorded_log(5.0, 120.0, noise_m=noise_m, seed=seed, arm_m=arm_m)
        found = rhec.calibrate(log, trust_log=True)
        report = found.report
        assert not any("wander" in remark for remark in found.remarks)  # the noise is white
        for name, value in truth.items():
            held[name] += report.loc[name, "low"] < value < report.loc[name, "high"]
    assert all(is_plausible(k, n, most=1.0) for k in held.values()), held
