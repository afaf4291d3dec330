"""Compiled loops without a long wait: first without optimisation, then optimised in the background.

Without optimisation a loop compiles in a fifth to a third of the time and takes three times as long
to run; its results have the same bits. So the first runs of a structure are there sooner, and a
structure that is run often is compiled again by a thread and replaced.
"""

import contextlib
import functools
import threading
from dataclasses import dataclass

from rhec.core._casadi import cache, compiled

THREAD = "rhec compiler"  # the name of all threads that compile
# From so many loads on, a structure is optimised: that takes as long as it saves in 100 to 200 runs
# of 240 s. Where a person waits for many runs, as in the explorer, `optimise` is called at once.
WORTH_OPTIMISING = 120


@dataclass
class _Opened:
    """A structure that was loaded."""

    functions: dict | None  # those without optimisation; None: `compiled.load` is asked
    loads: int = 0  # of these


# By (build, structure), also the threads that compile without optimisation, None where none does.
_opened: dict = {}
_threads: dict = {}


def load(build, *structure):
    """As `compiled.load`, without optimisation as long as only that is compiled."""
    key = build, structure
    opened = _opened.get(key)
    if opened is None:
        begin(build, [structure])
        opened = _opened[key] = _Opened(_open(build, structure))
    # Without a compiler nothing is compiled any more, not even what was compiled before.
    if opened.functions is None or not compiled.compiler():
        return compiled.load(build, *structure)
    opened.loads += 1
    if opened.loads == WORTH_OPTIMISING:
        optimise(build, [structure])
    return opened.functions


def begin(build, structures):
    """Begin to compile those of several structures that are missing; `load` waits for its own.

    A structure compiles while the C of the next one is made, and while the caller goes on.

    Args:
        build: The function that builds the Functions, as for `compiled.load`.
        structures: A list of its tuples of arguments.
    """
    keys = dict.fromkeys((build, tuple(structure)) for structure in structures)
    new = {key: _compile(*key) for key in keys if key not in _threads}
    _threads.update(new)
    if any(new.values()):
        compiled.announce(build)


def optimise(build, structures):
    """Begin to optimise structures that are sure to be run often; the arguments are `begin`'s."""
    for structure in structures:
        opened = _opened.get((build, tuple(structure)))
        if opened and opened.functions:
            _optimising(build, tuple(structure))


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    if (build, structure) in _opened or compiled.is_compiled(build, *structure):
        return True
    return cache.contains(_early_name(build, structure))


def _early_name(build, structure):
    return compiled.library_name(build, structure, "not optimised")


def _compile(build, structure):
    """The thread that compiles a structure without optimisation, or None."""
    if is_compiled(build, *structure):
        return None
    # CasADi is not safe in threads: the text is made here, and only compilers run beside.
    names, text = compiled.library_text(build(*structure))
    if None in names.values():  # left to `compiled.load`
        return None
    return _beside(_make, _early_name(build, structure), names, text, False)


def _open(build, structure):
    """The Functions without optimisation, or None: then `compiled.load` is to be asked."""
    thread = _threads[build, structure]
    if thread:
        thread.join()
    if compiled.is_compiled(build, *structure):
        return None
    with contextlib.suppress(cache.UnusableError):
        return cache.load_or_build(_early_name(build, structure), _fail, compiled.open_library)[1]


@functools.cache
def _optimising(build, structure):
    """The thread that compiles a structure once more, optimised."""
    return _beside(_optimise, build, structure)


def _optimise(build, structure):
    with contextlib.suppress(cache.UnusableError):
        early = cache.load_or_build(_early_name(build, structure), _fail, compiled.read_text)
        if _make(compiled.library_name(build, structure), *early):
            _opened[build, structure].functions = None


def _beside(function, *arguments):
    """Call a function in a thread."""
    thread = threading.Thread(target=function, args=arguments, name=THREAD)
    thread.start()
    return thread


def _make(name, names, text, optimised=True):
    """Compile a library, and say whether that succeeded; a failure costs time alone."""
    make = functools.partial(compiled.compile_text, names=names, text=text, optimised=optimised)
    with contextlib.suppress(cache.UnusableError, MemoryError):
        cache.load_or_build(name, make, lambda folder: None)
        return True
    return False


def _fail(folder):
    raise OSError(f"{folder} was removed while it was being opened")
