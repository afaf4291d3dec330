"""How far to go along a Gauss-Newton step of a multiple-shooting problem: a line search.

The merit of nodes and inputs w is their cost and what is missing at the ends of the intervals,

    φ(w) = J(w) + μ ‖c(w)‖₁,   c_i = s_{i+1} - F(s_i, v_i)

(Nocedal, Wright, "Numerical Optimization", 2006, Sec. 18.3). Of the lengths 1, 1/2, 1/4, … the
first is taken at which φ(w + α Δw) <= φ(w) + 1e-4 α D, where D = ∇J·Δw - μ ‖c‖₁ < 0 is the slope.
The penalty μ only grows, so that D stays below a share of it. A full step is also taken where |D|
is below a share of the least one so far: full steps that converge would be shortened for nothing
near a solution (Maratos effect), and no more than a few of them can fail to converge.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function

PENALTY = (2, 1)  # μ and the least |D| so far; zeros before the first step
HALVINGS = 10  # of the step, at most; a solution or a bad linearisation needs more, and stays
_SUFFICIENT = 1e-4
_PROGRESS = 0.9  # of the least |D| so far, below which a full step is taken
_SHARE = 0.5  # of μ ‖c‖₁ by which the merit has to fall along the step
DONE = 1e-12  # expected relative change of the merit, at which an iteration ends
CONVERGED = 1e-9  # expected relative change of the merit
NEAR = 0.1  # the same, above which the iterations ended far from a solution


def line_search(name, unknowns, data, cost_and_gaps):
    """Build the Function that shortens a step.

    Args:
        name: Of the Function.
        unknowns: {name: shape} of the unknowns.
        data: {name: shape} of what cost and gaps depend on besides.
        cost_and_gaps: Function (unknowns, data) -> (J, ‖c‖₁), by name.

    Returns:
        The Function (unknowns, unknowns with "_full" after a full step, penalty, data) ->
        (unknowns, penalty_after, near, converged, done, is_full: whether the step is a full one).
        The step is zero where no length is good enough.
    """
    full = {f"{unknown}_full": shape for unknown, shape in unknowns.items()}

    @casadi_function(name, ca.MX, **unknowns, **full, penalty=PENALTY, **data)
    def search(penalty, **values):
        penalty, least = ca.vertsplit(penalty)
        given = {key: values[key] for key in data}
        old = {key: values[key] for key in unknowns}
        step = {key: values[f"{key}_full"] - values[key] for key in unknowns}
        cost, gaps = called(cost_and_gaps, old, given)
        slope = slope_of(cost_and_gaps, old, step, given)
        needed = slope / ((1 - _SHARE) * ca.fmax(gaps, 1e-300))
        penalty = ca.fmax(penalty, ca.if_else(gaps > 0, needed, 0))
        merit = cost + penalty * gaps
        descent = slope - penalty * gaps
        length = ca.MX(0)
        for halvings in reversed(range(HALVINGS)):
            alpha = 0.5**halvings
            moved = {key: old[key] + alpha * step[key] for key in unknowns}
            cost, gaps = called(cost_and_gaps, moved, given)
            enough = merit + _SUFFICIENT * alpha * descent + 1e-12 * ca.fabs(merit)
            length = ca.if_else(cost + penalty * gaps <= enough, alpha, length)
        change = ca.fabs(descent) / ca.fmax(ca.fabs(merit), 1e-12)
        small = change <= DONE
        is_progress = ca.logic_or(least == 0, ca.fabs(descent) <= _PROGRESS * least)
        length = ca.if_else(ca.logic_or(small, is_progress * (least > 0)), 1, length)
        least = ca.if_else(is_progress, ca.fabs(descent), least)
        # A full step is taken to the last bit, since it ends exactly at the bounds.
        result = {
            key: ca.if_else(length == 1, values[f"{key}_full"], old[key] + length * step[key])
            for key in unknowns
        }
        flags = dict(near=change <= NEAR, converged=change <= CONVERGED, done=small)
        carried = dict(penalty_after=ca.vertcat(penalty, least))
        return result | flags | dict(is_full=length == 1) | carried

    return search


def called(cost_and_gaps, unknowns, data):
    """(J, ‖c‖₁) of unknowns and data, both by name."""
    result = cost_and_gaps(**unknowns, **data)
    return result["cost"], result["gaps"]


def slope_of(cost_and_gaps, unknowns, step, data):
    """∇J·Δw by forward differentiation; `step` has the shapes of the unknowns."""
    symbols = {key: ca.MX.sym(key, value.shape) for key, value in unknowns.items()}
    inner = {key: ca.MX.sym(key, value.shape) for key, value in data.items()}
    cost, _ = called(cost_and_gaps, symbols, inner)
    w = ca.veccat(*symbols.values())
    direction = ca.MX.sym("direction", w.numel())
    along = ca.jtimes(cost, w, direction)
    function = ca.Function("slope", [*symbols.values(), *inner.values(), direction], [along])
    return function(*unknowns.values(), *data.values(), ca.veccat(*step.values()))
