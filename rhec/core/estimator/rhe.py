"""Nonlinear receding horizon estimation (moving horizon estimation, MHE), eq. (10).

    min  ½ ‖ŝ_0 - s_0‖²_{H_N} + ½ Σ_{i=0..N} ‖z_i - h(s_i, v_{i-1})‖²_{H_k}
    s.t. s_{i+1} = F(s_i, v_i), lower ≤ p ≤ upper

The window has N intervals and N + 1 nodes; node N is the present. Measurement z_i arrives at node
i. Its part about the state belongs to that node. Its part about the inputs belongs to the interval
that *ends* there, so it measures v_{i-1}. Only the feedback phase uses the newest measurement.

The Gauss-Newton subproblem is a linear-Gaussian smoothing problem with bounds on some constants.
Eliminating everything unbounded, from the oldest node to the newest, is exactly a Kalman filter
over the window. It needs the covariance P = H_N⁻¹ only, never a dense Hessian. A QP in the bounded
parameters q remains. Its multipliers then run backwards through the window and yield all other
unknowns (Bryson-Frazier smoother). Each of these passes costs O(N).
"""

import functools
from collections import namedtuple
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core._casadi.build import casadi_function, inlined, select_inputs, short_cut
from rhec.core._casadi.c_text import LARGE
from rhec.core.estimator import kalman, newest_interval, window_bounds, window_noise
from rhec.core.estimator.estimate import (
    joint_estimate,
    joint_guess,
    noise_of,
    noise_shapes,
    variances_w,
)
from rhec.core.estimator.guard import ITERATED, noise_as_used, noise_memory, whole_noise, with_guard
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.core.model import robot_model
from rhec.core.model.integration import refuse_unstable_step
from rhec.core.model.known import checked_known
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, is_plausible
from rhec.core.model.robot_model import Model
from rhec.core.solver import gauss_newton
from rhec.core.solver.box_qp import box_qp
from rhec.core.solver.line_search import PENALTY, line_search
from rhec.core.solver.rti import (
    IMPROVE,
    PHASES,
    RealTimeIteration,
    RealTimeLoop,
    chained,
    copy_checked,
    iterate,
    outer_inputs,
)

ArrivalMean = Literal["filtered", "smoothed"]  # interpretation G7; see RHE
LOOPS = 20  # products of fewer states are faster without the zeros of their slopes
UNKNOWNS = ("s", "v")  # pieces of the memory that an iteration improves

# Records that the phases pass on. Their entries are expressions, or the shapes of these; a name
# is that of a Function's input, because the phases share arrays by name.


class Memory(NamedTuple):
    """What an RHE remembers from one sample to the next."""

    s: Any  # (n_s, N + 1) joint states at the nodes
    v: Any  # (n_v, N) inputs of the intervals
    z: Any  # (n_z, N + 1) measurements, NaN where there is none
    age: Any  # intervals since the first sample, at most N; -1 before the first sample
    m: Any  # (n_s,) mean of the arrival cost
    P: Any  # (n_s, n_s) covariance of the arrival cost


# Intervals s⁺ = F + (A_0 + D) (s - s̄) + B (v - v̄), with gains K and weighted innovations e of the
# Kalman update of the node before each; one interval, or all of the window side by side.
Filtered = namedtuple("Filtered", "F D B K e")

# What the feedback leaves to expand: the Kalman update of node N, the multipliers of the bounds,
# and whether the estimate is `ok`.
Constrained = namedtuple("Constrained", "K_N e_N multipliers ok")


