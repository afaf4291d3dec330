"""What RHE and RHC share: one generalised Gauss-Newton iteration on a multiple-shooting problem
(paper, Sec. Solution Methods).

Both problems are least squares over trajectories s_0 … s_N, v_0 … v_{N-1} of the same interval s⁺ =
F(s, v). Linearised at the previous solution (s̄, v̄) the dynamics are s_{i+1} = F_i + A_i (s_i -
s̄_i) + B_i (v_i - v̄_i); what is unbounded is then eliminated, and what is left is a QP with bounds
only: in (μ, κ) for the RHE, in the inputs for the RHC (condensed here, or by stages in `riccati`).

Each sample has four phases, each a Function of its own in `rhe` and `rhc`:
    shift      the horizon moves on by one sample, the previous solution with it (warm start)
    linearise  integrate, differentiate, condense
    feedback   what is new (a measurement; an estimate and references) and the QP: the answer
    expand     the rest of the solution, for the next linearisation, and the KKT tolerance
The paper's preparation is expand, shift and linearise; only feedback lies between a measurement and
the command. Iterating linearise, feedback and expand without shift converges to the solution of the
nonlinear problem.
"""

import casadi as ca
import numpy as np

from rhec._casadi import compiled
from rhec._casadi.validation import shown

# DAQP is asked for more than its usual tolerance, so that all solvers give the same answer to 1e-8.
QP_SOLVERS = {
    "daqp": {"daqp": {"primal_tol": 1e-11, "dual_tol": 1e-11}},
    "qpoases": {"printLevel": "none", "hessian_type": "posdef"},
}
LARGEST = 1e20  # entry of a QP that a solver is given


def linearise(interval, s, v, dt_s):
    """Integrate every interval from its node and differentiate: s (n_s, N+1), v (n_v, N) -> F (n_s,
    N), D (n_s, n_s N), B (n_s, n_v N).
    """
    N = v.shape[1]
    return interval.linearised.map(N)(s[:, :N], v, ca.repmat(ca.DM(dt_s), 1, N))


def transition(D):
    """A = 1 + D: the unit diagonal, written here, costs nothing where a passed number would be
    multiplied.
    """
    return ca.SX.eye(D.size1()) + D


def shift(interval, s, v, dt_s):
    """Warm start (paper: the initial value "takes on the value of the previous one intelligently"):
    move the trajectory one interval on, repeat its last input, and integrate one node more.
    """
    v = ca.horzcat(v[:, 1:], v[:, -1])
    return ca.horzcat(s[:, 1:], interval.step(s[:, -1], v[:, -1], dt_s)), v


def condensed_hessian(A, B, Q, R):
    """Hessian of ½ Σ_{i=1..N} s_i' Q_i s_i + ½ Σ_{i=0..N-1} v_i' R v_i in v alone, s_0 = 0, s_{i+1}
    = A_i s_i + B_i v_i.

    Needs O(N²) operations: the response to each single input forwards, its adjoint backwards
    (Andersson, "A General-Purpose Software Framework for Dynamic Optimization", 2013). Q is indexed
    0 … N-1 for nodes 1 … N. Only for scalar v.
    """
    N = len(A)
    H = [[None] * N for _ in range(N)]
    for j in range(N):
        response = [B[j]]  # ∂s_{j+1}/∂v_j … ∂s_N/∂v_j
        for i in range(j + 1, N):
            response.append(A[i] @ response[-1])
        adjoint = Q[N - 1] @ response[-1]
        for i in range(N - 1, j, -1):
            H[i][j] = H[j][i] = B[i].T @ adjoint
            adjoint = Q[i - 1] @ response[i - 1 - j] + A[i].T @ adjoint
        H[j][j] = B[j].T @ adjoint + R
    return ca.vertcat(*(ca.horzcat(*row) for row in H))


def box_qp_2():
    """`box_qp` of two variables in closed form: the optimum is the free one, or lies on one of the
    four edges.
    """
    H, g, lb, ub = ca.SX.sym("H", 2, 2), ca.SX.sym("g", 2), ca.SX.sym("lb", 2), ca.SX.sym("ub", 2)
    best = -ca.inv_minor(H) @ g
    inside = ca.mmin(ca.vertcat(best >= lb, best <= ub))
    least = ca.if_else(inside, -ca.inf, ca.inf)
    for fixed in (0, 1):
        other = 1 - fixed
        for bound in (lb, ub):
            along = -(g[other] + H[other, fixed] * bound[fixed]) / H[other, other]
            along = ca.fmin(ca.fmax(along, lb[other]), ub[other])
            x = ca.vertcat(bound[0], along) if fixed == 0 else ca.vertcat(along, bound[1])
            cost = ca.bilin(H, x, x) / 2 + ca.dot(g, x)
            best, least = ca.if_else(cost < least, x, best), ca.fmin(cost, least)
    ok = ca.mmin(ca.vertcat(best >= lb, best <= ub))  # also 0 where x is not a number
    return ca.Function("box_qp_2", [H, g, lb, ub], [ca.if_else(ok, best, 0), -(H @ best + g), ok])


