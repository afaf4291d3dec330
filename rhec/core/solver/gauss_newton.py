"""Gauss-Newton on a multiple-shooting problem (paper, Sec. Solution Methods), for RHE and RHC.

Both problems are least squares over trajectories s_0 … s_N, v_0 … v_{N-1} of one interval,
s⁺ = F(s, v). Linearised at the previous solution (s̄, v̄) the dynamics are s_{i+1} = F_i +
A_i (s_i - s̄_i) + B_i (v_i - v̄_i); what is unbounded is then eliminated, and what is left is a QP
with bounds only: in the bounded parameters for the RHE, in the commands for the RHC.
"""

import casadi as ca

__all__ = ["kkt_tolerance", "shift", "symmetric"]


def shift(interval, s, v, dt_s):
    """Warm start: the trajectory one interval on, its last input repeated, one node integrated.

    The paper: the initial value "takes on the value of the previous one intelligently".
    """
    v = ca.horzcat(v[:, 1:], v[:, -1])
    return ca.horzcat(s[:, 1:], interval.step(s[:, -1], v[:, -1], dt_s)), v


def kkt_tolerance(gradient_along_step, multipliers, lower, upper):
    """KKT tolerance as ACADO's generated code defines it (interpretation R12).

    |∇J·Δw| + Σ |λ_i · (distance from the linearisation point to the bound)|.
    """
    bound = ca.if_else(multipliers > 0, upper, lower)
    return ca.fabs(gradient_along_step) + ca.sum1(ca.vec(ca.fabs(multipliers * bound)))


def symmetric(P):
    """P (n, n) from its upper triangle: half the work, and symmetric to the last bit."""
    return ca.triu2symm(ca.triu(P))
