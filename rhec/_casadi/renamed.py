"""Names of an earlier release: they still answer, for one release, with a line that says the new one."""

import warnings

RENAMED = {
    "reading": "process_noise",
    "horizon_rhe": "estimation_horizon",
    "horizon": "prediction_horizon",
    "arrival_s": "settling_time_s",
}


def new_name(old, among, depth=3):
    """The name among these that `old` has now, said once in every place that asks; else None."""
    new = RENAMED.get(old)
    if new not in among:
        return None
    message = f"{old!r} is now called {new!r}; the old name goes with the next release"
    warnings.warn(message, FutureWarning, stacklevel=depth)
    return new


def with_new_names(arguments, names):
    """Keyword arguments for a function that takes `names`, each under the name it has now."""
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
