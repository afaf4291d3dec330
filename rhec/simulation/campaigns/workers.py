"""Worker processes on this machine, by loky.

They communicate through pipes, so no port is open to other users. The script that starts them needs
no `if __name__ == "__main__":`.
"""

import contextlib
import importlib.util
import itertools
import os
import pickle
import queue
import shutil
import signal
import tempfile
import threading
import time
import warnings
from concurrent.futures.process import BrokenProcessPool

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

_existing = None  # the workers of this process, which the next campaign reuses


def is_worth_spreading(samples):
    """Return whether this number of samples pays for worker processes."""
    are_running = _existing is not None and _existing.pool is not None
    return samples >= (_WORTH_SPREADING if are_running else _WORTH_STARTING)


def get_workers(count, large):
    """Return existing or new workers, or None for this process.

    Args:
        count: Number of processes, or None to choose: for a large campaign one per core.
        large: Whether starting processes pays.

    Raises:
        ImportError: If loky is needed and not installed.
    """
    global _existing
    if count is None and large and importlib.util.find_spec("loky"):
        count = _count_cores()
    if count in (None, 1):
        return None
    optional("loky", f"workers={count}")
    if _existing is None or _existing.count != count:
        if _existing is not None:
            _existing.stop()
        _existing = _Workers(count)
    return _existing


def _count_cores():
    """Return the number of cores to use: PYTHON_CPU_COUNT, as in Python 3.13, or all."""
    import loky

    limit = os.environ.get("PYTHON_CPU_COUNT", "")
    return int(limit) if limit.isdecimal() and int(limit) else loky.cpu_count()


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

    def submit(self, function, task):
        """Return the Future of function(task), whose result is for `_from_file`."""
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

    def stop(self):
        """Kill the processes and their tasks."""
        if self.pool is not None:
            self.pool.shutdown(kill_workers=True)
        self.pool = None


def _into_file(function, task, folder):
    """Return (path, None), where function(task) is pickled in a new file of this folder.

    Without room for the file, it is (None, function(task)).
    """
    result = function(task)
    file = None
    try:
        handle, file = tempfile.mkstemp(dir=folder)
        with open(handle, "wb") as content:
            pickle.dump(result, content)
    except OSError:
        with contextlib.suppress(OSError, TypeError):
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


def map_tasks(workers, function, tasks):
    """Yield (task, function(task)) in the order in which the workers finish.

    An error of the function is raised here. When a worker dies, nothing tells which task it ran, so
    all pending tasks have the result None.

    Args:
        workers: The workers of `get_workers`.
        function: A function of a task.
        tasks: An iterable of tasks.
    """
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
            with contextlib.suppress(BrokenProcessPool):
                result = _from_file(*future.result())
            yield pending.pop(future), result
    finally:
        if pending:  # interrupted, or an error
            workers.stop()
