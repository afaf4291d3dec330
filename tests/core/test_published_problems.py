"""Problems that others published are solved as IPOPT solves them."""

import numpy as np
import published_problems as published
import pytest

CONTROL = (published.pendulum, published.lotka_volterra, published.cstr)
ESTIMATION = (published.range_bearing, published.mass_on_a_spring)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("define", CONTROL)
def test_plans_cost_what_those_of_ipopt_cost(define):
    """The hard bounds are kept in closed loop, in which one or more are active."""
    problem = define()
    drive = published.drive(problem)
    assert drive.cost == pytest.approx(drive.ipopt, rel=1e-5)
    if define is published.pendulum:
        weighted = np.array(problem.options["q"]) > 1e-2 * max(problem.options["q"])
        goal = np.array(problem.goal)[weighted]
        np.testing.assert_allclose(drive.x[-1][weighted], goal, atol=0.01)
    for name, bound in problem.options["bounds"].items():
        names = problem.options["model"].states
        if name in names and isinstance(bound, tuple):
            states = drive.x[1:, names.index(name)]
            assert np.all((states >= bound[0] - 1e-9) & (states <= bound[1] + 1e-9))


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("discrete, cost", [(True, 103.36), (False, 101.81)])
def test_the_obstacle_costs_what_ipopt_s_closed_loop_costs(discrete, cost):
    """Within a hundredth; the numbers are those of IPOPT at each sample, without the start."""
    problem = published.obstacle(discrete)
    drive = published.drive(problem)
    off = drive.x[1:] - problem.goal
    q, r = problem.options["q"], problem.options["r"]
    assert (off**2 @ q).sum() + (drive.u**2 @ r).sum() == pytest.approx(cost, rel=0.01)
    assert np.hypot(*(drive.x[:, :2] - 0.5).T).min() > 0.3 - 1e-9


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("define", ESTIMATION)
def test_windows_are_solved_as_by_ipopt(define):
    np.testing.assert_allclose(*published.estimate(define(), seed=3), rtol=1e-6, atol=1e-8)
