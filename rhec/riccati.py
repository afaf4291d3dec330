"""The RHC's QP for long horizons, by its stages instead of condensed: time grows with N, not N³.

    min  ½ Σ_{i=1..N} ξ_i' Q_i ξ_i + Σ_{i=0..N-1} (½ R v_i² + g_i v_i)    s.t. ξ_0 = 0, ξ_{i+1} = A_i ξ_i + B_i v_i, lower_i ≤ v_i ≤ upper_i

This is the condensed QP min ½ v'Hv + g'v with H never formed. A primal-dual active-set method (Hintermüller, Ito, Kunisch, "The Primal-Dual Active
Set Strategy as a Semismooth Newton Method", 2003) guesses which inputs are at a bound, solves the rest exactly by one Riccati recursion, and
corrects the guess by the signs of what comes out; when the guess stands, the solution is exact. It starts from the previous solution's guess.
"""

import casadi as ca

from rhec.function import function
from rhec.gauss_newton import transition
from rhec.kalman import symmetric

GUESSES = 20   # after so many the search gives up; one to three are usual


def box_lq(N, D, B, loops):
    """(D, B, Q, QN, R, g, lower, upper, active) -> (x, λ, ok), all horizontal over the intervals; λ > 0 at an upper bound, as `box_qp`.

    D, B: sparsities of one interval's A - 1 and input column; Q, QN (n,) diagonals; active (1, N): 1, -1, 0 for an input guessed at its upper,
    lower, no bound.
    """
    n = D.size1()

    def backward(P, p, D, B, Q, R, g, lower, upper, active):
        """From the cost-to-go ½ξ'Pξ + p'ξ after an interval to the one before it, and the input v = Kξ + k in between."""
        A, h = transition(D), R + ca.bilin(P, B, B)
        free = active == 0
        K = -free * (B.T @ P @ A) / h
        k = ca.if_else(free, -(g + ca.dot(B, p)) / h, ca.if_else(active > 0, upper, lower))
        return dict(P_before=symmetric(A.T @ P @ (A + B @ K)) + ca.diag(Q), p_before=A.T @ (p + P @ B * k), K=K, k=k)

    def forward(xi, P, p, D, B, R, g, lower, upper, active, K, k):
        """The interval's input, its multiplier, the state after it, and which bound it should be at."""
        v = K @ xi + k
        xi = transition(D) @ xi + B @ v
        multiplier = -(g + R * v + ca.dot(B, p + P @ xi)) * (active != 0)
        right = ca.if_else(active == 0, (v > upper) - (v < lower), active * (active * multiplier > 0))
        return dict(xi_after=xi, v=v, multiplier=multiplier, right=right)

    one, state, matrix = (1, 1), (n, 1), (n, n)
    backward = function("lq_backward", backward, dict(P=matrix, p=state, D=D, B=B, Q=state, R=one, g=one, lower=one, upper=one, active=one))
    forward = function("lq_forward", forward, dict(xi=state, P=matrix, p=state, D=D, B=B, R=one, g=one, lower=one, upper=one, active=one,
                                                   K=(1, n), k=one))

    def guess(D, B, Q, QN, R, g, lower, upper, active):
        """Solve for one guess of the active set; what the signs say of the guess."""
        D, B = ca.horzsplit(D, n), ca.horzsplit(B)
        g, lower, upper, active = map(ca.horzsplit, (g, lower, upper, active))
        P, p, K, k = [None] * N + [ca.diag(QN)], [None] * N + [ca.DM.zeros(n)], [None] * N, [None] * N
        for i in reversed(range(N)):
            P[i], p[i], K[i], k[i] = backward(P[i + 1], p[i + 1], D[i], B[i], Q, R, g[i], lower[i], upper[i], active[i])
        xi, v, multipliers, right = ca.DM.zeros(n), [None] * N, [None] * N, [None] * N
        for i in range(N):
            xi, v[i], multipliers[i], right[i] = forward(xi, P[i + 1], p[i + 1], D[i], B[i], R, g[i], lower[i], upper[i], active[i], K[i], k[i])
        v, multipliers, right = (ca.horzcat(*each) for each in (v, multipliers, right))
        return dict(x=v, multipliers=multipliers, right=right, ok=ca.mmin(ca.horzcat(right == ca.horzcat(*active), ca.fabs(v) < ca.inf)))

    row = dict(g=(1, N), lower=(1, N), upper=(1, N), active=(1, N))
    given = dict(D=ca.repmat(D, 1, N), B=ca.repmat(B, 1, N), Q=state, QN=state, R=one)
    guess = function("lq_guess", guess, given | row, loops)

    def settled(D, B, Q, QN, R, g, lower, upper, right, x, multipliers):
        return dict(x=x, multipliers=multipliers, ok=1)

    def given_up(D, B, Q, QN, R, g, lower, upper, active):
        return dict(x=ca.MX.zeros(1, N), multipliers=ca.MX.zeros(1, N), ok=0)

    found = dict(x=(1, N), multipliers=(1, N))
    search = function("lq_given_up", given_up, given | row, ca.MX)
    for depth in range(GUESSES):   # each guess calls the next only if it did not stand
        def onward(D, B, Q, QN, R, g, lower, upper, right, x, multipliers, search=search):
            return dict(zip(("x", "multipliers", "ok"), search(D, B, Q, QN, R, g, lower, upper, right)))

        branch = given | {name: (1, N) for name in ("g", "lower", "upper", "right")} | found
        choose = ca.Function.if_else(f"lq_choose_{depth}", function("lq_settled", settled, branch, ca.MX),
                                     function(f"lq_onward_{depth}", onward, branch, ca.MX))

        def body(D, B, Q, QN, R, g, lower, upper, active, choose=choose):
            x, multipliers, right, ok = guess(D, B, Q, QN, R, g, lower, upper, active)
            return dict(zip(("x", "multipliers", "ok"), choose(ok, D, B, Q, QN, R, g, lower, upper, right, x, multipliers)))

        search = function(f"lq_search_{depth}", body, given | row, ca.MX)
    return search
