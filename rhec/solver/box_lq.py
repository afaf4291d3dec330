"""The RHC's QP by its stages instead of condensed: time grows with N, not N³, and is less at every
horizon.

    min  ½ Σ_{i=1..N} ξ_i' Q_i ξ_i + Σ_{i=0..N-1} (½ R v_i² + g_i v_i)    s.t. ξ_0 = 0, ξ_{i+1} =
         A_i ξ_i + B_i v_i, lower_i ≤ v_i ≤ upper_i

This is the condensed QP min ½ v'Hv + g'v with H never formed. Block principal pivoting (Júdice,
Pires, "A Block Principal Pivoting Algorithm for Large-Scale Strictly Monotone Linear
Complementarity Problems", 1994): guess which inputs are at a bound, solve the rest exactly by one
Riccati recursion, and correct the guess by the signs of what comes out, all wrong ones at once
while their number falls, else one at a time, which cannot cycle. When the guess stands, the
solution is exact. It starts from the previous solution's guess.
"""

import casadi as ca

from rhec._casadi.build import casadi_function
from rhec.estimator.kalman import symmetric
from rhec.solver.gauss_newton import transition

DOUBLINGS = 8  # after 2 to this power guesses the search gives up; one to three are usual
PATIENCE = 3  # exchanges of all wrong ones that may fail to lessen their number


def box_lq(N, D, B, loops):
    """(D, B, Q, QN, R, g, lower, upper, active) -> (x, λ, ok), all horizontal over the intervals; λ
    > 0 at an upper bound, as `box_qp`.

    D, B: sparsities of one interval's A - 1 and input column; Q, QN (n,) diagonals; active (1, N):
    1, -1, 0 for an input guessed at its upper, lower, no bound.
    """
    n = D.size1()

    def backward(P, p, D, B, Q, R, g, lower, upper, active):
        """From the cost-to-go ½ξ'Pξ + p'ξ after an interval to the one before it, and the input v =
        Kξ + k in between.
        """
        A, h = transition(D), R + ca.bilin(P, B, B)
        free = active == 0
        K = -free * (B.T @ P @ A) / h
        k = ca.if_else(free, -(g + ca.dot(B, p)) / h, ca.if_else(active > 0, upper, lower))
        return dict(
            P_before=symmetric(A.T @ P @ (A + B @ K)) + ca.diag(Q),
            p_before=A.T @ (p + P @ B * k),
            K=K,
            k=k,
        )

    def forward(xi, wrong, P, p, D, B, R, g, lower, upper, active, K, k):
        """The interval's input, its multiplier, the state after it, which bound it should be at,
        how many were wrong so far, the first one set right.
        """
        v = K @ xi + k
        xi = transition(D) @ xi + B @ v
        multiplier = -(g + R * v + ca.dot(B, p + P @ xi)) * (active != 0)
        right = ca.if_else(
            active == 0, (v > upper) - (v < lower), active * (active * multiplier >= 0)
        )
        return dict(
            xi_after=xi,
            v=v,
            multiplier=multiplier,
            right=right,
            first=ca.if_else(wrong, active, right),
            wrong_after=wrong + (right != active),
        )

    one, state, matrix = (1, 1), (n, 1), (n, n)
    backward = casadi_function(
        "lq_backward",
        backward,
        dict(P=matrix, p=state, D=D, B=B, Q=state, R=one, g=one, lower=one, upper=one, active=one),
    )
    forward = casadi_function(
        "lq_forward",
        forward,
        dict(
            xi=state,
            wrong=one,
            P=matrix,
            p=state,
            D=D,
            B=B,
            R=one,
            g=one,
            lower=one,
            upper=one,
            active=one,
            K=(1, n),
            k=one,
        ),
    )

    def guess(D, B, Q, QN, R, g, lower, upper, active):
        """Solve for one guess of the active set; what the signs say of the guess."""
        D, B = ca.horzsplit(D, n), ca.horzsplit(B)
        g, lower, upper, active = map(ca.horzsplit, (g, lower, upper, active))
        P, p, K, k = (
            [None] * N + [ca.diag(QN)],
            [None] * N + [ca.DM.zeros(n)],
            [None] * N,
            [None] * N,
        )
        for i in reversed(range(N)):
            P[i], p[i], K[i], k[i] = backward(
                P[i + 1], p[i + 1], D[i], B[i], Q, R, g[i], lower[i], upper[i], active[i]
            )
        xi, wrong, v, multipliers, right, first = ca.DM.zeros(n), 0, *([None] * N for _ in range(4))
        for i in range(N):
            xi, v[i], multipliers[i], right[i], first[i], wrong = forward(
                xi,
                wrong,
                P[i + 1],
                p[i + 1],
                D[i],
                B[i],
                R,
                g[i],
                lower[i],
                upper[i],
                active[i],
                K[i],
                k[i],
            )
        v, multipliers, right, first = (
            ca.horzcat(*each) for each in (v, multipliers, right, first)
        )
        finite = ca.mmin(ca.fabs(v) < ca.inf)  # also 0 where v is not a number
        return dict(
            x=v,
            multipliers=multipliers,
            right=right,
            first=first,
            wrong=ca.if_else(finite, wrong, -1),
        )  # -1: hopeless

    row = dict(g=(1, N), lower=(1, N), upper=(1, N), active=(1, N))
    given = dict(D=ca.repmat(D, 1, N), B=ca.repmat(B, 1, N), Q=state, QN=state, R=one)
    guess = casadi_function("lq_guess", guess, given | row, loops)

    # A search is one guess or, if that did not stand, two searches of half its length.

    problem = given | {name: (1, N) for name in ("g", "lower", "upper")}
    state = dict(active=(1, N), least=one, patience=one, wrong=one, x=(1, N), multipliers=(1, N))

    def once(active, least, patience, wrong, x, multipliers, **problem):
        solved = guess(**problem, active=active)
        right, first, wrong = solved["right"], solved["first"], solved["wrong"]
        fewer = wrong < least
        return dict(
            active=ca.if_else(ca.fmax(fewer, patience > 0), right, first),
            least=ca.fmin(wrong, least),
            patience=ca.if_else(fewer, PATIENCE, patience - 1),
            wrong=wrong,
            x=solved["x"],
            multipliers=solved["multipliers"],
        )

    def settled(**given):
        return {name: given[name] for name in state}

    once = casadi_function("lq_once", once, problem | state, ca.MX)
    settled = casadi_function("lq_settled", settled, problem | state, ca.MX)

    def then(name, search, onward):
        """`search`, and `onward` from where it got to if no guess has stood yet."""

        def body(**given):
            found = search(**given)
            found = ca.Function.if_else(f"{name}_or_not", settled, onward)(
                found["wrong"] <= 0, *(given | found).values()
            )
            return dict(zip(state, found))

        return casadi_function(name, body, problem | state, ca.MX)

    search = once
    for doubling in range(DOUBLINGS):
        search = then(f"lq_search_{doubling}", search, search)
    search = then("lq_search", once, search)

    def box_lq(active, **problem):
        nothing = dict(
            least=N + 1,
            patience=PATIENCE,
            wrong=N + 1,
            x=ca.MX.zeros(1, N),
            multipliers=ca.MX.zeros(1, N),
        )
        found = search(**problem, active=active, **nothing)
        ok = found["wrong"] == 0
        return dict(
            x=ca.if_else(ok, found["x"], 0),
            multipliers=ca.if_else(ok, found["multipliers"], 0),
            ok=ok,
        )

    return casadi_function("box_lq", box_lq, given | row, ca.MX)
