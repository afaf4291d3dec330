"""An estimator offline: its step scanned over recorded measurements, with arrays by name.

Replays, calibrations and studies all run an estimator over measurements that exist already. `build`
makes the Functions of such a scan, which `compiled.load` compiles; `run` calls them.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi import scan

__all__ = ["build", "run"]


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
    newest = dict(zip(columns, ca.vertsplit(stream, [0, *map(int, ends)])))
    results = step.call([*(symbols | newest).values()])
    known = dict(zip(["memory", "estimate", *step.name_out()[2:]], results))
    recorded = {name: ca.densify(known[name]) for name in outputs}
    constant = [name for name in settings if name not in streamed]
    # The outputs behind the row are for their names and shapes, which `run` reads.
    whole = ca.Function(
        "offline",
        [symbols[memory], stream, *(symbols[name] for name in constant)],
        [known["memory"], ca.veccat(*recorded.values()), *recorded.values()],
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
        settings: {name: array} of the other settings; those that the step does not take are unused.

    Returns:
        {output: array}, of shape (n,) for a number, (n, rows) for a vector, (n, rows, columns) for
        a matrix.
    """
    _, rows = scan.scan(functions, memory, stream, settings)
    step = functions["step"]
    arrays = {}
    begin = 0
    for name in step.name_out()[2:]:
        n_rows, n_columns = step.size_out(name)
        part = rows[:, begin : begin + n_rows * n_columns]
        begin += n_rows * n_columns
        if n_columns > 1:
            # CasADi stores matrices column by column.
            arrays[name] = part.reshape(len(rows), n_columns, n_rows).swapaxes(1, 2)
        else:
            arrays[name] = part[:, 0] if n_rows == 1 else part
    return arrays
