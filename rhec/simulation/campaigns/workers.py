"""Worker processes: on this machine by loky, elsewhere by a Dask cluster that exists already.

loky's processes speak through pipes that only they have, so there is no port that others could
reach. They need no `if __name__ == "__main__":` in the script that starts them.
"""

import concurrent.futures
import contextlib
import importlib.util
import itertools
import logging
import os
import signal
import tempfile
from concurrent.futures.process import BrokenProcessPool

from rhec.core._casadi.validation import optional

__all__ = ["map_tasks", "open_workers"]

_TASKS_PER_WORKER = 3  # running and waiting, so that no worker waits for its next task
_IDLE_S = 60.0  # after which a worker process ends, also if its parent was killed
SCHEDULER_TIMEOUT_S = 10.0
FIRST_WORKER_TIMEOUT_S = 60.0
# Each worker is one thread on one core; BLAS would start as many threads as there are cores.
_ONE_THREAD = dict(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")


def open_workers(workers, large):
    """Return a context with the workers of a campaign, or with None for this process itself.

    Args:
        workers: Number of processes on this machine, or None to choose: the cluster at
            DASK_SCHEDULER_ADDRESS; without that, one process a core for a large campaign.
        large: Whether the campaign is worth starting processes for.
    """
    if workers is None and os.environ.get("DASK_SCHEDULER_ADDRESS"):
        return _connect(os.environ["DASK_SCHEDULER_ADDRESS"])
    if workers is None and large and importlib.util.find_spec("loky"):
        workers = _count_cores()
    if workers in (None, 1):
        return contextlib.nullcontext()
    optional("loky", f"workers={workers}")
    return contextlib.nullcontext(_LocalWorkers(workers))


def _count_cores():
    """Return how many cores to use: PYTHON_CPU_COUNT, as for Python from 3.13 on, or all."""
    import loky

    wanted = os.environ.get("PYTHON_CPU_COUNT", "")
    return int(wanted) if wanted.isdecimal() and int(wanted) else loky.cpu_count()


class _LocalWorkers:
    """Processes on this machine. They stay for the next campaign until they are idle too long."""

    died = BrokenProcessPool
    _pool = None  # the one pool of this process, and its size
    _size = 0

    def __init__(self, count):
        self.count = count
        if _LocalWorkers._size != count:
            self.stop()

    def submit(self, function, task):
        """Return the Future of function(task); starts the processes if there are none."""
        import loky
        from loky.backend import resource_tracker

        # A terminal sends Ctrl-C to all processes, but only this one may end the workers. So they
        # start with the signal blocked. Starting loky's resource tracker would unblock it.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            if _LocalWorkers._pool is not None:
                with contextlib.suppress(self.died):
                    return _LocalWorkers._pool.submit(function, task)
            pool = loky.ProcessPoolExecutor(self.count, timeout=_IDLE_S, env=_ONE_THREAD)
            _LocalWorkers._pool = pool
            _LocalWorkers._size = self.count
            return pool.submit(function, task)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    @staticmethod
    def stop():
        """Kill the processes and what they run."""
        if _LocalWorkers._pool is not None:
            _LocalWorkers._pool.shutdown(kill_workers=True)
        _LocalWorkers._pool = None
        _LocalWorkers._size = 0


class _ClusterWorkers:
    """The workers of a Dask cluster."""

    def __init__(self, client):
        from distributed import KilledWorker

        self.client = client
        self.died = KilledWorker
        self.executor = client.get_executor(pure=False)

    @property
    def count(self):
        """Return the number of threads of all workers, which may come and go."""
        return max(1, sum(self.client.nthreads().values()))

    def submit(self, function, task):
        """Return the Future of function(task)."""
        return self.executor.submit(function, task)

    def stop(self):
        """Cancel what this client has handed out."""
        self.executor.shutdown(wait=False)


@contextlib.contextmanager
def _connect(address):
    """A context with the workers of the Dask cluster at an address."""
    distributed = optional("distributed", f"DASK_SCHEDULER_ADDRESS={address}")
    from dask import config

    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # its errors are raised here
    # By default Dask would use, and import from, a folder of a fixed name that all users share.
    with (
        tempfile.TemporaryDirectory(prefix="rhec-dask-") as private,
        config.set({"temporary-directory": private}),
        _client_at(address, distributed) as client,
    ):
        try:
            yield _ClusterWorkers(client)
        except (concurrent.futures.CancelledError, distributed.comm.CommClosedError):
            raise ConnectionError(f"the scheduler at {address} went away") from None
        except Exception as error:
            what = f"{type(error).__name__}: {error}"
            raise RuntimeError(f"a worker of {address} failed ({what})") from error


@contextlib.contextmanager
def _client_at(address, distributed):
    """A context with a Client that has at least one worker."""
    sentence = (
        f"DASK_SCHEDULER_ADDRESS was {address!r}; no scheduler answered in "
        f"{SCHEDULER_TIMEOUT_S:g} s"
    )
    client = None
    try:
        # A bare connection is tried first: a Client that finds no scheduler leaves threads behind.
        distributed.utils.LoopRunner().run_sync(_try_connection, address)
        client = distributed.Client(address, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)
        sentence = f"the scheduler at {address} has had no worker for {FIRST_WORKER_TIMEOUT_S:g} s"
        client.wait_for_workers(1, FIRST_WORKER_TIMEOUT_S)
    except Exception as error:  # a wrong address may be anything and raise anything
        if client:
            client.close()
        raise ConnectionError(sentence) from error
    with client:
        yield client


async def _try_connection(address):
    from distributed import Security, comm

    settings = Security().get_connection_args("client")
    await (await comm.connect(address, timeout=SCHEDULER_TIMEOUT_S, **settings)).close()


def map_tasks(workers, function, tasks, at_once=None):
    """Yield (task, function(task)) in the order in which the workers finish.

    The result is None for tasks that were handed out when a worker process died. For local workers
    these are all that were handed out: which of them the process died of is unknown.

    Args:
        workers: As `open_workers` gives them.
        function: A function of a task.
        tasks: An iterable of tasks.
        at_once: How many tasks are handed out at a time; by default three for each worker.

    Raises:
        RuntimeError: If the function raises an error.
    """
    tasks = iter(tasks)
    pending = {}
    try:
        while True:
            room = (at_once or _TASKS_PER_WORKER * workers.count) - len(pending)
            for task in itertools.islice(tasks, max(room, 0)):
                pending[workers.submit(function, task)] = task
            if not pending:
                return
            finished, _ = concurrent.futures.wait(
                pending, return_when=concurrent.futures.FIRST_COMPLETED
            )
            for future in finished:
                result = None
                with contextlib.suppress(workers.died):
                    result = future.result()
                yield pending.pop(future), result
    finally:
        if pending:  # interrupted, or an error
            workers.stop()
