"""Nonlinear Receding Horizon Estimation, eq. (mhe), with the arrival cost of Sec. Arrival Cost.

    min  ½ ‖(ξ̂, p̂) - s_0‖²_{H_N} + ½ Σ_{i=0..N} ‖z_i - h(s_i, v_{i-1})‖²_{H_k}     s.t. s_{i+1} = F(s_i, v_i), 0 ≤ μ, κ ≤ 1

N intervals have N+1 nodes; node N is now. z_i = (x, y, ν, ω)_i arrives at node i: its position belongs to the node, its encoder readings
ν, ω are means over the interval that *ends* there, so ω_i measures v_{i-1}. The newest measurement enters in the feedback phase only.

The Gauss-Newton subproblem is a linear-Gaussian smoothing problem with bounds on two constants. Eliminating all that is unbounded from
the oldest node to the newest is exactly a Kalman filter over the window (information needs H_N = P⁻¹ only, never a dense Hessian), which
leaves a QP in (μ, κ); its multiplier then runs backwards through the window and yields every other unknown (Bryson-Frazier). Each costs O(N).
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import compiled, gauss_newton, kalman, model, paper
from rhec.function import folded, function, only
from rhec.gauss_newton import put, transition
from rhec.kalman import symmetric, valid
from rhec.scenario import SIGMA_W
from rhec.validation import ArrivalMean, Intervals, NotNegative, Positive, Reading, Real, Solver, SpeedModel, checked

BEYOND = 1e12                # an estimate beyond this, or not a number, is no estimate
SIGMA_HELD = (1.0, 1.0)      # ν [m/s], ω [rad/s]: how far a missing input may be from the one before


def measured_inputs(interval, z, v, V):
    """What the reading z (4,) says of the inputs before it, and how surely: (v_m, R_v). A missing one is the last one held."""
    mean, variance = [], []
    for place, row in interval.measured_inputs:
        mean.append(ca.if_else(valid(z, row), z[row], v[place]))
        variance.append(ca.if_else(valid(z, row), V[row], SIGMA_HELD[row - 2] ** 2))
    return ca.vertcat(*mean), ca.diag(ca.vertcat(*variance))


def sane(x):
    """1 if every entry is a number of reasonable size."""
    return ca.mmin(ca.fabs(x) <= BEYOND)


def arrival(interval, s, v, m, P, z_0, z_1, V, W, dt_s, mean):
    """Smoothed-EKF update of the arrival cost (paper, Sec. Arrival Cost): the window's oldest node leaves.

    The prior at the oldest node takes in that node's measurement z_0, passes through the interval linearised at the previous RHE solution
    (s, v), and is down-weighted by W (n_s,), so that H_N = P⁻¹ never exceeds W⁻¹. The mean comes from the previous solution, as the paper
    says (`mean="smoothed"`), or from the filter itself (`"filtered"`): reading R7.
    """
    F, D, B = interval.linearised(s[:, 0], v[:, 0], dt_s)
    A = transition(D)
    m, P_updated, _, _, _ = kalman.update(m, P, z_0, V, interval.measured_states)
    v_m, R_v = measured_inputs(interval, z_1, v[:, 0], V)
    P_next = symmetric(A @ P_updated @ A.T + B @ R_v @ B.T) + ca.diag(W)
    m_next = F + A @ (m - s[:, 0]) + B @ (v_m - v[:, 0])
    # where readings were so wild that no covariance comes out, the old one grows instead
    good = sane(P_next) * ca.mmin(ca.diag(P_next) > 0)
    return s[:, 1] if mean == "smoothed" else ca.if_else(sane(m_next), m_next, s[:, 1]), ca.if_else(good, P_next, P + ca.diag(W))


def functions(dt_s, horizon, speed_model="parameter", arrival_mean="smoothed", qp="structured"):
    """The RHE as CasADi Functions shift, linearise, feedback and expand (each phase: see `gauss_newton`) and step, which is all of them.

    Memory: s (n_s, N+1) trajectory, v (n_v, N) inputs, z (4, N+1) window, age () intervals driven, m (n_s,) and P (n_s, n_s) arrival cost.
    V (4,) and W (n_s,) are variances. A window that is not full yet has intervals of no length before its first sample.
    """
    N, iv = horizon, model.interval(speed_model)
    q, n_s, n_v, rows = list(iv.traction), iv.n_s, iv.n_v, len(iv.measured_states)
    memory = dict(s=(n_s, N + 1), v=(n_v, N), z=(4, N + 1), age=(1, 1), m=(n_s, 1), P=(n_s, n_s))
    V, W = dict(V=(4, 1)), dict(W=(n_s, 1))
    loops = compiled.kind_of_loops()
    calls = loops if qp == "structured" else ca.MX   # a QP solver can only be called
    linearised = dict(F=(n_s, 1), D=iv.linearised.sparsity_out(1), B=iv.linearised.sparsity_out(2))

    def shift(s, v, z, age, m, P, V, W):
        """The window moves on by one sample; once it is full, its oldest node becomes the arrival cost."""
        m_next, P_next = arrival(iv, s, v, m, P, z[:, 0], z[:, 1], V, W, dt_s, arrival_mean)
        s, v = gauss_newton.shift(iv, s, v, dt_s * (age >= 0))
        return dict(s=s, v=v, z=ca.horzcat(z[:, 1:], ca.SX.nan(4)), age=ca.fmin(age + 1, N),
                    m=ca.if_else(age >= N, m_next, m), P=ca.if_else(age >= N, P_next, P))

    shift = function("rhe_shift", shift, memory | V | W)

    # linearise: from the oldest node to the newest, whose measurement is yet to come

    def with_input(B, m, P, v, z, V):
        """A prediction (m, P) made with the input v, corrected by what the reading z says of that input."""
        v_m, R_v = measured_inputs(iv, z, v, V)
        return m + B @ (v_m - v), P + B @ R_v @ B.T

    def filtered(B, v_before, m, P, z, s, v, dt_s, V):
        """One node: the input before it, its measurement, then the interval after it, integrated and differentiated at (s, v)."""
        m, P, K, e, _ = kalman.update(*with_input(B, m, P, v_before, z, V), z, V, iv.measured_states)
        F, D, B = iv.linearised(s, v, dt_s)
        A = transition(D)
        return dict(F=F, D=D, B=B, K=K, e=e, m=F + A @ (m - s), P=symmetric(A @ P @ A.T))

    filtered = function("rhe_filtered", filtered, dict(
        B=linearised["B"], v_before=(n_v, 1), m=(n_s, 1), P=(n_s, n_s), z=(4, 1), s=(n_s, 1), v=(n_v, 1), dt_s=(1, 1)) | V)

    def linearise(s, v, z, age, m, P, V):
        s, v, z, nodes = ca.horzsplit(s), ca.horzsplit(v), ca.horzsplit(z), []
        B, v_before = ca.DM(linearised["B"], 0), ca.DM.zeros(n_v)   # no input acts before the oldest node
        for i in range(N):
            nodes.append(filtered(B=B, v_before=v_before, m=m, P=P, z=z[i], s=s[i], v=v[i], dt_s=dt_s * (age >= N - i), V=V))
            B, v_before, m, P = nodes[-1]["B"], v[i], nodes[-1]["m"], nodes[-1]["P"]
        along = {name: ca.horzcat(*(node[name] for node in nodes)) for name in ("F", "D", "B", "K", "e")}
        return along | dict(B_N=B, v_N=v_before, m_N=m, P_N=P, s_N=s[N])

    linearise = function("rhe_linearise", linearise, memory | V, loops)

    # feedback: the newest measurement, and the QP that is left

    def newest(B_N, v_N, m_N, P_N, z_N, V):
        """min ½ (q - q̂)' H (q - q̂), 0 ≤ q = (μ, κ) ≤ 1, where H is the inverse covariance of (μ, κ) alone."""
        m, P, K, e, deviance = kalman.update(*with_input(B_N, m_N, P_N, v_N, z_N, V), z_N, V, iv.measured_states)
        H = ca.inv_minor(P[q, q])
        nu = m[3] if speed_model == "parameter" else measured_inputs(iv, z_N, v_N, V)[0][0]
        return dict(H=H, g=-H @ m[q], m=m, covariance=P, nu=nu, K_N=K, e_N=e, deviance=deviance)

    def bounded(H, m, covariance, nu, traction, solved, s_N):
        """The newest estimate (x, y, θ, ν, μ, κ) given (μ, κ), and the multipliers of its bounds; what was predicted where nothing sane comes out."""
        multipliers = H @ (m[q] - traction)
        corrected = m - covariance[:, q] @ multipliers
        ok = solved * sane(ca.vertcat(corrected, ca.vec(covariance), multipliers))
        newest = ca.if_else(ok, corrected, s_N)
        traction = ca.if_else(ok, traction, ca.fmin(ca.fmax(s_N[q], 0), 1))
        nu = newest[3] if speed_model == "parameter" else nu
        return dict(estimate=ca.vertcat(newest[:3], nu, traction), multipliers=multipliers,
                    covariance=ca.if_else(ok, covariance, BEYOND * ca.SX.eye(n_s)), ok=ok)

    prediction = dict(B_N=linearised["B"], v_N=(n_v, 1), m_N=(n_s, 1), P_N=(n_s, n_s))
    newest = function("rhe_newest", newest, prediction | dict(z_N=(4, 1)) | V)
    bounded = function("rhe_bounded", bounded, dict(H=(2, 2), m=(n_s, 1), covariance=(n_s, n_s), nu=(1, 1), traction=(2, 1),
                                                    solved=(1, 1), s_N=(n_s, 1)))
    solve = gauss_newton.box_qp_2() if qp == "structured" else gauss_newton.box_qp(2, qp)

    def feedback(s_N, **given):
        p = newest(**given)
        traction, _, solved = solve(p["H"], p["g"], ca.DM.zeros(2), ca.DM.ones(2))
        return bounded(**only(bounded, p), traction=traction, solved=solved, s_N=s_N) | {name: p[name] for name in ("K_N", "e_N", "deviance")}

    feedback = function("rhe_feedback", feedback, dict(s_N=(n_s, 1)) | prediction | dict(z_N=(4, 1)) | V, calls)

    # expand: the multipliers run backwards through the window, the solution forwards

    def unmeasured(adjoint, K, e):
        """The adjoint before a node's measurement, from the one after it."""
        adjoint = ca.SX(adjoint)
        for row in reversed(range(rows)):
            place, _ = iv.measured_states[row]
            adjoint[place] -= K[:, row].T @ adjoint + e[row]
        return adjoint

    def backward(adjoint, D, B, K, e, z, v, V):
        """One node and the interval before it: the interval's new input, and the adjoint at its beginning."""
        adjoint = unmeasured(adjoint, K, e)
        v_m, R_v = measured_inputs(iv, z, v, V)
        return dict(v_new=v_m - R_v @ B.T @ adjoint, adjoint=transition(D).T @ adjoint)

    def oldest(adjoint, K, e, m, P, s, z, V):
        """The oldest node's new state, and what it adds to ∇J·Δw: each residual where the iteration began times its change."""
        s_new = m - P @ unmeasured(adjoint, K, e)
        prior = ca.dot(ca.ldl_solve(s - m, *ca.ldl(P, False)), s_new - s)   # H_N = P⁻¹
        return dict(s_new=s_new, descent=prior + measured_descent(s_new, s, z, V))

    def measured_descent(new, old, z, V):
        return sum(ca.if_else(valid(z, row), (old[place] - z[row]) / V[row] * (new[place] - old[place]), 0) for place, row in iv.measured_states)

    def forward(new, old, F, D, B, s, v, v_new, z, V):
        """One interval of the new solution and of the one where the iteration began (its gap closed), and what it adds to ∇J·Δw."""
        A = transition(D)
        new, old = F + A @ (new - s) + B @ (v_new - v), F + A @ (old - s)
        v_m, R_v = measured_inputs(iv, z, v, V)
        return dict(new=new, old=old, descent=measured_descent(new, old, z, V) + ca.dot((v - v_m) / ca.diag(R_v), v_new - v))

    def accepted(s, v, s_new, v_new, ok):
        """The new solution; the shifted one after a step that failed. What is no number anywhere is none at the newest node either."""
        good = ok * sane(s_new[:, N])
        return dict(s=ca.if_else(good, s_new, s), v=ca.if_else(good, v_new, v))

    gains = dict(K=(n_s, rows), e=(rows, 1))
    backward = function("rhe_backward", backward, dict(adjoint=(n_s, 1), D=linearised["D"], B=linearised["B"]) | gains | dict(z=(4, 1), v=(n_v, 1)) | V)
    oldest = function("rhe_oldest", oldest, dict(adjoint=(n_s, 1)) | gains | dict(m=(n_s, 1), P=(n_s, n_s), s=(n_s, 1), z=(4, 1)) | V)
    forward = function("rhe_forward", forward, dict(new=(n_s, 1), old=(n_s, 1)) | linearised | dict(
        s=(n_s, 1), v=(n_v, 1), v_new=(n_v, 1), z=(4, 1)) | V)

    accepted = function("rhe_accepted", accepted, dict(s=(n_s, N + 1), v=(n_v, N), s_new=(n_s, N + 1), v_new=(n_v, N), ok=(1, 1)))

    def expand(s, v, z, age, m, P, V, F, D, B, K, e, K_N, e_N, multipliers, z_N, ok):
        """Every other unknown of the window, and the KKT tolerance of the linearisation point."""
        window = ca.horzcat(z[:, :N], z_N)
        z, s_old, v_old = ca.horzsplit(window), ca.horzsplit(s), ca.horzsplit(v)
        F, D, B = ca.horzsplit(F), ca.horzsplit(D, n_s), ca.horzsplit(B, n_v)
        K, e = [*ca.horzsplit(K, rows), K_N], [*ca.horzsplit(e), e_N]

        adjoint, v_new = ca.vertcat(ca.DM.zeros(n_s - 2), multipliers), [None] * N
        for i in reversed(range(N)):
            v_new[i], adjoint = backward(adjoint, D[i], B[i], K[i + 1], e[i + 1], z[i + 1], v_old[i], V)

        first, descent = oldest(adjoint, K[0], e[0], m, P, s_old[0], z[0], V)
        s_new, old = [first], s_old[0]
        for i in range(N):
            new, old, more = forward(s_new[i], old, F[i], D[i], B[i], s_old[i], v_old[i], v_new[i], z[i + 1], V)
            s_new, descent = [*s_new, new], descent + more
        kkt = gauss_newton.kkt_tolerance(descent, multipliers, -s_old[N][q], 1 - s_old[N][q])
        s, v = accepted(s, v, ca.horzcat(*s_new), ca.horzcat(*v_new), ok)
        return dict(s=s, v=v, z=window, age=age, m=m, P=P, kkt=kkt)

    along = {name: linearise.sparsity_out(name) for name in ("F", "D", "B", "K", "e")}
    result = {name: feedback.sparsity_out(name) for name in ("K_N", "e_N", "multipliers", "ok")}
    expand = function("rhe_expand", expand, memory | V | along | result | dict(z_N=(4, 1)), loops)

    def step(z_N, V, W, **memory):
        """All phases of one sample."""
        memory = shift(**memory, V=V, W=W)
        prepared = linearise(**memory, V=V)
        result = feedback(**only(feedback, prepared), z_N=z_N, V=V)
        expanded = expand(**memory, **only(expand, prepared), **only(expand, result), z_N=z_N, V=V)
        return {name: result[name] for name in ("estimate", "covariance", "deviance", "ok")} | expanded

    step = folded("rhe_step", step, memory, dict(z_N=(4, 1)) | V | W, calls)
    return dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand, step=step)


