"""From ẋ = f(x, u, p) to the state at the end of an interval: Runge-Kutta rules, with substeps.

A rule multiplies a mode of the model, λ, by R(h λ) in a step h. The classical explicit rule "rk4"
has |R| <= 1 only where |h λ| is below about 2.8, and grows without limit beyond. The implicit
Radau IIA rules have |R| < 1 wherever Re λ < 0, and R = 0 at infinity: they are for stiff models
(Hairer, Wanner, "Solving Ordinary Differential Equations II", 1996, Sec. IV.5).
"""

import functools
import math
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.c_text import LARGE
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE

Rule = Literal["rk4", "radau3", "radau5"]
RULES = ("rk4", "radau3", "radau5")
STAGES = {"radau3": 2, "radau5": 3}  # of the implicit rules; the order is twice that, minus one
NEWTON_STEPS = 4  # for the stages of a nonlinear model; a linear one needs a single step
MAX_GROWTH = 1.1  # in an interval, of what the model itself does not let grow
_MOST_STEPS = 1000  # that a refusal proposes
_POWERS = (8, 16)  # of a matrix, whose traces tell its largest mode
_HALVINGS = 6  # of an interval, for the exact flow
_ALIKE = 0.1  # largest mode, times the step, by which slopes at the stages may differ


class Step(NamedTuple):
    """A state at the end of a step, and its derivatives if the rule supplies them."""

    x: Any  # (n_x,)
    jacobian: Any = None  # (n_x, n_x + n_u + n_p) by (x, u, p); None: to be differentiated


def integrate(model, x, u, p, dt_s):
    """The Step over an interval of dt_s [s] with constant u, as the Model's rule computes it.

    A discrete Model takes one step f of its own, and none in an interval of no length.
    """
    f = model.dynamics
    if model.discrete:
        return Step(ca.if_else(dt_s > 0, f(x, u, p), x))
    if model.rule == "rk4":
        for _ in range(model.steps):
            x = rk4(f, x, u, p, dt_s / model.steps if model.steps > 1 else dt_s)
        return Step(x)
    return _integrate_implicitly(model, x, u, p, dt_s / model.steps)


def rk4(f, x, u, p, dt_s):
    """One classical Runge-Kutta step, eq. (3): x at the end of an interval dt_s with constant u.

    x⁺ = x + dt_s/6 (k₁ + 2 k₂ + 2 k₃ + k₄), where f maps (x, u, p) to ẋ.
    """
    k1 = f(x, u, p)
    k2 = f(x + dt_s / 2 * k1, u, p)
    k3 = f(x + dt_s / 2 * k2, u, p)
    x_4 = x + dt_s / 2 * k3 + dt_s / 2 * k3
    k4 = f(x_4, u, p)
    mean = x + dt_s * (1 / 6) * (k1 + 2 * k2 + 2 * k3 + k4)
    # A state with a constant slope, such as a yaw angle, ends where stage 4 is evaluated. That
    # expression avoids a second sum of the same value inside later sines.
    slopes = zip(ca.vertsplit(k1), ca.vertsplit(k4))
    is_constant = [ca.is_equal(first, last, 9) for first, last in slopes]
    return ca.vertcat(*(x_4[i] if same else mean[i] for i, same in enumerate(is_constant)))


def butcher(n_stages):
    """Coefficients A (n, n) and weights b (n,) of the Radau IIA rule of n stages.

    Its stages are where the Radau polynomial is zero, and its last one is the step's end: the last
    row of A is b.
    """
    points = ca.collocation_points(n_stages, "radau")
    powers = np.arange(1, n_stages + 1)
    # Exact for polynomials: Σ_j a_ij c_j^(k-1) = c_i^k / k.
    values = np.power.outer(points, powers - 1)
    integrals = np.power.outer(points, powers) / powers
    A = np.linalg.solve(values.T, integrals.T).T
    return A, A[-1]


def _integrate_implicitly(model, x_0, u_0, p_0, h):
    """The Step by `steps` steps of a Radau rule, its Jacobian by the chain rule."""
    step = _radau_step(model)
    x = x_0
    widths = [part.numel() for part in (x_0, u_0, p_0)]
    jacobian = ca.horzcat(ca.SX.eye(widths[0]), ca.SX(widths[0], sum(widths[1:])))
    for _ in range(model.steps):
        x, by_all = step(x, u_0, p_0, h)
        by_x = by_all[:, : widths[0]]
        unmoved = ca.horzcat(ca.SX(widths[0], widths[0]), by_all[:, widths[0] :])
        jacobian = by_x @ jacobian + unmoved
    return Step(x, jacobian)


