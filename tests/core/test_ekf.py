"""The extended Kalman filter against the textbook's formulas, written here with plain matrices."""

import numpy as np
import pytest
from helpers import answers_of, choice_of, weaving_yaw_rates, with_noise
from oracles import DT, V, drive, flat
from scipy.optimize import lsq_linear

import rhec
from notebooks.rivals import by_name, held_traction
from rhec.core.model.robot_model import MotionNoise
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

SIGMA_W = np.array([0.01, 0.01, 0.02, 0.01, 0.02, 0.02])
START = (0, 0, 0, 0.5, 1, 1)


def estimated(name, z, guess=START, sigma=(1.0,) * 6, traction=(1, 1)):
    """Estimates (n, 6), covariances and deviances of an EKF or a rival that is told a traction."""
    choice = choice_of(by_name(name) if isinstance(name, str) else name, 5)
    first = [dict(zip(QUANTITIES, values)) for values in (guess, sigma)]
    n_w = estimator_of(choice.estimator).n_sigma_w(choice)
    settings = dict(W=np.square(SIGMA_W[:n_w]), P_0=np.ones(n_w), m_0=guess[:n_w])
    settings |= dict(traction=traction, mean_traction=traction)
    answers = answers_of(choice, z, *first, V=V, **settings)
    names = [name for name in ("estimate", "covariance", "deviance") if name in answers[0]]
    return [np.array([of[name].full().squeeze() for of in answers]) for name in names]


def textbook(m, P, z, first):
    """Predict with the Jacobian of eq. (23), then correct with all measurements at once."""
    x, y, theta, nu = m
    if not first:
        ahead, turn = DT * nu, DT * z[3]
        A = np.array(
            [
                [1, 0, -ahead * np.sin(theta), DT * np.cos(theta)],
                [0, 1, ahead * np.cos(theta), DT * np.sin(theta)],
                [0, 0, 1, 0],
                [0, 0, 0, 1],
            ]
        )
        m, P = (
            np.array([x + ahead * np.cos(theta), y + ahead * np.sin(theta), theta + turn, nu]),
            A @ P @ A.T + np.diag(np.square(SIGMA_W[:4])),
        )
    there = ~np.isnan(z[:3])
    H, R, y = np.eye(4)[[0, 1, 3]][there], np.diag(V[:3][there]), (z[:3] - m[[0, 1, 3]])[there]
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return m + K @ y, (np.eye(4) - K @ H) @ P, y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1]


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_it_is_the_textbook_filter(missing):
    """Estimate, covariance and deviance, at every sample; a silent sensor's row is not there."""
    rng = np.random.default_rng(0)
    _, z = drive((1, 2, 0.5, 0.5, 0.9, 0.8), rng.uniform(-0.5, 0.5, 100))
    z += rng.normal(size=z.shape) * np.sqrt(V)
    z[:, :3][rng.random((len(z), 3)) < missing] = np.nan
    m, P = np.array([0.9, 2.1, 0.3, 0.4]), np.diag([1, 1, 0.1, 0.2])
    found = estimated("ekf", z, (*m, 1, 1), np.sqrt([*np.diag(P), 1, 1]))
    for k, (estimate, covariance, deviance) in enumerate(zip(*found)):
        m, P, expected = textbook(m, P, z[k], first=k == 0)
        np.testing.assert_allclose(estimate, [*m, 1, 1], atol=1e-10)
        np.testing.assert_allclose(covariance, P, atol=1e-10)
        np.testing.assert_array_equal(covariance, covariance.T)
        assert deviance == pytest.approx(expected, abs=1e-9)


def test_while_the_yaw_rate_is_silent_the_last_one_holds():
    _, z = drive((0, 0, 0, 0.5, 1, 1), np.full(20, 0.3))
    spoken, *_ = estimated("ekf", z)
    z[5:12, 3] = [np.nan, np.inf, 1e12, -np.inf, np.nan, np.nan, np.nan]
    silent, *_ = estimated("ekf", z)
    np.testing.assert_array_equal(spoken, silent)


# The rivals


