"""Moving horizon estimation and model predictive control for any robot: on those of `robots` they
solve what is written down independently in `oracles`.
"""

import itertools

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from helpers import controller, estimator, model
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import (
    cart_matrices,
    kalman_filter,
    limits,
    mhe_by_ipopt,
    mhe_instance,
    mpc_by_ipopt,
    mpc_instance,
    plant,
)
from robots import BICYCLE, CART, DT, ROBOTS, SKID_STEERED, VARIANTS, N

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
EVERY_ROBOT = [BICYCLE, *ROBOTS.values(), *VARIANTS.values()]
EVERY_ROBOT = [*dict.fromkeys(EVERY_ROBOT)]  # the bicycle first
names = {robot: name for name, robot in (ROBOTS | VARIANTS).items()}.get


def estimates(mhe, z, **iterations):
    """The estimate after each row of z, by one iteration each or by as many as asked for."""
    found = []
    for row in z:
        mhe.prepare()
        found.append(mhe.solve(row, **iterations) if iterations else mhe.feedback(row))
    return found


# The linear robot


def discrete_cart(x, u, p):
    A, B = cart_matrices()
    return (ca.DM(A) @ ca.vertcat(x, p) + ca.DM(B) @ u)[:2]


@pytest.mark.parametrize(
    "horizon, share, discrete",
    [(2, 0, False), (15, 0, True), (2, 1, True), (15, 1, False), (None, 1, False)],
)
def test_on_a_linear_robot_it_is_the_kalman_filter(horizon, share, discrete):
    """At every sample, by one iteration each; without a horizon it is the EKF.

    Without process noise (share 0) the window's length makes no difference; with it, what has
    left the window was filtered with W, the window without.
    """
    guess, z = mhe_instance(CART, np.random.default_rng(0), 44, missing=0.3)
    z[22:32, 0] = np.nan
    sigma_w = tuple(share * np.array(CART.sigma_w))
    told = dict(f=discrete_cart, discrete=True) if discrete else {}
    settings = dict(dt=DT, guess=tuple(guess), **CART.estimator) | dict(sigma_w=sigma_w)
    settings |= dict(model=rhec.Model(**CART.model | told))
    window = dict(horizon=horizon, arrival_mean="filtered")
    live = rhec.RHE(**settings, **window) if horizon else rhec.EKF(**settings)
    for k, row in enumerate(z):
        found = live.step(row)
        noise = (CART.sigma_guess, CART.sigma_v, sigma_w)
        leaving = k - (horizon or 0)
        m, P, u, deviance = kalman_filter(z[: k + 1], guess, *noise, leaving=leaving)
        np.testing.assert_allclose([*found.x, *found.p], m, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.covariance, P, rtol=0, atol=1e-9)
        if k and horizon:
            np.testing.assert_allclose(found.u, [u], rtol=0, atol=1e-9)
            told_deviance = float(live.iteration.arrays["deviance"][0])
            assert told_deviance == pytest.approx(deviance, abs=1e-7)


