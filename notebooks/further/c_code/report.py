"""Tables of an export: agreement with Python, memory, fuzzing, and times.

Times are measured on this machine and estimated for a Raspberry Pi 3. What the tools of this
machine cannot measure is left out.
"""

import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from notebooks.further.c_code import instructions, toolchain
from notebooks.studies.timing import PHASES
from rhec import paper
from rhec.simulation.columns import MEASUREMENTS

_PI = "Raspberry Pi 3"
TOLERANCE = 1e-9  # [m, rad, m/s, 1, rad/s] how far the answers of C may be from Python's


def measure(export, samples=60):
    """Measure an export, a folder, on this machine and on 64-bit Arm.

    The tables {name: DataFrame} are empty where a tool is missing:

    - sizes: one row a machine: the largest difference to Python in the export's log, and bytes
      of code, memory and stack;
    - times: mean and worst [ms], one row a machine, source, problem and phase;
    - nonsense: the report of `fuzz` on this machine;
    - counted: instructions of so many of the log's first samples, and times estimated from
      them, as `instructions.table` returns them.
    """
    export = Path(export)
    header = (export / "rhec_memory.h").read_text()
    memory_bytes = int(re.search(r"RHEC_MEMORY_BYTES (\d+)", header)[1])
    sizes = []
    tables = dict(nonsense=pd.DataFrame(), counted=pd.DataFrame())
    times = reported()
    # The two are one where this machine is a 64-bit Arm.
    for machine in dict.fromkeys(filter(None, (toolchain.this_machine(), toolchain.arm()))):
        with tempfile.TemporaryDirectory() as folder:
            objects = toolchain.library(machine, export, folder)
            replay = toolchain.program(machine, export, "replay", objects)
            size = _size(machine, export, objects, replay, memory_bytes)
            sizes.append(size)
            if machine.emulator:
                total_bytes = memory_bytes + np.nan_to_num(size["stack_bytes"])
                counted = _count(machine, export, replay, samples, total_bytes)
                pairs = counted[["mean_ms", "worst_ms"]].to_numpy()
                times += _rows(_PI, "rhec, estimated", pairs)
                tables["counted"] = counted
            else:
                tables["nonsense"], pairs = _run_here(machine, export, objects)
                times += _rows("this machine", "rhec, measured", pairs)
    return dict(sizes=pd.DataFrame(sizes), times=pd.DataFrame(times)) | tables


def _size(machine, export, objects, replay, memory_bytes):
    """A machine's row of sizes, with the largest difference between the answers of C and Python."""
    log = export / "log.csv"
    expected = pd.read_csv(log).drop(columns=MEASUREMENTS)
    answers = toolchain.replay(machine, replay, log)[expected.columns]
    row = dict(
        machine=machine.name,
        largest_difference=np.abs(answers - expected).to_numpy().max(),
        memory_bytes=memory_bytes,
    )
    return row | toolchain.sizes(machine, objects)


def _count(machine, export, replay, samples, total_bytes):
    """The table of instructions in the first samples of the export's log, under the emulator."""
    lines = (export / "log.csv").read_text().splitlines(keepends=True)
    part = replay.with_name("log.csv")
    part.write_text("".join(lines[: samples + 1]))  # the first line has the columns' names
    return instructions.table(instructions.trace(machine, replay, part), total_bytes)


def _run_here(machine, export, objects):
    """The report of `fuzz`, and mean and worst times [ms] of each phase, (4, 2)."""
    fuzz = toolchain.program(machine, export, "fuzz", objects)
    clock = toolchain.program(machine, export, "times", objects)
    nonsense = toolchain.nonsense(machine, fuzz)
    taken = toolchain.times(machine, clock, export / "log.csv") / 1e3
    return nonsense, np.column_stack([taken.mean(axis=0), taken.max(axis=0)])


def _rows(machine, who, pairs):
    """Rows of the table of times, from mean and worst times [ms] of each phase, (4, 2)."""
    return [
        dict(machine=machine, who=who, problem=problem, phase=phase, mean_ms=mean, worst_ms=worst)
        for (problem, phase), (mean, worst) in zip(PHASES, pairs)
    ]


def reported():
    """Rows with the paper's times, its Table 1."""
    return _rows(_PI, "paper, reported", [paper.TABLE_1_MS[key][1:] for key in PHASES])


def against_the_paper(counted):
    """The times of a whole sample that `measure` estimates beside the paper's."""
    whole = counted.iloc[-1]
    ours = whole[["mean_ms", "worst_ms"]]
    theirs = (paper.STEP_MEAN_MS, paper.STEP_MAX_MS)
    table = pd.DataFrame(dict(time=["mean", "worst"], estimated_ms=[*ours], paper_ms=theirs))
    ratio = table["estimated_ms"] / table["paper_ms"]
    return table.assign(ratio=ratio, a_fifth_at_most=ratio <= 1 / 5)
