"""Small dense QPs with bounds: min ½ x'Hx + g'x, lb ≤ x ≤ ub."""

import casadi as ca

from rhec.core._casadi.build import casadi_function, every
from rhec.core.solver.stage_qp import stage_qp


def box_qp(n):
    """Build the Function (H, g, lb, ub) -> (x, solved) that minimises ½ x'Hx + g'x, lb ≤ x ≤ ub.

    One and two variables have a closed form, more are solved by pivoting. Where the solution is not
    finite, both results are 0.
    """
    if n > 2:
        return _box_qp_by_pivoting(n)
    matrix = (n, n)
    column = (n, 1)

    @casadi_function(f"box_qp_{n}")
    def solve(H: matrix, g: column, lb: column, ub: column):
        if n == 1:
            best = ca.fmin(ca.fmax(-g / H, lb), ub)
        else:
            best = _best_of_two(H, g, lb, ub)
        solved = every(ca.vertcat(best >= lb, best <= ub))  # also 0 where x is not a number
        return dict(x=ca.if_else(solved, best, 0), solved=solved)

    return solve


def _best_of_two(H, g, lb, ub):
    """The optimum in two variables: the unconstrained one, or the best point of an edge."""
    best = -ca.inv_minor(H) @ g
    inside = every(ca.vertcat(best >= lb, best <= ub))
    # No edge is better than an unconstrained optimum inside.
    least = ca.if_else(inside, -ca.inf, ca.inf)
    for fixed in (0, 1):
        other = 1 - fixed
        for bound in (lb, ub):
            along = -(g[other] + H[other, fixed] * bound[fixed]) / H[other, other]
            along = ca.fmin(ca.fmax(along, lb[other]), ub[other])
            x = ca.vertcat(bound[0], along) if fixed == 0 else ca.vertcat(along, bound[1])
            cost = ca.bilin(H, x, x) / 2 + ca.dot(g, x)
            best = ca.if_else(cost < least, x, best)
            least = ca.fmin(cost, least)
    return best


def _box_qp_by_pivoting(n):
    """The box QP of more than two variables: one stage without states, from no bound active."""
    no_bound = ca.MX.zeros(1, n)
    nothing = ca.Sparsity(0, 0)
    one_stage = dict(A_0=ca.DM(0, 0), D=nothing, B=ca.Sparsity(0, n), Q=nothing)
    search = stage_qp(1, **one_stage, R=ca.Sparsity.dense(n, n), loop_symbols=ca.SX)

    @casadi_function(f"box_qp_{n}", ca.MX)
    def box_qp(H: (n, n), g: (n, 1), lb: (n, 1), ub: (n, 1)):
        solution = search(
            R=H, g=ca.horzcat(g, ca.MX.zeros(n)), lower=lb.T, upper=ub.T, active=no_bound
        )
        return dict(x=ca.fmin(ca.fmax(solution["x"].T, lb), ub), solved=solution["solved"])

    return box_qp
