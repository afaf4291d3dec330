"""Gauss-Newton on a multiple-shooting problem (paper, Sec. Solution Methods), for RHE and RHC.

Both problems are least squares over trajectories s_0 … s_N, v_0 … v_{N-1} of one interval,
s⁺ = F(s, v). Linearised at the previous solution (s̄, v̄) the dynamics are s_{i+1} = F_i +
A_i (s_i - s̄_i) + B_i (v_i - v̄_i). All unbounded unknowns are then eliminated, which leaves a QP
with bounds only: in the bounded parameters for the RHE, in the commands for the RHC.
"""

import casadi as ca


def shift(interval, s, v, dt_s, v_next=None):
    """Shift a trajectory by one interval, as the warm start of the next sample.

    The last input is repeated and the last node integrated. In the paper's words, the initial value
    "takes on the value of the previous one intelligently". v_next (n_v,) may be another input.

    The nodes s (n_s, N+1) and the inputs v (n_v, N) get a new last interval of dt_s [s].
    """
    v = ca.horzcat(v[:, 1:], v[:, -1] if v_next is None else v_next)
    return ca.horzcat(s[:, 1:], interval.step(s[:, -1], v[:, -1], dt_s)), v


def kkt_tolerance(gradient_along_step, multipliers, lower, upper):
    """KKT tolerance as ACADO's generated code defines it (interpretation G12).

    |∇J·Δw| + Σ |λ_i · d_i|, with d_i the distance from the linearisation point to the bound.

    Here ∇J·Δw is the cost's slope along the Gauss-Newton step, and λ_i is positive at an upper,
    negative at a lower bound. `lower` and `upper` are distances. The tolerance is 0 at a solution.
    """
    bound = ca.if_else(multipliers > 0, upper, lower)
    return ca.fabs(gradient_along_step) + ca.sum1(ca.vec(ca.fabs(multipliers * bound)))


def symmetric(P):
    """Mirror the upper triangle of P (n, n): half the work, and symmetric to the last bit."""
    if isinstance(P, ca.MX):
        n = P.size1()
        upper = [min(i, j) + n * max(i, j) for j in range(n) for i in range(n)]
        return ca.reshape(ca.densify(P).nz[upper], n, n)
    return ca.triu2symm(ca.triu(P))


def solve_positive(P, b):
    """P⁻¹ b of a positive definite P (n, n), by its factors L D L'."""
    if isinstance(P, ca.MX) and P.numel():
        return ca.solve(P, b, "ldl")
    return ca.ldl_solve(ca.SX(b), *ca.ldl(ca.SX(P), False))


def propagated(A, P, added):
    """The covariance A P A' + added of a state after an interval with the slopes A (n, n)."""
    if isinstance(P, ca.MX):
        A = ca.densify(A)  # products of dense matrices are the fastest loops
    return symmetric(A @ P @ A.T + added)
