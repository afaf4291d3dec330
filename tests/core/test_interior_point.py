"""The interior point: solutions of random QPs are those of qpOASES, which sees dense matrices."""

import functools

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import block_diag

from rhec.core.solver.interior_point import MAX_ITERATIONS, NO_PRICE, Shape, interior_point

# (intervals, states, inputs, rows, of these soft)
SIZES = [(6, 3, 2, 3, 1), (8, 4, 1, 4, 0), (6, 2, 2, 3, 3)]


@functools.cache
def solver(N, n, m, rows, soft):
    D, B, G = (ca.Sparsity.dense(*shape) for shape in ((n, n), (n, m), (rows, n + m)))
    return interior_point(Shape(N, ca.DM(n, n), D, B, G, soft))


def random_qp(rng, N, n, m, rows, soft):
    """A strictly convex QP in which a fifth of the lower bounds is missing: lists by node."""
    A = np.eye(n) + 0.2 * rng.normal(size=(n, n))
    B = rng.normal(size=(n, m))
    qp = dict(D=[A] * (N + 1), B=[B] * (N + 1), H=[], g=[], G=[], lower=[], upper=[])
    for k in range(N + 1):
        root = rng.normal(size=(n + m, n + m))
        H, g = 0.3 * root @ root.T + 0.1 * np.eye(n + m), 3 * rng.normal(size=(n + m, 1))
        G, low = rng.normal(size=(rows, n + m)), -rng.uniform(0.1, 2, (rows, 1))
        if k == N:
            H[n:], H[:, n:], H[n:, n:], g[n:], G[:, n:] = 0, 0, np.eye(m), 0, 0
        low[rng.random(low.shape) < 0.2] = -1e20
        high = rng.uniform(0.1, 2, (rows, 1))
        for name, value in dict(H=H, g=g, G=G, lower=low, upper=high).items():
            qp[name].append(value)
    prices = {name: 10 ** rng.uniform(-2, 2, soft) for name in ("linear", "quadratic")}
    return qp, prices


def by_qpoases(qp, prices):
    """The solution z (n + m, N+1) of the dense QP, in which each soft side has its own excess t."""
    nodes, (rows, n_z), n = len(qp["H"]), qp["G"][0].shape, len(qp["D"][0])
    soft = len(prices["linear"])
    n_t = nodes * soft
    dynamics = np.eye(nodes * n, nodes * n_z) * 0
    for k in range(nodes):
        dynamics[k * n : (k + 1) * n, k * n_z : k * n_z + n] = -np.eye(n)
        if k:
            before = np.hstack([qp["D"][k - 1], qp["B"][k - 1]])
            dynamics[k * n : (k + 1) * n, (k - 1) * n_z : k * n_z] = before
    G = block_diag(*qp["G"])
    places = [k * rows + i for k in range(nodes) for i in range(rows - soft, rows)]
    excess = np.eye(nodes * rows)[:, places]
    none = np.zeros((nodes * n, 2 * n_t))
    A = np.vstack(
        [
            np.hstack([dynamics, none]),
            np.hstack([G, -excess, 0 * excess]),
            np.hstack([G, 0 * excess, excess]),
        ]
    )
    low, high = np.vstack(qp["lower"])[:, 0], np.vstack(qp["upper"])[:, 0]
    linear, quadratic = (np.tile(prices[name], 2 * nodes) for name in ("linear", "quadratic"))
    inf = np.full(len(low), 1e20)
    given = dict(
        h=block_diag(*qp["H"], np.diag(quadratic)),
        g=np.concatenate([np.vstack(qp["g"])[:, 0], linear]),
        a=A,
        lba=np.concatenate([np.zeros(nodes * n), -inf, low]),
        uba=np.concatenate([np.zeros(nodes * n), high, inf]),
        lbx=np.concatenate([np.full(nodes * n_z, -np.inf), np.zeros(2 * n_t)]),
    )
    shapes = {name: ca.Sparsity.dense(*given[name].shape) for name in "ha"}
    options = dict(printLevel="none", error_on_fail=False, nWSR=5000)
    solve = ca.conic("qp", "qpoases", shapes, options)
    x = np.array(solve(**given)["x"])[:, 0]
    return solve.stats()["success"], x[: nodes * n_z].reshape(nodes, n_z).T


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_solutions_of_random_qps_are_those_of_qpoases(size):
    """On 10 QPs, if they can be solved at all. In every other one a state has no weight."""
    rng, solve, iterations = np.random.default_rng(0), solver(*size), []
    for trial in range(10):
        qp, prices = random_qp(rng, *size)
        for H in qp["H"] * (trial % 2):
            H[0], H[:, 0] = 0, 0
        feasible, expected = by_qpoases(qp, prices)
        solution = solve(**{name: np.hstack(parts) for name, parts in qp.items()}, **prices)
        assert solution["solved"] == feasible
        if feasible:
            z = np.array(solution["z"])
            np.testing.assert_allclose(z, expected, rtol=0, atol=1e-6 * max(1, np.abs(z).max()))
            iterations.append(float(solution["iterations"]))
    assert len(iterations) >= 8 and max(iterations) <= 20 < MAX_ITERATIONS


