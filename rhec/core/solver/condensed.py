"""The RHC's QP condensed to its commands, and solved by a library, as in the paper (qpOASES)."""

import casadi as ca

from rhec.core._casadi.build import casadi_function
from rhec.core.model.limits import MAX_QP_ENTRY, is_plausible

__all__ = ["box_qp_by_library", "condensed_hessian"]

# DAQP is asked for more than its usual tolerance, so that all solvers give one answer to 1e-8.
_OPTIONS = {
    "daqp": {"daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11}},
    "qpoases": {"printLevel": "none", "hessian_type": "posdef"},
}


def condensed_hessian(A, B, Q, R):
    """Hessian in u alone of ½ Σ_{i=1..N} x_i' Q_i x_i + ½ Σ_{i=0..N-1} u_i' R u_i.

    Here x_0 = 0 and x_{i+1} = A_i x_i + B_i u_i. It needs O(N²) operations: the response to each
    single input forwards, its adjoint backwards (Andersson, "A General-Purpose Software Framework
    for Dynamic Optimization", 2013). Q is indexed 0 … N-1 for nodes 1 … N.
    """
    N = len(A)
    H = [[None] * N for _ in range(N)]
    for j in range(N):
        response = [B[j]]  # ∂x_{j+1}/∂u_j … ∂x_N/∂u_j
        for i in range(j + 1, N):
            response.append(A[i] @ response[-1])
        adjoint = Q[N - 1] @ response[-1]
        for i in range(N - 1, j, -1):
            H[i][j] = B[i].T @ adjoint
            H[j][i] = H[i][j].T
            adjoint = Q[i - 1] @ response[i - 1 - j] + A[i].T @ adjoint
        H[j][j] = B[j].T @ adjoint + R
    return ca.vertcat(*(ca.horzcat(*row) for row in H))


def box_qp_by_library(n, solver):
    """A box QP by DAQP or qpOASES: (H, g, lb, ub) -> (x, multipliers, ok).

    Multipliers are positive at an upper, negative at a lower bound. CasADi's solvers report a
    failure and go on; then ok, x and the multipliers are 0: no step. What is not a number, or
    absurd, never reaches the solver: one that starts from its last solution might keep it.
    """
    column = (n, 1)

    @casadi_function("box_qp", ca.MX, H=(n, n), g=column, lb=column, ub=column)
    def solve(H, g, lb, ub):
        fine = is_plausible(ca.veccat(H, g, lb, ub), MAX_QP_ENTRY)
        given = [
            ca.if_else(fine, value, default)
            for value, default in ((H, ca.DM.eye(n)), (g, 0), (lb, 0), (ub, 0))
        ]
        qp = ca.conic(
            "qp", solver, {"h": H.sparsity()}, {"error_on_fail": False, **_OPTIONS[solver]}
        )
        solution = qp(**dict(zip(("h", "g", "lbx", "ubx"), given)))
        x = solution["x"]
        multipliers = solution["lam_x"]
        # An active-set solver may leave the box by its tolerance; the bounds are hard. Also 0
        # where x is not a number.
        ok = fine * ca.mmin(ca.vertcat(x >= lb - 1e-6, x <= ub + 1e-6))
        return dict(
            x=ca.if_else(ok, ca.fmin(ca.fmax(x, lb), ub), 0),
            multipliers=ca.if_else(ok, multipliers, 0),
            ok=ok,
        )

    return solve
