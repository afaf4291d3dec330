"""A QP with bounds on its inputs, by its stages instead of condensed: time grows with N, not N³.

    min  ½ Σ_{i=1..N-1} x_i' Q x_i + ½ x_N' Q_N x_N + ½ Σ_{i=0..N-1} u_i' R u_i
         + Σ_{i=0..N} g_i' (x_i, u_i)
    s.t. x_0 = 0, x_{i+1} = A_i x_i + B_i u_i, lower_i ≤ u_i ≤ upper_i

This is the condensed QP min ½ u'Hu + g'u with H never formed. For a guess of which inputs are at a
bound, one Riccati recursion solves for the others; `pivoting` corrects the guess, which begins with
the caller's. A dense QP with bounds is one stage without states.

The sparsities of A, B, Q and R are those of the caller's problem: what is structurally zero, such
as what is beside the diagonal of a diagonal weight, costs no operation.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, every
from rhec.core.solver.gauss_newton import symmetric
from rhec.core.solver.pivoting import correct_guess, search_active_set


def stage_qp(N, A_0, D, B, Q, R, loop_symbols):
    """Build the Function (D, B, Q, QN, R, g, lower, upper, active) -> (solved, x, multipliers, …).

    The Function takes D and B of all intervals side by side, and g (n + m, N+1), the gradient in
    (x_i, u_i) of all nodes. Its rows lower, upper, active, x and multipliers have N·m entries,
    interval by interval: `active` is 1 for an input at its upper bound, -1 at its lower, 0 at none;
    x holds the inputs; multipliers are positive at an upper bound. `slope` is Σ g_i' (x_i, u_i).
    Where no solution is found, all results are 0.

    Args:
        N: Number of stages.
        A_0: (n, n) constant part of an interval's transition A = A_0 + D.
        D: Sparsity (n, n) of the other part.
        B: Sparsity (n, m) of an interval's input matrix.
        Q: Sparsity (n, n) of the states' weights, Q and QN.
        R: Sparsity (m, m) of the inputs' weight.
        loop_symbols: SX or MX, for the Function that repeats a stage.
    """
    n, m = B.shape
    row = (1, N * m)
    problem = dict(D=ca.repmat(D, 1, N), B=ca.repmat(B, 1, N), Q=Q, QN=Q, R=R)
    problem |= dict(g=(n + m, N + 1), lower=row, upper=row)
    backward = _build_backward(A_0, D, B, Q, R)
    forward = _build_forward(A_0, D, B, R)

    @casadi_function("qp_solve", loop_symbols, **problem, active=row)
    def solve(D, B, Q, QN, R, g, lower, upper, active):
        D = ca.horzsplit(D, [i * n for i in range(N + 1)])
        B = ca.horzsplit(B, m)
        rows = (lower, upper, active)
        lower, upper, active = ([part.T for part in ca.horzsplit(row, m)] for row in rows)
        g = ca.horzsplit(g)
        P = [None] * N + [QN]
        p = [None] * N + [g[N][:n]]
        policies = [None] * N
        for i in reversed(range(N)):
            P[i], p[i], *policies[i] = backward(
                P[i + 1], p[i + 1], D[i], B[i], Q, R, g[i], lower[i], upper[i], active[i]
            )
        x = ca.DM.zeros(n)
        n_infeasible = 0
        slope = 0
        solutions = []
        for i in range(N):
            cost_to_go = P[i + 1], p[i + 1]
            stage = D[i], B[i], R, g[i], lower[i], upper[i], active[i]
            slope += ca.dot(g[i][:n], x)
            x, *solution, n_infeasible = forward(x, n_infeasible, *cost_to_go, *stage, *policies[i])
            slope += ca.dot(g[i][n:], solution[0])
            solutions.append(solution)
        slope += ca.dot(g[N][:n], x)
        u, multipliers, proposed, first_exchange = (ca.vertcat(*c).T for c in zip(*solutions))
        finite = every(ca.fabs(u) < ca.inf)  # also 0 where u is not a number
        wrong = ca.if_else(finite, n_infeasible, -1)
        corrected = dict(corrected=proposed, first_corrected=first_exchange)
        return dict(x=u, multipliers=multipliers, slope=slope, **corrected, wrong=wrong)

    return search_active_set(N * m, solve, problem)


def _build_backward(A_0, D_i, B_i, Q_i, R_i):
    """One step of the Riccati recursion, from the cost-to-go ½x'Px + p'x after an interval.

    With H = B'PB + R the free inputs minimise the cost by u = Kx + k:
    K = -H⁻¹ B'PA,  k = -H⁻¹ (g_u + B'p);  an input at a bound has K = 0 and k = the bound.
    Before the interval, P⁻ = A'P (A + BK) + Q and p⁻ = g_x + A' (p + PBk).
    """
    n, m = B_i.shape
    matrix = (n, n)
    state = (n, 1)
    inputs = (m, 1)

    @casadi_function("qp_backward")
    def backward(
        P: matrix, p: state, D: D_i, B: B_i, Q: Q_i, R: R_i, g: (n + m, 1),
        lower: inputs, upper: inputs, active: inputs,
    ):  # fmt: skip
        A = A_0 + D
        g_x, g_u = g[:n], g[n:]
        free = active == 0
        bound = ca.if_else(active > 0, upper, lower)
        H = B.T @ P @ B + R
        if m == 1:
            inverse = free / H
            K = -inverse * (B.T @ P @ A)
            k = ca.if_else(free, -inverse * (g_u + B.T @ p), bound)
        else:
            # Rows of inputs at a bound become those of the identity.
            fixed = ca.if_else(free, 0, bound)
            among_free = ca.diag(free) @ H @ ca.diag(free) + ca.diag(1 - free)
            factors = ca.ldl(among_free, False)
            K = -ca.ldl_solve(ca.diag(free) @ (B.T @ P @ A), *factors)
            k = ca.ldl_solve(-free * (g_u + B.T @ p + H @ fixed), *factors) + fixed
        P_before = symmetric(A.T @ P @ (A + B @ K)) + Q
        return dict(P_before=P_before, p_before=g_x + A.T @ (p + P @ (B @ k)), K=K, k=k)

    return backward


def _build_forward(A_0, D_i, B_i, R_i):
    """One interval forward: u = Kx + k, x⁺ = Ax + Bu, and the multipliers of the bounds,
    -(g_u + Ru + B' (p + Px⁺)), whose signs say which bounds should change.
    """
    n, m = B_i.shape
    matrix = (n, n)
    state = (n, 1)
    one = (1, 1)
    inputs = (m, 1)

    @casadi_function("qp_forward")
    def forward(
        x: state, wrong: one, P: matrix, p: state, D: D_i, B: B_i, R: R_i, g: (n + m, 1),
        lower: inputs, upper: inputs, active: inputs, K: (m, n), k: inputs,
    ):  # fmt: skip
        u = K @ x + k
        x = (A_0 + D) @ x + B @ u
        multiplier = -(g[n:] + R @ u + B.T @ (p + P @ x)) * (active != 0)
        proposed, first_exchange, n_infeasible = correct_guess(
            active, u, multiplier, lower, upper, wrong
        )
        solution = dict(x_after=x, u=u, multiplier=multiplier)
        first = ca.vertcat(*first_exchange)
        return solution | dict(right=proposed, first=first, wrong_after=n_infeasible)

    return forward
