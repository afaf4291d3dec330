"""Tables of an export of `rhec.export`: agreement with Python, memory, and times.

What the tools of this machine cannot measure is left out.
"""

import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from notebooks.studies import toolchain
from notebooks.studies.timing import PHASES
from rhec import paper
from rhec.simulation.columns import MEASUREMENTS

_PI = "Raspberry Pi 3"
TOLERANCE = 1e-9  # [m, rad, m/s, 1, rad/s] how far the answers of C may be from Python's


def measure(export):
    """Measure an export, a folder, on this machine and on 64-bit Arm.

    The tables {name: DataFrame} are empty where a tool is missing:

    - sizes: one row a machine: the largest difference to Python in the export's log, and bytes
      of code, memory and stack;
    - times: mean and worst [ms] of this machine and of the paper's, one row a machine, source,
      problem and phase.
    """
    export = Path(export)
    header = (export / "rhec_memory.h").read_text()
    memory_bytes = int(re.search(r"RHEC_MEMORY_BYTES (\d+)", header)[1])
    sizes = []
    times = reported()
    # The two are one where this machine is a 64-bit Arm.
    for machine in dict.fromkeys(filter(None, (toolchain.this_machine(), toolchain.arm()))):
        with tempfile.TemporaryDirectory() as folder:
            objects = toolchain.library(machine, export, folder)
            replay = toolchain.program(machine, export, "replay", objects)
            sizes.append(_size(machine, export, objects, replay, memory_bytes))
            # An emulator tells nothing about time.
            if not machine.emulator:
                times += _rows("this machine", "rhec, measured", _run(machine, export, objects))
    return dict(sizes=pd.DataFrame(sizes), times=pd.DataFrame(times))


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


def _run(machine, export, objects):
    """Mean and worst times [ms] of each phase, (4, 2)."""
    clock = toolchain.program(machine, export, "times", objects)
    taken = toolchain.times(machine, clock, export / "log.csv") / 1e3
    return np.column_stack([taken.mean(axis=0), taken.max(axis=0)])


def _rows(machine, who, pairs):
    """Rows of the table of times, from mean and worst times [ms] of each phase, (4, 2)."""
    return [
        dict(machine=machine, who=who, problem=problem, phase=phase, mean_ms=mean, worst_ms=worst)
        for (problem, phase), (mean, worst) in zip(PHASES, pairs)
    ]


def reported():
    """Rows with the paper's times, its Table 1."""
    return _rows(_PI, "paper, reported", [paper.TABLE_1_MS[key][1:] for key in PHASES])
