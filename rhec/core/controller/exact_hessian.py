"""The QP of an RHC with the exact Hessian of the Lagrangian, instead of that of Gauss and Newton.

The Gauss-Newton matrix of a stage is diag(Q, R). It neglects the curvature of the dynamics, which
counts where the plan stays far from its references, as in a swing-up:

    W_i = diag(Q_i, R) + Σ_k λ_{i+1,k} ∂²F_k / ∂(x, u)²        at the linearisation point (x_i, u_i)

λ_{i+1} is the gradient of the cost-to-go in x_{i+1}, by the backward sweep that also gives the
gradient in the commands. Condensed to the commands, the W_i are the Hessian of the plan's cost.

This Hessian need not be positive. The QP is then solved with the Gauss-Newton matrix, as a whole:
where the recursion finds a pivot that is not positive, where the search for the active set does
not end, and where the cost would not fall along the step. To shift the eigenvalues of the W_i
instead would also change a Hessian that is positive in the commands alone, as it is at a solution,
and so take the quadratic convergence away for which one asks for the exact one.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.controller.horizon import active_before, commanded_stages, plain_stages
from rhec.core.solver.coupled_lq import coupled_lq
from rhec.core.solver.gauss_newton import symmetric


class ExactQP:
    """The QP in the commanded inputs by stages with exact Hessians, with a safe QP beside it.

    Args:
        horizon: The controller's Horizon.
        safe: A QP that has always a solution, such as `rhec.core.controller.rhc.StagewiseQP`.
    """

    def __init__(self, horizon, safe):
        self._exact = _build_exact(horizon)
        self._safe = _build_safe(horizon, safe)

    def prepare(self, D, B, Q, QN, R):
        """Return no outputs: the Hessian needs the adjoints, and these the newest sample."""
        return {}

    def solve(self, step, inputs):
        """Solve min ½ Δu'HΔu + g'Δu, least ≤ Δu ≤ most, where the stages imply H.

        Args and returns are those of `rhec.core.controller.rhc.StagewiseQP.solve`; `step` also
        holds the `adjoints` λ_1 … λ_N, side by side.
        """
        known = inputs | step
        exact = self._exact(**select_inputs(self._exact, known))
        known |= {f"{name}_exact": value for name, value in exact.items()}
        # Only one of the two branches runs in compiled code.
        either = ca.Function.if_else("rhc_exact_or_not", _build_kept(self._safe), self._safe)
        return either(exact["ok"], *(known[name] for name in self._safe.name_in()))


def build_stage_hessian(horizon):
    """The Function (s, u, adjoint) -> Σ_k adjoint_k ∂²F_k / ∂(x, u)² of an interval.

    It differentiates adjoint' ∂F/∂(x, u), so that an implicit rule, which has derivatives of its
    own, is differentiated once more and not twice.
    """
    n_x = horizon.n_x
    s_i = (horizon.n_s, 1)

    @casadi_function("rhc_stage_hessian")
    def stage_hessian(s: s_i, u: (horizon.n_u, 1), adjoint: s_i):
        command = list(horizon.command)
        _, D, B = horizon.interval.linearised(s, u, horizon.dt_s)
        by_s = (horizon.interval.A_0 + D).T @ adjoint
        slope = ca.vertcat(by_s[:n_x], (B.T @ adjoint)[command])
        W = ca.jacobian(slope, ca.vertcat(s[:n_x], u[command]))
        return dict(W=ca.densify(symmetric(W)))

    return stage_hessian


def _shapes(horizon):
    """Shapes of what a QP of the feedback phase takes, by name."""
    row = (1, horizon.N * len(horizon.command))
    shapes = {name: horizon.dynamics[name] for name in "DB"}
    shapes |= horizon.memory | horizon.weights
    shapes |= {name: horizon.references[name] for name in ("lower", "upper")}
    return shapes | dict.fromkeys(("g", "least", "most"), row)


def _build_exact(horizon):
    """The QP with exact Hessians; `ok` where it has a solution towards which the cost falls."""
    N = horizon.N
    n_x = horizon.n_x
    n_z = n_x + len(horizon.command)
    stage_hessian = build_stage_hessian(horizon)

    @casadi_function("rhc_stage_matrix", W=(n_z, n_z), Q=(n_x, 1), R=horizon.weights["R"])
    def stage_matrix(W, Q, R):
        return dict(M=W + ca.diag(ca.vertcat(Q, R)))

    shapes = _shapes(horizon) | dict(adjoints=(horizon.n_s, N))
    qp = coupled_lq(N, *plain_stages(horizon), horizon.loops)

    @casadi_function("rhc_exact_qp", ca.MX, **shapes)
    def exact(adjoints, **given):
        W = stage_hessian.map(N)(given["s"][:, :N], given["u"], adjoints)
        W = stage_matrix.map(N)(W, given["Q"], given["R"])
        rows = dict(g=given["g"], lower=given["least"], upper=given["most"])
        stages = commanded_stages(horizon, given) | dict(W=W, QN=given["QN"], scale=given["R"])
        solution = qp(**stages, **rows, active=active_before(horizon, given))
        falls = ca.dot(given["g"], solution["x"]) <= 0
        ok = solution["ok"] * falls
        return dict(change=solution["x"], multipliers=solution["multipliers"], ok=ok)

    return exact


def _build_safe(horizon, qp):
    """The safe QP as a Function, which also takes the results of the exact one."""
    row = (1, horizon.N * len(horizon.command))
    tried = dict(change_exact=row, multipliers_exact=row, ok_exact=(1, 1))

    @casadi_function("rhc_safe_qp", ca.MX, **_shapes(horizon), **tried)
    def safe(**given):
        change, multipliers, ok = qp.solve(given, given)
        return dict(change=change, multipliers=multipliers, ok=ok)

    return safe


def _build_kept(safe):
    """The Function with the inputs of `safe` that keeps the results of the exact QP."""
    shapes = {name: safe.sparsity_in(name) for name in safe.name_in()}

    @casadi_function("rhc_kept_qp", ca.MX, **shapes)
    def kept(**given):
        return {name: given[f"{name}_exact"] for name in safe.name_out()}

    return kept
