"""The RHC's QP by its stages instead of condensed: time grows with N, not N³.

    min  ½ Σ_{i=1..N} x_i' Q_i x_i + Σ_{i=0..N-1} (½ u_i' R u_i + g_i' u_i)
    s.t. x_0 = 0, x_{i+1} = A_i x_i + B_i u_i, lower_i ≤ u_i ≤ upper_i

This is the condensed QP min ½ u'Hu + g'u with H never formed. For a guess of which inputs are at a
bound one Riccati recursion solves for the rest; `pivoting` corrects the guess, which begins at the
previous solution's.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, every
from rhec.core.solver.gauss_newton import symmetric
from rhec.core.solver.pivoting import corrected_bound, first_corrected, search_active_set

__all__ = ["box_lq"]


def box_lq(N, A_0, D, B, loops):
    """The Function (D, B, Q, QN, R, g, lower, upper, active) -> (x, multipliers, ok).

    Args:
        N: Intervals.
        A_0: (n, n) constant entries of an interval's transition A = A_0 + D.
        D: Sparsity of the others.
        B: Sparsity of its (n, m) input matrix.
        loops: SX or MX, for what repeats an interval.

    Returns:
        The Function. D and B stand side by side; Q, QN (n,) and R (m,) are diagonals; g, lower,
        upper and active are rows of N·m entries, interval by interval; active is 1, -1, 0 for an
        input guessed at its upper, its lower, no bound. Multipliers are positive at an upper bound.
    """
    n, m = B.shape
    state = (n, 1)
    column = (m, 1)
    matrix = (n, n)
    one = (1, 1)
    bounds = dict(lower=column, upper=column, active=column)

    @casadi_function(
        "lq_backward", P=matrix, p=state, D=D, B=B, Q=state, R=column, g=column, **bounds
    )
    def backward(P, p, D, B, Q, R, g, lower, upper, active):
        """Cost-to-go ½x'Px + p'x one interval back, and the input u = Kx + k in between."""
        A = A_0 + D
        free = active == 0
        bound = ca.if_else(active > 0, upper, lower)
        H = B.T @ P @ B + ca.diag(R)
        if m == 1:
            inverse = free / H
            K = -inverse * (B.T @ P @ A)
            k = ca.if_else(free, -inverse * (g + B.T @ p), bound)
        else:
            fixed = ca.if_else(free, 0, bound)
            among_free = ca.diag(free) @ H @ ca.diag(free) + ca.diag(1 - free)
            factors = ca.ldl(among_free, False)
            K = -ca.ldl_solve(ca.diag(free) @ (B.T @ P @ A), *factors)
            k = ca.ldl_solve(-free * (g + B.T @ p + H @ fixed), *factors) + fixed
        before = symmetric(A.T @ P @ (A + B @ K)) + ca.diag(Q)
        return dict(P_before=before, p_before=A.T @ (p + P @ (B @ k)), K=K, k=k)

    @casadi_function(
        "lq_forward",
        x=state,
        wrong=one,
        P=matrix,
        p=state,
        D=D,
        B=B,
        R=column,
        g=column,
        **bounds,
        K=(m, n),
        k=column,
    )
    def forward(x, wrong, P, p, D, B, R, g, lower, upper, active, K, k):
        """Roll one interval forward; the bounds that its signs ask for; how many were wrong."""
        u = K @ x + k
        x = (A_0 + D) @ x + B @ u
        multiplier = -(g + R * u + B.T @ (p + P @ x)) * (active != 0)
        right = corrected_bound(active, u, multiplier, lower, upper)
        first, wrong = first_corrected(active, right, wrong)
        return dict(
            x_after=x,
            u=u,
            multiplier=multiplier,
            right=right,
            first=ca.vertcat(*first),
            wrong_after=wrong,
        )

    row = (1, N * m)
    given = dict(D=ca.repmat(D, 1, N), B=ca.repmat(B, 1, N), Q=state, QN=state, R=column)
    problem = given | dict(g=row, lower=row, upper=row)

    def stages(row):
        return [part.T for part in ca.horzsplit(row, m)]

    @casadi_function("lq_solve", loops, **problem, active=row)
    def solve(D, B, Q, QN, R, g, lower, upper, active):
        """The solution for one guess of the active set, and what its signs say of the guess."""
        D = ca.horzsplit(D, n)
        B = ca.horzsplit(B, m)
        g, lower, upper, active = map(stages, (g, lower, upper, active))
        P = [None] * N + [ca.diag(QN)]
        p = [None] * N + [ca.DM.zeros(n)]
        K = [None] * N
        k = [None] * N
        for i in reversed(range(N)):
            P[i], p[i], K[i], k[i] = backward(
                P[i + 1], p[i + 1], D[i], B[i], Q, R, g[i], lower[i], upper[i], active[i]
            )
        x, wrong, u, multipliers, right, first = ca.DM.zeros(n), 0, *([None] * N for _ in range(4))
        for i in range(N):
            x, u[i], multipliers[i], right[i], first[i], wrong = forward(
                x,
                wrong,
                P[i + 1],
                p[i + 1],
                D[i],
                B[i],
                R,
                g[i],
                lower[i],
                upper[i],
                active[i],
                K[i],
                k[i],
            )
        u, multipliers, right, first = (
            ca.vertcat(*column).T for column in (u, multipliers, right, first)
        )
        finite = every(ca.fabs(u) < ca.inf)  # also 0 where u is not a number
        return dict(
            x=u,
            multipliers=multipliers,
            corrected=right,
            first_corrected=first,
            wrong=ca.if_else(finite, wrong, -1),
        )

    return search_active_set("box_lq", N * m, solve, problem)
