"""What is said of a log holds: noise, traction, intervals and covariances, each with an oracle.

The drives are simulated, in closed loop and in open loop (`notebooks.further.recorded.verdicts`).
"""

import numpy as np
import pandas as pd
import pytest
import yaml
from helpers import recorded_log

import rhec
from notebooks.further.recorded import verdicts
from notebooks.further.recorded.rivals import RIVALS
from notebooks.studies.statistics import share_interval
from rhec.logs import terms
from rhec.logs.position_noise import position_sigma_m
from rhec.logs.recording import prepare


@pytest.mark.parametrize("sigma_m", [0.05, 0.4])
def test_white_noise_on_a_straight_drive_has_its_deviation(sigma_m):
    """In the mean over 50 seeds within 3 %, whose own standard error is below 1 %."""
    t = np.arange(0, 240, 0.2)
    found = []
    for seed in range(50):
        noise = sigma_m * np.random.default_rng(seed).standard_normal((2, len(t)))
        log = pd.DataFrame(dict(t_s=t, x_m=0.5 * t + noise[0], y_m=noise[1]))
        rows = prepare(log.assign(speed_mps=0.5, yaw_rate_radps=0.0)).rows
        found.append(position_sigma_m(rows))
    assert np.std(found) / np.sqrt(50) < 0.01 * sigma_m
    assert np.mean(found) == pytest.approx(sigma_m, rel=0.03)


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


@pytest.mark.parametrize("seed", range(5))
def test_the_traction_of_unlike_tracks_is_that_of_their_centres_of_rotation(seed):
    """At its centre of rotation a track does not slip along itself: ahead - turning y = α v.

    The two tracks give two equations, which are solved here for unit speed and for unit yaw rate.
    """
    rng = np.random.default_rng(seed)
    y_left, y_right = rng.uniform(0.4, 0.9), -rng.uniform(0.4, 0.9)
    left, right = rng.uniform(0.5, 1.0, 2)
    half_m = 0.3
    told = RIVALS["EKF of ICR"].traction(np.array([[y_left, y_right, 0.1, left, right, half_m]]))
    for place, (nu, omega) in enumerate(((1.0, 0.0), (0.0, 1.0))):
        over_ground = left * (nu - half_m * omega), right * (nu + half_m * omega)
        motion = np.linalg.solve([[1.0, -y_left], [1.0, -y_right]], over_ground)
        np.testing.assert_allclose(told[place][0], motion[place], rtol=1e-12)


def dead_reckoned(told, log, begin, n):
    """Error (3,) and covariance of the pose after n rows by a filter with the YAML's numbers.

    The filter is an EKF as that of robot_localization: pose and velocities (x, y, θ, u, v, w), of
    which the velocities walk, and twists of the driver, with its covariance. It begins at the true
    pose. Error and covariance are ahead and left of the true pose, and of the yaw.
    """
    driver = told["diff_drive_controller"]["ros__parameters"]
    radius = driver["left_wheel_radius_multiplier"]
    turns = radius / driver["wheel_separation_multiplier"]
    R = np.diag(np.array(driver["twist_covariance_diagonal"])[[0, 1, 5]])
    process = told["ekf_filter_node"]["ros__parameters"]["process_noise_covariance"]
    Q = np.diag(np.diag(np.reshape(process, (15, 15)))[[0, 1, 5, 6, 7, 11]])
    rows = log.iloc[begin : begin + n + 1]
    truth = rows[["x_true_m", "y_true_m", "yaw_true_rad"]].to_numpy()
    z = np.column_stack(
        [radius * rows["speed_mps"], 0 * rows["t_s"], turns * rows["yaw_rate_radps"]]
    )
    m = np.array([*truth[0], *z[0]])
    P = np.zeros((6, 6))
    P[3:, 3:] = R
    H = np.eye(6)[3:]
    for twist, dt_s in zip(z[1:], np.diff(rows["t_s"])):
        # The twist is a mean over the interval: it corrects the velocities that move the pose.
        P[3:, 3:] += Q[3:, 3:] * dt_s
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        m = m + K @ (twist - m[3:])
        P = (np.eye(6) - K @ H) @ P
        middle = m[2] + m[5] * dt_s / 2
        cos, sin = np.cos(middle), np.sin(middle)
        A = np.eye(6)
        A[:2, 3:5] = dt_s * np.array([[cos, -sin], [sin, cos]])
        A[:2, 2] = dt_s * (np.array([[-sin, -cos], [cos, -sin]]) @ m[3:5])
        A[2, 5] = dt_s
        m = m + np.append(
            dt_s * np.array([cos * m[3] - sin * m[4], sin * m[3] + cos * m[4], m[5]]), [0, 0, 0]
        )
        P = A @ P @ A.T + np.diag(np.append(np.diag(Q)[:3] * dt_s, [0, 0, 0]))
    yaw = truth[-1, 2]
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]
    return turn @ (m[:3] - truth[-1]), turn @ P[:3, :3] @ turn.T


def test_the_covariances_of_the_yaml_make_a_consistent_filter():
    """On other drives of the same robot 95 % of its errors after 15 s are within 1.96 σ."""
    learnt = verdicts.open_loop_log(1, duration_s=240.0)
    told = yaml.safe_load(rhec.log(learnt).yaml)
    errors, squares = [], []
    for seed in range(10, 22):
        log = verdicts.open_loop_log(seed, duration_s=240.0)
        for begin in range(50, 2200, 200):
            error, P = dead_reckoned(told, log, begin, 150)
            errors.append(error / np.sqrt(np.diag(P)))
            squares.append(error @ np.linalg.solve(P, error))
    inside = (np.abs(errors) <= 1.96).mean(axis=0)
    assert (inside > 0.85).all() and 0.5 < np.mean(squares) / 3 < 2


# Intervals: how many of them hold the truth


def is_plausible(k, n, least=0.90, most=0.99):
    """Whether k of n intervals may hold the truth in `least` to `most` of all cases."""
    low, high = share_interval(k, n)
    return high >= least and low <= most


def judged(seeds, worlds):
    """Rows of `verdicts.judged`: open loop, and closed loop in worlds."""
    rows = []
    for seed in seeds:
        known = [verdicts.MU, verdicts.KAPPA, 0.0]
        rows.append(verdicts.judged(verdicts.open_loop_log(seed, duration_s=120.0), known))
        rows += [verdicts.judged(verdicts.closed_loop_log(world, (), seed)) for world in worlds]
    return pd.DataFrame(rows)


def of_traction(rows, name):
    """How many intervals of `rhec.log` hold the truth."""
    return int(rows[f"{name}_true"].between(rows[f"{name}_low"], rows[f"{name}_high"]).sum())


@pytest.mark.parametrize(
    "seeds, worlds",
    [
        pytest.param(range(800, 802), ["soft"]),
        pytest.param(range(810, 850), [], marks=pytest.mark.nightly),
        pytest.param(range(850, 858), [*rhec.WORLDS], marks=pytest.mark.nightly),
    ],
)
def test_intervals_of_the_traction_and_the_yaw_hold_the_truth(seeds, worlds):
    """Those of the yaw may hold it more often: a robot may slip less than the defaults expect."""
    rows = judged(seeds, worlds)
    for name in ("μ", "κ", "drift"):
        assert is_plausible(of_traction(rows, name), len(rows)), (name, len(rows))
    assert rows["way_in_95"].mean() > 0.9 and rows["smoothed_in_95"].mean() > 0.9


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
