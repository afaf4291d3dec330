"""Compile C to WebAssembly: by the `ziglang` wheel, or by Clang with LLD and wasi-libc.

    python -m rhec.workbench.live.wasm

exits with 1 where no compiler for WebAssembly is installed.
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

__all__ = ["compiler", "module_of"]

_FLAGS = [
    "--target=wasm32-wasi",
    "-O2",
    # A fused multiply-add rounds once where Python's run rounds twice.
    "-ffp-contract=off",
    "-mbulk-memory",
    "-nostartfiles",
    "-w",
    "-Wl,--no-entry,--strip-all",
]
# Functions may return several values: sine and cosine of an angle cost one call instead of two,
# and a run a fifth less time. Clang 14 crashes on these flags, Zig's Clang does not.
_MULTIVALUE = ["-mmultivalue", "-Xclang", "-target-abi", "-Xclang", "experimental-mv"]
_ZIG = [sys.executable, "-m", "ziglang", "cc"]
_SINES = compiled.HEADERS / "elementary.h"  # the sine of all compiled code
_PROBE = "double run(double x) { return sin(x) * cos(x) + exp(x); }"


@functools.cache
def compiler():
    """The command that compiles WebAssembly on this machine, or None."""
    clang = shutil.which("clang")
    for command in [_ZIG] * bool(find_spec("ziglang")) + [[clang]] * bool(clang):
        with contextlib.suppress(OSError):  # Clang without its linker or without a C library
            _compile(command, _PROBE)
            return command
    return None


def _compile(command, code, *flags):
    """The module's bytes; it exports `run` and all arrays whose names begin with `at_`."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "code.c").write_text(code, encoding="utf-8")
        arrays = re.findall(r"^double (at_\w+)\[", code, re.M)
        exports = [f"-Wl,--export={name}" for name in [*arrays, "run"]]
        files = ["-include", str(_SINES), "code.c", "-o", "code.wasm"]
        compiled.run_compiler([*command, *_FLAGS, *flags, *exports, *files], folder)
        return (Path(folder) / "code.wasm").read_bytes()


def module_of(text):
    """Compile a C text, or take its module from the cache.

    Args:
        text: C with the entry `run`.

    Returns:
        The module's bytes.

    Raises:
        OSError: if the text does not compile.
    """
    flags = _MULTIVALUE if compiler() == _ZIG else []
    key = repr((text, _SINES.read_bytes(), compiler(), _FLAGS, flags))

    def make(folder):
        (folder / "code.wasm").write_bytes(_compile(compiler(), text, *flags))

    name = hashlib.sha256(key.encode()).hexdigest()[:24]
    return cache.kept(name, make, lambda folder: (folder / "code.wasm").read_bytes())


if __name__ == "__main__":
    sys.exit(compiler() is None)
