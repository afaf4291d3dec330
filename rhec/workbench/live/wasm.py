"""C as WebAssembly, by the `ziglang` wheel (Clang and musl), or by Clang with LLD and wasi-libc.

    python -m rhec.workbench.live.wasm

ends with 1 where neither is there.
"""

import contextlib
import functools
import hashlib
import re
import shutil
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from rhec.core._casadi import cache, compiled

__all__ = ["can_compile", "module_of"]

_FLAGS = [
    "--target=wasm32-wasi",
    "-O2",
    "-ffp-contract=off",
    "-mbulk-memory",
    "-nostartfiles",
    "-w",
]
_FLAGS += ["-Wl,--no-entry,--strip-all"]
# Several values may be returned at once: sine and cosine of an angle cost one call, not two, and a
# run a fifth less time. Clang 14 crashes at it; a C library's functions on whole numbers of 128
# bits do not know of it.
_PAIRS = ["-mmultivalue", "-Xclang", "-target-abi", "-Xclang", "experimental-mv"]
_ZIG = [sys.executable, "-m", "ziglang", "cc"]
_OWN = compiled.HEADERS / "elementary.h"  # the sine of all compiled code


@functools.cache
def _compiler():
    """The command that makes WebAssembly here, or None."""
    clang = shutil.which("clang")
    for command in [_ZIG] * bool(find_spec("ziglang")) + [[clang]] * bool(clang):
        with contextlib.suppress(OSError):  # no linker, or no library
            _compile(command, "double run(double x) { return sin(x) * cos(x) + exp(x); }")
            return command
    return None


def can_compile():
    """Return whether there is a compiler for WebAssembly."""
    return _compiler() is not None


def _compile(command, code, *flags):
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "code.c").write_text(code, encoding="utf-8")
        arrays = re.findall(r"^(?:double|int) (at_\w+)\[", code, re.M)
        entries = re.findall(r"^(?:int|void|double) (run|ask|noise|soil)\(", code, re.M)
        shown = [f"-Wl,--export={name}" for name in arrays + entries]
        files = ["-include", str(_OWN), "code.c", "-o", "code.wasm"]
        compiled.run_compiler([*command, *_FLAGS, *flags, *shown, *files], folder)
        return (Path(folder) / "code.wasm").read_bytes()


def module_of(text, whole_numbers=False):
    """The module (bytes) of a text in C, from the cache if it was made.

    whole_numbers: whether it multiplies such of 128 bits.

    Raises:
        OSError: if the text does not compile.
    """
    flags = _PAIRS if _compiler() == _ZIG and not whole_numbers else []
    made_of = repr((text, _OWN.read_bytes(), _compiler(), _FLAGS, flags))

    def make(folder):
        (folder / "code.wasm").write_bytes(_compile(_compiler(), text, *flags))

    name = hashlib.sha256(made_of.encode()).hexdigest()[:24]
    return cache.load_or_build(name, make, lambda folder: (folder / "code.wasm").read_bytes())


if __name__ == "__main__":
    sys.exit(not can_compile())
