"""Compiled loops without a long wait: first without optimisation, then optimised in the background.

Without optimisation a loop compiles in a fifth to a third of the time and takes three times as long
to run; its results have the same bits. So the first runs of a structure are there sooner, and a
structure that is run often is compiled again by a thread and replaced.
"""

import functools
import threading

from rhec.core._casadi import cache, compiled

THREAD = "rhec compiler"  # the name of all threads that compile
# From so many loads on, a structure is optimised: that takes as long as it saves in 100 to 200 runs
# of 240 s. Where a person waits for many runs, as in the explorer, `optimise` is called at once.
WORTH_OPTIMISING = 120


def load(build, *structure):
    """As `compiled.load`, without optimisation as long as only that is compiled."""
    begin(build, [structure])
    return library(build, structure).load()


def begin(build, structures):
    """Begin to compile those of several structures that are missing; `load` waits for its own.

    A structure compiles while the C of the next one is made, and while the caller goes on.

    Args:
        build: The function that builds the Functions, as for `compiled.load`.
        structures: A list of its tuples of arguments.
    """
    is_announced = False
    for structure in structures:
        has_begun = library(build, tuple(structure)).begin()
        if has_begun and not is_announced:
            compiled.announce(build)
            is_announced = True


def optimise(build, structures):
    """Begin to optimise structures that are sure to be run often; the arguments are `begin`'s."""
    for structure in structures:
        library(build, tuple(structure)).optimise()


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return library(build, structure).is_compiled()


@functools.cache
def library(build, structure):
    """The Library of build(*structure) in this process."""
    return Library(build, structure)


class Library:
    """The Functions of a structure: compiled without optimisation, then replaced."""

    def __init__(self, build, structure):
        self._build = build
        self._structure = structure
        self._compiling = None  # the thread that compiles without optimisation
        self._functions = None  # those without optimisation, while they are used
        self._loads = 0  # of these
        self._optimising = None  # the thread that compiles the optimised library
        self._is_final = False  # whether nothing but the optimised library is used from now on

    def is_compiled(self):
        """Return whether `load` has nothing to compile."""
        return not self._is_missing() or cache.contains(self._early_name())

    def begin(self):
        """Begin to compile without optimisation, once; return whether that was to be done."""
        if self._compiling or self.is_compiled():
            return False
        # CasADi is not safe in threads: the text is made here, and only compilers run beside.
        names, text = compiled.library_text(self._build(*self._structure))
        if None in names.values():  # left to `compiled.load`
            self._is_final = True
            return False
        make = functools.partial(compiled.compile_text, names=names, text=text, optimised=False)
        self._compiling = _run_beside(_build_quietly, self._early_name(), make)
        return True

    def load(self):
        """Return the Functions, and begin to optimise them when that pays."""
        if self._is_missing():
            self._open()
        # Without a compiler nothing is compiled any more, not even what was compiled before.
        has_compiler = bool(compiled.compiler())
        if has_compiler and self._functions and not self._is_optimised():
            self._loads += 1
            if self._loads == WORTH_OPTIMISING:
                self.optimise()
            return self._functions
        if has_compiler:
            self._functions = None
            self._is_final = True
        return compiled.load(self._build, *self._structure)

    def optimise(self):
        """Begin to optimise the Functions, once, if they are there without optimisation."""
        if self._functions and not self._optimising:
            name = compiled.library_name(self._build, self._structure)
            self._optimising = _run_beside(_optimise, self._early_name(), name)

    def _is_missing(self):
        if self._functions or self._is_final or not compiled.compiler():
            return False
        return not compiled.is_compiled(self._build, *self._structure)

    def _is_optimised(self):
        """Whether the optimised library was compiled; where that failed, this one stays."""
        if not self._optimising or self._optimising.is_alive():
            return False
        return compiled.is_compiled(self._build, *self._structure)

    def _early_name(self):
        return compiled.library_name(self._build, self._structure, "not optimised")

    def _open(self):
        """Open the library; if it could not be compiled, `compiled.load` says why."""
        if self._compiling:
            self._compiling.join()
        name = self._early_name()
        if not cache.contains(name):
            return
        try:
            _, self._functions = cache.load_or_build(name, _fail, compiled.open_library)
        except cache.UnusableError:
            return


def _run_beside(function, *arguments):
    """Call a function in a thread."""
    thread = threading.Thread(target=function, args=arguments, name=THREAD)
    thread.start()
    return thread


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
