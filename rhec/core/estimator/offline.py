"""An estimator offline: its step scanned over recorded measurements, with results by name.

`build` makes the Functions of the scan, which `compiled.load` compiles; `run` calls them. `run_all`
compiles and calls them for several recordings at a time.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi import compiled, scan
from rhec.core.lanes import lanes


def build(step, outputs, streamed=()):
    """Scan of an estimator's step over a stream of measurements.

    Args:
        step: Function (memory, z, settings …) -> (memory, estimate, …). The first two inputs and
            the first two outputs are known by their position, all others by their names.
        outputs: Names of the outputs that each sample records, such as "estimate", "covariance".
        streamed: Names of the settings that change from sample to sample. In the stream their
            entries follow those of z.

    Returns:
        {"step", "block"}, as `rhec.core._casadi.scan.build_scan`; a row holds the outputs.
    """
    symbols = dict(zip(step.name_in(), step.mx_in()))
    memory, z, *settings = symbols
    columns = [z, *streamed]
    ends = np.cumsum([symbols[name].numel() for name in columns])
    stream = ca.MX.sym("stream", int(ends[-1]))
    # Entries of the stream replace these inputs of the step; the others stay inputs of the scan.
    sample = dict(zip(columns, ca.vertsplit(stream, [0, *map(int, ends)])))
    results = step.call([*(symbols | sample).values()])
    results = dict(zip(["memory", "estimate", *step.name_out()[2:]], results))
    recorded = {name: ca.densify(results[name]) for name in outputs}
    constant = [name for name in settings if name not in streamed]
    whole = ca.Function(
        "offline",
        [symbols[memory], stream, *(symbols[name] for name in constant)],
        # The scan reads the row alone; `run` reads names and shapes of the outputs behind it.
        [results["memory"], ca.veccat(*recorded.values()), *recorded.values()],
        ["memory", "stream", *constant],
        ["memory", "row", *recorded],
        {"allow_duplicate_io_names": True},
    )
    return scan.build_scan(whole)


def run(functions, memory, stream, settings):
    """Outputs of an estimator at each recorded sample.

    Args:
        functions: What `build` returns, compiled or not.
        memory: (n_memory,) the step's memory before the first sample.
        stream: (n, columns) measurements z, then the streamed settings.
        settings: {name: array} of the other settings, and of more that are not used.

    Returns:
        {output: array}, (n,) of a number, (n, rows) of a vector, (n, rows, columns) of a matrix.
    """
    _, rows = scan.scan(functions, memory, stream, settings)
    return _by_name(functions["step"], rows)


def run_all(make, structure, memories, streams, settings):
    """Outputs of an estimator at each sample of several recordings, in lanes where there are any.

    Args:
        make: Function that returns what `build` returns.
        structure: The tuple of its arguments, as for `compiled.load`.
        memories: The step's memory (n_memory,) before the first sample, of each recording.
        streams: (n, columns) measurements z, then the streamed settings, of each.
        settings: {name: array} of the other settings, of each.

    Returns:
        A list of what `run` returns, with the same bits, one for each recording.
    """
    block = lanes.load(make, *structure)
    if block is None:
        functions = compiled.load(make, *structure)
        return [run(functions, *of_one) for of_one in zip(memories, streams, settings)]
    step = make(*structure)["step"]
    results = []
    for first in range(0, len(streams), block.lanes):
        some = slice(first, first + block.lanes)
        rows = lanes.scan(block, memories[some], streams[some], settings[some])
        # Sums of NumPy depend on how an array lies in memory.
        results += [_by_name(step, np.ascontiguousarray(of_one)) for of_one in rows]
    return results


def _by_name(step, rows):
    """{output: array} of the rows (n, outputs) of a scan of this step."""
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
