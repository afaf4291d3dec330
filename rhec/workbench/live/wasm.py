"""C as WebAssembly, by Clang with LLD and wasi-libc, or by the `ziglang` wheel: Clang and musl.

    python -m rhec.workbench.live.wasm

ends with 1 where neither is there.
"""

import contextlib
import functools
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from rhec._casadi import cache, compiled

__all__ = ["can_compile", "module_of"]

_FLAGS = (
    "--target=wasm32-wasi",
    "-O2",
    "-ffp-contract=off",
    "-mbulk-memory",
    "-nostartfiles",
    "-w",
    "-Wl,--no-entry,--strip-all,--export=__heap_base,--export-memory",
)


@functools.cache
def _compiler():
    """The command that makes WebAssembly here, or None."""
    clang, zig = shutil.which("clang"), find_spec("ziglang")
    commands = [[clang]] * bool(clang) + [[sys.executable, "-m", "ziglang", "cc"]] * bool(zig)
    for command in commands:
        with contextlib.suppress(OSError):
            _compile(command, "#include <math.h>\ndouble run(double x) { return exp(x); }")
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
        files = ["code.c", "-o", "code.wasm"]
        done = subprocess.run(
            [*command, *_FLAGS, *shown, *flags, *files], cwd=folder, capture_output=True, text=True
        )
        if done.returncode:
            said = [line for line in done.stderr.splitlines() if "error" in line] or [""]
            raise OSError(f"{command[0]} ended with {done.returncode} {said[0]}")
        return (Path(folder) / "code.wasm").read_bytes()


def module_of(text):
    """The module (bytes) of a text in C, from the cache if it was made.

    Raises:
        OSError: if the text does not compile.
    """
    own = compiled.HEADERS / "elementary.h"  # the sine of all compiled code
    made_of = repr((text, own.read_bytes(), _compiler(), _FLAGS))

    def make(folder):
        (folder / "code.wasm").write_bytes(_compile(_compiler(), text, "-include", str(own)))

    name = hashlib.sha256(made_of.encode()).hexdigest()[:24]
    return cache.kept(name, make, lambda folder: (folder / "code.wasm").read_bytes())


if __name__ == "__main__":
    sys.exit(not can_compile())
