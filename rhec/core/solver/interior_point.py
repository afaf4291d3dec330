"""A QP with bounds on states, outputs and inputs: an interior point along its stages.

    min  Σ_{k=0..N} ½ z_k' H_k z_k + g_k' z_k + Σ price(t),   price(t) = linear·t + ½ quadratic·t²
    s.t. z_k = (x_k, u_k), x_0 = 0, x_{k+1} = A_k x_k + B_k u_k,
         lower_k - t ≤ G_k z_k ≤ upper_k + t, with t ≥ 0 for soft rows and t = 0 for hard ones

A soft row without a price is one that has to be kept, if it can be: it gets a linear price so far
above any multiplier that its solution is that of a hard row, where there is one (an exact penalty,
Fletcher, "Practical Methods of Optimization", 1987, Sec. 14.3). With hard rows on inputs alone the
QP therefore always has a solution.

Mehrotra's predictor and corrector ("On the Implementation of a Primal-Dual Interior Point Method",
1992; by stages: Rao, Wright, Rawlings, "Application of Interior-Point Methods to Model Predictive
Control", 1998). An iteration factorises once by a Riccati recursion, and solves twice with it; the
excess t of soft rows is eliminated in closed form. The states always follow the dynamics.
The corrector has a share α of the predictor's second order, the one that this may go alone: with
all of it, iterations may cycle (weights of correctors: Colombo, Gondzio, "Further Development
of Multiple Centrality Correctors for Interior Point Methods", 2008).

Each row has two sides e'z + s = b + t with a distance s ≥ 0, its multiplier λ ≥ 0 and, in a soft
row, the excess t ≥ 0 with its multiplier γ ≥ 0. A side without a bound has λ = 0 and no influence.

Close to a bound, w = λ / s grows without limit, and the recursion would lose the digits of all
other numbers. A multiplier's change therefore costs ½ δ dλ² (Friedlander and Orban, "A Primal-Dual
Regularized Interior-Point Method for Convex Quadratic Programs", 2012), which limits w to 1 / δ and
vanishes at the solution.
"""

import functools
from typing import Any, NamedTuple

import casadi as ca

from rhec.core._casadi.build import casadi_function, every, in_turn, select_inputs
from rhec.core._casadi.compiled import loop_symbols
from rhec.core.model.limits import MAX_QP_ENTRY, TINY
from rhec.core.solver.gauss_newton import symmetric

_DOUBLINGS = 5
MAX_ITERATIONS = 2**_DOUBLINGS  # then the search gives up; 8 to 15 are usual
_CONVERGED = 1e-12  # mean of λ s and γ t, and error of the rows, at the end, relative to the start
_LEAST_TARGET = 0.1 * _CONVERGED  # of λ s, so far below the end that the search reaches it
_OPTIMAL = 1e-20  # the same of what is left to gain, which is of second order
_TOLERANCE = 1e-7  # mean of λ s and γ t, and error of the rows, of a solution
_TOLERANCE_GAIN = 1e-14
_TO_BOUNDARY = 0.995  # share of the way to the nearest boundary that a step may go
_NEAREST = 0.1  # smallest first distance to a bound, as a share of the row's largest
_PROXIMAL = 1e-5  # δ relative to the compliance of a row
_OF_FIRST = 1e-3  # share of the first w = λ / s that δ has to be small beside, too
_LEAST_GAIN = 1e-6  # share of what each entry of g would gain alone that rounding may hide
_LEAST_SCALE = 1e-3  # smallest scale of a row, as a share of the way that the free QP moves it
_OWN_PRICE = 1e3  # over the least slope that moves a row as the free QP does
_KEPT = 1e-6  # excess of a row without a price, relative to its scale, up to which it is kept
NO_PRICE = MAX_QP_ENTRY
_NO_BOUND = 0.1 * MAX_QP_ENTRY


