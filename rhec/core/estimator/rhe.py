"""Nonlinear receding horizon estimation (moving horizon estimation, MHE), eq. (10).

    min  ½ ‖ŝ_0 - s_0‖²_{H_N} + ½ Σ_{i=0..N} ‖z_i - h(s_i, v_{i-1})‖²_{H_k}
    s.t. s_{i+1} = F(s_i, v_i), lower ≤ p ≤ upper

The window has N intervals and N + 1 nodes; node N is the present. Measurement z_i arrives at node
i. Its part about the state belongs to that node. Its part about the inputs belongs to the interval
that *ends* there, so it measures v_{i-1}. Only the feedback phase uses the newest measurement.

The Gauss-Newton subproblem is a linear-Gaussian smoothing problem with bounds on some constants.
Eliminating everything unbounded, from the oldest node to the newest, is exactly a Kalman filter
over the window. It needs the covariance P = H_N⁻¹ only, never a dense Hessian. A QP in the bounded
parameters θ remains. Its multipliers then run backwards through the window and yield all other
unknowns (Bryson-Frazier smoother). Each of these passes costs O(N).
"""

from collections.abc import Callable
from inspect import signature
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.estimator import kalman
from rhec.core.estimator.base import Estimate, joint_estimate, joint_guess, noise_of
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, is_plausible
from rhec.core.solver import gauss_newton
from rhec.core.solver.box_qp import box_qp
from rhec.core.solver.rti import PHASES, RealTimeIteration, RealTimeLoop, copy_checked

__all__ = ["RHE", "Window", "build_phases", "compose", "init", "predict_input"]


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


class Prediction(NamedTuple):
    """A node before its measurement: mean m, covariance P, last input v, and B = ∂s/∂v."""

    B: Any
    v: Any
    m: Any
    P: Any


class Linearised(NamedTuple):
    """Intervals s⁺ = F + (A_0 + D) (s - s̄) + B (v - v̄), one or all of the window side by side."""

    F: Any
    D: Any
    B: Any


class Correction(NamedTuple):
    """Kalman updates, of one node or several side by side: gains K, weighted innovations e."""

    K: Any
    e: Any


class Newest(NamedTuple):
    """Node N: its linearisation point, the input that led to it, its measurement and update."""

    s_N: Any
    B_N: Any
    v_N: Any
    z_N: Any
    K_N: Any
    e_N: Any


class Constrained(NamedTuple):
    """The solution of the QP: the last Kalman update, multipliers of the bounds, and success."""

    K_N: Any
    e_N: Any
    multipliers: Any
    ok: Any


class Solution(NamedTuple):
    """The new trajectory: joint states (n_s, N + 1) and inputs (n_v, N)."""

    s_new: Any
    v_new: Any


class Window(NamedTuple):
    """The structure of an RHE, which decides the shapes of its Functions.

    Args:
        model: The rhec.Model.
        dt_s: Length of an interval [s].
        N: Intervals of the window.
        arrival_mean: "smoothed" or "filtered", interpretation R7; see RHE.
        weighted: Whether the variances V of the measurements differ from node to node.
    """

    model: base.Model
    dt_s: float
    N: int
    arrival_mean: str = "smoothed"
    weighted: bool = False

    @property
    def interval(self):
        """The model's shooting interval."""
        return base.interval(self.model)

    @property
    def shapes(self):
        """Shapes (rows, columns) of s, of its covariance, of v, z, a node's Correction, and θ."""
        n_s = self.interval.n_s
        v = (self.interval.n_v, 1)
        z = (len(self.model.outputs), 1)
        rows = len(self.interval.outputs)
        correction = Correction(K=(n_s, rows), e=(rows, 1))
        theta = (len(self.interval.bounds), 1)
        return (n_s, 1), (n_s, n_s), v, z, correction, theta

    @property
    def memory(self):
        """Shapes of the Memory, by name."""
        s, P, v, z, *_ = self.shapes
        window = Memory(
            s=(s[0], self.N + 1), v=(v[0], self.N), z=(z[0], self.N + 1), age=(1, 1), m=s, P=P
        )
        return window._asdict()

    @property
    def noise(self):
        """Shapes at one node: variances V of measurements, constants c of noise by motion."""
        V = dict(V=(len(self.model.outputs), 1))
        if not (self.model.motion_noise and self.model.motion_noise.constants):
            return V
        return V | dict(c=(len(self.model.motion_noise.constants), 1))

    @property
    def noises(self):
        """Shapes for the whole window: where it is weighted, V has a column for each node."""
        if not self.weighted:
            return self.noise
        return self.noise | dict(V=(len(self.model.outputs), self.N + 1))

    def at(self, node, V, **noises):
        """V and c of one node, from those of the whole window."""
        return dict(V=V[:, node] if self.weighted else V, **noises)

    @property
    def linearised(self):
        """Sparsities of the Linearised of one interval, by name."""
        linearised = self.interval.linearised
        return {name: linearised.sparsity_out(i) for i, name in enumerate(Linearised._fields)}

    @property
    def prediction(self):
        """Shapes of the Prediction of node N, by name."""
        s, P, v, *_ = self.shapes
        return dict(B_N=self.linearised["B"], v_N=v, m_N=s, P_N=P)


