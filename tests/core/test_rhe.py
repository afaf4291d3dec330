"""The paper's receding horizon estimation: eq. (10), its arrival cost, and what it makes of sensors
that are silent or lie. What holds for any Model is in test_any_robot.
"""

import numpy as np
import pytest
from helpers import weaving_yaw_rates, with_noise
from oracles import N, drive, flat, mhe_by_ipopt, mhe_instance
from robots import CRAWLER

import rhec
from benchmark.condensed import box_qp_by_library
from rhec import paper
from rhec.core.solver.box_qp import box_qp
from rhec.tracked_robot.own_loop import Estimate

pytestmark = pytest.mark.usefixtures("virtual_machine")
GUESS = (0.0, 0.0, 0.0, 0.5, 0.9, 0.8)


def feed(rhe, z):
    """The estimates after each row of z."""
    estimates = []
    for reading in z:
        rhe.prepare()
        estimates.append(rhe.feedback(reading))
    return estimates


def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds():
    """Of a full window; a third of these or more with a traction coefficient at its bound."""
    rng, bounded = np.random.default_rng(0), 0
    for _ in range(12):
        guess, z = mhe_instance(CRAWLER, rng)
        rhe = rhec.RHE(guess=tuple(guess), sigma_v=paper.SIGMA_V)
        feed(rhe, z[:-1])
        rhe.prepare()
        estimate, optimum = rhe.solve(z[-1]), mhe_by_ipopt(CRAWLER, guess, z)
        found = [*estimate.pose, *estimate.p]
        np.testing.assert_allclose(found, [*optimum["x"], *optimum["p"]], rtol=0, atol=1e-6)
        covariance = optimum["covariance"]()
        np.testing.assert_allclose(estimate.covariance, covariance, rtol=1e-5, atol=1e-8)
        assert rhe.ok and rhe.kkt < 1e-8
        bounded += 1 in (estimate.mu, estimate.kappa)
    assert 4 <= bounded < 12


def test_the_first_estimate_knows_the_yaw_as_a_guess_or_a_sensor_does_and_else_not_at_all():
    z = [1.0, 2.0, 0.5, 0.0]
    alone = feed(rhec.RHE(), [z])[0]
    guessed = feed(rhec.RHE(guess=GUESS), [z])[0]
    with_heading = feed(rhec.RHE(sensors=("heading",)), [[*z, 2.0]])[0]
    sigmas = [each.covariance[2, 2] ** 0.5 for each in (alone, guessed, with_heading)]
    assert sigmas[0] >= np.pi / 2 > 10 * sigmas[1] > 20 * sigmas[2]
    assert with_heading.theta == pytest.approx(2.0, abs=1e-3)


def test_without_a_guess_it_begins_at_the_first_position_that_can_be():
    (estimate,) = feed(rhec.RHE(), [(500.0, -300.0, 0.4, 0.0)])
    assert isinstance(estimate, Estimate)
    assert estimate[:6] == pytest.approx((500, -300, 0, 0.4, 1, 1))
    for first in ((np.nan,) * 4, (1e12, -1e300, np.inf, 0.0)):
        estimate = feed(rhec.RHE(), [first, (5e5, 4e6, 0.5, 0.0), (5e5, 4e6, 0.5, 0.0)])[-1]
        assert estimate[:4] == pytest.approx((5e5, 4e6, 0, 0.5), rel=1e-6, abs=0.2)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_qp_in_the_bounded_parameters_is_solved_as_by_other_solvers(n):
    rng, own, active = np.random.default_rng(5), box_qp(n), 0
    for k in range(100):
        A, g = rng.normal(size=(n, n)), rng.normal(size=n)
        problem = dict(H=A @ A.T + 0.01 * np.eye(n), g=g, lb=-rng.random(n), ub=rng.random(n))
        solution = own(**problem)
        expected = np.clip(-g / problem["H"][0], problem["lb"], problem["ub"])
        if n > 1:
            other = box_qp_by_library(n, ("daqp", "qpoases")[k % 2])(**problem)
            assert other["solved"] == 1
            expected = flat(other["x"])
        assert solution["solved"] == 1
        x = flat(solution["x"])
        np.testing.assert_allclose(x, expected, rtol=0, atol=1e-8)
        active += np.any((x == problem["lb"]) | (x == problem["ub"]))
    assert active > 30


# Sensors that are silent, or lie


@pytest.mark.parametrize("channel", range(4))
def test_a_reading_that_cannot_be_is_a_missing_one(channel):
    _, z = drive(GUESS, weaving_yaw_rates(2 * N))
    z = with_noise(z, np.random.default_rng(10))
    wrong = [0, *range(7, 25, 3)]  # the first one, where nothing else is known, and later ones
    z[wrong, channel] = np.nan
    silent = feed(rhec.RHE(), z)
    for reading in (np.inf, -np.inf, 1e12, -1e300):
        z[wrong, channel] = reading
        absurd = feed(rhec.RHE(), z)
        for one, other in zip(silent, absurd):
            np.testing.assert_array_equal(
                np.append(one[:6], one.covariance), np.append(other[:6], other.covariance)
            )


def test_where_positions_have_moved_for_good_it_begins_anew_as_if_nothing_slips():
    """The robot may have been carried to other soil."""
    _, z = drive((0.0, 0.0, 0.0, 0.5, 0.6, 0.5), weaving_yaw_rates(12 * N))
    z[-N:, 0] += 100.0
    estimates = feed(rhec.RHE(guess=GUESS, process_noise="prediction"), z)
    before = estimates[-N - 1]
    moved = estimates[-N + 3]
    assert (before.mu, before.kappa) == pytest.approx((0.6, 0.5), abs=0.15)
    assert (moved.mu, moved.kappa) == pytest.approx((1, 1), abs=0.02)
