"""Compile a loop in parts, so that parts that several loops share are compiled once.

A part is the step of an estimator, the controller, the path's references or the robot's motion. It
is compiled in parallel with the rest. This does not slow down lanes; the loop of a single run would
be 5 % slower.
"""

import hashlib
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from rhec.core._casadi import cache
from rhec.core._casadi.compiled import run_compiler

# A Function that calls fewer Functions and has fewer instructions is compiled with the rest.
_LEAST_CALLED = 5
_LEAST_INSTRUCTIONS = 300
_CALL = """  casadi_real unused[{size}];
  for (int i = 0; i < {n_out}; i++) if (!res[i]) res[i] = unused;
  return {name}(arg, res, iw, w, mem);
}}"""


def compile_by_parts(place, text, step, text_of, key, command):
    """Compile the text of a loop into `library.so` in a folder.

    Args:
        place: The folder.
        text: Its C++.
        step: The Function of a sample; its larger parts are compiled separately.
        text_of: Function that returns the C++ of a Function, with names that begin with its name.
        key: Everything that affects the compiled text.
        command: The compiler with its flags.

    Raises:
        OSError: If the compiler fails, with its output.
        UnusableError: If a part cannot be stored in the cache.
    """
    jobs = []
    for function in step.find_functions(0):
        head = rf"(/\* {function.name()}:\(.*\n)(.*\{{\n)"
        if not _is_large(function) or len(re.findall(head, text)) != 1:
            continue
        digest = hashlib.sha256(repr((function.serialize(), key)).encode()).hexdigest()
        name = f"part_{digest[:24]}"
        # In the text of the loop, a call of the separately compiled part replaces its body.
        sizes = [function.nnz_out(i) for i in range(function.n_out())]
        call = _CALL.format(name=name, size=max(sizes), n_out=len(sizes))
        declared = (
            f"int {name}(const casadi_real**, casadi_real**, casadi_int*, casadi_real*, int);\n"
        )
        text = re.sub(rf"(?m)^{head}(?s:.*?)^\}}", rf"\1{declared}\2{call}", text)
        jobs.append(partial(_compile_part, name, function, text_of, command))
    with ThreadPoolExecutor(1) as pool:  # one thread, because the cache is not thread-safe
        parts = [pool.submit(job) for job in jobs]
        _compile(place, _without_unused(text), command)
        objects = [part.result() for part in parts]
    run_compiler([*command, "code.o", *objects, "-o", "library.so"], place)


def _is_large(function):
    """Return whether compiling a Function takes so long that loops should share the result."""
    if len(function.find_functions()) >= _LEAST_CALLED:
        return True
    is_counted = function.is_a("SXFunction") or function.is_a("MXFunction")
    return is_counted and function.n_instructions() >= _LEAST_INSTRUCTIONS


def _compile_part(name, function, text_of, command):
    """Return the object file of a Function, compiled under this name or from the cache."""

    def make(folder):
        _compile(folder, text_of(function), [*command, f"-D{function.name()}={name}"])

    return cache.load_or_build(name, make, lambda folder: folder / "code.o")


def _without_unused(text):
    """Return the text without Functions that only the parts use."""
    functions = re.split(r"(?m)^(?=/\* \w+:\()", text)
    used = set()
    last = len(functions) - 1  # the entry point
    for place in reversed(range(1, len(functions))):  # callers come after the Functions they call
        name, *called = re.findall(r"\bcasadi_f\d+", functions[place])
        if name in used or place == last:
            used.update(called)
        else:
            functions[place] = ""
    return "".join(functions)


def _compile(folder, text, command):
    (folder / "code.cpp").write_text(text)
    run_compiler([*command, "-c", "code.cpp", "-o", "code.o"], folder)
