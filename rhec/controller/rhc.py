"""Nonlinear Receding Horizon Control, eq. (NMPC).

    min  ½ Σ_{i=1..N-1} ‖ξ_r,i - ξ_i‖²_{Q_k} + ½ ‖ξ_r,N - ξ_N‖²_{Q_N} + ½ Σ_{i=0..N-1} ‖ω_r,i -
         ω_i‖²_R
    s.t. ξ_0 = ξ̂, ξ_{i+1} = F(ξ_i, ω_i, p̂), |ω_i| ≤ ω_max

The states are condensed away; the QP is in ω_0 … ω_{N-1}. The Hessian belongs to the preparation
phase. The estimate (ξ̂, p̂) and the references enter in the feedback phase only: they move the
gradient, through the linearised dynamics of the joint state s = (ξ, p).
"""

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi import compiled
from rhec._casadi.build import casadi_function, select_inputs, with_packed_memory
from rhec._casadi.validation import Intervals, NotNegative, Positive, Solver, Weights, checked
from rhec.model import tracked_robot as model
from rhec.solver import box_lq as riccati
from rhec.solver import gauss_newton
from rhec.solver.gauss_newton import copy_checked, transition

JOINT = 6  # s = (x, y, θ, ν, μ, κ)
BEYOND = 1e9  # a plan beyond this, or not a number, is no plan


