"""An exported Model's estimator and controller, compiled, to be called from Python."""

import ctypes
import shutil
import subprocess

import numpy as np

from notebooks.further.c_code import toolchain

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off"]


class InC:
    """struct rhec of an export, and its functions; compiled within the folder of the export."""

    def __init__(self, folder):
        sources = [folder / source for source in toolchain.LIBRARY]
        out = folder / "rhec.so"
        command = [
            shutil.which("cc") or "gcc",
            *FLAGS,
            "-shared",
            "-fPIC",
            *sources,
            "-lm",
            "-o",
            out,
        ]
        subprocess.run(command, check=True)
        self.library = ctypes.CDLL(str(out))
        sizes = (folder / "rhec_memory.h").read_text()
        size = int(sizes.split("RHEC_MEMORY_BYTES ")[1].split()[0])
        self.memory = ctypes.create_string_buffer(size)
        self.begin()

    def begin(self):
        """Begin anew, from the guess."""
        settings, guess = (
            ctypes.byref(ctypes.c_char.in_dll(self.library, f"rhec_scenario{name}"))
            for name in ("", "_guess")
        )
        self.library.rhec_init(self.memory, settings, guess)

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
