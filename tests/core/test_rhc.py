"""Receding horizon control: eq. (NMPC), one Gauss-Newton iteration a sample, or iterated."""

import dataclasses

import casadi as ca
import numpy as np
import published_problems
import pytest
from condensed_rhc import rhc_by
from oracles import mpc_by_ipopt, mpc_instance
from robots import CRAWLER, DT, ROBOTS

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
SOLVERS = ["structured", "daqp", "qpoases"]


def paper_problem(problem):
    """An instance of CRAWLER by the names of the paper's controller."""
    x, p, x_ref, u_ref = problem.values()
    return dict(pose=x, p=p, xi_ref=x_ref, omega_ref=u_ref[0])


def test_iterated_to_convergence_it_is_the_optimum_that_ipopt_finds():
    """With each solver on 3 random instances, each with weights of its own; at least a third of
    them at the bounds. So it is where weights and bounds change later, by the model's names.
    """
    rng, bounded = np.random.default_rng(0), 0
    instances = 9
    for k in range(instances):
        q, r, omega_max = tuple(rng.uniform(0.2, 3, 3)), rng.uniform(2, 12), rng.uniform(0.1, 0.4)
        bounds = {"omega_radps": (-omega_max, omega_max)}
        weights = dict(q=q, r=r, qn_factor=rng.uniform(0.5, 12))
        robot = dataclasses.replace(CRAWLER, **weights | dict(r=(r,)), bounds=bounds)
        problem = mpc_instance(robot, rng)
        if k % 3:
            rhc = rhc_by(SOLVERS[k % 3], **weights, omega_max=omega_max)
        else:
            rhc = rhec.RHC(qn_factor=weights["qn_factor"])
            rhc.update(q=q, r=(r,), qn=weights["qn_factor"] * np.array(q), bounds=bounds)
        command = rhc.solve(**paper_problem(problem), iterations=25)
        (optimum,) = mpc_by_ipopt(robot, **problem)
        np.testing.assert_allclose(rhc.omega_plan, optimum, rtol=0, atol=1e-7)
        assert command == rhc.omega_plan[0]
        assert rhc.kkt < 1e-9
        bounded += np.abs(rhc.omega_plan).max() == omega_max
    assert 0.35 <= bounded / instances <= 0.95


def test_infinite_bounds_are_no_bounds():
    """Neither in the plan nor in the KKT tolerance, where 0 times infinity would be NaN."""
    robot = ROBOTS["bicycle"]
    problem = dict(x=(0.0, 0.1, 0.1), p=(0.0, 0.0), x_ref=(1.0, 0.0, 0.0), u_ref=(0.5, 0.0))
    answers = []
    for bounds in (None, {"steering_rad": (-np.inf, np.inf)}, {"steering_rad": (-np.inf, 9.0)}):
        options = dict(robot.controller, bounds=bounds)
        rhc = rhec.RHC(model=rhec.Model(**robot.model), dt=DT, horizon=5, **options)
        rhc.prepare()
        answers.append([*rhc.feedback(**problem), rhc.kkt])
        assert rhc.ok and np.isfinite(rhc.kkt)
    np.testing.assert_allclose(answers[1:], answers[:1] * 2, rtol=0, atol=1e-12)


def test_a_step_whose_active_set_was_not_found_has_no_kkt_tolerance():
    """States of a pendulum that no plan expects, so that the search of the active set gives up."""
    pendulum = published_problems.pendulum()
    rhc = rhec.RHC(**pendulum.options | dict(dt=0.05, horizon=20))
    rng = np.random.default_rng(2)
    solved = []
    for x in rng.normal(size=(10, 4)) * (1.0, 3.0, 2.0, 2.0):
        rhc.step(x, (), np.zeros(4), (0.0,))
        assert np.isfinite(rhc.kkt) == rhc.ok
        solved.append(rhc.ok)
    assert 0 < sum(solved) < 10


def headed(**options):
    """An RHC of a unicycle that names its heading."""
    model = rhec.Model(
        states=("x", "y", "yaw"), inputs=("v", "turn"), heading="yaw",
        f=lambda x, u, p: [u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1]],
    )  # fmt: skip
    weights = dict(q=(1.0, 1.0, 0.5), r=(0.1, 0.1), dt=0.2, horizon=8)
    return rhec.RHC(model=model, bounds={"v": (-1, 1), "turn": (-1, 1)} | options, **weights)


@pytest.mark.parametrize("bounds", [{}, {"y": (-9.0, 9.0)}], ids=["commands", "also a state"])
def test_headings_count_up_to_full_turns(virtual_machine, bounds):
    """A robot whose estimate and references jump by full turns gets the commands of one whose
    headings go on: it turns through the half turn at which they wrap, the short way round.
    """
    wrapped, going_on = headed(**bounds), headed(**bounds)
    rng = np.random.default_rng(3)
    x = np.array([0.0, 0.0, 2.6])
    for k in range(15):
        x_ref = np.vstack([0.1 * np.arange(9), np.zeros(9), 2.8 + 0.1 * (k + np.arange(9))])
        turns = 2 * np.pi * rng.integers(-2, 3, 10)
        seen = wrapped.step(x + [0, 0, turns[9]], x_ref=x_ref + np.outer([0, 0, 1], turns[:9]))
        commands = going_on.step(x, x_ref=x_ref)
        np.testing.assert_allclose(seen, commands, rtol=0, atol=1e-9)
        x = x + 0.2 * np.array(
            [commands[0] * np.cos(x[2]), commands[0] * np.sin(x[2]), commands[1]]
        )
    assert x[2] > np.pi


def test_after_a_restart_it_is_as_new(virtual_machine):
    """Also its references, where none are given."""
    used, new = headed(), headed()
    used.step((0, 0, 0), x_ref=(3.0, 1.0, 0.5))
    used.restart()
    np.testing.assert_array_equal(used.step((1, 1, 0.3)), new.step((1, 1, 0.3)))
