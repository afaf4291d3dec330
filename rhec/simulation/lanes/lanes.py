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
import operator
import os
import re
import shutil
import subprocess
import threading
from pathlib import Path

import casadi as ca
import numpy as np

from rhec.core._casadi import cache, compiled
from rhec.simulation.lanes.parts import compile_by_parts

__all__ = ["is_compiled", "load", "scan"]

# Helpers of CasADi's that look into a number; lanes.h has them for lanes, or nothing has.
_HELPERS = "low|interpn|interpn_weights|interpn_interpolate|fmin|fmax|fabs"
_IF_ELSE = re.compile(
    r"->\((?P<outputs>\S*)\) \*/\n(?P<head>.* \{)\n"
    r"  if \(arg\[0\] \? casadi_to_int\(\*arg\[0\]\) : 0\) \{\n"
    r"    if \((?P<yes>\w+)\(arg\+1, res, iw, w, 0\)\) return 1;\n  \} else \{\n"
    r"    if \((?P<no>\w+)\(arg\+1, res, iw, w, 0\)\) return 1;\n  \}\n  return 0;"
)


_ASSIGNED = re.compile(r"  (a\d+)=(?:(sin|cos)\((a\d+)\);$)?")


def _by_lanes(code):
    """CasADi's C as C++ for lanes: what cannot be overloaded becomes a call."""
    code = "\n".join(_sines_with_cosines(code.splitlines()))
    code = re.sub(rf"^\w+ casadi_({_HELPERS})\(.*?^}}\n", "", code, flags=re.M | re.S)
    code = re.sub(r"\bcasadi_(fmin|fmax|fabs)\(", r"\1(", code)
    code = re.sub(r"\((\w+|\(\*cr\+\+\))\?(\w+(?:\[i\])?):0\)", r"select(\1, \2, 0.0)", code)
    slip = r"(/\* slip_fields:\(x\[2\],#c.*?)casadi_interpn\("
    return _IF_ELSE.sub(_if_else, re.sub(slip, r"\1slip_fields(", code, flags=re.S))


def _sines_with_cosines(lines):
    """Lines of C in which sine and cosine of one angle, each an assignment, are one call."""
    known = {}  # {variable: name of the pair of its sine and cosine}
    for number, line in enumerate(lines):
        if found := _ASSIGNED.match(line):
            variable, function, angle = found.groups()
            if function:
                call = "" if angle in known else f"complex pair{number}=own_cis({angle}); "
                pair = known.setdefault(angle, f"pair{number}")
                line = f"  {call}{variable}={pair}.{dict(sin='imaginary', cos='real')[function]};"
            known.pop(variable, None)
        elif line == "}":
            known.clear()
        yield line


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
    return not _compiler() or cache.contains(_name(build, structure))


@functools.cache
def load(build, *structure):
    """The block of build(*structure) for several scans at once, or None where that cannot be."""
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
    generator = ca.CodeGenerator(f"{name or function.name()}.c")
    generator.add(function)
    return f'extern "C" {{\n{_by_lanes(generator.dump())}}}\n'


def _compile(place, functions):
    # -O1: three quarters of the time to compile, the code a twentieth slower.
    flags = [*compiled.FLAGS, "-O1", "-std=gnu++17", "-march=native", "-w", "-Dcasadi_real=lanes"]
    command = [
        _compiler()[0],
        *flags,
        "-include",
        Path(__file__).with_name("lanes.h"),
        f"-I{compiled.HEADERS}",
    ]
    key = _compiler(), flags, compiled.source_digest()
    function = functions["block"]
    text = _text(functions["block"], "code")
    with contextlib.suppress(OSError, cache.UnusableError):
        compile_by_parts(place, text, functions["step"], _text, key, command)
    sizes = {name: function.nnz_in(name) for name in function.name_in()}
    (place / "block.json").write_text(json.dumps([sizes, function.size_out(1)]))


