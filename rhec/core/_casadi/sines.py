"""Sines of sums by the addition theorems, where sums share their terms.

The stages of a Runge-Kutta step turn an angle θ by the same δ. The sines and cosines of θ, θ + δ
and θ + δ + δ follow from those of θ and δ by products. Derivatives contain the same sines again.
"""

from collections import Counter

import casadi as ca

_COS_SIN = ca.OP_COS, ca.OP_SIN


def sines_by_addition(expressions):
    """Rewrite SX expressions with fewer sines and cosines; their values agree up to rounding."""
    expressions = ca.cse(expressions)
    order = ca.Function("order", ca.symvar(ca.veccat(*expressions)), expressions)
    nodes = order.instructions_sx().elements()  # each node after its terms
    angles = {node.dep().element_hash(): node.dep() for node in nodes if node.op() in _COS_SIN}
    sums = {key: angle for key, angle in angles.items() if angle.op() == ca.OP_ADD}
    n_uses = Counter(angle.dep(1).element_hash() for angle in sums.values())  # of each addend
    rewritten = {}
    cos_sins = {}

    def rewrite(node):
        return rewritten.get(node.element_hash(), node)

    def cos_sin(angle):
        """cos (α + δ) = cos α cos δ - sin α sin δ,  sin (α + δ) = sin α cos δ + cos α sin δ."""
        key = angle.element_hash()
        if key in cos_sins:
            return cos_sins[key]
        cos_sins[key] = ca.cos(rewrite(angle)), ca.sin(rewrite(angle))
        if key in sums:
            alpha = angle.dep(0)
            delta = angle.dep(1)
            if alpha.element_hash() in angles and n_uses[delta.element_hash()] > 1:
                c, s = cos_sin(alpha)
                c_delta, s_delta = cos_sin(delta)
                cos_sins[key] = c * c_delta - s * s_delta, s * c_delta + c * s_delta
        return cos_sins[key]

    for node in nodes:
        if node.op() in _COS_SIN:
            rewritten[node.element_hash()] = cos_sin(node.dep())[_COS_SIN.index(node.op())]
        elif node.n_dep():
            operation = ca.SX.unary if node.n_dep() == 1 else ca.SX.binary
            terms = (rewrite(node.dep(i)) for i in range(node.n_dep()))
            rewritten[node.element_hash()] = operation(node.op(), *terms)
    return [ca.SX(e.sparsity(), ca.veccat(*map(rewrite, e.nz[:].elements()))) for e in expressions]