def predict_input(window, B, m, P, v, z, **noise):
    """A Prediction made with the input v, corrected by what z says about that input.

    m + B (v_m - v),  P + B R_v B', where v_m and R_v are the input's mean and variances given z.

    Returns:
        m (n_s,), P (n_s, n_s).
    """
    v_m, R_v = window.interval.input_noise(z, v, **noise)
    return m + B @ (v_m - v), gauss_newton.symmetric(P + B @ ca.diag(R_v) @ B.T)


def selection_matrix(interval):
    """The matrix C of zeros and ones that selects the bounded parameters, θ = C s."""
    n_theta = len(interval.bounds)
    places = list(interval.bounds)
    return ca.DM.triplet(range(n_theta), places, ca.DM.ones(n_theta), n_theta, interval.n_s)


def _bounds(interval):
    """Lower and upper bounds of θ."""
    lower = ca.DM([bound[0] for bound in interval.bounds.values()])
    upper = ca.DM([bound[1] for bound in interval.bounds.values()])
    return lower, upper


# Shift: the window moves on by one sample, and its oldest node becomes the arrival cost.


def _arrival(window, memory, W, noises):
    """Smoothed-EKF update of the arrival cost (paper, Sec. Arrival Cost): the oldest node leaves.

    The prior of that node takes in its measurement z_0 and passes through the interval, linearised
    at the previous solution. The process noise W (n_s,) then adds to it, so that H_N = P⁻¹ never
    exceeds W⁻¹, eq. (9). The mean comes from the previous solution, as the paper says ("smoothed"),
    or from the filter itself ("filtered"): interpretation R7.
    """
    interval = window.interval
    s_bar = memory.s[:, 0]
    v_bar = memory.v[:, 0]
    F, D, B = interval.linearised(s_bar, v_bar, window.dt_s)
    A = interval.A_0 + D
    V_0 = window.at(0, **noises)["V"]
    noise = window.at(1, **noises)
    updated = kalman.update(memory.m, memory.P, memory.z[:, 0], V_0, interval.outputs, s_bar)
    v_m, R_v = interval.input_noise(memory.z[:, 1], v_bar, **noise)
    added = ca.diag(interval.process_noise(v_m, W, window.dt_s, noise.get("c")))
    P_next = gauss_newton.symmetric(A @ updated.P @ A.T + B @ ca.diag(R_v) @ B.T) + added
    m_next = F + A @ (updated.m - s_bar) + B @ (v_m - v_bar)
    # Absurd measurements can leave no valid covariance; the previous one grows by W instead.
    is_valid = is_plausible(P_next) * ca.mmin(ca.diag(P_next) > 0)
    filtered = ca.if_else(is_plausible(m_next), m_next, memory.s[:, 1])
    m_next = memory.s[:, 1] if window.arrival_mean == "smoothed" else filtered
    return m_next, ca.if_else(is_valid, P_next, memory.P + added)


def _build_shift(window):
    N = window.N
    n_z = len(window.model.outputs)
    memory = Memory(**window.memory)

    @casadi_function("rhe_shift")
    def shift(memory: memory, noises: window.noises, W: memory.m):
        """The memory one sample later; the newest measurement is still missing."""
        m_next, P_next = _arrival(window, memory, W, noises)
        # Before the first sample lie intervals of no length, until the window is full.
        dt_s = window.dt_s * (memory.age >= 0)
        s, v = gauss_newton.shift(window.interval, memory.s, memory.v, dt_s)
        return Memory(
            s=s,
            v=v,
            z=ca.horzcat(memory.z[:, 1:], ca.SX.nan(n_z)),
            age=ca.fmin(memory.age + 1, N),
            m=ca.if_else(memory.age >= N, m_next, memory.m),
            P=ca.if_else(memory.age >= N, P_next, memory.P),
        )

    return shift


