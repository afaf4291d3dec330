"""Nonlinear receding horizon estimation (moving horizon estimation, MHE), eq. (10).

    min  ½ ‖ŝ_0 - s_0‖²_{H_N} + ½ Σ_{i=0..N} ‖z_i - h(s_i, v_{i-1})‖²_{H_k}
    s.t. s_{i+1} = F(s_i, v_i), lower ≤ p ≤ upper

N intervals have N+1 nodes; node N is now. z_i arrives at node i: what it says of the state belongs
to the node, what it says of inputs to the interval that *ends* there, so it measures v_{i-1}. The
newest measurement enters in the feedback phase only.

The Gauss-Newton subproblem is a linear-Gaussian smoothing problem with bounds on some constants.
Eliminating all that is unbounded from the oldest node to the newest is exactly a Kalman filter over
the window (information needs H_N = P⁻¹ only, never a dense Hessian), which leaves a QP in the
bounded parameters; its multipliers then run backwards through the window and yield every other
unknown (Bryson-Frazier). Each costs O(N).
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi import validation as valid
from rhec.core._casadi.build import casadi_function, select_inputs, short_cut, with_packed_memory
from rhec.core.estimator import kalman
from rhec.core.estimator.base import joint_estimate, joint_guess, noise_of
from rhec.core.model import base
from rhec.core.model.base import Model
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE, is_plausible
from rhec.core.solver import gauss_newton
from rhec.core.solver.box_qp import box_qp
from rhec.core.solver.rti import PHASES, RealTimeIteration, RealTimeLoop, copy_checked

__all__ = ["RHE", "Window", "build_phases", "compose", "init", "predict_input"]


class Window(NamedTuple):
    """What decides the shape of the Functions: N intervals of dt_s of a model, the arrival cost."""

    model: base.Model
    dt_s: float
    N: int
    arrival_mean: str = "smoothed"
    weighted: bool = False  # measurements have variances V of their own at each node

    @property
    def interval(self):
        """The model's shooting interval."""
        return base.interval(self.model)

    @property
    def memory(self):
        """s nodes, v inputs, z measurements, age intervals driven, m and P arrival cost."""
        n_s = self.interval.n_s
        n_v = self.interval.n_v
        n_z = len(self.model.outputs)
        window = dict(s=(n_s, self.N + 1), v=(n_v, self.N), z=(n_z, self.N + 1), age=(1, 1))
        return window | dict(m=(n_s, 1), P=(n_s, n_s))

    @property
    def noise(self):
        """Variances V of the measurements; constants c of noise that grows with the motion."""
        constants = self.model.motion_noise.constants if self.model.motion_noise else {}
        c = dict(c=(len(constants), 1)) if constants else {}
        return dict(V=(len(self.model.outputs), 1)) | c

    @property
    def noises(self):
        """Those of all nodes: V has a column for each."""
        return self.noise | (dict(V=(len(self.model.outputs), self.N + 1)) if self.weighted else {})

    def at(self, node, V, **noises):
        """Those of one node, of those of all."""
        return dict(V=V[:, node] if self.weighted else V, **noises)

    @property
    def linearised(self):
        """Sparsities of one interval's end F, D (A = A_0 + D) and B."""
        return {name: self.interval.linearised.sparsity_out(i) for i, name in enumerate("FDB")}

    @property
    def prediction(self):
        """Of the newest node, before its measurement: mean, covariance, and the input before it."""
        n_s = self.interval.n_s
        n_v = self.interval.n_v
        return dict(B_N=self.linearised["B"], v_N=(n_v, 1), m_N=(n_s, 1), P_N=(n_s, n_s))


def predict_input(window, B, m, P, v, z, **noise):
    """A prediction (m, P) made with the input v, corrected by what z says of that input."""
    v_m, R_v = window.interval.input_noise(z, v, **noise)
    return m + B @ (v_m - v), gauss_newton.symmetric(P + B @ ca.diag(R_v) @ B.T)


