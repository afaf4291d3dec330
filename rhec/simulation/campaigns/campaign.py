"""A campaign: many closed-loop runs, one row each, here or on a Dask cluster."""

import functools
import textwrap
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from rhec.core._casadi import compiled
from rhec.core._casadi.validation import Whole, checked, shown
from rhec.simulation.campaigns import store
from rhec.simulation.campaigns.side_by_side import (
    compile_lanes,
    in_parts,
    n_samples,
    run_in_lanes,
    samples_alike,
    size_of_task,
    to_compile,
)
from rhec.simulation.campaigns.workers import are_waiting, dask_client, run_on
from rhec.simulation.closed_loop import simulate
from rhec.simulation.scenario import Scenario

__all__ = ["campaign"]

# Samples that take one core longer than local workers take to start, or, once there, to be told.
_LARGE = 2_000_000
_HANDED_OUT = 200_000


if TYPE_CHECKING:
    import pandas as pd


@checked
def campaign(
    scenarios: Any,
    folder: Path | None = None,
    workers: Annotated[Whole, Field(ge=1, le=1024)] | None = None,
) -> "pd.DataFrame":
    """Run scenarios; the result is the same to the last bit wherever they run.

    Without `workers` they run on the Dask cluster at DASK_SCHEDULER_ADDRESS; without that in this
    process, if they are few or Dask is not installed, else on one worker process a core.

    Args:
        scenarios: an iterable of rhec.Scenario. Equal ones run once.
        folder: where finished runs are kept, as Parquet, so that the same call goes on from them
            after an interruption. Failed runs and rows of other code or versions are made again.
        workers: processes on this machine, 1 to 1024; 1 is this process. They stay for the next
            campaign. A script that starts them needs `if __name__ == "__main__":`.

    Returns:
        A DataFrame with one row a scenario, in the order given: its fields, its metrics
        (`Run.metrics`), and `error`: "", or in one sentence why the run failed. Metrics of a failed
        run are NaN, `all_ok` is False.

    Raises:
        ValueError: for bad arguments, in one sentence.
        ImportError: if Dask or pyarrow is asked for and not installed.
        ConnectionError: if no scheduler or no worker answers.
        RuntimeError: if workers run other code or do not start.
        KeyboardInterrupt: if interrupted; says how many runs were finished.
    """
    import pandas as pd  # here, because workers do without

    scenarios = _as_list(scenarios)
    compiler = compiled.compiler()
    rows_in = None if folder is None else store.cache_folder(folder)
    keys = []
    done = store.load_rows(rows_in) if rows_in else {}
    for scenario in scenarios:
        try:
            keys.append(store.scenario_key(scenario))
        except Exception as error:  # an estimator without a serial form: not sent, not kept
            keys.append(f"row {len(keys)}")
            done[keys[-1]] = store.failed_row(_reason(error))
    wanted = dict(zip(keys, scenarios))
    missing = {key: scenario for key, scenario in wanted.items() if key not in done}
    with _progress_bar(len(wanted), len(wanted) - len(missing)) as progress:
        try:
            for rows in _results(missing, workers):
                if compiled.compiler() != compiler:  # it failed: other code makes other rows
                    return campaign(scenarios, folder, workers)
                done |= rows
                if rows_in:
                    store.save_rows(rows_in, rows)
                progress.update(len(rows))
        except KeyboardInterrupt:
            n_done = len(done.keys() & wanted.keys())
            rest = "the same call goes on from there" if folder else "with a folder it would go on"
            message = f"interrupted after {n_done} of {len(wanted)} runs; {rest}"
            raise KeyboardInterrupt(message) from None
    columns = {
        field.name: [getattr(scenario, field.name) for scenario in scenarios]
        for field in fields(Scenario)
    }
    columns |= {name: [done[key][name] for key in keys] for name in store.failed_row("")}
    return pd.DataFrame(columns)


def _as_list(scenarios):
    if isinstance(scenarios, str) or not hasattr(scenarios, "__iter__"):
        raise ValueError(f"scenarios was {shown(scenarios)}; it should be a list of rhec.Scenario")
    scenarios = list(scenarios)
    for i, scenario in enumerate(scenarios):
        if not isinstance(scenario, Scenario):
            raise ValueError(f"scenarios[{i}] was {shown(scenario)}; it should be a rhec.Scenario")
    return scenarios


def _progress_bar(total, done):
    """Runs done and time left, shown in a terminal or a notebook if it takes over a second."""
    from tqdm.auto import tqdm

    where = dict(desc="campaign", unit="run", leave=False, delay=1, disable=None)
    return tqdm(total=total, initial=done, **where)


def _results(scenarios, workers):
    """Yield {key: row} of some of the scenarios {key: scenario} at a time, as they finish."""
    if not scenarios:
        return
    samples = sum(map(n_samples, scenarios.values()))
    alike = samples_alike(scenarios.values())
    work = functools.partial(_rows, alike=alike)
    size = size_of_task(alike)
    large = samples >= (_HANDED_OUT if are_waiting() else _LARGE)
    with dask_client(workers, large) as client:
        if client is None:
            yield from map(work, in_parts(scenarios, size))
            return
        work = functools.partial(work, expected=store.provenance())
        # First, several at a time: else workers wait for one another's.
        for _ in run_on(client, compile_lanes, to_compile(scenarios.values(), alike)):
            yield {}
        suspects = {}  # among them is a run that kills its worker
        share = samples / (4 * max(1, sum(client.nthreads().values())))
        for chunk, rows in run_on(client, work, in_parts(scenarios, min(size, share))):
            suspects |= {} if rows else chunk
            yield rows or {}
        # One task at a time, so that no run dies with another.
        alone = [{key: scenario} for key, scenario in suspects.items()]
        killed = store.failed_row("KilledWorker: every worker that ran it died")
        for chunk, rows in run_on(client, work, alone, at_once=1):
            yield rows or dict.fromkeys(chunk, killed)


def _rows(chunk, alike, expected=None):
    """{key: row} of {key: scenario}; RuntimeError if this process is not as the caller's."""
    _refuse_another(expected)
    rows = {key: metrics | dict(error="") for key, metrics in run_in_lanes(chunk, alike).items()}
    rows = {key: rows.get(key) or _run_or_error(scenario) for key, scenario in chunk.items()}
    _refuse_another(expected)  # a compiler may have failed
    return rows


def _refuse_another(expected):
    here = store.provenance() if expected else {}
    for name, there in (expected or {}).items():
        if here.get(name) != there:
            what = f"it has {name} {here.get(name)}, where the caller has {there}"
            raise RuntimeError(f"{what}; they must be the same")


def _run_or_error(scenario):
    """A run's row: its metrics and no error, or no metrics and why."""
    try:
        return simulate(scenario).metrics | dict(error="")
    except Exception as error:  # whatever one run raises, the others go on
        return store.failed_row(_reason(error))


def _reason(error):
    return f"{type(error).__name__}: {textwrap.shorten(str(error), 300)}"