class Window(NamedTuple):
    """The structure of an RHE, which decides the shapes of its Functions."""

    model: Model
    dt_s: float  # length of an interval [s]
    N: int  # intervals of the window
    arrival_mean: ArrivalMean = "filtered"
    judge: InnovationGate | None = None  # of each sample (`guard`); None: it is used as measured
    # Whether process noise acts within the window (`window_noise`); that takes a judge.
    noisy: bool = False
    # Names of what the estimate holds, inputs as they are measured: with noise that is slip, an
    # encoder does not measure the robot's motion. None: all of the model, as estimated.
    quantities: tuple[str, ...] | None = None

    @property
    def estimated(self):
        """Names of the estimate's entries."""
        return self.quantities or self.model.names

    @property
    def interval(self):
        """The model's shooting interval."""
        if self.noisy:
            return window_noise.noisy_interval(self.model, self.dt_s)
        return robot_model.interval(self.model)

    @property
    def shapes(self):
        """Shapes (rows, columns) of s, of its covariance, of v, z, a node's K and e, and q."""
        n_s = self.interval.n_s
        v = (self.interval.n_v, 1)
        z = (len(self.model.sampled), 1)
        rows = len(self.interval.outputs)
        correction = dict(K=(n_s, rows), e=(rows, 1))
        q = (len(self.interval.bounds), 1)
        return (n_s, 1), (n_s, n_s), v, z, correction, q

    @property
    def pieces(self):
        """Shapes of the Memory."""
        s, P, v, z, *_ = self.shapes
        N = self.N
        return Memory(s=(s[0], N + 1), v=(v[0], N), z=(z[0], N + 1), age=(1, 1), m=s, P=P)

    @property
    def memory(self):
        """Shapes of all that is remembered, by name."""
        return _memory_of(self)

    @property
    def doubts_model(self):
        """Whether predictions and all nodes have to be plausible, see `InnovationGate`."""
        return bool(self.judge and self.judge.doubts_model)

    @property
    def at_measured_input(self):
        """Whether the feedback linearises the `newest_interval` at the measured input.

        The paper's RHE does not: its preparation linearises all that is linearised.
        """
        return self.doubts_model and newest_interval.bends(self.model)

    @property
    def symbols(self):
        """SX, or MX for Functions with matrices so large that loops are better than scalars."""
        return ca.MX if self.interval.n_s >= LARGE else ca.SX

    @property
    def loop_symbols(self):
        """The symbols for Functions that repeat another Function."""
        return ca.MX if self.symbols is ca.MX else compiled.loop_symbols()

    @property
    def noise(self):
        """Shapes at one node: variances V of measurements, constants c of noise by motion.

        In a noisy window also the variances W of the process noise of the interval before the node.
        """
        noise = noise_shapes(self.model)
        return noise | dict(W=(self.interval.n_s, 1)) if self.noisy else noise

    @property
    def noises(self):
        """Shapes for the whole window: W_window has the W of each interval, in columns."""
        return noise_shapes(self.model) | noise_memory(self)

    def at(self, node, **noises):
        """V, c and W of one node, from those of the whole window."""
        if self.noisy:  # before the oldest node lies no interval of the window
            noises["W"] = noises.pop("W_window")[:, max(node - 1, 0)]
        return noises

    @property
    def prediction(self):
        """Shapes of node N before its measurement: B = ∂s/∂v, last input v, mean and covariance."""
        s, P, v, *_ = self.shapes
        return dict(B_N=self.interval.sparsities["B"], v_N=v, m_N=s, P_N=P)

    @property
    def before_newest(self):
        """Names of the filter's results at the node before, which `newest_interval` needs."""
        return newest_interval.BEFORE if self.at_measured_input else ()

    def predict_input(self, B, m, P, v, z, **noise):
        """Correct the mean m and covariance P of a prediction by what z says about its input v.

        m + B (v_m - v),  P + B R_v B', with the mean v_m and variances R_v of the input given z.
        """
        v_m, R_v = self.interval.input_noise(z, v, **noise)
        return m + B @ (v_m - v), gauss_newton.symmetric(P + B @ ca.diag(R_v) @ B.T)

    def corrected(self, B, m, P, v, z, s_bar, **noise):
        """A node's prediction after its sample z: `predict_input`, then `kalman.update`."""
        if isinstance(P, ca.MX):
            found = _build_corrected(self)(B, m, P, v, z, s_bar, *noise.values())
            m, P, K, e, y, S = found
            deviance = kalman.deviance_of(z, self.interval.outputs, y, S)
            return kalman.Update(m, P, K, e, deviance, None, y, S)
        m, P = self.predict_input(B, m, P, v, z, **noise)
        return kalman.update(m, P, z, noise["V"], self.interval.outputs, s_bar)

    def updated(self, m, P, v, z, s_bar, **noise):
        """A node after its sample z, whose inputs v are known: `kalman.update`."""
        if isinstance(P, ca.MX):
            no_slopes = ca.DM(self.interval.sparsities["B"], 0)
            return self.corrected(no_slopes, m, P, v, z, s_bar, **noise)
        return kalman.update(m, P, z, noise["V"], self.interval.outputs, s_bar)

    def times_inverse(self, P, b):
        """P⁻¹ b."""
        if isinstance(P, ca.MX) and self.interval.n_s < LOOPS:
            return _build_times_inverse(self.interval.n_s)(P, b)
        return gauss_newton.solve_positive(P, b)

    def propagated(self, F, D, m, P, s_bar, added=0):
        """Mean F + A (m - s̄) and covariance A P A' + added after an interval with A = A_0 + D."""
        if isinstance(P, ca.MX) and self.interval.n_s < LOOPS:
            m, P = _build_propagated(self)(F, D, m, P, s_bar)
            return m, P + added
        A = self.interval.A_0 + D
        return F + A @ (m - s_bar), gauss_newton.propagated(A, P, added)


# Functions of MX call what those of SX have inline. They share it if it is the same Function.


@functools.cache
def _build_corrected(window):
    s, P, v, z, *_ = window.shapes
    B = window.interval.sparsities["B"]

    @casadi_function("rhe_corrected")
    def corrected(B: B, m: s, P: P, v: v, z: z, s_bar: s, noise: window.noise):
        found = window.corrected(B, m, P, v, z, s_bar, **noise)
        # Nearly all callers need no deviance, and its logarithms take a tenth of the time.
        return {name: getattr(found, name) for name in ("m", "P", "K", "e", "y", "S")}

    return corrected


@functools.cache
def _build_times_inverse(n):
    @casadi_function("times_inverse")
    def times_inverse(P: (n, n), b: (n, 1)):
        return dict(x=gauss_newton.solve_positive(P, b))

    return times_inverse


@functools.cache
def _build_propagated(window):
    s, P, *_ = window.shapes
    F, D, _ = window.interval.sparsities.values()

    @casadi_function("rhe_propagated")
    def propagated(F: F, D: D, m: s, P: P, s_bar: s):
        m, P = window.propagated(F, D, m, P, s_bar)
        return dict(m=m, P=ca.densify(P))

    return propagated


# A loop needs its shapes each time it is set up, and its judge takes most of that time.
@functools.cache
def _memory_of(window):
    """Shapes of all that a Window remembers, by name."""
    of_judge = window.judge.memory(window) if window.judge else {}
    return MappingProxyType(window.pieces._asdict() | noise_memory(window) | of_judge)


def _bounded(interval):
    """Matrix C of zeros and ones that selects the bounded parameters q = C s, and their bounds."""
    C = ca.DM.eye(interval.n_s)[[*interval.bounds], :]
    lower, upper = (ca.DM([b[side] for b in interval.bounds.values()]) for side in (0, 1))
    return C, lower, upper


# Shift: the window moves on by one sample, and its oldest node becomes the arrival cost.


