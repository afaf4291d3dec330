"""CasADi Functions as a cached shared library, or on CasADi's virtual machine where there is no C
compiler.

The library's name is a digest of all that made it (this package's source, the structure asked for,
the versions and flags), so that what is found under it is never out of date.
"""

import contextlib
import ctypes
import functools
import hashlib
import json
import multiprocessing
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np

from rhec.core._casadi import cache
from rhec.core._casadi.c_text import generate_c

__all__ = [
    "BufferedFunction",
    "FLAGS",
    "HEADERS",
    "PROCESSOR",
    "compiler",
    "is_compiled",
    "library_name",
    "load",
    "loop_symbols",
    "run_compiler",
    "source_digest",
    "vector_instructions",
]


PROCESSOR = Path("/proc/cpuinfo")


def vector_instructions():
    """Those of the processor by which libm and NumPy choose how they compute, as far as known."""
    with contextlib.suppress(OSError), PROCESSOR.open() as about:
        return {*re.findall(r"\b(?:avx|fma|asimd|sve)\w*", about.read(8192))}  # of the first core
    return set()


# No fused multiply-add: the virtual machine has none, and both must agree. No interposition:
# CasADi's helpers may be inlined. The two passes left out take a fifth of the time to compile, and
# the code is no slower without them; Clang, whose code is faster, takes no notice. With AVX an
# operation need not overwrite one of its operands: a sixth fewer instructions, the same bits.
FLAGS = (
    *["-mavx"] * ("avx" in vector_instructions()),
    "-fno-gcse",
    "-fno-schedule-insns2",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",
    "-fno-semantic-interposition",
)
_CASADI = Path(ca.__file__).parent
HEADERS = Path(__file__).parent

_SLOWER = "on CasADi's virtual machine the results are the same, about five times slower"
_failed = set()  # compilers that failed in this process


def compiler():
    """The C compiler's path, or None, which is said once."""
    found = _working_compiler()
    return None if found in _failed else found


@functools.cache
def _working_compiler():
    named = os.environ.get("CC", "clang")
    found = shutil.which(named) or shutil.which("cc") or shutil.which("gcc")
    try:
        if found and not subprocess.run([found, "--version"], capture_output=True).returncode:
            return found
    except OSError:  # a file that is no program
        pass
    cache.say(f"{f'the C compiler {found} fails' if found else 'no C compiler found'}: {_SLOWER}")
    return None


def loop_symbols():
    """The symbols for Functions that repeat another.

    MX, which calls it, where code is compiled (small and built fast); SX, which inlines it, on the
    virtual machine.
    """
    return ca.MX if compiler() else ca.SX


_PACKAGE = Path(__file__).parents[2]
_ROOMS = (".", "core/*", "tracked_robot", "extensions", "simulation", "simulation/lanes")


@functools.cache
def source_digest(*modules):
    """A digest of the sources that make Functions, and of these modules.

    Figures, studies and notebooks are none of them: an edit there compiles nothing.
    """
    sources = {source for room in _ROOMS for source in _PACKAGE.glob(f"{room}/*.[ph]*")} | {
        Path(sys.modules[module].__file__) for module in modules
    }
    return hashlib.sha256(b"".join(source.read_bytes() for source in sorted(sources))).hexdigest()


def library_name(build, structure, *more):
    """The name of the compiled Functions of build(*structure)."""
    identity = repr(
        (
            build.__module__,
            build.__name__,
            _key(structure),
            source_digest(build.__module__),
            ca.__version__,
            compiler(),
            FLAGS,
            platform.machine(),
            *more,
        )
    )
    return hashlib.sha256(identity.encode()).hexdigest()[:24]


def _key(piece):
    """A structure's parts; a Model among them is replaced by the key of all that decides its C."""
    if isinstance(piece, tuple):
        return tuple(map(_key, piece))
    return getattr(piece, "key", piece)


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return not compiler() or cache.holds(library_name(build, structure))


