"""Run a step (memory, input, settings …) -> (memory, row, …) over streams of inputs, as a fold.

One call of compiled code does BLOCK samples. No compiled code depends on the length of a run. What
is called is a Program: it computes one run at a time (`OneByOne`) or as many as the processor has
SIMD lanes (`rhec.core.lanes.lanes.InLanes`), with the same bits.
"""

import functools
import math
import operator
import threading

import casadi as ca
import numpy as np

from rhec.core import blocks
from rhec.core._casadi import compiled

BLOCK = 48


def build(step):
    """Functions {step, block}: the step, and BLOCK steps in one Function."""
    first_memory, _, *settings = step.mx_in()
    memory = first_memory
    stream = ca.MX.sym("stream", step.size1_in(1), BLOCK)
    rows = []
    for sample in ca.horzsplit(stream):
        memory, row, *_ = step.call([memory, sample, *settings])
        rows.append(row)
    inputs = [first_memory, stream, *settings]
    outputs = [memory, ca.horzcat(*rows)]
    names = step.name_in(), ["memory", "rows"], {"allow_duplicate_io_names": True}
    return dict(step=step, block=ca.Function("block", inputs, outputs, *names))


def build_recorded(step, outputs, streamed=()):
    """As `build`, for the step of an estimator whose outputs are recorded; see `by_name`.

    Args:
        step: Function (memory, z, settings …) -> (memory, estimate, …). The first two inputs and
            the first two outputs are known by their position, all others by their names.
        outputs: Names of the outputs that a row holds, such as "estimate", "covariance".
        streamed: Names of the settings that change from sample to sample. In the stream their
            entries follow those of z.
    """
    memory, z, *settings = step.name_in()
    next_memory, estimate, *_ = step.name_out()
    block = blocks.Block(
        _as_it_is,
        (step,),
        reads={memory: "memory", z: "z"},
        writes={next_memory: "memory", estimate: "estimate"},
        remembers=("memory",),
        draws=("z", *streamed),
    )
    return build(blocks.sample([block], settings, outputs, outputs))


def _as_it_is(step):
    return step


def aligned(*shape):
    """Zeros of this shape whose address is a multiple of the last dimension's size.

    Loading a register requires that, where the last dimension is that of the lanes.
    """
    n = math.prod(shape)
    raw = np.zeros(n + shape[-1])
    begin = -raw.ctypes.data // 8 % shape[-1]
    return raw[begin : begin + n].reshape(shape)


class Program(compiled.Uncopied):
    """A compiled Function each number of which has one entry per lane; a lane computes one run.

    Attributes:
        lanes: Number of lanes.
        sizes: {argument: length}, in order; of `build` the memory, the stream and the settings.
        shapes: {result: (rows, columns)}, in order; of `build` the memory and the rows.
        lock: Lock for using it, because all threads share its arrays.
    """

    def __init__(self, lanes, sizes, shapes):
        self.lanes = lanes
        self.sizes = sizes
        self.shapes = shapes
        self.lock = threading.RLock()
        self._arrays = {}
        self._last_settings = {}

    def evaluate(self, calls, arguments, results):
        """Call the Function, one call after the other.

        Args:
            calls: Number of calls.
            arguments: {name: array (entries, length, lanes)}. The calls take the entries in turn:
                they share a single one.
            results: {name: array (entries, length, lanes)}, to write to, likewise. A call may read
                what the call before it wrote, but not what it writes itself.
        """
        raise NotImplementedError

    def scratch(self, name, *shape):
        """The array of this name, (*shape, lanes), reused while its shape is equal."""
        if name not in self._arrays or self._arrays[name].shape[:-1] != shape:
            self._arrays[name] = aligned(*shape, self.lanes)
        return self._arrays[name]

    def interleaved_settings(self, settings):
        """{name: array (1, length, lanes)} of the settings of the lanes.

        What did not change since the last call is not copied again.
        """
        arrays = {}
        _, _, *names = self.sizes
        for name in names:
            size = self.sizes[name]
            array = arrays[name] = self.scratch(f"setting {name}", 1, size)
            values = [of_run[name] for of_run in settings]
            last = self._last_settings.get(name)
            if last is None or not all(map(operator.is_, values, last)):
                # What several lanes share is flattened once, so that `_interleave` recognises it.
                flat = {id(value): _flat(value, size) for value in values}
                _interleave(array[0], [flat[id(value)] for value in values])
                self._last_settings[name] = values
        return arrays


