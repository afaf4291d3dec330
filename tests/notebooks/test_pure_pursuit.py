"""Pure pursuit, against the arc that it should drive on."""

import dataclasses

import numpy as np
import pytest
from oracles import flat, move

import rhec
from notebooks.further.rivals import pure_pursuit
from rhec import paper

pytestmark = pytest.mark.usefixtures("virtual_machine")
N = 6


@pytest.mark.parametrize("nu", [0.5, -0.5])
@pytest.mark.parametrize("goal", [(1.0, 0.2), (0.8, -0.5), (1.5, 0.0)])
def test_pure_pursuit_drives_an_arc_through_its_goal(goal, nu):
    """Forwards, and in reverse to a goal behind the robot."""
    goal = np.array(goal) * np.sign(nu)
    x_ref = np.zeros((3, N + 1))
    x_ref[:2, 0] = goal
    p = np.array([nu, 0.9, 0.8])
    step = pure_pursuit.build_step(N)
    omega = float(step(s_0=[0, 0, 0, *p], x_ref=x_ref, lower=-10.0, upper=10.0)["command"])
    pose = np.zeros(3)
    nearest = np.inf
    for _ in range(2000):
        pose = flat(move(pose, *p, omega, dt=0.005))
        nearest = min(nearest, np.hypot(*(pose[:2] - goal)))
    assert nearest < 2e-3


@pytest.mark.parametrize("backwards", [False, True])
def test_a_robot_that_knows_the_truth_follows_its_path(backwards):
    """Forwards and in reverse, to a tenth of the tolerance on even soil."""
    quiet = dict(mu_deviation=0.0, kappa_deviation=0.0, bump_sigma_radps=0.0, gnss_sigma_m=0.0)
    scenario = rhec.Scenario(
        estimator="oracle", duration_s=120.0, look_ahead_m=0.8, backwards=backwards, **quiet
    )
    controller = pure_pursuit.controller(scenario)
    run = rhec.simulate(dataclasses.replace(scenario, controller=controller))
    assert run.metrics["solver_ok"]
    assert run.metrics["mean_error_true_m"] < 0.1 * paper.TOLERANCE_M


def test_it_needs_a_goal_ahead():
    with pytest.raises(ValueError, match="look_ahead_m was 0.0; for pure pursuit"):
        pure_pursuit.controller(rhec.Scenario())
