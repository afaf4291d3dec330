"""Parts of a loop that other loops have, too, such as an estimator's or the controller's step: each
is compiled once for all of them, while the rest is compiled.

For lanes it costs no speed; a loop for one run at a time would be a twentieth slower.
"""

import hashlib
import re
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from rhec.core._casadi import cache
from rhec.core._casadi.compiled import run_compiler

__all__ = ["compile_by_parts"]

_LEAST = 5  # Functions that a part calls: a smaller one is compiled with the rest
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
        command: Of the compiler, with its flags.

    Raises:
        OSError: With what the compiler said, if it fails.
        UnusableError: If a part cannot be kept.
    """
    jobs = []
    for function in step.find_functions(0):
        own = function.serialize()
        sizes = [function.nnz_out(i) for i in range(function.n_out())]
        head = rf"(/\* {function.name()}:\(.*\n)(.*\{{\n)"
        name = f"part_{hashlib.sha256(repr((own, key)).encode()).hexdigest()[:24]}"
        if len(function.find_functions()) < _LEAST or len(re.findall(head, text)) != 1:
            continue
        call = _CALL.format(name=name, size=max(sizes), n_out=len(sizes))
        shown = f"int {name}(const casadi_real**, casadi_real**, casadi_int*, casadi_real*, int);\n"
        text = re.sub(rf"(?m)^{head}(?s:.*?)^\}}", rf"\1{shown}\2{call}", text)
        jobs.append(partial(_part, name, function, text_of, command))
    with ThreadPoolExecutor(1) as pool:  # one part after the other: a cache is no place for threads
        parts = [pool.submit(job) for job in jobs]
        _compile(place, _without_unused(text), command)
        objects = [part.result() for part in parts]
    run_compiler([*command, "code.o", *objects, "-o", "library.so"], place)


def _part(name, function, text_of, command):
    """The object file of a Function, whose entry has this name."""

    def make(folder):
        _compile(folder, text_of(function), [*command, f"-D{function.name()}={name}"])

    return cache.load_or_build(name, make, lambda folder: folder / "code.o")


def _without_unused(text):
    """The text without what only parts use."""
    functions = re.split(r"(?m)^(?=/\* \w+:\()", text)
    used = set()
    for place in reversed(range(1, len(functions))):  # each after those that call it
        (own, *called) = re.findall(r"\bcasadi_f\d+", functions[place])
        if own in used or place == len(functions) - 1:
            used.update(called)
        else:
            functions[place] = ""
    return "".join(functions)


def _compile(folder, text, command):
    (folder / "code.cpp").write_text(text)
    run_compiler([*command, "-c", "code.cpp", "-o", "code.o"], folder)
