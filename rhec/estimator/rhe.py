"""Nonlinear Receding Horizon Estimation, eq. (mhe), with the arrival cost of Sec. Arrival Cost.

    min  ½ ‖(ξ̂, p̂) - s_0‖²_{H_N} + ½ Σ_{i=0..N} ‖z_i - h(s_i, v_{i-1})‖²_{H_k}     s.t. s_{i+1} =
         F(s_i, v_i), 0 ≤ μ, κ ≤ 1

N intervals have N+1 nodes; node N is now. z_i = (x, y, ν, ω)_i arrives at node i: its position
belongs to the node, its encoder readings ν, ω are means over the interval that *ends* there, so ω_i
measures v_{i-1}. The newest measurement enters in the feedback phase only.

The Gauss-Newton subproblem is a linear-Gaussian smoothing problem with bounds on two constants.
Eliminating all that is unbounded from the oldest node to the newest is exactly a Kalman filter over
the window (information needs H_N = P⁻¹ only, never a dense Hessian), which leaves a QP in (μ, κ);
its multiplier then runs backwards through the window and yields every other unknown
(Bryson-Frazier). Each costs O(N).
"""

import functools
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi import compiled
from rhec._casadi.build import casadi_function, packed_size, select_inputs, with_packed_memory
from rhec._casadi.validation import (
    ArrivalMean,
    Flag,
    Intervals,
    NotNegative,
    Positive,
    Reading,
    Real,
    Solver,
    SpeedModel,
    checked,
)
from rhec.estimator import kalman
from rhec.estimator.kalman import Z_MAX, is_valid_measurement, symmetric
from rhec.extensions import gating
from rhec.model import tracked_robot as model
from rhec.solver import gauss_newton
from rhec.solver.gauss_newton import copy_checked, transition

BEYOND = 1e12  # an estimate beyond this, or not a number, is no estimate
SIGMA_HELD = (1.0, 1.0)  # ν [m/s], ω [rad/s]: how far a missing input may be from the one before
SIDE_MPS = 1e-3  # the side slip speed of a robot that does not turn

# Process noise W as standard deviations of (x, y, θ, ν, μ, κ) per sample: to the letter (R2), and
# as `rhec.studies.calibration` found it on training seeds.
SIGMA_W = {"printed": paper.SIGMA_W_RHE, "calibrated": (0.001, 0.001, 0.001, 0.001, 0.0034, 0.001)}
# Where noise is the tracks' slip it grows with the motion: of (μ, κ) with the distance d that the
# tracks ran, like √d; of the motion itself in proportion, ν and ω by shares of themselves, the side
# slip speed by a share of bω; and bumps turn the robot, like √d.
SIGMA_W_SLIPPING, SHARES, SIGMA_BUMPS = (
    (0.01, 0.015),
    (0.1, 0.25, 0.08),
    0.02,
)  # [1/√m], [-], [rad/√m]
# Before the first sample, standard deviations of (x, y, θ, ν, μ, κ, l_f, l_l): the paper's W, and
# an antenna whose place is known to the millimetre.
SIGMA_START = (*paper.SIGMA_W_RHE, 1e-3, 1e-3)


class Window(NamedTuple):
    """What decides the shape of the Functions: intervals N of dt_s, their model, and how readings,
    arrival cost and QP are treated.
    """

    interval: model.Interval
    N: int
    dt_s: float
    arrival_mean: str
    qp: str
    robust: bool

    @property
    def problem(self):
        """s trajectory, v inputs, z readings, age intervals driven, m and P arrival cost."""
        n_s, n_v = self.interval.n_s, self.interval.n_v
        return dict(
            s=(n_s, self.N + 1),
            v=(n_v, self.N),
            z=(4, self.N + 1),
            age=(1, 1),
            m=(n_s, 1),
            P=(n_s, n_s),
        )

    @property
    def memory(self):
        """The problem; and seen: what `screening` remembers."""
        return (
            self.problem | dict(seen=(packed_size(gating.memory(self.dt_s)), 1))
            if self.robust
            else self.problem
        )

    @property
    def weights(self):
        """Variances: V of the readings, and where tracks slip of shares and bumps, with b; W of the
        process noise.
        """
        return dict(V=(9 if self.interval.slips else 4, 1)), dict(W=(self.interval.n_s, 1))

    @property
    def linearised(self):
        """Sparsities of one interval's end F, D = A - 1 and B."""
        return {name: self.interval.linearised.sparsity_out(i) for i, name in enumerate("FDB")}


