"""The RHC's QP condensed to its commands, and solved by a library, as in the paper (qpOASES)."""

from dataclasses import dataclass

import casadi as ca

import rhec
from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.packing import pack_array
from rhec.core.controller import rhc
from rhec.core.model.limits import MAX_QP_ENTRY, is_plausible
from rhec.simulation.closed_loop import first_guess
from rhec.tracked_robot.path import path_of
from rhec.tracked_robot.rhc import horizon_of

# DAQP gets tighter tolerances than its usual ones, so that all solvers agree to 1e-8.
_OPTIONS = {
    "daqp": {"daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11}},
    "qpoases": {"printLevel": "none", "hessian_type": "posdef"},
}


def controller(scenario, solver):
    """The RHC of a Scenario with its QP condensed, as a rhec.Controller.

    Args:
        scenario: The Scenario that it is for; its own controller does not count.
        solver: "daqp" or "qpoases".
    """
    horizon = horizon_of(scenario.prediction_horizon)._replace(qp=Condensed(solver))
    guess = first_guess(scenario, path_of(scenario))
    memory = pack_array(rhc.init(horizon, guess[:3], guess[3:]))
    return rhec.Controller(rhc.build_phases(horizon)["step"], memory)


@dataclass(frozen=True)
class Condensed:
    """The option `qp` of a Horizon, or of `rhec.RHC`; `solver` is "daqp" or "qpoases"."""

    solver: str

    @property
    def key(self):
        """What names compiled code: this module makes it, too."""
        return self.solver, compiled.source_digest(__name__)

    def build(self, horizon):
        """Build the CondensedQP of a Horizon."""
        return CondensedQP(horizon, self.solver)


class CondensedQP:
    """The QP in the commanded inputs with a dense Hessian, which the preparation phase condenses.

    Args:
        horizon: The controller's Horizon.
        solver: "daqp" or "qpoases".
    """

    def __init__(self, horizon, solver):
        self.horizon = horizon
        self._solve = box_qp_by_library(horizon.N * len(horizon.command), solver)

    def prepare(self, D, B, Q, QN, R):
        """Condense the linearised dynamics and the weights to the Hessian H."""
        horizon = self.horizon
        # The parameters have no weight.
        unweighted = ca.SX(horizon.n_s - horizon.n_x, 1)
        Q, QN = (ca.diag(ca.vertcat(weight, unweighted)) for weight in (Q, QN))
        A = [horizon.interval.A_0 + part for part in ca.horzsplit(D, horizon.n_s)]
        B = [part[:, list(horizon.command)] for part in ca.horzsplit(B, horizon.n_u)]
        return dict(H=_condensed_hessian(A, B, [Q] * (horizon.N - 1) + [QN], ca.diag(R)))

    def solve(self, step, inputs):
        """Solve min ½ Δu'HΔu + g'Δu, least ≤ Δu ≤ most, with H from `prepare`.

        Args and returns are those of `rhec.core.controller.plain.StagewiseQP.solve`.
        """
        bounds = dict(lb=step["least"].T, ub=step["most"].T)
        solution = self._solve(H=inputs["H"], g=step["g"].T, **bounds)
        return solution["x"].T, solution["multipliers"].T, solution["solved"]


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
