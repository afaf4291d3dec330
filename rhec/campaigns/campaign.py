"""Many runs: in this process, on all cores of this machine, or on a Dask cluster; kept on disk, so
that what was interrupted goes on.

python -m rhec.campaigns.campaign -p estimator rhe ekf -p q [1,1,1] [1,1,0] --seeds 250
"""

import argparse
import asyncio
import contextlib
import functools
import hashlib
import importlib.metadata
import itertools
import json
import os
import platform
import queue
import reprlib
import signal
import sys
import textwrap
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, is_dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Annotated, Any

import casadi as ca
import numpy as np
from pydantic import Field

from rhec import paper, simulation
from rhec._casadi import compiled
from rhec._casadi.validation import Whole, checked
from rhec.model import terrain
from rhec.scenario import Scenario
from rhec.simulation import simulate

# closed-loop samples a worker takes at a time: about a second, which is also what an interruption
# loses
CHUNK = 40_000
MANY = 500_000  # samples that take one core longer than local workers take to start
AT_ONCE = 3  # chunks handed out for each worker's thread, so that none waits for the next
PATIENCE_S = 10.0  # for a scheduler to answer
WORKERS_S = 60.0  # for a worker to come where there is none, or to replace the last


@checked
def campaign(
    scenarios: Any,
    folder: Path | None = None,
    workers: Annotated[Whole, Field(ge=1, le=1024)] | None = None,
):
    """One row a scenario, in the order given, as a DataFrame: its fields, its metrics, and `error`.
    Bit for bit the same wherever it runs.

    error: "" or why the run failed, in one sentence; its metrics are NaN then, `all_ok` is False,
    and the others go on. folder: where finished runs are kept, as Parquet; what is found there from
    the same code and versions is not run again, so that an interrupted campaign goes on when called
    again, and changed code or parameters never meet old rows. What failed is tried again. workers:
    processes of a cluster on this machine, which stays for the next campaign. Unless told, the
    campaign runs on the cluster at DASK_SCHEDULER_ADDRESS; without one, in this process if it is
    small, else on one worker a core. A script that starts workers needs `if __name__ ==
    "__main__":`. Errors: ValueError for bad arguments; ConnectionError if no scheduler or no worker
    answers; RuntimeError if workers run other code.
    """
    import pandas as pd  # as in `closed_loop`

    scenarios = listed(scenarios)
    folder = None if folder is None else prepared(folder)
    keys, done = [], kept(folder) if folder else {}
    for scenario in scenarios:
        try:
            keys.append(key(scenario))
        except (
            Exception
        ) as error:  # an estimator that cannot be written down can neither be sent nor recognised
            keys.append(f"row {len(keys)}")
            done[keys[-1]] = failed(error)
    wanted = dict(zip(keys, scenarios))
    todo = {name: scenario for name, scenario in wanted.items() if name not in done}
    with bar(len(wanted), len(wanted) - len(todo)) as progress:
        try:
            for rows in finished(todo, workers):
                done |= rows
                if folder:
                    keep(
                        folder,
                        {name: row for name, row in rows.items() if not row["error"]},
                        wanted,
                    )
                progress.update(len(rows))
        except KeyboardInterrupt:
            rest = (
                "the same call goes on from there"
                if folder
                else "campaign(…, folder=…) would have kept them"
            )
            raise KeyboardInterrupt(
                f"interrupted after {len(done.keys() & wanted.keys())} of {len(wanted)} runs; {rest}"
            ) from None
    columns = [*(field.name for field in fields(Scenario)), *no_metrics(), "error"]
    return pd.DataFrame(
        [values(scenario) | done[name] for scenario, name in zip(scenarios, keys)], columns=columns
    )


def listed(scenarios):
    """The scenarios as a list, each of them one."""
    if isinstance(scenarios, str) or not hasattr(scenarios, "__iter__"):
        raise ValueError(
            f"scenarios was {reprlib.repr(scenarios)}; it should be a list of rhec.Scenario"
        )
    scenarios = list(scenarios)
    for place, scenario in enumerate(scenarios):
        if not isinstance(scenario, Scenario):
            raise ValueError(
                f"scenarios[{place}] was {reprlib.repr(scenario)}; it should be a rhec.Scenario"
            )
    return scenarios


def values(scenario):
    return {field.name: getattr(scenario, field.name) for field in fields(scenario)}


