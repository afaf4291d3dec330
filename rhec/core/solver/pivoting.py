"""Block principal pivoting: which of a QP's variables are at a bound.

Guess the active set, solve for the other variables exactly, and correct the guess by the signs of
the solution: all infeasible variables at once while their number falls, otherwise the first one
alone, which cannot cycle (Júdice and Pires, "A Block Principal Pivoting Algorithm for Large-Scale
Strictly Monotone Linear Complementarity Problems", 1994). If no variable is infeasible, the
solution is exact.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function

DOUBLINGS = 8
MAX_SWEEPS = 2**DOUBLINGS + 1  # guesses before the search gives up; one to three are usual
_PATIENCE = 3  # block exchanges that may fail to reduce the number of infeasible variables


def correct_guess(active, x, multiplier, lower, upper, n_infeasible=0):
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


def search_active_set(name, N, solve, problem, doublings=DOUBLINGS):
    """Build a Function (problem …, active) -> (solved, x, multipliers); the last two are rows of N.

    `problem` {name: shape} is the QP's data. `solve` is a Function (problem …, active) -> (x,
    multipliers, corrected, first_corrected, wrong): the solution for a guess of the active set; the
    guess after exchanging all infeasible variables, or the first alone; their number, or -1 where
    the solution is not finite. If the search gives up, after 2^doublings + 1 guesses, all three
    results are 0.
    """
    row = (1, N)
    one = (1, 1)
    # `wrong` counts the infeasible variables of the last guess, `least` the fewest so far.
    state = dict(active=row, least=one, patience=one, wrong=one, x=row, multipliers=row)
    shapes = problem | state
    pivot = _build_pivot(name, solve, shapes)

    @casadi_function(f"{name}_converged", ca.MX, **shapes)
    def converged(**inputs):
        return {piece: inputs[piece] for piece in state}

    def repeat_unless_converged(name, first, second):
        """A Function that runs `first` and, only if that has not converged, `second`."""

        @casadi_function(name, ca.MX, **shapes)
        def search(**inputs):
            after = first(**inputs)
            unless_converged = ca.Function.if_else(f"{name}_or_not", converged, second)
            result = unless_converged(after["wrong"] <= 0, *(inputs | after).values())
            return dict(zip(state, result))

        return search

    # CasADi has no early exit, so the loop is unrolled by doubling: each search runs the one
    # before it twice, 2^doublings pivots in the end.
    search = pivot
    for doubling in range(doublings):
        search = repeat_unless_converged(f"{name}_search_{doubling}", search, search)
    search = repeat_unless_converged(f"{name}_search", pivot, search)

    @casadi_function(name, ca.MX, **problem, active=row)
    def search_from(active, **problem):
        zeros = ca.MX.zeros(1, N)
        start = dict(least=N + 1, patience=_PATIENCE, wrong=N + 1, x=zeros, multipliers=zeros)
        end = search(**problem, active=active, **start)
        solved = end["wrong"] == 0
        return dict(solved=solved) | {
            name: ca.if_else(solved, end[name], 0) for name in ("x", "multipliers")
        }

    return search_from


def _build_pivot(name, solve, shapes):
    """One guess solved, and the next one chosen."""

    @casadi_function(f"{name}_pivot", ca.MX, **shapes)
    def pivot(active, least, patience, wrong, x, multipliers, **problem):
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
        )

    return pivot