# Linearise: a Kalman filter from the oldest node to the newest, whose measurement is to come.


def _build_filter_step(window):
    interval = window.interval
    s, P, v, z, *_ = window.shapes
    before = dict(B=window.linearised["B"], v_before=v, m=s, P=P)

    @casadi_function("rhe_filtered")
    def filter_step(before: before, z: z, s: s, v: v, dt_s: (1, 1), noise: window.noise):
        """One node: the input before it, its measurement, then the interval after it."""
        B, v_before, m, P = Prediction(*before.values())
        m, P = predict_input(window, B, m, P, v_before, z, **noise)
        m, P, K, e, _ = kalman.update(m, P, z, noise["V"], interval.outputs, s)
        F, D, B = interval.linearised(s, v, dt_s)
        A = interval.A_0 + D
        # The input of the interval is uncertain, too; `predict_input` of the next node adds that.
        P = ca.densify(gauss_newton.symmetric(A @ P @ A.T))
        return dict(F=F, D=D, B=B, K=K, e=e, m=F + A @ (m - s), P=P)

    return filter_step


def _build_linearise(window, loops):
    N = window.N
    n_v = window.interval.n_v
    filter_step = _build_filter_step(window)

    @casadi_function("rhe_linearise", loops)
    def linearise(memory: Memory(**window.memory), noises: window.noises):
        """Linearised and Correction of the whole window, Prediction of node N, and s̄_N."""
        s = ca.horzsplit(memory.s)
        v = ca.horzsplit(memory.v)
        z = ca.horzsplit(memory.z)
        nodes = []
        # No input acts before the oldest node.
        B_before = ca.DM(window.linearised["B"], 0)
        before = dict(B=B_before, v_before=ca.DM.zeros(n_v), m=memory.m, P=memory.P)
        for i in range(N):
            dt_s = window.dt_s * (memory.age >= N - i)
            noise = window.at(i, **noises)
            node = filter_step(**before, z=z[i], s=s[i], v=v[i], dt_s=dt_s, **noise)
            before = dict(B=node["B"], v_before=v[i], m=node["m"], P=node["P"])
            nodes.append(node)
        stacked = (*Linearised._fields, *Correction._fields)
        window_wide = {name: ca.horzcat(*(node[name] for node in nodes)) for name in stacked}
        prediction = dict(zip(window.prediction, before.values()))
        return window_wide | prediction | dict(s_N=s[N])

    return linearise


# Feedback: the newest measurement, and the QP in the bounded parameters.


def _build_update_newest(window):
    interval = window.interval
    n_theta = len(interval.bounds)
    C = selection_matrix(interval)
    s, _, _, z, *_ = window.shapes

    @casadi_function("rhe_newest")
    def update_newest(prediction: window.prediction, s_N: s, z_N: z, noise: window.noise):
        """Kalman update by z_N, and the QP  min ½ (θ - θ̂)' H (θ - θ̂) with H = (C P C')⁻¹."""
        B, v, m, P = Prediction(*prediction.values())
        m, P = predict_input(window, B, m, P, v, z_N, **noise)
        m, P, K, e, deviance = kalman.update(m, P, z_N, noise["V"], interval.outputs, s_N)
        P_theta = C @ P @ C.T
        if n_theta == 2:
            H = ca.inv_minor(P_theta)
        else:
            H = ca.ldl_solve(ca.SX.eye(n_theta), *ca.ldl(P_theta, False))
        g = -H @ (C @ m)
        return dict(H=H, g=g, m=m, covariance=P, K_N=K, e_N=e, deviance=deviance)

    return update_newest


def _smoothed_input(window, newest, v, R_v, adjoint, ok):
    """The last input as estimated, v - R_v B' λ; as measured, v, where that is not finite."""
    update = Correction(newest.K_N, newest.e_N)
    adjoint = adjoint_before_update(window, adjoint, update, newest.s_N)
    v_new = v - R_v * (newest.B_N.T @ adjoint)
    return ca.if_else(ok * is_plausible(v_new), v_new, v)


