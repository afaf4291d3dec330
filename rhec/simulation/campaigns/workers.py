"""Workers: processes on this machine, by loky, or any executor that the caller has made.

Those of loky communicate through pipes, so no port is open to other users. The script that starts
them needs no `if __name__ == "__main__":`.
"""

import atexit
import contextlib
import functools
import importlib.util
import itertools
import multiprocessing
import os
import pickle
import platform
import queue
import shutil
import signal
import tempfile
import threading
import time
import warnings
from concurrent.futures import BrokenExecutor, Executor
from concurrent.futures.process import BrokenProcessPool

from rhec.simulation.campaigns import store
from rhec.simulation.campaigns.optional import optional

# Starting worker processes pays from this number of samples.
_WORTH_STARTING = 1_000_000
# Using worker processes that already run pays from this number of samples.
_WORTH_SPREADING = 200_000
_TASKS_PER_WORKER = 3  # running and queued, so that no worker is idle
_IDLE_S = 60.0  # idle time after which a worker process ends
_PARENT_CHECKED_S = 1.0  # interval in which a worker looks whether its parent still runs
# Each worker uses one core; by default BLAS would start one thread per core in every worker.
_ONE_THREAD = dict(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

# Errors by which Dask and ipyparallel tell that a worker died; they are no BrokenExecutor.
_DEATHS = "KilledWorker", "EngineError"
_COUNT_UNKNOWN = 16  # workers of an executor that does not tell how many it has
# What helps where a worker would compute other bits than the caller.
_BY_PROCESSOR = (
    "start the campaign and its workers on machines of one kind, or give each kind a part of the "
    "seeds and a folder, and join the tables with pandas.concat"
)
_REMEDIES = {
    "C compiler": "CC should name a C compiler that works on all machines, or be empty on all",
    "machine": _BY_PROCESSOR,
    "C library": _BY_PROCESSOR,
    "vector instructions": _BY_PROCESSOR,
}
_BY_PACKAGES = "install the same rhec and packages on all machines and start the workers anew"

_existing = None  # the workers of this process, which the next campaign reuses


def is_worth_spreading(samples):
    """Return whether this number of samples pays for worker processes."""
    are_running = _existing is not None and _existing.pool is not None
    return samples >= (_WORTH_SPREADING if are_running else _WORTH_STARTING)


def get_workers(count, large):
    """Return existing or new workers, or None for this process.

    Args:
        count: Number of processes, an Executor, or None to choose: for a large campaign the Dask
            cluster whose address RHEC_DASK is, else one process per core.
        large: Whether starting processes pays.

    Raises:
        ImportError: If loky or distributed is needed and not installed.
        OSError: If processes are asked for, and this system lets none share a lock.
    """
    global _existing
    if count is None and large and (address := os.environ.get("RHEC_DASK")):
        count = _of_dask(address)
    if isinstance(count, Executor):
        return _Given(count)
    lacking = _lacks_locks()
    if count is None and large and not lacking and importlib.util.find_spec("loky"):
        count = _count_cores()
    if count in (None, 1):
        return None
    optional("loky", f"workers={count}")
    if lacking:
        raise OSError(
            lacking.errno,
            f"workers={count} needs locks that processes share, as a writable /dev/shm has them "
            f"({lacking.strerror}); workers=1 needs none",
        )
    if _existing is None or _existing.count != count:
        if _existing is not None:
            _existing.stop(())
        _existing = _Workers(count)
    return _existing


def _count_cores():
    """Return the number of cores to use: PYTHON_CPU_COUNT, as in Python 3.13, or all."""
    import loky

    limit = os.environ.get("PYTHON_CPU_COUNT", "")
    return int(limit) if limit.isdecimal() and int(limit) else loky.cpu_count()


def _lacks_locks():
    """Return the OSError with which this system refuses a lock of several processes, or None."""
    try:
        multiprocessing.Lock()
    except OSError as error:
        return error
    return None


@functools.cache
def _of_dask(address):
    """Return the Executor of the Dask cluster whose scheduler has this address."""
    return optional("distributed", f"RHEC_DASK={address}").Client(address).get_executor(pure=False)


class _Workers:
    """Worker processes, started with the first task.

    Results come back in files of a private folder; a pipe transfers only their names. If a worker
    is killed while it writes a long message, the reader of the pipe waits for its end for ever. A
    name is so short that the pipe has all of it or nothing.
    """

    def __init__(self, count):
        self.count = count
        self.pool = None
        self.folder = tempfile.TemporaryDirectory(
            prefix="rhec-workers-", ignore_cleanup_errors=True
        )
        atexit.register(self.folder.cleanup)

    def submit(self, function, task):
        """Return the Future of function(task); `result` reads what it left."""
        order = _into_file, function, task, self.folder.name
        with _interrupts_blocked():
            if self.pool is not None:
                with contextlib.suppress(BrokenProcessPool):  # workers died: start new ones
                    return self.pool.submit(*order)
            import loky

            # Compiled loops take much memory. A worker that is replaced for it loses no run.
            warnings.filterwarnings("ignore", "A worker was restarted", UserWarning)
            self.pool = loky.ProcessPoolExecutor(
                self.count,
                timeout=_IDLE_S,
                env=_ONE_THREAD,
                initializer=_end_with_parent,
                initargs=(os.getpid(), self.folder.name),
            )
            return self.pool.submit(*order)

    @staticmethod
    def result(future):
        """Return the result of a finished future; raise BrokenExecutor if its worker died."""
        return _from_file(*future.result())

    def stop(self, pending):
        """Kill the processes and their tasks."""
        if self.pool is not None:
            self.pool.shutdown(kill_workers=True)
        self.pool = None


class _Given:
    """The workers of an Executor that the caller has made, and that stays the caller's."""

    def __init__(self, executor):
        self.pool = executor
        self.count = _count_of(executor)

    def submit(self, function, task):
        """Return the Future of function(task)."""
        try:
            return self.pool.submit(function, task)
        except BrokenExecutor:
            raise RuntimeError(
                f"a worker of the {type(self.pool).__name__} died, which starts no other; with a "
                "folder, the same call with a new executor continues from the runs that are done"
            ) from None

    @staticmethod
    def result(future):
        """Return the result of a finished future; raise BrokenExecutor if its worker died."""
        try:
            return future.result()
        except Exception as error:
            # ipyparallel wraps errors of its engines, whose name is `ename`.
            if getattr(error, "ename", type(error).__name__) in _DEATHS:
                raise BrokenExecutor(str(error)) from error
            raise

    def stop(self, pending):
        """Leave the workers alone, but not with tasks that nobody waits for."""
        for future in pending:
            future.cancel()


def _count_of(executor):
    """Return how many tasks an Executor computes at a time, at least 1."""
    if dask := getattr(executor, "_client", None):
        return max(1, sum(dask.nthreads().values()))
    # Of mpi4py, then of the standard library and ipyparallel.
    for name in ("num_workers", "_max_workers"):
        if count := getattr(executor, name, None):
            return count
    return _COUNT_UNKNOWN


def _into_file(function, task, folder):
    """Return (path, None), where function(task) is pickled in a new file of this folder.

    Without room for the file, it is (None, function(task)).
    """
    result = function(task)
    try:
        handle, file = tempfile.mkstemp(dir=folder)
    except OSError:
        return None, result
    try:
        with open(handle, "wb") as content:
            pickle.dump(result, content)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(file)
        return None, result
    return file, None


def _from_file(file, result):
    """Return the result of `_into_file`, and remove its file."""
    if file is None:
        return result
    with open(file, "rb") as content:
        result = pickle.load(content)
    os.unlink(file)
    return result


def _end_with_parent(parent, folder):
    """End this worker soon after its parent, the process that started it, has ended.

    If the parent is killed, a worker that waits for one of its pipes would wait for ever. The
    folder of results is removed then, because the parent could not do it.
    """

    def watch():
        while os.getppid() == parent:
            time.sleep(_PARENT_CHECKED_S)
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextlib.contextmanager
def _interrupts_blocked():
    """A context in which new processes and threads start with Ctrl-C blocked.

    A terminal sends Ctrl-C to all processes, but only this process may end the workers.
    """
    from loky.backend import resource_tracker

    resource_tracker.ensure_running()  # first, because starting it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _like_caller(expected, function, task):
    """Return function(task), if it has the bits that it has in the process that asked for it.

    Raises:
        RuntimeError: If the provenance of this process is not the expected one.
    """
    try:
        return function(task)
    finally:  # not before it, because the compiler may fail meanwhile
        _check_provenance(expected)


def _check_provenance(expected):
    here = store.provenance()
    for name, value in expected.items():
        if here[name] != value:
            raise RuntimeError(
                f"the worker on {platform.node()} has {name} {here[name]}, but the caller has "
                f"{value}, so their results may differ; {_REMEDIES.get(name, _BY_PACKAGES)}"
            )


def map_tasks(workers, function, tasks):
    """Yield (task, function(task)) in the order in which the workers finish.

    An error of the function is raised here. When a worker dies, nothing tells which task it ran, so
    all pending tasks have the result None.

    Args:
        workers: What `get_workers` returns.
        function: A function of a task.
        tasks: An iterable of tasks.

    Raises:
        RuntimeError: If a worker would compute other bits than this process.
    """
    if workers is None:
        yield from ((task, function(task)) for task in tasks)
        return
    function = functools.partial(_like_caller, store.provenance(), function)
    tasks = iter(tasks)
    pending = {}
    finished = queue.SimpleQueue()
    try:
        while True:
            room = _TASKS_PER_WORKER * workers.count - len(pending)
            for task in itertools.islice(tasks, room):
                future = workers.submit(function, task)
                pending[future] = task
                future.add_done_callback(finished.put)
            if not pending:
                return
            # Not `concurrent.futures.wait`, which Ctrl-C may leave with locks of the futures held;
            # then the workers could never be stopped.
            future = finished.get()
            result = None
            with contextlib.suppress(BrokenExecutor):
                result = workers.result(future)
            yield pending.pop(future), result
    finally:
        if pending:  # interrupted, or an error
            workers.stop(pending)