# shift: the window moves on by one sample, and its oldest node becomes the arrival cost


def _arrival(window, s, v, m, P, z_0, z_1, W, **noises):
    """Smoothed-EKF update of the arrival cost (paper, Sec. Arrival Cost): the oldest node leaves.

    The prior there takes in that node's measurement z_0, passes through the interval linearised at
    the previous solution (s, v), and is down-weighted by W (n_s,), so that H_N = P⁻¹ never exceeds
    W⁻¹, eq. (9). The mean comes from the previous solution, as the paper says ("smoothed"), or
    from the filter itself ("filtered"): interpretation R7.
    """
    interval = window.interval
    F, D, B = interval.linearised(s[:, 0], v[:, 0], window.dt_s)
    A = interval.A_0 + D
    V_0 = window.at(0, **noises)["V"]
    noise = window.at(1, **noises)
    m, P_updated, _, _, _ = kalman.update(m, P, z_0, V_0, interval.outputs, s[:, 0])
    v_m, R_v = interval.input_noise(z_1, v[:, 0], **noise)
    added = ca.diag(interval.process_noise(v_m, W, window.dt_s, noise.get("c")))
    P_next = gauss_newton.symmetric(A @ P_updated @ A.T + B @ ca.diag(R_v) @ B.T) + added
    m_next = F + A @ (m - s[:, 0]) + B @ (v_m - v[:, 0])
    # Where measurements were so wild that no covariance comes out, the old one grows instead.
    good = is_plausible(P_next) * ca.mmin(ca.diag(P_next) > 0)
    filtered = ca.if_else(is_plausible(m_next), m_next, s[:, 1])
    m_next = s[:, 1] if window.arrival_mean == "smoothed" else filtered
    return m_next, ca.if_else(good, P_next, P + added)


def _build_shift(window):
    N = window.N
    n_z = len(window.model.outputs)

    @casadi_function("rhe_shift", **window.memory, **window.noises, W=(window.interval.n_s, 1))
    def shift(s, v, z, age, m, P, W, **noises):
        m_next, P_next = _arrival(window, s, v, m, P, z[:, 0], z[:, 1], W, **noises)
        # A window that is not full yet has intervals of no length before its first sample.
        s, v = gauss_newton.shift(window.interval, s, v, window.dt_s * (age >= 0))
        return dict(
            s=s,
            v=v,
            z=ca.horzcat(z[:, 1:], ca.SX.nan(n_z)),
            age=ca.fmin(age + 1, N),
            m=ca.if_else(age >= N, m_next, m),
            P=ca.if_else(age >= N, P_next, P),
        )

    return shift


# linearise: from the oldest node to the newest, whose measurement is yet to come


def _build_linearise(window, loops):
    interval = window.interval
    N = window.N
    B = window.linearised["B"]
    n_s = interval.n_s
    n_v = interval.n_v
    n_z = len(window.model.outputs)

    @casadi_function(
        "rhe_filtered",
        B=B,
        v_before=(n_v, 1),
        m=(n_s, 1),
        P=(n_s, n_s),
        z=(n_z, 1),
        s=(n_s, 1),
        v=(n_v, 1),
        dt_s=(1, 1),
        **window.noise,
    )
    def filtered(B, v_before, m, P, z, s, v, dt_s, **noise):
        """One node: the input before it, its measurement, then the interval after it."""
        m, P = predict_input(window, B, m, P, v_before, z, **noise)
        m, P, K, e, _ = kalman.update(m, P, z, noise["V"], interval.outputs, s)
        F, D, B = interval.linearised(s, v, dt_s)
        A = interval.A_0 + D
        P = ca.densify(gauss_newton.symmetric(A @ P @ A.T))
        return dict(F=F, D=D, B=B, K=K, e=e, m=F + A @ (m - s), P=P)

    @casadi_function("rhe_linearise", loops, **window.memory, **window.noises)
    def linearise(s, v, z, age, m, P, **noises):
        s = ca.horzsplit(s)
        v = ca.horzsplit(v)
        z = ca.horzsplit(z)
        nodes = []
        before = dict(B=ca.DM(B, 0), v_before=ca.DM.zeros(n_v), m=m, P=P)  # no input acts there
        for i in range(N):
            known = dict(z=z[i], s=s[i], v=v[i], dt_s=window.dt_s * (age >= N - i))
            node = filtered(**before, **known, **window.at(i, **noises))
            before = dict(B=node["B"], v_before=v[i], m=node["m"], P=node["P"])
            nodes.append(node)
        along = {name: ca.horzcat(*(node[name] for node in nodes)) for name in "FDBKe"}
        newest = dict(zip(("B_N", "v_N", "m_N", "P_N"), before.values()))
        return along | newest | dict(s_N=s[N])

    return linearise


