"""Exported C, compiled, to be called from Python."""

import ctypes
import shutil
import subprocess

import numpy as np

from notebooks.studies import toolchain

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off"]


class InC:
    """struct rhec of an export, and its functions; compiled once, beside the export's folder."""

    def __init__(self, folder, guess=None):
        out = folder.with_suffix(".so")
        if not out.exists():
            sources = [folder / source for source in toolchain.LIBRARY]
            compiler = [shutil.which("cc") or "gcc", *FLAGS, "-shared", "-fPIC"]
            subprocess.run([*compiler, *sources, "-lm", "-o", out], check=True)
        self.library = ctypes.CDLL(str(out))
        sizes = (folder / "rhec_memory.h").read_text()
        settings = sizes.split("struct rhec_settings {")[1].split("}")[0].strip().splitlines()
        assert all(line.endswith(" */") for line in settings)  # a comment says what each is
        size = int(sizes.split("RHEC_MEMORY_BYTES ")[1].split()[0])
        self.memory = ctypes.create_string_buffer(size)
        self.begin(guess)

    def begin(self, guess=None):
        """Begin anew, from a guess or the one that was exported."""
        settings, exported = (
            ctypes.byref(ctypes.c_char.in_dll(self.library, f"rhec_scenario{name}"))
            for name in ("", "_guess")
        )
        first = exported if guess is None else np.array(guess, dtype=float).ctypes
        self.library.rhec_init(self.memory, settings, first)

    def prepare(self):
        """Prepare whatever has been exported; C does so itself where it was not done."""
        for name in ("rhec_prepare_estimate", "rhec_prepare_control"):
            if hasattr(self.library, name):
                getattr(self.library, name)(self.memory)

    def call(self, name, *arrays, length):
        """Answer (length,) and status."""
        arrays = [np.ravel(array, order="F").astype(float) for array in arrays]
        answer = np.zeros(length)
        function = getattr(self.library, f"rhec_{name}")
        status = function(self.memory, *(array.ctypes for array in arrays), answer.ctypes)
        return answer, status

    def step(self, z):
        """A sample of the paper's robot: estimate (6,), ω, status."""
        self.prepare()
        estimate, estimated = self.call("estimate", z, length=6)
        (omega,), planned = self.call("control", length=1)
        return estimate, omega, estimated | planned
