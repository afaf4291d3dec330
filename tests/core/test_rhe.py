"""Receding horizon estimation: eq. (10), its arrival cost, one Gauss-Newton iteration a sample, or
iterated.
"""

import numpy as np
import oracles
import pytest
from helpers import choice_of, weaving_yaw_rates, with_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import DT, N, V, drive, flat, iterate, places, rhe_by_ipopt, rhe_instance, unknowns

import rhec
from notebooks.studies.condensed import box_qp_by_library
from rhec import paper
from rhec.core.estimator import rhe as core_rhe
from rhec.core.solver.box_qp import box_qp
from rhec.core.solver.rti import RealTimeIteration
from rhec.tracked_robot import paper_rhe, tuning
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.own_loop import Estimate

pytestmark = pytest.mark.usefixtures("virtual_machine")
SPEED_MODELS = ["parameter", "input"]
ARRIVAL_MEANS = ["smoothed", "filtered"]
GUESS = (0.0, 0.0, 0.0, 0.5, 0.9, 0.8)


def build_phases(*options):
    return paper_rhe.build_phases(choice_of("rhe", N, *options))


def first_memory(guess, sigma, speed_model="parameter"):
    of = (dict(zip(QUANTITIES, values)) for values in (guess, sigma))
    return paper_rhe.init(paper_rhe.window_of(choice_of("rhe", N, speed_model)), *of)


def window_memory(*window):
    """As of `oracles`, before the first position, which is never rejected."""
    of_judge = paper_rhe.JUDGE.memory(paper_rhe.window_of(choice_of("rhe", N)))
    nothing = {name: np.zeros(shape) for name, shape in of_judge.items()}
    return oracles.window_memory(*window) | nothing


def feed(rhe, z, **iterations):
    """The estimates after each row of z, by one iteration each or by as many as asked for."""
    estimates = []
    for reading in z:
        rhe.prepare()
        estimates.append(rhe.solve(reading, **iterations) if iterations else rhe.feedback(reading))
    return estimates


# The nonlinear problem


