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
    ends = np.cumsum([rows * columns for rows, columns in shapes.values()])
    parts = np.split(vector, ends[:-1])
    return {name: part.reshape(shapes[name], order="F") for name, part in zip(shapes, parts)}
