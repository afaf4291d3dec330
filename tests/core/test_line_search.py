"""The line search takes the longest of its steps that lowers the merit enough."""

import casadi as ca
import numpy as np
import pytest

from rhec.core._casadi.build import casadi_function
from rhec.core.solver.line_search import HALVINGS, line_search

N, CONDITIONS = 3, 2


@casadi_function("cost_and_gaps", ca.MX, w=(N, 1), H=(N, N), A=(CONDITIONS, N))
def cost_and_gaps(w, H, A):
    """J = wᵀ H w / 2 with a quartic term, and ‖A w + w₁²‖₁."""
    cost = ca.bilin(H, w, w) / 2 + ca.sumsqr(w) ** 2 / 10
    return dict(cost=cost, gaps=ca.norm_1(A @ w + w[0] ** 2))


SEARCH = line_search("search", dict(w=(N, 1)), dict(H=(N, N), A=(CONDITIONS, N)), cost_and_gaps)


@pytest.mark.parametrize("far", [0.1, 1.0, 3.0])
def test_the_first_length_at_which_the_merit_falls_enough_is_taken(far):
    """φ(w + α Δw) <= φ(w) + 1e-4 α D, of 1, 1/2, 1/4, …, and none where none is good enough.

    Whatever φ is, the whole step is taken where |D| has fallen below 0.9 of the least so far.
    """
    rng = np.random.default_rng(0)
    taken = []
    for _ in range(80):
        root = rng.normal(size=(N, N))
        H, A = root @ root.T + 0.1 * np.eye(N), rng.normal(size=(CONDITIONS, N))
        w = rng.normal(size=N)
        gradient = H @ w + 0.4 * (w @ w) * w
        step = -far * np.linalg.solve(H, gradient) + 0.1 * rng.normal(size=N)
        given = dict(w=w, w_full=w + step, penalty=[0.5, 0.0], H=H, A=A)
        found = SEARCH(**given)

        def merit(alpha, mu):
            values = cost_and_gaps(w=w + alpha * step, H=H, A=A)
            return float(values["cost"]) + mu * float(values["gaps"])

        mu, gaps = float(found["penalty_after"][0]), float(cost_and_gaps(w=w, H=H, A=A)["gaps"])
        descent = gradient @ step - mu * gaps
        assert mu >= 0.5 and descent <= max(gradient @ step, -0.5 * mu * gaps) + 1e-9
        lengths = 0.5 ** np.arange(HALVINGS)
        good = [a for a in lengths if merit(a, mu) <= merit(0, mu) + 1e-4 * a * descent + 1e-12]
        expected = good[0] if good else 0.0
        np.testing.assert_allclose(found["w"].full().ravel(), w + expected * step, rtol=1e-12)
        assert found["is_full"] == (expected == 1)
        taken.append(expected)
        for share, is_full in ((0.85, True), (0.95, expected == 1)):
            least = -descent / share
            again = SEARCH(**given | dict(penalty=[0.5, least]))
            assert again["is_full"] == is_full
            least_after = -descent if share < 0.9 else least
            assert float(again["penalty_after"][1]) == pytest.approx(least_after, rel=1e-9)
    assert len({*taken}) >= 2
