"""Bounds of states at all nodes of an RHE's window.

Without bounds the Gauss-Newton subproblem has the solution (s*, v*), a Kalman smoother. About the
linearisation point with its gaps closed (s°, v̄) the subproblem within the bounds is the QP

    min  ½ ‖d_0 - d*_0‖²_{P⁻¹} + ½ Σ_{i=0..N} ‖d_i - d*_i‖²_{H'V⁻¹H} + ½ Σ ‖e_i - e*_i‖²_{R⁻¹}
    s.t. d_{i+1} = A_i d_i + B_i e_i,  lower ≤ s°_i + d_i ≤ upper

in d = s - s°, e = v - v̄, with d* = s* - s°, e* = v* - v̄, the minimum without bounds. A Riccati
interior point solves it (`rhec.core.solver.interior_point`). The state of its first stage is zero,
and so d_0 is the input of a stage before the window.

Parameters do not change within the window unless it is noisy; so their bounds are rows of the
newest node alone, as without bounds of states, or of all nodes of a noisy window.
"""

import dataclasses

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.model.limits import MAX_QP_ENTRY, is_plausible
from rhec.core.solver.interior_point import Shape, interior_point


def without_bounds(window):
    """The same Window, of a Model without bounds."""
    parameters = dict.fromkeys(window.model.parameters)
    free = dataclasses.replace(window.model, parameters=parameters, state_bounds=None)
    return window._replace(model=free)


def _shape_of(window):
    """The Shape of the QP: the stage before the window, then those of its nodes."""
    interval = window.interval
    n = interval.n_s
    m = max(n, interval.n_v)
    sparse = interval.sparsities
    before = ca.horzcat(ca.DM.eye(n), ca.DM(n, m - n))
    B = before + ca.horzcat(ca.DM(sparse["B"], 1), ca.DM(n, m - interval.n_v))
    rows = ca.DM.eye(n + m)[[*interval.bounds], :]
    return Shape(
        window.N + 1, interval.A_0, sparse["D"], B.sparsity(), ca.sparsify(rows).sparsity(), 0
    )


def _build_stage(window, shape):
    """Functions of a node: the Hessian of its measurements; of an interval: its inputs, whitened.

    The inputs e = σ ε of an interval have the covariance of the unit matrix in ε.
    """
    interval = window.interval
    s, _, v, z, *_ = window.shapes
    B = interval.sparsities["B"]
    noise = window.noise

    @casadi_function("rhe_measured")
    def measured(s: s, z: z, noise: noise):
        hessian = ca.SX(interval.n_s, interval.n_s)
        for output in interval.outputs:
            H = output.slope(s, z)
            hessian += H.T @ H * (output.is_valid(z) / noise["V"][output.row])
        # Inputs are whitened, and those that a stage has too many of cost something, too.
        return dict(hessian=ca.densify(ca.diagcat(hessian, ca.SX.eye(shape.m))))

    @casadi_function("rhe_whitened")
    def whitened(B: B, v: v, z: z, noise: noise):
        _, R_v = interval.input_noise(z, v, **noise)
        sigma = ca.sqrt(R_v)
        columns = ca.horzcat(B @ ca.diag(sigma), ca.SX(interval.n_s, shape.m - interval.n_v))
        return dict(columns=ca.project(columns, shape.B), sigma=sigma)

    return measured, whitened


def _build_first(window, shape):
    """The stage before the window, whose inputs are d_0, with the weight P⁻¹ of the arrival."""
    n = shape.n

    @casadi_function("rhe_first_stage", P=(n, n))
    def first(P):
        weight = ca.ldl_solve(ca.SX.eye(n), *ca.ldl(P, False))
        hessian = ca.diagcat(ca.SX(n, n), weight, ca.SX.eye(shape.m - n))
        return dict(hessian=ca.densify(hessian))

    return first


