"""Names of the last release: they answer for one more, with one line that says the new name."""

import warnings

__all__ = ["Renamed", "new_name", "with_new_names"]

_RENAMED = {
    "reading": "process_noise",
    "horizon_rhe": "estimation_horizon",
    "horizon": "prediction_horizon",
    "arrival_s": "settling_time_s",
}


def new_name(old, among, depth=3):
    """Return the name among these that `old` has now, with a warning; None if it has none.

    depth: of the caller to be named in the warning, as in `warnings.warn`.
    """
    new = _RENAMED.get(old)
    if new not in among:
        return None
    message = f"{old!r} is now called {new!r}; the old name goes with the next release"
    warnings.warn(message, FutureWarning, stacklevel=depth)
    return new


def with_new_names(arguments, names):
    """Return keyword arguments for a function that takes `names`, each under its new name."""
    old = {name: new_name(name, names, 5) for name in arguments.keys() - names}
    old = {name: new for name, new in old.items() if new}
    given = {name: value for name, value in arguments.items() if name not in old}
    return given | {new: arguments[name] for name, new in old.items()}


class Renamed(dict):
    """A dict that answers to the names its entries had, too."""

    def __missing__(self, name):
        new = new_name(name, self)
        if new is None:
            raise KeyError(name)
        return self[new]
