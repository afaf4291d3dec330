"""The memory of a step as a NumPy vector, in the order of `build.with_packed_memory`."""

import numpy as np


def shapes_of(memory):
    """Shapes of a memory's arrays, as `packed_size` and `unpack` take them."""
    return {
        name: np.shape(piece) if np.ndim(piece) == 2 else (np.size(piece), 1)
        for name, piece in memory.items()
    }


def pack_array(memory):
    """The NumPy vector of a memory's arrays {name: array}, each column by column."""
    pieces = [np.ravel(piece, order="F") for piece in memory.values()]
    return np.concatenate(pieces).astype(float)


def unpack_array(vector, shapes):
    """The opposite of `pack_array`: views of the NumPy vector, by name."""
    arrays = {}
    begin = 0
    for name, shape in shapes.items():  # np.split would take several times as long
        end = begin + shape[0] * shape[1]
        arrays[name] = vector[begin:end].reshape(shape, order="F")
        begin = end
    return arrays