# The model's noise


def abs_track_speeds(nu, omega, b):
    """Speeds (left, right) [m/s] of the tracks of a robot with track width b [m]."""
    return ca.fabs(nu - b / 2 * omega), ca.fabs(nu + b / 2 * omega)


def measured_inputs(window, z, v, V):
    """What the reading z (4,) says of the inputs before it, and how surely: (v_m, R_v). A missing
    one is the last one held.
    """
    mean, variance = [], []
    for place, row in window.interval.measured_inputs:
        mean.append(ca.if_else(is_valid_measurement(z, row), z[row], v[place]))
        variance.append(ca.if_else(is_valid_measurement(z, row), V[row], SIGMA_HELD[row - 2] ** 2))
    if window.interval.slips:
        nu, omega = mean
        share2_nu, share2_omega, share2_side, sigma2_bumps, b = ca.vertsplit(V[4:])
        variance[0] += share2_nu * nu**2
        variance[1] += share2_omega * omega**2 + sigma2_bumps * ca.fabs(nu) / window.dt_s
        mean.append(0)
        variance.append(share2_side * (b * omega) ** 2 + SIDE_MPS**2)
    return ca.vertcat(*mean), ca.diag(ca.vertcat(*variance))


def process_noise(window, v, W, V):
    """W of one interval: per sample, or where tracks slip per metre that they ran."""
    if not window.interval.slips:
        return ca.diag(W)
    left, right = abs_track_speeds(v[0], v[1], V[8])
    return ca.diag(W * (left + right) / 2 * window.dt_s)


def with_input(window, B, m, P, v, z, V):
    """A prediction (m, P) made with the input v, corrected by what the reading z says of that
    input.
    """
    v_m, R_v = measured_inputs(window, z, v, V)
    return m + B @ (v_m - v), P + B @ R_v @ B.T


def is_plausible(x):
    """1 if every entry is a number of reasonable size."""
    return ca.mmin(ca.fabs(x) <= BEYOND)


# shift: the window moves on by one sample, and its oldest node becomes the arrival cost


def arrival(window, s, v, m, P, z_0, z_1, V, W):
    """Smoothed-EKF update of the arrival cost (paper, Sec. Arrival Cost): the window's oldest node
    leaves.

    The prior at the oldest node takes in that node's measurement z_0, passes through the interval
    linearised at the previous RHE solution (s, v), and is down-weighted by W (n_s,), so that H_N =
    P⁻¹ never exceeds W⁻¹. The mean comes from the previous solution, as the paper says
    (`arrival_mean="smoothed"`), or from the filter itself (`"filtered"`): reading R7.
    """
    F, D, B = window.interval.linearised(s[:, 0], v[:, 0], window.dt_s)
    A = transition(D)
    m, P_updated, _, _, _ = kalman.update(m, P, z_0, V, window.interval.measured_states)
    v_m, R_v = measured_inputs(window, z_1, v[:, 0], V)
    noise = process_noise(window, v_m, W, V)
    P_next = symmetric(A @ P_updated @ A.T + B @ R_v @ B.T) + noise
    m_next = F + A @ (m - s[:, 0]) + B @ (v_m - v[:, 0])
    # where readings were so wild that no covariance comes out, the old one grows instead
    good = is_plausible(P_next) * ca.mmin(ca.diag(P_next) > 0)
    smoothed = window.arrival_mean == "smoothed"
    return s[:, 1] if smoothed else ca.if_else(is_plausible(m_next), m_next, s[:, 1]), ca.if_else(
        good, P_next, P + noise
    )


def shift(window):
    iv, N = window.interval, window.N

    def body(s, v, z, age, m, P, V, W, **seen):
        m_next, P_next = arrival(window, s, v, m, P, z[:, 0], z[:, 1], V, W)
        s, v = gauss_newton.shift(iv, s, v, window.dt_s * (age >= 0))
        return (
            dict(
                s=s,
                v=v,
                z=ca.horzcat(z[:, 1:], ca.SX.nan(4)),
                age=ca.fmin(age + 1, N),
                m=ca.if_else(age >= N, m_next, m),
                P=ca.if_else(age >= N, P_next, P),
            )
            | seen
        )

    V, W = window.weights
    return casadi_function("rhe_shift", body, window.memory | V | W)


# linearise: from the oldest node to the newest, whose measurement is yet to come


