"""Compile C to WebAssembly with Zig's Clang (wheel `ziglang`), without a C library to build."""

import hashlib
import re
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from rhec.core._casadi import cache, compiled

_SINES = compiled.HEADERS / "elementary.h"  # the sine of all compiled code
_HEADERS = Path(__file__).with_name("freestanding")
_COMMAND = [sys.executable, "-m", "ziglang", "cc", "-include", str(_SINES), "code.c"]
_FLAGS = [
    "--target=wasm32-freestanding",
    "-nostdlib",
    f"-isystem{_HEADERS}",
    "-fno-math-errno",  # a square root is an instruction
    "-O2",
    # A fused multiply-add rounds once where Python's run rounds twice.
    "-ffp-contract=off",
    "-mbulk-memory",
    "-w",
    "-Wl,--no-entry,--strip-all,--export=run",
    # Functions may return several values: sine and cosine of an angle then cost one call instead
    # of two, and a run takes a fifth less time.
    *("-mmultivalue", "-Xclang", "-target-abi", "-Xclang", "experimental-mv"),
]


def can_compile():
    """Return whether the wheel is installed."""
    return find_spec("ziglang") is not None


def module_of(text):
    """Compile a C text, or take its module from the cache.

    Args:
        text: C with the entry `run`; arrays whose names begin with `at_` are exported.

    Returns:
        The module's bytes.

    Raises:
        OSError: if the text does not compile.
    """
    arrays = re.findall(r"^double (at_\w+)\[", text, re.M)
    exports = [f"-Wl,--export={name}" for name in arrays]

    def make(folder):
        with tempfile.TemporaryDirectory() as sources:
            (Path(sources) / "code.c").write_text(text, encoding="utf-8")
            module = folder / "code.wasm"
            compiled.run_compiler([*_COMMAND, *_FLAGS, *exports, "-o", str(module)], sources)

    headers = [file.read_bytes() for file in (_SINES, *sorted(_HEADERS.iterdir()))]
    key = repr((text, headers, _FLAGS, find_spec("ziglang").origin))
    name = hashlib.sha256(key.encode()).hexdigest()[:24]
    return cache.load_or_build(name, make, lambda folder: (folder / "code.wasm").read_bytes())
