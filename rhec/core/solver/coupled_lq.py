"""A QP by its stages whose costs may be indefinite and couple states with inputs.

    min  ½ x_N' Q_N x_N + Σ_{i=0..N-1} (½ (x_i, u_i)' W_i (x_i, u_i) + g_i' u_i)
    s.t. x_0 = 0, x_{i+1} = A_i x_i + B_i u_i, lower_i ≤ u_i ≤ upper_i

It is `box_lq` with matrices W_i = (Q_i, S_i'; S_i, R_i) of any sign. Condensed to its free inputs,
the cost has a unique minimum exactly where all pivots of the recursion are positive (the recursion
is an LDL' factorisation of the condensed Hessian). The search for the active set ends at a guess
without one, and tells so by `ok`, because such a guess leads nowhere.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, every
from rhec.core.solver.gauss_newton import symmetric
from rhec.core.solver.pivoting import corrected_interval, search_active_set

DOUBLINGS = 4  # 17 guesses at most; without a positive Hessian, more of them may go in circles
_LEAST_PIVOT = 1e-3  # of a weight that the caller names for each input


def coupled_lq(N, A_0, D, B, loops):
    """Build the Function (D, B, W, QN, scale, g, lower, upper, active) -> (ok, x, multipliers).

    Args:
        N: Number of intervals.
        A_0: (n, n) constant entries of an interval's transition A = A_0 + D.
        D: Sparsity (n, n).
        B: Sparsity (n, m).
        loops: SX or MX, for Functions that repeat an interval.

    Returns:
        The Function of `rhec.core.solver.box_lq.box_lq`, with the matrices W (n + m, n + m) of the
        intervals side by side, and with weights `scale` (m,) of the inputs: pivots below a
        thousandth of them count as no minimum.
    """
    n, m = B.shape
    row = (1, N * m)
    problem = dict(D=ca.repmat(D, 1, N), B=ca.repmat(B, 1, N), W=(n + m, N * (n + m)))
    problem |= dict(QN=(n, 1), scale=(m, 1), g=row, lower=row, upper=row)
    backward = _build_backward(A_0, D, B)
    forward = _build_forward(A_0, D, B)

    @casadi_function("coupled_solve", loops, **problem, active=row)
    def solve(D, B, W, QN, scale, g, lower, upper, active):
        D = ca.horzsplit(D, n)
        B = ca.horzsplit(B, m)
        W = ca.horzsplit(W, n + m)
        rows = (g, lower, upper, active)
        g, lower, upper, active = ([part.T for part in ca.horzsplit(row, m)] for row in rows)
        P = [None] * N + [ca.diag(QN)]
        p = [None] * N + [ca.DM.zeros(n)]
        policies = [None] * N
        convex = 1
        for i in reversed(range(N)):
            stage = D[i], B[i], W[i], scale, g[i], lower[i], upper[i], active[i]
            P[i], p[i], *policies[i], convex = backward(P[i + 1], p[i + 1], convex, *stage)
        # The QP is in changes from the rolled-out plan, so it starts at 0.
        x = ca.DM.zeros(n)
        n_infeasible = 0
        solutions = []
        for i in range(N):
            cost_to_go = P[i + 1], p[i + 1]
            stage = D[i], B[i], W[i], g[i], lower[i], upper[i], active[i]
            x, *solution, n_infeasible = forward(x, n_infeasible, *cost_to_go, *stage, *policies[i])
            solutions.append(solution)
        u, multipliers, proposed, first_exchange = (ca.vertcat(*c).T for c in zip(*solutions))
        finite = every(ca.fabs(u) < ca.inf)  # also 0 where u is not a number
        wrong = ca.if_else(finite * convex, n_infeasible, -1)
        corrected = dict(corrected=proposed, first_corrected=first_exchange)
        return dict(x=u, multipliers=multipliers, **corrected, wrong=wrong)

    return search_active_set("coupled_lq", N * m, solve, problem, DOUBLINGS)


def _build_backward(A_0, D_i, B_i):
    """One step of the Riccati recursion, from the cost-to-go ½x'Px + p'x after an interval.

    With H = B'PB + R the free inputs minimise the cost by u = Kx + k:
    K = -H⁻¹ (B'PA + S),  k = -H⁻¹ (g + B'p);  an input at a bound has K = 0 and k = the bound.
    Before the interval, P⁻ = A'PA + Q + (A'PB + S') K and p⁻ = A' (p + PBk) + S'k. `convex`
    becomes 0 where a pivot of H is not positive.
    """
    n, m = B_i.shape
    state = (n, 1)
    inputs = (m, 1)

    @casadi_function("coupled_backward")
    def backward(
        P: (n, n), p: state, convex: (1, 1), D: D_i, B: B_i, W: (n + m, n + m), scale: inputs,
        g: inputs, lower: inputs, upper: inputs, active: inputs,
    ):  # fmt: skip
        A = A_0 + D
        free = active == 0
        # Rows of inputs at a bound become those of the identity.
        fixed = ca.if_else(free, 0, ca.if_else(active > 0, upper, lower))
        H = B.T @ P @ B + W[n:, n:]
        M_ux = B.T @ P @ A + W[n:, :n]
        among_free = ca.diag(free) @ H @ ca.diag(free) + ca.diag(1 - free)
        pivots, *factors = ca.ldl(ca.densify(among_free), False)
        K = -ca.ldl_solve(ca.diag(free) @ M_ux, pivots, *factors)
        k = ca.ldl_solve(-free * (g + B.T @ p + H @ fixed), pivots, *factors) + fixed
        P_before = symmetric(W[:n, :n] + A.T @ P @ A + M_ux.T @ K)
        p_before = A.T @ (p + P @ (B @ k)) + W[:n, n:] @ k
        # The comparison is also 0 where a pivot is no number.
        is_convex = convex * every(pivots > free * _LEAST_PIVOT * scale)
        return dict(P_before=P_before, p_before=p_before, K=K, k=k, convex_before=is_convex)

    return backward


def _build_forward(A_0, D_i, B_i):
    """One interval forward: u = Kx + k, x⁺ = Ax + Bu, and the multipliers of the bounds,
    -(g + Ru + Sx + B' (p + Px⁺)), whose signs say which bounds should change.
    """
    n, m = B_i.shape
    state = (n, 1)
    inputs = (m, 1)

    @casadi_function("coupled_forward")
    def forward(
        x: state, wrong: (1, 1), P: (n, n), p: state, D: D_i, B: B_i, W: (n + m, n + m),
        g: inputs, lower: inputs, upper: inputs, active: inputs, K: (m, n), k: inputs,
    ):  # fmt: skip
        u = K @ x + k
        after = (A_0 + D) @ x + B @ u
        slope = g + W[n:, :] @ ca.vertcat(x, u) + B.T @ (p + P @ after)
        multiplier = -slope * (active != 0)
        return corrected_interval(after, u, multiplier, active, lower, upper, wrong)

    return forward