def linearise(window, loops):
    iv, N, n_s, n_v = window.interval, window.N, window.interval.n_s, window.interval.n_v
    V, _ = window.weights

    def filtered(B, v_before, m, P, z, s, v, dt_s, V):
        """One node: the input before it, its measurement, then the interval after it, integrated
        and differentiated at (s, v).
        """
        m, P, K, e, _ = kalman.update(
            *with_input(window, B, m, P, v_before, z, V), z, V, iv.measured_states
        )
        F, D, B = iv.linearised(s, v, dt_s)
        A = transition(D)
        return dict(F=F, D=D, B=B, K=K, e=e, m=F + A @ (m - s), P=symmetric(A @ P @ A.T))

    filtered = casadi_function(
        "rhe_filtered",
        filtered,
        dict(
            B=window.linearised["B"],
            v_before=(n_v, 1),
            m=(n_s, 1),
            P=(n_s, n_s),
            z=(4, 1),
            s=(n_s, 1),
            v=(n_v, 1),
            dt_s=(1, 1),
        )
        | V,
    )

    def body(s, v, z, age, m, P, V):
        s, v, z, nodes = ca.horzsplit(s), ca.horzsplit(v), ca.horzsplit(z), []
        B, v_before = (
            ca.DM(window.linearised["B"], 0),
            ca.DM.zeros(n_v),
        )  # no input acts before the oldest node
        for i in range(N):
            nodes.append(
                filtered(
                    B=B,
                    v_before=v_before,
                    m=m,
                    P=P,
                    z=z[i],
                    s=s[i],
                    v=v[i],
                    dt_s=window.dt_s * (age >= N - i),
                    V=V,
                )
            )
            B, v_before, m, P = nodes[-1]["B"], v[i], nodes[-1]["m"], nodes[-1]["P"]
        along = {
            name: ca.horzcat(*(node[name] for node in nodes)) for name in ("F", "D", "B", "K", "e")
        }
        return along | dict(B_N=B, v_N=v_before, m_N=m, P_N=P, s_N=s[N])

    return casadi_function("rhe_linearise", body, window.problem | V, loops)


# feedback: the newest measurement, and the QP that is left


def feedback(window, calls):
    q, n_s, n_v = list(window.interval.traction), window.interval.n_s, window.interval.n_v
    speed_place = 3 if 3 in window.interval.states else None  # of ν in s, if it is there
    V, _ = window.weights

    def newest(B_N, v_N, m_N, P_N, z_N, V):
        """min ½ (q - q̂)' H (q - q̂), 0 ≤ q = (μ, κ) ≤ 1, where H is the inverse covariance of (μ,
        κ) alone.
        """
        m, P, K, e, deviance = kalman.update(
            *with_input(window, B_N, m_N, P_N, v_N, z_N, V), z_N, V, window.interval.measured_states
        )
        H = ca.inv_minor(P[q, q])
        nu = m[speed_place] if speed_place else measured_inputs(window, z_N, v_N, V)[0][0]
        return dict(H=H, g=-H @ m[q], m=m, covariance=P, nu=nu, K_N=K, e_N=e, deviance=deviance)

    def bounded(H, m, covariance, nu, traction, solved, s_N):
        """The newest estimate (x, y, θ, ν, μ, κ) given (μ, κ), and the multipliers of its bounds;
        what was predicted where nothing sane comes out.
        """
        multipliers = H @ (m[q] - traction)
        corrected = m - covariance[:, q] @ multipliers
        ok = solved * is_plausible(ca.vertcat(corrected, ca.vec(covariance), multipliers))
        newest = ca.if_else(ok, corrected, s_N)
        traction = ca.if_else(ok, traction, ca.fmin(ca.fmax(s_N[q], 0), 1))
        nu = newest[speed_place] if speed_place else nu
        return dict(
            estimate=ca.vertcat(newest[:3], nu, traction),
            multipliers=multipliers,
            covariance=ca.if_else(ok, covariance, BEYOND * ca.SX.eye(n_s)),
            ok=ok,
        )

    prediction = dict(B_N=window.linearised["B"], v_N=(n_v, 1), m_N=(n_s, 1), P_N=(n_s, n_s))
    newest = casadi_function("rhe_newest", newest, prediction | dict(z_N=(4, 1)) | V)
    bounded = casadi_function(
        "rhe_bounded",
        bounded,
        dict(
            H=(2, 2),
            m=(n_s, 1),
            covariance=(n_s, n_s),
            nu=(1, 1),
            traction=(2, 1),
            solved=(1, 1),
            s_N=(n_s, 1),
        ),
    )
    solve = (
        gauss_newton.box_qp_2() if window.qp == "structured" else gauss_newton.box_qp(2, window.qp)
    )

    def answered(s_N, **given):
        p = newest(**given)
        traction, _, solved = solve(p["H"], p["g"], ca.DM.zeros(2), ca.DM.ones(2))
        return bounded(**select_inputs(bounded, p), traction=traction, solved=solved, s_N=s_N) | {
            name: p[name] for name in ("K_N", "e_N", "deviance")
        }

    given = dict(s_N=(n_s, 1)) | prediction | dict(z_N=(4, 1)) | V
    if not window.robust:
        return casadi_function("rhe_feedback", answered, given, calls)

    def screened(B_N, v_N, m_N, P_N, z_N, V, age, seen):
        return gating.gate(
            z_N,
            seen,
            lambda z: with_input(window, B_N, m_N, P_N, v_N, z, V),
            V,
            q[1],
            age < 1,
            speed_place is not None,
            window.dt_s,
        )

    remembered = {name: window.memory[name] for name in ("age", "seen")}
    screened = casadi_function(
        "rhe_screened", screened, prediction | dict(z_N=(4, 1)) | V | remembered
    )

    def body(**given):
        believed = screened(**select_inputs(screened, given))
        answer = answered(
            **{name: given[name] for name in ("s_N", *prediction, "V")}, z_N=believed["z_used"]
        )
        return (
            answer
            | {name: believed[name] for name in ("z_used", "again", "pose")}
            | dict(seen_after=believed["seen"])
        )

    return casadi_function("rhe_feedback", body, given | remembered, calls)


