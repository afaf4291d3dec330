"""The controller that chooses its speed, against its problem written once more, and in drives."""

import dataclasses

import numpy as np
import pytest
from oracles import flat
from scipy.optimize import lsq_linear

import rhec
from rhec import paper
from rhec.core._casadi.packing import pack_array
from rhec.tracked_robot import speed_rhc
from rhec.tracked_robot.terrain import Terrain

N, DT = 6, paper.DT_S
HORIZON = speed_rhc.horizon_of(N)
CURVATURE = 0.12  # of the path [1/m]
PATH = rhec.Path.from_segments([(200.0, CURVATURE)])
Q, R, R_SPEED = (1.0, 1.0, 0.3), 0.05, 0.2
SET_MPS, OMEGA = 0.5, paper.OMEGA_MAX_RADPS
LEAST_CHANGE = np.exp(-DT / speed_rhc.SPEED_LAG_S)


def moved(x, u, mu, kappa):
    """(e, ψ, v) after a sample, by many small Euler steps."""
    e, psi, v = x
    steps = 200
    for _ in range(steps):
        along = mu * v * np.cos(psi) / (1 - CURVATURE * e)
        change = (mu * v * np.sin(psi), kappa * u[0] - CURVATURE * along,
                  (u[1] - v) / speed_rhc.SPEED_LAG_S)  # fmt: skip
        e, psi, v = np.array([e, psi, v]) + DT / steps * np.array(change)
    return np.array([e, psi, v])


def plan():
    """The memory of a controller that planned to stay on the path, without turning."""
    s = np.tile([[0.0], [0.0], [SET_MPS], [1.0], [1.0]], N + 1)
    u = np.tile([[0.0], [SET_MPS], [CURVATURE]], N)
    return pack_array(dict(s=s, u=u))


def command(e, psi, mu, kappa):
    """(ω, v) of the controller on an arc, after that plan."""
    step = speed_rhc.build_step(HORIZON, len(PATH.segments))
    s = 10.0
    ((x, y, theta),), _ = PATH.poses([s])
    pose = [x - e * np.sin(theta), y + e * np.cos(theta), theta + psi]
    result = step(
        memory=plan(), estimate=[*pose, SET_MPS, mu, kappa],
        s=s, segments=PATH.segments.T, period_m=PATH.period_m, backwards=0.0, speed_mps=SET_MPS,
        Q=Q, QN=10 * np.array(Q), R=R, r_speed=R_SPEED, lower=-OMEGA, upper=OMEGA,
    )  # fmt: skip
    assert float(result["ok"]) == 1
    return float(result["command"]), float(result["speed_mps"])


def command_by_least_squares(e, psi, mu, kappa):
    """The same QP by finite differences of the motion about that plan.

    The traction moves the linearised prediction, too, as data of the feedback.
    """
    bar = np.array([0.0, 0.0, SET_MPS])
    h = 1e-6
    u = np.array([0.0, SET_MPS])
    # The last interval is new, and integrated.
    nodes = [bar] * N + [moved(bar, u, 1, 1)]
    u_ref = np.array([np.clip(CURVATURE * mu * SET_MPS / kappa, -OMEGA, OMEGA), SET_MPS])
    offset, slopes = np.array([e, psi, SET_MPS]) - nodes[0], np.zeros((3, 2 * N))
    rows, values = [], []
    for i in range(N):
        x = nodes[i]
        A = np.array(
            [moved(x + h * d, u, 1, 1) - moved(x - h * d, u, 1, 1) for d in np.eye(3)]
        ).T / (2 * h)
        B = np.array(
            [moved(x, u + h * d, 1, 1) - moved(x, u - h * d, 1, 1) for d in np.eye(2)]
        ).T / (2 * h)
        P = np.array(
            [moved(x, u, *(1 + h * d)) - moved(x, u, *(1 - h * d)) for d in np.eye(2)]
        ).T / (2 * h)  # fmt: skip
        # The inputs of the QP are whole ones, not changes.
        offset = (
            moved(x, u, 1, 1) - nodes[i + 1] + A @ offset + P @ (np.array([mu, kappa]) - 1) - B @ u
        )
        slopes = A @ slopes
        slopes[:, 2 * i : 2 * i + 2] += B
        at = offset + nodes[i + 1]
        weight = np.sqrt((10 if i == N - 1 else 1) * np.array([Q[1], Q[2], 0]))
        rows.append(weight[:, None] * slopes)
        values.append(-weight * at)
    root = np.sqrt(np.tile([R, R_SPEED], N))
    rows.append(np.diag(root))
    values.append(root * np.tile(u_ref, N))
    bounds = np.tile([-OMEGA, speed_rhc.SLOWEST_MPS], N), np.tile([OMEGA, SET_MPS], N)
    u = lsq_linear(np.concatenate(rows), np.concatenate(values), bounds, method="bvls").x
    return u[0], u[1] + (SET_MPS - u[1]) * LEAST_CHANGE