def start(guess, sigma, horizon, speed_model="parameter"):
    """Memory before the first sample: guess (6,) = (x, y, θ, ν, μ, κ), sigma (6,) its standard deviations."""
    iv = model.interval(speed_model)
    guess, sigma, states = np.asarray(guess, dtype=float), np.asarray(sigma, dtype=float), list(iv.states)
    inputs = [0.0] if speed_model == "parameter" else [guess[3], 0.0]
    return dict(s=np.tile(guess[states], (horizon + 1, 1)).T, v=np.tile(inputs, (horizon, 1)).T, z=np.full((4, horizon + 1), np.nan),
                age=-1.0, m=guess[states], P=np.diag(sigma[states] ** 2))


class Estimate(NamedTuple):
    """Pose [m, m, rad], speed [m/s], traction, and the covariance of the estimated ones among (x, y, θ, ν, μ, κ), bounds left aside."""

    x: float
    y: float
    theta: float
    nu: float
    mu: float
    kappa: float
    covariance: np.ndarray


class RHE:
    """The estimator for a loop of one's own: `prepare()` while there is time, `feedback(z)` when the measurement is there.

    dt [s]; horizon: intervals; reading, sigma_w, sigma_v, speed_model, arrival_mean, qp: see Scenario. guess: first (x, y, θ, ν, μ, κ); without it the
    first measurement's position and speed, yaw 0 and no slip, with a yaw that may be a right angle off.
    """

    @checked
    def __init__(self, *, dt: Positive = paper.DT_S, horizon: Intervals = paper.HORIZON, reading: Reading = "printed",
                 sigma_w: tuple[NotNegative, ...] | None = None, sigma_v: tuple[Positive, Positive, Positive, Positive] = paper.SIGMA_V,
                 speed_model: SpeedModel = "parameter", arrival_mean: ArrivalMean = "smoothed", qp: Solver = "structured",
                 guess: tuple[Real, Real, Real, Real, Real, Real] | None = None):
        states = model.interval(speed_model).states
        if sigma_w is None:
            sigma_w = np.array(SIGMA_W["rhe", reading])[list(states)]
        if len(sigma_w) != len(states):
            raise ValueError(f"sigma_w was {sigma_w!r}; with speed_model {speed_model!r} it should have {len(states)} entries")
        self.horizon, self.speed_model, self.guess, self.n_s = horizon, speed_model, guess, len(states)
        self.iteration = gauss_newton.Iteration(compiled.load(functions, dt, horizon, speed_model, arrival_mean, qp),
                                                ("s", "v", "z", "age", "m", "P"), V=np.square(sigma_v), W=np.square(sigma_w))

    def prepare(self):
        """Arrival cost, shift, integrate, linearise, filter (paper: preparation part)."""
        self.iteration.prepare()

    def feedback(self, z):
        """The estimate after the measurement z = (x, y, ν, ω); an entry that is not finite has no sample now."""
        self._given(z)
        self.iteration.feedback()
        return self._estimate()

    def solve(self, z, iterations=20):
        """The same, iterated to convergence on the nonlinear problem."""
        self._given(z)
        self.iteration.solve(iterations)
        return self._estimate()

    def _given(self, z):
        put("z", z, self.iteration.arrays["z_N"])
        if not self.iteration.started:
            guess, sigma = self.guess, list(paper.SIGMA_W_RHE)
            z = self.iteration.arrays["z_N"]
            readable = np.abs(z) <= kalman.Z_MAX
            if guess is None:
                x, y, nu, _ = np.where(readable, z, 0.0)
                guess, sigma[2] = (x, y, 0.0, nu, 1.0, 1.0), np.pi / 2
            self.iteration.start(start(guess, sigma, self.horizon, self.speed_model) | dict(age=0.0))
            self.iteration.started = self.guess is not None or bool(readable[:2].all())   # without a place, begin again with the next reading

    def _estimate(self):
        arrays = self.iteration.arrays
        return Estimate(*arrays["estimate"].tolist(), arrays["covariance"].reshape(self.n_s, self.n_s).copy())

    @property
    def kkt(self):
        """KKT tolerance of the linearisation point of the last feedback."""
        self.iteration.expand()
        return self.iteration.arrays["kkt"].item()
