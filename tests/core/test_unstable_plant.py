"""Hard bounds of a state of an unstable plant: a cart with a pole, on a short rail."""

import casadi as ca
import numpy as np
import pytest

import rhec

DT = 0.04
N = 40
Q = np.array([1.0, 0.1, 10.0, 0.1])
R = 0.01
RAIL = 0.6
GOAL = (0, 0, 0, 0)


def _f(x, u, p):
    mass, pole, length, g = 1.0, 0.1, 0.5, 9.81
    sine, cosine = ca.sin(x[2]), ca.cos(x[2])
    inertia = mass + pole * sine**2
    a = (u[0] + pole * sine * (length * x[3] ** 2 - g * cosine)) / inertia
    return [x[1], a, x[3], (g * sine - a * cosine) / length]


MODEL = rhec.Model(states=("pos", "vel", "angle", "rate"), inputs=("force",), f=_f)


@pytest.fixture(scope="module")
def hard():
    bounds = {"force": (-12.0, 12.0), "pos": (-RAIL, RAIL)}
    return rhec.RHC(model=MODEL, dt=DT, horizon=N, q=tuple(Q), r=(R,), bounds=bounds)


def start(seed):
    rng = np.random.default_rng(seed)
    pos, vel, side, rate = rng.uniform((-0.3, -0.5, -1, -0.5), (0.3, 0.5, 1, 0.5))
    return np.array([pos, vel, 0.7 * np.sign(side), rate])


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("seed", range(4))
def test_a_loop_stays_within_a_hard_bound(hard, seed):
    """Also while a step is not solved, and the plan before goes on."""
    hard.restart()
    x = start(seed)
    n_ok = 0
    for _ in range(80):
        u = hard.step(x=x, x_ref=GOAL)
        n_ok += hard.ok
        x = MODEL.simulate(x, [u], dt=DT)[-1]
        assert abs(x[0]) < RAIL + 0.01
    assert n_ok > 0.85 * 80


@pytest.mark.nightly(keep=2)
@pytest.mark.parametrize("seed", range(4))
def test_no_iteration_is_worse_by_cost_and_bound_and_dynamics(hard, seed):
    """With any prices of the last two, such an iteration would raise the merit."""
    x = start(seed)
    before = measured(np.tile(x, (N + 1, 1)).T, np.zeros((1, N)))
    for iterations in range(1, 15):
        hard.restart()
        hard.solve(x=x, x_ref=GOAL, iterations=iterations)
        # What a QP with a lower price exceeds does not tell that the rail cannot be kept.
        assert "cannot be kept" not in hard.status
        after = measured(hard.x_plan, hard.u_plan)
        is_same = np.allclose(after, before, rtol=1e-6, atol=1e-9)
        assert is_same or np.any(after < before), (iterations, before, after)
        before = after


def measured(x, u):
    """The cost of a plan, what it exceeds the rail by, and what its intervals miss the nodes by.

    What is missed of a state counts by the root of its weight, so that units do not count.
    """
    cost = (Q @ x[:, 1:] ** 2).sum() / 2 + R * (u**2).sum() / 2
    excess = np.maximum(np.abs(x[0, 1:]) - RAIL, 0).sum()
    ends = [MODEL.simulate(x[:, k], [u[:, k]], dt=DT)[-1] for k in range(N)]
    missed = np.abs(np.array(ends).T - x[:, 1:]).sum(axis=1)
    return np.array([cost, excess, np.sqrt(Q) @ missed])
