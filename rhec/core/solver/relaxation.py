"""How far to go along a Gauss-Newton step of a problem with curved bounds: a share of it.

Where a step goes too far, as it does along a curved bound, full steps may jump to and fro for ever,
and a line search shortens them only once their merit is worse. With the steps d, now, and d'
before, the share becomes -share d'·(d - d') / ‖d - d'‖² (Aitken's relaxation; Irons and Tuck,
1969), which converges in fewer steps there. In the product, each state and input is relative to how
far the plan goes in it, so that units do not count.

Behind it stands the merit of a line search, with the price of what hard rows exceed,

    φ(w) = J(w) + price · t(w) + μ Σ per_gap |c(w)|.

A share that would raise it is halved until it does not. The QP's own price of hard rows is far
above usual multipliers. On an unstable plant it buys a plan that keeps the bounds of the linearised
dynamics by going where these hold no longer. Where no share is good enough the plan stays, and the
next QP has a tenth of that price. It rises again, step by step, once the iterations are near a
solution that still exceeds a hard row, and above the first price, too: only at the highest one does
a bound count as one that cannot be kept. Without an excess each price is above the multipliers, and
the solution is that of hard rows.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.model.limits import TINY
from rhec.core.solver.extents import inverse_extent, largest, typical_root, weight_of_gaps
from rhec.core.solver.interior_point import NO_PRICE
from rhec.core.solver.line_search import (
    CONVERGED,
    DONE,
    NEAR,
    build_lengths,
    called,
    moved,
    slope_of,
)

RELIEF = 1  # place in `penalty` of the decades by which the QP's own price is lower
_MOST_RELIEF = 4
_LEAST_RELIEF = -3  # the own price may be too low where it costs much to keep a row
_LENGTHS = 6  # that are tried, each half of the one before
_ROUNDING = 1e-9  # of the merit
_OF_STATES = 1e-15  # the same of states, from which gaps and excesses follow
_LEAST_SHARE = 0.05
_FULL_SHARE = 0.99  # from here on a full step is taken, which ends exactly at the bounds
_NO_STEP = 1e-9  # relative to each extent of the plan: a step at which an iteration ends


def relaxation(name, unknowns, data, cost):
    """Build the Function that goes a share of a step, like `line_search`.

    Args:
        name: Of the Function.
        unknowns: {name: shape} of the unknowns.
        data: {name: shape} of what the cost depends on besides.
        cost: Function (unknowns, data) -> cost, gaps of each state, and of each row beyond: Σ t if
            it has no price, and way: how far it goes; root_s and root_u, the roots of the weights.

    Returns:
        The Function (unknowns, unknowns with "_full" after a full step, penalty, solved, kkt,
        price, excess, data) -> (unknowns, penalty_after, near, converged, done, again,
        excess_shown). `penalty` carries the last share, `relief`, μ and the last step on; at first
        it is 0, and after a QP that was not solved the share is. `again` says that a QP that was
        not solved is to be tried with a lower price. `excess_shown` is the excess at the highest
        price, 0 at a lower one, which does not tell whether the bounds can be kept.
    """
    full = {f"{unknown}_full": shape for unknown, shape in unknowns.items()}
    rows = cost.sparsity_out("beyond")
    carried = 3 + sum(rows * columns for rows, columns in unknowns.values())
    known = dict(penalty=(carried, 1), solved=(1, 1), kkt=(1, 1), price=rows, excess=rows)
    merit = _build_merit(unknowns, data, cost)
    weights = dict(price=rows, per_gap=(unknowns["s"][0], 1))
    lengths = build_lengths("rhc_search", _LENGTHS, unknowns, data | weights, merit)

    @casadi_function(name, ca.MX, **unknowns, **full, **known, **data)
    def search(penalty, solved, kkt, price, excess, **values):
        share, relief, mu, last = ca.vertsplit(penalty, [0, 1, 2, 3, carried])
        here = cost(**select_inputs(cost, values))
        change = kkt / ca.fmax(here["cost"], TINY)
        old = {key: values[key] for key in unknowns}
        steps = {key: values[f"{key}_full"] - values[key] for key in unknowns}
        step = ca.veccat(*steps.values())
        per_step, per_gap, lost = _scales(here, old, values)
        stays = ca.norm_inf(per_step * step) <= _NO_STEP
        share = _next_share(share, per_step * last, per_step * step)
        near, converged, ended = (
            ca.logic_or(change <= most, stays) for most in (NEAR, CONVERGED, DONE)
        )
        has_hard = ca.sum1(values["linear"] >= NO_PRICE) > 0
        # A step that ends the iterations is too small for a merit.
        is_free = ca.logic_or(ca.logic_not(has_hard), ended)
        given = {key: values[key] for key in data} | dict(price=price, per_gap=per_gap)
        good, mu_new = _good_share(merit, lengths, old, steps, given, share, mu, lost)
        share = ca.if_else(is_free, share, good)
        taken = share > 0
        # A comparison with a number that is none is false; then the QP was not solved, either.
        better = solved * taken
        is_higher = better * near * (relief > _LEAST_RELIEF) * (ca.norm_1(excess) > 0)
        is_lower = has_hard * ca.logic_not(better) * (relief < _MOST_RELIEF)
        relief_after = relief - is_higher + is_lower
        is_full = ca.logic_or(ended, share == 1)
        parts = moved(old, steps, share)
        result = {key: ca.if_else(is_full, values[f"{key}_full"], parts[key]) for key in unknowns}
        # Where no share is good with the lowest price, the next iteration would be the same.
        is_stuck = ca.logic_not(taken) * ca.logic_not(is_lower)
        done = ca.logic_or(ended * ca.logic_not(is_higher), is_stuck)
        flags = dict(near=near, converged=converged * ca.logic_not(is_higher), done=done)
        flags |= dict(again=is_lower * ca.logic_not(solved))
        flags |= dict(excess_shown=ca.if_else(relief > _LEAST_RELIEF, 0, excess))
        # Steps with different prices do not tell how far to go.
        is_comparable = solved * (relief_after == relief)
        carry = (ca.if_else(is_comparable, share, 0), relief_after, ca.if_else(better, mu_new, mu))
        last = ca.if_else(solved, step, 0)
        return result | flags | dict(penalty_after=ca.vertcat(*carry, last))

    return search


def _build_merit(unknowns, data, cost):
    """The Function of J + price · t, of the gaps Σ per_gap |c|, and of price · way."""
    weights = dict(price=cost.sparsity_out("beyond"), per_gap=cost.sparsity_out("gaps"))

    @casadi_function("rhc_merit", ca.MX, **unknowns, **data, **weights)
    def merit(price, per_gap, **values):
        found = cost(**values)
        total = found["cost"] + ca.dot(price, found["beyond"])
        way = ca.dot(price, found["way"])
        return dict(cost=total, gaps=ca.dot(per_gap, found["gaps"]), way=way)

    return merit


def _good_share(merit, lengths, old, step, given, share, mu, lost):
    """The first of share, share / 2, … that does not raise φ, or 0; and μ.

    μ makes what is missing at the ends of the intervals twice as dear as what closing it costs, by
    the cost's slope, and by its rise along the share.
    """
    here = merit(**old, **given)
    cost = here["cost"]
    gaps = here["gaps"]
    cost_there, gaps_there = called(merit, moved(old, step, share), given)
    rise = ca.fmax((cost_there - cost) / share, slope_of(merit, old, step, given))
    mu = ca.fmax(mu, ca.if_else(gaps > 0, 2 * rise / ca.fmax(gaps, TINY), 0))
    before = cost + mu * gaps
    # Far from the origin the states' own rounding counts more than that of the merit.
    of_gaps, of_way = lost
    rounding = _ROUNDING * ca.fabs(before) + mu * of_gaps + of_way * here["way"]
    limits = dict(penalty=mu, merit=before, slope=0, rounding=rounding)
    first = dict(length=share, cost=cost_there, gaps=gaps_there)
    steps = {f"{key}_step": change for key, change in step.items()}
    return lengths(**first, **limits, **old, **steps, **given)["good"], mu


def _scales(here, old, values):
    """What steps, gaps, and what rounding hides are relative to, so that units do not count.

    Args:
        here: What the cost's Function found at the plan before the step.
        old: That plan.
        values: They have the plan after the step, with "_full".

    Returns:
        1 / extent for each entry of a step; the weight of each state's gaps; and what rounding of
        the states hides: of the gaps, and of a row's way as a share of it.
    """
    s = old["s"]
    typical = typical_root(here["cost"], s)
    per_extent = {
        key: inverse_extent(key, plan, values[f"{key}_full"], here[f"root_{key}"], typical)
        for key, plan in old.items()
    }
    per_step = ca.veccat(*(ca.repmat(per_extent[key], 1, old[key].size2()) for key in old))
    per_gap = weight_of_gaps(here["root_s"], per_extent["s"], typical)
    of_gaps = _OF_STATES * ca.dot(per_gap, ca.sum2(ca.fabs(s)))
    of_way = _OF_STATES * ca.mmax(per_extent["s"] * largest(s))
    return per_step, per_gap, (of_gaps, of_way)


def _next_share(share, last, step):
    """The share of a step, from the share and the step before; share 0 says that there is none.

    Both steps are relative to the extents of the plan.
    """
    change = step - last
    relaxed = -share * ca.dot(last, change) / ca.fmax(ca.dot(change, change), TINY)
    # A comparison with a number that is none is false; then the step is a full one.
    is_partial = ca.logic_and(share > 0, relaxed < _FULL_SHARE)
    return ca.if_else(is_partial, ca.fmax(relaxed, _LEAST_SHARE), 1)