def box_qp(n, solver):
    """min ½ x'Hx + g'x, lb ≤ x ≤ ub, as a Function (H, g, lb, ub) -> (x, λ, ok); λ > 0 at an upper,
    λ < 0 at a lower bound.

    CasADi's solvers report a failure and go on; then ok is 0 and x and λ are 0: no step. What is
    not a number, or absurd, never reaches the solver: one that starts from its last solution might
    keep it.
    """
    H, g, lb, ub = ca.MX.sym("H", n, n), ca.MX.sym("g", n), ca.MX.sym("lb", n), ca.MX.sym("ub", n)
    options = {"error_on_fail": False, **QP_SOLVERS[solver]}
    sane = ca.mmin(ca.fabs(ca.veccat(H, g, lb, ub)) <= LARGEST)
    given = [
        ca.if_else(sane, value, default)
        for value, default in ((H, ca.DM.eye(n)), (g, 0), (lb, 0), (ub, 0))
    ]
    solution = ca.conic("qp", solver, {"h": H.sparsity()}, options)(
        **dict(zip(("h", "g", "lbx", "ubx"), given))
    )
    x, multipliers = solution["x"], solution["lam_x"]
    ok = sane * ca.mmin(
        ca.vertcat(x >= lb - 1e-6, x <= ub + 1e-6)
    )  # also 0 where x is not a number
    # an active-set solver may leave the box by its tolerance; the bounds are hard
    return ca.Function(
        "box_qp",
        [H, g, lb, ub],
        [ca.if_else(ok, ca.fmin(ca.fmax(x, lb), ub), 0), ca.if_else(ok, multipliers, 0), ok],
    )


def kkt_tolerance(gradient_along_step, multipliers, lower, upper):
    """KKT tolerance as ACADO's generated code defines it: |∇J·Δw| + Σ |λ_i · (distance from the
    linearisation point to the bound)|.
    """
    bound = ca.if_else(multipliers > 0, upper, lower)
    return ca.fabs(gradient_along_step) + ca.sum1(ca.vec(ca.fabs(multipliers * bound)))


def copy_checked(name, value, array):
    """Copy an argument into its array, or say in one sentence why it does not fit."""
    shape = getattr(value, "shape", None)
    try:
        if (
            shape is None
            and isinstance(value, tuple)
            and len(value) == len(array)
            and array.ndim == 1
        ):
            for i, number in enumerate(value):  # a few numbers: faster than making an array of them
                array[i] = number
            return
        shape = np.shape(value) if shape is None else shape
        if shape == array.shape:
            array[...] = value
            return
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it should be made of numbers") from None
    raise ValueError(f"{name} had shape {shape}; it should have {array.shape}")


class RealTimeIteration:
    """The four phases on shared NumPy arrays, compiled: what the RHE and RHC objects are made of.

    Arrays of the same name are one array. The memory exists twice, because a Function must not
    write what it still reads: `expand` leaves it in `previous`, `shift` takes it from there to
    `current`, where `linearise` and `feedback` read it.
    """

    def __init__(self, functions, memory, unknowns, **constants):
        self.unknowns = unknowns  # of the memory, what an iteration improves
        self.phases = {
            name: compiled.BufferedFunction(functions[name])
            for name in ("shift", "linearise", "feedback", "expand")
        }
        self.previous = {
            name: np.zeros(self.phases["shift"].arguments[name].shape) for name in memory
        }
        self.current, self.arrays = (
            {name: array.copy() for name, array in self.previous.items()},
            {},
        )
        for phase, call in self.phases.items():
            for name, array in call.arguments.items():
                home = (
                    self.arrays
                    if name not in memory
                    else self.previous
                    if phase == "shift"
                    else self.current
                )
                call.read_from(name, home.setdefault(name, array))
            for name, array in call.results.items():
                home = (
                    self.arrays
                    if name not in memory
                    else self.previous
                    if phase == "expand"
                    else self.current
                )
                call.write_to(name, home.setdefault(name, array))
        self.set(self.arrays, constants)
        self.started = self.prepared = self.expanded = False

    @staticmethod
    def set(arrays, values):
        for name, value in values.items():
            arrays[name][:] = np.ravel(value, order="F")

    def start(self, memory):
        """Begin at this memory, already in place for the sample that comes."""
        self.set(self.current, memory)
        self.phases["linearise"].call()
        self.started = self.prepared = True

    def prepare(self):
        """The paper's preparation: all that can be done before the next sample arrives. Before the
        first there is nothing to do.
        """
        if self.started and not self.prepared:
            self.expand()
            self.phases["shift"].call()
            self.phases["linearise"].call()
            self.prepared = True

    def feedback(self):
        if not self.prepared:
            raise RuntimeError("prepare() must be called before each feedback()")
        self.phases["feedback"].call()
        self.prepared = self.expanded = False

    def expand(self):
        """Once a sample: the rest of the solution."""
        if not self.expanded:
            self.phases["expand"].call()
            self.expanded = True

    def solve(self, iterations):
        """The same problem again and again: Gauss-Newton to convergence."""
        for _ in range(iterations):
            self.phases["linearise"].call()
            self.phases["feedback"].call()
            self.phases["expand"].call()
            self.set(self.current, {name: self.previous[name] for name in self.unknowns})
        self.prepared, self.expanded = False, True