def build_phases(dt_s, horizon, qp="structured"):
    """The RHC as CasADi Functions shift, linearise, feedback and expand (each phase: see
    `gauss_newton`) and step, which is all of them.

    Memory: s (6, N+1) predicted joint states, omega (1, N) planned inputs [rad/s]. Weights: Q (3,),
    QN (3,) diagonals, R (). feedback takes s_0 (6,) = (ξ̂, p̂), xi_ref (3, N+1) of which node 0 has
    no weight, omega_ref (1, N), omega_max () [rad/s].
    """
    N, iv, dense = horizon, model.interval("parameter"), qp != "structured"
    loops = (
        ca.SX if dense or N <= 30 else compiled.loop_symbols()
    )  # a short horizon is faster in one piece
    memory = dict(s=(JOINT, N + 1), omega=(1, N))
    weights = dict(Q=(3, 1), QN=(3, 1), R=(1, 1))
    references = dict(s_0=(JOINT, 1), xi_ref=(3, N + 1), omega_ref=(1, N), omega_max=(1, 1))
    F_1, D_1, B_1 = (iv.linearised.sparsity_out(i) for i in range(3))

    def shift(s, omega):
        s, omega = gauss_newton.shift(iv, s, omega, dt_s)
        return dict(s=s, omega=omega)

    def linearise(s, omega, Q, QN, R):
        F, D, B = gauss_newton.linearise(iv, s, omega, dt_s)
        dynamics = dict(F=F, D=D, B=B)
        if not dense:
            return dynamics
        Q, QN = (
            ca.diag(ca.vertcat(each, ca.SX(3, 1))) for each in (Q, QN)
        )  # the parameters have no weight
        A = [transition(each) for each in ca.horzsplit(D, JOINT)]
        return dynamics | dict(
            H=gauss_newton.condensed_hessian(A, ca.horzsplit(B), [Q] * (N - 1) + [QN], R)
        )

    def forward(F, D, B, s, omega, s_new, omega_new):
        """s_{i+1} = F_i + A_i (s_i - s̄_i) + B_i (ω_i - ω̄_i)."""
        return dict(s_after=F + transition(D) @ (s_new - s) + B @ (omega_new - omega))

    def backward(adjoint, D, B, weight, s, ref, omega, omega_ref, R):
        """Gradient in an interval's input from the adjoint after it, which takes in the error
        there; the adjoint before it.
        """
        adjoint = adjoint + ca.vertcat(weight * (s[:3] - ref), ca.SX(3, 1))
        return dict(
            g=R * (omega - omega_ref) + ca.dot(B, adjoint), adjoint_before=transition(D).T @ adjoint
        )

    forward = casadi_function(
        "rhc_forward",
        forward,
        dict(F=F_1, D=D_1, B=B_1, s=(JOINT, 1), omega=(1, 1), s_new=(JOINT, 1), omega_new=(1, 1)),
    )
    backward = casadi_function(
        "rhc_backward",
        backward,
        dict(
            adjoint=(JOINT, 1),
            D=D_1,
            B=B_1,
            weight=(3, 1),
            s=(JOINT, 1),
            ref=(3, 1),
            omega=(1, 1),
            omega_ref=(1, 1),
            R=(1, 1),
        ),
    )

    def rollout(s, omega, F, D, B, s_0, omega_new):
        """The linearised trajectory from s_0; the gaps of multiple shooting close here."""
        nodes = [s_0]
        along = zip(
            ca.horzsplit(F),
            ca.horzsplit(D, JOINT),
            ca.horzsplit(B),
            ca.horzsplit(s),
            ca.horzsplit(omega),
            ca.horzsplit(omega_new),
        )
        for F, D, B, s, omega, omega_new in along:
            nodes.append(forward(F, D, B, s, omega, nodes[-1], omega_new))
        return nodes

    def gradient(s, omega, F, D, B, Q, QN, R, s_0, xi_ref, omega_ref, omega_max):
        """Of the cost in ω at the previous plan, started from the new estimate; with what is left
        to the bounds.
        """
        nodes, ref = rollout(s, omega, F, D, B, s_0, omega), ca.horzsplit(xi_ref)
        D, B, inputs, omega_ref = (
            ca.horzsplit(D, JOINT),
            ca.horzsplit(B),
            ca.horzsplit(omega),
            ca.horzsplit(omega_ref),
        )
        adjoint, g, weight = ca.DM.zeros(JOINT), [None] * N, QN
        for i in reversed(range(N)):
            g[i], adjoint = backward(
                adjoint, D[i], B[i], weight, nodes[i + 1], ref[i + 1], inputs[i], omega_ref[i], R
            )
            weight = Q
        return dict(g=ca.horzcat(*g), lower=-omega_max - omega, upper=omega_max - omega)

    shift = casadi_function("rhc_shift", shift, memory)
    linearise = casadi_function("rhc_linearise", linearise, memory | weights, loops)
    prepared = {name: linearise.sparsity_out(name) for name in linearise.name_out()}
    dynamics = {name: prepared[name] for name in ("F", "D", "B")}
    gradient = casadi_function(
        "rhc_gradient", gradient, memory | dynamics | weights | references, loops
    )
    if dense:
        box_qp = gauss_newton.box_qp(N, qp)
    else:
        pose = list(range(3))  # the parameters do not move: in ξ alone the stages are half as large
        box_lq = riccati.box_lq(N, D_1.sub(pose, pose)[0], B_1.sub(pose, [0])[0], loops)

    def solve(local, omega, omega_max, Q, QN, R, D, B, H=None):
        if dense:
            x, multipliers, ok = box_qp(H, local["g"].T, local["lower"].T, local["upper"].T)
            return x.T, multipliers.T, ok
        D, B = ca.horzcat(*(each[:3, :3] for each in ca.horzsplit(D, JOINT))), B[:3, :]
        active = (omega >= omega_max) - (
            omega <= -omega_max
        )  # where the previous plan was at its bounds
        return box_lq(D, B, Q, QN, R, local["g"], local["lower"], local["upper"], active)

    def feedback(**given):
        local, omega, limit = (
            gradient(**select_inputs(gradient, given)),
            given["omega"],
            given["omega_max"],
        )
        x, multipliers, ok = solve(
            local,
            **{
                name: given[name]
                for name in ("omega", "omega_max", "Q", "QN", "R", "D", "B", "H")
                if name in given
            },
        )
        plan = ca.fmin(ca.fmax(omega + x, -limit), limit)  # ω + (ω_max - ω) may round past ω_max
        return dict(omega_plan=plan, multipliers=multipliers, ok=ok, **local)

    def expand(s, omega, F, D, B, s_0, omega_plan, g, lower, upper, multipliers, ok):
        """The predicted states of the new plan, and the KKT tolerance of the linearisation point."""
        kkt = gauss_newton.kkt_tolerance(ca.dot(g, omega_plan - omega), multipliers, lower, upper)
        predicted = ca.horzcat(*rollout(s, omega, F, D, B, s_0, omega_plan))
        # a step that failed leaves the shifted plan, unless nothing can be linearised there, which
        # its last node shows: then the next begins at the estimate
        shifted = ca.if_else(ca.mmin(ca.fabs(s[:, N]) <= BEYOND), s, ca.repmat(s_0, 1, N + 1))
        return dict(s=ca.if_else(ok, predicted, shifted), omega=omega_plan, kkt=kkt)

    feedback = casadi_function(
        "rhc_feedback", feedback, prepared | memory | weights | references, ca.MX
    )
    result = {
        name: feedback.sparsity_out(name)
        for name in ("omega_plan", "g", "lower", "upper", "multipliers", "ok")
    }
    expand = casadi_function(
        "rhc_expand", expand, memory | dynamics | dict(s_0=(JOINT, 1)) | result, loops
    )

    def step(Q, QN, R, s_0, xi_ref, omega_ref, omega_max, **memory):
        """All phases of one sample."""
        given = dict(
            Q=Q, QN=QN, R=R, s_0=s_0, xi_ref=xi_ref, omega_ref=omega_ref, omega_max=omega_max
        )
        memory = shift(**memory)
        prepared = linearise(**memory, **select_inputs(linearise, given))
        result = feedback(**prepared, **memory, **given)
        return expand(
            **memory, **select_inputs(expand, prepared | given), **select_inputs(expand, result)
        ) | dict(command=result["omega_plan"][0], ok=result["ok"])

    step = with_packed_memory("rhc_step", step, memory, weights | references)
    return dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand, step=step)


