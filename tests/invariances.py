"""What is done to the world, and what must follow: relations between runs that need no oracle.

A Change maps a world (what a run is given) to another one, and the results of that run back to
those of the first. Estimates and plans of both then have to be equal. Worlds are dicts of arrays
and settings.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np


class Change(NamedTuple):
    """What is done to a world, and how its results are undone."""

    apply: Callable  # world -> world
    undo: Callable  # results (n, columns) -> those of the first world


def largest_difference(run, world, change):
    """The largest difference of the results of both runs, by the size of each column."""
    first = np.asarray(run(world))
    other = change.undo(np.asarray(run(change.apply(world))))
    size = np.maximum(np.ptp(first, axis=0), 1e-9)
    return float(np.max(np.abs(other - first) / size))
