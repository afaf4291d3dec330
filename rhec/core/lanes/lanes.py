"""Several runs at a time, one per SIMD lane, with the same bits as runs one after the other.

CasADi's C of a Function is compiled as C++ with vectors as numbers (lanes.h). If the platform or
the Function does not allow this (no C++ compiler, a QP solver), the compilation fails once.
"""

import contextlib
import ctypes
import functools
import json
import math
import os
import re
import shutil
from pathlib import Path

import casadi as ca

from rhec.core._casadi import cache, compiled
from rhec.core.lanes.shared_steps import compile_by_parts
from rhec.core.runner import OneByOne, Program

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
    # A helper ends on its first line or where the next closing bracket begins a line.
    helper = rf"^\w+ casadi_({_HELPERS})\([^\n]*?(\}}|\n.*?^\}})\n"
    code = re.sub(helper, "", code, flags=re.M | re.S)
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
def cpp_compiler():
    """Return the C++ compiler and its macros, which identify the processor; None without lanes."""
    compiler = shutil.which(os.environ.get("CXX", "c++")) or shutil.which("clang++")
    if not (compiler and compiled.compiler()):
        return None
    command = [compiler, "-march=native", "-dM", "-E", "-x", "c++", os.devnull]
    macros = compiled.answer_of(command)
    return None if macros is None else (compiler, macros)


def library_name(build, structure):
    """The name of compiled lanes: `compiled.library_name`, C++ compiler and processor included."""
    return compiled.library_name(build, structure, "lanes", *cpp_compiler())


def is_compiled(build, *structure):
    """Return whether `load` has nothing to compile."""
    return not cpp_compiler() or cache.contains(library_name(build, structure))


@functools.cache
def load(build, *structure):
    """Return the block of build(*structure) in lanes, or None if lanes are unavailable.

    `build` returns {block, step}: the Function of a call, and that of a sample, if it is another.
    """
    if not cpp_compiler():
        return None
    name = library_name(build, structure)
    # Built first, because an error in the structure is not the compiler's failure.
    functions = None if cache.contains(name) else build(*structure)

    def make(place):
        compile_block(place, functions or build(*structure))

    def open_block(folder):
        return InLanes(folder) if (folder / "library.so").exists() else None

    with contextlib.suppress(cache.UnusableError):
        return cache.load_or_build(name, make, open_block)
    return None


def programs(build, structures):
    """Return the blocks of several structures as Programs of equally many lanes.

    They run in lanes if these are available for all of them, else one by one.
    """
    in_lanes = [load(build, *structure) for structure in structures]
    if all(in_lanes):
        return in_lanes
    return [OneByOne(compiled.load(build, *structure)["block"]) for structure in structures]


def cpp_text(function, name=None):
    """Return the C++ of a Function, for lanes."""
    generator = ca.CodeGenerator(f"{name or function.name()}.c")
    generator.add(function)
    return f'extern "C" {{\n{_vectorise(generator.dump())}}}\n'


def compile_block(place, functions):
    """Compile Functions {block, step} into a folder, which has no library.so if that fails."""
    # Compared with -O1, -O2 takes a third longer to compile; campaigns gain 3 to 20 %. The last
    # level counts, so the flags of `compiled` may say another.
    compiler, macros = cpp_compiler()
    flags = ["-O2", *compiled.FLAGS, "-std=gnu++17", "-march=native", "-w", "-Dcasadi_real=lanes"]
    if "__clang__" not in macros:
        flags += _GCC_FLAGS
    header = Path(__file__).with_name("lanes.h")
    command = [compiler, *flags, "-include", header, f"-I{compiled.HEADERS}"]
    key = cpp_compiler(), flags, compiled.source_digest()
    function = functions["block"]
    text = cpp_text(function, "code")
    with contextlib.suppress(OSError, cache.UnusableError):
        compile_by_parts(place, text, functions.get("step", function), cpp_text, key, command)
    sizes = {name: function.nnz_in(name) for name in function.name_in()}
    shapes = {name: function.size_out(name) for name in function.name_out()}
    (place / "block.json").write_text(json.dumps([sizes, shapes]))


class InLanes(Program):
    """A compiled Function that computes as many runs at a time as the processor has lanes."""

    def __init__(self, folder):
        sizes, shapes = json.loads((folder / "block.json").read_text())
        self._library = ctypes.CDLL(str(folder / "library.so"))
        super().__init__(self._library.code_casadi_real_size() // 8, sizes, shapes)
        # CasADi's convention: pointers to arguments and results, and integer and real work space.
        lengths = [ctypes.c_longlong() for _ in range(4)]
        self._library.block_work(*map(ctypes.byref, lengths))
        n_arguments, n_results, n_integers, n_reals = (length.value for length in lengths)
        self._arguments = (ctypes.c_void_p * n_arguments)()
        self._results = (ctypes.c_void_p * n_results)()
        self._integers = (ctypes.c_longlong * n_integers)()
        self._reals = ctypes.c_void_p(self.scratch("work space", n_reals).ctypes.data)

    def evaluate(self, calls, arguments, results):
        """As `Program.evaluate`."""
        given = [(self._arguments, place, arguments[name]) for place, name in enumerate(self.sizes)]
        given += [(self._results, place, results[name]) for place, name in enumerate(self.shapes)]
        moving = []
        with self.lock:
            for pointers, place, array in given:
                pointers[place] = array.ctypes.data
                if len(array) > 1:  # addresses are faster than a new array for each call
                    moving.append((pointers, place, pointers[place], array.strides[0], len(array)))
            for call in range(calls):
                for pointers, place, address, stride, entries in moving:
                    pointers[place] = address + call % entries * stride
                self._library.block(self._arguments, self._results, self._integers, self._reals, 0)