def bar(total, done):
    """Runs done and time left, in a terminal or a notebook; nothing where nobody looks, and nothing
    for what takes a second.
    """
    from tqdm.auto import tqdm

    return tqdm(
        total=total, initial=done, desc="campaign", unit="run", leave=False, delay=1, disable=None
    )


# One run


def attempt(scenario):
    """A run's metrics and no error; or no metrics, and why. Whatever a run raises, the campaign
    goes on.
    """
    try:
        return simulate(scenario).metrics | dict(error="")
    except Exception as error:
        return failed(error)


def failed(error):
    return no_metrics() | dict(error=f"{type(error).__name__}: {textwrap.shorten(str(error), 300)}")


@functools.cache
def no_metrics():
    """The metrics of a run that failed: each NaN, or False."""
    log = dict.fromkeys(
        (*simulation.COLUMNS, "t_s", "error_m", "error_true_m"), np.zeros(1)
    ) | dict.fromkeys(("ok", "on_straight"), np.zeros(1, bool))
    return {
        name: False if isinstance(value, bool) else np.nan
        for name, value in simulation.metrics(log, np.zeros((1, 3))).items()
    }


def made_by():
    """What decides a run's numbers beside its scenario. Rows that were made by different ones are
    not mixed.
    """
    versions = {name: importlib.metadata.version(name) for name in ("casadi", "numpy", "scipy")}
    return versions | {
        "source of rhec": compiled.source_digest()[:16],
        "data of rhec": file_digest(terrain.STANDARD_FIELDS),
        "C compiler": bool(compiled.compiler()),
        "machine": platform.machine(),
    }


@functools.cache
def file_digest(file):
    return hashlib.sha256(file.read_bytes()).hexdigest()[:16]


# Where it runs


def finished(scenarios, workers):
    """Rows {key: metrics and error} of the scenarios {key: scenario}, a chunk at a time, as they
    get done.
    """
    if not scenarios:
        return
    samples = sum(map(n_samples, scenarios.values()))
    with cluster(workers, samples) as client:
        if client is None:
            yield from (run(chunk, None)[1] for chunk in chunks(scenarios, CHUNK))
            return
        size = min(CHUNK, samples / (4 * (sum(client.nthreads().values()) or 1)))
        suspects = {}
        for chunk, rows in on(client, chunks(scenarios, size)):
            if rows is None:
                suspects |= chunk
            else:
                yield rows
        # each alone, so that nothing dies of its neighbour
        for chunk, rows in on(
            client, ({name: scenario} for name, scenario in suspects.items()), alone=True
        ):
            yield rows or {
                name: no_metrics() | dict(error="KilledWorker: every worker that ran it died")
                for name in chunk
            }


def n_samples(scenario):
    return round(scenario.duration_s / paper.DT_S)


def chunks(scenarios, size):
    """The scenarios in parts of about `size` closed-loop samples."""
    chunk, samples = {}, 0
    for name, scenario in scenarios.items():
        chunk[name], samples = scenario, samples + n_samples(scenario)
        if samples >= size:
            yield chunk
            chunk, samples = {}, 0
    if chunk:
        yield chunk


def run(scenarios, expected):
    """What a worker does: (what it is made by, rows of the scenarios). It does nothing if that is
    not as expected.
    """
    found = made_by() if expected else None
    return found, {
        name: attempt(scenario) for name, scenario in scenarios.items()
    } if found == expected else {}


@contextlib.contextmanager
def cluster(workers, samples):
    """A Dask client for this much work, or None where this process does it as fast."""
    import dask.config
    import dask.system

    address = dask.config.get("scheduler-address", None)
    if workers is None and address:
        from distributed import Client

        try:
            with (
                ThreadPoolExecutor(1) as thread
                # a notebook has an event loop of its own, and a Client that finds no one leaves threads
                # behind
            ):
                thread.submit(asyncio.run, greet(address)).result()
            client = Client(address, timeout=PATIENCE_S, set_as_default=False)
        except Exception as error:  # whatever may be at a wrong address
            raise ConnectionError(
                f"DASK_SCHEDULER_ADDRESS was {address!r}; no Dask scheduler answered there within {PATIENCE_S:g} s"
            ) from error
        with client:
            yield client
    elif workers is None and (samples < MANY or dask.system.CPU_COUNT < 2):
        yield None
    else:
        yield local(workers or dask.system.CPU_COUNT)


async def greet(address):
    """Connect to a scheduler and leave."""
    from distributed.comm import connect
    from distributed.security import Security

    comm = await connect(address, timeout=PATIENCE_S, **Security().get_connection_args("client"))
    await comm.close()