# The nonlinear problems


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("robot", EVERY_ROBOT, ids=names)
def test_iterated_to_convergence_the_rhe_is_the_optimum_that_ipopt_finds(robot):
    """On 16 random windows, half of them with gaps, some of which fill up; where parameters have
    bounds, at least a quarter with one at its bound.
    """
    rng, bounded = np.random.default_rng(3), 0
    for k in range(16):
        intervals = N if k % 4 else (1, 2, 8)[k // 4 % 3]
        guess, z = mhe_instance(robot, rng, intervals, missing=0.2 * (k % 2))
        mhe = estimator(robot, guess)
        estimates(mhe, z[:-1])
        mhe.prepare()
        estimate, optimum = mhe.solve(z[-1], iterations=40), mhe_by_ipopt(robot, guess, z)
        for part in ("x", "u", "p"):
            np.testing.assert_allclose(getattr(estimate, part), optimum[part], rtol=0, atol=1e-6)
        np.testing.assert_allclose(
            estimate.covariance, optimum["covariance"](), rtol=1e-5, atol=1e-8
        )
        assert mhe.ok and mhe.kkt < 1e-8
        low, high = limits(robot)
        at_bounds = int(np.sum((estimate.p == low) | (estimate.p == high)))
        assert at_bounds == optimum["at_bounds"]
        bounded += at_bounds > 0
    if np.isfinite(limits(robot)).any():
        assert 4 <= bounded <= 15


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("robot", EVERY_ROBOT, ids=names)
def test_iterated_to_convergence_the_rhc_is_the_optimum_that_ipopt_finds(robot):
    """On 15 random instances, at least a third of them with a command at its bound; the plan is a
    trajectory of the model from the state.
    """
    rng, step, bounded = np.random.default_rng(5), plant(robot), 0
    low, high = np.array([robot.bounds[name] for name in robot.inputs]).T[:, :, None]
    for _ in range(15):
        problem, mpc = mpc_instance(robot, rng), controller(robot)
        command, optimum = mpc.solve(**problem, iterations=40), mpc_by_ipopt(robot, **problem)
        np.testing.assert_allclose(mpc.u_plan, optimum, rtol=0, atol=1e-6)
        np.testing.assert_array_equal(command, mpc.u_plan[:, 0])
        assert mpc.ok and mpc.kkt < 1e-8
        bounded += np.any((mpc.u_plan == low) | (mpc.u_plan == high))
        states = mpc.x_plan
        np.testing.assert_array_equal(states[:, 0], problem["x"])
        for i in range(N):
            after, _ = step(states[:, i], mpc.u_plan[:, i], problem["p"])
            np.testing.assert_allclose(states[:, i + 1], np.array(after)[:, 0], atol=1e-8)
    assert 5 <= bounded <= 15


def commanding(robot, *command):
    """A controller of a robot that commands these inputs alone, and their places."""
    places = [robot.inputs.index(name) for name in command]
    bounds = {name: robot.bounds[name] for name in command}
    weights = [robot.r[place] for place in places]
    return controller(robot, command=command, bounds=bounds, r=weights), places


@pytest.mark.parametrize("command", BICYCLE.inputs)
def test_an_input_that_is_not_commanded_stays_at_its_reference(command):
    rng = np.random.default_rng(6)
    for _ in range(6):
        problem = mpc_instance(BICYCLE, rng)
        mpc, (place,) = commanding(BICYCLE, command)
        u = mpc.solve(**problem, iterations=40)
        optimum = mpc_by_ipopt(BICYCLE, **problem, command=(command,))
        np.testing.assert_allclose(u, optimum[:, 0], rtol=0, atol=1e-6)
        np.testing.assert_array_equal(u[1 - place], problem["u_ref"][1 - place, 0])


# One model, three forms


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("robot", EVERY_ROBOT, ids=names)
def test_a_replayed_log_gives_the_estimates_of_the_live_objects(robot):
    """In each segment; rows between the samples are predicted to their own time."""
    rng = np.random.default_rng(9)
    guess, z = mhe_instance(robot, rng, 60, missing=0.2)
    t_s = DT * np.arange(len(z))
    log = pd.DataFrame(dict(zip(robot.outputs, z.T))).assign(t_s=t_s, segment=0)
    log = pd.concat([log, log.assign(t_s=t_s + 100.0, segment=1)], ignore_index=True)
    given = dict(dt=DT, guess=tuple(guess), **robot.estimator)
    by_rhe = rhec.replay(log, model=model(robot), horizon=N, arrival_mean="filtered", **given)
    by_ekf = rhec.replay(log, "ekf", model=model(robot), **given)
    ekf = rhec.EKF(model=model(robot), **given)
    estimated = [*robot.states, *robot.parameters]
    for replayed, live in (
        (by_rhe, estimates(estimator(robot, guess), z)),
        (by_ekf, estimates(ekf, z)),
    ):
        for part in (replayed[: len(z)], replayed[len(z) :]):
            hats = [f"{name}_hat" for name in model(robot).names]
            expected = np.array([[*e.x, *e.u, *e.p] for e in live])
            np.testing.assert_allclose(part[hats], expected, rtol=0, atol=1e-9)
            sigma = np.sqrt([np.diag(e.covariance) for e in live])
            sigmas = [f"{name}_sigma" for name in estimated]
            np.testing.assert_allclose(part[sigmas], sigma, rtol=0, atol=1e-9)
        assert replayed["ok"].all()


# Whatever comes


numbers = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-3, 3)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "robot", [each for each in EVERY_ROBOT if np.isfinite(limits(each)).any()], ids=names
)
@settings(max_examples=30, deadline=None)
@given(data=st.data())
def test_estimates_never_leave_their_bounds(robot, data):
    """Whatever is measured, and wherever the first guess was; and they stay numbers."""
    low, high = limits(robot)
    n_z, n_s = len(robot.outputs), len(robot.sigma_w)
    guess = data.draw(st.lists(st.floats(0, 0.07), min_size=n_s, max_size=n_s))
    guess[len(robot.states) :] = np.clip(guess[len(robot.states) :], low, high)
    z = data.draw(
        st.lists(st.lists(numbers, min_size=n_z, max_size=n_z), min_size=1, max_size=2 * N)
    )
    for estimate in estimates(estimator(robot, guess), z):
        assert np.all((low <= estimate.p) & (estimate.p <= high))
        for part in (estimate.x, estimate.u, estimate.p):
            assert np.all(np.isfinite(part))


