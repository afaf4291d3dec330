"""Compiled loops without a long wait: first without optimisation, then optimised in the background.

Without optimisation a loop compiles in a fifth to a third of the time and takes three times as long
to run; its results have the same bits. So the first runs of a structure are there sooner, and a
structure that is run often is compiled again by a thread and replaced.
"""

import functools
import multiprocessing
import os
import threading

from rhec.core._casadi import cache, compiled

# From so many loads on, a structure is worth optimising where a person waits: it takes a second or
# two of another core. Workers and executed notebooks leave no core idle, and there it has to pay.
# Optimising takes as long as it saves in 100 to 200 runs of 240 s.
WORTH_OPTIMISING = 12
_WORTH_OPTIMISING_UNATTENDED = 120

_compiling = {}  # {(build, structure): the thread that compiles it}, until it is opened
_early = {}  # {(build, structure): _Early}, until the optimised library replaces it
_optimised = set()  # (build, structure) of which nothing but the optimised library is used


class _Early:
    """A structure that is compiled without optimisation.

    Attributes:
        functions: The Functions of build(*structure).
        loads: How often they were loaded.
        thread: The thread that compiles the optimised library, or None.
    """

    def __init__(self, key, functions):
        self.functions = functions
        self.loads = 0
        self.thread = None
        self._name = compiled.library_name(*key)
        self._optimise = functools.partial(_optimise, _early_name(*key), self._name)

    def load(self):
        """Return the Functions, and begin to optimise them when that pays."""
        self.loads += 1
        if self.loads == worth_optimising():
            self.optimise()
        return self.functions

    def optimise(self):
        """Begin to optimise the Functions, once."""
        if self.thread is None:
            self.thread = threading.Thread(target=self._optimise)
            self.thread.start()

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
    key = build, structure
    begin(build, [structure])
    if _is_missing(*key):
        _open_early(*key)
    early = _early.get(key)
    # Without a compiler nothing is compiled any more, not even what was compiled before.
    if early is not None and compiled.compiler() and not early.is_optimised():
        return early.load()
    if compiled.compiler():
        _early.pop(key, None)
        _optimised.add(key)
    return compiled.load(build, *structure)


def begin(build, structures):
    """Begin to compile those of several structures that are missing; `load` waits for its own.

    A structure compiles while the C of the next one is made, and while the caller goes on.

    Args:
        build: The function that builds the Functions, as for `compiled.load`.
        structures: A list of its tuples of arguments.
    """
    for structure in structures:
        key = build, tuple(structure)
        if key not in _compiling and not is_compiled(build, *structure):
            _begin_one(build, tuple(structure))


def optimise(build, structures):
    """Begin to optimise structures that are sure to be run often; the arguments are `begin`'s."""
    for structure in structures:
        if early := _early.get((build, tuple(structure))):
            early.optimise()


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return not _is_missing(build, structure) or cache.contains(_early_name(build, structure))


def _begin_one(build, structure):
    # CasADi is not safe in threads: the text is made here, and only compilers run beside.
    names, text = compiled.library_text(build(*structure))
    if None in names.values():  # left to `compiled.load`
        _optimised.add((build, structure))
        return
    if not _compiling:
        compiled.announce(build)
    make = functools.partial(compiled.compile_text, names=names, text=text, optimised=False)
    thread = threading.Thread(target=_build_quietly, args=(_early_name(build, structure), make))
    thread.start()
    _compiling[build, structure] = thread


def _is_missing(build, structure):
    key = build, structure
    if key in _early or key in _optimised or not compiled.compiler():
        return False
    return not compiled.is_compiled(build, *structure)


def _early_name(build, structure):
    return compiled.library_name(build, structure, "not optimised")


def _open_early(build, structure):
    """Open the structure's library; if it could not be compiled, `compiled.load` says why."""
    key = build, structure
    if thread := _compiling.get(key):
        thread.join()
        _compiling.pop(key, None)
    if not cache.contains(_early_name(*key)):
        return
    try:
        _, functions = cache.load_or_build(_early_name(*key), _fail, compiled.open_library)
    except cache.UnusableError:
        return
    _early[key] = _Early(key, functions)


def _fail(folder):
    raise OSError(f"{folder} was removed while it was being opened")


def _optimise(early_name, name):
    """Compile the C of an early library once more, optimised."""
    try:
        names, text = cache.load_or_build(early_name, _fail, compiled.read_text)
    except cache.UnusableError:
        return
    _build_quietly(name, functools.partial(compiled.compile_text, names=names, text=text))


def _build_quietly(name, make):
    """Compile a library; a failure costs time alone, so nobody is told."""
    try:
        cache.load_or_build(name, make, lambda folder: None)
    except (cache.UnusableError, MemoryError):
        return
