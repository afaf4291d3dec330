"""A user's functions of (x, u, p), as CasADi expressions, or refused in a sentence."""

import math
import warnings

import casadi as ca

from rhec.core._casadi.validation import shown

# What CasADi says of the truth value of an expression, and of an entry that there is not.
_ASKED = "Cannot compute the truth value"
_BEYOND = "out of bounds", "stop<=len"


class _Column(ca.SX):
    """A column of expressions that can also be unpacked, as in `a, b = x`."""

    def __iter__(self):
        return iter(ca.vertsplit(self))


def expression_of(name, function, symbols, *sizes):
    """A user's function as a column of the symbols, whose length is one of the sizes.

    Args:
        name: What the user calls it, such as "f".
        function: Of x, u and p, and of known signals where there are some.
        symbols: These.
        sizes: Allowed numbers of its entries.

    Raises:
        ValueError: If it cannot be called, or returns something else.
    """
    arguments = ("x", "u", "p", "known")[: len(symbols)]
    names = ", ".join(arguments)
    expected = f"it should map CasADi expressions ({names}) to one expression or a list of them"
    try:
        with warnings.catch_warnings():
            # NumPy's functions of expressions are expressions; CasADi warns of those of numbers.
            warnings.simplefilter("ignore", FutureWarning)
            value = function(*map(_Column, symbols))
        if value is None:
            raise TypeError("it returned nothing")
        value = ca.SX(ca.vertcat(*value)) if isinstance(value, list | tuple) else ca.SX(value)
    except Exception as error:
        problem = shown(error)
        if _ASKED in str(error):
            problem = "it asks whether an expression is true, as `if`, `and`, min and max do"
            expected = "it should use ca.if_else, ca.logic_and, ca.fmin or ca.fmax instead"
        if any(words in str(error).lower() for words in _BEYOND):
            problem = "it asks for an entry that there is not"
            sizes = [f"{s} has {each.numel()}" for s, each in zip(arguments, symbols)]
            expected = f"{', '.join(sizes)} entries"
        raise ValueError(f"{name} was refused ({problem}); {expected}") from error
    problem = f"{name} was {shown(value)}"
    if value.numel() not in sizes or 1 not in value.shape:
        counts = " or ".join(map(str, sorted(sizes)))
        raise ValueError(f"{problem}, of shape {value.shape}; it should be a column of {counts}")
    known = ca.vertcat(*symbols)
    free = [s.name() for s in ca.symvar(value) if not ca.depends_on(known, s)]
    if free:
        raise ValueError(f"{problem}, with {free[0]!r} free; it should depend on x, u and p alone")
    column = ca.densify(ca.vec(value))
    if _has_nan(ca.Function("column", symbols, [column])):
        expected = "it should use CasADi's functions, such as ca.sin in place of math.sin"
        raise ValueError(f"{problem}, which is no number whatever x, u and p are; {expected}")
    return column


def _has_nan(function):
    """Whether a Function contains NaN as a constant, which a math function makes of a symbol."""
    return any(
        function.instruction_id(i) == ca.OP_CONST and math.isnan(function.instruction_constant(i))
        for i in range(function.n_instructions())
    )
