"""An export compiled and run: on this machine, or on 64-bit Arm with a cross compiler and a
user-mode emulator.
"""

import functools
import io
import platform
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec._casadi import compiled

# As in c/CMakeLists.txt.
FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
LIBRARY = ("rhec.c", "rhec_scenario.c")
ARM = "aarch64"
STATUS = dict(
    predicted=1, as_planned=2, estimator_restarted=4, controller_restarted=8
)  # of c/rhec.h
PHASES = ("RHE", "preparation"), ("RHE", "feedback"), ("RHC", "preparation"), ("RHC", "feedback")


class Machine(NamedTuple):
    """Where C can be compiled for and run."""

    name: str  # of the processor
    compiler: str  # path
    emulator: tuple  # what the command begins with


def this_machine():
    """This machine, or None without a C compiler."""
    return Machine(platform.machine(), compiled.compiler(), ()) if compiled.compiler() else None


def arm():
    """64-bit Arm: this machine, or an emulated one, or None where the cross compiler or the
    emulator (Debian: gcc-aarch64-linux-gnu, qemu-user) is missing.
    """
    if platform.machine() == ARM:
        return this_machine()
    compiler, emulator = shutil.which(f"{ARM}-linux-gnu-gcc"), shutil.which(f"qemu-{ARM}")
    return Machine(ARM, compiler, (emulator,)) if compiler and emulator else None


def library(machine, export, folder, flags=FLAGS):
    """Compile an export's library into `folder`; returns its object files."""
    compile_ = [
        machine.compiler,
        *flags,
        f"-I{export}",
        "-c",
        *(f"{export}/{source}" for source in LIBRARY),
    ]
    with_stack = subprocess.run(
        [*compile_, "-fcallgraph-info=su"], cwd=folder, capture_output=True
    )  # GCC alone knows
    if with_stack.returncode:
        subprocess.run(compile_, cwd=folder, check=True, capture_output=True, text=True)
    return [Path(folder) / source.replace(".c", ".o") for source in LIBRARY]


def program(machine, export, name, objects, flags=FLAGS):
    """Compile and link a program of an export ("replay", "times", "fuzz") beside its library;
    returns its path.
    """
    path = objects[0].with_name(name)
    # an emulator has no shared libraries to load
    static = ["-static"] if machine.emulator else []
    subprocess.run(
        [
            machine.compiler,
            *flags,
            *static,
            f"-I{export}",
            f"{export}/{name}.c",
            *objects,
            "-o",
            path,
            "-lm",
        ],
        check=True,
        capture_output=True,
        text=True,
    )
    return path


def run(machine, program, *arguments):
    """Run a program; returns the finished process with its text."""
    return subprocess.run(
        [*machine.emulator, program, *map(str, arguments)], capture_output=True, text=True
    )


def replay(machine, program, log):
    """What `replay` answers to a log: one row a sample."""
    return pd.read_csv(io.StringIO(run(machine, program, log).stdout))


def times(machine, program, log, repetitions=5):
    """Times [µs] that `times` measures, (samples, 4) as in PHASES: of each sample the least of some
    runs; the first is left out.
    """
    return (
        np.min(
            [
                np.loadtxt(
                    io.StringIO(run(machine, program, log).stdout), delimiter=",", skiprows=2
                )
                for _ in range(repetitions)
            ],
            axis=0,
        )
        / 1e3
    )


def nonsense(machine, program, samples=50_000, seed=0):
    """What `fuzz` reports: one row with samples, storms, those after which the estimate was still
    lost 20 s later, and samples with each status bit.

    Raises where an estimate was not finite or a command out of bounds.
    """
    finished = run(machine, program, samples, seed)
    if finished.returncode:
        raise RuntimeError(f"{program.name} failed: {finished.stderr.strip()}")
    summary, _, *rows = finished.stdout.splitlines()
    statuses = [tuple(map(int, row.split(","))) for row in rows]
    bits = {
        name: sum(count for status, count in statuses if status & bit)
        for name, bit in STATUS.items()
    }
    return pd.DataFrame(
        [
            dict(zip(("samples", "storms", "still_lost"), map(int, re.findall(r"\d+", summary))))
            | bits
        ]
    )


def sizes(machine, objects):
    """{code_bytes: code and constants of a library, stack_bytes: the deepest chain of calls in
    GCC's call graph, libm left out; else NaN}.
    """
    tool = shutil.which(re.sub(r"(gcc|cc|clang)(-[\d.]+)?$", "size", machine.compiler)) or "size"
    printed = subprocess.run(
        [tool, *objects], check=True, capture_output=True, text=True
    ).stdout.splitlines()[1:]
    frames, calls = {}, {}
    for graph in objects[0].parent.glob("*.ci"):
        text = graph.read_text()
        frames |= {
            name: int(size)
            for name, size in re.findall(
                r'node: { title: "([^"]+)" label: "[^"]*?(\d+) bytes \(static\)', text
            )
        }
        for caller, called in re.findall(
            r'edge: { sourcename: "([^"]+)" targetname: "([^"]+)"', text
        ):
            calls.setdefault(caller, set()).add(called)

    @functools.cache
    def depth(name):
        return frames.get(name, 0) + max(map(depth, calls.get(name, ())), default=0)

    return dict(
        code_bytes=sum(int(line.split()[0]) for line in printed),
        stack_bytes=max(map(depth, frames), default=np.nan),
    )
