"""Run a step (memory, input, settings …) -> (memory, row, …) over a stream of inputs, as a fold.

The step's first argument and result are its memory; its second are one input of the stream and one
row of output. The scan runs in blocks: one call of compiled code does BLOCK samples, with the
settings passed by reference. No compiled code depends on the length of the run.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.build import select_inputs

BLOCK = 48


def build_scan(step):
    """Functions {step, block}: the step, and BLOCK steps in one Function."""
    symbols = step.mx_in()
    memory = symbols[0]
    settings = symbols[2:]
    stream = ca.MX.sym("stream", step.size1_in(1), BLOCK)
    rows = []
    for sample in ca.horzsplit(stream):
        memory, row, *_ = step.call([memory, sample, *settings])
        rows.append(row)
    inputs = [symbols[0], stream, *settings]
    outputs = [memory, ca.horzcat(*rows)]
    names = step.name_in(), ["memory", "rows"], {"allow_duplicate_io_names": True}
    return dict(step=step, block=ca.Function("block", inputs, outputs, *names))


def scan(functions, memory, stream, settings):
    """Fold the step over a stream.

    Args:
        functions: Those of `build_scan`, compiled.
        memory: (n_memory,) memory before the first sample.
        stream: (n, n_inputs) inputs, one row for each sample.
        settings: {name: array} of the step's other inputs.

    Returns:
        The last memory (n_memory,), and the rows of output (n, n_outputs).
    """
    rows = np.empty((len(stream), functions["step"].numel_out(1)))
    stream = np.ascontiguousarray(stream, dtype=float)
    memory = memory.copy()
    spare = memory.copy()  # a Function must not write to the memory that it still reads
    done = 0
    for function, length in ((functions["block"], BLOCK), (functions["step"], 1)):
        if done + length > len(stream):
            continue
        call = compiled.BufferedFunction(function)
        call.set(**select_inputs(function, settings))
        memory_in, stream_in, *_ = function.name_in()
        memory_out, row_out, *_ = function.name_out()
        while done + length <= len(stream):
            call.read_from(memory_in, memory)
            call.read_from(stream_in, stream[done : done + length])
            call.write_to(memory_out, spare)
            call.write_to(row_out, rows[done : done + length])
            call.call()
            memory, spare = spare, memory
            done += length
    return memory, rows