def _arrival(window, memory, W, noises):
    """Smoothed-EKF update of the arrival cost (paper, Sec. Arrival Cost): the oldest node leaves.

    The prior of that node takes in its measurement z_0 and passes through the interval, linearised
    at the previous solution. The process noise W (n_s,) then adds to it, so that H_N = P⁻¹ never
    exceeds W⁻¹, eq. (9). The mean comes from the previous solution, as the paper says ("smoothed"),
    or from the filter itself ("filtered"): interpretation G7.
    """
    interval = window.interval
    s_bar = memory.s[:, 0]
    v_bar = memory.v[:, 0]
    F, D, B = interval.linearised(s_bar, v_bar, window.dt_s)
    noise_0 = window.at(0, **noises)
    noise = window.at(1, **noises)
    updated = window.updated(memory.m, memory.P, v_bar, memory.z[:, 0], s_bar, **noise_0)
    v_m, R_v = interval.input_noise(memory.z[:, 1], v_bar, **noise)
    added = ca.diag(interval.process_noise(v_m, W, window.dt_s, noise.get("c")))
    by_input = B @ ca.diag(R_v) @ B.T
    m_next, P_next = window.propagated(F, D, updated.m, updated.P, s_bar, by_input)
    m_next += B @ (v_m - v_bar)
    P_next += added
    # Absurd measurements can leave no valid covariance; the previous one grows by W instead.
    is_valid = is_plausible(P_next) * ca.mmin(ca.diag(P_next) > 0)
    filtered = ca.if_else(is_plausible(m_next), m_next, memory.s[:, 1])
    m_next = memory.s[:, 1] if window.arrival_mean == "smoothed" else filtered
    return m_next, ca.if_else(is_valid, P_next, memory.P + added)


def _plausible_newest(s, age, m_0):
    """The nodes s, the newest of which is the one before where it is not plausible.

    The newest node is the estimate where a step fails, and the window restarts there. If it has
    restarted (age 0) and still no interval leads on, the model has no slopes there, such as sqrt(x)
    for x < 0. The newest node is then the first guess m_0, where it has some.
    """
    held = ca.if_else(age == 0, m_0, s[:, -2])
    return ca.horzcat(s[:, :-1], ca.if_else(is_plausible(s[:, -1]), s[:, -1], held))


def _build_shift(window):
    N = window.N
    memory = window.pieces
    of_guess = dict(m_0=memory.m) if window.doubts_model else {}

    @casadi_function("rhe_shift", window.symbols, **of_guess)
    def shift(memory: memory, noises: window.noises, W: memory.m, m_0=None):
        """The memory one sample later; the newest measurement is still missing."""
        m_next, P_next = _arrival(window, memory, W, noises)
        # Before the first sample lie intervals of no length, until the window is full.
        dt_s = window.dt_s * (memory.age >= 0)
        v_next = memory.v[:, -1]
        if window.noisy:  # what is expected of the new interval: the last input, and no noise
            v_next = ca.vertcat(v_next[: len(window.model.acting)], ca.DM.zeros(memory.s.size1()))
        v_next = window.interval.with_known(v_next, memory.z[:, N])
        s, v = gauss_newton.shift(window.interval, memory.s, memory.v, dt_s, v_next)
        if window.doubts_model:
            s = _plausible_newest(s, memory.age, m_0)
        return Memory(
            s=s,
            v=v,
            z=ca.horzcat(memory.z[:, 1:], window.interval.without_measurements(memory.z[:, N])),
            age=ca.fmin(memory.age + 1, N),
            m=ca.if_else(memory.age >= N, m_next, memory.m),
            P=ca.if_else(memory.age >= N, P_next, memory.P),
        )

    return shift


# Linearise: a Kalman filter from the oldest node to the newest, whose measurement is to come.


def _build_linearise(window):
    interval = window.interval
    N = window.N
    s, P, v, z, *_ = window.shapes
    B_0 = interval.sparsities["B"]
    before = dict(B=B_0, v_before=v, m=s, P=P)

    @casadi_function("rhe_filtered", window.symbols)
    def filter_step(before: before, z: z, s: s, v: v, dt_s: (1, 1), noise: window.noise):
        """One node: the input before it, its measurement, then the interval after it."""
        B, v_before, m, P = before.values()
        m, P, K, e, *_ = window.corrected(B, m, P, v_before, z, s, **noise)
        F, D, B = interval.linearised(s, v, dt_s)
        # The input of the interval is uncertain, too; `predict_input` of the next node adds that.
        m_next, P_next = window.propagated(F, D, m, P, s)
        before_newest = dict(zip(window.before_newest, (m, P)))
        return dict(F=F, D=D, B=B, K=K, e=e, m=m_next, P=ca.densify(P_next)) | before_newest

    @casadi_function("rhe_linearise", window.loop_symbols)
    def linearise(memory: window.pieces, noises: window.noises):
        """Filtered of the whole window, the prediction of node N, and s̄_N."""
        s, v, z = map(ca.horzsplit, (memory.s, memory.v, memory.z))
        nodes = []
        # No input acts before the oldest node.
        before = dict(B=ca.DM(B_0, 0), v_before=ca.DM.zeros(*v[0].shape), m=memory.m, P=memory.P)
        for i in range(N):
            # Intervals before the first sample have no length, as in shift.
            dt_s = window.dt_s * (memory.age >= N - i)
            noise = window.at(i, **noises)
            given = before | dict(z=z[i], s=s[i], v=v[i], dt_s=dt_s) | noise
            # Where its products are loops, the compiler would take longer for N copies of these.
            is_short = interval.n_s < LOOPS
            node = inlined(filter_step, given) if is_short else filter_step(**given)
            before = dict(B=node["B"], v_before=v[i], m=node["m"], P=node["P"])
            nodes.append(node)
        filtered = {name: ca.horzcat(*(node[name] for node in nodes)) for name in Filtered._fields}
        filtered |= {name: nodes[-1][name] for name in window.before_newest}
        return filtered | dict(zip(window.prediction, before.values()), s_N=s[N])

    return linearise