# feedback: the newest measurement, and the QP that is left


def _build_feedback(window, quantities, loops):
    interval = window.interval
    bounds = window.interval.bounds
    n_s = interval.n_s
    n_v = interval.n_v
    n_z = len(window.model.outputs)
    q = _bounded(interval)
    n_q = len(bounds)
    lower, upper = (ca.DM([bound[side] for bound in bounds.values()]) for side in (0, 1))

    @casadi_function("rhe_newest", **window.prediction, s_N=(n_s, 1), z_N=(n_z, 1), **window.noise)
    def newest(B_N, v_N, m_N, P_N, s_N, z_N, **noise):
        """min ½ (q - q̂)' H (q - q̂): H is the inverse covariance of the bounded q alone."""
        m, P = predict_input(window, B_N, m_N, P_N, v_N, z_N, **noise)
        m, P, K, e, deviance = kalman.update(m, P, z_N, noise["V"], interval.outputs, s_N)
        P_q = q @ P @ q.T
        H = ca.inv_minor(P_q) if n_q == 2 else ca.ldl_solve(ca.SX.eye(n_q), *ca.ldl(P_q, False))
        return dict(H=H, g=-H @ (q @ m), m=m, covariance=P, K_N=K, e_N=e, deviance=deviance)

    @casadi_function(
        "rhe_bounded", H=(n_q, n_q), m=(n_s, 1), covariance=(n_s, n_s), x=(n_q, 1), solved=(1, 1),
        s_N=(n_s, 1), B_N=window.linearised["B"], v_N=(n_v, 1), z_N=(n_z, 1),
        K_N=(n_s, len(interval.outputs)), e_N=(len(interval.outputs), 1), **window.noise,
    )  # fmt: skip
    def bounded(H, m, covariance, x, solved, s_N, B_N, v_N, z_N, K_N, e_N, **noise):
        """The newest estimate given q, its bounds' multipliers; the prediction if none is sane."""
        multipliers = H @ (q @ m - x)
        corrected = m - covariance @ q.T @ multipliers
        ok = solved * is_plausible(ca.vertcat(corrected, ca.vec(covariance), multipliers))
        s = ca.if_else(ok, corrected, s_N)
        for i, place in enumerate(bounds):
            s[place] = ca.if_else(ok, x[i], ca.fmin(ca.fmax(s_N[place], lower[i]), upper[i]))
        v, R_v = interval.input_noise(z_N, v_N, **noise)
        if not quantities:
            adjoint = _before_measurement(window, q.T @ multipliers, K_N, e_N, s_N)
            v_new = v - R_v * (B_N.T @ adjoint)
            v = ca.if_else(ok * is_plausible(v_new), v_new, v)
        known = dict(zip(window.model.inputs, ca.vertsplit(v)))
        known |= dict(zip(window.model.joint_names, ca.vertsplit(s)))
        return dict(
            estimate=ca.vertcat(*(known[name] for name in quantities or window.model.names)),
            multipliers=multipliers,
            covariance=ca.if_else(ok, covariance, MAX_PLAUSIBLE_STATE * ca.SX.eye(n_s)),
            ok=ok,
        )

    solve = box_qp(n_q) if n_q else None

    @casadi_function(
        "rhe_feedback", loops if n_q <= 2 else ca.MX, s_N=(n_s, 1), **window.prediction,
        z_N=(n_z, 1), **window.noise,
    )  # fmt: skip
    def feedback(**inputs):
        free = newest(**select_inputs(newest, inputs))
        x, solved = solve(free["H"], free["g"], lower, upper) if n_q else (ca.DM(0, 1), 1)
        answer = bounded(**select_inputs(bounded, inputs | free), x=x, solved=solved)
        return answer | {name: free[name] for name in ("K_N", "e_N", "deviance")}

    return feedback


