"""Report on an export: agreement with Python, memory, fuzzing, times on this machine and on a
Raspberry Pi 3, as far as the tools at hand can say.
"""

import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from notebooks.embedded_measurements import instructions, toolchain
from rhec import paper
from rhec.simulation.columns import MEASUREMENTS
from rhec.workbench.studies.timing import PHASES

__all__ = ["TOLERANCE", "against_the_paper", "measure", "reported"]

_PI = "Raspberry Pi 3"
TOLERANCE = 1e-9  # m, rad, m/s, 1, rad/s: how far C may be from Python


def measure(export, samples=60):
    """Tables of an export: {sizes, times, nonsense, counted}; nonsense is empty without a compiler,
    counted without one for 64-bit Arm and an emulator.

    sizes: one row a machine, the largest difference to Python in the export's log and bytes of
    code, memory and stack. times: mean and worst [ms], one row a machine, who says so, problem and
    phase. nonsense: report of `fuzz` on this machine. counted: instructions of the first `samples`
    of the log on 64-bit Arm and times estimated from them, see `instructions.table`.
    """
    export, log = Path(export), Path(export, "log.csv")
    header = (export / "rhec_memory.h").read_text()
    memory_bytes = int(re.search(r"RHEC_MEMORY_BYTES (\d+)", header)[1])
    expected = pd.read_csv(log).drop(columns=MEASUREMENTS)
    sizes = []
    times = reported()
    nonsense = pd.DataFrame()
    counted = pd.DataFrame()
    for machine in dict.fromkeys(filter(None, (toolchain.this_machine(), toolchain.arm()))):
        with tempfile.TemporaryDirectory() as folder:
            objects = toolchain.library(machine, export, folder)
            replay, *others = (
                toolchain.program(machine, export, name, objects)
                for name in (["replay"] if machine.emulator else ["replay", "fuzz", "times"])
            )
            answers = toolchain.replay(machine, replay, log)[expected.columns]
            row = dict(
                machine=machine.name,
                largest_difference=np.abs(answers - expected).to_numpy().max(),
                memory_bytes=memory_bytes,
            )
            sizes.append(row | toolchain.sizes(machine, objects))
            if machine.emulator:
                part = Path(folder, "log.csv")
                lines = log.read_text().splitlines(keepends=True)
                part.write_text("".join(lines[: samples + 1]))
                counted = instructions.table(
                    instructions.trace(machine, replay, part),
                    memory_bytes + np.nan_to_num(sizes[-1]["stack_bytes"]),
                )
                pairs = counted[["mean_ms", "worst_ms"]].to_numpy()
                times += _rows(_PI, "rhec, estimated", pairs)
            else:
                fuzz, clock = others
                nonsense = toolchain.nonsense(machine, fuzz)
                taken = toolchain.times(machine, clock, log) / 1e3
                pairs = np.column_stack([taken.mean(axis=0), taken.max(axis=0)])
                times += _rows("this machine", "rhec, measured", pairs)
    return dict(
        sizes=pd.DataFrame(sizes), times=pd.DataFrame(times), nonsense=nonsense, counted=counted
    )


def _rows(machine, who, pairs):
    """Rows of a table of times: mean and worst [ms] of each phase, (4, 2)."""
    return [
        dict(machine=machine, who=who, problem=problem, phase=phase, mean_ms=mean, worst_ms=worst)
        for (problem, phase), (mean, worst) in zip(PHASES, pairs)
    ]


def reported():
    """Rows of the paper's Table of computation times."""
    return _rows(_PI, "paper, reported", [paper.TABLE_1_MS[key][1:] for key in PHASES])


def against_the_paper(counted):
    """The estimated times of a whole sample beside the paper's, and whether they are at most a
    fifth of them.
    """
    whole = counted.iloc[-1]
    ours = whole[["mean_ms", "worst_ms"]]
    theirs = (paper.STEP_MEAN_MS, paper.STEP_MAX_MS)
    table = pd.DataFrame(dict(time=["mean", "worst"], estimated_ms=[*ours], paper_ms=theirs))
    ratio = table["estimated_ms"] / table["paper_ms"]
    return table.assign(ratio=ratio, a_fifth_at_most=ratio <= 1 / 5)
