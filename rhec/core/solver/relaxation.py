"""How far to go along a Gauss-Newton step of a problem with curved bounds: a share of it.

Where a step goes too far, as it does along a curved bound, full steps may jump to and fro for ever,
and a line search shortens them only once their merit is worse. With the steps d, now, and d'
before, the share becomes -share d'·(d - d') / ‖d - d'‖² (Aitken's relaxation; Irons and Tuck,
1969), which converges in fewer steps there.
"""

import casadi as ca

from rhec.core._casadi.build import casadi_function, select_inputs
from rhec.core.solver.line_search import CONVERGED, DONE, NEAR

_LEAST_SHARE = 0.05
_FULL_SHARE = 0.99  # from here on a full step is taken, which ends exactly at the bounds
_NO_STEP = 1e-9  # relative to the plan's extent: a step at which an iteration ends
_TINY = 1e-300


def relaxation(unknowns, data, cost):
    """Build the Function that goes a share of a step, like `line_search`.

    Args:
        unknowns: {name: shape} of the unknowns.
        data: {name: shape} of what the cost depends on besides.
        cost: Function (unknowns, data) -> cost.

    Returns:
        The Function (unknowns, unknowns with "_full" after a full step, penalty, solved, kkt, data)
        -> (unknowns, penalty_after, near, converged, done). `penalty` carries the last share and
        step on; at first, and after a QP that was not solved, it is 0.
    """
    full = {f"{unknown}_full": shape for unknown, shape in unknowns.items()}
    carried = 1 + sum(rows * columns for rows, columns in unknowns.values())
    known = dict(penalty=(carried, 1), solved=(1, 1), kkt=(1, 1))

    @casadi_function("rhc_search", ca.MX, **unknowns, **full, **known, **data)
    def search(penalty, solved, kkt, **values):
        change = kkt / ca.fmax(cost(**select_inputs(cost, values))["cost"], _TINY)
        step = ca.veccat(*(values[f"{key}_full"] - values[key] for key in unknowns))
        stays = ca.norm_inf(step) <= _NO_STEP * ca.norm_inf(_extent(values, unknowns))
        share = _next_share(penalty[0], penalty[1:], step)
        done = ca.logic_or(change <= DONE, stays)
        is_full = ca.logic_or(done, share == 1)
        result = {}
        for key in unknowns:
            part = values[key] + share * (values[f"{key}_full"] - values[key])
            result[key] = ca.if_else(is_full, values[f"{key}_full"], part)
        near, converged = (ca.logic_or(change <= most, stays) for most in (NEAR, CONVERGED))
        flags = dict(near=near, converged=converged, done=done)
        carry = ca.if_else(solved, ca.vertcat(share, step), ca.DM.zeros(carried))
        return result | flags | dict(penalty_after=carry)

    return search


def _extent(values, unknowns):
    """How far the plan goes: its states from where it begins, far from the origin or not."""
    parts = []
    for key in unknowns:
        plan = values[f"{key}_full"]
        begin = ca.repmat(plan[:, 0], 1, plan.size2()) if key == "s" else 0
        parts.append(plan - begin)
    return ca.veccat(*parts)


def _next_share(share, last, step):
    """The share of a step, from the share and the step before; share 0 says that there is none."""
    change = step - last
    relaxed = -share * ca.dot(last, change) / ca.fmax(ca.dot(change, change), _TINY)
    # A comparison with a number that is none is false; then the step is a full one.
    is_partial = ca.logic_and(share > 0, relaxed < _FULL_SHARE)
    return ca.if_else(is_partial, ca.fmax(relaxed, _LEAST_SHARE), 1)
