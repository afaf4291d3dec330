"""What a drive costs on each engine, and what many drives would cost: docs/campaigns.md.

    python tests/engine_costs.py [drives, 10000 by itself]

Each engine runs the same drives, and where it can go on, a worker is killed on the way. All must
give the same rows to the last bit. Its costs of a drive, and the table that follows from them, are
printed in Markdown.
"""

import json
import os
import pickle
import subprocess
import sys
import tempfile
import tracemalloc
from concurrent.futures import Executor, Future
from pathlib import Path

import psutil
from engines import ENGINES, ONE_THREAD, scenarios

import rhec

HERE = Path(__file__).parent
CORES = 100
POWERS = "⁴⁵⁶⁷⁸⁹"
NAMES = dict(
    here="this process", own="own workers", dask="Dask", mpi="MPI", ipyparallel="ipyparallel"
)


class Counting(Executor):
    """It computes in this process, and counts the bytes that others would be sent and return."""

    bytes = 0

    def submit(self, function, task):
        """Return the finished Future of function(task)."""
        future = Future()
        future.set_result(function(task))
        self.bytes += len(pickle.dumps((function, task))) + len(pickle.dumps(future.result()))
        return future


def bytes_of_a_drive(drives):
    """Bytes of one drive: to a worker and back, kept in a folder, and in the caller's memory."""
    counting = Counting()
    with tempfile.TemporaryDirectory() as folder:
        rhec.campaign(scenarios(drives), folder, counting)
        kept = sum(file.stat().st_size for file in Path(folder).glob("*/*.parquet"))
        tracemalloc.start()
        # From the folder, which takes no longer, and where the caller has the same rows.
        rhec.campaign(scenarios(drives), folder, counting)
        memory = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return counting.bytes / drives, kept / drives, memory / drives


def measured(engine, drives):
    """What `engines.py` says of an engine, and `cpu_s`: the time of all its processes together."""
    begin = [sys.executable]
    # All of an MPI job ends with one of its processes.
    kill = [] if engine in ("here", "mpi") else ["--kill"]
    if engine == "mpi":
        begin = [str(Path(sys.executable).with_name("mpiexec")), "-n", "3", *begin]
        begin += ["-m", "mpi4py.futures"]
    command = [*begin, str(HERE / "engines.py"), engine, str(drives), *kill]
    before = psutil.Process().cpu_times()
    done = subprocess.run(
        command, env=os.environ | ONE_THREAD, stdout=subprocess.PIPE, text=True, check=True
    )
    after = psutil.Process().cpu_times()
    used = [getattr(after, of) - getattr(before, of) for of in ("children_user", "children_system")]
    said = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    return said | dict(cpu_s=sum(used))


def reckoned(cpu_s, moved, kept, memory):
    """Lines of the table for 10⁴ to 10⁹ drives, of the costs of one: seconds and bytes."""
    lines = []
    for place, power in enumerate(POWERS):
        drives = 10 ** (4 + place)
        times = [of_seconds(drives * cpu_s / cores) for cores in (1, CORES)]
        sizes = [of_bytes(drives * size) for size in (moved, kept, memory)]
        lines.append(f"| 10{power} | {' | '.join([*times, *sizes])} |")
    return lines


def of_seconds(seconds):
    """A time of two digits, in hours from two on."""
    return f"{digits(seconds)} s" if seconds < 7200 else f"{digits(seconds / 3600)} h"


def of_bytes(size):
    """A size of two digits, in GB from one on."""
    return f"{digits(size / 1e6)} MB" if size < 1e9 else f"{digits(size / 1e9)} GB"


def digits(number):
    """A number of two digits."""
    return f"{float(f'{number:.2g}'):,.10g}"


def main(drives=10_000):
    """Measure, and print both tables."""
    drives = int(drives)
    said = {engine: measured(engine, drives) for engine in ENGINES}
    bits = {of["digest"] for of in said.values()}
    assert len(bits) == 1 and not any(of["failed"] for of in said.values()), said
    moved, kept, memory = bytes_of_a_drive(drives)
    print(f"{drives:,} drives, all rows with the digest {bits.pop()}\n")
    print("| cost of a drive | measured |\n|---|---|")
    for engine, of in said.items():
        name = NAMES[engine] + ", a worker killed" * of["killed"]
        print(f"| processor time, {name} | {digits(of['cpu_s'] / drives * 1e3)} ms |")
    caller_ms = said["dask"]["caller_s"] / drives * 1e3
    print(f"| processor time of the caller with Dask | {digits(caller_ms)} ms |")
    print(f"| bytes to a worker and back | {moved:.0f} |")
    print(f"| bytes kept in the folder | {kept:.0f} |")
    print(f"| memory of the caller | {digits(memory)} bytes |\n")
    print(f"| drives | processor time | on {CORES} cores | moved | kept | memory of the caller |")
    print("|---|---|---|---|---|---|")
    print(*reckoned(said["own"]["cpu_s"] / drives, moved, kept, memory), sep="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
