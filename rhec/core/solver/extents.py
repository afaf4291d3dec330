"""How far a plan goes in each of its states and inputs, so that units do not count."""

import functools

import casadi as ca

from rhec.core.model.limits import TINY

_LEAST_EXTENT = 1e-9  # of a state that moves, relative to itself; less may be rounding
_LEAST_ROOT = 1e-6  # root of the least cost of an extent, relative to that of a node


def weight_of_gaps(root, per_extent, typical):
    """What a gap of each state counts in a merit: its root of the weight, √Q or √Q_N.

    That of a state without a weight counts as if its extent cost what a node does on average.

    Args:
        root: (n_s,) roots of the weights.
        per_extent: (n_s,) `inverse_extent` of the states.
        typical: As there.
    """
    return ca.if_else(root > 0, root, typical * per_extent)


def inverse_extent(key, old, full, root, typical):
    """1 / extent of each row of the plan's states or inputs, or 0 where there is none.

    The extent is how far a state goes from where the plan begins, or an input from 0. It is no less
    than rounding explains, nor than what counts in the cost.

    Args:
        key: "s" or "u".
        old: The plan before a step.
        full: The plan after it.
        root: Roots of what a unit costs, one for each row.
        typical: Root of what a node costs on average, `typical_root`.
    """
    begin = ca.repmat(full[:, 0], 1, full.size2()) if key == "s" else 0
    way = ca.fmax(largest(old - begin), largest(full - begin))
    least = ca.if_else(root > 0, _LEAST_ROOT * typical / ca.fmax(root, TINY), 0)
    least = ca.fmax(least, _LEAST_EXTENT * largest(old))
    extent = ca.if_else(way > 0, ca.fmax(way, least), 0)
    return ca.if_else(extent > 0, 1 / ca.fmax(extent, TINY), 0)


def typical_root(cost, s):
    """The root of what each of the nodes s costs on average."""
    return ca.sqrt(2 * cost / s.size2())


def largest(numbers):
    """The largest of each row, without its sign."""
    return functools.reduce(ca.fmax, ca.horzsplit(ca.fabs(numbers)))
