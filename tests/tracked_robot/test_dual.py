"""Dual estimation: the RHE's traction, and a pose by an EKF that is told it."""

import numpy as np
import pytest
from helpers import choice_of, weaving_yaw_rates, with_noise
from oracles import V, drive, flat

from rhec.core._casadi.packing import pack_array
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.tuning import SIGMA_W_TRACKING

pytestmark = pytest.mark.usefixtures("virtual_machine")
SIGMA_W = SIGMA_W_TRACKING["dual"]
HORIZON, TRUTH = 8, (1.0, 2.0, 0.4, 0.5, 0.9, 0.75)


def settings(sigma_w=SIGMA_W):
    return dict(V=V, W=np.square(sigma_w), P_0=np.ones(6))


def first(guess=TRUTH, robust=False):
    return memory_of("dual", guess, robust)


def memory_of(name, guess, robust=False):
    init = estimator_of(name, robust).init
    return pack_array(init(choice_of(name, HORIZON, robust=robust), dict(zip(QUANTITIES, guess))))


@pytest.fixture(scope="module")
def step():
    return build_step(choice_of("dual", HORIZON))


def readings(samples=120, noise=1.0, seed=0):
    truth, z = drive(TRUTH, weaving_yaw_rates(samples))
    return truth, with_noise(z, seed, noise)


def run(step, memory, z, **given):
    """Estimates (n, 6) after each row of z, and the last memory."""
    estimates = []
    for reading in z:
        result = step(memory=memory, z_N=reading, **(given or settings()))
        memory = result["memory"]
        estimates.append(flat(result["estimate"]))
    return np.array(estimates), memory


def test_without_noise_on_even_soil_it_stays_on_the_truth(step):
    truth, z = readings(noise=0.0)
    estimates, _ = run(step, first(), z)
    np.testing.assert_allclose(estimates, truth, atol=1e-5)


def test_its_traction_is_the_rhes_to_the_last_bit(step):
    """With the RHE's part of W, whatever the pose filter's part is."""
    _, z = readings()
    alone = build_step(choice_of("rhe", HORIZON))
    memory, expected = memory_of("rhe", TRUTH), []
    for reading in z:
        result = alone(memory=memory, z_N=reading, V=V, W=np.square(SIGMA_W[:6]), P_0=np.ones(6))
        memory = result["memory"]
        expected.append(flat(result["estimate"])[4:])
    for other in (SIGMA_W, (*SIGMA_W[:6], 1.0, 1.0, 0.5, 0.3)):
        estimates, _ = run(step, first(), z, **settings(other))
        np.testing.assert_array_equal(estimates[:, 4:], expected)


def test_traction_stays_within_its_bounds(step):
    """Also on soil on which the robot seems to go faster than its tracks."""
    _, z = drive((0, 0, 0, 0.5, 1.15, 1.2), weaving_yaw_rates(80))
    z = z + np.random.default_rng(1).normal(size=z.shape) * np.sqrt(V)
    estimates, _ = run(step, first((0, 0, 0, 0.5, 1, 1)), z)
    assert ((estimates[:, 4:] >= 0) & (estimates[:, 4:] <= 1)).all() and (
        estimates[:, 4:] == 1
    ).any()


def test_a_run_cut_in_two_goes_on_as_if_it_had_not_been(step):
    _, z = readings()
    whole, last = run(step, first(), z)
    one, memory = run(step, first(), z[:50])
    other, end = run(step, np.array(memory), z[50:])
    np.testing.assert_array_equal(np.concatenate([one, other]), whole)
    np.testing.assert_array_equal(flat(end), flat(last))


def test_its_pose_follows_the_readings_the_faster_the_more_noise_it_is_told(step):
    truth, z = readings()
    z[60:, :2] += [0.3, -0.2]  # the robot is pushed
    lags = []
    for factor in (0.2, 1, 5):
        sigma = np.array(SIGMA_W)
        sigma[6:8] *= factor
        estimates, _ = run(step, first(), z, **settings(sigma))
        lags.append(np.abs(estimates[60:, :2] - truth[60:, :2] - [0.3, -0.2]).mean())
    assert lags[0] > lags[1] > lags[2]


def test_screening_changes_little_on_clean_readings(step):
    _, z = readings(60)
    plain, _ = run(step, first(), z)
    screened, _ = run(build_step(choice_of("dual", HORIZON, robust=True)), first(robust=True), z)
    assert np.abs(screened - plain)[:, :4].max() < 0.05
    assert np.median(np.abs(screened - plain)) < 1e-6