def _build_condition(window, quantities):
    interval = window.interval
    s, P, v, z, correction, theta = window.shapes
    H = (len(interval.bounds), len(interval.bounds))
    newest = Newest(s, window.linearised["B"], v, z, *correction)
    C = selection_matrix(interval)
    lower, upper = _bounds(interval)

    @casadi_function("rhe_bounded")
    def condition(
        H: H, m: s, covariance: P, x: theta, solved: (1, 1), newest: newest, noise: window.noise
    ):
        """The newest estimate given θ = x:  s = m - P C' λ,  λ = H (θ̂ - θ), P the covariance.

        Where the solution is not finite, the estimate falls back to the prediction.
        """
        multipliers = H @ (C @ m - x)
        conditioned = m - covariance @ C.T @ multipliers
        ok = solved * is_plausible(ca.vertcat(conditioned, ca.vec(covariance), multipliers))
        s = ca.if_else(ok, conditioned, newest.s_N)
        for i, place in enumerate(interval.bounds):
            # θ exactly as the QP found it: s above may pass a bound by a rounding error.
            s[place] = ca.if_else(ok, x[i], ca.fmin(ca.fmax(newest.s_N[place], lower[i]), upper[i]))
        v, R_v = interval.input_noise(newest.z_N, newest.v_N, **noise)
        if not quantities:
            v = _smoothed_input(window, newest, v, R_v, C.T @ multipliers, ok)
        values = dict(zip(window.model.inputs, ca.vertsplit(v)))
        values |= dict(zip(window.model.joint_names, ca.vertsplit(s)))
        unknown = MAX_PLAUSIBLE_STATE * ca.SX.eye(interval.n_s)
        return dict(
            estimate=ca.vertcat(*(values[name] for name in quantities or window.model.names)),
            multipliers=multipliers,
            covariance=ca.if_else(ok, covariance, unknown),
            ok=ok,
        )

    return condition


def _build_feedback(window, quantities, loops):
    n_theta = len(window.interval.bounds)
    lower, upper = _bounds(window.interval)
    s, _, _, z, *_ = window.shapes
    update_newest = _build_update_newest(window)
    condition = _build_condition(window, quantities)
    solve = box_qp(n_theta) if n_theta else None

    @casadi_function("rhe_feedback", loops if n_theta <= 2 else ca.MX)
    def feedback(s_N: s, prediction: window.prediction, z_N: z, noise: window.noise):
        """The estimate, by the Kalman update with z_N and the QP within the bounds."""
        inputs = dict(s_N=s_N, z_N=z_N) | prediction | noise
        updated = update_newest(**select_inputs(update_newest, inputs))
        x = ca.DM(0, 1)
        solved = 1
        if n_theta:
            x, solved = solve(updated["H"], updated["g"], lower, upper)
        given_theta = inputs | updated | dict(x=x, solved=solved)
        estimate = condition(**select_inputs(condition, given_theta))
        return estimate | {name: updated[name] for name in ("K_N", "e_N", "deviance")}

    return feedback


def adjoint_before_update(window, adjoint, correction, s_bar):
    """The adjoint λ before a node's measurements, from the one after them (Bryson-Frazier).

    λ - H' (K' λ + e) for one scalar measurement after the other, the last first.
    """
    K, e = correction
    for i, output in reversed(list(enumerate(window.interval.outputs))):
        adjoint = adjoint - output.H(s_bar).T @ (K[:, i].T @ adjoint + e[i])
    return adjoint


# Expand: the multipliers run backwards through the window, the new solution forwards.


def _build_backward(window):
    interval = window.interval
    s, _, v, z, correction, _ = window.shapes
    _, D, B = window.linearised.values()

    @casadi_function("rhe_backward")
    def backward(
        adjoint: s, D: D, B: B, correction: correction, s: s, v: v, z: z, noise: window.noise
    ):
        """λ_i = A' λ and the new input v_m - R_v B' λ of one interval, from the node s after it."""
        adjoint = adjoint_before_update(window, adjoint, correction, s)
        v_m, R_v = interval.input_noise(z, v, **noise)
        return dict(v_new=v_m - R_v * (B.T @ adjoint), adjoint=(interval.A_0 + D).T @ adjoint)

    return backward