# expand: the multipliers run backwards through the window, the solution forwards


def expand(window, linearise, feedback, loops):
    iv, N, n_s, n_v, rows = (
        window.interval,
        window.N,
        window.interval.n_s,
        window.interval.n_v,
        len(window.interval.measured_states),
    )
    q, linearised, (V, _) = list(iv.traction), window.linearised, window.weights

    def unmeasured(adjoint, K, e):
        """The adjoint before a node's measurement, from the one after it."""
        adjoint = ca.SX(adjoint)
        for row in reversed(range(rows)):
            place, _ = iv.measured_states[row]
            adjoint[place] -= K[:, row].T @ adjoint + e[row]
        return adjoint

    def backward(adjoint, D, B, K, e, z, v, V):
        """One node and the interval before it: the interval's new input, and the adjoint at its
        beginning.
        """
        adjoint = unmeasured(adjoint, K, e)
        v_m, R_v = measured_inputs(window, z, v, V)
        return dict(v_new=v_m - R_v @ B.T @ adjoint, adjoint=transition(D).T @ adjoint)

    def oldest(adjoint, K, e, m, P, s, z, V):
        """The oldest node's new state, and what it adds to ∇J·Δw: each residual where the iteration
        began times its change.
        """
        s_new = m - P @ unmeasured(adjoint, K, e)
        prior = ca.dot(ca.ldl_solve(s - m, *ca.ldl(P, False)), s_new - s)  # H_N = P⁻¹
        return dict(s_new=s_new, descent=prior + measured_descent(s_new, s, z, V))

    def measured_descent(new, old, z, V):
        return sum(
            ca.if_else(
                is_valid_measurement(z, row),
                (old[place] - z[row]) / V[row] * (new[place] - old[place]),
                0,
            )
            for place, row in iv.measured_states
        )

    def forward(new, old, F, D, B, s, v, v_new, z, V):
        """One interval of the new solution and of the one where the iteration began (its gap
        closed), and what it adds to ∇J·Δw.
        """
        A = transition(D)
        new, old = F + A @ (new - s) + B @ (v_new - v), F + A @ (old - s)
        v_m, R_v = measured_inputs(window, z, v, V)
        return dict(
            new=new,
            old=old,
            descent=measured_descent(new, old, z, V) + ca.dot((v - v_m) / ca.diag(R_v), v_new - v),
        )

    def accepted(s, v, z, age, m, P, s_new, v_new, ok):
        """The memory after the new solution. A step that failed leaves the shifted one, and begins
        a window of its own from there, as uncertain as at the first start: what made it fail may be
        in the readings or in the arrival cost, and would stay. What is no number anywhere is none
        at the newest node either.
        """
        good = ok * is_plausible(s_new[:, N])
        s = ca.if_else(is_plausible(s[:, N]), s, 0)
        held = ca.if_else(ca.fabs(v) <= Z_MAX[3], v, 0)  # an input beyond what can be read
        return dict(
            s=ca.if_else(good, s_new, s),
            v=ca.if_else(good, v_new, held),
            z=ca.if_else(good, z, ca.SX.nan(4, N + 1)),
            age=ca.if_else(good, age, 0),
            m=ca.if_else(good, m, s[:, N]),
            P=ca.if_else(good, P, ca.diag(ca.DM(SIGMA_START)[list(iv.states)] ** 2)),
        )

    gains = dict(K=(n_s, rows), e=(rows, 1))
    backward = casadi_function(
        "rhe_backward",
        backward,
        dict(adjoint=(n_s, 1), D=linearised["D"], B=linearised["B"])
        | gains
        | dict(z=(4, 1), v=(n_v, 1))
        | V,
    )
    oldest = casadi_function(
        "rhe_oldest",
        oldest,
        dict(adjoint=(n_s, 1)) | gains | dict(m=(n_s, 1), P=(n_s, n_s), s=(n_s, 1), z=(4, 1)) | V,
    )
    forward = casadi_function(
        "rhe_forward",
        forward,
        dict(new=(n_s, 1), old=(n_s, 1))
        | linearised
        | dict(s=(n_s, 1), v=(n_v, 1), v_new=(n_v, 1), z=(4, 1))
        | V,
    )
    accepted = casadi_function(
        "rhe_accepted",
        accepted,
        window.problem | dict(s_new=(n_s, N + 1), v_new=(n_v, N), ok=(1, 1)),
    )

    def begun_again(again, pose, z_used, s, v, z, age, m, P):
        """The memory of a new start at this pose with the present speed and traction, where the
        screening asks for it.
        """
        there = ca.vertcat(pose, s[3:, N])
        there[q] = ca.fmin(ca.fmax(there[q], 0), 1)
        fresh = dict(
            s=ca.repmat(there, 1, N + 1),
            v=ca.repmat(v[:, N - 1], 1, N),
            z=ca.horzcat(ca.SX.nan(4, N), z_used),
            age=0,
            m=there,
            P=ca.diag(ca.DM(gating.SIGMA_AGAIN)[list(iv.states)] ** 2),
        )
        old = dict(s=s, v=v, z=z, age=age, m=m, P=P)
        return {name: ca.if_else(again, fresh[name], old[name]) for name in old}

    begun_again = casadi_function(
        "rhe_begun_again",
        begun_again,
        dict(again=(1, 1), pose=(3, 1), z_used=(4, 1)) | window.problem,
    )

    def body(
        s,
        v,
        z,
        age,
        m,
        P,
        V,
        F,
        D,
        B,
        K,
        e,
        K_N,
        e_N,
        multipliers,
        ok,
        z_N=None,
        z_used=None,
        again=None,
        pose=None,
        seen_after=None,
    ):
        """Every other unknown of the window, and the KKT tolerance of the linearisation point."""
        readings = ca.horzcat(z[:, :N], z_used if window.robust else z_N)
        z, s_old, v_old = ca.horzsplit(readings), ca.horzsplit(s), ca.horzsplit(v)
        F, D, B = ca.horzsplit(F), ca.horzsplit(D, n_s), ca.horzsplit(B, n_v)
        K, e = [*ca.horzsplit(K, rows), K_N], [*ca.horzsplit(e), e_N]

        adjoint, v_new = ca.vertcat(ca.DM.zeros(n_s - 2), multipliers), [None] * N
        for i in reversed(range(N)):
            v_new[i], adjoint = backward(
                adjoint, D[i], B[i], K[i + 1], e[i + 1], z[i + 1], v_old[i], V
            )

        first, descent = oldest(adjoint, K[0], e[0], m, P, s_old[0], z[0], V)
        s_new, old = [first], s_old[0]
        for i in range(N):
            new, old, more = forward(
                s_new[i], old, F[i], D[i], B[i], s_old[i], v_old[i], v_new[i], z[i + 1], V
            )
            s_new, descent = [*s_new, new], descent + more
        kkt = gauss_newton.kkt_tolerance(descent, multipliers, -s_old[N][q], 1 - s_old[N][q])
        expanded = accepted(
            s=s,
            v=v,
            z=readings,
            age=age,
            m=m,
            P=P,
            s_new=ca.horzcat(*s_new),
            v_new=ca.horzcat(*v_new),
            ok=ok,
        )
        if window.robust:
            expanded = begun_again(again=again, pose=pose, z_used=z_used, **expanded) | dict(
                seen=seen_after
            )
        return expanded | dict(kkt=kkt)

    along = {name: linearise.sparsity_out(name) for name in ("F", "D", "B", "K", "e")}
    told = ("z_used", "again", "pose", "seen_after") if window.robust else ()
    result = {
        name: feedback.sparsity_out(name) for name in ("K_N", "e_N", "multipliers", "ok", *told)
    }
    return casadi_function(
        "rhe_expand",
        body,
        window.problem | V | along | result | ({} if window.robust else dict(z_N=(4, 1))),
        loops,
    )


