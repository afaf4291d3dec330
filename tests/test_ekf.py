"""The extended Kalman filter against the textbook's formulas, written here with plain matrices."""

import numpy as np
import pytest
from oracles import DT, V, drive, flat

from rhec._casadi import build as function
from rhec.tracked_robot import ekf as paper_ekf
from rhec.tracked_robot.kinematics import QUANTITIES

W = np.square([0.02, 0.02, 0.01, 0.05])
STEP = paper_ekf.build_step(DT)


def init(guess, sigma):
    return paper_ekf.init(4, *(dict(zip(QUANTITIES, values)) for values in (guess, sigma)))


def textbook(m, P, z, traction, first):
    """Predict with the Jacobian of eq. (23), then correct with all measurements at once."""
    mu, kappa = traction
    x, y, theta, nu = m
    if not first:
        ahead, turn = DT * mu * nu, DT * kappa * z[3]
        A = np.array(
            [
                [1, 0, -ahead * np.sin(theta), DT * mu * np.cos(theta)],
                [0, 1, ahead * np.cos(theta), DT * mu * np.sin(theta)],
                [0, 0, 1, 0],
                [0, 0, 0, 1],
            ]
        )
        m, P = (
            np.array([x + ahead * np.cos(theta), y + ahead * np.sin(theta), theta + turn, nu]),
            A @ P @ A.T + np.diag(W),
        )
    there = ~np.isnan(z[:3])
    H, R, y = np.eye(4)[[0, 1, 3]][there], np.diag(V[:3][there]), (z[:3] - m[[0, 1, 3]])[there]
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return m + K @ y, (np.eye(4) - K @ H) @ P, y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1]


def run(z, start, traction):
    memory, results = function.pack_array(start), []
    for reading in z:
        result = STEP(memory=memory, z_N=reading, V=V, W=W, traction=traction)
        memory = result["memory"]
        results.append(
            (flat(result["estimate"]), np.array(result["covariance"]), float(result["deviance"]))
        )
    return results


@pytest.mark.parametrize("traction", [(1, 1), (0.9, 0.7)])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_it_is_the_textbook_filter(traction, missing):
    """Estimate, covariance and deviance, at every sample; a silent sensor's row is not there."""
    rng = np.random.default_rng(0)
    _, z = drive((1, 2, 0.5, 0.5, 0.9, 0.8), rng.uniform(-0.5, 0.5, 100))
    z += rng.normal(size=z.shape) * np.sqrt(V)
    z[:, :3][rng.random((len(z), 3)) < missing] = np.nan
    m, P = np.array([0.9, 2.1, 0.3, 0.4]), np.diag([1, 1, 0.1, 0.2])
    for k, (estimate, covariance, deviance) in enumerate(
        run(z, init((*m, 1, 1), np.sqrt([1, 1, 0.1, 0.2, 1, 1])), traction)
    ):
        m, P, expected = textbook(m, P, z[k], traction, first=k == 0)
        np.testing.assert_allclose(estimate, [*m, *traction], atol=1e-10)
        np.testing.assert_allclose(covariance, P, atol=1e-10)
        np.testing.assert_array_equal(covariance, covariance.T)
        assert deviance == pytest.approx(expected, abs=1e-9)


def test_on_a_straight_line_it_is_the_kalman_filter():
    """With the yaw known and no yaw rate the model is linear: the best estimate of all readings and
    steps at once, by ordinary least squares.
    """
    rng, n = np.random.default_rng(1), 30
    _, z = drive((0, 0, 0, 0.5, 1, 1), np.zeros(n - 1))
    z[:, :3] += rng.normal(size=(n, 3)) * np.sqrt(V[:3])
    sigma, w = np.array([1.0, 1.0, 0.0, 0.3]), np.array([0.02, 0.03, 0.0, 0.05])
    memory = function.pack_array(init((0.3, -0.2, 0, 0.6, 1, 1), (*sigma, 1, 1)))
    for reading in z:
        result = STEP(memory=memory, z_N=reading, V=V, W=w**2, traction=(1, 1))
        memory = result["memory"]

    A = np.array([[1, 0, DT], [0, 1, 0], [0, 0, 1]])  # of (x, y, ν)
    rows, values = (
        [np.eye(3, 3 * n) / sigma[[0, 1, 3], None]],
        [np.array([0.3, -0.2, 0.6]) / sigma[[0, 1, 3]]],
    )
    for k in range(n):
        rows.append(np.eye(3, 3 * n, 3 * k) / np.sqrt(V[:3, None]))
        values.append(z[k, :3] / np.sqrt(V[:3]))
        if k:
            rows.append(
                (np.eye(3, 3 * n, 3 * k) - A @ np.eye(3, 3 * n, 3 * k - 3)) / w[[0, 1, 3], None]
            )
            values.append(np.zeros(3))
    best = np.linalg.lstsq(np.vstack(rows), np.concatenate(values), rcond=None)[0][-3:]
    np.testing.assert_allclose(flat(result["estimate"])[[0, 1, 3]], best, atol=1e-9)
    assert float(result["estimate"][2]) == 0


def test_while_the_yaw_rate_is_silent_the_last_one_holds():
    _, z = drive((0, 0, 0, 0.5, 1, 1), np.full(20, 0.3))
    start = init((0, 0, 0, 0.5, 1, 1), (1,) * 6)
    spoken = run(z, start, (1, 1))
    z[5:12, 3] = [np.nan, np.inf, 1e12, -np.inf, np.nan, np.nan, np.nan]
    silent = run(z, start, (1, 1))
    for one, other in zip(spoken, silent):
        np.testing.assert_array_equal(one[0], other[0])


@pytest.mark.parametrize("reading", [np.inf, -np.inf, 1e12])
@pytest.mark.parametrize("channel", range(3))
def test_a_reading_that_cannot_be_is_a_missing_one(channel, reading):
    _, z = drive((0, 0, 0, 0.5, 1, 1), np.full(20, 0.3))
    start = init((0.1, 0, 0, 0.5, 1, 1), (1,) * 6)
    z[[0, 5, 6], channel] = np.nan
    silent = run(z, start, (1, 1))
    z[[0, 5, 6], channel] = reading
    for one, other in zip(silent, run(z, start, (1, 1))):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])