@pytest.mark.parametrize(
    ("e", "psi", "mu", "kappa"),
    [(0.0, 0.0, 0.9, 0.9), (-0.1, -0.05, 0.95, 0.4), (0.05, -0.1, 0.8, 0.3), (0.3, 0.1, 0.7, 0.8)],
)
def test_the_command_is_the_solution_of_its_qp(e, psi, mu, kappa):
    omega, speed = command(e, psi, mu, kappa)
    expected = command_by_least_squares(e, psi, mu, kappa)
    assert omega == pytest.approx(expected[0], abs=2e-4)
    # The speed of the plan is that of a Runge-Kutta step.
    assert speed == pytest.approx(expected[1], abs=5e-4)


SILENT = dict.fromkeys(
    ("gnss_sigma_m", "encoder_sigma_mps", "speed_sigma_mps", "bump_sigma_radps", "slip_difference"),
    0.0,
)
FIRM = rhec.Scenario(
    **SILENT, estimator="oracle", controller="speed_rhc", q=Q, r=0.005, r_speed=0.04,
    start_offset_m=0.0, terrain=Terrain.uniform(0.95, 0.9), duration_s=140.0,
)  # fmt: skip


def test_where_the_soil_gives_enough_it_drives_at_the_set_speed():
    columns = rhec.simulate(FIRM).columns
    assert columns["nu_mps"][50:].min() > 0.49
    assert columns["error_true_m"].max() < 0.02


@pytest.mark.parametrize("kappa", [0.3, 0.45])
def test_where_the_soil_gives_too_little_it_slows_down_to_what_it_gives(kappa):
    """In the curve μ ν c ≤ κ ω_max at most; beside it, a drive at a constant speed."""
    soft = dataclasses.replace(FIRM, terrain=Terrain.uniform(0.9, kappa))
    columns = rhec.simulate(soft).columns
    curve = (columns["s_m"] > 36) & (columns["s_m"] < 50)
    possible_mps = kappa * OMEGA * paper.HEADLAND_RADIUS_M / 0.9
    assert curve.sum() > 50
    assert columns["nu_mps"][curve].mean() == pytest.approx(possible_mps, rel=0.05)
    assert columns["error_true_m"].max() < paper.TOLERANCE_M
    before = (columns["s_m"] > 5) & (columns["s_m"] < 25)
    assert columns["nu_mps"][before].mean() > 0.49
    constant = rhec.simulate(dataclasses.replace(soft, controller="rhc"))
    assert constant.columns["error_true_m"].max() > 3 * paper.TOLERANCE_M


def test_the_speed_keeps_its_bounds_and_changes_no_faster_than_it_may():
    drive = rhec.Scenario(
        **rhec.WORLDS["former"], estimator="yaw_drift_ekf", controller="speed_rhc", r=0.01,
        r_speed=0.001, duration_s=120.0, seed=1,
    )  # fmt: skip
    speeds = np.array(rhec.simulate(drive).columns["nu_mps"])
    slowest = speed_rhc.SLOWEST_MPS
    # The tracks follow the command with a lag of their own and overshoot a little.
    assert speeds.min() < 0.3
    assert speeds.min() > slowest - 0.05
    assert speeds.max() < SET_MPS + 0.05


def test_backwards_it_drives_as_forwards():
    soft = dataclasses.replace(FIRM, terrain=Terrain.uniform(0.9, 0.4), duration_s=100.0)
    forwards = rhec.simulate(soft).columns
    backwards = rhec.simulate(dataclasses.replace(soft, backwards=True)).columns
    np.testing.assert_allclose(backwards["s_m"], forwards["s_m"], atol=1e-6)
    np.testing.assert_allclose(backwards["nu_mps"], -forwards["nu_mps"], atol=1e-6)


def test_it_comes_to_its_row_from_aside():
    run = rhec.simulate(dataclasses.replace(FIRM, start_offset_m=1.0, duration_s=60.0))
    assert run.metrics["settling_time_s"] < 30
    assert run.metrics["max_error_true_m"] < 0.05


def test_an_absurd_estimate_leaves_the_speed_within_its_bounds():
    step = speed_rhc.build_step(HORIZON, len(PATH.segments))
    fixed = dict(
        s=10.0, segments=PATH.segments.T, period_m=PATH.period_m, backwards=0.0,
        speed_mps=SET_MPS, Q=Q, QN=Q, R=R, r_speed=R_SPEED, lower=-OMEGA, upper=OMEGA,
    )  # fmt: skip
    ((x, y, theta),), _ = PATH.poses([10.0])
    for absurd in (np.nan, np.inf, 1e300):
        memory = pack_array(speed_rhc.init(HORIZON, SET_MPS))
        for estimate in ([absurd] * 6, *([[x, y, theta, 0.5, 0.9, 0.8]] * 2)):
            result = step(memory=memory, estimate=estimate, **fixed)
            memory = result["memory"]
            assert speed_rhc.SLOWEST_MPS - 1e-12 <= float(result["speed_mps"]) <= SET_MPS + 1e-12
            assert abs(float(result["command"])) <= OMEGA
        assert np.isfinite(flat(memory)).all()
        assert float(result["ok"]) == 1


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (dict(cautious=True), "^cautious was True; for the controller 'speed_rhc'"),
        (dict(qp="daqp"), "^qp was 'daqp'; for the controller 'speed_rhc'"),
        (dict(traction_timing="prepared_anew"), "^traction_timing was 'prepared_anew'; for the"),
    ],
)
def test_what_it_does_not_have_is_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        rhec.Scenario(controller="speed_rhc", **fields)
