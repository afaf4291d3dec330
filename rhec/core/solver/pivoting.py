"""Block principal pivoting: which of a QP's variables are at a bound.

Guess the active set, solve for the other variables exactly, and correct the guess by the signs of
the solution: all infeasible variables at once while their number falls, otherwise the first one
alone, which cannot cycle (Júdice and Pires, "A Block Principal Pivoting Algorithm for Large-Scale
Strictly Monotone Linear Complementarity Problems", 1994). If no variable is infeasible, the
solution is exact.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, in_turn

_DOUBLINGS = 8
MAX_SWEEPS = 2**_DOUBLINGS + 1  # guesses before the search gives up; one to three are usual
_PATIENCE = 3  # block exchanges that may fail to reduce the number of infeasible variables


def correct_guess(active, x, multiplier, lower, upper, n_infeasible):
    """Correct a guess of the active set by the sign conditions of its solution.

    A free variable beyond a bound is fixed there; one at a bound stays if its multiplier presses it
    against that bound. Returns the guess with all infeasible variables exchanged, the guess (a
    list) with the first one exchanged unless one of the earlier stages is infeasible, and how many
    are infeasible so far.
    """
    violated = (x > upper) - (x < lower)
    proposed = ca.if_else(active == 0, violated, active * (active * multiplier >= 0))
    first_exchange = []
    for i in range(active.numel()):
        first_exchange.append(ca.if_else(n_infeasible, active[i], proposed[i]))
        n_infeasible = n_infeasible + (proposed[i] != active[i])
    return proposed, first_exchange, n_infeasible


def search_active_set(N, solve, problem):
    """Build a Function (problem …, active) -> (solved, x, multipliers, slope).

    x and multipliers are rows of N, slope is the gradient times the solution. `problem` {name:
    shape} is the QP's data. `solve` is a Function (problem …, active) -> (x, multipliers, slope,
    corrected, first_corrected, wrong): the solution for a guess of the active set; the guess after
    exchanging all infeasible variables, or the first alone; their number, or -1 where the solution
    is not finite. If the search gives up, after MAX_SWEEPS guesses, all results are 0.
    """
    row = (1, N)
    one = (1, 1)
    # `wrong` counts the infeasible variables of the last guess, `least` the fewest so far.
    state = dict(active=row, least=one, patience=one, wrong=one, x=row, multipliers=row, slope=one)
    shapes = problem | state
    pivot = _build_pivot(solve, shapes)

    then = in_turn("stage_qp_search", shapes, state, lambda inputs, after: after["wrong"] <= 0)
    search = pivot
    for doubling in range(_DOUBLINGS):
        search = then(doubling, search, search)
    search = then("whole", pivot, search)

    @casadi_function("stage_qp", ca.MX, **problem, active=row)
    def search_from(active, **problem):
        zeros = ca.MX.zeros(1, N)
        start = dict(
            least=N + 1, patience=_PATIENCE, wrong=N + 1, x=zeros, multipliers=zeros, slope=0
        )
        end = search(**problem, active=active, **start)
        solved = end["wrong"] == 0
        return dict(solved=solved) | {
            name: ca.if_else(solved, end[name], 0) for name in ("x", "multipliers", "slope")
        }

    return search_from


def _build_pivot(solve, shapes):
    """One guess solved, and the next one chosen."""

    @casadi_function("stage_qp_pivot", ca.MX, **shapes)
    def pivot(active, least, patience, wrong, x, multipliers, slope, **problem):
        solution = solve(**problem, active=active)
        n_infeasible = solution["wrong"]
        is_fewer = n_infeasible < least
        block_exchange = ca.fmax(is_fewer, patience > 0)
        corrected = (solution["corrected"], solution["first_corrected"])
        return dict(
            active=ca.if_else(block_exchange, *corrected),
            least=ca.fmin(n_infeasible, least),
            patience=ca.if_else(is_fewer, _PATIENCE, patience - 1),
            wrong=n_infeasible,
            x=solution["x"],
            multipliers=solution["multipliers"],
            slope=solution["slope"],
        )

    return pivot