# Feedback: the newest measurement, and the QP in the bounded parameters.


def _build_update_newest(window):
    interval = window.interval
    n_q = len(interval.bounds)
    C, _, _ = _bounded(interval)
    s, _, _, z, *_ = window.shapes

    @casadi_function("rhe_newest", window.symbols)
    def update_newest(prediction: window.prediction, s_N: s, z_N: z, noise: window.noise):
        """Kalman update by z_N, and the QP  min ½ (q - q̂)' H (q - q̂) with H = (C P C')⁻¹."""
        B, v, m, P = prediction.values()
        m, P, K, e, deviance, *_ = window.corrected(B, m, P, v, z_N, s_N, **noise)
        P_q = C @ P @ C.T
        if not n_q:
            H = ca.DM(0, 0)
        elif n_q == 2:
            H = ca.inv_minor(P_q)
        else:
            H = gauss_newton.solve_positive(P_q, ca.DM.eye(n_q))
        g = -H @ (C @ m)
        return dict(H=H, g=g, m=m, covariance=P, K_N=K, e_N=e, deviance=deviance)

    return update_newest


def _predicted(interval, s_N):
    """The estimate of a step without a solution: the prediction within bounds, of any variance."""
    s = ca.SX(s_N)
    for place, (lower, upper) in interval.bounds.items():
        s[place] = ca.fmin(ca.fmax(s[place], lower), upper)
    return s, MAX_PLAUSIBLE_STATE * ca.SX.eye(interval.n_s)


def _build_condition(window):
    interval = window.interval
    s, P, v, z, correction, q = window.shapes
    H = (len(interval.bounds), len(interval.bounds))
    newest = dict(s_N=s, B_N=interval.sparsities["B"], v_N=v, z_N=z)
    newest |= dict(K_N=correction["K"], e_N=correction["e"])
    C, _, _ = _bounded(interval)

    @casadi_function("rhe_bounded")
    def condition(
        H: H, m: s, covariance: P, q: q, solved: (1, 1), newest: newest, noise: window.noise
    ):
        """The newest estimate given q:  s = m - P C' λ,  λ = H (q̂ - q), P the covariance.

        Where that is not finite, the estimate is the prediction (`_predicted`), with the last input
        as measured.
        """
        s_N, B_N, v_N, z_N, K_N, e_N = newest.values()
        multipliers = H @ (C @ m - q)
        s = m - covariance @ C.T @ multipliers
        ok = solved * is_plausible(ca.vertcat(s, ca.vec(covariance), multipliers))
        # Exactly as the QP found it: by a rounding error, s may be beyond a bound.
        s[[*interval.bounds]] = q
        v, R_v = interval.input_noise(z_N, v_N, **noise)
        if not window.quantities:
            adjoint = C.T @ multipliers
            adjoint = adjoint_before_update(interval.outputs, adjoint, K_N, e_N, s_N, z_N)
            v_new = v - R_v * (B_N.T @ adjoint)
            v = ca.if_else(ok * is_plausible(v_new), v_new, v)
        s_predicted, unknown = _predicted(interval, s_N)
        s = ca.if_else(ok, s, s_predicted)
        covariance = ca.if_else(ok, covariance, unknown)
        values = dict(zip(window.model.inputs, ca.vertsplit(v)))
        values |= dict(zip(window.model.joint_names, ca.vertsplit(s)))
        estimate = ca.vertcat(*(values[name] for name in window.estimated))
        return dict(estimate=estimate, multipliers=multipliers, covariance=covariance, ok=ok)

    return condition


def _build_feedback(window):
    n_q = len(window.interval.bounds)
    _, lower, upper = _bounded(window.interval)
    s, _, _, z, *_ = window.shapes
    update_newest = _build_update_newest(window)
    condition = _build_condition(window)
    solve = box_qp(n_q) if n_q else None

    @casadi_function("rhe_feedback", window.loop_symbols if n_q <= 2 else ca.MX)
    def feedback(s_N: s, prediction: window.prediction, z_N: z, noise: window.noise):
        """The estimate, by the Kalman update with z_N and the QP within the bounds."""
        inputs = dict(s_N=s_N, z_N=z_N) | prediction | noise
        updated = update_newest(**select_inputs(update_newest, inputs))
        q = ca.DM(0, 1)
        solved = 1
        if n_q:
            q, solved = solve(updated["H"], updated["g"], lower, upper)
        given_q = inputs | updated | dict(q=q, solved=solved)
        estimate = condition(**select_inputs(condition, given_q))
        return estimate | {name: updated[name] for name in ("K_N", "e_N", "deviance")}

    return feedback


def adjoint_before_update(outputs, adjoint, K, e, s_bar, z):
    """The adjoint λ before a node's measurements, from the one after them (Bryson-Frazier).

    λ - H' (K' λ + e) for one scalar measurement after the other, the last first.
    """
    for i, output in reversed(list(enumerate(outputs))):
        adjoint = adjoint - output.slope(s_bar, z).T @ (K[:, i].T @ adjoint + e[i])
    return adjoint


# Expand: the multipliers run backwards through the window, the new solution forwards.


def _descent(outputs, new, old, s_bar, z, V):
    """A node's part of ∇J·Δw by its measurements: each weighted residual times its change."""
    total = 0
    for output in outputs:
        residual = output.residual(z, old, s_bar) / V[output.row]
        change = output.slope(s_bar, z) @ (new - old)
        total -= ca.if_else(output.is_valid(z), residual * change, 0)
    return total