def build_phases(
    dt_s, horizon, speed_model="parameter", arrival_mean="smoothed", qp="structured", robust=False
):
    """The RHE as CasADi Functions shift, linearise, feedback and expand (each phase: see
    `gauss_newton`) and step, which is all of them.

    Memory, V and W: see `Window`. A window that is not full yet has intervals of no length before
    its first sample.
    """
    window = Window(model.interval(speed_model), horizon, dt_s, arrival_mean, qp, robust)
    loops = compiled.loop_symbols()
    calls = loops if qp == "structured" else ca.MX  # a QP solver can only be called
    phases = dict(
        shift=shift(window), linearise=linearise(window, loops), feedback=feedback(window, calls)
    )
    phases["expand"] = expand(window, phases["linearise"], phases["feedback"], loops)

    def step(z_N, V, W, **memory):
        """All phases of one sample. Robust: z_used are the readings that were believed, again is 1
        if the estimator begins again.
        """
        memory = phases["shift"](**memory, V=V, W=W)
        prepared = phases["linearise"](**select_inputs(phases["linearise"], memory), V=V)
        result = phases["feedback"](
            **select_inputs(phases["feedback"], prepared | memory), z_N=z_N, V=V
        )
        expanded = phases["expand"](
            **select_inputs(phases["expand"], memory | prepared | result | dict(z_N=z_N, V=V))
        )
        told = ("estimate", "covariance", "deviance", "ok") + (
            ("z_used", "again") if robust else ()
        )
        return {name: result[name] for name in told} | expanded

    V, W = window.weights
    return phases | dict(
        step=with_packed_memory("rhe_step", step, window.memory, dict(z_N=(4, 1)) | V | W, calls)
    )