class _Block:
    """A block of samples whose every number is one a lane, side by side in memory.

    sizes: of its arguments by name; n_rows, length: of what it yields, (outputs, samples).
    """

    def __init__(self, folder):
        self.sizes, (self.n_rows, self.length) = json.loads((folder / "block.json").read_text())
        self._library = ctypes.CDLL(str(folder / "library.so"))
        self.lock = threading.Lock()  # arrays and work space are one for all threads
        self.given = {}  # {name: what the lanes were given last}
        self.lanes = self._library.code_casadi_real_size() // 8
        lengths = [ctypes.c_longlong() for _ in range(4)]
        self._library.block_work(*map(ctypes.byref, lengths))
        n_arguments, n_results, n_whole, n_work = (length.value for length in lengths)
        self._arguments = (ctypes.c_void_p * n_arguments)()
        self._results = (ctypes.c_void_p * n_results)()
        self._whole = (ctypes.c_longlong * n_whole)()
        self._arrays = {}
        self._work = ctypes.c_void_p(self.array("work", n_work).ctypes.data)

    def array(self, name, *shape):
        """The array of this name, which stays as long as its shape does: a number for each lane,
        from an address where a register can be read.
        """
        if name not in self._arrays or self._arrays[name].shape[:-1] != shape:
            n = math.prod(shape) * self.lanes
            raw = np.zeros(n + self.lanes)
            begin = -raw.ctypes.data // 8 % self.lanes
            self._arrays[name] = raw[begin : begin + n].reshape(*shape, self.lanes)
        return self._arrays[name]

    def side_by_side(self, name, values, *shape):
        """The array of this name with the lanes' values, of which some may be shorter; one that all
        have in common is laid out at once.
        """
        array = self.array(name, *shape)
        given = enumerate(values)
        if all(value is values[0] for value in values):
            given = [(slice(None), values[0][..., None])]
        for lanes, value in given:
            array[: len(value), ..., lanes] = value
        return array

    def give(self, place, array):
        """Take an argument from an array, which stays as long as its shape does."""
        self._arguments[place] = array.ctypes.data

    def call(self, memory, stream, next_memory, rows):
        """Evaluate the block from the first two addresses into the others."""
        self._arguments[0] = memory
        self._arguments[1] = stream
        self._results[0] = next_memory
        self._results[1] = rows
        self._library.block(self._arguments, self._results, self._whole, self._work, 0)


def scan(block, memories, streams, settings):
    """Rows (n, outputs) of as many runs as there are lanes, or fewer, each as by `scan.scan`.

    memories: vectors; streams: (n, inputs), n may differ; settings: dicts.
    """
    with block.lock:
        return _scan(block, memories, streams, settings)


def _scan(block, memories, streams, settings):
    idle = block.lanes - len(memories)  # such lanes repeat the last run
    first, each, given = ([*of, *of[-1:] * idle] for of in (memories, streams, settings))
    memory_name, _, *names = block.sizes
    for place, name in enumerate(names, 2):
        values = [run[name] for run in given]
        if all(map(operator.is_, values, block.given.get(name, [None]))):
            continue  # as for the runs before
        block.given[name] = values
        flat = {id(each): np.ravel(each, order="F") for each in values}
        values = [flat[id(each)] for each in values]
        block.give(place, block.side_by_side(name, values, block.sizes[name]))
    memory = block.side_by_side("first", first, block.sizes[memory_name])
    samples = -(-max(map(len, streams)) // block.length) * block.length
    stream = block.side_by_side("each", each, samples, streams[0].shape[1])
    spare = block.array("spare", len(memory))
    rows = block.array("rows", samples, block.n_rows)
    now, after, begin, end = (each.ctypes.data for each in (memory, spare, stream, rows))
    for done in range(0, samples, block.length):
        block.call(now, begin + done * stream.strides[0], after, end + done * rows.strides[0])
        now, after = after, now
    by_run = np.ascontiguousarray(rows.T)
    return [rows_of[:, : len(run)].T for rows_of, run in zip(by_run, streams)]
