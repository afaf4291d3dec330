"""Compiled loops without a long wait: first without optimisation, then optimised in the background.

Without optimisation a loop compiles in a fifth to a third of the time and takes three times as long
to run; its results have the same bits. So the first runs of a structure are there sooner, and a
structure that is run often is compiled again by a thread and replaced.
"""

import functools
import multiprocessing
import os
import threading
from concurrent.futures import ThreadPoolExecutor

from rhec.core._casadi import cache, compiled

# From so many loads on, a structure is worth optimising where a person waits: it takes a second or
# two of another core. Workers and executed notebooks leave no core idle, and there it has to pay.
# Optimising takes as long as it saves in 100 to 200 runs of 240 s.
WORTH_OPTIMISING = 12
_WORTH_OPTIMISING_UNATTENDED = 120

_early = {}  # {(build, structure): _Early}, until the optimised library replaces it
_optimised = set()  # (build, structure) of which nothing but the optimised library is used


class _Early:
    """A structure that is compiled without optimisation.

    Attributes:
        functions: The Functions of build(*structure).
        loads: How often they were loaded.
        thread: The thread that compiles the optimised library, or None.
    """

    def __init__(self, build, structure, names, text, functions):
        self.functions = functions
        self.loads = 0
        self.thread = None
        self._name = compiled.library_name(build, structure)
        self._optimise = functools.partial(_compile_quietly, self._name, names, text)

    def load(self):
        """Return the Functions, and begin to optimise them when that pays."""
        self.loads += 1
        if self.loads == worth_optimising():
            self.thread = threading.Thread(target=self._optimise)
            self.thread.start()
        return self.functions

    def is_optimised(self):
        """Return whether the optimised library was compiled; where that failed, this one stays."""
        if self.thread is None or self.thread.is_alive():
            return False
        return cache.contains(self._name)


def worth_optimising():
    """Return the number of loads of a structure from which on this process optimises it."""
    is_worker = multiprocessing.parent_process() is not None
    if is_worker or os.environ.get("RHEC_UNATTENDED"):
        return _WORTH_OPTIMISING_UNATTENDED
    return WORTH_OPTIMISING


def load(build, *structure):
    """As `compiled.load`, without optimisation as long as only that is compiled."""
    return load_all(build, [structure])[0]


def load_all(build, structures):
    """Return the Functions of several structures; those that are missing compile at once.

    Args:
        build: The function that builds the Functions, as for `compiled.load`.
        structures: A list of its tuples of arguments.
    """
    keys = [(build, tuple(structure)) for structure in structures]
    missing = [key for key in dict.fromkeys(keys) if _is_missing(*key)]
    # CasADi is not safe in threads: it makes all texts here, and only compilers run at once.
    texts = [compiled.library_text(build(*structure)) for _, structure in missing]
    jobs = [(key, text) for key, text in zip(missing, texts) if None not in text[0].values()]
    if jobs:
        compiled.announce(build)
        with ThreadPoolExecutor(len(jobs)) as pool:
            made = [pool.submit(_compile_early, *key, *text) for key, text in jobs]
        for (key, text), done in zip(jobs, made):
            _open_early(key, text, done)
    return [_load_one(*key) for key in keys]


def _is_missing(build, structure):
    key = build, structure
    if key in _early or key in _optimised or not compiled.compiler():
        return False
    return not compiled.is_compiled(build, *structure)


def _early_name(build, structure):
    return compiled.library_name(build, structure, "not optimised")


def _compile_early(build, structure, names, text):
    """Compile the text without optimisation."""
    make = functools.partial(compiled.compile_text, names=names, text=text, optimised=False)
    cache.load_or_build(_early_name(build, structure), make, lambda folder: None)


def _open_early(key, text, done):
    """Open what was compiled; if that failed, `compiled.load` says why."""
    try:
        done.result()
        opened = cache.load_or_build(_early_name(*key), _fail, compiled.open_library)
    except cache.UnusableError:
        return
    _early[key] = _Early(*key, *text, opened[1])


def _fail(folder):
    raise OSError(f"{folder} was removed while it was being opened")


def _load_one(build, structure):
    if not compiled.compiler():  # nothing is compiled any more, not even what was compiled before
        return compiled.load(build, *structure)
    key = build, structure
    early = _early.get(key)
    if early is not None and not early.is_optimised():
        return early.load()
    _early.pop(key, None)
    _optimised.add(key)
    return compiled.load(build, *structure)


def _compile_quietly(name, names, text):
    """Compile the optimised library; a failure costs speed alone, so nobody is told."""
    make = functools.partial(compiled.compile_text, names=names, text=text)
    try:
        cache.load_or_build(name, make, lambda folder: None)
    except cache.UnusableError:
        return