def n_sigma_w(speed_model):
    """How many standard deviations are behind W: of (x, y, θ, ν, μ, κ) per sample, without ν where
    that is an input; of (μ, κ) where tracks slip.
    """
    return 2 if speed_model == "slipping" else len(model.interval(speed_model).states)


def noise_settings(speed_model, process_noise, sigma_w, sigma_v, track_width_m):
    """The settings V and W (see `Window`) behind these standard deviations; sigma_w None stands for
    those of the reading.
    """
    states = list(model.interval(speed_model).states)
    if speed_model == "slipping":
        sigma_w = (0,) * 5 + tuple(SIGMA_W_SLIPPING if sigma_w is None else sigma_w)
        return dict(
            V=np.array([*np.square([*sigma_v, *SHARES, SIGMA_BUMPS]), track_width_m]),
            W=np.square(sigma_w),
        )
    return dict(
        V=np.square(sigma_v),
        W=np.square(np.array(SIGMA_W[process_noise])[states] if sigma_w is None else sigma_w),
    )


def init(guess, sigma, horizon, speed_model="parameter", robust=False, dt_s=paper.DT_S):
    """Memory before the first sample: guess (8,) = (x, y, θ, ν, μ, κ, l_f, l_l), sigma (8,) its
    standard deviations; an antenna in the middle need not be mentioned.
    """
    iv = model.interval(speed_model)
    guess = np.append(guess, np.zeros(8 - len(guess)))
    sigma, states = np.append(sigma, SIGMA_START[len(sigma) :]), list(iv.states)
    inputs = [0.0] if speed_model == "parameter" else [guess[3], 0.0, 0.0][: iv.n_v]
    memory = dict(
        s=np.tile(guess[states], (horizon + 1, 1)).T,
        v=np.tile(inputs, (horizon, 1)).T,
        z=np.full((4, horizon + 1), np.nan),
        age=-1.0,
        m=guess[states],
        P=np.diag(sigma[states] ** 2),
    )
    return memory | dict(seen=gating.init(dt_s)) if robust else memory