def _bounded(interval):
    """The matrix that picks the bounded entries of the joint state."""
    n_q = len(interval.bounds)
    places = list(interval.bounds)
    return ca.DM.triplet(range(n_q), places, ca.DM.ones(n_q), n_q, interval.n_s)


def _before_measurement(window, adjoint, K, e, s_bar):
    """The adjoint before a node's measurement, from the one after it."""
    for i, output in reversed(list(enumerate(window.interval.outputs))):
        adjoint = adjoint - output.H(s_bar).T @ (K[:, i].T @ adjoint + e[i])
    return adjoint


# expand: the multipliers run backwards through the window, the solution forwards


def _build_expand(window, linearise, feedback, loops):
    interval = window.interval
    N = window.N
    outputs = window.interval.outputs
    n_s = interval.n_s
    n_v = interval.n_v
    n_z = len(window.model.outputs)
    rows = len(outputs)
    q = _bounded(interval)
    lower, upper = (ca.DM([b[side] for b in interval.bounds.values()]) for side in (0, 1))
    state = (n_s, 1)
    inputs = (n_v, 1)
    measured = dict(z=(n_z, 1)) | window.noise
    gains = dict(K=(n_s, rows), e=(rows, 1))
    linearised = window.linearised

    @casadi_function(
        "rhe_backward", adjoint=state, D=linearised["D"], B=linearised["B"], **gains, s=state,
        v=inputs, **measured,
    )  # fmt: skip
    def backward(adjoint, D, B, K, e, s, v, z, **noise):
        """Adjoint and new input of one interval, from the node after it, at s."""
        adjoint = _before_measurement(window, adjoint, K, e, s)
        v_m, R_v = interval.input_noise(z, v, **noise)
        return dict(v_new=v_m - R_v * (B.T @ adjoint), adjoint=(interval.A_0 + D).T @ adjoint)

    def descent(new, old, s_bar, z, V):
        """What a node's measurements add to ∇J·Δw: each residual times its change."""
        total = 0
        for output in outputs:
            residual = (output.predicted(old, s_bar) - z[output.row]) / V[output.row]
            change = output.H(s_bar) @ (new - old)
            total += ca.if_else(output.is_valid(z), residual * change, 0)
        return total

    @casadi_function(
        "rhe_oldest", adjoint=state, **gains, m=state, P=(n_s, n_s), s=state, **measured
    )
    def oldest(adjoint, K, e, m, P, s, z, **noise):
        """The oldest node's new state, and its part of ∇J·Δw."""
        s_new = m - P @ _before_measurement(window, adjoint, K, e, s)
        prior = ca.dot(ca.ldl_solve(s - m, *ca.ldl(P, False)), s_new - s)  # H_N = P⁻¹
        return dict(s_new=s_new, descent=prior + descent(s_new, s, s, z, noise["V"]))

    @casadi_function(
        "rhe_forward", new=state, old=state, **linearised, s=state, s_after=state, v=inputs,
        v_new=inputs, **measured,
    )  # fmt: skip
    def forward(new, old, F, D, B, s, s_after, v, v_new, z, **noise):
        """One interval of the new solution and of the one where the iteration began, gap closed."""
        A = interval.A_0 + D
        new = F + A @ (new - s) + B @ (v_new - v)
        old = F + A @ (old - s)
        v_m, R_v = interval.input_noise(z, v, **noise)
        more = descent(new, old, s_after, z, noise["V"]) + ca.dot((v - v_m) / R_v, v_new - v)
        return dict(new=new, old=old, descent=more)

    @short_cut("good")
    @casadi_function(
        "rhe_accepted", **window.memory, s_new=(n_s, N + 1), v_new=(n_v, N), good=(1, 1), P_0=state
    )
    def accepted(s, v, z, age, m, P, s_new, v_new, good, P_0):
        """The memory after the new solution; if the step failed, the window restarts at its newest
        node with the start-up variances, as the cause would stay in it.
        """
        s = ca.if_else(is_plausible(s[:, N]), s, 0)
        limit = min((limit for _, limit in interval.input_outputs.values()), default=np.inf)
        held = ca.if_else(ca.fabs(v) <= limit, v, 0)
        return dict(
            s=ca.if_else(good, s_new, s),
            v=ca.if_else(good, v_new, held),
            z=ca.if_else(good, z, ca.SX.nan(n_z, N + 1)),
            age=ca.if_else(good, age, 0),
            m=ca.if_else(good, m, s[:, N]),
            P=ca.if_else(good, P, ca.diag(P_0)),
        )

    result = {name: feedback.sparsity_out(name) for name in ("K_N", "e_N", "multipliers", "ok")}

    @casadi_function(
        "rhe_expand", loops, **window.memory, **window.noises, P_0=state,
        **{name: linearise.sparsity_out(name) for name in "FDBKe"}, **result, z_N=(n_z, 1),
    )  # fmt: skip
    def expand(s, v, z, age, m, P, P_0, F, D, B, K, e, K_N, e_N, multipliers, ok, z_N, **noises):
        """Every other unknown of the window, and the KKT tolerance of the linearisation point."""
        memory = dict(v=v, z=ca.horzcat(z[:, :N], z_N), age=age, m=m, P=P)
        z = ca.horzsplit(memory["z"])
        s_bar = ca.horzsplit(s)
        v_bar = ca.horzsplit(v)
        measured = [(z[i], *window.at(i, **noises).values()) for i in range(N + 1)]
        F = ca.horzsplit(F)
        D = ca.horzsplit(D, n_s)
        B = ca.horzsplit(B, n_v)
        K = [*ca.horzsplit(K, rows), K_N]
        e = [*ca.horzsplit(e), e_N]

        adjoint = ca.densify(q.T @ multipliers)
        v_new = [None] * N
        for i in reversed(range(N)):
            v_new[i], adjoint = backward(
                adjoint, D[i], B[i], K[i + 1], e[i + 1], s_bar[i + 1], v_bar[i], *measured[i + 1]
            )

        first, descent = oldest(adjoint, K[0], e[0], m, P, s_bar[0], *measured[0])
        s_new = [first]
        old = s_bar[0]
        for i in range(N):
            new, old, more = forward(
                s_new[i],
                old,
                F[i],
                D[i],
                B[i],
                s_bar[i],
                s_bar[i + 1],
                v_bar[i],
                v_new[i],
                *measured[i + 1],
            )
            s_new = [*s_new, new]
            descent = descent + more
        at = q @ s_bar[N]
        kkt = gauss_newton.kkt_tolerance(descent, multipliers, lower - at, upper - at)
        new = dict(s_new=ca.horzcat(*s_new), v_new=ca.horzcat(*v_new))
        good = ok * is_plausible(s_new[N])
        return accepted(s=s, **memory, **new, good=good, P_0=P_0) | dict(kkt=kkt)

    return expand