def _radau_step(model):
    """Function (x, u, p, h) -> (x⁺, ∂x⁺/∂(x, u, p)) of one Radau IIA step h [s].

    The slopes k of the stages solve G(k) = 0, with

        G_i(k) = k_i - f(x + h Σ_j a_ij k_j, u, p),   x⁺ = x + h Σ_i b_i k_i,

    by a fixed number of Newton steps from stages that stay at x. The derivatives follow from
    ∂k/∂w = -(∂G/∂k)⁻¹ ∂G/∂w, with the factorisation of the last Newton step.
    """
    f = model.dynamics
    A, b = butcher(STAGES[model.rule])
    x, u, p = symbols = f.sx_in()
    h = ca.SX.sym("h")
    n_x = x.numel()
    k = ca.SX.sym("k", n_x, len(b))
    states = (x + h * (k @ A[i]) for i in range(len(b)))
    residual = ca.vertcat(*(k[:, i] - f(state, u, p) for i, state in enumerate(states)))
    by_k = ca.jacobian(residual, ca.vec(k))
    by_all = ca.jacobian(residual, ca.vertcat(*symbols))
    newton = ca.Function("newton", [ca.vec(k), *symbols, h], [residual, by_k, by_all])
    is_linear = not ca.depends_on(ca.jacobian(f(*symbols), x), x)
    slopes = ca.SX.zeros(n_x * len(b))
    for _ in range(1 if is_linear else NEWTON_STEPS):
        G, G_k, G_w = newton(slopes, *symbols, h)
        solved = _solve_by_states(G_k, ca.horzcat(G, G_w), n_x)
        slopes = slopes - solved[:, 0]
    weights = h * ca.kron(ca.DM(b).T, ca.DM.eye(n_x))
    unmoved = ca.horzcat(ca.SX.eye(n_x), ca.SX(n_x, u.numel() + p.numel()))
    outputs = [x + weights @ slopes, unmoved - weights @ solved[:, 1:]]
    return ca.Function("radau", [*symbols, h], outputs, {"cse": True})


def _solve_by_states(matrix, right, n_x):
    """The solution of matrix · y = right, whose rows and unknowns are those of stages of n_x.

    Elimination state by state, with a block of all stages as pivot and without exchanges, keeps
    the model's sparsity. For a single state, a Radau rule's block is never singular.
    """
    states = [list(range(i, matrix.size1(), n_x)) for i in range(n_x)]
    blocks = {}
    for i, rows in enumerate(states):
        for j, columns in enumerate(states):
            block = ca.sparsify(matrix[rows, columns])
            if block.nnz():
                blocks[i, j] = block
    rest = [right[rows, :] for rows in states]
    inverse = [None] * n_x
    for i in range(n_x):
        inverse[i] = ca.inv_minor(ca.densify(blocks[i, i]))
        after = [j for j in range(i + 1, n_x) if (i, j) in blocks]
        for row in (row for row in range(i + 1, n_x) if (row, i) in blocks):
            factor = blocks[row, i] @ inverse[i]
            for j in after:
                blocks[row, j] = blocks.get((row, j), 0) - factor @ blocks[i, j]
            rest[row] = rest[row] - factor @ rest[i]
    for i in reversed(range(n_x)):
        for j in (j for j in range(i + 1, n_x) if (i, j) in blocks):
            rest[i] = rest[i] - blocks[i, j] @ rest[j]
        rest[i] = inverse[i] @ rest[i]
    order = [place for rows in states for place in rows]
    return ca.vertcat(*rest)[list(np.argsort(order)), :]


def refuse_unstable_step(model, x, u, p, dt_s, sigma_p=None):
    """Refuse a Model whose rule lets grow what the model itself does not.

    It is checked at this point, and at it with each parameter at either of its bounds; where there
    is none, two standard deviations `sigma_p` away, if these are given. An estimate would not find
    out by itself, since beside an interval that grows any other fits better.

    The modes λ are the eigenvalues of ∂f/∂x at (x, u, p). A classical Runge-Kutta interval of k
    substeps multiplies them by R(λ dt_s/k)^k, the model by e^(λ dt_s). The implicit rules and
    discrete Models have nothing to refuse, nor has a point where f has no finite derivatives.

    Raises:
        ValueError: If the largest |R^k| is above MAX_GROWTH, and as much above |e^(λ dt_s)|.
    """
    if model.discrete or model.rule != "rk4":
        return
    points = {"the first guess": list(p)}
    for place, (name, bounds) in enumerate(model.parameters.items()):
        for side, bound in zip((-1, 1), bounds or (-math.inf, math.inf)):
            where = f"{name} = {bound:g}, its bound"
            if abs(bound) > MAX_PLAUSIBLE_STATE:
                if sigma_p is None:
                    continue
                bound = p[place] + side * 2 * sigma_p[place]
                where = f"{name} = {bound:g}, its guess and two standard deviations"
            points[where] = [*p[:place], bound, *p[place + 1 :]]
    for where, parameters in points.items():
        _refuse_growth(model, np.array(model.slopes(x, u, parameters)), dt_s, where)


