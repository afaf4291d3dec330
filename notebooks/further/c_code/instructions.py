"""Instructions per step on 64-bit Arm, and estimated times on a Cortex-A53.

The emulator lists each block of instructions that it executes, which does not depend on the load of
this machine. LLVM's model of the Cortex-A53 (llvm-mca: in order, at most two instructions a cycle,
with the latency of each) turns that sequence into cycles. It assumes that all code and data are in
the first cache and that all branches are predicted. The time to fill that cache is added, on the
assumptions _SECOND_CACHE_S and _DRAM_S.
"""

import re
import shutil
import subprocess
from array import array
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import pandas as pd

from notebooks.studies.timing import PHASES

# The C functions of the phases, in the order of PHASES, and the functions that call them.
_CALLS = "rhec_prepare_estimate", "rhec_estimate", "rhec_prepare_control", "rhec_control"
_CALLERS = "main", "sample"
CLOCK_HZ = 1.2e9  # Raspberry Pi 3 Model B (paper, Sec. System Description)
_LINE_BYTES = 64
# Assumed times to fetch one line of the cache.
_SECOND_CACHE_S = 20 / CLOCK_HZ
_DRAM_S = 150e-9
# Samples whose cycles are counted: some from all over the run, and those of most instructions.
_SPREAD = 5
_LONGEST = 5


class _Trace(NamedTuple):
    """Executed instructions."""

    blocks: list  # [(address, instruction words in hexadecimal), …]
    samples: list  # for each sample and phase the numbers of its blocks, in the order of execution


def trace(machine, program, *arguments):
    """The _Trace of what each phase of each sample executes, of a program under the emulator."""
    command = [*machine.emulator, "-d", "in_asm,exec,nochain", program, *map(str, arguments)]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, bufsize=1 << 20
    ) as process:
        return _read(process.stderr)


def _read(listing):
    """The _Trace in the emulator's listing, its lines."""
    blocks = []
    numbers = {}
    samples = []
    phase = None
    fresh = None
    for line in listing:
        if line.startswith("Trace"):
            address = line[line.index("/") + 1 :].split("/", 1)[0]
            function = line.rsplit(None, 1)[-1].split(".")[0]
            # A block is listed when it is translated, right before it is first executed.
            if fresh is not None:
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
    """Numbers of instructions (samples, 4), phases as in PHASES."""
    lengths = np.array([len(words) for _, words in traced.blocks])
    return np.array(
        [
            [lengths[np.frombuffer(phase, dtype=f"i{phase.itemsize}")].sum() for phase in sample]
            for sample in traced.samples
        ]
    )


def _cache_lines(traced, sample, memory_bytes):
    """Lines of the cache that each phase of a sample fills, (4,).

    They hold the phase's code and a share of all memory in proportion to its instructions.
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
    """Output of a command whose input is `text`."""
    arguments = command.split()
    return subprocess.run(arguments, input=text, capture_output=True, text=True, check=True).stdout


def _as_executed(word):
    """The instruction word that llvm-mca counts in place of an executed one.

    llvm-mca charges calls and returns with 100 cycles, so they become plain branches.
    """
    code = int(word, 16)
    call = code >> 26 == 0b100101
    indirect = code & 0xFFFFFC1F in (0xD61F0000, 0xD63F0000, 0xD65F0000)
    return "14000001" if call or indirect else word


def table(traced, memory_bytes):
    """Instructions per sample and estimated times on a Cortex-A53; the first sample is left out.

    - mean_ms: the mean number of instructions, at the pace of samples spread over the run. Each
      line of code and memory is fetched from the second cache once, as the first is smaller.
    - worst_ms: the most cycles among the samples of most instructions. Each line is fetched from
      DRAM, one after the other, as after a pause in which other programs used the caches.

    There is a row for each phase and one for the whole sample, which uses so much memory and stack.
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
