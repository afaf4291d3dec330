"""Worker processes: on this machine by loky, on other machines by an existing Dask cluster.

The processes of loky communicate through pipes, so no port is open to other users. The script that
starts them needs no `if __name__ == "__main__":`.
"""

import concurrent.futures
import contextlib
import importlib.util
import itertools
import logging
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
SCHEDULER_TIMEOUT_S = 10.0
FIRST_WORKER_TIMEOUT_S = 60.0
# Each worker uses one core; by default BLAS would start one thread per core in every worker.
_ONE_THREAD = dict(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")


def open_workers(workers, large):
    """Return a context with the workers of a campaign, or with None for this process.

    Args:
        workers: Number of processes on this machine, or None to choose: the cluster at
            DASK_SCHEDULER_ADDRESS or, if that is not set, one process per core for a large
            campaign.
        large: Whether starting processes pays.
    """
    if workers is None and os.environ.get("DASK_SCHEDULER_ADDRESS"):
        return _connect(os.environ["DASK_SCHEDULER_ADDRESS"])
    if workers is None and large and importlib.util.find_spec("loky"):
        workers = _count_cores()
    if workers in (None, 1):
        return contextlib.nullcontext()
    return contextlib.nullcontext(_local_workers(workers))


def _count_cores():
    """Return the number of cores to use: PYTHON_CPU_COUNT, as in Python 3.13, or all."""
    import loky

    limit = os.environ.get("PYTHON_CPU_COUNT", "")
    return int(limit) if limit.isdecimal() and int(limit) else loky.cpu_count()


class _LocalWorkers:
    """Worker processes on this machine, started with the first task.

    Results come back in files of a private folder; a pipe transfers only their names. If a worker
    is killed while it writes a long message, the reader of the pipe waits for its end for ever. A
    name is so short that the pipe has all of it or nothing.
    """

    died = BrokenProcessPool

    def __init__(self, count):
        self.count = count
        self.pool = None
        self.folder = tempfile.TemporaryDirectory(
            prefix="rhec-workers-", ignore_cleanup_errors=True
        )

    def submit(self, function, task):
        """Return the Future of function(task), whose value is for `result_of`."""
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
    def result_of(future):
        """Return the result of a Future that is done."""
        file, result = future.result()
        if file is None:
            return result
        with open(file, "rb") as content:
            result = pickle.load(content)
        os.unlink(file)
        return result

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


_local = None  # the workers of this process, which the next campaign reuses


def is_worth_spreading(samples):
    """Return whether this number of samples pays for worker processes on this machine."""
    are_running = _local is not None and _local.pool is not None
    return samples >= (_WORTH_SPREADING if are_running else _WORTH_STARTING)


def _local_workers(count):
    """Return `count` workers on this machine, existing or new ones."""
    global _local
    optional("loky", f"workers={count}")
    if _local is None or _local.count != count:
        if _local is not None:
            _local.stop()
        _local = _LocalWorkers(count)
    return _local


class _ClusterWorkers:
    """The workers of a Dask cluster."""

    def __init__(self, client):
        from distributed import KilledWorker

        self.client = client
        self.died = KilledWorker
        self.executor = client.get_executor(pure=False)

    @property
    def count(self):
        """Return the current number of threads of all workers."""
        return max(1, sum(self.client.nthreads().values()))

    def submit(self, function, task):
        """Return the Future of function(task)."""
        return self.executor.submit(function, task)

    @staticmethod
    def result_of(future):
        """Return the result of a Future that is done."""
        return future.result()

    def stop(self):
        """Cancel the tasks of this client."""
        self.executor.shutdown(wait=False)


@contextlib.contextmanager
def _connect(address):
    """A context with the workers of the Dask cluster at an address."""
    distributed = optional("distributed", f"DASK_SCHEDULER_ADDRESS={address}")
    from dask import config

    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # its errors are raised here
    # By default Dask may import from a folder with a fixed name that all users share.
    private = tempfile.TemporaryDirectory(prefix="rhec-dask-")
    with private, config.set({"temporary-directory": private.name}):
        client = _client_at(address, distributed)
        try:
            yield _ClusterWorkers(client)
        except (concurrent.futures.CancelledError, distributed.comm.CommClosedError):
            raise ConnectionError(
                f"the connection to the scheduler at {address} was lost"
            ) from None
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise RuntimeError(f"a worker of {address} failed ({reason})") from error
        finally:
            client.close()


def _client_at(address, distributed):
    """Return a Client that has at least one worker."""
    try:
        # A plain connection is tried first, because a Client without a scheduler leaves threads.
        distributed.utils.LoopRunner().run_sync(_try_connection, address)
        client = distributed.Client(address, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)
    except Exception as error:  # a wrong address may raise any error
        limit = f"{SCHEDULER_TIMEOUT_S:g} s"
        message = f"DASK_SCHEDULER_ADDRESS was {address!r}; no scheduler answered in {limit}"
        raise ConnectionError(message) from error
    try:
        client.wait_for_workers(1, FIRST_WORKER_TIMEOUT_S)
    except TimeoutError as error:
        client.close()
        limit = f"{FIRST_WORKER_TIMEOUT_S:g} s"
        raise ConnectionError(
            f"the scheduler at {address} has had no worker for {limit}"
        ) from error
    return client


async def _try_connection(address):
    from distributed import Security, comm

    settings = Security().get_connection_args("client")
    await (await comm.connect(address, timeout=SCHEDULER_TIMEOUT_S, **settings)).close()


def map_tasks(workers, function, tasks):
    """Yield (task, function(task)) in the order in which the workers finish.

    An error of the function is raised here. The result is None for tasks that were pending when a
    worker process died. Local workers do not report which task killed the process, so all their
    pending tasks have the result None.

    Args:
        workers: The workers of `open_workers`.
        function: A function of a task.
        tasks: An iterable of tasks.
    """
    tasks = iter(tasks)
    pending = {}
    finished = queue.SimpleQueue()
    try:
        while True:
            room = _TASKS_PER_WORKER * workers.count - len(pending)
            for task in itertools.islice(tasks, max(room, 0)):
                future = workers.submit(function, task)
                pending[future] = task
                future.add_done_callback(finished.put)
            if not pending:
                return
            # Not `concurrent.futures.wait`, which Ctrl-C may leave with locks of the futures held;
            # then the workers could never be stopped.
            future = finished.get()
            result = None
            with contextlib.suppress(workers.died):
                result = workers.result_of(future)
            yield pending.pop(future), result
    finally:
        if pending:  # interrupted, or an error
            workers.stop()