def _descent(outputs, new, old, s_bar, z, V):
    """A node's part of ∇J·Δw by its measurements: each weighted residual times its change."""
    total = 0
    for output in outputs:
        residual = (output.predicted(old, s_bar) - z[output.row]) / V[output.row]
        change = output.H(s_bar) @ (new - old)
        total += ca.if_else(output.is_valid(z), residual * change, 0)
    return total


def _build_oldest(window):
    s, P, _, z, correction, _ = window.shapes

    @casadi_function("rhe_oldest")
    def oldest(adjoint: s, correction: correction, m: s, P: P, s: s, z: z, noise: window.noise):
        """The oldest node's new state m - P λ, and its part of ∇J·Δw, the arrival cost's too."""
        s_new = m - P @ adjoint_before_update(window, adjoint, correction, s)
        arrival = ca.dot(ca.ldl_solve(s - m, *ca.ldl(P, False)), s_new - s)  # H_N = P⁻¹
        measured = _descent(window.interval.outputs, s_new, s, s, z, noise["V"])
        return dict(s_new=s_new, descent=arrival + measured)

    return oldest


def _build_forward(window):
    interval = window.interval
    s, _, v, z, *_ = window.shapes
    end = Linearised(**window.linearised)
    noise = window.noise

    @casadi_function("rhe_forward")
    def forward(new: s, old: s, end: end, s: s, s_after: s, v: v, v_new: v, z: z, noise: noise):
        """One interval of the new solution, and of the old inputs, with the interval's gap closed.

        The step Δw = new - old starts from the old inputs' trajectory without gaps, because the
        linearisation point itself need not satisfy the dynamics.
        """
        F, D, B = end
        A = interval.A_0 + D
        new = F + A @ (new - s) + B @ (v_new - v)
        old = F + A @ (old - s)
        v_m, R_v = interval.input_noise(z, v, **noise)
        descent = _descent(interval.outputs, new, old, s_after, z, noise["V"])
        return dict(new=new, old=old, descent=descent + ca.dot((v - v_m) / R_v, v_new - v))

    return forward


def _build_accepted(window):
    interval = window.interval
    N = window.N
    memory = Memory(**window.memory)
    solution = Solution(memory.s, memory.v)
    n_z = len(window.model.outputs)
    limits = [limit for _, limit in interval.input_outputs.values()]
    max_input = min(limits, default=np.inf)

    @short_cut("good")
    @casadi_function("rhe_accepted")
    def accepted(memory: memory, solution: solution, good: (1, 1), P_0: memory.m):
        """The memory with the new solution or, if the step failed, of a new start.

        A failed window would fail again, as its cause remains in it. It therefore restarts at its
        newest node with the variances P_0 of the start.
        """
        s = ca.if_else(is_plausible(memory.s[:, N]), memory.s, 0)
        v = ca.if_else(ca.fabs(memory.v) <= max_input, memory.v, 0)
        restarted = Memory(s, v, ca.SX.nan(n_z, N + 1), age=0, m=s[:, N], P=ca.diag(P_0))
        solved = memory._replace(s=solution.s_new, v=solution.v_new)
        return Memory(*(ca.if_else(good, *pieces) for pieces in zip(solved, restarted)))

    return accepted


def _nodes(window, z, noises, correction, constrained):
    """Of each node of the window: the measurements (z, V, c), and the Correction by them."""
    rows = len(window.interval.outputs)
    K = [*ca.horzsplit(correction.K, rows), constrained.K_N]
    e = [*ca.horzsplit(correction.e), constrained.e_N]
    z = ca.horzsplit(z)
    measured = [(z[i], *window.at(i, **noises).values()) for i in range(window.N + 1)]
    return measured, list(map(Correction, K, e))


def _intervals(window, linearised):
    """The Linearised of each interval of the window."""
    F = ca.horzsplit(linearised.F)
    D = ca.horzsplit(linearised.D, window.interval.n_s)
    B = ca.horzsplit(linearised.B, window.interval.n_v)
    return list(map(Linearised, F, D, B))


def _sweep_backward(backward, adjoint, intervals, s, v, measured, corrections):
    """New inputs of all intervals, and the adjoint after the measurements of node 0."""
    v_new = [None] * len(v)
    for i in reversed(range(len(v))):
        _, D, B = intervals[i]
        v_new[i], adjoint = backward(
            adjoint, D, B, *corrections[i + 1], s[i + 1], v[i], *measured[i + 1]
        )
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


