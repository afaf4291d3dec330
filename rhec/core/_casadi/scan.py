"""A run is a fold: a step (memory, input, settings …) -> (memory, row, …) taken over a stream of
inputs.

The step's first argument and result are its memory, its second are one input of the stream and one
row of what it yields. It runs in blocks: one call of compiled code for BLOCK samples, to which all
settings pass by reference. Nothing depends on the length of the run.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled
from rhec.core._casadi.build import select_inputs

__all__ = ["BLOCK", "build_scan", "scan"]

BLOCK = 48


def build_scan(step):
    """{step, block}: the step, and BLOCK of them in one Function."""
    symbols = step.mx_in()
    memory = symbols[0]
    stream = ca.MX.sym("stream", step.size1_in(1), BLOCK)
    rows = []
    for given in ca.horzsplit(stream):
        memory, row, *_ = step.call([memory, given, *symbols[2:]])
        rows.append(row)
    names = step.name_in()
    return dict(
        step=step,
        block=ca.Function(
            "block",
            [symbols[0], stream, *symbols[2:]],
            [memory, ca.horzcat(*rows)],
            names,
            ["memory", "rows"],
            {"allow_duplicate_io_names": True},
        ),
    )


def scan(functions, memory, stream, settings):
    """Fold the step over the rows of `stream` (n, inputs), from this memory. Returns the last
    memory and what each yielded (n, outputs).
    """
    rows = np.empty((len(stream), functions["step"].numel_out(1)))
    stream = np.ascontiguousarray(stream, dtype=float)
    memory, spare, done = memory.copy(), memory.copy(), 0
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
            memory, spare, done = spare, memory, done + length
    return memory, rows
