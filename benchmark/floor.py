"""How near the compiled step is to what the processor allows: its operations are counted, and what
an addition or a multiplication takes is measured.
"""

import ctypes
import subprocess
import tempfile
from collections import Counter
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd

from benchmark import native, problems
from rhec.core._casadi import compiled

PHASES = ("expand", "shift", "linearise", "feedback")


def operations(function):
    """How many operations on scalars a Function does, by CasADi's number of the operation.

    What it does in a branch alone, such as to look for another active set, is not counted.

    Args:
        function: A Function of expressions.
    """
    found = Counter()
    is_scalar = function.is_a("SXFunction")
    if not is_scalar and not function.is_a("MXFunction"):
        return found  # a branch
    for k in range(function.n_instructions()):
        what = function.instruction_id(k)
        if what == ca.OP_CALL:
            found += operations(function.instruction_MX(k).which_function())
        elif ca.OP_ASSIGN < what < ca.OP_CONST:  # CasADi numbers its arithmetic first
            found[what] += 1 if is_scalar else function.instruction_MX(k).nnz()
    return found


def _seconds_a_flop():
    """Least time of an addition or multiplication, of many that do not wait for each other."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "peak.so")
        source = Path(__file__).with_name("peak.c")
        flags = ["-O2", "-fno-tree-vectorize", "-ffp-contract=off", "-shared", "-fPIC"]
        subprocess.run([compiled.compiler(), *flags, source, "-o", library], check=True)
        peak = ctypes.CDLL(str(library)).seconds_a_flop
        peak.restype = ctypes.c_double
        return min(peak() for _ in range(200))


def measure(in_c):
    """Table by phase: operations, the floor and the measured time [µs] of a step in C.

    Args:
        in_c: {(problem, phase): median µs} of rhec in C at the paper's size.
    """
    seconds = _seconds_a_flop()
    loop = problems.robot(problems.PAPERS_SIZE[0], 1)
    rows = []
    structures = native.structures(loop)
    for problem, build, structure in zip(("RHE", "RHC"), loop.case.builds, structures):
        phases = build(structure)
        counts = {name: sum(operations(phases[name]).values()) for name in PHASES}
        feedback = counts.pop("feedback")
        for phase, number in dict(preparation=sum(counts.values()), feedback=feedback).items():
            rows.append(dict(problem=problem, phase=phase, operations=number))
    table = pd.DataFrame(rows)
    table["floor_us"] = table["operations"] * seconds * 1e6
    keys = zip(table["problem"], table["phase"])
    table["median_us"] = [in_c[key] for key in keys]
    table["over_floor"] = table["median_us"] / table["floor_us"]
    return table.assign(gflops=np.round(1e-9 / seconds, 2))
