"""A campaign: many closed-loop runs, one row each, on this machine or on a Dask cluster."""

import contextlib
import functools
import textwrap
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from rhec.core._casadi import compiled
from rhec.core._casadi.validation import Whole, checked
from rhec.simulation.campaigns import store
from rhec.simulation.campaigns.batch import (
    compile_lanes,
    count_samples,
    mean_samples_per_structure,
    one_per_structure,
    run_in_lanes,
    samples_per_task,
    split_into_tasks,
)
from rhec.simulation.campaigns.workers import are_running, map_tasks, open_workers
from rhec.simulation.closed_loop import simulate
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import as_list

if TYPE_CHECKING:
    import pandas as pd

# Samples that take one core longer than worker processes take to start, or to get work if they run.
_WORTH_STARTING = 1_000_000
_WORTH_SPREADING = 200_000
# A share of the campaign for each worker and this number, so that all end at about the same time.
_TASKS_PER_WORKER = 4


@checked
def campaign(
    scenarios: Any,
    folder: Path | None = None,
    workers: Annotated[Whole, Field(ge=1, le=1024)] | None = None,
) -> "pd.DataFrame":
    """Run scenarios; the result is the same to the last bit wherever they run.

    Without `workers`, the runs are spread over the Dask cluster at DASK_SCHEDULER_ADDRESS. If that
    is not set, a small campaign runs in this process, a large one on one worker process a core.

    Args:
        scenarios: An iterable of rhec.Scenario. Equal scenarios run once.
        folder: Where finished runs are kept, as Parquet, so that the same call continues after an
            interruption. Failed runs, and rows of other code or other versions, run again.
        workers: Number of processes on this machine, 1 to 1024; 1 is this process.

    Returns:
        A DataFrame with one row for each scenario, in the order given: its fields, its metrics
        (`Run.metrics`), and `error`: "", or the reason in one sentence if the run failed. The
        metrics of a failed run are NaN; its `all_ok` is False.

    Raises:
        ValueError: If an argument is invalid.
        ImportError: If loky or pyarrow is needed and not installed.
        ConnectionError: If no scheduler or no worker answers.
        RuntimeError: If workers run other code.
        KeyboardInterrupt: If interrupted; the message says how many runs were finished.
    """
    import pandas as pd  # here, because workers do without

    scenarios = as_list(scenarios, "scenarios")
    compiler = compiled.compiler()
    rows_folder = None if folder is None else store.open_folder(folder)
    rows = store.load_rows(rows_folder) if rows_folder else {}
    keys, unusable = _keys_of(scenarios)
    rows |= unusable
    wanted = dict(zip(keys, scenarios))
    missing = {key: scenario for key, scenario in wanted.items() if key not in rows}
    with (
        _progress_bar(len(wanted), len(wanted) - len(missing)) as progress,
        contextlib.closing(_run_all(missing, workers)) as results,
    ):
        try:
            for new_rows in results:
                if compiled.compiler() != compiler:
                    # The compiler failed. Without it, rows differ in their last bits: start again.
                    return campaign(scenarios, folder, workers)
                rows |= new_rows
                if rows_folder:
                    store.save_rows(rows_folder, new_rows)
                progress.update(len(new_rows))
        except KeyboardInterrupt:
            raise KeyboardInterrupt(_interrupted(rows, wanted, folder)) from None
    columns = {
        field.name: [getattr(scenario, field.name) for scenario in scenarios]
        for field in fields(Scenario)
    }
    columns |= {name: [rows[key][name] for key in keys] for name in store.failed_row("")}
    return pd.DataFrame(columns)


def _keys_of(scenarios):
    """Return the keys of scenarios, and {key: row} of those that cannot be run at all."""
    keys = []
    unusable = {}
    for scenario in scenarios:
        try:
            keys.append(store.scenario_key(scenario))
        except Exception as error:  # an estimator that cannot be serialised has no key
            keys.append(f"row {len(keys)}")
            unusable[keys[-1]] = store.failed_row(_reason(error))
    return keys, unusable