def qp_without_prices(rng, N, n, m, rows, far=2):
    """A random QP whose inputs have hard bounds, and whose rows have no price, for both solvers.

    Half of them are moved, so that z = 0 exceeds their bounds. For qpOASES all rows are hard.
    """
    qp, _ = random_qp(rng, N, n, m, rows, 0)
    moved = (rng.random() < 0.5) * far * rng.normal(size=(N + 1, rows, 1))
    unit = np.eye(n + m)[n:]
    given = dict(qp, G=[np.vstack([unit * (k < N), qp["G"][k]]) for k in range(N + 1)])
    for name, limit in (("lower", -0.8), ("upper", 0.8)):
        rows_of = [np.where(np.abs(b) < 1e19, b + by, b) for b, by in zip(qp[name], moved)]
        given[name] = [np.vstack([np.full((m, 1), limit), b]) for b in rows_of]
    return given, dict(linear=np.full(rows, NO_PRICE), quadratic=np.zeros(rows))


def excess_of(given, z):
    """How far each row is exceeded at each node by z (n + m, N+1): (rows, N+1)."""
    values = np.hstack([G @ each for G, each in zip(given["G"], z.T[..., None])])
    over = np.maximum(values - np.hstack(given["upper"]), np.hstack(given["lower"]) - values)
    return np.maximum(over, 0)


NO_SOFT_ROWS = dict(linear=np.zeros(0), quadratic=np.zeros(0))


def test_rows_without_a_price_are_hard_ones_wherever_they_can_be_kept():
    """Then z is that of qpOASES with hard rows; elsewhere it is solved, and tells the excess."""
    rng, (N, n, m, rows, _) = np.random.default_rng(6), SIZES[0]
    solve = solver(N, n, m, m + rows, rows)
    kept = []
    for _ in range(20):
        given, prices = qp_without_prices(rng, N, n, m, rows)
        feasible, expected = by_qpoases(given, NO_SOFT_ROWS)
        found = solve(**{name: np.hstack(parts) for name, parts in given.items()}, **prices)
        assert found["solved"] == 1
        excess = np.array(found["excess"])[:, 0]
        assert np.all(excess == 0) == feasible
        kept.append(feasible)
        if feasible:
            np.testing.assert_allclose(found["z"], expected, rtol=0, atol=2e-6)
        over = excess_of(given, np.array(found["z"])).max(axis=1)
        np.testing.assert_allclose(excess, over[m:], rtol=0, atol=1e-5)
        assert np.all(over[:m] <= 1e-7)
    assert 5 <= sum(kept) <= 15


def test_what_cannot_be_kept_is_exceeded_as_little_as_possible():
    """The sum of a row's excess is the least there is, as qpOASES finds with that cost alone."""
    rng, (N, n, m, _, _) = np.random.default_rng(6), SIZES[0]
    solve = solver(N, n, m, m + 1, 1)
    checked = 0
    for _ in range(20):
        given, prices = qp_without_prices(rng, N, n, m, 1, far=30)
        if by_qpoases(given, NO_SOFT_ROWS)[0]:
            continue
        alone = dict(H=[1e-9 * np.eye(n + m)] * (N + 1), g=[0 * g for g in given["g"]])
        _, best = by_qpoases(given | alone, dict(linear=np.ones(1), quadratic=np.zeros(1)))
        found = solve(**{name: np.hstack(parts) for name, parts in given.items()}, **prices)
        least = excess_of(given, best)[m:].sum()
        assert excess_of(given, np.array(found["z"]))[m:].sum() <= 1.001 * least + 1e-6
        checked += 1
    assert checked >= 3


@pytest.mark.parametrize(("other", "unit"), [(-1.0, 1e-8), (-1.0, 1e8), (-1e20, 1.0)])
def test_a_row_that_is_at_rest_at_its_bound(other, unit):
    """At z = 0, at all nodes; with and without a bound on the row's other side.

    That side is the row's scale, so it takes no more iterations in another unit.
    """
    rng, size = np.random.default_rng(5), SIZES[0]
    for _ in range(5):
        qp, prices = random_qp(rng, *size)
        for low, high in zip(qp["lower"], qp["upper"]):
            low[0], high[0] = other, 0.0
        feasible, z = by_qpoases(qp, prices)
        for low, G in zip(qp["lower"], qp["G"]):
            low[0] = max(other * unit, -1e20)
            G[0] *= unit
        found = solver(*size)(**{name: np.hstack(parts) for name, parts in qp.items()}, **prices)
        assert feasible and found["solved"] == 1 and found["iterations"] <= 15
        np.testing.assert_allclose(found["z"], z, rtol=0, atol=2e-6)
