"""Bounds of states hold at all nodes of an RHE's window: its optimum is the one of IPOPT."""

import numpy as np
import pytest
from helpers import estimator
from oracles import draw, drive_robot, limits, mhe_by_ipopt, mhe_instance, robots_model
from robots import BICYCLE, CART, DT, SKID_STEERED, UNICYCLE

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
WALL_M = 0.9  # which the robot comes close to, with the first of its states


def instance(robot, rng, samples):
    """A guess and noisy measurements (n, n_z) of a robot that comes within 4 mm of the wall."""
    x, inputs, p = draw(robot, rng, samples - 1)
    states, z = drive_robot(robot, x, inputs, np.clip(p, *limits(robot)))
    shift = WALL_M - states[:, 0].max() - rng.uniform(0, 0.004)
    z[:, 0] += shift
    z += rng.normal(size=z.shape) * robot.sigma_v
    guess = np.append(x, np.clip(p, *limits(robot)))
    guess[0] = min(guess[0] + shift, WALL_M)
    return guess, z


def bounded(robot, guess, horizon, bounds=None, **more):
    """An RHE whose first state has the wall as its bound."""
    bounds = {robot.states[0]: (-60.0, WALL_M)} if bounds is None else bounds
    model = robots_model(robot, tuple(bounds.items()))
    options = dict(dt=DT, horizon=horizon, arrival_mean="filtered") | robot.estimator | more
    return rhec.RHE(model=model, guess=tuple(guess), **options)


def noise_of_samples(robot, rng, samples):
    """Standard deviations (n, n_x + n_p) of the process noise, no two samples alike."""
    return np.array(robot.sigma_w) * rng.uniform(1, 9, (samples, len(robot.sigma_w)))


# Whether there are bounds of states, and whether there is noise within the window.
KINDS = [(True, True), (True, False), (False, True)]


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("narrow, noisy", KINDS)
@pytest.mark.parametrize("robot", [BICYCLE, CART, SKID_STEERED, UNICYCLE])
def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds(robot, narrow, noisy):
    """On 6 random windows, with a bound of a state active in some of them."""
    bounds = {robot.states[0]: (-60.0, WALL_M)} if narrow else {}
    rng, active = np.random.default_rng(0), 0
    for _ in range(6):
        guess, z = instance(robot, rng, 7)
        mhe = bounded(robot, guess, 6, bounds, noise_in_window=noisy)
        sigma_w = noise_of_samples(robot, rng, len(z)) if noisy else None
        for k, row in enumerate(z):
            mhe.prepare()
            given = dict(sigma_w=sigma_w[k]) if noisy else {}
            if k < len(z) - 1:
                mhe.feedback(row, **given)
        found = mhe.solve(z[-1], iterations=60, **given)
        optimum = mhe_by_ipopt(robot, guess, z, sigma_w, bounds)
        assert mhe.converged and mhe.kkt < 1e-8
        for part in ("x", "u", "p"):
            np.testing.assert_allclose(getattr(found, part), optimum[part], rtol=0, atol=1e-6)
        np.testing.assert_allclose(mhe.x_window, optimum["states"], rtol=0, atol=1e-6)
        np.testing.assert_array_equal(mhe.u_window[:, -1], found.u)
        active += np.abs(optimum["states"][0] - WALL_M).min() < 1e-7
        mhe.step(z[-1])
        assert not mhe.converged
    assert active >= 2 if narrow else active == 0


def test_bounds_that_cannot_be_kept_end_in_a_prediction_and_a_restart():
    """A cart behind the wall: each estimate is finite and within its bounds; later it is right."""
    guess = np.zeros(3)
    mhe = bounded(CART, guess, 5)
    for k in range(120):
        mhe.prepare()
        found = mhe.feedback((1e5 if 10 <= k < 20 else 0.1, 0.0))
        assert np.isfinite(np.concatenate(found[:3])).all() and found.x[0] <= WALL_M
        assert np.isnan(mhe.kkt) or mhe.ok
    assert mhe.ok and abs(found.x[0] - 0.1) < 0.05


def test_without_an_argument_the_noise_is_that_which_it_was_made_with():
    """Also after a sample that had another."""
    guess, z = mhe_instance(BICYCLE, np.random.default_rng(2), 19)
    first, second = (estimator(BICYCLE, guess, horizon=5, noise_in_window=True) for _ in range(2))
    for k, row in enumerate(z):
        others = np.array(BICYCLE.sigma_w) * (7 if k == 8 else 1)
        one = first.step(row, sigma_w=others if k == 8 else None)
        np.testing.assert_array_equal(one.x, second.step(row, sigma_w=others).x)
