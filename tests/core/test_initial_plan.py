"""A controller starts from a plan that it is given, and ends at the solution beside it."""

import numpy as np
import published_problems
import pytest

import rhec
from notebooks.studies.ipopt import PlanProblem

PENDULUM = published_problems.pendulum()
N = 20
OPTIONS = PENDULUM.options | dict(dt=0.05, horizon=N)
GOAL = np.zeros(4)
HANGING = np.array(PENDULUM.start)
CONSTRAINED = OPTIONS["bounds"] | {"p_m": (-1.5, 1.5)}


def controller(**changes):
    return rhec.RHC(**OPTIONS | changes)


def some_inputs(rng):
    """Forces (1, N) that push the cart to and fro."""
    time = np.arange(N) / N
    waves = [rng.normal() * np.sin((k + 1) * np.pi * time) for k in range(3)]
    return 30 * np.sum(waves, axis=0).reshape(1, N)


def test_a_soft_bound_that_is_not_reached_costs_nothing():
    """By IPOPT, which the RHC is compared with."""
    near = np.array([0.1, 0.05, 0.0, 0.0])
    free = PlanProblem(OPTIONS).solve(near, GOAL)
    soft = OPTIONS["bounds"] | {"p_m": rhec.Bound(-9.0, 9.0, linear=1.0)}
    bounded = PlanProblem(OPTIONS | dict(bounds=soft)).solve(near, GOAL)
    assert free.solved and bounded.solved and not bounded.active
    assert bounded.cost == pytest.approx(free.cost, rel=1e-6)


@pytest.mark.parametrize("bounds", [OPTIONS["bounds"], CONSTRAINED])
def test_the_plan_of_a_robot_that_stays_is_the_usual_start(bounds, virtual_machine):
    usual, planned = (controller(bounds=bounds, horizon=12) for _ in range(2))
    planned.solve(HANGING + 0.5, (), GOAL, (0.0,), iterations=5)
    planned.restart(u_plan=(0.0,), x_plan=HANGING)
    for each in (usual, planned):
        for _ in range(3):
            each.prepare()
            each.feedback(HANGING, (), GOAL, (0.0,))
    np.testing.assert_array_equal(planned.u_plan, usual.u_plan)
    np.testing.assert_array_equal(planned.x_plan, usual.x_plan)


@pytest.mark.parametrize("bounds", [OPTIONS["bounds"], CONSTRAINED])
def test_a_solution_as_the_plan_is_the_first_command(bounds, virtual_machine):
    solved, first = (controller(bounds=bounds, horizon=12) for _ in range(2))
    solved.solve(HANGING, (), GOAL, (0.0,), iterations=300)
    assert solved.converged
    first.restart(u_plan=solved.u_plan, x_plan=solved.x_plan)
    first.prepare()
    first.feedback(HANGING, (), GOAL, (0.0,))
    np.testing.assert_allclose(first.u_plan, solved.u_plan, atol=1e-5)


def test_without_states_the_plan_is_simulated_within_the_bounds_of_commands(virtual_machine):
    mpc = controller()
    u_plan = 5 * some_inputs(np.random.default_rng(1))
    mpc.restart(u_plan=u_plan)
    mpc.solve(HANGING, (), GOAL, (0.0,), iterations=0)
    kept = np.clip(u_plan, *OPTIONS["bounds"]["force_N"])
    assert (kept != u_plan).any()
    nodes = OPTIONS["model"].simulate(HANGING, kept.T, dt=OPTIONS["dt"])
    current = mpc.iteration.current["s"].reshape(N + 1, 4)
    np.testing.assert_allclose(current, nodes, rtol=1e-12, atol=1e-12)


def test_inputs_that_diverge_are_refused(virtual_machine):
    mpc = controller(bounds=None)
    mpc.restart(u_plan=(1e11,))
    with pytest.raises(ValueError, match=r"u_plan led at node \d+ to states .*; with x_plan, or"):
        mpc.solve(HANGING, (), GOAL, (0.0,))