STARTED = {}  # {workers: client} of the cluster on this machine, once there is one


def local(workers):
    """The client of a cluster of processes on this machine; it is there for the next campaign until
    Dask ends it with this process.
    """
    import dask
    from distributed import Client, LocalCluster

    if workers not in STARTED or STARTED[workers].status != "running":
        for client in STARTED.values():
            client.close()
            client.cluster.close()
        STARTED.clear()
        # it listens to Dask on this machine alone, and has no pages to look at
        settings = {
            "distributed.scheduler.http.routes": [],
            "distributed.worker.http.routes": [],
            # not forked: a notebook's kernel has threads, which a fork may leave in the middle of
            # something
            "distributed.worker.multiprocessing-method": "spawn",
        }
        with dask.config.set(settings), no_interrupt():
            try:
                started = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    silence_logs="CRITICAL",
                    scheduler_kwargs=dict(dashboard=False, allowed_failures=1),
                )
            except RuntimeError as error:
                raise RuntimeError(
                    "the workers did not start; a script that starts workers needs `if __name__ == '__main__':`"
                ) from error
            STARTED[workers] = Client(started, set_as_default=False)
    return STARTED[workers]


@contextlib.contextmanager
def no_interrupt():
    """Ctrl-C waits. It never reaches threads and processes that are started here, though a terminal
    sends it to all: ending them is for their parent.
    """
    # else the first process starts it, and unblocks the signal doing so
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def on(client, chunks, alone=False):
    """(chunk, its rows) as workers get them done; rows are None if every worker that had the chunk
    died. What dies with one worker is redone.
    """
    from distributed.scheduler import KilledWorker

    expected, pending, ready, chunks = made_by(), {}, queue.SimpleQueue(), iter(chunks)

    def hand_out(chunk):
        future = client.submit(run, chunk, expected, pure=False)
        pending[future] = chunk
        future.add_done_callback(ready.put)

    try:
        while True:
            room = 1 if alone else AT_ONCE * (sum(client.nthreads().values()) or 1)
            for chunk in itertools.islice(chunks, max(room - len(pending), 0)):
                hand_out(chunk)
            if not pending:
                return
            future = first(client, ready)
            chunk = pending.pop(future)
            if future.status == "cancelled":
                raise ConnectionError(f"the scheduler at {client.scheduler.address} went away")
            error = future.exception(timeout=PATIENCE_S)
            if isinstance(error, KilledWorker):
                yield chunk, None
            elif error:
                raise RuntimeError(
                    f"a worker of {client.scheduler.address} could not run rhec as it is here ({type(error).__name__}: {error})"
                )
            else:
                try:
                    found, rows = future.result(timeout=PATIENCE_S)
                except TimeoutError:  # its worker died with it
                    hand_out(chunk)
                    continue
                for name in expected:
                    if found.get(name) != expected[name]:
                        raise RuntimeError(
                            f"a worker of {client.scheduler.address} has {name} {found.get(name)}, where this process has "
                            f"{expected[name]}; they must be the same"
                        )
                yield chunk, rows
    finally:
        client.cancel(list(pending), force=True)


def first(client, ready):
    """The next finished future, for as long as there is a worker to wait for."""
    alone_since = time.monotonic()
    while True:
        with contextlib.suppress(queue.Empty):
            return ready.get(timeout=1)
        if client.nthreads():
            alone_since = time.monotonic()
        elif time.monotonic() - alone_since > WORKERS_S:
            raise ConnectionError(
                f"the scheduler at {client.scheduler.address} has had no worker for {WORKERS_S:g} s"
            )


# What is kept


def key(scenario):
    """A name for the scenario, down to the last bit of its terrain."""
    return hashlib.sha256(written(scenario).encode()).hexdigest()[:32]


def written(value):
    """A value as text that no other value has."""
    if isinstance(value, ca.Function):
        return value.serialize()
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if is_dataclass(value):
        return repr({name: written(each) for name, each in values(value).items()})
    return repr(value)


def prepared(folder):
    """The folder's part for this code and these versions."""
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder was {str(folder)!r}; that is a file, it should be a folder")
    folder = folder / hashlib.sha256(json.dumps(made_by()).encode()).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@functools.cache
