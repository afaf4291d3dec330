"""Block principal pivoting: which of a QP's variables are at a bound.

Guess which are, solve for the rest exactly, and correct the guess by the signs of what comes out:
all wrong ones at once while their number falls, else one at a time, which cannot cycle (Júdice and
Pires, "A Block Principal Pivoting Algorithm for Large-Scale Strictly Monotone Linear
Complementarity Problems", 1994). When the guess stands, the solution is exact.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function

__all__ = ["MAX_SWEEPS", "corrected_bound", "first_corrected", "search_active_set"]

_DOUBLINGS = 8
MAX_SWEEPS = 2**_DOUBLINGS + 1  # after so many guesses the search gives up; one to three are usual
_PATIENCE = 3  # exchanges of all wrong ones that may fail to lessen their number


def corrected_bound(active, x, multiplier, lower, upper):
    """The bound (1 upper, -1 lower, 0 none) that each variable's sign condition asks for."""
    violated = (x > upper) - (x < lower)
    return ca.if_else(active == 0, violated, active * (active * multiplier >= 0))


def first_corrected(active, corrected, n_wrong):
    """The guess with its first wrong bound set right, unless some were before; how many are now."""
    first = []
    for i in range(active.numel()):
        first.append(ca.if_else(n_wrong, active[i], corrected[i]))
        n_wrong = n_wrong + (corrected[i] != active[i])
    return first, n_wrong


def search_active_set(name, N, solve, problem):
    """A Function (problem …, active) -> (x, multipliers, ok), all rows of N.

    Args:
        name: Prefix of the Functions' names.
        N: Number of variables.
        solve: Function (problem …, active) -> (x, multipliers, corrected, first_corrected,
            n_wrong): the solution for a guess of the active set; the guess that its signs ask for,
            all at once or the first alone; how many were wrong, or -1 where no number came out.
        problem: Shapes of the problem's data, by name.

    Returns:
        The Function; where no guess stood, ok, x and multipliers are 0.
    """
    row = (1, N)
    one = (1, 1)
    state = dict(active=row, least=one, patience=one, wrong=one, x=row, multipliers=row)
    shapes = problem | state

    @casadi_function(f"{name}_pivot", ca.MX, **shapes)
    def pivot(active, least, patience, wrong, x, multipliers, **problem):
        found = solve(**problem, active=active)
        wrong, fewer = found["wrong"], found["wrong"] < least
        at_once = ca.fmax(fewer, patience > 0)
        return dict(
            active=ca.if_else(at_once, found["corrected"], found["first_corrected"]),
            least=ca.fmin(wrong, least),
            patience=ca.if_else(fewer, _PATIENCE, patience - 1),
            wrong=wrong,
            x=found["x"],
            multipliers=found["multipliers"],
        )

    @casadi_function(f"{name}_converged", ca.MX, **shapes)
    def converged(**inputs):
        return {piece: inputs[piece] for piece in state}

    def then(name, first, onward):
        """`first`, and `onward` from where it got to, only if no guess has stood yet."""

        @casadi_function(name, ca.MX, **shapes)
        def search(**inputs):
            found = first(**inputs)
            unless_converged = ca.Function.if_else(f"{name}_or_not", converged, onward)
            result = unless_converged(found["wrong"] <= 0, *(inputs | found).values())
            return dict(zip(state, result))

        return search

    # CasADi has no early exit, so the loop is unrolled by doubling: each search runs the one
    # before it and, only if that has not converged, runs it again.
    search = pivot
    for doubling in range(_DOUBLINGS):
        search = then(f"{name}_search_{doubling}", search, search)
    search = then(f"{name}_search", pivot, search)

    @casadi_function(name, ca.MX, **problem, active=row)
    def searched(active, **problem):
        zeros = ca.MX.zeros(1, N)
        begin = dict(least=N + 1, patience=_PATIENCE, wrong=N + 1, x=zeros, multipliers=zeros)
        found = search(**problem, active=active, **begin)
        ok = found["wrong"] == 0
        return dict(ok=ok) | {name: ca.if_else(ok, found[name], 0) for name in ("x", "multipliers")}

    return searched
