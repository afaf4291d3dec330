"""Process noise within the window of an RHE, by sample, on a linear robot."""

import numpy as np
import pytest
from helpers import estimator
from oracles import kalman_filter, mhe_instance
from robots import BICYCLE, CART

pytestmark = pytest.mark.usefixtures("virtual_machine")


def noise_of_samples(robot, rng, samples):
    """Standard deviations (n, n_x + n_p) of the process noise, no two samples alike."""
    sigma_w = 3 * np.array(robot.sigma_w)
    return sigma_w * rng.uniform(0.3, 3, (samples, len(sigma_w)))


@pytest.mark.parametrize("horizon, exact", [(2, ()), (9, (1,)), (9, (0, 1, 2))])
def test_on_a_linear_robot_it_is_the_kalman_filter(horizon, exact):
    """At every sample by one iteration each, a third of the positions missing. The length of the
    window makes no difference. Of some states and samples there is no noise.
    """
    rng = np.random.default_rng(0)
    guess, z = mhe_instance(CART, rng, 34, missing=0.3)
    sigma_w = noise_of_samples(CART, rng, len(z))
    sigma_w[:, exact] = 0
    sigma_w[20:25] = 0
    mhe = estimator(CART, guess, horizon=horizon, noise_in_window=True)
    for k, row in enumerate(z):
        mhe.prepare()
        found = mhe.feedback(row, sigma_w=sigma_w[k])
        given = (CART.sigma_guess, CART.sigma_v, sigma_w[: k + 1])
        m, P, u, _ = kalman_filter(z[: k + 1], guess, *given, leaving=k)
        np.testing.assert_allclose(np.append(found.x, found.p), m, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.covariance, P, rtol=0, atol=1e-9)
        np.testing.assert_allclose(mhe.x_window[:, -1], found.x, rtol=0, atol=1e-9)
        if k:
            np.testing.assert_allclose(found.u, [u], rtol=0, atol=1e-9)
            np.testing.assert_allclose(mhe.u_window[:, -1], [u], rtol=0, atol=1e-9)
    assert mhe.ok


def test_without_an_argument_it_is_the_noise_that_it_was_made_with():
    """Also after a sample that had another."""
    guess, z = mhe_instance(BICYCLE, np.random.default_rng(2), 19)
    first, second = (estimator(BICYCLE, guess, horizon=5, noise_in_window=True) for _ in range(2))
    for k, row in enumerate(z):
        others = np.array(BICYCLE.sigma_w) * (7 if k == 8 else 1)
        first.prepare(), second.prepare()
        one = first.feedback(row, sigma_w=others if k == 8 else None)
        np.testing.assert_array_equal(one.x, second.feedback(row, sigma_w=others).x)
