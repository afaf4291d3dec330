"""Algebraic variables a of a model, which its equation 0 = g(x, u, p, a) determines at any moment.

The equation has index 1: where ∂g/∂a is regular, a follows from x, u and p alone. What moves is
then x, and an estimator or controller has nothing to know of a.
"""

import casadi as ca
import numpy as np

NEWTON_STEPS = 8  # from a guess that does not depend on x, u and p
# The last of Newton's steps moves an algebraic variable by at most this share of 1 + |a|. The
# error that is left is about its square.
LARGEST_LAST_STEP = 1e-5


def consistent(equations, guess):
    """Function (x, u, p) -> a with g(x, u, p, a) = 0, NaN where it was not found.

    a ← a - (∂g/∂a)⁻¹ g, a fixed number of times; once where g is linear in a.

    Args:
        equations: Function (x, u, p, a) -> (ẋ, g).
        guess: (n_a,) where Newton's method begins.
    """
    *given, a = equations.sx_in()
    g = equations(*given, a)[1]
    slope = ca.jacobian(g, a)
    newton = ca.Function("newton", [*given, a], [ca.solve(slope, g)])
    reached = ca.SX(ca.DM(guess))
    if not ca.depends_on(slope, a):
        return ca.Function("consistent", given, [reached - newton(*given, reached)], {"cse": True})
    for _ in range(NEWTON_STEPS):
        move = newton(*given, reached)
        reached = reached - move
    return ca.Function("consistent", given, [if_converged(reached, move, reached)], {"cse": True})


def if_converged(a, move, value):
    """The value, or NaN for all of it unless Newton's last step, `move`, was small beside 1 + |a|.

    A variable that is NaN or infinite has not converged.
    """
    steps = zip(ca.vertsplit(a), ca.vertsplit(move))
    small = [ca.fabs(last) <= LARGEST_LAST_STEP * (1 + ca.fabs(each)) for each, last in steps]
    converged = small[0]
    for each in small[1:]:
        converged = ca.logic_and(converged, each)
    return ca.if_else(converged, value, ca.SX(ca.DM.nan(value.shape)))


def undetermined(equations, names):
    """Names of algebraic variables that no choice of one residual for each can determine."""
    symbols = equations.sx_in()
    slope = ca.jacobian(equations(*symbols)[1], symbols[3])
    lacking = slope.size2() - ca.sprank(slope.sparsity())
    columns = np.array(ca.DM(slope.sparsity(), 1)).sum(axis=0)
    return [name for name, uses in zip(names, columns) if not uses] or list(names) * bool(lacking)