def _build_passes(window):
    """One interval backward, the oldest node, and one interval forward, as Functions."""
    interval = window.interval
    outputs = interval.outputs
    noise = window.noise
    s, P, v, z, update, _ = window.shapes
    F, D, B = interval.sparsities.values()

    @casadi_function("rhe_backward")
    def backward(adjoint: s, D: D, B: B, update: update, s: s, v: v, z: z, noise: noise):
        """λ_i = A' λ and the new input v_m - R_v B' λ of one interval, from the node s after it."""
        adjoint = adjoint_before_update(outputs, adjoint, *update.values(), s, z)
        v_m, R_v = interval.input_noise(z, v, **noise)
        return dict(v_new=v_m - R_v * (B.T @ adjoint), adjoint=(interval.A_0 + D).T @ adjoint)

    @casadi_function("rhe_oldest", window.symbols)
    def oldest(adjoint: s, update: update, m: s, P: P, s: s, z: z, noise: noise):
        """The oldest node's new state m - P λ, and its part of ∇J·Δw, the arrival cost's too."""
        s_new = m - P @ adjoint_before_update(outputs, adjoint, *update.values(), s, z)
        arrival = ca.dot(window.times_inverse(P, s - m), s_new - s)  # H_N = P⁻¹
        return dict(s_new=s_new, descent=arrival + _descent(outputs, s_new, s, s, z, noise["V"]))

    @casadi_function("rhe_forward")
    def forward(
        new: s, old: s, F: F, D: D, B: B, s: s, s_after: s, v: v, v_new: v, z: z, noise: noise
    ):
        """One interval of the new solution, and of the old inputs, with the interval's gap closed.

        The step Δw = new - old starts from the old inputs' trajectory without gaps, because the
        linearisation point itself need not satisfy the dynamics.
        """
        A = interval.A_0 + D
        new = F + A @ (new - s) + B @ (v_new - v)
        old = F + A @ (old - s)
        v_m, R_v = interval.input_noise(z, v, **noise)
        descent = _descent(outputs, new, old, s_after, z, noise["V"])
        return dict(new=new, old=old, descent=descent + ca.dot((v - v_m) / R_v, v_new - v))

    return backward, oldest, forward


def _build_next_window(window):
    interval = window.interval
    N = window.N
    memory = window.pieces
    max_input = min((limit for _, limit in interval.input_outputs.values()), default=np.inf)

    @short_cut("kept", window.symbols)
    @casadi_function("rhe_next_window", window.symbols)
    def next_window(memory: memory, s_new: memory.s, v_new: memory.v, kept: (1, 1), P_0: memory.m):
        """The memory with the new solution or, if the step failed, of a new start.

        A failed window would fail again, as its cause remains in it. It therefore restarts at its
        newest node with the variances P_0 of the start.
        """
        s = ca.if_else(is_plausible(memory.s[:, N]), memory.s, 0)
        v = ca.if_else(ca.fabs(memory.v) <= max_input, memory.v, 0)
        z = ca.repmat(interval.without_measurements(memory.z[:, N]), 1, N + 1)
        restarted = Memory(s, v, z, age=0, m=s[:, N], P=ca.diag(P_0))
        improved = memory._replace(s=s_new, v=v_new)
        return Memory(*(ca.if_else(kept, *pieces) for pieces in zip(improved, restarted)))

    return next_window


def _split(window, z, noises, filtered, constrained):
    """Of each node the measurements (z, V, c) and the update (K, e); of each interval F, D, B."""
    interval = window.interval
    z = ca.horzsplit(z)
    measured = [(z[i], *window.at(i, **noises).values()) for i in range(window.N + 1)]
    widths = (1, interval.n_s, interval.n_v, len(interval.outputs), 1)
    # A model without inputs has a B of no width.
    ends = ([i * width for i in range(window.N + 1)] for width in widths)
    F, D, B, K, e = map(ca.horzsplit, filtered, ends)
    updates = list(zip([*K, constrained.K_N], [*e, constrained.e_N]))
    return measured, updates, list(zip(F, D, B))


def _sweep_backward(backward, adjoint, intervals, s, v, measured, updates):
    """New inputs of all intervals, and the adjoint after the measurements of node 0."""
    v_new = [None] * len(v)
    for i in reversed(range(len(v))):
        _, D, B = intervals[i]
        node = (*updates[i + 1], s[i + 1], v[i], *measured[i + 1])
        v_new[i], adjoint = backward(adjoint, D, B, *node)
    return v_new, adjoint


def _sweep_forward(forward, first, descent, intervals, s, v, v_new, measured):
    """New states of all nodes, and ∇J·Δw, from those of the oldest node."""
    s_new = [first]
    old = s[0]
    for i in range(len(v)):
        new, old, more = forward(
            s_new[i], old, *intervals[i], s[i], s[i + 1], v[i], v_new[i], *measured[i + 1]
        )
        s_new.append(new)
        descent = descent + more
    return s_new, descent


def _build_expand(window, linearise, feedback, whole_window):
    N = window.N
    C, lower, upper = _bounded(window.interval)
    backward, oldest, forward = _build_passes(window)
    next_window = _build_next_window(window)
    memory = window.pieces
    z_N = (memory.z[0], 1)
    noises = window.noises
    filtered = Filtered(*map(linearise.sparsity_out, Filtered._fields))
    constrained = Constrained(*map(feedback.sparsity_out, Constrained._fields))

    @casadi_function("rhe_expand", window.loop_symbols)
    def expand(
        memory: memory,
        noises: noises,
        P_0: memory.m,
        filtered: filtered,
        constrained: constrained,
        z_N: z_N,
    ):
        """All other unknowns of the window, and the KKT tolerance of the linearisation point."""
        memory = memory._replace(z=ca.horzcat(*ca.horzsplit(memory.z)[:-1], z_N))
        s, v = map(ca.horzsplit, (memory.s, memory.v))
        measured, updates, intervals = _split(window, memory.z, noises, filtered, constrained)
        adjoint = ca.densify(C.T @ constrained.multipliers)
        v_new, adjoint = _sweep_backward(backward, adjoint, intervals, s, v, measured, updates)
        first, descent = oldest(adjoint, *updates[0], memory.m, memory.P, s[0], *measured[0])
        s_new, descent = _sweep_forward(forward, first, descent, intervals, s, v, v_new, measured)
        q = C @ s[N]
        kkt = gauss_newton.kkt_tolerance(descent, constrained.multipliers, lower - q, upper - q)
        solution = dict(s_new=ca.horzcat(*s_new), v_new=ca.horzcat(*v_new))
        kept = constrained.ok * is_plausible(s_new[N])
        if whole_window:  # no other node may stay implausible either: it would remain for long
            kept = kept * is_plausible(ca.veccat(*s_new, *v_new, memory.m, memory.P))
        pieces = memory._asdict() | solution
        return inlined(next_window, pieces | dict(kept=kept, P_0=P_0)) | dict(kkt=kkt)

    return expand


