"""A user's functions of a Model, as CasADi Functions, or refused in a sentence."""

import casadi as ca

from rhec.core._casadi.validation import refuse, shown

_LETTERS = "xupa"  # states, inputs, parameters, algebraic variables


class _Column(ca.SX):
    """A column of expressions that can also be unpacked, as in `a, b = x`."""

    def __iter__(self):
        return iter(ca.vertsplit(self))


def function_of(name, function, symbols, *sizes):
    """A user's function as a Function of the symbols, whose length is one of the sizes.

    Args:
        name: What the user calls it: "f" or "h".
        function: Of as many arguments as there are symbols.
        symbols: x, u and p, and with algebraic variables a.
        sizes: Allowed numbers of its entries.

    Raises:
        ValueError: If it cannot be called, or returns something else.
    """
    value = _called(name, function, symbols, "to one expression or a list of them")
    column = _column(name, value, symbols, *sizes)
    return ca.Function(name, symbols, [column], [*_LETTERS[: len(symbols)]], [name])


def equations_of(f, symbols, n_x, n_a):
    """A user's f with algebraic variables, as Function (x, u, p, a) -> (ẋ, g).

    Raises:
        ValueError: If it cannot be called, or returns something else.
    """
    expected = "to a pair: the slopes, and what should be zero"
    value = _called("f", f, symbols, expected)
    if not isinstance(value, tuple) or len(value) != 2:
        refuse("f returned", value, f"it should map CasADi expressions (x, u, p, a) {expected}")
    parts = [
        _column(f"{which} of f", part, symbols, size)
        for which, part, size in zip(("the slopes", "the residual"), value, (n_x, n_a))
    ]
    return ca.Function("equations", symbols, parts, [*_LETTERS], ["slope", "residual"])


def _called(name, function, symbols, to_what):
    """What a user's function makes of the symbols."""
    try:
        return function(*map(_Column, symbols))
    except Exception as error:
        arguments = ", ".join(_LETTERS[: len(symbols)])
        expected = f"it should map CasADi expressions ({arguments}) {to_what}"
        raise ValueError(f"{name} was refused ({shown(error)}); {expected}") from error


def _column(name, value, symbols, *sizes):
    """A user's expressions as one dense column, whose length is one of the sizes."""
    try:
        value = ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value)
    except Exception as error:
        expected = "it should be one expression or a list of them"
        raise ValueError(f"{name} was refused ({shown(error)}); {expected}") from error
    problem = f"{name} was {shown(value)}"
    if value.numel() not in sizes or 1 not in value.shape:
        counts = " or ".join(map(str, sorted(sizes)))
        raise ValueError(f"{problem}, of shape {value.shape}; it should be a column of {counts}")
    known = ca.vertcat(*symbols)
    free = [s.name() for s in ca.symvar(value) if not ca.depends_on(known, s)]
    if free:
        words = f"{', '.join(_LETTERS[: len(symbols) - 1])} and {_LETTERS[len(symbols) - 1]}"
        raise ValueError(f"{problem}, with {free[0]!r} free; it should depend on {words} alone")
    return ca.densify(ca.vec(value))
