"""Many scans at once: one in each lane of the processor's registers, with the bits of one after
the other.

A Function's C is compiled as C++ whose numbers are vectors (lanes.h). What the platform or the
Function does not allow (no C++ compiler, a QP solver's C) is found out by compiling, once.
"""

import contextlib
import ctypes
import functools
import json
import math
import os
import re
import shutil
import subprocess

import casadi as ca
import numpy as np

from rhec._casadi import cache, compiled

__all__ = ["is_compiled", "load", "scan"]

# Helpers of CasADi's that look into a number; lanes.h has them for lanes, or nothing has.
_HELPERS = "low|interpn|interpn_weights|interpn_interpolate|fmin|fmax|fabs"
_IF_ELSE = re.compile(
    r"->\((?P<outputs>\S*)\) \*/\n(?P<head>.* \{)\n"
    r"  if \(arg\[0\] \? casadi_to_int\(\*arg\[0\]\) : 0\) \{\n"
    r"    if \((?P<yes>\w+)\(arg\+1, res, iw, w, 0\)\) return 1;\n  \} else \{\n"
    r"    if \((?P<no>\w+)\(arg\+1, res, iw, w, 0\)\) return 1;\n  \}\n  return 0;"
)


def _by_lanes(code):
    """CasADi's C as C++ for lanes: what cannot be overloaded becomes a call."""
    code = re.sub(rf"^\w+ casadi_({_HELPERS})\(.*?^}}\n", "", code, flags=re.M | re.S)
    code = re.sub(r"\bcasadi_(fmin|fmax|fabs)\(", r"\1(", code)
    code = re.sub(r"\((\w+|\(\*cr\+\+\))\?(\w+(?:\[i\])?):0\)", r"select(\1, \2, 0.0)", code)
    slip = r"(/\* slip_fields:\(x\[2\],#c.*?)casadi_interpn\("
    return _IF_ELSE.sub(_if_else, re.sub(slip, r"\1slip_fields(", code, flags=re.S))


def _if_else(found):
    """The Function that chooses between two, as a call of lanes.h with its outputs' lengths."""
    shapes = re.findall(r"o\d+(?:\[(?:[^],]*,)?([^]]*)\])?", found["outputs"])
    lengths = (math.prod(map(int, re.findall(r"\d+", shape))) for shape in shapes)
    call = "  return if_else<{}>({yes}, {no}, arg, res, iw, w);".format(
        ", ".join(map(str, lengths)), **found.groupdict()
    )
    return f"*/\n{found['head']}\n{call}"


@functools.cache
def _compiler():
    """The C++ compiler and all that it knows of this processor; None where there are no lanes."""
    found = shutil.which(os.environ.get("CXX", "c++")) or shutil.which("clang++")
    if not (found and compiled.compiler()):
        return None
    ask = [found, "-march=native", "-dM", "-E", "-x", "c++", os.devnull]
    asked = subprocess.run(ask, capture_output=True, text=True)
    return None if asked.returncode else (found, asked.stdout)


def _name(build, structure):
    return compiled.library_name(build, structure, "lanes", *_compiler())


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return not _compiler() or cache.holds(_name(build, structure))


@functools.cache
def load(build, *structure):
    """The block of build(*structure) for several scans at once, or None where that cannot be."""
    if not _compiler():
        return None

    def make(place):
        _compile(place, build(*structure)["block"])

    def open_block(folder):
        return _Block(folder) if (folder / "library.so").exists() else None

    with contextlib.suppress(cache.UnusableError):
        return cache.kept(_name(build, structure), make, open_block)
    return None


def _compile(place, function):
    generator = ca.CodeGenerator("code.c")
    generator.add(function)
    generator.generate(f"{place}/")
    (place / "code.cpp").write_text(_by_lanes((place / "code.c").read_text()))
    flags = ["-std=gnu++17", "-march=native", "-w", "-Dcasadi_real=lanes"]
    flags += ["-include", compiled.HEADERS / "lanes.h"]
    command = [_compiler()[0], *compiled.FLAGS, *flags, "code.cpp", "-o", "library.so"]
    subprocess.run(command, cwd=place, stderr=subprocess.DEVNULL)
    sizes = {name: function.nnz_in(name) for name in function.name_in()}
    (place / "block.json").write_text(json.dumps([sizes, function.size_out(1)]))


class _Block:
    """A block of samples whose every number is one a lane, side by side in memory.

    sizes: of its arguments by name; n_rows, length: of what it yields, (outputs, samples).
    """

    def __init__(self, folder):
        self.sizes, (self.n_rows, self.length) = json.loads((folder / "block.json").read_text())
        # With Python's lock held: the work space is one.
        self._library = ctypes.PyDLL(str(folder / "library.so"))
        self.lanes = self._library.code_casadi_real_size() // 8
        lengths = [ctypes.c_longlong() for _ in range(4)]
        self._library.block_work(*map(ctypes.byref, lengths))
        n_arguments, n_results, n_whole, n_work = (length.value for length in lengths)
        self._arguments = (ctypes.c_void_p * n_arguments)()
        self._results = (ctypes.c_void_p * n_results)()
        self._whole, self._work = (ctypes.c_longlong * n_whole)(), self.zeros(n_work)

    def zeros(self, *shape):
        """Zeros, one a lane, from an address where a register can be read."""
        n = math.prod(shape) * self.lanes
        raw = np.zeros(n + self.lanes)
        begin = -raw.ctypes.data // 8 % self.lanes
        return raw[begin : begin + n].reshape(*shape, self.lanes)

    def side_by_side(self, values, *shape):
        """Arrays of the lanes as one; behind those that are shorter are zeros."""
        array = self.zeros(*shape)
        for lane, value in enumerate(values):
            array[: len(value), ..., lane] = value
        return array

    def call(self, arguments, results):
        """Evaluate the block from arrays into arrays."""
        self._arguments[: len(arguments)] = [array.ctypes.data for array in arguments]
        self._results[: len(results)] = [array.ctypes.data for array in results]
        work = ctypes.c_void_p(self._work.ctypes.data)
        self._library.block(self._arguments, self._results, self._whole, work, 0)


def scan(block, memories, streams, settings):
    """Rows (n, outputs) of as many runs as there are lanes, or fewer, each as by `scan.scan`.

    memories: vectors; streams: (n, inputs), n may differ; settings: dicts.
    """
    idle = block.lanes - len(memories)  # such lanes repeat the last run
    first, each, given = ([*of, *of[-1:] * idle] for of in (memories, streams, settings))
    memory_name, _, *names = block.sizes
    kept = [
        block.side_by_side((np.ravel(run[name], order="F") for run in given), block.sizes[name])
        for name in names
    ]
    memory = block.side_by_side(first, block.sizes[memory_name])
    samples = -(-max(map(len, streams)) // block.length) * block.length
    stream = block.side_by_side(each, samples, streams[0].shape[1])
    spare, rows = block.zeros(len(memory)), block.zeros(samples, block.n_rows)
    for done in range(0, samples, block.length):
        block.call([memory, stream[done:], *kept], [spare, rows[done:]])
        memory, spare = spare, memory
    by_run = np.ascontiguousarray(rows.T)
    return [rows_of[:, : len(run)].T for rows_of, run in zip(by_run, streams)]