@pytest.mark.parametrize("speed_model", SPEED_MODELS)
def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds(speed_model):
    """On 30 random full windows each; at least 30 % of them with a traction coefficient at its
    bound.
    """
    rng, keep, bounded = np.random.default_rng(0), places(speed_model), 0
    phases = build_phases(speed_model)
    for _ in range(30):
        z, m, P = rhe_instance(rng, speed_model)
        memory, answer, tolerances = iterate(
            phases, window_memory(z, m, P, speed_model), dict(z_N=z[-1]), dict(V=V), 12
        )
        optimum, newest = rhe_by_ipopt(z, m, P, speed_model)
        np.testing.assert_allclose(unknowns(memory), optimum, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(
            flat(answer["estimate"])[keep], newest[keep], rtol=1e-6, atol=1e-9
        )
        assert tolerances[-1] < 1e-9 < tolerances[0]
        bounded += np.any(flat(answer["estimate"])[4:] == 1)
    assert 9 <= bounded <= 27


def test_without_a_guess_it_begins_at_the_first_reading():
    (estimate,) = feed(rhec.RHE(), [(500.0, -300.0, 0.4, 0.0)])
    assert isinstance(estimate, Estimate)
    assert estimate[:6] == pytest.approx((500, -300, 0, 0.4, 1, 1))


def test_an_impossible_first_reading_is_no_first_guess():
    """The position then comes with the first reading that there is, wherever that may be."""
    for first in ((np.nan,) * 4, (1e12, -1e300, np.inf, 0.0)):
        estimate = feed(rhec.RHE(), [first, (5e5, 4e6, 0.5, 0.0), (5e5, 4e6, 0.5, 0.0)])[-1]
        assert estimate[:4] == pytest.approx((5e5, 4e6, 0, 0.5), rel=1e-6, abs=0.2)


# One iteration a sample


def linear_window(rng, samples, dtheta=1e-6):
    """Straight ahead with yaw and traction known, so that (x, y, ν) is all there is to estimate,
    and linear: readings, arrival cost, V.
    """
    _, z = drive(GUESS, np.zeros(samples - 1))
    z[:, :3] += rng.normal(size=(samples, 3)) * (0.3, 0.3, 0.2)
    m = np.array([0.5, -0.5, 0.0, 0.8, 0.9, 0.8])
    P = np.diag(np.square([1.0, 1.0, dtheta, 0.5, dtheta, dtheta]))
    return z, m, P, np.square([0.3, 0.3, 0.2, dtheta])


def batch(z, m, P, V):
    """Mean and covariance of (x, y, ν) at the last reading by ordinary least squares over all, and
    the -2 log likelihood of the readings.
    """
    free = np.ix_([0, 1, 3], [0, 1, 3])
    rows, values, prior = [], [], m[[0, 1, 3]]
    for i, reading in enumerate(z):
        reach = i * DT * m[4]
        rows += [[1, 0, reach * np.cos(m[2])], [0, 1, reach * np.sin(m[2])], [0, 0, 1]]
        values += [*reading[:3]]
    H, R = np.array(rows), np.diag(np.tile(V[:3], len(z)))
    information = np.linalg.inv(P[free]) + H.T @ np.linalg.inv(R) @ H
    off = values - H @ prior
    first = prior + np.linalg.solve(information, H.T @ np.linalg.solve(R, off))
    ahead = np.array([[1, 0, reach * np.cos(m[2])], [0, 1, reach * np.sin(m[2])], [0, 0, 1]])
    S = H @ P[free] @ H.T + R
    return (
        ahead @ first,
        ahead @ np.linalg.solve(information, ahead.T),
        off @ np.linalg.solve(S, off) + np.linalg.slogdet(S)[1],
    )


def test_a_linear_problem_is_estimated_as_by_least_squares_over_all_there_ever_was():
    """With the filtered arrival cost and without process noise, what leaves the window is not lost;
    deviances sum to -2 log likelihood.
    """
    samples, step = 3 * N, build_phases("parameter", "filtered")["step"]
    z, m, P, V = linear_window(np.random.default_rng(2), samples)
    start = first_memory(m, np.sqrt(np.diag(P)))
    memory, deviance = np.concatenate([flat(piece) for piece in start.values()]), 0.0
    for reading in z:
        result = step(
            memory=memory, z_N=reading, V=V, W=np.zeros(6), P_0=np.ones(6), m_0=np.ones(6)
        )
        memory, deviance = result["memory"], deviance + float(result["deviance"])
    mean, covariance, likelihood = batch(z, m, P, V)
    np.testing.assert_allclose(flat(result["estimate"])[[0, 1, 3]], mean, atol=1e-8)
    np.testing.assert_allclose(
        np.array(result["covariance"])[np.ix_([0, 1, 3], [0, 1, 3])], covariance, atol=1e-8
    )
    assert deviance == pytest.approx(likelihood, abs=1e-6)


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_the_qp_in_the_bounded_parameters_is_solved_as_by_other_solvers(n):
    rng, own, active = np.random.default_rng(5), box_qp(n), 0
    for k in range(100):
        A, g = rng.normal(size=(n, n)), rng.normal(size=n)
        problem = dict(H=A @ A.T + 0.01 * np.eye(n), g=g, lb=-rng.random(n), ub=rng.random(n))
        solution, expected = (
            own(**problem),
            np.clip(-g / problem["H"][0], problem["lb"], problem["ub"]),
        )
        if n > 1:
            other = box_qp_by_library(n, ("daqp", "qpoases")[k % 2])(**problem)
            assert other["solved"] == 1
            expected = flat(other["x"])
        assert solution["solved"] == 1
        np.testing.assert_allclose(flat(solution["x"]), expected, rtol=0, atol=1e-8)
        x = flat(solution["x"])
        active += np.any((x == problem["lb"]) | (x == problem["ub"]))
    assert active > 30


@pytest.mark.parametrize("speed_model", SPEED_MODELS)
def test_a_line_search_finds_what_full_steps_find_of_the_same_quantities(speed_model):
    """Of a window that estimates named quantities, with inputs as measured."""
    rhe = rhec.RHE(guess=GUESS, speed_model=speed_model, sigma_v=paper.SIGMA_V)
    _, z = drive(GUESS, weaving_yaw_rates(2 * N))
    z = with_noise(z, np.random.default_rng(4))
    feed(rhe, z[:-1])
    rhe.prepare()
    memory = {name: array.copy() for name, array in rhe.iteration.current.items()}
    by_full_steps = rhe.solve(z[-1])
    functions = core_rhe.build_solvable(rhe.window)
    searching = RealTimeIteration(functions, tuple(memory), core_rhe.UNKNOWNS, **rhe.settings)
    searching.start(memory)
    searching.arrays["z_N"][:] = z[-1]
    searching.solve(20)
    assert searching.converged
    np.testing.assert_allclose(searching.arrays["estimate"], by_full_steps[:6], atol=1e-9)


# Preparation and feedback


@pytest.mark.parametrize("speed_model", SPEED_MODELS)
def test_preparation_does_not_see_the_newest_reading(speed_model):
    phases, rng = build_phases(speed_model), np.random.default_rng(6)
    z, m, P = rhe_instance(rng, speed_model)
    results = []
    for newest in (np.full(4, np.nan), np.zeros(4), np.full(4, 1e6)):
        memory = oracles.window_memory(z, m, P, speed_model)
        memory["z"][:, -1] = newest
        results.append(
            np.concatenate([flat(part) for part in phases["linearise"](**memory, V=V).values()])
        )
    np.testing.assert_array_equal(results[1:], results[:1] * 2)


# The arrival cost


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("speed_model", SPEED_MODELS)
@pytest.mark.parametrize("arrival_mean", ARRIVAL_MEANS)
@pytest.mark.parametrize("process_noise", ["printed", "prediction"])
def test_the_arrival_cost_never_exceeds_the_inverse_of_W(process_noise, arrival_mean, speed_model):
    """W⁻¹ - H_N positive semi-definite at every sample (paper, Sec. Arrival Cost), the mean from
    where `arrival_mean` says.
    """
    phases, keep = build_phases(speed_model, arrival_mean), places(speed_model)
    sigma = np.array(tuning.NOISES["rhe"][process_noise].sigma_w)[keep]
    _, z = drive(GUESS, weaving_yaw_rates(4 * N))
    z = with_noise(z, np.random.default_rng(7))
    z[25, :2] = z[30, 3] = z[33:36] = np.nan
    memory, weights = (first_memory(GUESS, paper.SIGMA_W_RHE, speed_model), dict(V=V, W=sigma**2))
    for k, newest in enumerate(z):
        before = memory
        memory = phases["shift"](**before, **weights)
        full = k > N
        if full:
            H = np.linalg.inv(np.array(memory["P"]))
            slack = np.linalg.eigvalsh(np.eye(len(sigma)) - sigma[:, None] * H * sigma)
            assert slack.min() > -1e-9
            smoothed = np.array(before["s"])[:, 1]
            assert np.array_equal(flat(memory["m"]), smoothed) == (arrival_mean == "smoothed")
        else:
            np.testing.assert_array_equal(flat(memory["m"]), np.array(GUESS)[keep])
        memory, _, _ = iterate(phases, memory | dict(z=memory["z"]), dict(z_N=newest), dict(V=V), 1)
        window = np.array(memory["z"])
        window[:, -1] = newest
        memory = memory | dict(z=window)
    assert full


# Sensors that are silent, or lie


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("speed_model", SPEED_MODELS)
def test_a_missing_reading_is_a_term_left_out(speed_model):
    rng, phases = np.random.default_rng(9), build_phases(speed_model)
    for _ in range(4):
        z, m, P = rhe_instance(rng, speed_model)
        complete = z.copy()
        z[rng.random(z.shape) < 0.2] = np.nan
        z[:, 3] = complete[:, 3]
        z[rng.integers(1, N // 2), 3] = np.nan  # one that the positions after it tell
        if speed_model == "input":
            z[N:, 2] = complete[N:, 2]
        memory, _, tolerances = iterate(
            phases, window_memory(z, m, P, speed_model), dict(z_N=z[-1]), dict(V=V), 300
        )
        assert tolerances[-1] < 1e-9
        optimum, _ = rhe_by_ipopt(z, m, P, speed_model)
        np.testing.assert_allclose(unknowns(memory), optimum, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("reading", [np.inf, -np.inf, 1e12, -1e300])
@pytest.mark.parametrize("channel", range(4))
def test_a_reading_that_cannot_be_is_a_missing_one(channel, reading):
    _, z = drive(GUESS, weaving_yaw_rates(3 * N))
    z = with_noise(z, np.random.default_rng(10))
    z[7:35:3, channel] = np.nan
    silent = feed(rhec.RHE(guess=GUESS), z)
    z[7:35:3, channel] = reading
    absurd = feed(rhec.RHE(guess=GUESS), z)
    for one, other in zip(silent, absurd):
        np.testing.assert_array_equal(
            np.append(one[:6], one.covariance), np.append(other[:6], other.covariance)
        )


reading = st.floats(-3, 3) | st.floats() | st.sampled_from([np.nan, 0.0, 1e8, -1e8])


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.lists(st.tuples(reading, reading, reading, reading), min_size=1, max_size=40),
    st.sampled_from(SPEED_MODELS),
    st.booleans(),
)
def test_whatever_the_sensors_say_estimates_stay_finite_and_traction_between_0_and_1(
    z, speed_model, guessed
):
    rhe = rhec.RHE(guess=GUESS if guessed else None, speed_model=speed_model)
    for estimate in feed(rhe, z):
        assert np.all(np.isfinite(estimate[:6])) and np.all(np.isfinite(estimate.covariance))
        assert 0 <= estimate.mu <= 1 and 0 <= estimate.kappa <= 1
