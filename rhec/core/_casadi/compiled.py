"""CasADi Functions as a cached shared library, or without a C compiler on CasADi's virtual machine.

The library's name is a digest of everything that makes it: this package's source, the structure,
the versions and the flags. A library that is found under its name is therefore never out of date.
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
from rhec.core._casadi.c_text import generate_c, without_inlining

PROCESSOR = Path("/proc/cpuinfo")


def vector_instructions():
    """The processor's instructions by which libm and NumPy choose how they compute; Linux only."""
    with contextlib.suppress(OSError), PROCESSOR.open() as description:
        first_core = description.read(8192)
        return {*re.findall(r"\b(?:avx|fma|asimd|sve)\w*", first_core)}
    return set()


_AVX = ["-mavx"] if "avx" in vector_instructions() else []
FLAGS = (
    *_AVX,  # an operation need not overwrite an operand: a sixth fewer instructions, same bits
    "-fno-gcse",  # this pass and the next take a fifth of the time to compile, and gain nothing
    "-fno-schedule-insns2",
    "-fPIC",
    "-shared",
    "-ffp-contract=off",  # no fused multiply-add: the virtual machine has none; both must agree
    "-fno-semantic-interposition",  # CasADi's helpers may be inlined
)
_CASADI = Path(ca.__file__).parent
HEADERS = Path(__file__).parent

_SLOWER = "on CasADi's virtual machine the results are the same, about five times slower"
_ANSWER_S = 30.0  # in which a compiler has to tell its version
_COMPILE_S = 1800.0  # in which it has to compile; the largest structures take minutes
_failed = set()  # compilers that failed in this process


def compiler():
    """The C compiler's path, or None, which is reported once."""
    path = _working_compiler()
    return None if path in _failed else path


@functools.cache
def _working_compiler():
    named = os.environ.get("CC", "clang")
    if not named:  # `CC=` asks for none
        return None
    path = shutil.which(named) or shutil.which("cc") or shutil.which("gcc")
    if os.name != "posix":  # the flags and the cache's locks are those of POSIX
        path = None
    if path and answer_of([path, "--version"]) is not None:
        return path
    problem = f"the C compiler {path} fails" if path else "no C compiler found"
    cache.warn_once(f"{problem}: {_SLOWER}")
    return None


def answer_of(command):
    """What a compiler prints, or None if it fails, hangs or is no program."""
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=_ANSWER_S
        )
        return None if done.returncode else done.stdout
    return None


def loop_symbols():
    """The symbols for Functions that repeat another Function.

    MX calls it, which keeps compiled code small and fast to build. SX inlines it, which is faster
    on the virtual machine.
    """
    return ca.MX if compiler() else ca.SX


_PACKAGE = Path(__file__).parents[2]
# Folders whose sources make Functions. An edit of figures, studies or logs compiles nothing anew.
# In a hidden one JupyterLab keeps copies of what was edited in it.
_ROOMS = (".", "core", "core/[!.]*", "tracked_robot", "simulation")


@functools.cache
def source_digest(*modules):
    """A digest of the sources that make Functions, and of these modules."""
    # The folder of Python's bytecode is in `core`, too, but has no sources.
    patterns = [f"{room}/*.{ending}" for room in _ROOMS for ending in ("py", "h")]
    sources = {source for pattern in patterns for source in _PACKAGE.glob(pattern)}
    sources |= {Path(sys.modules[module].__file__) for module in modules}
    return hashlib.sha256(b"".join(source.read_bytes() for source in sorted(sources))).hexdigest()


def library_name(build, structure, *more):
    """The name of the compiled Functions of build(*structure): a digest of all that makes them."""
    code = (build.__module__, build.__name__, key_of(structure), source_digest(build.__module__))
    origin = (*code, ca.__version__, compiler(), FLAGS, platform.machine(), *more)
    return hashlib.sha256(repr(origin).encode()).hexdigest()[:24]


def key_of(part):
    """A structure in which each Model or Block is replaced by the key of all that decides its C."""
    return tuple(map(key_of, part)) if isinstance(part, tuple) else getattr(part, "key", part)


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return not compiler() or cache.contains(library_name(build, structure))


@functools.cache
def load(build, *structure):
    """Return the Functions of the dict build(*structure), compiled.

    The structure consists of strings, numbers, Models, Blocks and tuples of these. CasADi generates
    no C for qpOASES: Functions that call it stay on the virtual machine, as all Functions do where
    nothing can be compiled.
    """
    if not compiler():
        return build(*structure)
    name = library_name(build, structure)
    # Built first, because an error in the structure is not the compiler's failure.
    functions = None if cache.contains(name) else build(*structure)

    def compile_library(folder):
        announce(build)
        compile_text(folder, *library_text(functions or build(*structure)))

    try:
        names, compiled = cache.load_or_build(name, compile_library, open_library)
    except cache.UnusableError as error:
        _failed.add(compiler())
        cache.warn_once(f"nothing more is compiled, since {error}; {_SLOWER}")
        return build(*structure)
    return (build(*structure) if None in names.values() else {}) | compiled