@functools.cache
def load(build, *structure):
    """Return the Functions of the dict build(*structure), compiled.

    structure is made of strings, numbers and tuples. CasADi generates no C for qpOASES: Functions
    that call it stay on the virtual machine, as all do where they cannot be compiled.
    """
    if not compiler():
        return build(*structure)
    name = library_name(build, structure)
    # Before: what is wrong with a structure is no compiler's failure.
    functions = None if cache.holds(name) else build(*structure)

    def compile_library(folder):
        if _is_interactive():
            what = build.__module__.split(".")[-1].replace("_", " ")
            print(f"rhec: compiling the {what}, once (some seconds)", file=sys.stderr, flush=True)
        _compile_library(folder, functions or build(*structure))

    try:
        names, compiled = cache.kept(name, compile_library, _open)
    except cache.UnusableError as error:
        _failed.add(compiler())
        cache.say(f"nothing more is compiled, since {error}; {_SLOWER}")
        return build(*structure)
    return (build(*structure) if None in names.values() else {}) | compiled


def _open(folder):
    """The Functions' names in a library, and the Functions."""
    for daqp in _CASADI.glob("libdaqp.*[!a]"):  # a library finds it by its name, once it is loaded
        ctypes.CDLL(str(daqp))
    names = json.loads((folder / "functions.json").read_text())
    library = str(folder / "library.so")
    return names, {key: ca.external(name, library) for key, name in names.items() if name}


def _is_interactive():
    """True in a terminal or an interactive notebook, false in workers and executed notebooks."""
    notebook = "ipykernel" in sys.modules and not os.environ.get("RHEC_UNATTENDED")
    return multiprocessing.parent_process() is None and (notebook or sys.stderr.isatty())


def _calls_qpoases(function):
    return any(inner.class_name() == "QpoasesInterface" for inner in function.find_functions())


def _compile_library(folder, functions):
    """Generate and compile."""
    names = {
        key: None if _calls_qpoases(function) else function.name()
        for key, function in functions.items()
    }
    entries = [functions[key] for key in names if names[key]]
    (folder / "code.c").write_text(generate_c(entries, "code.c"))
    # A loop by Clang is as fast so, after two thirds of the time; a step alone is not.
    briefly = "block" in functions and "clang" in Path(compiler()).name
    # No path of DAQP's is put in: others may use the library when this environment is gone.
    flags = ["-O2", *["-fno-vectorize", "-fno-slp-vectorize"] * briefly, *FLAGS]
    flags += [f"-I{_CASADI / 'include'}", "-include", HEADERS / "elementary.h"]
    files = ["code.c", "-o", "library.so", f"-L{_CASADI}", "-ldaqp", "-lm"]
    run_compiler([compiler(), *flags, *files], folder)
    (folder / "functions.json").write_text(json.dumps(names))


def run_compiler(command, folder):
    """Run a compiler in a folder; OSError, with what it said, if it fails."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, errors="replace")
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if "error" in line] or [""]
        raise OSError(f"{command[0]} ended with {done.returncode} {said[0]}")


class BufferedFunction:
    """A Function whose arguments and results stay in NumPy arrays of its own.

    A call costs 0.1 µs where CasADi's ordinary one costs 26 µs. Matrices are held as CasADi stores
    them: the structural nonzeros, column by column.
    """

    def __init__(self, function):
        self.function = function
        self.arguments = {name: np.zeros(function.nnz_in(name)) for name in function.name_in()}
        self.results = {name: np.zeros(function.nnz_out(name)) for name in function.name_out()}
        self._buffer, self.call = function.buffer()
        for i, array in enumerate(self.arguments.values()):
            self._buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self.results.values()):
            self._buffer.set_res(i, memoryview(array))

    def set(self, **values):
        """Copy values in; matrices as usual, rows by columns."""
        for name, value in values.items():
            self.arguments[name][:] = np.ravel(value, order="F")

    def read_from(self, name, array):
        """Take an argument from this contiguous array from now on, without copying it."""
        self.arguments[name] = array
        self._buffer.set_arg(self.function.index_in(name), memoryview(array))

    def write_to(self, name, array):
        """Put a result into this contiguous array from now on."""
        self.results[name] = array
        self._buffer.set_res(self.function.index_out(name), memoryview(array))