def _interrupted(rows, wanted, folder):
    """Return the sentence of an interrupted campaign."""
    n_done = len(rows.keys() & wanted.keys())
    rest = "the same call goes on from there" if folder else "with a folder it would go on"
    return f"interrupted after {n_done} of {len(wanted)} runs; {rest}"


def _progress_bar(total, done):
    """Return a bar of runs done and time left, shown on a screen after the first second."""
    from tqdm.auto import tqdm

    options = dict(desc="campaign", unit="run", leave=False, delay=1, disable=None)
    return tqdm(total=total, initial=done, **options)


def _run_all(scenarios, workers):
    """Yield {key: row} of some of the scenarios {key: scenario} at a time, as they finish."""
    if not scenarios:
        return
    samples = sum(map(count_samples, scenarios.values()))
    mean_samples = mean_samples_per_structure(scenarios.values())
    size = samples_per_task(mean_samples)
    large = samples >= (_WORTH_SPREADING if are_running() else _WORTH_STARTING)
    with open_workers(workers, large) as pool:
        if pool is None:
            run_here = functools.partial(_run_task, mean_samples=mean_samples)
            yield from map(run_here, split_into_tasks(scenarios, size))
        else:
            size = min(size, samples / (_TASKS_PER_WORKER * pool.count))
            yield from _run_on_workers(pool, scenarios, mean_samples, size)


def _run_on_workers(pool, scenarios, mean_samples, size):
    """Yield {key: row} from workers, some of which may die.

    Tasks that were handed out when a worker died run again, one at a time. What kills its worker
    again is taken apart, so that a run that kills its worker takes no other run with it.
    """
    run_task = functools.partial(_run_task, mean_samples=mean_samples, expected=store.provenance())
    # Lanes are compiled first, several at a time: else each worker waits for those of the others.
    for _ in map_tasks(pool, compile_lanes, one_per_structure(scenarios.values(), mean_samples)):
        yield {}  # lets the caller look at the compiler
    suspects = []
    for task, rows in map_tasks(pool, run_task, split_into_tasks(scenarios, size)):
        if rows is None:
            suspects.append(task)
        else:
            yield rows
    single = []
    for task, rows in map_tasks(pool, run_task, suspects, at_once=1):
        if rows is None:
            single += [{key: scenario} for key, scenario in task.items()]
        else:
            yield rows
    killed = store.failed_row("KilledWorker: every worker that ran it died")
    for task, rows in map_tasks(pool, run_task, single, at_once=1):
        yield dict.fromkeys(task, killed) if rows is None else rows


def _run_task(scenarios, mean_samples, expected=None):
    """Return {key: row} of {key: scenario}.

    Args:
        scenarios: {key: scenario} of one task.
        mean_samples: `mean_samples_per_structure` of the campaign.
        expected: `store.provenance` of the caller, if that is another process.

    Raises:
        RuntimeError: If this process would make other rows than the caller.
    """
    _check_provenance(expected)
    in_lanes = run_in_lanes(scenarios, mean_samples)
    rows = {}
    for key, scenario in scenarios.items():
        rows[key] = in_lanes[key] | dict(error="") if key in in_lanes else _run_alone(scenario)
    _check_provenance(expected)  # again, because the compiler may have failed on the way
    return rows


def _check_provenance(expected):
    """Raise RuntimeError where this process differs from the caller in what decides the rows."""
    if not expected:
        return
    here = store.provenance()
    for name, value in expected.items():
        if here.get(name) != value:
            raise RuntimeError(
                f"the worker has {name} {here.get(name)}, where the caller has {value}; "
                "they must be the same"
            )


def _run_alone(scenario):
    """Return a run's row: its metrics and no error, or no metrics and the reason."""
    try:
        return simulate(scenario).metrics | dict(error="")
    except Exception as error:  # one failing run must not stop the others
        return store.failed_row(_reason(error))


def _reason(error):
    return f"{type(error).__name__}: {textwrap.shorten(str(error), 300)}"
