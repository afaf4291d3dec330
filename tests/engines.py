"""A campaign on an engine of several processes that are started for it.

    python tests/engines.py dask 10000 --kill
    mpiexec -n 3 python -m mpi4py.futures tests/engines.py mpi 10000

It prints the digest of all rows, how long it took, and the processor time of the caller. With
--kill a worker is killed when a third of the rows are there.
"""

import argparse
import contextlib
import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import psutil
import pyarrow.parquet as pq

import rhec

ENGINES = ("here", "own", "dask", "mpi", "ipyparallel")
WORKERS = 2
ONE_THREAD = dict(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")


def scenarios(drives):
    """Scenario B by both estimators, on seeds from 0."""
    return [rhec.Scenario(estimator=("rhe", "ekf")[k % 2], seed=k // 2) for k in range(drives)]


def digest(table):
    """A digest of every bit of a campaign's rows."""
    return hashlib.sha256(table.to_csv().encode()).hexdigest()[:16]


@contextlib.contextmanager
def processes(*commands):
    """A context with these processes, which end with it."""
    environment = os.environ | ONE_THREAD
    started = [subprocess.Popen(command, env=environment) for command in commands]
    try:
        yield started
    finally:
        for each in reversed(started):
            each.send_signal(signal.SIGTERM)
        for each in started:
            each.wait(30)


@contextlib.contextmanager
def dask_cluster(workers=WORKERS):
    """A context with the address of a scheduler of Dask, and the processes of its workers.

    Each is the parent of the process that computes, and starts another one when that is killed.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "scheduler.json")
        dask = [sys.executable, "-m", "dask"]
        # On this machine alone; port 0 is one that is free.
        common = ["--scheduler-file", str(file), "--no-dashboard"]
        begin = ["scheduler", "--host", "127.0.0.1", "--port", "0"]
        with processes([*dask, *begin, *common]) as scheduler:
            wait(lambda: file.exists() and file.stat().st_size or scheduler[0].poll())
            begin = ["worker", "--nthreads", "1", "--local-directory", folder]
            with processes(*[[*dask, *begin, *common]] * workers) as nannies:
                yield json.loads(file.read_text())["address"], nannies


def children_of(nannies):
    """The processes that compute, below those of `dask_cluster`."""
    found = []
    for nanny in nannies:
        for child in psutil.Process(nanny.pid).children(recursive=True):
            with contextlib.suppress(psutil.NoSuchProcess):
                if "spawn_main" in " ".join(child.cmdline()):
                    found.append(child)
    return found


def wait(done, seconds=300):
    """Wait until a function's result is true."""
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, "it took too long"
        time.sleep(0.05)


def kill_at(folder, rows, find, killed):
    """Kill the first of the processes that `find` finds, once a folder has so many rows.

    It appends the process to the list `killed`.
    """

    def watch():
        files = {}
        while sum(files.values()) < rows:
            time.sleep(0.1)
            for file in Path(folder).glob("*/*.parquet"):
                if file not in files:
                    files[file] = pq.read_metadata(file).num_rows
        killed.append(find()[0])
        killed[0].kill()

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def executor_of(engine):
    """A context with the `workers` of an engine, and what finds its processes that compute."""
    if engine in ("here", "own"):
        from storm import workers_of

        yield (WORKERS if engine == "own" else 1), lambda: workers_of(psutil.Process())
    elif engine == "mpi":
        from mpi4py.futures import MPIPoolExecutor

        with MPIPoolExecutor() as executor:
            yield executor, lambda: psutil.Process(os.getppid()).children()[1:]
    elif engine == "dask":
        from distributed import Client

        with dask_cluster() as (address, nannies), Client(address) as client:
            client.wait_for_workers(WORKERS)
            yield client.get_executor(pure=False), lambda: children_of(nannies)
    else:
        import ipyparallel

        cluster = ipyparallel.Cluster(n=WORKERS, log_level=40)
        with cluster as client:
            client.wait_for_engines(WORKERS)
            engines = client[:].apply_sync(os.getpid)
            found = [psutil.Process(pid) for pid in engines]
            yield client.load_balanced_view().executor, lambda: found


def main():
    """Run a campaign from the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("engine", choices=ENGINES)
    parser.add_argument("drives", type=int)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--kill", action="store_true")
    options = parser.parse_args()
    killed = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        with executor_of(options.engine) as (workers, find):
            if options.kill:
                kill_at(folder, options.drives // 3, find, killed)
            began = time.monotonic()
            table = rhec.campaign(scenarios(options.drives), folder, workers)
            seconds = time.monotonic() - began
    used = resource.getrusage(resource.RUSAGE_SELF)
    caller_s = round(used.ru_utime + used.ru_stime, 1)
    failed = int((table["error"] != "").sum())
    result = dict(engine=options.engine, rows=len(table), failed=failed, digest=digest(table))
    result |= dict(seconds=round(seconds, 1), caller_s=caller_s, killed=len(killed))
    print(json.dumps(result))


if __name__ == "__main__":
    main()