class Estimate(NamedTuple):
    """Pose [m, m, rad], speed [m/s], traction, and the covariance of the estimated ones among (x,
    y, θ, ν, μ, κ), bounds left aside.

    With speed_model "slipping", (x, y) is the antenna's place, and the covariance is that of (x, y,
    θ, l_f, l_l, μ, κ).
    """

    x: float
    y: float
    theta: float
    nu: float
    mu: float
    kappa: float
    covariance: np.ndarray


class RHE:
    """The estimator for a loop of one's own: `prepare()` while there is time, `feedback(z)` when
    the measurement is there.

    dt [s]; horizon: intervals; process_noise, sigma_w, sigma_v, speed_model, arrival_mean, robust,
    track_width_m, qp: see Scenario. guess: first (x, y, θ, ν, μ, κ); without it the first
    measurement's position and speed, yaw 0 and no slip, with a yaw that may be a right angle off.
    """

    @checked
    def __init__(
        self,
        *,
        dt: Positive = paper.DT_S,
        horizon: Intervals = paper.HORIZON,
        process_noise: Reading = "printed",
        sigma_w: tuple[NotNegative, ...] | None = None,
        sigma_v: tuple[Positive, Positive, Positive, Positive] = paper.SIGMA_V,
        speed_model: SpeedModel = "parameter",
        arrival_mean: ArrivalMean = "smoothed",
        robust: Flag = False,
        track_width_m: Positive = paper.TRACK_WIDTH_M,
        qp: Solver = "structured",
        guess: tuple[Real, Real, Real, Real, Real, Real] | None = None,
    ):
        if sigma_w is not None and len(sigma_w) != n_sigma_w(speed_model):
            raise ValueError(
                f"sigma_w was {sigma_w!r}; with speed_model {speed_model!r} it should have {n_sigma_w(speed_model)} entries"
            )
        self.guess, self.n_s = guess, model.interval(speed_model).n_s
        self.start = functools.partial(
            init, horizon=horizon, speed_model=speed_model, robust=robust, dt_s=dt
        )
        self.iteration = gauss_newton.RealTimeIteration(
            compiled.load(build_phases, dt, horizon, speed_model, arrival_mean, qp, robust),
            self.start((0.0,) * 6, SIGMA_START),
            ("s", "v"),
            **noise_settings(speed_model, process_noise, sigma_w, sigma_v, track_width_m),
        )

    def prepare(self):
        """Arrival cost, shift, integrate, linearise, filter (paper: preparation part)."""
        self.iteration.prepare()

    def feedback(self, z):
        """The estimate after the measurement z = (x, y, ν, ω); an entry that is not finite has no
        sample now.
        """
        self._given(z)
        self.iteration.feedback()
        return self._estimate()

    def solve(self, z, iterations=20):
        """The same, iterated to convergence on the nonlinear problem."""
        self._given(z)
        self.iteration.solve(iterations)
        return self._estimate()

    def _given(self, z):
        copy_checked("z", z, self.iteration.arrays["z_N"])
        if not self.iteration.started:
            guess, sigma = self.guess, list(SIGMA_START)
            z = self.iteration.arrays["z_N"]
            readable = np.abs(z) <= kalman.Z_MAX
            if guess is None:
                x, y, nu, _ = np.where(readable, z, 0.0)
                guess, sigma[2] = (x, y, 0.0, nu, 1.0, 1.0), np.pi / 2
            self.iteration.start(self.start(guess, sigma) | dict(age=0.0))
            self.iteration.started = self.guess is not None or bool(
                readable[:2].all()
            )  # without a place, begin again with the next reading

    def _estimate(self):
        arrays = self.iteration.arrays
        return Estimate(
            *arrays["estimate"].tolist(), arrays["covariance"].reshape(self.n_s, self.n_s).copy()
        )

    @property
    def ok(self):
        """Whether the last step was solved; if not, its answer is the shifted previous solution's."""
        return self.iteration.arrays["ok"].item() == 1

    @property
    def kkt(self):
        """KKT tolerance of the linearisation point of the last feedback."""
        self.iteration.expand()
        return self.iteration.arrays["kkt"].item()
