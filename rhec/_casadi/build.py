"""CasADi Functions from plain Python functions: named expressions in, a dict of named expressions
out.
"""

import casadi as ca
import numpy as np


def casadi_function(name, body, inputs, kind=ca.SX):
    """The Function of `body`. `inputs` gives each argument's shape or sparsity, in order.

    kind: SX for arithmetic (inlined, simplified), MX for what calls other Functions or a QP solver.
    """
    symbols = {
        key: kind.sym(key, shape if isinstance(shape, ca.Sparsity) else ca.Sparsity.dense(*shape))
        for key, shape in inputs.items()
    }
    outputs = body(**symbols)
    return ca.Function(
        name,
        [*symbols.values()],
        [*outputs.values()],
        [*symbols],
        [*outputs],
        {"allow_duplicate_io_names": True, "cse": True},
    )


def with_packed_memory(name, body, memory, inputs, kind=ca.MX):
    """The same, with the pieces of `memory` (name: shape) packed in one vector: (memory, inputs …)
    -> (memory, outputs …).

    `body` takes each piece by its name, and returns each piece's next value under that name.
    """

    def packed(**arguments):
        result = body(**unpack(arguments.pop("memory"), memory), **arguments)
        result = {"memory": ca.veccat(*(result.pop(piece) for piece in memory))} | result
        return {
            name: ca.densify(output) for name, output in result.items()
        }  # what is folded or logged has no gaps

    return casadi_function(name, packed, {"memory": (packed_size(memory), 1)} | inputs, kind)


def packed_size(shapes):
    """Length of the vector that holds matrices of these shapes."""
    return sum(rows * columns for rows, columns in shapes.values())


def unpack(vector, shapes):
    """The matrices, by name, that a vector holds one after the other, each column by column."""
    offsets = [0]
    for rows, columns in shapes.values():
        offsets.append(offsets[-1] + rows * columns)
    return {
        name: ca.reshape(part, *shapes[name])
        for name, part in zip(shapes, ca.vertsplit(vector, offsets))
    }


def unpack_array(vector, shapes):
    """The same of a NumPy vector, as views of it."""
    ends = np.cumsum([rows * columns for rows, columns in shapes.values()])
    return {
        name: part.reshape(shape, order="F")
        for (name, shape), part in zip(shapes.items(), np.split(vector, ends[:-1]))
    }


def shapes_of(memory):
    """The shapes of a memory's pieces, as `size`, `unpack` and `pieces` take them."""
    return {
        name: np.shape(piece) if np.ndim(piece) == 2 else (np.size(piece), 1)
        for name, piece in memory.items()
    }


def pack_array(memory):
    """The NumPy vector of a memory's pieces, as `unpack` reads it."""
    return np.concatenate([np.ravel(piece, order="F") for piece in memory.values()]).astype(float)


def select_inputs(function, values):
    """Those of `values` that the Function takes."""
    return {name: values[name] for name in function.name_in() if name in values}