def build_phases(window, quantities=None):
    """The RHE as CasADi Functions shift, linearise, feedback, expand (see `rti`) and step, all.

    Args:
        window: The Window.
        quantities: Names of what the estimate holds, inputs among them as measured: noise may be
            slip, of which an encoder knows nothing. By default states, inputs and parameters, all
            as estimated.

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
    """All phases of one sample as one Function, the `memory` (name: shape) packed in a vector."""
    order = [phases[phase] for phase in PHASES]
    made = {output for phase in order for output in phase.name_out()} | memory.keys()
    given = {"z_N": phases["feedback"].size_in("z_N")}  # the measurement comes next to the memory
    given |= {
        name: phase.size_in(name) for phase in order for name in phase.name_in() if name not in made
    }
    told = "estimate", "covariance", "deviance", "ok", "accepted", "restart"
    told = [name for name in told if name in phases["feedback"].name_out()]

    @with_packed_memory(name, memory, kind, **given)
    def step(**known):
        for phase in order:
            known |= phase(**select_inputs(phase, known))
        return {name: known[name] for name in (*told, "kkt", *memory)}

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
    return dict(
        s=np.tile(guess, (window.N + 1, 1)).T,
        v=np.tile(inputs, (window.N, 1)).T,
        z=np.full((len(window.model.outputs), window.N + 1), np.nan),
        age=-1.0,
        m=np.asarray(guess),
        P=np.diag(np.square(sigma)),
    )


class RHE(RealTimeLoop):
    """Moving horizon estimation for a loop of one's own: `prepare()`, then `feedback(z)`.

    Without `model` it is the estimator of the paper's robot, `rhec.tracked_robot.live.PaperRHE`.

    Args:
        model: The robot, a rhec.Model.
        dt: Length of a sample [s].
        horizon: Intervals of the window.
        sigma_v: Standard deviation of each output's measurement.
        sigma_w: Standard deviations of the process noise per sample: one a state, then one a
            parameter. They count in the arrival cost.
        guess: First guess of each state, then each parameter.
        sigma_guess: Its standard deviations.
        arrival_mean: "smoothed": the prior mean comes from the previous solution; "filtered": from
            the EKF update itself. On a linear model the latter is the Kalman filter.

    Raises:
        ValueError: In one sentence, for an argument that cannot be.
    """

    # Returns the class that stands in where no model is passed; `rhec` sets it.
    paper_class: ClassVar[Callable[[], type["RHE"]] | None] = None

    def __new__(cls, *, model: Model | None = None, **options: Any) -> "RHE":
        if cls is RHE and model is None and cls.paper_class:
            cls = cls.paper_class()
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
        self._begin(Window(model, dt, horizon, arrival_mean), None, settings)

    def _begin(self, window, quantities, settings):
        self.window = window
        self.settings = settings
        functions = compiled.load(build_phases, window, quantities)
        self.iteration = RealTimeIteration(functions, window.memory, ("s", "v"), **settings)

    def feedback(self, z: Any) -> Any:
        """Estimate from the newest measurement, by one Gauss-Newton step.

        Args:
            z: (n_z,) measurements; an entry that is not finite is not there now.

        Returns:
            Estimate: x (n_x,), u (n_u,), p (n_p,), covariance of (x, p), bounds left aside.
        """
        self._give(z)
        self.iteration.feedback()
        return self._estimate()

    def solve(self, z: Any, iterations: int = 20) -> Any:
        """Iterate to convergence on the nonlinear problem.

        Args:
            z: (n_z,) measurements, as in `feedback`.
            iterations: Gauss-Newton steps.

        Returns:
            Estimate.
        """
        self._give(z)
        self.iteration.solve(iterations)
        return self._estimate()

    def _give(self, z):
        copy_checked("z", z, self.iteration.arrays["z_N"])
        if not self.iteration.started:
            self._start(self.iteration.arrays["z_N"])

    def _start(self, z):
        self.iteration.start(init(self.window, *self._guess) | dict(age=0.0))

    def _estimate(self):
        arrays = self.iteration.arrays
        n_s = self.model.n_s
        return joint_estimate(
            self.model, arrays["estimate"].copy(), arrays["covariance"].reshape(n_s, n_s).copy()
        )
