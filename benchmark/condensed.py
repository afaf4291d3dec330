"""The RHC's QP condensed to its commands, and solved by a library, as in the paper (qpOASES).

`measure` times the step of RHE and RHC with it. With qpOASES the feedback phase runs on CasADi's
virtual machine, because CasADi generates no C code for it. All else is compiled.
"""

from dataclasses import dataclass
from functools import partial

import casadi as ca
import pandas as pd

import rhec
from notebooks.studies import timing
from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core.controller.qp import commanded
from rhec.core.model.limits import MAX_QP_ENTRY, is_plausible

SOLVERS = "qpoases", "daqp"
# DAQP gets tighter tolerances than its usual ones, so that all solvers agree to 1e-8.
_OPTIONS = {
    "daqp": {"daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11}},
    "qpoases": {"printLevel": "none", "hessian_type": "posdef"},
}


@dataclass(frozen=True)
class Condensed:
    """The option `qp` of Stages, or of `rhec.RHC`; `solver` is "daqp" or "qpoases"."""

    solver: str

    @property
    def key(self):
        """What names compiled code: this module makes it, too."""
        return self.solver, compiled.source_digest(__name__)

    def build(self, stages):
        """Build the CondensedQP of Stages."""
        return CondensedQP(stages, self.solver)


def measure(scenario):
    """The times of `timing.table` with each of SOLVERS, and with the recursion by stages."""
    makers = {solver: partial(rhec.RHC, qp=Condensed(solver)) for solver in SOLVERS}
    makers["by stages"] = rhec.RHC
    tables = {name: timing.table(timing.phases(scenario, make)) for name, make in makers.items()}
    return pd.concat(tables, names=["qp"]).reset_index(level=0)


class CondensedQP:
    """The QP in the commanded inputs with a dense Hessian, which the preparation phase condenses.

    Args:
        stages: The controller's Stages.
        solver: "daqp" or "qpoases".
    """

    reported = ()

    def __init__(self, stages, solver):
        self.stages = stages
        self._solve = box_qp_by_library(stages.N * stages.n_c, solver)

    def prepare(self, inputs):
        """Condense the linearised dynamics and the weights to the Hessian H."""
        A, B = self._intervals(inputs)
        Q, QN, R = (ca.diag(inputs[name]) for name in ("Q", "QN", "R"))
        return dict(H=_condensed_hessian(A, B, [Q] * (self.stages.N - 1) + [QN], R))

    def solve(self, at_plan, inputs):
        """Solve min ½ Δu'HΔu + g'Δu, lower ≤ u + Δu ≤ upper, with H from `prepare`.

        Args and returns are those of `rhec.core.controller.qp.ActiveSet.solve`.
        """
        stages = self.stages
        g = _condensed_gradient(*self._intervals(inputs), ca.horzsplit(at_plan["g"]))
        commands = at_plan["rows"][:, : stages.N]
        lb, ub = (ca.vec(inputs[name] - commands) for name in ("lower", "upper"))
        solution = self._solve(H=inputs["H"], g=g, lb=lb, ub=ub)
        multipliers = solution["multipliers"]
        distance = ca.if_else(multipliers > 0, ub, lb)
        return dict(
            change=ca.reshape(solution["x"], stages.n_c, stages.N),
            decrease=ca.fabs(ca.dot(g, solution["x"])),
            complementarity=ca.sum1(ca.fabs(multipliers * distance)),
            solved=solution["solved"],
            ok=solution["solved"],
        )

    def _intervals(self, inputs):
        """A and B of each interval, of the states x and the commands."""
        stages = self.stages
        x = list(range(stages.n_x))
        of_commands = commanded(stages, inputs)
        A_0 = stages.interval.A_0[x, x]
        A = [A_0 + part for part in ca.horzsplit(of_commands["D"], stages.n_x)]
        return A, ca.horzsplit(of_commands["B"], stages.n_c)


def _condensed_gradient(A, B, g):
    """The gradient in u alone, from those of the nodes 0 … N in (x_i, u_i).

    λ_N = g_x,N;  g_i = g_u,i + B_i' λ_{i+1} and λ_i = g_x,i + A_i' λ_{i+1}.
    """
    n_x = A[0].size1()
    adjoint = g[-1][:n_x]
    condensed = []
    for A_i, B_i, g_i in zip(A[::-1], B[::-1], g[-2::-1]):
        condensed.insert(0, g_i[n_x:] + B_i.T @ adjoint)
        adjoint = g_i[:n_x] + A_i.T @ adjoint
    return ca.vertcat(*condensed)


def _condensed_hessian(A, B, Q, R):
    """Hessian (N·m, N·m) in u alone of ½ Σ_{i=1..N} x_i' Q_i x_i + ½ Σ_{i=0..N-1} u_i' R u_i.

    Here x_0 = 0 and x_{i+1} = A_i x_i + B_i u_i; the first of Q belongs to node 1. It takes O(N²)
    operations: the response to each single input forwards, its adjoint backwards (Andersson, "A
    General-Purpose Software Framework for Dynamic Optimization", 2013).
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
    """Build a box QP that DAQP or qpOASES solves.

    Args:
        n: Number of variables.
        solver: "daqp" or "qpoases".

    Returns:
        The Function (H, g, lb, ub) -> (x, multipliers, solved). Multipliers are positive at an
        upper, negative at a lower bound. Where the solver fails, all three are 0.
    """
    column = (n, 1)

    @casadi_function("box_qp", ca.MX)
    def solve(H: (n, n), g: column, lb: column, ub: column):
        # A solver that starts from its last solution might keep a value that is not a number.
        plausible = is_plausible(ca.veccat(H, g, lb, ub), MAX_QP_ENTRY)
        defaults = (H, ca.DM.eye(n)), (g, 0), (lb, 0), (ub, 0)
        h, g_safe, lbx, ubx = (ca.if_else(plausible, *value) for value in defaults)
        # CasADi's solvers report a failure and go on.
        options = {"error_on_fail": False, **_OPTIONS[solver]}
        qp = ca.conic("qp", solver, {"h": H.sparsity()}, options)
        solution = qp(h=h, g=g_safe, lbx=lbx, ubx=ubx)
        x = solution["x"]
        # An active-set solver may leave the box by its tolerance; the bounds are hard. The
        # comparison is also 0 where x is not a number.
        solved = plausible * ca.mmin(ca.vertcat(x >= lb - 1e-6, x <= ub + 1e-6))
        return dict(
            x=ca.if_else(solved, ca.fmin(ca.fmax(x, lb), ub), 0),
            multipliers=ca.if_else(solved, solution["lam_x"], 0),
            solved=solved,
        )

    return solve
