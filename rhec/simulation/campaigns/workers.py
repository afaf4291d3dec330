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
    return contextlib.nullcontext(_local_workers(workers))


def _count_cores():
    """Return how many cores to use: PYTHON_CPU_COUNT, as for Python from 3.13 on, or all."""
    import loky

    wanted = os.environ.get("PYTHON_CPU_COUNT", "")
    return int(wanted) if wanted.isdecimal() and int(wanted) else loky.cpu_count()


class _LocalWorkers:
    """Worker processes on this machine, started when the first task comes."""

    died = BrokenProcessPool

    def __init__(self, count):
        self.count = count
        self.pool = None

    def submit(self, function, task):
        """Return the Future of function(task)."""
        with _interrupts_for_this_process_alone():
            if self.pool is not None:
                with contextlib.suppress(BrokenProcessPool):  # workers died: take new ones
                    return self.pool.submit(function, task)
            import loky

            self.pool = loky.ProcessPoolExecutor(self.count, timeout=_IDLE_S, env=_ONE_THREAD)
            return self.pool.submit(function, task)

    def stop(self):
        """Kill the processes and what they run."""
        if self.pool is not None:
            self.pool.shutdown(kill_workers=True)
        self.pool = None


@contextlib.contextmanager
def _interrupts_for_this_process_alone():
    """A context in which new processes and threads start with Ctrl-C blocked.

    A terminal sends Ctrl-C to all processes, but only this one may end the workers.
    """
    from loky.backend import resource_tracker

    resource_tracker.ensure_running()  # before, since starting it would unblock the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_local = None  # the workers of this process, which stay for the next campaign


def are_running():
    """Return whether workers on this machine were started before."""
    return _local is not None and _local.pool is not None


def _local_workers(count):
    """Return so many workers on this machine: those that there are, or new ones."""
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
    # By default Dask may use, and import from, a folder of a fixed name that all users share.
    private = tempfile.TemporaryDirectory(prefix="rhec-dask-")
    with private, config.set({"temporary-directory": private.name}):
        client = _client_at(address, distributed)
        try:
            yield _ClusterWorkers(client)
        except (concurrent.futures.CancelledError, distributed.comm.CommClosedError):
            raise ConnectionError(f"the scheduler at {address} went away") from None
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise RuntimeError(f"a worker of {address} failed ({reason})") from error
        finally:
            client.close()


def _client_at(address, distributed):
    """Return a Client that has at least one worker."""
    try:
        # A bare connection is tried first: a Client that finds no scheduler leaves threads behind.
        distributed.utils.LoopRunner().run_sync(_try_connection, address)
        client = distributed.Client(address, timeout=SCHEDULER_TIMEOUT_S, set_as_default=False)
    except Exception as error:  # a wrong address may be anything and raise anything
        limit = f"{SCHEDULER_TIMEOUT_S:g} s"
        sentence = f"DASK_SCHEDULER_ADDRESS was {address!r}; no scheduler answered in {limit}"
        raise ConnectionError(sentence) from error
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
