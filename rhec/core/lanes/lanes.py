"""Several scans at a time, one per SIMD lane, with the same bits as scans one after the other.

CasADi's C of a Function is compiled as C++ with vectors as numbers (lanes.h). If the platform or
the Function does not allow this (no C++ compiler, a QP solver), the compilation fails once.
"""

import contextlib
import ctypes
import functools
import json
import math
import operator
import os
import re
import shutil
import threading
from pathlib import Path

import casadi as ca
import numpy as np

from rhec.core._casadi import cache, compiled
from rhec.core.lanes.parts import compile_by_parts

# These passes take a fifth of the time to compile, and gain nothing. Clang refuses the flags.
_GCC_FLAGS = ("-fno-tree-vrp", "-fno-thread-jumps", "-fno-tree-pre")
# Helpers of CasADi's C that branch on a number. lanes.h replaces those that a loop may use.
_HELPERS = "low|interpn|interpn_weights|interpn_interpolate|fmin|fmax|fabs|sign"
# The C of Function.if_else, and of an assignment, which may be a sine or cosine.
_IF_ELSE = re.compile(
    r"->\((?P<outputs>\S*)\) \*/\n(?P<head>.* \{)\n"
    r"  if \(arg\[0\] \? casadi_to_int\(\*arg\[0\]\) : 0\) \{\n"
    r"    if \((?P<yes>\w+)\(arg\+1, res, iw, w, 0\)\) return 1;\n  \} else \{\n"
    r"    if \((?P<no>\w+)\(arg\+1, res, iw, w, 0\)\) return 1;\n  \}\n  return 0;"
)
_ASSIGNMENT = re.compile(r"  (a\d+)=(?:(sin|cos)\((a\d+)\);$)?")


def _vectorise(code):
    """Return CasADi's C as C++ for lanes, with calls for operators that C++ cannot overload."""
    code = "\n".join(_join_sines_and_cosines(code.splitlines()))
    code = re.sub(rf"^\w+ casadi_({_HELPERS})\(.*?^}}\n", "", code, flags=re.M | re.S)
    code = re.sub(r"\bcasadi_(fmin|fmax|fabs|sign)\(", r"\1(", code)
    code = re.sub(r"\((\w+|\(\*cr\+\+\))\?(\w+(?:\[i\])?):0\)", r"select(\1, \2, 0.0)", code)
    # An interpolant of two dimensions with values as inputs, whatever its name.
    table = r"(/\* \w+:\(x\[2\],#c.*?)casadi_interpn\("
    code = re.sub(table, r"\1bilinear(", code, flags=re.S)
    return _IF_ELSE.sub(_call_if_else, code)


def _join_sines_and_cosines(lines):
    """Yield lines of C in which sine and cosine of an angle are computed by one call.

    A pair is valid until the variable of its angle changes.
    """
    pairs = {}  # {variable: name of the pair of its sine and cosine}
    for number, line in enumerate(lines):
        assignment = _ASSIGNMENT.match(line)
        if assignment:
            variable, function, angle = assignment.groups()
            if function:
                call = "" if angle in pairs else f"complex pair{number}=own_cis({angle}); "
                pair = pairs.setdefault(angle, f"pair{number}")
                part = dict(sin="imaginary", cos="real")[function]
                line = f"  {call}{variable}={pair}.{part};"
            pairs.pop(variable, None)
        elif line == "}":
            pairs.clear()
        yield line


def _call_if_else(match):
    """Return Function.if_else as a call of `if_else` in lanes.h with the output lengths."""
    shapes = re.findall(r"o\d+(?:\[(?:[^],]*,)?([^]]*)\])?", match["outputs"])
    lengths = [math.prod(map(int, re.findall(r"\d+", shape))) for shape in shapes]
    functions = f"{match['yes']}, {match['no']}"
    call = f"if_else<{', '.join(map(str, lengths))}>({functions}, arg, res, iw, w)"
    return f"*/\n{match['head']}\n  return {call};"


@functools.cache
def _compiler():
    """Return the C++ compiler and its macros, which identify the processor; None without lanes."""
    compiler = shutil.which(os.environ.get("CXX", "c++")) or shutil.which("clang++")
    if not (compiler and compiled.compiler()):
        return None
    command = [compiler, "-march=native", "-dM", "-E", "-x", "c++", os.devnull]
    macros = compiled.answer_of(command)
    return None if macros is None else (compiler, macros)


