"""The extended Kalman filter against the textbook's formulas, written here with plain matrices."""

import numpy as np
import pytest
from guard_table import model_of, settings_of
from helpers import choice_of, with_noise
from oracles import DT, V, drive, flat
from scipy.optimize import lsq_linear

import rhec
from notebooks.rivals import by_name, held_traction
from rhec.core._casadi import packing
from rhec.core.model.robot_model import MotionNoise
from rhec.tracked_robot import paper_rhe
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

W = np.square([0.02, 0.02, 0.01, 0.05])
PAPERS = choice_of("ekf", 5)
STEP = build_step(PAPERS)


def init(guess, sigma):
    first = (dict(zip(QUANTITIES, values)) for values in (guess, sigma))
    return estimator_of("ekf").init(PAPERS, *first)


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
            A @ P @ A.T + np.diag(W),
        )
    there = ~np.isnan(z[:3])
    H, R, y = np.eye(4)[[0, 1, 3]][there], np.diag(V[:3][there]), (z[:3] - m[[0, 1, 3]])[there]
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    return m + K @ y, (np.eye(4) - K @ H) @ P, y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1]


def run(z, start):
    memory, results = packing.pack_array(start), []
    for reading in z:
        result = STEP(memory=memory, z_N=reading, V=V, W=W)
        memory = result["memory"]
        results.append(
            (flat(result["estimate"]), np.array(result["covariance"]), float(result["deviance"]))
        )
    return results


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_it_is_the_textbook_filter(missing):
    """Estimate, covariance and deviance, at every sample; a silent sensor's row is not there."""
    rng = np.random.default_rng(0)
    _, z = drive((1, 2, 0.5, 0.5, 0.9, 0.8), rng.uniform(-0.5, 0.5, 100))
    z += rng.normal(size=z.shape) * np.sqrt(V)
    z[:, :3][rng.random((len(z), 3)) < missing] = np.nan
    m, P = np.array([0.9, 2.1, 0.3, 0.4]), np.diag([1, 1, 0.1, 0.2])
    for k, (estimate, covariance, deviance) in enumerate(
        run(z, init((*m, 1, 1), np.sqrt([1, 1, 0.1, 0.2, 1, 1])))
    ):
        m, P, expected = textbook(m, P, z[k], first=k == 0)
        np.testing.assert_allclose(estimate, [*m, 1, 1], atol=1e-10)
        np.testing.assert_allclose(covariance, P, atol=1e-10)
        np.testing.assert_array_equal(covariance, covariance.T)
        assert deviance == pytest.approx(expected, abs=1e-9)


def test_while_the_yaw_rate_is_silent_the_last_one_holds():
    _, z = drive((0, 0, 0, 0.5, 1, 1), np.full(20, 0.3))
    start = init((0, 0, 0, 0.5, 1, 1), (1,) * 6)
    spoken = run(z, start)
    z[5:12, 3] = [np.nan, np.inf, 1e12, -np.inf, np.nan, np.nan, np.nan]
    silent = run(z, start)
    for one, other in zip(spoken, silent):
        np.testing.assert_array_equal(one[0], other[0])


# The rivals

SIGMA_W = (0.01, 0.01, 0.02, 0.01, 0.02, 0.02)


def sine_of_yaw_rates(samples, size=0.3):
    return size * np.sin(0.3 * np.arange(samples))


def rival(name, z, guess, sigma=(1.0,) * 6, traction=None):
    """Estimates (n, 6) and covariances of a rival or "bounded_ekf", told a `traction`, one or one
    a sample.
    """
    of = estimator_of(by_name(name) if isinstance(name, str) else name)
    step = of.build_step(PAPERS)
    first = [dict(zip(QUANTITIES, values)) for values in (guess, sigma)]
    memory, rows = packing.pack_array(of.init(PAPERS, *first)), []
    n, n_w = len(z), of.n_sigma_w(PAPERS)
    given = dict(V=V, W=np.square(SIGMA_W[:n_w]), P_0=np.ones(n_w), m_0=guess[:n_w])
    told = np.broadcast_to((1, 1) if traction is None else traction, (n, 2))
    for reading, p in zip(z, told):
        known = given | dict(memory=memory, z_N=reading, traction=p, mean_traction=p)
        result = step(**{name: known[name] for name in step.name_in()})
        memory = result["memory"]
        rows.append((flat(result["estimate"]), np.array(result["covariance"])))
    return [np.array(each) for each in zip(*rows)]


