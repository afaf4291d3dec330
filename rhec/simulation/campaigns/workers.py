"""Tasks on a Dask cluster: one that is there already, or processes on this machine."""

import contextlib
import importlib.util
import itertools
import logging
import os
import signal
from multiprocessing import resource_tracker

from rhec.core._casadi.validation import optional

__all__ = ["are_waiting", "dask_client", "local_cluster", "run_on"]

_AT_ONCE = 3  # tasks handed out for each thread of a worker, so that none waits for the next
PATIENCE_S = 10.0  # for a scheduler to answer
WORKERS_S = 60.0  # for a first worker to come


def dask_client(workers, large):
    """A context that gives a Dask client, or None where this process shall do the work itself."""
    if workers is None and os.environ.get("DASK_SCHEDULER_ADDRESS"):
        return _connected(os.environ["DASK_SCHEDULER_ADDRESS"])
    if workers is None and large and importlib.util.find_spec("distributed"):
        workers = _cores()
    return contextlib.nullcontext(None if workers in (None, 1) else local_cluster(workers))


def are_waiting():
    """Whether processes of this machine, as many as it has cores to use, are there already."""
    return bool(_clusters) and _cores() in _clusters


def _cores():
    """How many this process may use: as PYTHON_CPU_COUNT tells Python from 3.13 on, or all."""
    from dask.system import CPU_COUNT

    told = os.environ.get("PYTHON_CPU_COUNT", "")
    return int(told) if told.isdigit() else CPU_COUNT


def _connected(address):
    distributed = optional("distributed", f"DASK_SCHEDULER_ADDRESS={address}")
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it logs is raised
    sentence = f"DASK_SCHEDULER_ADDRESS was {address!r}; no scheduler answered in {PATIENCE_S:g} s"
    client = None
    try:
        # First a greeting: a Client that finds no one leaves threads behind.
        distributed.utils.LoopRunner().run_sync(_greet, address)
        client = distributed.Client(address, timeout=PATIENCE_S, set_as_default=False)
        sentence = f"the scheduler at {address} has had no worker for {WORKERS_S:g} s"
        client.wait_for_workers(1, WORKERS_S)
    except Exception as error:  # whatever may be at a wrong address
        if client:
            client.close()
        raise ConnectionError(sentence) from error
    return client


async def _greet(address):
    from distributed import Security, comm

    settings = Security().get_connection_args("client")
    await (await comm.connect(address, timeout=PATIENCE_S, **settings)).close()


_clusters = {}  # {workers: client} of the one cluster on this machine


def local_cluster(workers):
    """The client of so many processes on this machine, which stay until this process ends.

    Whoever may speak to a scheduler may run code as its owner, and anyone on this machine can reach
    a port. So all must show a certificate that is made here, kept in memory, and known to no one
    else; and nothing is served to browsers.
    """
    distributed = optional("distributed", f"workers={workers}")
    optional("cryptography", f"workers={workers}")
    from dask import config
    from tornado.ioloop import PeriodicCallback

    if workers in _clusters and _clusters[workers].status == "running":
        return _clusters[workers]
    for client in _clusters.values():
        client.close()
        client.cluster.close()
    _clusters.clear()
    # A terminal sends Ctrl-C to all processes, but ending the workers is for this one alone: the
    # signal is blocked in threads and processes started here. The tracker would unblock it.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    here = dict(host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs="CRITICAL")
    here["security"] = distributed.Security.temporary()
    scheduler = dict(dashboard=False, allowed_failures=1)
    pages = {f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker", "nanny")}
    options = {
        # Not forked: a notebook's kernel has threads, and a fork may catch one inside a lock.
        "distributed.worker.multiprocessing-method": "spawn",
        # Without Dask's word to malloc, which has each array's memory made anew: a third slower.
        "distributed.nanny.pre-spawn-environ": dict(OMP_NUM_THREADS=1, OPENBLAS_NUM_THREADS=1),
        "distributed.worker.profile.enabled": False,  # looks at each stack every 10 ms: a sixth
    }
    try:
        with config.set(options | pages):
            cluster = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, scheduler_kwargs=scheduler, **here
            )
        # Dask gives up a worker that takes long to come back, or is killed again meanwhile.
        fill_up = PeriodicCallback(lambda: cluster.scale(workers), 5000)
        cluster.loop.add_callback(fill_up.start)
        _clusters[workers] = distributed.Client(cluster, set_as_default=False)
    except RuntimeError as error:
        needs = "a script that starts workers needs `if __name__ == '__main__':`"
        raise RuntimeError(f"the workers did not start; {needs}") from error
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return _clusters[workers]


def run_on(client, function, tasks, at_once=None):
    """Yield (task, function(task)) as workers finish; None if every worker that had the task died.

    At most `at_once` tasks are handed out, by default some for each thread.
    """
    from distributed import CancelledError, KilledWorker, as_completed
    from distributed.comm import CommClosedError

    tasks = iter(tasks)
    pending = {}
    address = client.scheduler.address
    finished = as_completed(raise_errors=False, loop=client.loop)
    try:
        while True:
            room = (at_once or _AT_ONCE * sum(client.nthreads().values()) or 1) - len(pending)
            for task in itertools.islice(tasks, max(room, 0)):
                future = client.submit(function, task, pure=False)
                pending[future] = task
                finished.add(future)
            if not pending:
                return
            future = next(finished)
            result = None
            with contextlib.suppress(KilledWorker):
                result = future.result()
            yield pending.pop(future), result
    except (CancelledError, CommClosedError):
        raise ConnectionError(f"the scheduler at {address} went away") from None
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise RuntimeError(f"a worker of {address} failed ({what})") from error
    finally:
        client.cancel(list(pending), force=True)
