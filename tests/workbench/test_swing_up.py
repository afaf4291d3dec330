"""What one iteration a sample costs beside many: nothing where one is enough."""

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec.workbench.studies import swing_up
from rhec.workbench.studies.gallery import ControlProblem


def cart():
    """A double integrator: linear, so that one iteration solves it."""
    model = rhec.Model(
        states=("place", "speed"), inputs=("push",), parameters={}, outputs=("place",),
        f=lambda x, u, p: [x[1], u[0]],
    )  # fmt: skip
    options = dict(model=model, command=("push",), q=(2.0, 1.0), r=(0.5,), dt=0.2, horizon=20)
    return ControlProblem(options | dict(qn_factor=1.0), (1.0, 0.0), (0.2, 0.0), 30)


def test_a_linear_problem_costs_the_same_and_as_much_as_its_loop_says(virtual_machine):
    problem = cart()
    table = swing_up.excesses(problem, range(3))
    np.testing.assert_allclose(table["excess"], 0.0, atol=1e-9)
    assert table["one"].nunique() == 3 and table["away"].max() < 0.05
    # Written apart: the same loop with its controller alone.
    rhc = rhec.RHC(**problem.options)
    x = problem.start + np.random.default_rng(1).uniform(-swing_up.SPREAD, swing_up.SPREAD, 2)
    cost = 0.0
    for _ in range(problem.samples):
        (u,) = rhc.solve(x=x, p=[], x_ref=[0.2, 0.0], u_ref=[0.0])
        cost += 2.0 * (x[0] - 0.2) ** 2 + x[1] ** 2 + 0.5 * u**2
        x = np.array([x[0] + 0.2 * x[1] + 0.02 * u, x[1] + 0.2 * u])
    assert table["solved"][1] == pytest.approx(cost, rel=1e-9)


def test_a_summary_has_the_median_its_interval_and_the_worst():
    table = pd.DataFrame(dict(excess=np.arange(40) / 100, away=[0.0] * 38 + [1.0] * 2))
    found = swing_up.summary(table)
    assert found["median"] == pytest.approx(0.195) and found["worst"] == pytest.approx(0.39)
    # By order statistics: of 40, the 14th and the 27th.
    assert (found["low"], found["high"]) == pytest.approx((0.13, 0.26))
    assert (found["n_up"], found["n"]) == (38, 40)