def _refuse_growth(model, by_x, dt_s, where):
    """Refuse the Model if its rule lets grow, with this ∂f/∂x, what the model does not."""
    if not np.all(np.isfinite(by_x)):
        return
    modes = np.linalg.eigvals(by_x) * dt_s
    allowed = MAX_GROWTH * max(1.0, math.exp(min(max(modes.real), 700.0)))
    growth = _growth(modes, model.steps)
    if growth <= allowed:
        return
    enough = next((k for k in range(1, _MOST_STEPS) if _growth(modes, k) <= allowed), None)
    more = f"steps={enough} or " if enough else ""
    raise ValueError(
        f"dt was {dt_s:g}; in that time Runge-Kutta with steps={model.steps} multiplies an error of"
        f" the state by {growth:.3g} at {where}, where the model damps it: a Model with"
        f" {more}the implicit rule='radau3' would help"
    )


def growth_function(model, dt_s):
    """The Function (x, u, p) -> 1 where the rule lets grow what the model does not; or None.

    It is the criterion of `refuse_unstable_step` without eigenvalues, for compiled code, and also
    that of the rule itself, whose stages may lie where ∂f/∂x is another. For each block A (n, n) of
    ∂f/∂x whose states depend on each other in a circle, an error of them is multiplied

    - by M = R(A dt_s/k)^k, where the model allows E ≈ e^(A dt_s);
    - by M = ∂F/∂x of the rule F, where the same rule with four times the substeps allows E.

    A mode grows where for a j, with g = max_i (|tr E^i| / n)^(1/i) of all blocks,

        |tr M^j| > n (MAX_GROWTH max(1, g))^j

    None is needed where nothing can grow: for an implicit rule, a discrete Model, without such a
    block, or with constant ones, which were checked when the estimator was made.
    """
    if model.discrete or model.rule != "rk4":
        return None
    symbols = model.slopes.sx_in()
    by_x = ca.sparsify(model.slopes(*symbols))
    groups = _circles(by_x)
    blocks = [by_x[group, group] for group in groups]
    if all(block.is_constant() for block in blocks):
        return None
    depends = any(ca.depends_on(block, symbols[0]) for block in blocks)
    names = ["x", "u", "p"], ["grows"]
    may_grow = _build_may_grow(model, dt_s, groups)
    whole = ca.Function("grows_whole", *_whole_check(model, dt_s, groups, depends), *names)
    x, u, p = whole.mx_in()
    nothing = ca.Function("grows_not", [x, u, p], [ca.MX(0)], *names)
    checked = ca.Function.if_else("grows_or_not", whole, nothing)
    return ca.Function("grows", [x, u, p], [checked(may_grow(x, u, p), x, u, p)], *names)


def _whole_check(model, dt_s, groups, depends):
    """The inputs and the result of the check of `growth_function`, with products as loops."""
    symbols = [ca.MX.sym(name, model.slopes.sparsity_in(i)) for i, name in enumerate("xup")]
    by_x = model.slopes(*symbols)
    blocks = [by_x[group, group] * dt_s for group in groups]

    step = _build_step_and_slopes(model)

    def steps_of(steps):
        """Blocks of ∂F/∂x of the rule with so many substeps."""
        x, u, p = symbols
        rule = ca.MX.eye(x.numel())
        for _ in range(steps):
            x, slopes = step(x, u, p, dt_s / steps)
            rule = slopes @ rule
        return [rule[group, group] for group in groups]

    linear = [_grown(block / model.steps, model.steps) for block in blocks]
    grows = _grows_more(linear, [_flow(block) for block in blocks])
    if depends:  # otherwise the two are the same
        more = _grows_more(steps_of(model.steps), steps_of(4 * model.steps))
        grows = ca.logic_or(grows, more)
    return symbols, [grows]


