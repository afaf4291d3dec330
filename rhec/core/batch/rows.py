"""Arrays of many runs, and the evaluation of a Program for some of them.

Arrays have the shape (groups, length, lanes): a group has one run in each lane, and lanes that are
left over repeat the last run. What all runs share has the shape (1, length, lanes).
"""

import numpy as np

from rhec.core.runner import aligned


def zeros(n, length, width):
    """Return zeros for n runs of this length, in groups of `width`."""
    return aligned(-(-n // width), length, width)


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


def evaluate_some(program, runs, arguments, results):
    """Evaluate a Program for some runs, given by their numbers; the results of others remain."""
    n_groups = len(results["memory"])
    # What all runs share has one group. So has everything where one group holds all runs; taking
    # the runs from it is right for both.
    some = {
        name: array if len(array) < n_groups else to_lanes(get_runs(array, runs), program.lanes)
        for name, array in arguments.items()
    }
    few = {name: zeros(len(runs), array.shape[1], program.lanes) for name, array in results.items()}
    program.evaluate(len(few["memory"]), some, few)
    for name, array in few.items():
        set_runs(results[name], runs, get_runs(array, np.arange(len(runs))))