def _name(build, structure):
    return compiled.library_name(build, structure, "lanes", *_compiler())


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return not _compiler() or cache.contains(_name(build, structure))


@functools.cache
def load(build, *structure):
    """Return the block of build(*structure) for several runs, or None if lanes are unavailable.

    `build` returns {block, step}: the Function of a call, and that of a sample, if it is another.
    """
    if not _compiler():
        return None

    def make(place):
        _compile(place, build(*structure))

    def open_block(folder):
        return _Block(folder) if (folder / "library.so").exists() else None

    with contextlib.suppress(cache.UnusableError):
        return cache.load_or_build(_name(build, structure), make, open_block)
    return None


def _text(function, name=None):
    """Return the C++ of a Function, for lanes."""
    generator = ca.CodeGenerator(f"{name or function.name()}.c")
    generator.add(function)
    return f'extern "C" {{\n{_vectorise(generator.dump())}}}\n'


def _compile(place, functions):
    """Compile the Functions of a scan into a folder, which has no library.so if that fails."""
    # Compared with -O1, -O2 takes a third longer to compile; campaigns gain 3 to 20 %. The last
    # level counts, so the flags of `compiled` may say another.
    compiler, macros = _compiler()
    flags = ["-O2", *compiled.FLAGS, "-std=gnu++17", "-march=native", "-w", "-Dcasadi_real=lanes"]
    if "__clang__" not in macros:
        flags += _GCC_FLAGS
    header = Path(__file__).with_name("lanes.h")
    command = [compiler, *flags, "-include", header, f"-I{compiled.HEADERS}"]
    key = _compiler(), flags, compiled.source_digest()
    function = functions["block"]
    text = _text(function, "code")
    with contextlib.suppress(OSError, cache.UnusableError):
        compile_by_parts(place, text, functions.get("step", function), _text, key, command)
    sizes = {name: function.nnz_in(name) for name in function.name_in()}
    shapes = {name: function.size_out(name) for name in function.name_out()}
    (place / "block.json").write_text(json.dumps([sizes, shapes]))


def aligned(*shape):
    """Return zeros of this shape whose address is a multiple of the last dimension's size.

    Loading a register requires that, where the last dimension is that of the lanes.
    """
    n = math.prod(shape)
    raw = np.zeros(n + shape[-1])
    begin = -raw.ctypes.data // 8 % shape[-1]
    return raw[begin : begin + n].reshape(shape)


class _Block:
    """A compiled Function, such as that of a block of samples; each number has one entry per lane.

    Attributes:
        sizes: {argument: length}, in order; of a scan the memory, the stream and the settings.
        shapes: {result: (rows, columns)}, in order; of a scan the memory and the rows.
        lanes: Number of lanes.
        lock: Lock for using the block, because all threads share its arrays.
        last_settings: {name: list of the last values of the lanes}.
    """

    def __init__(self, folder):
        self.sizes, self.shapes = json.loads((folder / "block.json").read_text())
        self.lock = threading.Lock()
        self.last_settings = {}
        self._arrays = {}  # settings have their own names; all other names contain a space
        self._library = ctypes.CDLL(str(folder / "library.so"))
        self.lanes = self._library.code_casadi_real_size() // 8
        # CasADi's convention: pointers to arguments and results, and integer and real work space.
        lengths = [ctypes.c_longlong() for _ in range(4)]
        self._library.block_work(*map(ctypes.byref, lengths))
        n_arguments, n_results, n_integers, n_reals = (length.value for length in lengths)
        self._arguments = (ctypes.c_void_p * n_arguments)()
        self._results = (ctypes.c_void_p * n_results)()
        self._integers = (ctypes.c_longlong * n_integers)()
        self._reals = ctypes.c_void_p(self.array("work space", n_reals).ctypes.data)

    def array(self, name, *shape):
        """Return the array of this name, (*shape, lanes), reused while its shape is equal."""
        if name not in self._arrays or self._arrays[name].shape[:-1] != shape:
            self._arrays[name] = aligned(*shape, self.lanes)
        return self._arrays[name]

    def interleave(self, name, values, *shape):
        """Return the array of this name with one value per lane; values may be shorter than it."""
        array = self.array(name, *shape)
        first = values[0]
        if all(value is first for value in values):
            array[: len(first)] = first[..., None]
        else:
            for lane, value in enumerate(values):
                array[: len(value), ..., lane] = value
        return array

    def set_argument(self, place, array):
        """Set an argument to an array of this block."""
        self._arguments[place] = array.ctypes.data

    def call(self, memory, stream, next_memory, rows):
        """Evaluate the block, from the addresses of memory and stream to those of the results."""
        self._arguments[0] = memory
        self._arguments[1] = stream
        self._results[0] = next_memory
        self._results[1] = rows
        self._library.block(self._arguments, self._results, self._integers, self._reals, 0)

    def call_groups(self, n_groups, arguments, results):
        """Evaluate the Function for one group of lanes after the other.

        Args:
            n_groups: Number of groups.
            arguments: Pairs (address, stride) of the arguments, in order, in bytes from group to
                group; a stride of 0 is for an argument that all groups share.
            results: The same of the results.
        """
        for group in range(n_groups):
            for place, (address, stride) in enumerate(arguments):
                self._arguments[place] = address + group * stride
            for place, (address, stride) in enumerate(results):
                self._results[place] = address + group * stride
            self._library.block(self._arguments, self._results, self._integers, self._reals, 0)