def _closed(window, s, F, D):
    """The nodes s° of the linearisation point with its gaps closed: its inputs from its first."""
    closed = [s[0]]
    for i in range(window.N):
        A = window.interval.A_0 + D[i]
        closed.append(F[i] + A @ (closed[i] - s[i]))
    return closed


def _bounds_of_stages(window, closed):
    """lower and upper (n_rows, N + 2) of d: none before the window."""
    interval = window.interval
    places = [*interval.bounds]
    n_p = len(window.model.parameters)
    newest_only = [place >= interval.n_s - n_p and not window.noisy for place in places]
    for side, none in ((0, -MAX_QP_ENTRY), (1, MAX_QP_ENTRY)):
        bounds = ca.DM([bound[side] for bound in interval.bounds.values()])
        columns = [ca.DM.ones(len(places)) * none]
        for i, node in enumerate(closed):
            counts = ca.DM([i == window.N or not newest for newest in newest_only])
            columns.append(ca.if_else(counts, bounds - node[places], none))
        yield ca.horzcat(*columns)


def _gradient(shape, hessians, d, e):
    """-H (d*, ε*) of the stages: of the one before the window, of intervals, of the newest node."""
    points = [(ca.MX.zeros(shape.n), d[0]), *zip(d[:-1], e), (d[-1], ca.MX(0, 1))]
    columns = []
    for hessian, (state, inputs) in zip(hessians, points):
        unused = ca.MX.zeros(shape.m - inputs.numel())
        columns.append(-hessian @ ca.vertcat(state, inputs, unused))
    return ca.horzcat(*columns)


def _dynamics(shape, D, columns):
    """D, B and the rows G of all stages; the inputs of the first one are d_0."""
    before = ca.horzcat(ca.DM.eye(shape.n), ca.DM(shape.n, shape.m - shape.n))
    before = ca.project(before, shape.B)
    no_D = ca.DM(shape.D, 0)
    return dict(
        D=ca.horzcat(no_D, *D, no_D),
        B=ca.horzcat(before, *columns, before),  # after the newest node nothing counts
        G=ca.repmat(ca.DM(shape.G, 1), 1, shape.N + 1),
    )


def _build_qp(window):
    """The Function of the QP: (memory, noises, filtered, z_N, s*, v*) -> (s, v, kkt, ok)."""
    N = window.N
    n_v = window.interval.n_v
    shape = _shape_of(window)
    n = shape.n
    measured, whitened = _build_stage(window, shape)
    first = _build_first(window, shape)
    solve = interior_point(shape)
    pieces = {name: getattr(window.pieces, name) for name in ("s", "v", "z", "P")}
    sparse = {name: ca.repmat(each, 1, N) for name, each in window.interval.sparsities.items()}
    best = dict(s_best=pieces["s"], v_best=pieces["v"])

    @casadi_function("rhe_window_qp", ca.MX, **pieces, **sparse, **best, noises=window.noises)
    def qp(s, v, z, P, F, D, B, s_best, v_best, noises):
        s, v, z, F, D = map(ca.horzsplit, (s, v, z, F, D), (1, 1, 1, 1, n))
        B = ca.horzsplit(B, [i * n_v for i in range(N + 1)])  # of no width without inputs
        at = [[*window.at(i, **noises).values()] for i in range(N + 1)]
        closed = _closed(window, s, F, D)
        inputs = [whitened(B[i], v[i], z[i + 1], *at[i + 1]) for i in range(N)]
        columns, sigmas = zip(*inputs)
        hessians = [first(P), *(measured(s[i], z[i], *at[i]) for i in range(N + 1))]
        d = [best - node for best, node in zip(ca.horzsplit(s_best), closed)]
        e = [(v_best[:, i] - v[i]) / sigmas[i] for i in range(N)]
        g = _gradient(shape, hessians, d, e)
        lower, upper = _bounds_of_stages(window, closed)
        rows = dict(H=ca.horzcat(*hessians), g=g, lower=lower, upper=upper)
        solution = solve(**_dynamics(shape, D, columns), **rows)
        x = solution["z"]
        s_new = ca.horzcat(*closed) + x[:n, 1:]
        v_new = [v[i] + sigmas[i] * x[n : n + n_v, i + 1] for i in range(N)]
        kkt = ca.fabs(ca.dot(g, x)) + solution["complementarity"]
        return dict(s_new=s_new, v_new=ca.horzcat(*v_new), qp_kkt=kkt, qp_solved=solution["solved"])

    return qp