def _build_plain_phases(window, whole_window):
    shift = _build_shift(window)
    linearise = _build_linearise(window)
    feedback = _build_feedback(window)
    expand = _build_expand(window, linearise, feedback, whole_window)
    return dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand)


def build_phases(window):
    """The RHE as {name: Function}: shift, linearise, feedback, expand (see `rti`) and step.

    `step` runs all phases; it maps (memory, z_N, V, c, W, m_0, P_0) to (memory, estimate, …), with
    m_0 if the judge doubts the model.
    """
    phases = build_live_phases(window)
    return phases | dict(step=_build_step(phases, window.memory, _calling_symbols(window)))


def build_live_phases(window):
    """The phases of a live object, which calls one after the other and needs no `step`.

    Without a compiler `step` would contain all of them once more.
    """
    phases = _build_judged_phases(window)
    phases.pop(ITERATED, None)  # for `improve` alone
    return phases


def _calling_symbols(window):
    """The kind of symbols (SX or MX) of Functions that call the phases."""
    # More than two bounds need pivoting, or the interior point: Functions that SX cannot call.
    is_closed_form = len(window.interval.bounds) <= 2 and not window.model.state_bounds
    return window.loop_symbols if is_closed_form else ca.MX


def _build_judged_phases(window):
    """The phases with those of the judge.

    If `solve` needs a feedback of its own, which is told the iteration, it is there as ITERATED.
    """
    if window.model.state_bounds:
        free = _build_plain_phases(window_bounds.without_bounds(window), whole_window=True)
        phases = window_bounds.with_bounds(window, free, _build_next_window(window))
    else:
        phases = _build_plain_phases(window, whole_window=window.doubts_model)
    if window.judge:
        phases = with_guard(window, phases, _calling_symbols(window))
    return phases


def build_solvable(window):
    """The phases of a live object, and `improve`, by which `solve` iterates with a line search."""
    phases = _build_judged_phases(window)
    improve = _build_improve(window, phases)
    phases.pop(ITERATED, None)
    return phases | {IMPROVE: improve}


# Improve: one iteration without shift, for `solve`.


def _build_cost(window):
    """Parts of the cost, eq. (10): the arrival, the outputs at a node, the inputs of an interval.

    Each is half a sum of weighted squares of residuals; a missing measurement has none.
    """
    interval = window.interval
    s, P, v, z, *_ = window.shapes
    noise = window.noise

    @casadi_function("rhe_cost_of_arrival", window.symbols)
    def arrival(s: s, m: s, P: P):
        return dict(cost=ca.dot(s - m, gauss_newton.solve_positive(P, s - m)) / 2)

    @casadi_function("rhe_cost_of_node")
    def node(s: s, z: z, noise: noise):
        cost = ca.SX(0)
        for output in interval.outputs:
            residual = output.residual(z, s, s)
            square = residual**2 / noise["V"][output.row]
            cost += ca.if_else(output.is_valid(z), square, 0)
        return dict(cost=cost / 2)

    @casadi_function("rhe_cost_of_interval")
    def between(s: s, s_after: s, v: v, v_last: v, z: z, dt_s: (1, 1), noise: noise):
        v_m, R_v = interval.input_noise(z, v_last, **noise)
        gap = ca.sum1(ca.fabs(interval.step(s, v, dt_s) - s_after))
        return dict(cost=ca.sum1((v - v_m) ** 2 / R_v) / 2, gap=gap)

    return arrival, node, between


def _build_cost_and_gaps(window):
    """The window's cost and Σ |F(s_i, v_i) - s_{i+1}| as a Function, and its data, by name.

    By how much states exceed their bounds counts as a gap, too: a shifted window may do so.
    """
    N = window.N
    bounds = window.interval.bounds if window.model.state_bounds else {}
    memory = window.memory
    arrival, node, between = _build_cost(window)
    data = {name: memory[name] for name in ("z", "age", "m", "P")} | dict(v_last=memory["v"])
    unknowns = {name: memory[name] for name in UNKNOWNS}

    @casadi_function("rhe_cost_and_gaps", ca.MX, **unknowns, **data, noises=window.noises)
    def cost_and_gaps(s, v, z, age, m, P, v_last, noises):
        nodes, inputs, last, measured = map(ca.horzsplit, (s, v, v_last, z))
        cost = arrival(nodes[0], m, P)
        gaps = 0
        for i in range(N + 1):
            at = window.at(i, **noises).values()
            cost += node(nodes[i], measured[i], *at)
            for place, (lower, upper) in bounds.items():
                gaps += ca.fmax(lower - nodes[i][place], 0) + ca.fmax(nodes[i][place] - upper, 0)
            if i:
                dt_s = window.dt_s * (age >= N + 1 - i)
                ends = nodes[i - 1], nodes[i], inputs[i - 1], last[i - 1], measured[i]
                more, gap = between(*ends, dt_s, *at)
                cost += more
                gaps += gap
        return dict(cost=cost, gaps=gaps)

    return cost_and_gaps, unknowns, data | window.noises