@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_commands_never_leave_their_bounds(data):
    """Not by one bit, whatever finite problem is given."""
    robot, mpc = SKID_STEERED, controller(SKID_STEERED)
    low, high = np.array(list(robot.bounds.values())).T
    problem = mpc_instance(robot, np.random.default_rng(data.draw(st.integers(0, 10**6))))
    scale = data.draw(st.sampled_from([0.1, 10.0, 1e4, 1e9]))
    for _ in range(data.draw(st.integers(1, 5))):
        mpc.prepare()
        offset = np.array(data.draw(st.lists(st.floats(-1, 1), min_size=3, max_size=3)))
        u = mpc.feedback(**problem | dict(x=problem["x"] + scale * offset))
        assert np.all((low <= u) & (u <= high))


@pytest.mark.parametrize(
    "robot, command", [(SKID_STEERED, SKID_STEERED.inputs), (BICYCLE, ("steering_rad",))]
)
def test_a_value_that_is_no_number_does_no_lasting_harm(robot, command):
    """The robot must keep driving: the step is flagged, and the last plan goes on."""
    problem = mpc_instance(robot, np.random.default_rng(15))
    (mpc, places), (spared, _) = (commanding(robot, *command) for _ in range(2))
    low, high = np.array([robot.bounds[name] for name in command]).T
    for _ in range(30):
        expected = spared.step(**problem)
    for name, value in itertools.product(problem, [np.nan, np.inf, 1e300]):
        mpc.step(**problem)
        plan = mpc.u_plan
        u = mpc.step(**problem | {name: np.full(np.shape(problem[name]), value)})
        assert np.all((low <= u[places]) & (u[places] <= high))
        if not np.isfinite(value):
            assert not mpc.ok and np.isnan(mpc.kkt)
            rows = slice(None) if name == "u_ref" else places  # others follow their reference
            shifted = np.hstack([plan[:, 1:], plan[:, -1:]])
            np.testing.assert_allclose(mpc.u_plan[rows], shifted[rows], rtol=0, atol=1e-12)
        for _ in range(30):
            after = mpc.step(**problem)
        assert mpc.ok
        np.testing.assert_allclose(after, expected, atol=1e-6)


def test_ok_of_a_solve_tells_how_far_the_optimum_is():
    """From a heading that is wrong by 2 rad, after each of six iterations."""
    guess, z = mhe_instance(BICYCLE, np.random.default_rng(3), 3)
    guess[2] += 2.0
    optimum = mhe_by_ipopt(BICYCLE, guess, z)["x"]
    mhe = estimator(BICYCLE, guess, outliers=False)
    estimates(mhe, z[:-1])
    mhe.prepare()
    solved = []
    for _ in range(6):
        error = np.abs(mhe.solve(z[-1], iterations=1).x - optimum).max()
        solved.append(mhe.ok)
        assert mhe.ok == (error < 0.01) == (mhe.status == "")
    assert solved == [False] * 3 + [True] * 3