def scan(block, memories, streams, settings):
    """Scan the block over at most as many runs as lanes, as `scan.scan` does for one run.

    Args:
        block: The block that `load` returned.
        memories: Initial memory of each run, a vector.
        streams: Inputs of each run, (samples, inputs); the numbers of samples may differ.
        settings: {name: array} of each run.

    Returns:
        The rows of each run, (samples, outputs).
    """
    # Idle lanes repeat the last run.
    n_idle = block.lanes - len(memories)
    memories = [*memories, *memories[-1:] * n_idle]
    settings = [*settings, *settings[-1:] * n_idle]
    padded_streams = [*streams, *streams[-1:] * n_idle]
    with block.lock:
        _set_settings(block, settings)
        rows = _scan(block, memories, padded_streams)
        # The copy (lanes, outputs, samples) makes the columns of a run contiguous.
        by_lane = np.ascontiguousarray(rows.T)
    return [lane[:, : len(stream)].T for lane, stream in zip(by_lane, streams)]


def _set_settings(block, settings):
    """Set the settings of all lanes; unchanged values are not copied again."""
    _, _, *names = block.sizes
    for place, name in enumerate(names, 2):
        values = [run_settings[name] for run_settings in settings]
        last = block.last_settings.get(name)
        if last is not None and all(map(operator.is_, values, last)):
            continue
        block.last_settings[name] = values
        # An array that several lanes share is flattened once, so that `interleave` recognises it.
        flat = {id(value): np.ravel(value, order="F") for value in values}
        flat_values = [flat[id(value)] for value in values]
        block.set_argument(place, block.interleave(name, flat_values, block.sizes[name]))


def _scan(block, memories, streams):
    """Return the rows of all lanes, (samples, outputs, lanes), in an array of the block."""
    memory_name, *_ = block.sizes
    n_rows, length = block.shapes["rows"]
    n_samples = max(map(len, streams))
    n_blocks = -(-n_samples // length)  # rounded up: the last block may be partly unused
    n_samples = n_blocks * length
    memory = block.interleave("first memory", memories, block.sizes[memory_name])
    stream = block.interleave("all streams", streams, n_samples, streams[0].shape[1])
    next_memory = block.array("next memory", len(memory))
    rows = block.array("all rows", n_samples, n_rows)
    # Addresses are faster than a new array for each block.
    memory_at = memory.ctypes.data
    next_memory_at = next_memory.ctypes.data
    for first_sample in range(0, n_samples, length):
        stream_at = stream.ctypes.data + first_sample * stream.strides[0]
        rows_at = rows.ctypes.data + first_sample * rows.strides[0]
        block.call(memory_at, stream_at, next_memory_at, rows_at)
        memory_at, next_memory_at = next_memory_at, memory_at
    return rows
