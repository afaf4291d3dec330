"""A Function evaluated for many runs, several at a time where there are SIMD lanes.

Arrays have the shape (groups, length, lanes): a group has one run in each lane, and lanes that are
left over repeat the last run. What all runs share has the shape (1, length, lanes).
"""

import numpy as np

from rhec.core._casadi import cache, compiled
from rhec.core.lanes import lanes

_ONE_BY_ONE = (
    "no SIMD lanes, for want of a C++ compiler that can make them: a batch computes one run after "
    "the other, with the same results, some five times slower"
)


class Rows:
    """One compiled Function.

    Attributes:
        lanes: Runs in a group; 1 where there are no lanes.
        sizes: {argument: length}, in order.
        lengths: {result: length}, in order; the first is the memory.
    """

    def __init__(self, build, *structure):
        if not lanes.is_compiled(build, *structure):
            compiled.announce(build)
        self._block = lanes.load(build, *structure)
        if self._block:
            self.lanes = self._block.lanes
            self.sizes = self._block.sizes
            self.lengths = {name: rows * cols for name, (rows, cols) in self._block.shapes.items()}
            return
        cache.warn_once(_ONE_BY_ONE)
        function = compiled.load(build, *structure)["block"]
        self._call = compiled.BufferedFunction(function)
        self.lanes = 1
        self.sizes = {name: function.nnz_in(name) for name in function.name_in()}
        self.lengths = {name: function.nnz_out(name) for name in function.name_out()}

    def evaluate(self, arguments, results):
        """Evaluate all groups.

        Args:
            arguments: {name: array} of the arguments.
            results: {name: array} of the results, to write to; none of them is an argument.
        """
        n_groups = len(results["memory"])
        if self._block:
            given = [_address(arguments[name]) for name in self.sizes]
            written = [_address(results[name]) for name in self.lengths]
            with self._block.lock:
                self._block.call_groups(n_groups, given, written)
            return
        for run in range(n_groups):
            for name, argument in self._call.arguments.items():
                array = arguments[name]
                argument[:] = array[run if len(array) > 1 else 0, :, 0]
            self._call.call()
            for name, result in self._call.results.items():
                results[name][run, :, 0] = result


def _address(array):
    """Return the address of the first group, and the bytes from one group to the next."""
    return array.ctypes.data, array.strides[0] if len(array) > 1 else 0


def zeros(n, length, width):
    """Return zeros for n runs of this length, in groups of `width`."""
    return lanes.aligned(-(-n // width), length, width)


def to_lanes(values, width):
    """Return values (n, length), one row for each run, in groups of `width`."""
    array = zeros(len(values), values.shape[1], width)
    run_of_lane = np.minimum(np.arange(len(array) * width), len(values) - 1)
    array[:] = values[run_of_lane].reshape(len(array), width, -1).swapaxes(1, 2)
    return array


def shared(value, width):
    """Return a vector that all runs share."""
    array = zeros(1, len(value), width)
    array[:] = value[:, None]
    return array


def get_runs(array, runs):
    """Return the rows (runs, length) of some runs, given by their numbers."""
    width = array.shape[2]
    return array[runs // width, :, runs % width]


def set_runs(array, runs, values):
    """Set the rows of some runs, given by their numbers, to values (runs, length) or (length,)."""
    width = array.shape[2]
    array[runs // width, :, runs % width] = values


def evaluate_some(rows, runs, arguments, results):
    """Evaluate a Rows for some runs, given by their numbers; the results of others remain."""
    n_groups = len(results["memory"])
    # What all runs share has one group. So has everything where one group holds all runs; taking
    # the runs from it is right for both.
    some = {
        name: array if len(array) < n_groups else to_lanes(get_runs(array, runs), rows.lanes)
        for name, array in arguments.items()
    }
    few = {name: zeros(len(runs), array.shape[1], rows.lanes) for name, array in results.items()}
    rows.evaluate(some, few)
    for name, array in few.items():
        set_runs(results[name], runs, get_runs(array, np.arange(len(runs))))