def _kkt_tolerance(window, theta, descent, multipliers):
    """KKT tolerance of a linearisation point with parameters θ, from ∇J·Δw and the multipliers."""
    lower, upper = _bounds(window.interval)
    return gauss_newton.kkt_tolerance(descent, multipliers, lower - theta, upper - theta)


def _build_expand(window, linearise, feedback, loops):
    N = window.N
    C = selection_matrix(window.interval)
    backward = _build_backward(window)
    oldest = _build_oldest(window)
    forward = _build_forward(window)
    accepted = _build_accepted(window)
    memory = Memory(**window.memory)
    z_N = (memory.z[0], 1)
    linearised = Linearised(*map(linearise.sparsity_out, Linearised._fields))
    correction = Correction(*map(linearise.sparsity_out, Correction._fields))
    constrained = Constrained(*map(feedback.sparsity_out, Constrained._fields))

    @casadi_function("rhe_expand", loops)
    def expand(
        memory: memory,
        noises: window.noises,
        P_0: memory.m,
        linearised: linearised,
        correction: correction,
        constrained: constrained,
        z_N: z_N,
    ):
        """All other unknowns of the window, and the KKT tolerance of the linearisation point."""
        memory = memory._replace(z=ca.horzcat(memory.z[:, :N], z_N))
        s = ca.horzsplit(memory.s)
        v = ca.horzsplit(memory.v)
        measured, corrections = _nodes(window, memory.z, noises, correction, constrained)
        intervals = _intervals(window, linearised)
        multipliers = constrained.multipliers
        adjoint = ca.densify(C.T @ multipliers)
        v_new, adjoint = _sweep_backward(backward, adjoint, intervals, s, v, measured, corrections)
        first, descent = oldest(adjoint, *corrections[0], memory.m, memory.P, s[0], *measured[0])
        s_new, descent = _sweep_forward(forward, first, descent, intervals, s, v, v_new, measured)
        kkt = _kkt_tolerance(window, C @ s[N], descent, multipliers)
        solution = Solution(ca.horzcat(*s_new), ca.horzcat(*v_new))
        good = constrained.ok * is_plausible(s_new[N])
        pieces = memory._asdict() | solution._asdict()
        return accepted(**pieces, good=good, P_0=P_0) | dict(kkt=kkt)

    return expand


def build_phases(window, quantities=None):
    """The RHE as CasADi Functions shift, linearise, feedback, expand (see `rti`) and step, all.

    Args:
        window: The Window.
        quantities: Names of the estimate's entries. Inputs among them are as measured: with noise
            that is slip, an encoder does not measure the robot's motion. By default states, inputs
            and parameters, all as estimated.

    Returns:
        {name: Function}. `step` maps (memory, z_N, V, c, W, P_0) to (memory, estimate, …).
    """
    loops = compiled.loop_symbols()
    shift = _build_shift(window)
    linearise = _build_linearise(window, loops)
    feedback = _build_feedback(window, quantities, loops)
    expand = _build_expand(window, linearise, feedback, loops)
    phases = dict(shift=shift, linearise=linearise, feedback=feedback, expand=expand)
    kind = loops if len(window.interval.bounds) <= 2 else ca.MX
    return phases | dict(step=compose("rhe_step", phases, window.memory, kind))


def compose(name, phases, memory, kind):
    """All phases of one sample as one Function.

    Args:
        name: Name of the Function.
        phases: {name: Function}, see `build_phases`.
        memory: {name: shape} of what is packed in the first input and output, a vector.
        kind: Type of the symbols, SX or MX.

    Returns:
        Function (memory, z_N, …) -> (memory, estimate, …).
    """
    order = [phases[phase] for phase in PHASES]
    computed = {output for phase in order for output in phase.name_out()} | memory.keys()
    inputs = {"z_N": phases["feedback"].size_in("z_N")}  # the measurement follows the memory
    for phase in order:
        inputs |= {key: phase.size_in(key) for key in phase.name_in() if key not in computed}
    candidates = ("estimate", "covariance", "deviance", "ok", "accepted", "restart")
    outputs = [key for key in candidates if key in phases["feedback"].name_out()]

    @with_packed_memory(name, memory, kind, **inputs)
    def step(**values):
        for phase in order:
            values |= phase(**select_inputs(phase, values))
        return {key: values[key] for key in (*outputs, "kkt", *memory)}

    return step