def _build_improve(window, phases):
    """One iteration without shift: linearise, feedback, expand, and a line search.

    The search starts where a sample was used and solved; otherwise expand's window stays. The first
    one takes the newest interval at the measured input (`newest_interval`), as a feedback does.
    """
    cost_and_gaps, unknowns, data = _build_cost_and_gaps(window)
    search = line_search("rhe_search", unknowns, data, cost_and_gaps)
    model = window.model
    iteration = [phases[name] for name in PHASES if name != "shift"]
    shapes = window.memory | outer_inputs(iteration, window.memory) | dict(penalty=PENALTY)
    iterating = phases | dict(feedback=phases.get(ITERATED, phases["feedback"]))

    @casadi_function("rhe_improve", ca.MX, **shapes)
    def improve(penalty, **inputs):
        values, full = iterate(iterating, inputs | dict(iteration=1 + (penalty[1] > 0)))
        z = ca.horzcat(inputs["z"][:, : window.N], values.get("z_used", inputs["z_N"]))
        given = inputs | dict(z=z, v_last=inputs["v"], s_full=full["s"], v_full=full["v"])
        given |= whole_noise(window, values)
        if window.judge:
            given = noise_as_used(window, given, values["scale_used"])
        chosen = search(**select_inputs(search, given), penalty=penalty)
        ok = values["ok"]
        moved = {name: ca.if_else(ok, chosen[name], full[name]) for name in unknowns}
        newest = dict(zip(window.estimated, ca.vertsplit(values["estimate"])))
        of_window = dict(zip(model.joint_names, ca.vertsplit(moved["s"][:, window.N])))
        if not window.quantities:  # otherwise inputs are as measured
            of_window |= dict(zip(model.inputs, ca.vertsplit(moved["v"][:, -1])))
        newest |= {name: of_window[name] for name in newest if name in of_window}
        # After a full step that of the feedback, whose parameters are exactly at their bounds.
        shortened = ok * (1 - chosen["is_full"])
        estimate = ca.if_else(shortened, ca.vertcat(*newest.values()), values["estimate"])
        outputs = {name: values[name] for name in phases["feedback"].name_out()}
        outputs |= full | moved | dict(estimate=estimate, converged=chosen["converged"] * ok)
        outputs |= dict(done=chosen["done"] * ok, ok=ok * chosen["near"])
        return outputs | dict(penalty_after=chosen["penalty_after"])

    return improve


def _build_step(phases, memory, symbols):
    """All phases of one sample as one Function (memory, z_N, …) -> (memory, estimate, …)."""
    order = [phases[name] for name in PHASES]
    candidates = ("estimate", "covariance", "deviance", "ok", "accepted", "restart")
    results = [key for key in candidates if key in phases["feedback"].name_out()]
    return chained("rhe_step", order, memory, (*results, "kkt"), symbols, ("z_N",))


def init(window, guess, sigma, inputs=0.0, known=0.0):
    """Memory before the first sample, by name, with the shapes of `Window.memory`.

    It holds a guess (n_s,) of the joint state, its standard deviations sigma (n_s,), and the inputs
    (n_v,) before the first sample, by default 0, with the known signals (n_d,) of that sample.
    """
    N = window.N
    s = np.full((N + 1, window.interval.n_s), guess).T
    v = np.full((N, window.interval.n_v), inputs).T
    z = np.full((len(window.model.sampled), N + 1), np.nan)
    z[len(window.model.outputs) :] = np.reshape(known, (-1, 1))
    for place, row in window.interval.known.items():
        v[place] = z[row, 0]
    memory = dict(s=s, v=v, z=z, age=-1.0, m=np.asarray(guess), P=np.diag(np.square(sigma)))
    # The judge knows of no samples: the first one is judged by the guess.
    others = {name: shape for name, shape in window.memory.items() if name not in memory}
    return memory | {name: np.zeros(shape) for name, shape in others.items()}


def refuse_noise(sigma_w):
    """Refuse the process noise of a sample where the window has none."""
    expected = "it should be None, unless the RHE is made with noise_in_window=True"
    valid.refuse("sigma_w was", sigma_w, expected)