def schema():
    import pyarrow as pa

    metrics = {
        name: pa.bool_() if value is False else pa.float64() for name, value in no_metrics().items()
    }
    return pa.schema(dict(key=pa.string(), scenario=pa.string()) | metrics)


def keep(folder, rows, scenarios):
    """Write rows as one more file, which is there as a whole or not at all."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not rows:
        return
    table = pa.Table.from_pylist(
        [dict(key=name, scenario=repr(scenarios[name])) | row for name, row in rows.items()],
        schema(),
    )
    name = hashlib.sha256("".join(rows).encode()).hexdigest()[:32]
    unfinished = folder / f"{name}.{os.getpid()}.unfinished"
    pq.write_table(table, unfinished, write_page_checksum=True)
    os.replace(unfinished, folder / f"{name}.parquet")


def kept(folder):
    """Rows {key: metrics and no error} of all files in the folder that can be read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names, rows = [name for name in schema().names if name != "scenario"], {}
    for file in sorted(folder.glob("*.parquet")):
        try:
            with pq.ParquetFile(file, page_checksum_verification=True) as parquet:
                table = (
                    parquet.read(names)
                    .select(names)
                    .cast(pa.schema([schema().field(name) for name in names]))
                )
        except (pa.ArrowException, OSError, KeyError, ValueError) as error:
            warnings.warn(
                f"{file} cannot be read ({type(error).__name__}), so its runs are done again",
                stacklevel=3,
            )
            continue
        rows |= {row.pop("key"): row | dict(error="") for row in table.to_pylist()}
    return rows


# From the command line

SHOWN = ("settling_time_s", "mean_error_m", "mean_error_true_m", "violations", "violations_true")


def summary(table, by):
    """Mean and 95 % interval (percentile bootstrap) over the runs with the same values of the
    columns `by`, as text; n counts the runs without error.
    """
    import pandas as pd
    from scipy.stats import bootstrap

    def estimate(sample):
        sample = sample.dropna().to_numpy()
        if len(sample) < 2:
            return "-"
        interval = bootstrap(
            (sample,), np.mean, method="percentile", n_resamples=2000, rng=0
        ).confidence_interval
        return f"{sample.mean():.4g} ({interval.low:.4g} to {interval.high:.4g})"

    groups = table.groupby(by, sort=False, dropna=False) if by else [((), table)]
    return pd.DataFrame(
        [
            dict(zip(by, each))
            | {name: estimate(rows[name]) for name in SHOWN}
            | dict(n=int((rows["error"] == "").sum()))
            for each, rows in groups
        ]
    )


def main():
    parser = argparse.ArgumentParser(
        prog="python -m rhec.campaigns.campaign",
        description="Run every combination of some parameters on many seeds. "
        "What is interrupted goes on when it is called again.",
    )
    parser.add_argument(
        "-p",
        nargs="+",
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="a parameter of rhec.Scenario and its values: numbers, words or lists such as [1,1,0]",
    )
    parser.add_argument("--seeds", type=int, default=250, help="how many, from 0 on (250)")
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("build/campaign"),
        help="where rows are kept, and the table campaign.parquet (build/campaign)",
    )
    args = parser.parse_args()

    vary = {name: [value(text) for text in texts] for name, *texts in args.p} or dict(
        estimator=["rhe", "ekf"], process_noise=["printed", "calibrated"]
    )
    vary = vary if "seed" in vary else vary | dict(seed=range(args.seeds))
    try:
        table = campaign(
            [Scenario(**dict(zip(vary, chosen))) for chosen in itertools.product(*vary.values())],
            args.folder,
        )
    except (ValueError, ConnectionError, RuntimeError) as error:
        parser.exit(2 if isinstance(error, ValueError) else 1, f"{error}\n")
    except KeyboardInterrupt as error:
        parser.exit(130, f"{error}\n")
    failures = table.loc[table["error"] != "", "error"]
    if len(table):
        print(summary(table, [name for name in vary if name != "seed"]).to_string(index=False))
    table.to_parquet(args.folder / "campaign.parquet")
    print(
        f"{len(table)} runs, {len(failures)} failed"
        + (f", the first by {failures.iloc[0]}" if len(failures) else "")
        + f"; all of them are in {args.folder / 'campaign.parquet'}"
    )


def value(text):
    try:
        parsed = json.loads(text)
    except ValueError:
        return text
    return tuple(parsed) if isinstance(parsed, list) else parsed


if __name__ == "__main__":
    from rhec.campaigns.campaign import main  # workers import this module by its name

    sys.exit(main())
