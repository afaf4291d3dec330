"""Compile a loop by parts, so that parts that loops share are compiled once.

Such a part is an estimator's or the controller's step. It is compiled while the rest is. For lanes
that costs no speed; the loop of a single run would be a twentieth slower.
"""

import hashlib
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from rhec.core._casadi import cache
from rhec.core._casadi.compiled import run_compiler

_LEAST = 5  # Functions that a part calls; a smaller one is compiled with the rest
_CALL = """  casadi_real unused[{size}];
  for (int i = 0; i < {n_out}; i++) if (!res[i]) res[i] = unused;
  return {name}(arg, res, iw, w, mem);
}}"""


def compile_by_parts(place, text, step, text_of, key, command):
    """Compile the text of a loop into `library.so` in a folder.

    Args:
        place: The folder.
        text: Its C++.
        step: The Function of one of its samples, whose larger parts are compiled on their own.
        text_of: Makes such a text of a Function; names in it begin with the Function's.
        key: All that decides what is made of a text.
        command: The compiler with its flags.

    Raises:
        OSError: With what the compiler said, if it fails.
        UnusableError: If a part cannot be kept.
    """
    jobs = []
    for function in step.find_functions(0):
        head = rf"(/\* {function.name()}:\(.*\n)(.*\{{\n)"
        is_large = len(function.find_functions()) >= _LEAST
        if not is_large or len(re.findall(head, text)) != 1:
            continue
        digest = hashlib.sha256(repr((function.serialize(), key)).encode()).hexdigest()
        name = f"part_{digest[:24]}"
        # In the loop's text, the body of the part becomes a call of what is compiled on its own.
        sizes = [function.nnz_out(i) for i in range(function.n_out())]
        call = _CALL.format(name=name, size=max(sizes), n_out=len(sizes))
        declared = (
            f"int {name}(const casadi_real**, casadi_real**, casadi_int*, casadi_real*, int);\n"
        )
        text = re.sub(rf"(?m)^{head}(?s:.*?)^\}}", rf"\1{declared}\2{call}", text)
        jobs.append(partial(_compile_part, name, function, text_of, command))
    with ThreadPoolExecutor(1) as pool:  # one part after the other: the cache is not for threads
        parts = [pool.submit(job) for job in jobs]
        _compile(place, _without_unused(text), command)
        objects = [part.result() for part in parts]
    run_compiler([*command, "code.o", *objects, "-o", "library.so"], place)


def _compile_part(name, function, text_of, command):
    """Return the object file of a Function, which is compiled under this name, or kept."""

    def make(folder):
        _compile(folder, text_of(function), [*command, f"-D{function.name()}={name}"])

    return cache.load_or_build(name, make, lambda folder: folder / "code.o")


def _without_unused(text):
    """Return the text without the Functions that only parts use."""
    functions = re.split(r"(?m)^(?=/\* \w+:\()", text)
    used = set()
    last = len(functions) - 1  # the entry, which nothing calls
    for place in reversed(range(1, len(functions))):  # callers stand after what they call
        own, *called = re.findall(r"\bcasadi_f\d+", functions[place])
        if own in used or place == last:
            used.update(called)
        else:
            functions[place] = ""
    return "".join(functions)


def _compile(folder, text, command):
    (folder / "code.cpp").write_text(text)
    run_compiler([*command, "-c", "code.cpp", "-o", "code.o"], folder)