def _build_step_and_slopes(model):
    """(x, u, p, h) -> the state after one step h [s] of the rule, and its slopes by x, dense."""
    x, u, p = symbols = model.slopes.sx_in()
    h = ca.SX.sym("h")
    after = rk4(model.dynamics, x, u, p, h)
    slopes = ca.densify(ca.jacobian(after, x))
    return ca.Function("step_and_slopes", [*symbols, h], [after, slopes], {"cse": True})


def _build_may_grow(model, dt_s, groups):
    """(x, u, p) -> 0 where bounds tell that nothing grows, so that no product is needed.

    The largest mode of A is at most max_i √(R_i C_i), with the sums R of its rows and C of its
    columns (Ostrowski, 1951), in any unit. With h A below 1 at all stages of the rule, and nearly
    the same there, R(h A) is e^(h A) within a hundredth.
    """
    x, u, p = symbols = model.slopes.sx_in()
    h = dt_s / model.steps
    f = model.dynamics
    may = 0
    for _ in range(model.steps):
        k1 = f(x, u, p)
        k2 = f(x + h / 2 * k1, u, p)
        k3 = f(x + h / 2 * k2, u, p)
        stages = [x, x + h / 2 * k1, x + h / 2 * k2, x + h * k3]
        slopes = [ca.sparsify(model.slopes(stage, u, p)) for stage in stages]
        for group in groups:
            first = slopes[0][group, group]
            for other in slopes:
                block = other[group, group]
                is_small = _largest_mode(h * block) <= 1
                is_alike = _largest_mode(h * (block - first)) <= _ALIKE
                may = ca.logic_or(may, 1 - is_small * is_alike)
        x = rk4(f, x, u, p, h)
    return ca.Function("may_grow", symbols, [may], {"cse": True})


def _largest_mode(matrix):
    """A bound of the largest mode."""
    matrix = ca.fabs(matrix)
    squares = ca.densify(ca.sum2(matrix)) * ca.densify(ca.sum1(matrix)).T
    return ca.sqrt(ca.mmax(squares))


def _circles(matrix):
    """Groups of places whose diagonal blocks have all eigenvalues that need not be 0."""
    n_groups, order, ends = matrix.sparsity().scc()
    groups = (order[ends[k] : ends[k + 1]] for k in range(n_groups))
    return [group for group in groups if matrix[group, group].nnz()]


def _grows_more(blocks, allowed_blocks):
    """Whether a mode of one of the blocks is above MAX_GROWTH, and as much above all allowed."""
    allowed = 1
    for block in allowed_blocks:
        for power, mean in _mean_traces(block):
            allowed = ca.fmax(allowed, mean ** (1 / power))
    grows = 0
    for block in blocks:
        for _, mean in _mean_traces(block / (MAX_GROWTH * allowed)):
            grows = ca.logic_or(grows, mean > 1)
    return grows


def _grown(z, steps):
    """R(z)^steps of a matrix z (n, n): what the classical rule makes of an error."""
    unit = ca.DM.eye(z.size1())
    once = unit + z @ (unit + z / 2 @ (unit + z / 3 @ (unit + z / 4)))
    return functools.reduce(ca.mtimes, [once] * steps)


def _flow(z):
    """About e^z of a matrix z (n, n), by a rule that damps whatever the model damps."""
    n = z.size1()
    if n < LARGE:
        symbol = ca.SX.sym("z", n, n)
        unit = ca.SX.eye(n)
        inverse = ca.densify(ca.solve(unit - symbol / 2**_HALVINGS, unit))
        flow = ca.Function("implicit", [symbol], [inverse], {"cse": True})(ca.densify(z))
    else:
        unit = ca.DM.ones(n, n) * ca.DM.eye(n)
        flow = ca.solve(unit - ca.densify(z) / 2**_HALVINGS, unit, "qr")
    for _ in range(_HALVINGS):
        flow = flow @ flow
    return flow


def _mean_traces(matrix):
    """(j, |tr matrix^j| / n) for j in _POWERS: of two modes e^(±iφ), at most one is near 0."""
    power = 1
    while power < max(_POWERS):
        matrix = matrix @ matrix
        power *= 2
        if power in _POWERS:
            yield power, ca.fabs(ca.trace(matrix)) / matrix.size1()


def _growth(modes, steps):
    """The largest |R(λ h)|^steps over the modes λ·dt_s, where h = dt_s/steps."""
    z = modes / steps
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.max(np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) ** steps))
