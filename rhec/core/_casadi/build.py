"""CasADi Functions from plain Python functions: named expressions in, a dict of named ones out."""

import casadi as ca

from rhec.core._casadi.compiled import loop_symbols

# Eliminating common subexpressions makes the C of SX a tenth shorter. That of MX, which calls other
# Functions, would be at most a hundredth shorter, and a loop would take twice as long to build.
OPTIONS = {
    ca.SX: {"allow_duplicate_io_names": True, "cse": True},
    ca.MX: {"allow_duplicate_io_names": True},
}


def casadi_function(name, symbols=ca.SX, /, **shapes):
    """Decorator: the CasADi Function of a Python function whose annotations are its inputs' shapes.

    A shape is (rows, columns) or a CasADi Sparsity. An annotation may also be a dict or NamedTuple
    of shapes: each entry is one input, and the function receives a dict or NamedTuple of
    expressions. `shapes` are those of inputs without annotation. The function returns its outputs
    as a dict or NamedTuple. `symbols` are SX for arithmetic (inlined, simplified), or MX for
    functions that call other Functions.
    """

    def decorate(body):
        inputs = {}
        annotated = body.__annotations__ | shapes
        arguments = {
            key: _argument(key, shape, symbols, inputs) for key, shape in annotated.items()
        }
        outputs = body(**arguments)
        if hasattr(outputs, "_asdict"):
            outputs = outputs._asdict()
        names = [*inputs], [*outputs], OPTIONS[symbols]
        return ca.Function(name, [*inputs.values()], [*outputs.values()], *names)

    return decorate


def _argument(name, shape, symbols, inputs):
    """A symbol of this shape, or a dict or NamedTuple of them; all are added to `inputs`."""
    if hasattr(shape, "_asdict"):
        return type(shape)(**_argument(name, shape._asdict(), symbols, inputs))
    if isinstance(shape, dict):
        return {key: _argument(key, entry, symbols, inputs) for key, entry in shape.items()}
    sparsity = shape if isinstance(shape, ca.Sparsity) else ca.Sparsity.dense(*shape)
    inputs[name] = symbols.sym(name, sparsity)
    return inputs[name]


def short_cut(flag, symbols=ca.SX):
    """Decorator: a Function of these symbols that skips what does not count where `flag` is 1.

    The flag is one of its inputs. It becomes a branch between the Function with flag = 1 and the
    whole one. On the virtual machine, and of other symbols, the Function remains as it is.
    """

    def decorate(whole):
        if loop_symbols() is ca.SX or whole.is_a("SXFunction") != (symbols is ca.SX):
            return whole
        place = whole.index_in(flag)
        names = whole.name_in(), whole.name_out()
        inputs = whole.sx_in() if symbols is ca.SX else whole.mx_in()
        results = whole.call([*inputs[:place], symbols(1), *inputs[place + 1 :]], True, False)
        short = ca.Function(f"{whole.name()}_short", inputs, results, *names, OPTIONS[symbols])
        either = ca.Function.if_else(f"{whole.name()}_or_not", short, whole)
        inputs = whole.mx_in()
        outputs = either.call([inputs[place], *inputs])
        return ca.Function(whole.name(), inputs, outputs, *names, OPTIONS[ca.MX])

    return decorate


def in_turn(name, shapes, state, has_ended):
    """What stands in for a loop with an early exit, which CasADi has not.

    Args:
        name: Of the Functions, which a suffix follows.
        shapes: {name: shape} of their inputs, of which the state is a part.
        state: Names of what they return.
        has_ended: (inputs, results of the first) -> 1 where the second has nothing to do.

    Returns:
        A function (suffix, first, second) -> Function that runs `first` and, only if that has not
        ended, `second`. A loop is unrolled by doubling: each Function runs the one before it twice.
    """

    @casadi_function(f"{name}_ended", ca.MX, **shapes)
    def ended(**inputs):
        return {piece: inputs[piece] for piece in state}

    def then(suffix, first, second):
        @casadi_function(f"{name}_{suffix}", ca.MX, **shapes)
        def both(**inputs):
            after = first(**inputs)
            unless_ended = ca.Function.if_else(f"{name}_{suffix}_or_not", ended, second)
            result = unless_ended(has_ended(inputs, after), *(inputs | after).values())
            return dict(zip(state, result))

        return both

    return then


def with_packed_memory(name, memory, symbols=ca.MX, **shapes):
    """`casadi_function` whose `memory` (name: shape) is packed in one vector, its first input.

    The function takes each piece by its name and returns each piece's next value under that name.
    """

    def decorate(body):
        @casadi_function(name, symbols, memory=(packed_size(memory), 1), **shapes)
        def packed(**inputs):
            result = body(**unpack(inputs.pop("memory"), memory), **inputs)
            result = {"memory": ca.veccat(*(result.pop(piece) for piece in memory))} | result
            # A scan or log reads every entry, so that outputs must have no structural zeros.
            return {name: ca.densify(output) for name, output in result.items()}

        return packed

    return decorate


def packed_size(shapes):
    """Length of the vector that holds matrices of these shapes."""
    return sum(rows * columns for rows, columns in shapes.values())


def unpack(vector, shapes):
    """Matrices by name from the CasADi vector that holds them."""
    offsets = [0]
    for rows, columns in shapes.values():
        offsets.append(offsets[-1] + rows * columns)
    parts = ca.vertsplit(vector, offsets)
    return {name: ca.reshape(part, *shapes[name]) for name, part in zip(shapes, parts)}


def every(conditions):
    """1 where all of these comparisons hold; their sum takes less time than CasADi's mmin."""
    if isinstance(conditions, ca.MX):  # whose sum is a product with a vector of ones
        return ca.sumsqr(conditions) == conditions.numel()
    return ca.sum1(ca.vec(conditions)) == conditions.numel()


def select_inputs(function, values):
    """Those of `values` that the Function takes, in the order of its inputs."""
    return {name: values[name] for name in function.name_in() if name in values}


def inlined(function, values):
    """The results, by name, of a Function of those of these values that it takes.

    One of MX is not called: it would copy its results into those of the Function around it.
    """
    arguments = [values[name] for name in function.name_in()]
    results = function.call(arguments, function.is_a("MXFunction"), False)
    return dict(zip(function.name_out(), results))
