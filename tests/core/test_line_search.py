"""The line search takes the longest of its steps that lowers the merit enough."""

import casadi as ca
import numpy as np
import pytest

from rhec.core._casadi.build import casadi_function
from rhec.core.solver.interior_point import NO_PRICE
from rhec.core.solver.line_search import line_search
from rhec.core.solver.relaxation import relaxation

N, CONDITIONS = 3, 2


@casadi_function("cost_and_gaps", ca.MX, w=(N, 1), H=(N, N), A=(CONDITIONS, N))
def cost_and_gaps(w, H, A):
    """J = wᵀ H w / 2 with a quartic term, and ‖A w + w₁²‖₁."""
    cost = ca.bilin(H, w, w) / 2 + ca.sumsqr(w) ** 2 / 10
    return dict(cost=cost, gaps=ca.norm_1(A @ w + w[0] ** 2))


SEARCH = line_search("search", dict(w=(N, 1)), dict(H=(N, N), A=(CONDITIONS, N)), cost_and_gaps)


@pytest.mark.parametrize("far", [0.1, 1.0, 3.0])
def test_the_first_length_at_which_the_merit_falls_enough_is_taken(far):
    """φ(w + α Δw) <= φ(w) + 1e-4 α D, of 1, 1/2, … 1/512, and none where none is good enough.

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
        lengths = 0.5 ** np.arange(10)
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


@casadi_function("cost", ca.MX, s=(1, 2), u=(1, 1), linear=(1, 1))
def cost_with_hard_row(s, u, linear):
    none = dict.fromkeys(("gaps", "beyond", "way"), ca.MX.zeros(1))
    return none | dict(cost=u**2 / 2, root_s=1, root_u=1)


SHARE_OF = relaxation("share", dict(s=(1, 2), u=(1, 1)), dict(linear=(1, 1)), cost_with_hard_row)


def shortened(penalty, step, kkt, excess=0):
    """A step of the input from 1 down, of a plan with a hard row."""
    given = dict(s=[0, 0], s_full=[0, 0], u=1, u_full=1 - step, linear=NO_PRICE)
    given |= dict(solved=1, price=1e6, kkt=kkt, excess=excess)
    found = {
        name: value.full().ravel() for name, value in SHARE_OF(penalty=penalty, **given).items()
    }
    return found["penalty_after"], {name: value[0] for name, value in found.items()}


@pytest.mark.parametrize("halvings", range(8))
def test_a_step_with_hard_rows_is_halved_until_the_merit_is_not_higher(halvings):
    """Down to 1/32 of it; then the plan stays, and the next price is a tenth, until none helps."""
    length = 1.5 * 2**halvings
    penalty, found = shortened(np.zeros(6), length, kkt=1)
    share = 0.5**halvings if halvings <= 5 else 0
    assert found["u"] == pytest.approx(1 - share * length, abs=1e-12) and not found["done"]
    assert penalty[1] == (share == 0)
    if share == 0:
        decades = [penalty[1]]
        while not found["done"] and len(decades) < 20:
            penalty, found = shortened(penalty, length, kkt=1)
            decades.append(penalty[1])
        np.testing.assert_array_equal(decades[:-1], np.arange(1, len(decades)))
        assert found["done"] and decades[-1] == decades[-2]


@pytest.mark.parametrize("excess", [0.0, 0.5])
def test_with_an_excess_it_has_converged_at_the_highest_price_alone(excess):
    """Which is higher with each iteration near a solution that exceeds a hard row."""
    penalty = np.zeros(6)
    for iteration in range(20):
        before = penalty[1]
        penalty, found = shortened(penalty, 0.1, 1e-10, excess)
        assert found["near"] and found["excess_shown"] in (0, excess)
        assert found["converged"] == (penalty[1] == before)
        if found["converged"]:
            break
        assert penalty[1] == before - 1 and not found["done"]
    assert found["converged"] and found["excess_shown"] == excess
    assert (iteration > 0) == (excess > 0)
