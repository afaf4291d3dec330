"""Small dense QPs with bounds."""

import casadi as ca

from rhec.core._casadi.build import casadi_function, every
from rhec.core.solver.pivoting import corrected_bound, first_corrected, search_active_set

__all__ = ["box_qp"]


def box_qp(n):
    """min ½ x'Hx + g'x, lb ≤ x ≤ ub, as a Function (H, g, lb, ub) -> (x, ok).

    One and two variables in closed form: the optimum is the free one, or lies on an edge. More by
    pivoting. Where no number comes out, ok and x are 0.
    """
    if n > 2:
        return _box_qp_by_pivoting(n)
    column = (n, 1)

    @casadi_function(f"box_qp_{n}", H=(n, n), g=column, lb=column, ub=column)
    def solve(H, g, lb, ub):
        if n == 1:
            best = ca.fmin(ca.fmax(-g / H, lb), ub)
        else:
            best = -ca.inv_minor(H) @ g
            inside = every(ca.vertcat(best >= lb, best <= ub))
            least = ca.if_else(inside, -ca.inf, ca.inf)
            for x in _edges(H, g, lb, ub):
                cost = ca.bilin(H, x, x) / 2 + ca.dot(g, x)
                best = ca.if_else(cost < least, x, best)
                least = ca.fmin(cost, least)
        ok = every(ca.vertcat(best >= lb, best <= ub))  # also 0 where x is not a number
        return dict(x=ca.if_else(ok, best, 0), ok=ok)

    return solve


def _edges(H, g, lb, ub):
    """The best point of each of the four edges of a box in two variables."""
    for fixed in (0, 1):
        other = 1 - fixed
        for bound in (lb, ub):
            along = -(g[other] + H[other, fixed] * bound[fixed]) / H[other, other]
            along = ca.fmin(ca.fmax(along, lb[other]), ub[other])
            yield ca.vertcat(bound[0], along) if fixed == 0 else ca.vertcat(along, bound[1])


def _box_qp_by_pivoting(n):
    row = (1, n)
    column = (n, 1)

    @casadi_function("qp_solve", H=(n, n), g=row, lb=row, ub=row, active=row)
    def solve(H, g, lb, ub, active):
        free = active == 0
        fixed = ca.if_else(free, 0, ca.if_else(active > 0, ub, lb))
        among_free = ca.diag(free) @ H @ ca.diag(free) + ca.diag(1 - free)
        x = ca.ldl_solve(-free.T * (g.T + H @ fixed.T), *ca.ldl(among_free, False)).T + fixed
        multipliers = -(x @ H + g) * (1 - free)
        right = corrected_bound(active, x, multipliers, lb, ub)
        first, wrong = first_corrected(active, right, 0)
        return dict(
            x=x,
            multipliers=multipliers,
            corrected=right,
            first_corrected=ca.horzcat(*first),
            wrong=ca.if_else(every(ca.fabs(x) < ca.inf), wrong, -1),
        )

    search = search_active_set("qp", n, solve, dict(H=(n, n), g=row, lb=row, ub=row))

    @casadi_function(f"box_qp_{n}", ca.MX, H=(n, n), g=column, lb=column, ub=column)
    def box_qp(H, g, lb, ub):
        found = search(H=H, g=g.T, lb=lb.T, ub=ub.T, active=ca.MX.zeros(1, n))
        return dict(x=ca.fmin(ca.fmax(found["x"].T, lb), ub), ok=found["ok"])

    return box_qp