def init(window, guess, sigma, inputs=None):
    """Memory before the first sample.

    Args:
        window: The Window.
        guess: (n_s,) joint state.
        sigma: (n_s,) its standard deviations.
        inputs: (n_v,) inputs before the first sample; by default 0.

    Returns:
        {name: array}, as `Window.memory` gives the shapes.
    """
    inputs = np.zeros(window.interval.n_v) if inputs is None else np.asarray(inputs)
    memory = Memory(
        s=np.tile(guess, (window.N + 1, 1)).T,
        v=np.tile(inputs, (window.N, 1)).T,
        z=np.full((len(window.model.outputs), window.N + 1), np.nan),
        age=-1.0,
        m=np.asarray(guess),
        P=np.diag(np.square(sigma)),
    )
    return memory._asdict()


class RHE(RealTimeLoop):
    """Moving horizon estimation in a user's own loop: `prepare()`, then `feedback(z)`, each sample.

    Without `model` it is the estimator of the paper's robot, with the options of
    `rhec.tracked_robot.live.PaperRHE`.

    Args:
        model: The robot, a rhec.Model.
        dt: Length of a sample [s].
        horizon: Intervals of the window.
        sigma_v: Standard deviation of each output's measurement, in the output's unit.
        sigma_w: Standard deviations of the process noise per sample, of each state, then of each
            parameter. They enter the arrival cost, eq. (9).
        guess: First guess of each state, then of each parameter.
        sigma_guess: Standard deviations of the guess.
        arrival_mean: Prior mean of the oldest node: "smoothed", from the previous solution, or
            "filtered", from the EKF update. On a linear model the latter is the Kalman filter.

    Raises:
        ValueError: If an argument is invalid.
    """

    # Returns the class behind RHE() without a model; the package's face sets it.
    paper_class: ClassVar[Callable[[], type] | None] = None

    def __new__(cls, *, model: Model | None = None, **options: Any) -> "RHE":
        if cls is RHE and model is None and RHE.paper_class:
            cls = RHE.paper_class()
        return super().__new__(cls)

    if TYPE_CHECKING:  # without a model, the options are those of the paper's robot

        def __init__(self, *, model: Model | None = None, **options: Any) -> None: ...

    @valid.checked  # type: ignore[no-redef]
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
        arrival_mean: valid.ArrivalMean = "smoothed",
    ):
        self.model = model
        self._guess = joint_guess(model, guess, sigma_guess)
        settings = noise_of(model, sigma_v, sigma_w) | dict(P_0=np.square(self._guess[1]))
        self.window = Window(model, dt, horizon, arrival_mean)
        self.settings = settings
        functions = compiled.load(build_phases, self.window, None)
        memory = tuple(self.window.memory)
        self.iteration = RealTimeIteration(functions, memory, ("s", "v"), **settings)

    __new__.__signature__ = signature(__init__)  # what help() and editors show

    def __repr__(self) -> str:
        started = "started" if self.iteration.started else "not started"
        size = f"dt {self.window.dt_s:g} s, horizon {self.window.N}, {started}"
        return f"{type(self).__name__}, {size}\n{self.model}"

    def feedback(self, z: Any) -> Any:
        """Estimate from the newest measurement, by one Gauss-Newton step.

        Args:
            z: (n_z,) measurements; an entry that is not finite counts as missing.

        Returns:
            Estimate: x (n_x,), u (n_u,), p (n_p,), covariance of (x, p) without the bounds.
        """
        self._set_measurement(z)
        self.iteration.feedback()
        return self._estimate()

    def solve(self, z: Any, iterations: int = 20) -> Any:
        """Iterate to convergence on the nonlinear problem.

        Args:
            z: (n_z,) measurements, as in `feedback`.
            iterations: Gauss-Newton steps.

        Returns:
            Estimate, as `feedback`.
        """
        self._set_measurement(z)
        self.iteration.solve(iterations)
        return self._estimate()

    def _set_measurement(self, z):
        copy_checked("z", z, self.iteration.arrays["z_N"])
        if not self.iteration.started:
            self._start(self.iteration.arrays["z_N"])

    def _start(self, z):
        self.iteration.start(init(self.window, *self._guess) | dict(age=0.0))

    def _estimate(self) -> Estimate:
        arrays = self.iteration.arrays
        n_s = self.model.n_s
        covariance = arrays["covariance"].reshape(n_s, n_s).copy()
        return joint_estimate(self.model, arrays["estimate"].copy(), covariance)
