"""Instructions a step on 64-bit Arm, and how long a Cortex-A53 would take for them.

The emulator writes down each block of instructions that it executes; that does not depend on what
else the machine is doing. LLVM's model of the Cortex-A53 (llvm-mca: in order, two instructions a
cycle at most, its latencies) then says how many cycles that very sequence takes, if all of it is in
the first cache and all branches are predicted. What it takes to fill that cache is added, on
assumptions of its own.
"""

import re
import shutil
import subprocess
from array import array
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.studies.embedded.toolchain import PHASES

CALLS = (
    "rhec_prepare_estimate",
    "rhec_estimate",
    "rhec_prepare_control",
    "rhec_control",
)  # in the order of PHASES
CALLERS = ("main", "sample")  # in replay and fuzz
CLOCK_HZ = 1.2e9  # Raspberry Pi 3 Model B (paper, Sec. System Description)
LINE_BYTES = 64
SECOND_CACHE_S, DRAM_S = 20 / CLOCK_HZ, 150e-9  # assumed: to fetch a line from there
SPREAD, LONGEST = (
    5,
    5,
)  # samples whose cycles are counted: from all over the run, and those of most instructions


class Trace(NamedTuple):
    """What was executed."""

    blocks: list  # [address, instruction words in hexadecimal], one entry a block
    samples: list  # of each sample, in the order of CALLS: which blocks, one after the other


def trace(machine, program, *arguments):
    """Run a program of an export under the emulator and write down what each call of each sample
    executes.
    """
    command = [*machine.emulator, "-d", "in_asm,exec,nochain", program, *map(str, arguments)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, bufsize=1 << 20
    ) as process:
        return read(process.stderr)


def read(listing):
    """The Trace in the emulator's listing."""
    blocks, numbers, samples, phase, fresh = [], {}, [], None, None
    for line in listing:
        if line.startswith("Trace"):
            address = line[line.index("/") + 1 :].split("/", 1)[0]
            function = line.rsplit(None, 1)[-1].split(".")[0]
            if (
                fresh is not None
            ):  # a block is listed when it is translated, right before it is first executed
                numbers[address] = len(blocks)
                blocks.append((int(address, 16), fresh))
                fresh = None
            if phase is None and function in CALLS:
                phase = CALLS.index(function)
                if phase == 0 or not samples or samples[-1][phase]:
                    samples.append([array("l") for _ in CALLS])
            elif function in CALLERS:
                phase = None
            if phase is not None:
                samples[-1][phase].append(numbers[address])
        elif line.startswith("0x"):
            fresh.append(line.split()[1])
        elif line.startswith("IN:"):
            fresh = []
    return Trace(blocks, samples)


def counts(traced):
    """Instructions (samples, 4), as in PHASES."""
    lengths = np.array([len(words) for _, words in traced.blocks])
    return np.array(
        [
            [lengths[np.frombuffer(phase, dtype=f"i{phase.itemsize}")].sum() for phase in sample]
            for sample in traced.samples
        ]
    )


def lines(traced, sample, memory_bytes):
    """Lines of the cache that each phase of a sample fills, (4,): with its code, and with its
    share, by instructions, of all memory.
    """
    code = [
        len(
            {
                line
                for number in set(phase)
                for address, words in [traced.blocks[number]]
                for line in range(
                    address // LINE_BYTES, (address + 4 * len(words) - 1) // LINE_BYTES + 1
                )
            }
        )
        for phase in traced.samples[sample]
    ]
    executed = counts(Trace(traced.blocks, [traced.samples[sample]]))[0]
    return np.array(code) + memory_bytes / LINE_BYTES * executed / executed.sum()


def cycles(traced, sample):
    """Cycles of each phase of a sample by llvm-mca's Cortex-A53, (4,); NaN without llvm-mca."""
    if not (shutil.which("llvm-mc") and shutil.which("llvm-mca")):
        return np.full(4, np.nan)
    found = []
    for phase in traced.samples[sample]:
        words = [straight(word) for number in phase for word in traced.blocks[number][1]]
        code = "\n".join(" ".join(f"0x{word[i : i + 2]}" for i in (6, 4, 2, 0)) for word in words)
        assembly = subprocess.run(
            ["llvm-mc", "-disassemble", "-triple=aarch64"],
            input=code,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        report = subprocess.run(
            [
                "llvm-mca",
                "-mtriple=aarch64",
                "-mcpu=cortex-a53",
                "-iterations=1",
                "-instruction-info=0",
                "-resource-pressure=0",
            ],
            input=assembly,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        found.append(int(re.search(r"Total Cycles: +(\d+)", report)[1]))
    return np.array(found)


def straight(word):
    """An instruction of the sequence as executed: calls and returns, which llvm-mca charges with
    100 cycles, are plain branches here.
    """
    code = int(word, 16)
    call, indirect = (
        code >> 26 == 0b100101,
        code & 0xFFFFFC1F in (0xD61F0000, 0xD63F0000, 0xD65F0000),
    )
    return "14000001" if call or indirect else word


def table(traced, memory_bytes):
    """Instructions a sample, mean and worst, by phase and overall, and estimated times [ms] on a
    Cortex-A53; the first sample is left out.

    mean_ms: the mean number of instructions, at the pace of samples spread over the run, and each
    line of code and memory [bytes] fetched from the second cache once, as the first is smaller.
    worst_ms: the most cycles among the samples of most instructions, and each line fetched from
    DRAM, one after the other, as after a pause in which others used the caches.
    """
    executed = counts(traced)[1:]
    whole = executed.sum(axis=1)
    spread, longest = (
        np.linspace(0, len(whole) - 1, SPREAD).astype(int),
        np.argsort(whole)[-LONGEST:],
    )
    chosen = np.unique([*spread, *longest])
    with ThreadPoolExecutor() as pool:
        taken = dict(zip(chosen, pool.map(lambda sample: cycles(traced, sample + 1), chosen)))
    pace = sum(taken[sample] for sample in spread) / executed[spread].sum(axis=0)
    worst = max(longest, key=lambda sample: taken[sample].sum())

    mean_ms = 1e3 * (
        executed.mean(axis=0) * pace / CLOCK_HZ
        + SECOND_CACHE_S * lines(traced, spread[-1] + 1, memory_bytes)
    )
    worst_ms = 1e3 * (taken[worst] / CLOCK_HZ + DRAM_S * lines(traced, worst + 1, memory_bytes))
    rows = [
        dict(
            problem=problem,
            phase=phase,
            mean_instructions=executed[:, i].mean(),
            worst_instructions=executed[:, i].max(),
            mean_ms=mean_ms[i],
            worst_ms=worst_ms[i],
        )
        for i, (problem, phase) in enumerate(PHASES)
    ]
    return pd.DataFrame(
        [
            *rows,
            dict(
                problem="RHE + RHC",
                phase="overall",
                mean_instructions=whole.mean(),
                worst_instructions=whole.max(),
                mean_ms=mean_ms.sum(),
                worst_ms=worst_ms.sum(),
            ),
        ]
    )