class OneByOne(Program):
    """A Function that computes one run at a time: a Program with one lane.

    It reads settings where they are, without copying them.
    """

    def __init__(self, function):
        sizes = {name: function.nnz_in(name) for name in function.name_in()}
        super().__init__(1, sizes, {name: function.size_out(name) for name in function.name_out()})
        self._call = compiled.BufferedFunction(function)

    def interleaved_settings(self, settings):
        """As `Program.interleaved_settings`."""
        _, _, *names = self.sizes
        (of_run,) = settings
        return {
            name: np.ascontiguousarray(_flat(of_run[name], self.sizes[name]), float)[None, :, None]
            for name in names
        }

    def evaluate(self, calls, arguments, results):
        """As `Program.evaluate`."""
        given = [(self._call.read_from, name, arguments[name]) for name in self.sizes]
        given += [(self._call.write_to, name, results[name]) for name in self.shapes]
        moving = [each for each in given if len(each[2]) > 1]
        for call in range(calls):
            for connect, name, array in moving if call else given:
                connect(name, array[call % len(array)])
            self._call.call()


# Making one takes as long as 50 samples.
@functools.lru_cache
def _one_by_one(function):
    return OneByOne(function)


def run_one(functions, memory, stream, settings):
    """The rows of output (n, n_outputs) of one run; `functions` are those of `build`."""
    (rows,) = run(_one_by_one(functions["block"]), [memory], [stream], [settings])
    return rows


def run(program, memories, streams, settings):
    """Fold a step over streams of inputs, as many runs at a time as the program has lanes.

    Args:
        program: A Program of a block of `build`.
        memories: Memory (n_memory,) before the first sample, of each run.
        streams: Inputs (n, n_inputs), one row for each sample, of each run; the numbers of samples
            may differ.
        settings: {name: array} of the step's other inputs, and of more that are not used, of each.

    Returns:
        A list of the rows of output (n, n_outputs) of each run.
    """
    rows = []
    for first in range(0, len(streams), program.lanes):
        some = slice(first, first + program.lanes)
        with program.lock:
            # In the copy (lanes, outputs, samples) the columns of a run are contiguous.
            by_lane = _fold(program, memories[some], streams[some], settings[some]).T.copy()
        rows += [lane[:, : len(stream)].T for lane, stream in zip(by_lane, streams[some])]
    return rows


def record(functions, memory, stream, settings):
    """The outputs of one run by name.

    Args:
        functions: Those of `build_recorded`, compiled or not.
        memory, stream, settings: Of the run, as for `run`.

    Returns:
        {output: array}, (n,) of a number, (n, rows) of a vector, (n, rows, columns) of a matrix.
    """
    return by_name(functions["step"], run_one(functions, memory, stream, settings))


def by_name(step, rows):
    """The rows (n, entries) of a run of `build_recorded`'s step as in `record`."""
    rows = np.ascontiguousarray(rows)  # sums of NumPy depend on how an array lies in memory
    arrays = {}
    begin = 0
    for name in step.name_out()[2:]:
        n_rows, n_columns = step.size_out(name)
        part = rows[:, begin : begin + n_rows * n_columns]
        begin += n_rows * n_columns
        # CasADi stores matrices column by column.
        matrices = part.reshape(len(rows), n_columns, n_rows).swapaxes(1, 2)
        shape = (n_rows, n_columns) if n_columns > 1 else (n_rows,) if n_rows > 1 else ()
        arrays[name] = matrices.reshape(len(rows), *shape)
    return arrays


def _fold(program, memories, streams, settings):
    """The rows (samples, n_outputs, lanes) of at most as many runs as the program has lanes.

    Streams are filled up to whole blocks, and idle lanes repeat the last run. The rows are in an
    array that the next fold writes to.
    """
    idle = program.lanes - len(streams)
    memories, streams, settings = (
        [*of_runs, *[of_runs[-1]] * idle] for of_runs in (memories, streams, settings)
    )
    memory_name, stream_name, *_ = program.sizes
    n_rows, length = program.shapes["rows"]
    calls = -(-max(map(len, streams)) // length)  # rounded up
    # Each call writes the memory that the next one reads.
    memory = program.scratch("memory, in turn", 2, program.sizes[memory_name])
    _interleave(memory[0], memories)
    n_inputs = program.sizes[stream_name] // length
    stream = program.scratch("stream of inputs", calls * length, n_inputs)
    _interleave(stream, streams)
    rows = program.scratch("rows of output", calls * length, n_rows)
    by_block = {memory_name: memory, stream_name: _by_block(stream, length)}
    results = dict(memory=memory[::-1], rows=_by_block(rows, length))
    program.evaluate(calls, program.interleaved_settings(settings) | by_block, results)
    return rows


def _by_block(array, length):
    """An array (samples, entries, lanes) as (blocks, length * entries, lanes)."""
    samples, entries, lanes = array.shape
    return array.reshape(samples // length, length * entries, lanes)


def _flat(value, size):
    """A setting as a vector, column by column; a number may stand for equal ones."""
    flat = np.ravel(value, order="F")
    # Most settings have their size already, and `broadcast_to` takes ten times as long.
    return flat if len(flat) == size else np.broadcast_to(flat, (size,))


def _interleave(array, values):
    """Fill an array (length, …, lanes) with one value per lane; values may be shorter than it."""
    first = values[0]
    if all(value is first for value in values):
        array[: len(first)] = first[..., None]
        return
    for lane, value in enumerate(values):
        array[: len(value), ..., lane] = value
