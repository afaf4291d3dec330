"""Known signals of a Model, which come with each sample: checked, and held where one is missing."""

from collections.abc import Mapping

import numpy as np

from rhec.core._casadi.validation import numbers, refuse


def checked_known(names, given, held):
    """The known signals of a sample; what is not given, or is not finite, is as it was.

    They are held only once all else of the sample is checked: a sample that is refused leaves none.

    Args:
        names: Of the Model's known signals.
        given: {name: number, or (n,) numbers}; None: nothing is given.
        held: (n_d, n) array of the last ones, NaN before the first.

    Returns:
        A new array (n_d, n).

    Raises:
        ValueError: If a name or a shape does not fit, or if a signal never had a value.
    """
    if given is not None and not isinstance(given, Mapping):
        refuse("known was", given, f"it should be a dict with numbers for {names}")
    taken = held.copy()
    for name, value in (given or {}).items():
        if name not in names:
            refuse("known had", name, f"the Model has the known signals {names}")
        row = taken[names.index(name)]
        value = numbers(f"known[{name!r}]", value)
        if value.shape not in ((), row.shape):
            several = f" or {len(row)} numbers" if len(row) > 1 else ""
            expected = f"it should be a number{several}"
            raise ValueError(f"known[{name!r}] had shape {value.shape}; {expected}")
        np.copyto(row, value, where=np.isfinite(value))
    for name, row in zip(names, taken):
        if np.isnan(row).any():
            raise ValueError(f"known had no {name!r}; the first sample needs a number for it")
    return taken