def init(pose, p, horizon):
    """Memory before the first sample: the robot at pose (3,) with parameters p (3,) = (ν, μ, κ),
    nothing planned.
    """
    return dict(s=np.tile([*pose, *p], (horizon + 1, 1)).T, omega=np.zeros((1, horizon)))


class RHC:
    """The controller for a loop of one's own: `prepare()` while there is time, `feedback(…)` when
    the estimate is there.

    q: weights Q_k of (x, y, θ); r: R; qn_factor: Q_N = qn_factor · Q_k; omega_max [rad/s]; dt [s];
    horizon: intervals; qp: see Scenario.
    """

    @checked
    def __init__(
        self,
        *,
        q: Weights = paper.Q3,
        r: Positive = paper.R,
        qn_factor: NotNegative = paper.QN_FACTOR,
        omega_max: Positive = paper.OMEGA_MAX_RADPS,
        dt: Positive = paper.DT_S,
        horizon: Intervals = paper.HORIZON,
        qp: Solver = "structured",
    ):
        self.horizon = horizon
        q = np.array(q)
        self.iteration = gauss_newton.RealTimeIteration(
            compiled.load(build_phases, dt, horizon, qp),
            ("s", "omega"),
            ("s", "omega"),
            Q=q,
            QN=qn_factor * q,
            R=r,
            omega_max=omega_max,
        )
        arrays = self.iteration.arrays
        xi_ref = arrays["xi_ref"].reshape((3, horizon + 1), order="F")  # a view, in CasADi's order
        self._inputs = arrays["s_0"][:3], arrays["s_0"][3:], xi_ref, arrays["omega_ref"]

    def prepare(self):
        """Shift, integrate, linearise, condense (paper: preparation part)."""
        self.iteration.prepare()

    def feedback(self, pose, p, xi_ref, omega_ref):
        """The yaw rate [rad/s] to command: pose (3,), p (3,) = (ν, μ, κ), xi_ref (3, N+1) and
        omega_ref (N,) references (node 0 of xi_ref is now).
        """
        self._given(pose, p, xi_ref, omega_ref)
        self.iteration.feedback()
        return self.iteration.arrays["omega_plan"][0].item()

    def solve(self, pose, p, xi_ref, omega_ref, iterations=20):
        """The same, iterated to convergence on the nonlinear problem."""
        self._given(pose, p, xi_ref, omega_ref)
        self.iteration.solve(iterations)
        return self.iteration.arrays["omega_plan"][0].item()

    def _given(self, pose, p, xi_ref, omega_ref):
        to_pose, to_p, to_xi_ref, to_omega_ref = self._inputs
        copy_checked("pose", pose, to_pose)
        copy_checked("p", p, to_p)
        copy_checked("xi_ref", xi_ref, to_xi_ref)
        copy_checked("omega_ref", omega_ref, to_omega_ref)
        if not self.iteration.started:
            self.iteration.start(init(pose, p, self.horizon))

    @property
    def ok(self):
        """Whether the last step was solved; if not, its answer is the shifted previous solution's."""
        return self.iteration.arrays["ok"].item() == 1

    @property
    def kkt(self):
        """KKT tolerance of the linearisation point of the last feedback."""
        self.iteration.expand()
        return self.iteration.arrays["kkt"].item()

    @property
    def omega_plan(self):
        """Planned yaw rates (N,) [rad/s]."""
        return self.iteration.arrays["omega_plan"].copy()

    @property
    def xi_plan(self):
        """Predicted poses (3, N+1)."""
        self.iteration.expand()
        return self.iteration.previous["s"].reshape((JOINT, -1), order="F")[:3].copy()