def test_an_interval_is_predicted_with_the_traction_it_was_driven_on():
    rng = np.random.default_rng(0)
    tractions = rng.uniform(0.5, 1, (40, 2))
    truth, z = [np.array([0, 0, 0, 0.5, *tractions[0]])], [[0, 0, 0.5, 0]]
    for here, there in zip(tractions, tractions[1:]):
        after, readings = drive((*truth[-1][:4], *here), [rng.uniform(-1, 1)])
        truth.append(np.array([*after[1, :4], *there]))
        z.append(readings[1])
    estimates, _ = rival("traction_oracle", np.array(z), truth[0], (1e-3,) * 6, tractions)
    np.testing.assert_allclose(estimates, truth, atol=1e-3)


def test_a_filter_begins_with_the_variances_of_its_guess():
    """Its first memory is the mean, and the squares of the deviations on the diagonal."""
    guess = np.arange(6.0)
    sigma = np.arange(1.0, 8.0) / 10
    memory = by_name("augmented_ekf").first(guess, sigma).full().ravel()
    np.testing.assert_allclose(memory[:6], guess)
    np.testing.assert_allclose(memory[6:42].reshape(6, 6), np.diag(sigma[:6] ** 2))


def test_the_bounded_estimate_is_the_likeliest_within_the_bounds():
    """Of the Gaussian that the augmented EKF has, by bounded least squares.

    The two are the same filter until a bound counts; by then motion has correlated all states.
    """
    rng = np.random.default_rng(3)
    sides = [(-np.inf,) * 4 + (0, 0), (np.inf,) * 4 + (1, 1)]
    moved = []
    for mu in [-0.4, 1.6] * 6:
        z = with_noise(drive((0, 0, 0, 0.5, mu, 0.8), [0.4] * 5)[1], rng.integers(1000))
        guess = (0, 0, 0, 0.5, *rng.uniform(0.3, 0.7, 2))
        free, P = rival("augmented_ekf", z, guess)
        bounded, same = rival("bounded_ekf", z, guess)
        first = np.argmax((free != bounded).any(axis=1))
        root = np.linalg.inv(np.linalg.cholesky(P[first]))
        best = lsq_linear(root, root @ free[first], sides, tol=1e-14).x
        np.testing.assert_allclose(bounded[first], best, atol=1e-6)
        np.testing.assert_allclose(same[first], P[first], atol=1e-12)
        moved.append(np.abs(bounded[first] - free[first]))
    assert (np.max(moved, axis=0) > 1e-5).all()  # so that each state shows the formula


@pytest.mark.parametrize("name, told", [("rhe_fixed_traction", (0.8, 0.6)), ("rhe_no_slip", None)])
def test_an_rhe_with_the_traction_held_is_the_rhe_that_is_sure_of_it(name, told):
    held = told or (1, 1)
    z = with_noise(drive((0, 0, 0, 0.5, 0.7, 0.7), sine_of_yaw_rates(40, 0.1))[1])
    guess = (0, 0, 0, 0.5, *held)
    choice = choice_of("rhe", 5)
    alone = held_traction.rival(name, 5, choice.arrival_mean)
    estimates, covariances = rival(alone, z, guess, traction=told)
    np.testing.assert_array_equal(estimates[:, 4:], np.broadcast_to(held, (len(z), 2)))
    step, first = build_step(choice), dict(zip(QUANTITIES, guess))
    sure = dict(zip(QUANTITIES, (1.0,) * 4 + (1e-7,) * 2))
    memory = packing.pack_array(paper_rhe.init(paper_rhe.window_of(choice), first, sure))
    W = np.square([*SIGMA_W[:4], 1e-9, 1e-9])
    for reading, estimate, covariance in zip(z, estimates, covariances):
        result = step(memory=memory, z_N=reading, V=V, W=W, P_0=np.ones(6), m_0=guess)
        memory = result["memory"]
        np.testing.assert_allclose(estimate, flat(result["estimate"]), atol=1e-6)
        np.testing.assert_allclose(covariance, np.array(result["covariance"])[:4, :4], atol=1e-6)


def test_before_its_first_sample_it_says_what_an_rhe_says(virtual_machine):
    ekf = rhec.EKF(model=model_of("unicycle"), dt=0.2, **settings_of("unicycle"))
    for _ in range(2):
        assert not ekf.ok and ekf.status == rhec.RHE().status != ""
        ekf.step((0.0, 0.0, 1.0, 0.0))
        assert ekf.ok and ekf.status == ""
        ekf.restart()


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
