"""Linear time-varying MPC and pure pursuit, against their problems written once more."""

import numpy as np
import pytest
from oracles import DT, flat, move
from scipy.optimize import lsq_linear

import rhec
from rhec import paper
from rhec.core._casadi.packing import pack_array
from rhec.core.controller import rhc
from rhec.tracked_robot import rival_controllers, yaw_disturbance
from rhec.tracked_robot.rhc import horizon_of

pytestmark = pytest.mark.usefixtures("virtual_machine")
N = 6
HORIZON = horizon_of(N)
P = np.array([0.5, 0.9, 0.8])  # ν, μ, κ
Q = np.array([1.0, 1.0, 0.3])
WEIGHTS = dict(Q=Q, QN=10 * Q, R=0.05)
CURVATURE = 0.1  # of the path [1/m]


def on_arc(s, c=CURVATURE):
    """Poses (3, n) on an arc through the origin."""
    return np.array([np.sin(c * s) / c, (1 - np.cos(c * s)) / c, c * s])


def command(build, pose, x_ref, bound=paper.OMEGA_MAX_RADPS, **others):
    memory = pack_array(rhc.init(HORIZON, pose, P))
    signals = dict(s_0=[*pose, *P], x_ref=x_ref, u_ref=np.zeros((1, N)), **WEIGHTS)
    step = build(HORIZON)
    signals |= dict(lower=-bound, upper=bound) | others
    result = step(memory=memory, **{k: v for k, v in signals.items() if k in step.name_in()})
    assert float(result["ok"]) == 1
    return float(result["command"])


def ltv_command(pose, x_ref, bound):
    """The QP about the path by finite differences of the robot's motion, and by least squares."""
    u_bar = np.clip(np.diff(x_ref[2]) / (P[2] * DT), -bound, bound)

    def after(x, u):
        return flat(move(x, *P, u))

    offset, slopes = np.array(pose) - x_ref[:, 0], np.zeros((3, N))
    rows, values = [], []
    h = 1e-6
    for i in range(N):
        x, u = x_ref[:, i], u_bar[i]
        A = np.array([after(x + h * e, u) - after(x - h * e, u) for e in np.eye(3)]).T / (2 * h)
        B = (after(x, u + h) - after(x, u - h)) / (2 * h)
        # The node's error to the path is offset + slopes (u - ū).
        offset = A @ offset + after(x, u) - x_ref[:, i + 1]
        slopes = A @ slopes
        slopes[:, i] += B
        weight = np.sqrt((10 if i == N - 1 else 1) * Q)
        rows.append(weight[:, None] * slopes)
        values.append(-weight * offset)
    # The reference of the yaw rate is 0.
    rows.append(np.sqrt(WEIGHTS["R"]) * np.eye(N))
    values.append(-np.sqrt(WEIGHTS["R"]) * u_bar)
    bounds = -bound - u_bar - 1e-12, bound - u_bar + 1e-12
    change = lsq_linear(np.vstack(rows), np.concatenate(values), bounds, tol=1e-14).x
    return (u_bar + change)[0]


@pytest.mark.parametrize("bound", [1.0, 0.1])
@pytest.mark.parametrize("pose", [(0, 0, 0), (0.02, 0.1, -0.05), (0, -0.2, 0.1)])
def test_ltv_mpc_is_the_qp_about_the_path(pose, bound):
    x_ref = on_arc(P[0] * P[1] * DT * np.arange(N + 1))
    found = command(rival_controllers.build_ltv_mpc, pose, x_ref, bound)
    assert found == pytest.approx(ltv_command(pose, x_ref, bound), abs=1e-5)


def test_ltv_mpc_follows_a_straight_as_the_rhc_does():
    """On the path itself both are linearised about the same plan."""
    x_ref = np.array([P[0] * P[1] * DT * np.arange(N + 1), np.zeros(N + 1), np.zeros(N + 1)])
    for build in (rival_controllers.build_ltv_mpc, lambda h: rhc.build_phases(h)["step"]):
        assert command(build, (0, 0, 0), x_ref) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("nu", [0.5, -0.5])
@pytest.mark.parametrize("goal", [(1.0, 0.2), (0.8, -0.5), (1.5, 0.0)])
def test_pure_pursuit_drives_an_arc_through_its_goal(goal, nu):
    """Forwards, and in reverse to a goal behind the robot."""
    goal = np.array(goal) * np.sign(nu)
    x_ref = np.zeros((3, N + 1))
    x_ref[:2, 0] = goal
    p = np.array([nu, *P[1:]])
    omega = command(rival_controllers.build_pure_pursuit, (0, 0, 0), x_ref, 10.0, s_0=[0, 0, 0, *p])
    pose = np.zeros(3)
    nearest = np.inf
    for _ in range(2000):
        pose = flat(move(pose, *p, omega, dt=0.005))
        nearest = min(nearest, np.hypot(*(pose[:2] - goal)))
    assert nearest < 2e-3


def test_a_known_disturbance_moves_the_command_and_its_bounds():
    """The compensated RHC commands what an RHC that plans with it would, less the disturbance."""
    plain = rhc.build_phases(HORIZON)["step"]
    compensated = yaw_disturbance.compensated(plain)
    x_ref = on_arc(P[0] * P[1] * DT * np.arange(N + 1))
    for d in (0.0, 0.02, -0.04):
        found = command(lambda _: compensated, (0, 0.05, 0), x_ref, 0.1, disturbance=d)
        moved = dict(lower=-0.1 + d, upper=0.1 + d)
        expected = command(lambda _: plain, (0, 0.05, 0), x_ref, **moved)
        assert found == pytest.approx(expected - d, abs=1e-12)
        assert abs(found) <= 0.1 + 1e-12


@pytest.mark.parametrize(
    "fields", [dict(controller="ltv_mpc"), dict(controller="pure_pursuit", look_ahead_m=0.8)]
)
@pytest.mark.parametrize("backwards", [False, True])
def test_a_robot_that_knows_the_truth_follows_its_path(fields, backwards):
    """By each controller, forwards and in reverse, to a tenth of the tolerance on even soil."""
    quiet = dict(mu_deviation=0.0, kappa_deviation=0.0, bump_sigma_radps=0.0, gnss_sigma_m=0.0)
    scenario = rhec.Scenario(
        estimator="oracle", duration_s=120.0, r=0.1, backwards=backwards, **quiet, **fields
    )
    run = rhec.simulate(scenario)
    assert run.metrics["all_ok"]
    assert run.metrics["mean_error_true_m"] < 0.1 * paper.TOLERANCE_M


def test_pure_pursuit_needs_a_goal_ahead():
    with pytest.raises(ValueError, match="look_ahead_m was 0.0; for the controller 'pure_pursuit'"):
        rhec.Scenario(controller="pure_pursuit")