def with_bounds(window, phases, next_window):
    """The phases {shift, linearise, feedback, expand} within the bounds of all nodes.

    Args:
        window: The rhe.Window.
        phases: The phases of the same window without bounds, see `without_bounds`.
        next_window: `rhe._build_next_window`.
    """
    qp = _build_qp(window)
    feedback = _build_feedback(window, phases, qp)
    from_feedback = ("s_window", "v_window", "qp_kkt", "ok")
    shapes = {name: feedback.sparsity_out(name) for name in from_feedback}
    shapes |= {name: phases["expand"].sparsity_in(name) for name in ("z_N", "P_0")}

    @casadi_function("bounded_expand", ca.MX, **window.pieces._asdict(), **shapes)
    def expand(s_window, v_window, qp_kkt, ok, z_N, P_0, **memory):
        memory["z"] = ca.horzcat(memory["z"][:, : window.N], z_N)
        new = dict(s_new=s_window, v_new=v_window)
        return next_window(**memory, **new, kept=ok, P_0=P_0) | dict(kkt=qp_kkt)

    return dict(
        shift=phases["shift"], linearise=phases["linearise"], feedback=feedback, expand=expand
    )


def _build_feedback(window, phases, qp):
    """The feedback, which ends with the QP of the whole window."""
    free = phases["feedback"]
    smooth = phases["expand"]
    shapes = {
        name: smooth.sparsity_in(name) for name in smooth.name_in() if name not in free.name_out()
    }
    shapes |= {name: free.sparsity_in(name) for name in free.name_in()}

    @casadi_function("bounded_feedback", ca.MX, **shapes)
    def feedback(**inputs):
        found = free(**select_inputs(free, inputs))
        of_window = inputs | found | dict(z=ca.horzcat(inputs["z"][:, : window.N], inputs["z_N"]))
        smoothed = smooth(**select_inputs(smooth, of_window))
        best = dict(s_best=smoothed["s"], v_best=smoothed["v"])
        solution = qp(**select_inputs(qp, of_window), **best)
        restarted = smoothed["age"] != inputs["age"]
        s = _clipped(window, solution["s_new"])
        v = solution["v_new"]
        ok = found["ok"] * ca.logic_not(restarted) * solution["qp_solved"]
        ok = ok * is_plausible(ca.veccat(s, v))
        last = ca.if_else(ok, s[:, -1], _clipped(window, inputs["s"])[:, -1])
        v_last = ca.if_else(ok, v[:, -1], inputs["v"][:, -1])
        results = dict(estimate=_estimate(window, last, v_last), ok=ok)
        results |= {name: found[name] for name in ("covariance", "deviance")}
        return results | dict(s_window=s, v_window=v, qp_kkt=solution["qp_kkt"])

    return feedback


def _clipped(window, s):
    """The nodes s, in which rounding errors pass no bound."""
    rows = ca.vertsplit(s)
    for place, (lower, upper) in window.interval.bounds.items():
        within = ca.fmin(ca.fmax(rows[place], lower), upper)
        is_state = place < len(window.model.states)
        before = within if is_state or window.noisy else rows[place]
        rows[place] = ca.horzcat(before[:-1], within[-1])
    return ca.vertcat(*rows)


def _estimate(window, s, v):
    """States, inputs and parameters, from the newest node and the last input."""
    values = dict(zip(window.model.inputs, ca.vertsplit(v)))
    values |= dict(zip(window.model.joint_names, ca.vertsplit(s)))
    return ca.vertcat(*(values[name] for name in window.model.names))