class Shape(NamedTuple):
    """The structure of the QP: its sizes, and constants and sparsities of its stages."""

    N: int  # intervals; node N has an input, too, which changes nothing
    A_0: Any  # (n, n) constant entries of A = A_0 + D
    D: ca.Sparsity  # (n, n)
    B: ca.Sparsity  # (n, m)
    G: ca.Sparsity  # (n_rows, n + m), with the soft rows last
    n_soft: int

    @property
    def n(self):
        """Number of states."""
        return self.B.size1()

    @property
    def m(self):
        """Number of inputs."""
        return self.B.size2()

    @property
    def n_rows(self):
        """Number of rows."""
        return self.G.size1()

    @property
    def n_hard(self):
        """Number of hard sides. These come first; of hard and of soft sides, the upper come first.

        So the order is: hard upper, hard lower, soft upper, soft lower.
        """
        return 2 * (self.n_rows - self.n_soft)

    @property
    def side(self):
        """Shape of one number for each side."""
        return (2 * self.n_rows, 1)

    @property
    def soft(self):
        """Shape of one number for each soft side."""
        return (2 * self.n_soft, 1)

    @property
    def stage(self):
        """Shapes of a stage's data: e' of all sides are the rows of E."""
        n_z = self.n + self.m
        places = [0, self.n_hard // 2, self.n_rows]
        hard, soft = ca.vertsplit(ca.DM(self.G, 1), places)
        E = ca.vertcat(hard, hard, soft, soft).sparsity()
        return dict(D=self.D, B=self.B, H=(n_z, n_z), g=(n_z, 1), E=E, b=self.side)

    @property
    def price(self):
        """Shapes of the excess' prices, of δ and of the rows' scales, which hold at all nodes."""
        return dict(linear=self.soft, quadratic=self.soft, delta=self.side, widest=self.side)

    @property
    def point(self):
        """Shapes of a stage's unknowns (z, s, λ, t, γ)."""
        return dict(z=(self.n + self.m, 1), s=self.side, lam=self.side, t=self.soft, gam=self.soft)

    @property
    def aim(self):
        """Shapes of what λ s and γ t should become: target - e_s and target - e_t."""
        return dict(target=(1, 1), e_s=self.side, e_t=self.soft)

    @property
    def policy(self):
        """Shapes of the feedback K of a stage's input, and of `_inverse_root` of its Hessian."""
        return dict(K=(self.m, self.n), root=ca.Sparsity.lower(self.m))

    def of_all_nodes(self, shapes):
        """Shapes of matrices of the nodes side by side."""
        sparsities = {
            name: each if isinstance(each, ca.Sparsity) else ca.Sparsity.dense(*each)
            for name, each in shapes.items()
        }
        return {name: ca.repmat(each, 1, self.N + 1) for name, each in sparsities.items()}

    def by_node(self, shapes, values):
        """The opposite: for each node, a dict of its matrices."""
        widths = (
            each.size2() if isinstance(each, ca.Sparsity) else each[1] for each in shapes.values()
        )
        parts = [ca.horzsplit(values[name], width) for name, width in zip(shapes, widths)]
        return [dict(zip(shapes, each)) for each in zip(*parts)]


def interior_point(shape):
    """Build the Function (D, B, H, …, upper, linear, quadratic, relief) -> (z, solved, …).

    It takes D, B, H, g, G, lower and upper of the nodes 0 … N side by side, and the prices
    (n_soft,) of the soft rows; a bound of ±1e20 is none, and so is a linear price of 1e20. The
    price of rows without one is lower by `relief` decades. Where no solution is found, `solved` and
    z are 0.

    Args:
        shape: The Shape of the QP.

    Returns:
        The Function. Its results are z (n + m, N+1), solved, the number of iterations,
        complementarity = Σ λ |b + t|, which is 0 at a solution z = 0, excess (n_soft,): how far
        rows without a price, which has to be kept, are exceeded, 0 for the others; and price
        (n_soft,), the linear ones, with that of rows without one.
    """
    problem = shape.of_all_nodes(shape.stage) | shape.price
    one = (1, 1)
    state = shape.of_all_nodes(shape.point)
    state |= dict(scale=one, gap=one, error=one, gain=one, iterations=one)
    start = _build_start(shape)
    search = _build_search(_build_iteration(shape, problem, state), problem, state)
    rows = (shape.n_rows, shape.N + 1)
    given = {name: problem[name] for name in "DBHg"}
    given |= dict(G=ca.repmat(shape.G, 1, shape.N + 1), lower=rows, upper=rows)
    given |= dict(linear=(shape.n_soft, 1), quadratic=(shape.n_soft, 1), relief=(1, 1))

    @casadi_function("interior_point", ca.MX, **given)
    def solve(G, lower, upper, linear, quadratic, relief, **stages):
        places = [0, shape.n_hard // 2, shape.n_rows]
        G, lower, upper = (ca.vertsplit(each, places) for each in (G, lower, upper))
        stages |= dict(
            E=ca.vertcat(G[0], -G[0], G[1], -G[1]),
            b=ca.vertcat(upper[0], -lower[0], upper[1], -lower[1]),
            linear=ca.repmat(linear, 2, 1),
            quadratic=ca.repmat(quadratic, 2, 1),
        )
        begin = start(**stages, relief=relief)
        end = search(**stages | begin)
        errors = ca.vertcat(end["gap"], end["error"], end["gain"] * _TOLERANCE / _TOLERANCE_GAIN)
        # The comparisons are also 0 where a number is none.
        solved = every(ca.fabs(errors) <= _TOLERANCE) * every(ca.fabs(end["z"]) < MAX_QP_ENTRY)
        distance = _bounded(stages["b"])[1] + _of_all_sides(shape, end["t"])
        complementarity = ca.sum1(ca.vec(end["lam"] * ca.fabs(distance)))
        results = dict(
            z=ca.if_else(solved, end["z"], 0), solved=solved, iterations=end["iterations"]
        )
        excess = _excess(shape, stages, begin["widest"], end["t"])
        price = ca.DM(0, 1)
        if shape.n_soft:
            price = ca.fmax(*ca.vertsplit(begin["linear"], shape.n_soft))
        return results | dict(complementarity=complementarity, excess=excess, price=price)

    return solve


def _bounded(b):
    """1 for each side that has a bound, and the bounds, 0 where there is none."""
    there = ca.fabs(b) < _NO_BOUND
    return there, ca.if_else(there, b, 0)


def _of_all_sides(shape, t):
    """The excess at all sides, from that at the soft ones."""
    return ca.vertcat(ca.DM.zeros(shape.n_hard, t.size2()), t)


def _excess(shape, stages, widest, t):
    """The largest excess of each soft row that has no price; 0 where rounding explains it."""
    there, _ = _bounded(stages["b"])
    exceeded = _largest(there[shape.n_hard :, :] * t)
    counts = (stages["linear"] >= _NO_BOUND) * (exceeded > _KEPT * widest[shape.n_hard :])
    return ca.fmax(*ca.vertsplit(counts * exceeded, shape.n_soft)) if shape.n_soft else ca.DM(0, 1)


def _largest(numbers):
    """The largest of each row; CasADi's mmax has no counterpart in lanes."""
    return functools.reduce(ca.fmax, ca.horzsplit(numbers))


def _widest(shape, b):
    """The largest distance of each side from z = 0 at any node, as a scale of its row.

    A side at which z = 0 is everywhere, such as a command at rest at its bound, takes that of the
    row's other side, or 1 if there is none.
    """
    own = _largest(ca.fabs(b))
    n_hard = shape.n_hard // 2
    pairs = ca.vertsplit(own, [0, n_hard, 2 * n_hard, 2 * n_hard + shape.n_soft, own.numel()])
    other = ca.vertcat(pairs[1], pairs[0], pairs[3], pairs[2])
    other = ca.if_else(other > TINY, other, 1)
    return ca.if_else(own > TINY, own, other) + TINY


def _band(shape, there, b):
    """How far the bounds of each hard row are apart, where they are nearest: no distance is more.

    If both distances began far beyond that, their multipliers would grow against each other.
    """
    places = [0, shape.n_hard // 2, shape.n_hard, 2 * shape.n_rows]
    upper, lower, _ = ca.vertsplit(ca.if_else(there, b, _NO_BOUND), places)
    least = -_largest(-(upper + lower))
    return ca.vertcat(least, least, _NO_BOUND * ca.DM.ones(*shape.soft))


def _build_start(shape):
    """The first point: z = 0, with λ s = γ t, and what stays the same: prices, δ, scales.

    `scale` is the cost that the QP without bounds gains, and what it costs to leave each row whose
    bound is exceeded at z = 0; all that ends the search is relative to it. λ s = γ t is that, and
    the price of the excess at z = 0.
    """
    shapes = shape.of_all_nodes(shape.stage)
    shapes |= dict(linear=shape.soft, quadratic=shape.soft, relief=(1, 1))
    without_bounds = _build_without_bounds(shape)

    @casadi_function("qp_start", loop_symbols(), **shapes)
    def start(**given):
        there, b = _bounded(given["b"])
        stages = shape.by_node(shape.stage, given)
        cost, compliance = without_bounds(stages)
        stiffness = ca.if_else(compliance > TINY, 1 / ca.fmax(compliance, TINY), 0)
        scale = cost + ca.dot(stiffness, ca.sum2(ca.fmin(b, 0) ** 2)) / 2 + _hidden(stages) + TINY
        # A bound that rounding alone keeps away, such as at rest on it, has no scale of its own.
        free_way = ca.sqrt(scale * compliance)
        band = _band(shape, there, b)
        widest = ca.fmin(ca.fmax(_widest(shape, b), _LEAST_SCALE * free_way), band)
        own = _OWN_PRICE * ca.sqrt(scale * stiffness[shape.n_hard :])
        own *= 10 ** -given["relief"]
        own += _pushed(shape, given, b, compliance, stiffness)
        price = dict(linear=ca.if_else(given["linear"] < _NO_BOUND, given["linear"], own))
        price |= dict(quadratic=given["quadratic"])
        linear, quadratic = (ca.repmat(each, 1, shape.N + 1) for each in price.values())
        soft = there[shape.n_hard :, :]
        exceeded = soft * ca.fmax(-b[shape.n_hard :, :], 0)
        first = scale + ca.dot(linear, exceeded) + ca.dot(quadratic, exceeded**2) / 2
        # A multiplier grows up to its price or the own one, and those of hard rows as these push
        # them. δ has to be small beside that, too.
        highest = ca.fmin(price["linear"], own)
        push = ca.sum1(highest * ca.sqrt(compliance[shape.n_hard :]))
        highest = ca.vertcat(push * ca.sqrt(stiffness[: shape.n_hard]), highest)
        steepness = highest / (widest + free_way)
        delta = _PROXIMAL / (stiffness + _OF_FIRST * first / widest**2 + steepness)
        nearest = ca.repmat(_NEAREST * widest, 1, shape.N + 1)
        near = nearest[shape.n_hard :, :]
        # If a price is high, λ s = γ t needs a small t, but not where the bound is exceeded.
        t = ca.fmax(first / (linear + quadratic * near + first / near), exceeded)
        gam = ca.fmax(first / t, linear + quadratic * t)
        s = ca.fmax(b + _of_all_sides(shape, t), nearest)
        s = ca.if_else(there, ca.fmin(s, ca.repmat(band, 1, shape.N + 1)), 1)
        point = dict(z=ca.DM.zeros(shape.n + shape.m, shape.N + 1), s=s, lam=there * first / s)
        point |= dict(t=ca.if_else(soft, t, 1), gam=ca.if_else(soft, gam, 1))
        constant = price | dict(delta=delta, widest=widest)
        return constant | point | dict(scale=scale, gap=1, error=1, gain=1, iterations=0)

    return start


def _pushed(shape, given, b, compliance, stiffness):
    """By how much rows with prices may push one without a price, as a price of that row (n_soft,).

    They push at every node, each with its price times the way of the row for a multiplier of one,
    and what they do to a command's changes adds up along the horizon once more.
    """
    soft = slice(shape.n_hard, None)
    beyond = _largest(ca.fmax(-b[soft, :], 0))
    linear = ca.if_else(given["linear"] < _NO_BOUND, given["linear"], 0)
    asked = linear + given["quadratic"] * beyond
    push = (shape.N + 1) ** 2 * ca.sum1(asked * ca.sqrt(compliance[soft]))
    return push * ca.sqrt(stiffness[soft])


def _build_without_bounds(shape):
    """A function of the stages: what the QP without bounds gains, and each row's compliance."""
    factor = _build_factor(shape)
    vector = _build_vector(shape)
    comply = _build_compliance(shape)

    def without_bounds(stages):
        cost = 0
        P = ca.DM.zeros(shape.n, shape.n)
        p = ca.DM.zeros(shape.n)
        policies = [None] * len(stages)
        for k, stage in reversed(list(enumerate(stages))):
            P, *policy = factor(P, ca.DM.zeros(*shape.side), *select_inputs(factor, stage).values())
            p, _, cost = vector(p, cost, stage["g"], stage["D"], stage["B"], *policy)
            policies[k] = policy
        W = ca.DM.zeros(shape.n, shape.n)
        compliance = ca.DM.zeros(*shape.side)
        for stage, policy in zip(stages, policies):
            W, compliance = comply(W, compliance, *select_inputs(comply, stage).values(), *policy)
        return cost, compliance

    return without_bounds


def _build_search(iterate, problem, state):
    """Iterations until one converges or MAX_ITERATIONS are done."""

    def has_ended(inputs, after):
        # Where rounding keeps the error of a row, more iterations would not lower it.
        is_kept = (after["error"] <= _TOLERANCE) * (after["error"] > inputs["error"] / 2)
        error = ca.if_else(is_kept, 0, after["error"])
        worst = ca.fmax(ca.fmax(after["gap"], error) - _CONVERGED, after["gain"] - _OPTIMAL)
        # A comparison with a number that is none is false: then the search has ended as well.
        return ca.logic_not(worst > 0)

    then = in_turn("qp_search", problem | state, state, has_ended)
    search = iterate
    for doubling in range(_DOUBLINGS):
        search = then(doubling, search, search)
    return search


def _build_factor(shape):
    """One stage of the Riccati recursion, from the cost-to-go ½ x'Px after its interval.

    With M = H + E' diag(w) E + (A B)' P (A B):  K = -M_uu⁻¹ M_ux and P⁻ = M_xx + M_xu K.
    """
    n = shape.n
    D_i, B_i, H_i, _, E_i, _ = shape.stage.values()

    @casadi_function("qp_factor")
    def factor(P: (n, n), w: shape.side, D: D_i, B: B_i, H: H_i, E: E_i):
        A = shape.A_0 + D
        M = H + E.T @ ca.diag(w) @ E
        PB = P @ B
        M_uu = symmetric(M[n:, n:] + B.T @ PB)
        M_ux = M[n:, :n] + PB.T @ A
        root = _inverse_root(M_uu)
        K = -root.T @ (root @ M_ux)
        P_before = symmetric(M[:n, :n] + A.T @ P @ A + M_ux.T @ K)
        return dict(P_before=P_before, K=K, root=root)

    return factor


def _inverse_root(M):
    """The lower triangle L⁻¹ of M = L L', whose products solve M y = b by y = L⁻' (L⁻¹ b).

    Of M⁻¹ itself rounding would leave little where w is high: M is steep then in one direction, and
    all others follow from differences of its entries.
    """
    D, above, _ = ca.ldl(ca.densify(M), False)
    rows = []
    for i in range(M.size1()):
        unit = ca.SX.eye(M.size1())[i, :]
        rows.append(unit - sum(above[j, i] * row for j, row in enumerate(rows)))
    return ca.diag(1 / ca.sqrt(D)) @ ca.vertcat(*rows)


def _build_vector(shape):
    """The linear part of a stage's recursion, u = Kx + k, from the cost-to-go p'x after it.

    k = -M_uu⁻¹ (g_u + B'p), p⁻ = g_x + A'p + K' (g_u + B'p), and the cost gains -½ k' (g_u + B'p).
    """
    n = shape.n
    D_i, B_i, _, g_i, _, _ = shape.stage.values()

    @casadi_function("qp_vector")
    def vector(p: (n, 1), cost: (1, 1), g: g_i, D: D_i, B: B_i, policy: shape.policy):
        g_u = g[n:] + B.T @ p
        k = -policy["root"].T @ (policy["root"] @ g_u)
        p_before = g[:n] + (shape.A_0 + D).T @ p + policy["K"].T @ g_u
        return dict(p_before=p_before, k=k, cost_before=cost - ca.dot(g_u, k) / 2)

    return vector


def _hidden(stages):
    """What rounding hides of the gain: _LEAST_GAIN of ½ Σ g² / H_ii."""
    g = ca.vertcat(*(stage["g"] for stage in stages))
    weight = ca.vertcat(*(ca.diag(stage["H"]) for stage in stages))
    by_itself = ca.if_else(weight > 0, g**2 / ca.fmax(weight, TINY), 0)
    return _LEAST_GAIN * ca.sum1(by_itself) / 2


def _build_compliance(shape):
    """How far a unit force along a row moves it, at most at any node, by the inputs until then.

    Without bounds a change of the gradient, -E', moves z by C E', where C is the inverse Hessian of
    the condensed cost. Its blocks follow the stages like a covariance with u = Kx + (0, M_uu⁻¹):

        C_k = (I, K)' W_k (I, K) + (0, M_uu⁻¹),   W_{k+1} = (A B) C_k (A B)',   W_0 = 0.

    To move a row by b alone thus costs ½ b² / e'Ce. What the free QP gains is ½ λ'E C E'λ with the
    multipliers λ of its bounds, or more, and so bounds a single one: λ² e'Ce <= 2 · gain.
    """
    n = shape.n
    D_i, B_i, _, _, E_i, b_i = shape.stage.values()

    @casadi_function("qp_compliance")
    def compliance(
        W: (n, n), most: shape.side, D: D_i, B: B_i, E: E_i, b: b_i, policy: shape.policy
    ):
        KW = policy["K"] @ W
        of_inputs = KW @ policy["K"].T + policy["root"].T @ policy["root"]
        C = ca.vertcat(ca.horzcat(W, KW.T), ca.horzcat(KW, of_inputs))
        moves = ca.horzcat(shape.A_0 + D, B)
        there, _ = _bounded(b)
        along = there * ca.sum2((E @ C) * E)
        return dict(W_after=moves @ C @ moves.T, most_after=ca.fmax(most, along))

    return compliance


class _Newton(NamedTuple):
    """A Newton step of the sides: λ + dλ = v + w·e'dz and, where soft, dt = T (dλ + τ)."""

    v: Any
    w: Any
    T: Any
    tau: Any
    r_s: Any  # what is missing in e'z + s = b + t
    c_t: Any  # what γ t lacks


def _newton(shape, E, b, price, point, aim):
    """Eliminate s, t and γ of a stage from its Newton step.

    e'dz + ds = r_s + dt + δ dλ,  λ ds + s dλ = c_s,  γ dt + t dγ = c_t and, with the price's slope,
    quadratic·dt = dλ + dγ + r_t.
    """
    z, s, lam, t, gam = (point[name] for name in shape.point)
    there, b = _bounded(b)
    soft = there[shape.n_hard :]
    r_s = there * (b + _of_all_sides(shape, t) - E @ z - s)
    r_t = soft * (lam[shape.n_hard :] + gam - price["linear"] - price["quadratic"] * t)
    c_s = there * (aim["target"] - s * lam - aim["e_s"])
    c_t = soft * (aim["target"] - t * gam - aim["e_t"])
    T = t / (price["quadratic"] * t + gam)
    tau = c_t / t + r_t
    slope = 1 / (s + lam * (price["delta"] + _of_all_sides(shape, T)))
    change = slope * (c_s - lam * (r_s + _of_all_sides(shape, T * tau)))
    return _Newton(lam + change, lam * slope, T, tau, r_s, c_t)


def _build_condense(shape):
    """The gradient of a stage's cost and the weights w of its rows, without s, t and γ."""
    _, _, H_i, g_i, E_i, b_i = shape.stage.values()

    @casadi_function("qp_condense")
    def condense(
        H: H_i, g: g_i, E: E_i, b: b_i,
        price: shape.price, point: shape.point, aim: shape.aim,
    ):  # fmt: skip
        newton = _newton(shape, E, b, price, point, aim)
        return dict(gradient=H @ point["z"] + g + E.T @ newton.v, w=newton.w)

    return condense


def _build_forward(shape):
    """A stage's step, from that of its state; the largest share of a positive number that a step
    takes away; and the first and second order of the change of Σ λ s + γ t.
    """
    D_i, B_i, _, _, E_i, b_i = shape.stage.values()
    K_i, _ = shape.policy.values()
    one = (1, 1)

    @casadi_function("qp_forward")
    def forward(
        x: (shape.n, 1), most: one, first: one, second: one,
        D: D_i, B: B_i, E: E_i, b: b_i, price: shape.price,
        point: shape.point, aim: shape.aim, K: K_i, k: (shape.m, 1),
    ):  # fmt: skip
        u = K @ x + k
        dz = ca.vertcat(x, u)
        newton = _newton(shape, E, b, price, point, aim)
        _, s, lam, t, gam = (point[name] for name in shape.point)
        there, _ = _bounded(b)
        soft = there[shape.n_hard :]
        e_dz = E @ dz
        dlam = newton.v - lam + newton.w * e_dz
        dt = soft * newton.T * (dlam[shape.n_hard :] + newton.tau)
        ds = there * (newton.r_s + _of_all_sides(shape, dt) - e_dz + price["delta"] * dlam)
        dgam = soft * (newton.c_t - gam * dt) / t
        # Where there is no bound λ is 0, and does not change.
        positive = ca.vertcat(s, lam + (1 - there), t, gam)
        taken = ca.vertsplit(-ca.vertcat(ds, dlam, dt, dgam) / positive)
        first += ca.dot(s, dlam) + ca.dot(lam, ds) + ca.dot(soft * t, dgam) + ca.dot(gam, dt)
        second += ca.dot(ds, dlam) + ca.dot(dt, dgam)
        sums = functools.reduce(ca.fmax, taken, most), first, second
        after = ((shape.A_0 + D) @ x + B @ u, *sums)
        names = ("x_after", "most_after", "first_after", "second_after")
        return dict(zip(names, after)) | dict(dz=dz, ds=ds, dlam=dlam, dt=dt, dgam=dgam)

    return forward


def _build_measure(shape):
    """What a point still lacks: the largest error of a row, and what a step in the inputs gains.

    With the gradient g_z = Hz + g + E'λ and the adjoint a of the dynamics, it is that of
    r = g_u + B'a, ½ r' M_uu⁻¹ r.
    """
    n = shape.n
    stage = shape.stage
    _, root_i = shape.policy.values()
    one = (1, 1)

    @casadi_function("qp_measure")
    def measure(
        a: (n, 1), error: one, gain: one, stage: stage,
        price: shape.price, point: shape.point, root: root_i,
    ):  # fmt: skip
        nothing = {name: ca.DM.zeros(*each) for name, each in shape.aim.items()}
        r_s = _newton(shape, stage["E"], stage["b"], price, point, nothing).r_s
        errors = ca.vertsplit(ca.fabs(r_s) / price["widest"])
        gradient = stage["H"] @ point["z"] + stage["g"] + stage["E"].T @ point["lam"]
        r = gradient[n:] + stage["B"].T @ a
        return dict(
            a_before=gradient[:n] + (shape.A_0 + stage["D"]).T @ a,
            error_before=functools.reduce(ca.fmax, errors, error),
            gain_before=gain + ca.sumsqr(root @ r) / 2,
        )

    return measure


def _build_direction(shape):
    """A function that solves for a Newton step, by one sweep back and one forth.

    It returns the most that a step takes away of a positive number, the first and the second order
    of the change of Σ λ s + γ t, the step by unknown, and the policies of all stages.
    """
    factor = _build_factor(shape)
    vector = _build_vector(shape)
    condense = _build_condense(shape)
    forward = _build_forward(shape)

    def direction(stages, points, price, aims, policies=None):
        factors = not policies
        policies = policies or [None] * len(stages)
        k = [None] * len(stages)
        P = ca.DM.zeros(shape.n, shape.n)
        p = ca.DM.zeros(shape.n)
        for i in reversed(range(len(stages))):
            stage = stages[i]
            given = stage | price | points[i] | aims[i]
            gradient, w = condense(*select_inputs(condense, given).values())
            if factors:
                P, *policies[i] = factor(P, w, *select_inputs(factor, stage).values())
            p, k[i], _ = vector(p, 0, gradient, stage["D"], stage["B"], *policies[i])
        carried = [ca.DM.zeros(shape.n), 0, 0, 0]
        steps = []
        for i, stage in enumerate(stages):
            given = stage | price | points[i] | aims[i]
            given = list(select_inputs(forward, given).values())
            *carried, dz, ds, dlam, dt, dgam = forward(*carried, *given, policies[i][0], k[i])
            steps.append((dz, ds, dlam, dt, dgam))
        step = dict(zip(shape.point, (ca.horzcat(*each) for each in zip(*steps))))
        return carried[1:], step, policies

    return direction


def _build_iteration(shape, problem, state):
    """One iteration: the step to λ s = γ t = 0, and from it the step to their new target."""
    direction = _build_direction(shape)
    measured = _build_measured(shape)

    @casadi_function("qp_iteration", loop_symbols(), **problem, **state)
    def iterate(scale, iterations, **given):
        stages = shape.by_node(shape.stage, given)
        points = shape.by_node(shape.point, given)
        price = {name: given[name] for name in shape.price}
        there, _ = _bounded(given["b"])
        soft = there[shape.n_hard :, :]
        n_sides = ca.fmax(ca.sum1(ca.vec(there)) + ca.sum1(ca.vec(soft)), 1)
        total = ca.dot(given["s"], given["lam"]) + ca.dot(soft * given["t"], given["gam"])
        none = {name: ca.DM.zeros(*each) for name, each in shape.aim.items()}
        (most, first, second), step, policies = direction(
            stages, points, price, [none] * len(stages)
        )
        alpha = 1 / ca.fmax(most, 1)
        left = (total + alpha * first + alpha**2 * second) / ca.fmax(total, TINY)
        share = ca.fmin(ca.fmax(left, 0), 1)
        # Much below what counts as converged, the recursion would lose digits and gain nothing.
        target = ca.fmax(share**3 * total / n_sides, _LEAST_TARGET * scale)
        # Where the predictor may go a share of its way alone, all of its second order is too much.
        crossed = (alpha * step[one] * step[other] for one, other in (("s", "lam"), ("t", "gam")))
        aims = [
            dict(target=target, e_s=e_s, e_t=e_t) for e_s, e_t in zip(*map(ca.horzsplit, crossed))
        ]
        (most, first, second), step, _ = direction(stages, points, price, aims, policies)
        alpha = ca.fmin(1, _TO_BOUNDARY / ca.fmax(most, TINY))
        after = {name: given[name] + alpha * change for name, change in step.items()}
        gap = (total + alpha * first + alpha**2 * second) / n_sides / scale
        error, gain = measured(stages, after, price, policies)
        end = dict(scale=scale, gap=gap, error=error, gain=gain / scale, iterations=iterations + 1)
        return after | end

    return iterate


def _build_measured(shape):
    """A function that measures, by one sweep back, what a point lacks: its error and gain."""
    measure = _build_measure(shape)

    def measured(stages, values, price, policies):
        carried = [ca.DM.zeros(shape.n), 0, 0]
        nodes = zip(stages, shape.by_node(shape.point, values), policies)
        for stage, point, (_, root) in reversed(list(nodes)):
            given = list(select_inputs(measure, stage | price | point).values())
            carried = measure(*carried, *given, root)
        return carried[1:]

    return measured
