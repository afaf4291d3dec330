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

from rhec.core._casadi.build import casadi_function, in_turn, select_inputs
from rhec.core.model.limits import TINY
from rhec.core.solver.extents import inverse_extent, typical_root, weight_of_gaps

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
    lengths = build_lengths(name, HALVINGS, unknowns, data, cost_and_gaps)

    @casadi_function(name, ca.MX, **unknowns, **full, penalty=PENALTY, **data)
    def search(penalty, **values):
        penalty, least = ca.vertsplit(penalty)
        given = {key: values[key] for key in data}
        old = {key: values[key] for key in unknowns}
        step = {key: values[f"{key}_full"] - values[key] for key in unknowns}
        cost, gaps = called(cost_and_gaps, old, given)
        slope = slope_of(cost_and_gaps, old, step, given)
        needed = slope / ((1 - _SHARE) * ca.fmax(gaps, TINY))
        penalty = ca.fmax(penalty, ca.if_else(gaps > 0, needed, 0))
        merit = cost + penalty * gaps
        descent = slope - penalty * gaps
        cost, gaps = called(cost_and_gaps, moved(old, step, 1), given)
        limits = dict(penalty=penalty, merit=merit, slope=_SUFFICIENT * descent)
        limits |= dict(rounding=1e-12 * ca.fabs(merit))
        steps = {f"{key}_step": change for key, change in step.items()}
        length = lengths(length=1, cost=cost, gaps=gaps, **limits, **old, **steps, **given)["good"]
        change = ca.fabs(descent) / ca.fmax(ca.fabs(merit), 1e-12)
        small = change <= DONE
        is_progress = ca.logic_or(least == 0, ca.fabs(descent) <= _PROGRESS * least)
        length = ca.if_else(ca.logic_or(small, is_progress * (least > 0)), 1, length)
        least = ca.if_else(is_progress, ca.fabs(descent), least)
        # A full step is taken to the last bit, since it ends exactly at the bounds.
        parts = moved(old, step, length)
        result = {
            key: ca.if_else(length == 1, values[f"{key}_full"], parts[key]) for key in unknowns
        }
        flags = dict(near=change <= NEAR, converged=change <= CONVERGED, done=small)
        carried = dict(penalty_after=ca.vertcat(penalty, least))
        return result | flags | dict(is_full=length == 1) | carried

    return search


def line_search_of_plan(name, unknowns, data, cost):
    """A `line_search` whose ‖c‖₁ is that of gaps in units that do not count (`weight_of_gaps`).

    Args:
        name: Of the Function.
        unknowns: {name: shape} of the unknowns, with the states s.
        data: {name: shape} of what the cost depends on besides.
        cost: Function (unknowns, data) -> cost, gaps of each state, root_s of their weights.

    Returns:
        The Function, as `line_search`.
    """
    full = {f"{unknown}_full": shape for unknown, shape in unknowns.items()}
    per_gap = dict(per_gap=cost.sparsity_out("gaps"))

    @casadi_function("rhc_merit", ca.MX, **unknowns, **data, **per_gap)
    def merit(per_gap, **values):
        found = cost(**values)
        return dict(cost=found["cost"], gaps=ca.dot(per_gap, found["gaps"]))

    shortened = line_search("rhc_shortened", unknowns, data | per_gap, merit)

    @casadi_function(name, ca.MX, **unknowns, **full, penalty=PENALTY, **data)
    def search(**values):
        here = cost(**select_inputs(cost, values))
        root = here["root_s"]
        typical = typical_root(here["cost"], values["s"])
        per_extent = inverse_extent("s", values["s"], values["s_full"], root, typical)
        return shortened(**values, per_gap=weight_of_gaps(root, per_extent, typical))

    return search


def build_lengths(name, most, unknowns, data, cost_and_gaps):
    """Build the Function that finds the first of some lengths α, α/2, α/4, … that is good enough:

        J(w + α Δw) + μ ‖c(w + α Δw)‖₁ <= merit + α slope + rounding

    J and ‖c‖₁ at the first one are given. Each other is tried only if none before it is good.

    Args:
        name: Of the search, before those of its Functions.
        most: How many lengths there are.
        unknowns: {name: shape} of the unknowns w.
        data: {name: shape} of what cost and gaps depend on besides.
        cost_and_gaps: Function (unknowns, data) -> (J, ‖c‖₁), by name.

    Returns:
        The Function (length, good, cost, gaps, penalty μ, merit, slope, rounding, unknowns,
        unknowns with "_step" for Δw, data) -> (length, good: the length, 0 if none is good).
    """
    numbers = ("length", "good", "cost", "gaps", "penalty", "merit", "slope", "rounding")
    steps = {f"{unknown}_step": shape for unknown, shape in unknowns.items()}
    shapes = dict.fromkeys(numbers, (1, 1)) | unknowns | steps | data

    def judged(length, cost, gaps, penalty, merit, slope, rounding, **_):
        is_good = cost + penalty * gaps <= merit + slope * length + rounding
        return dict(length=length / 2, good=ca.if_else(is_good, length, 0))

    @casadi_function(f"{name}_first", ca.MX, **shapes)
    def first(**inputs):
        return judged(**inputs)

    @casadi_function(f"{name}_next", ca.MX, **shapes)
    def following(**inputs):
        step = {key: inputs[f"{key}_step"] for key in unknowns}
        at = moved(inputs, step, inputs["length"])
        cost, gaps = called(cost_and_gaps, at, {key: inputs[key] for key in data})
        return judged(**inputs | dict(cost=cost, gaps=gaps))

    then = in_turn(name, shapes, ("length", "good"), lambda inputs, after: after["good"] > 0)
    others = following
    for left in range(2, most):
        others = then(f"last_{left}", following, others)
    return then("lengths", first, others)


def moved(unknowns, step, length):
    """w + α Δw, by the names of the step."""
    return {key: unknowns[key] + length * change for key, change in step.items()}


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
