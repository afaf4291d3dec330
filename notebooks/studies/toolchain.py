"""Compile and run an export on this machine, or on 64-bit Arm under an emulator."""

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

from rhec.core._casadi import compiled

# As in rhec/embedded/c/CMakeLists.txt
FLAGS = (
    "-std=c99",
    "-O3",
    "-ffp-contract=off",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Werror",
    "-Wframe-larger-than=16384",  # Clang: 12.4 kB at most
)
LIBRARY = ("rhec.c", "rhec_scenario.c")
_ARM = "aarch64"
# As in rhec/embedded/c/rhec.h
STATUS = dict(predicted=1, as_planned=2, estimator_restarted=4, controller_restarted=8)


class Machine(NamedTuple):
    """A processor that C can be compiled for and run on."""

    name: str  # of the architecture, as `platform.machine` returns it
    compiler: str  # its path
    emulator: tuple  # words that a command begins with; none where the processor is real


def this_machine():
    """This machine, or None without a C compiler."""
    # GCC is preferred, since it alone writes how large the stack grows.
    compiler = compiled.compiler() and (shutil.which("gcc") or compiled.compiler())
    return Machine(platform.machine(), compiler, ()) if compiler else None


def arm():
    """64-bit Arm: this machine, or an emulated one.

    It is None where the cross compiler or the emulator is missing (Debian: gcc-aarch64-linux-gnu,
    qemu-user).
    """
    if platform.machine() == _ARM:
        return this_machine()
    compiler = shutil.which(f"{_ARM}-linux-gnu-gcc")
    emulator = shutil.which(f"qemu-{_ARM}")
    return Machine(_ARM, compiler, (emulator,)) if compiler and emulator else None


def library(machine, export, folder, flags=FLAGS):
    """Compile the library of an export into `folder`; returns its object files."""
    export = Path(export).resolve()  # the compiler runs in `folder`
    sources = [export / source for source in LIBRARY]
    command = [machine.compiler, *flags, f"-I{export}", "-c", *sources]
    # Only GCC knows the option that writes the call graph; others compile without it.
    done = subprocess.run([*command, "-fcallgraph-info=su"], cwd=folder, capture_output=True)
    if done.returncode:
        subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return [Path(folder, source.with_suffix(".o").name) for source in sources]


def program(machine, export, name, objects, flags=FLAGS):
    """Compile "replay", "times" or "fuzz" of an export beside its `library`; returns its path."""
    path = objects[0].with_name(name)
    # An emulator has no shared libraries to load.
    flags = [*flags, *(["-static"] if machine.emulator else []), f"-I{export}"]
    command = [machine.compiler, *flags, Path(export, f"{name}.c"), *objects, "-o", path, "-lm"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return path


def run(machine, program, *arguments):
    """Run a program; returns the finished process with its output as text."""
    command = [*machine.emulator, program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True)


def replay(machine, program, log):
    """Answers of `replay` to a log: a DataFrame with one row a sample."""
    return pd.read_csv(io.StringIO(run(machine, program, log).stdout))


def nonsense(machine, program, samples, seed):
    """Run `fuzz`, which feeds an export with invalid measurements; a table of one row.

    It counts samples, storms of invalid measurements, still_lost (storms after which the estimate
    was lost 20 s later), unnoticed (those of them with status 0), and the samples with each status
    bit. It is a RuntimeError if an estimate was not finite or a command out of bounds.
    """
    finished = run(machine, program, samples, seed)
    if finished.returncode:
        raise RuntimeError(f"{program.name} failed: {finished.stderr.strip()}")
    summary, _, *rows = finished.stdout.splitlines()
    names = ("samples", "storms", "still_lost", "unnoticed")
    counts = dict(zip(names, map(int, re.findall(r"\d+", summary))))
    statuses = [tuple(map(int, row.split(","))) for row in rows]
    for name, bit in STATUS.items():
        counts[name] = sum(count for status, count in statuses if status & bit)
    return pd.DataFrame([counts])


def sizes(machine, objects):
    """Bytes of a library's code with its constants, and of its stack.

    The stack is the deepest chain of calls in GCC's call graph, libm left out, and NaN for other
    compilers.
    """
    tool = shutil.which(re.sub(r"(gcc|cc|clang)(-[\d.]+)?$", "size", machine.compiler)) or "size"
    printed = subprocess.run([tool, *objects], check=True, capture_output=True, text=True).stdout
    frames = {}
    calls = {}
    node = r'node: { title: "([^"]+)" label: "[^"]*?(\d+) bytes \(static\)'
    edge = r'edge: { sourcename: "([^"]+)" targetname: "([^"]+)"'
    for graph in objects[0].parent.glob("*.ci"):
        text = graph.read_text()
        frames |= {name: int(size) for name, size in re.findall(node, text)}
        for caller, called in re.findall(edge, text):
            calls.setdefault(caller, set()).add(called)

    @functools.cache
    def depth(name):
        return frames.get(name, 0) + max(map(depth, calls.get(name, ())), default=0)

    return dict(
        code_bytes=sum(int(line.split()[0]) for line in printed.splitlines()[1:]),
        stack_bytes=max(map(depth, frames), default=np.nan),
    )