def open_library(folder):
    """The Functions' names in a library, and the Functions."""
    for daqp in _CASADI.glob("libdaqp.*[!a]"):  # once loaded, a library finds it by its name
        ctypes.CDLL(str(daqp))
    names = json.loads((folder / "functions.json").read_text())
    library = str(folder / "library.so")
    return names, {key: ca.external(name, library) for key, name in names.items() if name}


def announce(build):
    """Say what is compiled to whoever waits: in a terminal, or in an interactive notebook.

    Notebooks show stderr as an error, so there it goes to stdout. Workers and executed notebooks
    say nothing.
    """
    if multiprocessing.parent_process() is not None:
        return
    is_notebook = "ipykernel" in sys.modules and not os.environ.get("RHEC_UNATTENDED")
    if is_notebook or sys.stderr.isatty():
        what = build.__module__.split(".")[-1].replace("_", " ")
        stream = sys.stdout if is_notebook else sys.stderr
        print(f"rhec: compiling the {what}, once (some seconds)", file=stream, flush=True)


def library_text(functions):
    """The C of Functions.

    Returns:
        {key: the Function's name in the library}, None for one without C, and the C.
    """
    names = {}
    for key, function in functions.items():
        calls = {inner.class_name() for inner in function.find_functions()}
        names[key] = None if "QpoasesInterface" in calls else function.name()
    text = generate_c([functions[key] for key in names if names[key]], "code.c")
    return names, without_inlining(text)


def compile_text(folder, names, text, optimised=True):
    """Compile the C of `library_text` into a folder; the optimised library has the same bits."""
    path = compiler()
    if path is None:  # it failed meanwhile, in another thread
        raise OSError("there is no C compiler any more")
    (folder / "code.c").write_text(text)
    flags = ["-O2" if optimised else "-O0", *FLAGS]
    # Without vectorising, Clang compiles a loop in two thirds of the time, and the loop is as fast.
    # A step alone would be slower.
    if "block" in names and "clang" in Path(path).name:
        flags += ["-fno-vectorize", "-fno-slp-vectorize"]
    flags += [f"-I{_CASADI / 'include'}", "-include", HEADERS / "elementary.h"]
    # The library does not record the path of DAQP, as that environment may be gone some day.
    files = ["code.c", "-o", "library.so", f"-L{_CASADI}", "-ldaqp", "-lm"]
    run_compiler([path, *flags, *files], folder)
    (folder / "functions.json").write_text(json.dumps(names))


def read_text(folder):
    """The names and the C that `compile_text` put into a folder."""
    return json.loads((folder / "functions.json").read_text()), (folder / "code.c").read_text()


def run_compiler(command, folder):
    """Run a compiler in a folder; OSError, with its message, if it fails."""
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_COMPILE_S,
        )
    except subprocess.TimeoutExpired:
        raise OSError(f"{command[0]} did not end in {_COMPILE_S:g} s") from None
    if done.returncode:
        messages = [line for line in done.stderr.splitlines() if "error" in line] or [""]
        raise OSError(f"{command[0]} ended with {done.returncode} {messages[0]}")


class Uncopied:
    """What holds compiled code with its work space, of which there is no copy."""

    def __reduce__(self):
        raise TypeError(
            "an object with compiled code cannot be copied or pickled; make another one with the "
            "same arguments"
        )


class BufferedFunction(Uncopied):
    """A Function whose arguments and results stay in NumPy arrays.

    A call costs 0.1 µs; CasADi's ordinary call costs 26 µs. Matrices are stored as CasADi stores
    them: the structural nonzeros, column by column.
    """

    def __init__(self, function):
        self.function = function
        self._buffer, self.call = function.buffer()
        self.arguments = {}
        self.results = {}
        for name in function.name_in():
            self.read_from(name, np.zeros(function.nnz_in(name)))
        for name in function.name_out():
            self.write_to(name, np.zeros(function.nnz_out(name)))

    def set(self, **values):
        """Copy in values by name; matrices as (rows, columns)."""
        for name, value in values.items():
            self.arguments[name][:] = np.ravel(value, order="F")

    def read_from(self, name, array):
        """From now on, take an argument from this contiguous array without copying it."""
        self.arguments[name] = array
        self._buffer.set_arg(self.function.index_in(name), memoryview(array))

    def write_to(self, name, array):
        """From now on, put a result into this contiguous array."""
        self.results[name] = array
        self._buffer.set_res(self.function.index_out(name), memoryview(array))
