"""Instructions a step on 64-bit Arm, and estimated times on a Cortex-A53.

The emulator writes down each block of instructions that it executes; that does not depend on the
machine's load. LLVM's model of the Cortex-A53 (llvm-mca: in order, at most two instructions a
cycle, its latencies) then says how many cycles that very sequence takes, if all of it is in the
first cache and all branches are predicted. The time to fill that cache is added, on assumptions of
its own.
"""

import re
import shutil
import subprocess
from array import array
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec.workbench.studies.timing import PHASES

__all__ = ["CLOCK_HZ", "counts", "table", "trace"]

# Functions that make the phases, in the order of PHASES, and those that call them in programs
_CALLS = "rhec_prepare_estimate", "rhec_estimate", "rhec_prepare_control", "rhec_control"
_CALLERS = "main", "sample"
CLOCK_HZ = 1.2e9  # Raspberry Pi 3 Model B (paper, Sec. System Description)
_LINE_BYTES = 64
# assumed: to fetch a line from there
_SECOND_CACHE_S = 20 / CLOCK_HZ
_DRAM_S = 150e-9
# Samples whose cycles are counted: from all over the run, and those of most instructions
_SPREAD = 5
_LONGEST = 5


class _Trace(NamedTuple):
    """Executed instructions.

    blocks   [(address, instruction words in hexadecimal), …]
    samples  of each sample, for each phase, the numbers of its blocks in order of execution
    """

    blocks: list
    samples: list


def trace(machine, program, *arguments):
    """Run a program of an export under the emulator and write down what each call of each sample
    executes.
    """
    command = [*machine.emulator, "-d", "in_asm,exec,nochain", program, *map(str, arguments)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, bufsize=1 << 20
    ) as process:
        return _read(process.stderr)


def _read(listing):
    """The _Trace in the emulator's listing."""
    blocks = []
    numbers = {}
    samples = []
    phase = None
    fresh = None
    for line in listing:
        if line.startswith("Trace"):
            address = line[line.index("/") + 1 :].split("/", 1)[0]
            function = line.rsplit(None, 1)[-1].split(".")[0]
            if fresh is not None:  # listed when translated, right before it is first executed
                numbers[address] = len(blocks)
                blocks.append((int(address, 16), fresh))
                fresh = None
            if phase is None and function in _CALLS:
                phase = _CALLS.index(function)
                if phase == 0 or not samples or samples[-1][phase]:
                    samples.append([array("l") for _ in _CALLS])
            elif function in _CALLERS:
                phase = None
            if phase is not None:
                samples[-1][phase].append(numbers[address])
        elif line.startswith("0x"):
            fresh.append(line.split()[1])
        elif line.startswith("IN:"):
            fresh = []
    return _Trace(blocks, samples)


def counts(traced):
    """Instructions (samples, 4), as in PHASES."""
    lengths = np.array([len(words) for _, words in traced.blocks])
    return np.array(
        [
            [lengths[np.frombuffer(phase, dtype=f"i{phase.itemsize}")].sum() for phase in sample]
            for sample in traced.samples
        ]
    )


def _cache_lines(traced, sample, memory_bytes):
    """Lines of the cache that each phase of a sample fills, (4,): with its code, and with its
    share, by instructions, of all memory.
    """
    code = []
    for phase in traced.samples[sample]:
        blocks = (traced.blocks[number] for number in set(phase))
        ends = [(address, address + 4 * len(words) - 1) for address, words in blocks]
        code.append(
            len(
                {
                    i
                    for low, high in ends
                    for i in range(low // _LINE_BYTES, high // _LINE_BYTES + 1)
                }
            )
        )
    executed = counts(_Trace(traced.blocks, [traced.samples[sample]]))[0]
    return np.array(code) + memory_bytes / _LINE_BYTES * executed / executed.sum()


def _cycles(traced, sample):
    """Cycles of each phase of a sample by llvm-mca's Cortex-A53, (4,); NaN without llvm-mca."""
    if not (shutil.which("llvm-mc") and shutil.which("llvm-mca")):
        return np.full(4, np.nan)
    cycles = []
    for phase in traced.samples[sample]:
        words = [_as_executed(word) for number in phase for word in traced.blocks[number][1]]
        code = "\n".join(" ".join(f"0x{word[i : i + 2]}" for i in (6, 4, 2, 0)) for word in words)
        assembly = _output("llvm-mc -disassemble -triple=aarch64", code)
        report = _output(
            "llvm-mca -mtriple=aarch64 -mcpu=cortex-a53 -iterations=1 -instruction-info=0 "
            "-resource-pressure=0",
            assembly,
        )
        cycles.append(int(re.search(r"Total Cycles: +(\d+)", report)[1]))
    return np.array(cycles)


def _output(command, text):
    """Output of a command that is given this text."""
    arguments = command.split()
    return subprocess.run(arguments, input=text, capture_output=True, text=True, check=True).stdout


def _as_executed(word):
    """An instruction of the executed sequence: calls and returns, which llvm-mca charges with 100
    cycles, are plain branches here.
    """
    code = int(word, 16)
    call = code >> 26 == 0b100101
    indirect = code & 0xFFFFFC1F in (0xD61F0000, 0xD63F0000, 0xD65F0000)
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
    spread = np.linspace(0, len(whole) - 1, _SPREAD).astype(int)
    longest = np.argsort(whole)[-_LONGEST:]
    chosen = np.unique([*spread, *longest])
    with ThreadPoolExecutor() as pool:
        taken = dict(zip(chosen, pool.map(lambda sample: _cycles(traced, sample + 1), chosen)))
    pace = sum(taken[sample] for sample in spread) / executed[spread].sum(axis=0)
    worst = max(longest, key=lambda sample: taken[sample].sum())

    mean_s = executed.mean(axis=0) * pace / CLOCK_HZ
    mean_s = mean_s + _SECOND_CACHE_S * _cache_lines(traced, spread[-1] + 1, memory_bytes)
    worst_s = taken[worst] / CLOCK_HZ + _DRAM_S * _cache_lines(traced, worst + 1, memory_bytes)
    columns = dict(
        mean_instructions=np.append(executed.mean(axis=0), whole.mean()),
        worst_instructions=np.append(executed.max(axis=0), whole.max()),
        mean_ms=1e3 * np.append(mean_s, mean_s.sum()),
        worst_ms=1e3 * np.append(worst_s, worst_s.sum()),
    )
    rows = pd.DataFrame([*PHASES, ("RHE + RHC", "overall")], columns=["problem", "phase"])
    return rows.assign(**columns)