class RHE(RealTimeLoop):
    """Moving horizon estimation in a user's own loop: `prepare()`, then `feedback(z)`, each sample.

    A sample far outside its prediction is not used, and `ok` is False then; where such samples
    follow each other the window restarts there, and where they scatter they count as noisier
    (`rhec.core.estimator.innovation_gate`). It also restarts, and is not `ok`, where the model's
    `steps` are too few for its slopes at the estimate.

    Args:
        model: The robot, a rhec.Model.
        dt: Length of a sample [s].
        horizon: Intervals of the window.
        sigma_v: Standard deviation of each output's measurement, in the output's unit.
        sigma_w: Standard deviations of the process noise per sample, of each state, then of each
            parameter. They enter the arrival cost, eq. (9), and with `noise_in_window` the window.
        guess: First guess of each state, then of each parameter.
        sigma_guess: Standard deviations of the guess.
        arrival_mean: Prior mean of the oldest node: "filtered", from the EKF update, or "smoothed",
            from the previous solution. With "filtered" and `noise_in_window` the RHE is the Kalman
            filter on a linear model; without that noise it trusts the model within the window.
        noise_in_window: Whether the process noise also acts within the window, whose states then
            need not follow the model exactly. `feedback` takes its standard deviations by sample.
        outliers: Whether samples can be outliers. False: all of them are used.

    Raises:
        ValueError: If an argument is invalid.
    """

    _unsolved = (
        "the sample was far from its prediction, or the QP was not solved; the estimate is the "
        "prediction"
    )

    @valid.checked
    def __init__(
        self,
        *,
        model: Model,
        dt: valid.Positive,
        horizon: valid.Intervals,
        sigma_v: valid.Positives,
        sigma_w: valid.NotNegatives,
        guess: valid.Reals,
        sigma_guess: valid.Positives,
        arrival_mean: ArrivalMean = "filtered",
        noise_in_window: valid.Flag = False,
        outliers: valid.Flag = True,
    ):
        self._guess = joint_guess(model, guess, sigma_guess)
        n_x = len(model.states)
        u = np.zeros(len(model.acting))
        refuse_unstable_step(model, guess[:n_x], u, guess[n_x:], dt, sigma_guess[n_x:])
        m_0, sigma_0 = self._guess
        settings = noise_of(model, sigma_v, sigma_w) | dict(m_0=m_0, P_0=np.square(sigma_0))
        judge = InnovationGate(rejects=outliers)
        window = Window(model, dt, horizon, arrival_mean, judge, noise_in_window)
        self._load(build_solvable, window, settings)

    def _load(self, build, window, settings):
        """Load the compiled phases `build(window)`, and name views of their arrays.

        Args:
            build: `build_live_phases` or `build_solvable`.
            window: The Window.
            settings: {name: array} of the variances V, W, P_0, and what else the phases take.
        """
        self.model = window.model
        self.window = window
        self.settings = settings
        functions = compiled.load(build, window)
        self.iteration = RealTimeIteration(functions, tuple(window.memory), UNKNOWNS, **settings)
        arrays = self.iteration.arrays
        n_s = self.model.n_s
        n_z = len(self.model.outputs)
        self._known = arrays["z_N"][n_z:, None]
        self._known[:] = np.nan
        self._inputs = dict(z=arrays["z_N"][:n_z], known=self._known)
        # Views of the result, made once: reshaping takes longer than the QP of the feedback.
        self._result = (arrays["estimate"], arrays["covariance"].reshape(n_s, n_s))

    def __repr__(self) -> str:
        started = "started" if self.iteration.started else "not started"
        size = f"dt {self.window.dt_s:g} s, horizon {self.window.N}, {started}"
        return f"{type(self).__name__}, {size}\n{self.model}"

    def feedback(self, z: Any, sigma_w: Any = None, known: Any = None) -> Any:
        """Estimate from the newest measurement, by one Gauss-Newton step.

        Args:
            z: (n_z,) measurements; an entry that is not finite counts as missing.
            sigma_w: (n_x + n_p,) standard deviations of the process noise since the last sample, of
                an estimator with `noise_in_window`; None: those that it was made with.
            known: {name: number} of the Model's known signals; what is not given, or is no finite
                number, is as at the last sample.

        Returns:
            Estimate: x (n_x,), u (n_u,), p (n_p,), covariance of (x, p) without the bounds.

        Raises:
            ValueError: If an argument is invalid.
        """
        self._set_sample(z, sigma_w, known)
        self.iteration.feedback()
        return self._estimate()

    def solve(self, z: Any, iterations: int = 20, sigma_w: Any = None, known: Any = None) -> Any:
        """Iterate to convergence on the nonlinear problem.

        Steps are shortened by a line search, so that the cost falls, and end once `converged`.

        Args:
            z: (n_z,) measurements, as in `feedback`.
            iterations: Gauss-Newton steps, at most.
            sigma_w: Standard deviations of the process noise, as in `feedback`.
            known: Known signals, as in `feedback`.

        Returns:
            Estimate, as `feedback`.

        Raises:
            ValueError: If an argument is invalid.
        """
        self._set_sample(z, sigma_w, known)
        self.iteration.solve(iterations)
        return self._estimate()

    def restart(self) -> None:
        """Let the next sample be the first, judged by the first guess."""
        self.iteration.restart()

    @property
    def rejected(self) -> float:
        """Share of samples that were rejected as outliers, a running mean over about 30 of them.

        The mean is over three windows, if these are longer.
        """
        return self.iteration.arrays["share_after"].item()

    @property
    def accepted(self) -> np.ndarray:
        """Which of the last sample's measurements (n_z,) were used: not missing, nor rejected."""
        used = self.iteration.arrays["z_used"][: len(self.model.outputs)]
        return self.iteration.started & (np.abs(used) <= self.model.limits)

    @property
    def x_window(self) -> np.ndarray:
        """States (n_x, N + 1) at the window's nodes, from the oldest to the newest.

        Nodes before the first sample are where the robot was then.
        """
        s = self._expanded("s", self.model.n_s, self.window.N + 1)
        return s[: len(self.model.states)]

    @property
    def u_window(self) -> np.ndarray:
        """Inputs (n_u, N) of the window's intervals, as estimated."""
        v = self._expanded("v", self.window.interval.n_v, self.window.N)
        return v[: len(self.model.inputs)]

    def _expanded(self, name, n_rows, n_columns):
        # They are not needed for the newest estimate, so feedback leaves them to expand.
        self.iteration.expand()
        return self.iteration.previous[name].reshape((n_rows, n_columns), order="F").copy()

    def _set_sample(self, z, sigma_w, known):
        """Copy the newest sample in, with the noise and the known signals that came with it."""
        self._set_noise(sigma_w)
        self._set_inputs(z=z, known=checked_known(self.model.known, known, self._known))

    def _set_noise(self, sigma_w):
        if self.window.noisy:
            W = self.settings["W"] if sigma_w is None else variances_w(self.model, sigma_w)
            copy_checked("sigma_w", W, self.iteration.arrays["W"])
        elif sigma_w is not None:
            refuse_noise(sigma_w)

    def _start(self):
        first = init(self.window, *self._guess, known=self._known[:, 0])
        self.iteration.start(first | dict(age=0.0))

    def _estimate(self):
        values, covariance = self._result
        return joint_estimate(self.model, values.copy(), covariance.copy())