def test_an_interval_is_predicted_with_the_traction_it_was_driven_on():
    rng = np.random.default_rng(0)
    tractions = rng.uniform(0.5, 1, (40, 2))
    truth, z = [np.array([0, 0, 0, 0.5, *tractions[0]])], [[0, 0, 0.5, 0]]
    for here, there in zip(tractions, tractions[1:]):
        after, readings = drive((*truth[-1][:4], *here), [rng.uniform(-1, 1)])
        truth.append(np.array([*after[1, :4], *there]))
        z.append(readings[1])
    estimates, *_ = estimated("traction_oracle", np.array(z), truth[0], (1e-3,) * 6, tractions)
    np.testing.assert_allclose(estimates, truth, atol=1e-3)


def test_the_bounded_estimate_is_the_likeliest_within_the_bounds():
    """Of the Gaussian that the augmented EKF has, by bounded least squares.

    The two are the same filter until a bound counts; by then motion has correlated all states.
    """
    rng = np.random.default_rng(3)
    sides = [(-np.inf,) * 4 + (0, 0), (np.inf,) * 4 + (1, 1)]
    sigma = np.linspace(0.7, 1.3, 6)
    moved = []
    for mu in [-0.4, 1.6] * 6:
        z = with_noise(drive((0, 0, 0, 0.5, mu, 0.8), [0.4] * 5)[1], rng.integers(1000))
        guess = (0, 0, 0, 0.5, *rng.uniform(0.3, 0.7, 2))
        free, P, *_ = estimated("augmented_ekf", z, guess, sigma)
        bounded, same, *_ = estimated("bounded_ekf", z, guess, sigma)
        first = np.argmax((free != bounded).any(axis=1))
        root = np.linalg.inv(np.linalg.cholesky(P[first]))
        best = lsq_linear(root, root @ free[first], sides, tol=1e-14).x
        np.testing.assert_allclose(bounded[first], best, atol=1e-6)
        np.testing.assert_allclose(same[first], P[first], atol=1e-12)
        moved.append(np.abs(bounded[first] - free[first]))
    assert (np.max(moved, axis=0) > 1e-5).all()  # so that each state shows the formula


@pytest.mark.parametrize(
    "name, held", [("rhe_fixed_traction", (0.8, 0.6)), ("rhe_no_slip", (1, 1))]
)
def test_an_rhe_with_the_traction_held_is_the_rhe_that_is_sure_of_it(name, held):
    z = with_noise(drive((0, 0, 0, 0.5, 0.7, 0.7), weaving_yaw_rates(40))[1])
    guess = (0, 0, 0, 0.5, *held)
    choice = choice_of("rhe", 5)
    alone = held_traction.rival(name, 5, choice.arrival_mean)
    sigma = (0.5, 0.6, 0.7, 0.8)
    estimates, covariances, *_ = estimated(alone, z, guess, (*sigma, 1, 1), traction=held)
    np.testing.assert_array_equal(estimates[:, 4:], np.broadcast_to(held, (len(z), 2)))
    first, sure = (dict(zip(QUANTITIES, each)) for each in (guess, (*sigma, 1e-7, 1e-7)))
    W = np.square([*SIGMA_W[:4], 1e-9, 1e-9])
    for k, of in enumerate(answers_of(choice, z, first, sure, V=V, W=W, P_0=np.ones(6), m_0=guess)):
        np.testing.assert_allclose(estimates[k], flat(of["estimate"]), atol=1e-6)
        np.testing.assert_allclose(covariances[k], of["covariance"][:4, :4], atol=1e-6)


@pytest.mark.parametrize("u", [0.0, -2.0, 3.0])
def test_noise_of_ones_own_that_grows_with_the_motion_adds_up(u, virtual_machine):
    """Over a sample without a position: R (1 + u²) dt² + W (1 + 2 u²) dt."""
    noise = MotionNoise(
        {}, lambda u, R, c: (u, R * (1 + u**2)), lambda u, W, dt_s, c: W * (1 + 2 * u**2) * dt_s
    )
    model = rhec.Model(
        states="x", inputs="v", outputs=("x", "v"), f=lambda x, u, p: u, motion_noise=noise
    )
    known = dict(sigma_v=[0.1, 0.2], sigma_w=[0.3], guess=[0.0], sigma_guess=[1.0])
    ekf = rhec.EKF(model=model, dt=0.5, **known)
    before, after = (ekf.step([x, u]).covariance.item() for x in (0.0, np.nan))
    added = 0.2**2 * (1 + u**2) * 0.5**2 + 0.3**2 * (1 + 2 * u**2) * 0.5
    assert after - before == pytest.approx(added, rel=1e-9)
