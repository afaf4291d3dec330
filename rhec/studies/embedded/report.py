"""What an export needs and how long it takes, on this machine and on a Raspberry Pi 3, as far as
the tools at hand can say.
"""

import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from rhec import paper
from rhec.studies.embedded import instructions, toolchain
from rhec.studies.embedded.toolchain import PHASES

PI = "Raspberry Pi 3"
TOLERANCE = 1e-9  # m, rad, m/s, 1, rad/s: how far C may be from Python


def measure(export, samples=60):
    """Tables of an export: {sizes, times, nonsense, counted}; nonsense is empty without a compiler,
    counted without one for 64-bit Arm and an emulator.

    sizes: one row a machine, the largest difference to Python in the export's log and bytes of
    code, memory and stack. times: mean and worst [ms], one row a machine, who says so, problem and
    phase. nonsense: what `fuzz` reports on this machine. counted: instructions of the first
    `samples` of the log on 64-bit Arm and what follows from them, see `instructions.table`.
    """
    export, sizes, times, nonsense, counted = (
        Path(export),
        [],
        reported(),
        pd.DataFrame(),
        pd.DataFrame(),
    )
    memory_bytes = int(
        re.search(r"RHEC_MEMORY_BYTES (\d+)", (export / "rhec_memory.h").read_text())[1]
    )
    expected = pd.read_csv(export / "log.csv").iloc[:, 4:]
    for machine in dict.fromkeys(filter(None, (toolchain.this_machine(), toolchain.arm()))):
        with tempfile.TemporaryDirectory() as folder:
            objects = toolchain.library(machine, export, folder)
            replay = toolchain.program(machine, export, "replay", objects)
            answers = toolchain.replay(machine, replay, export / "log.csv")[expected.columns]
            row = dict(
                machine=machine.name,
                largest_difference=np.abs(answers - expected).to_numpy().max(),
                memory_bytes=memory_bytes,
            )
            sizes.append(row | toolchain.sizes(machine, objects))
            if machine.emulator:
                part = Path(folder) / "log.csv"
                part.write_text(
                    "".join(
                        (export / "log.csv").read_text().splitlines(keepends=True)[: samples + 1]
                    )
                )
                counted = instructions.table(
                    instructions.trace(machine, replay, part),
                    memory_bytes + np.nan_to_num(sizes[-1]["stack_bytes"]),
                )
                times += [
                    dict(
                        machine=PI,
                        who="rhec, estimated",
                        problem=row.problem,
                        phase=row.phase,
                        mean_ms=row.mean_ms,
                        worst_ms=row.worst_ms,
                    )
                    for row in counted.itertuples()
                    if row.phase != "overall"
                ]
            else:
                nonsense = toolchain.nonsense(
                    machine, toolchain.program(machine, export, "fuzz", objects)
                )
                taken = (
                    toolchain.times(
                        machine,
                        toolchain.program(machine, export, "times", objects),
                        export / "log.csv",
                    )
                    / 1e3
                )
                times += [
                    dict(
                        machine="this machine",
                        who="rhec, measured",
                        problem=problem,
                        phase=phase,
                        mean_ms=taken[:, i].mean(),
                        worst_ms=taken[:, i].max(),
                    )
                    for i, (problem, phase) in enumerate(PHASES)
                ]
    return dict(
        sizes=pd.DataFrame(sizes), times=pd.DataFrame(times), nonsense=nonsense, counted=counted
    )


def reported():
    """The paper's Table of computation times."""
    return [
        dict(
            machine=PI,
            who="paper, reported",
            problem=problem,
            phase=phase,
            mean_ms=paper.TABLE_1_MS[problem, phase][1],
            worst_ms=paper.TABLE_1_MS[problem, phase][2],
        )
        for problem, phase in PHASES
    ]


def against_the_paper(counted):
    """The estimated times of a whole sample beside the paper's, and whether they are a fifth of
    them at most.
    """
    whole = counted.iloc[-1]
    rows = [
        ("mean", whole["mean_ms"], paper.STEP_MEAN_MS),
        ("worst", whole["worst_ms"], paper.STEP_MAX_MS),
    ]
    return pd.DataFrame(
        [
            dict(
                time=time,
                estimated_ms=ours,
                paper_ms=theirs,
                ratio=ours / theirs,
                a_fifth_at_most=ours <= theirs / 5,
            )
            for time, ours, theirs in rows
        ]
    )
