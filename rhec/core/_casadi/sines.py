"""Sines of sums by the theorem of addition, where sums share their terms.

The stages of a Runge-Kutta step turn an angle by the same δ: the sines of θ, θ + δ and θ + δ + δ
are those of θ and of δ, and products. Derivatives hold the same sines again.
"""

from collections import Counter

import casadi as ca

__all__ = ["sines_by_addition"]

_COS_SIN = ca.OP_COS, ca.OP_SIN


def sines_by_addition(expressions):
    """SX expressions that are the same up to rounding, with fewer sines and cosines."""
    expressions = ca.cse(expressions)
    order = ca.Function("order", ca.symvar(ca.veccat(*expressions)), expressions)
    nodes = order.instructions_sx().elements()  # each after those that it is made of
    angles = {node.dep().element_hash(): node.dep() for node in nodes if node.op() in _COS_SIN}
    sums = {key: angle for key, angle in angles.items() if angle.op() == ca.OP_ADD}
    shared = Counter(angle.dep(1).element_hash() for angle in sums.values())
    new = {}
    turned = {}

    def of(node):
        return new.get(node.element_hash(), node)

    def cos_sin(angle):
        key = angle.element_hash()
        if key in turned:
            return turned[key]
        turned[key] = ca.cos(of(angle)), ca.sin(of(angle))
        if key in sums:
            first = angle.dep(0)
            added = angle.dep(1)
            if first.element_hash() in angles and shared[added.element_hash()] > 1:
                (c, s) = cos_sin(first)
                (c_added, s_added) = cos_sin(added)
                turned[key] = c * c_added - s * s_added, s * c_added + c * s_added
        return turned[key]

    for node in nodes:
        if node.op() in _COS_SIN:
            new[node.element_hash()] = cos_sin(node.dep())[_COS_SIN.index(node.op())]
        elif node.n_dep():
            make = ca.SX.unary if node.n_dep() == 1 else ca.SX.binary
            terms = (of(node.dep(i)) for i in range(node.n_dep()))
            new[node.element_hash()] = make(node.op(), *terms)
    return [ca.SX(e.sparsity(), ca.veccat(*map(of, e.nz[:].elements()))) for e in expressions]
