"""A campaign: a table of many closed-loop runs, in this process or in worker processes."""

import collections
import contextlib
import functools
import os
import textwrap
import threading
from concurrent.futures import Executor
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, GetPydanticSchema, WrapValidator

from rhec.core._casadi import compiled
from rhec.core._casadi.validation import Whole, checked, refuse
from rhec.simulation.campaigns import store
from rhec.simulation.campaigns.batch import Plan, compile_lanes, run_in_lanes
from rhec.simulation.campaigns.workers import get_workers, is_worth_spreading, map_tasks
from rhec.simulation.metrics import METRICS
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import as_list, simulate

if TYPE_CHECKING:
    import pandas as pd

# With at least this many tasks per worker, all workers finish at about the same time.
_TASKS_PER_WORKER = 4
# A task whose worker died is divided into this number of parts before it runs again.
_PARTS_OF_A_LOST_TASK = 8
# A run has failed if so many workers died while they ran it alone.
_DEATHS_OF_A_RUN = 3
# So often a worker may die while it starts, before the deaths count as those of the run.
_STARTS_OF_A_WORKER = 20
_SHOWN_AFTER_S = 2.0  # a campaign that takes longer shows its progress

# An Executor passes; all else must be a count. As a union, it would be refused in other words.
_Count = Annotated[Whole, Field(ge=1, le=1024)]
_CountOrExecutor = Annotated[
    _Count,
    WrapValidator(lambda value, check: value if isinstance(value, Executor) else check(value)),
]
_Workers = Annotated[
    Executor | int, GetPydanticSchema(lambda _, schema_of: schema_of(_CountOrExecutor))
]


@checked
def campaign(
    scenarios: Any,
    folder: Path | None = None,
    workers: _Workers | None = None,
    readings: Any = None,
) -> "pd.DataFrame":
    """Run scenarios and return a table with one row per run.

    The numbers do not depend, to the last bit, on where the scenarios run. Without `workers`, a
    small campaign runs in this process, a large one in one worker process per core
    (PYTHON_CPU_COUNT sets another number), where loky is installed. A worker that is killed loses
    no finished run; a run has failed if three workers died that ran nothing else. A terminal or a
    notebook shows a progress bar after two seconds.

    An Executor of several machines, such as one of Dask or MPI, computes the same rows; how to
    start one is in docs/campaigns.md.

    Args:
        scenarios: An iterable of rhec.Scenario. Equal scenarios run once.
        folder: Folder of Parquet files with finished runs. With it, the same call continues an
            interrupted campaign. Failed runs, and those of other code, versions or machines, run
            again.
        workers: Number of processes, 1 to 1024; 1 is this process. Or a
            concurrent.futures.Executor, which stays yours: it is neither started nor ended here.
        readings: {name: function of a rhec.Run that returns a number}, which become columns, for
            what the metrics do not report. Other processes must be able to import the functions. A
            folder keeps no readings.

    Returns:
        A DataFrame with one row for each scenario, in their order: the parameters in which the
        scenarios differ, the metrics (`Run.metrics`), the readings, and `error`, which is "" or the
        reason of a failure. The metrics of a failed run are NaN; its `solver_ok` is False. The
        parameters that are the same in all scenarios are in the dict `attrs` of the table.

    Raises:
        ValueError: If an argument is invalid.
        ImportError: If loky or pyarrow is needed and not installed.
        RuntimeError: If a worker has another processor, compiler, code or packages than this
            process, so that its numbers may differ; or if an Executor starts no other worker in
            place of one that died.
        KeyboardInterrupt: If interrupted; the message has the number of finished runs.
    """
    import pandas as pd  # imported here, because workers do not need it

    scenarios = as_list(scenarios, "scenarios")
    readings = _checked_readings(readings, folder)
    rows, places = _driven(scenarios, folder, workers, readings)
    varied, constant = _varied_and_constant(scenarios)
    table = pd.DataFrame(varied | rows.take(places), copy=False)
    table.attrs = constant
    return table


def _checked_readings(readings, folder):
    """The readings as a dict; what is none is refused."""
    if readings is None:
        return {}
    if not isinstance(readings, dict) or not all(map(callable, readings.values())):
        refuse("readings was", readings, "it should be a dict of names to functions of a Run")
    for name in readings:
        if name in METRICS or name in Scenario.__dataclass_fields__ or name == "error":
            refuse("a name in readings was", name, "the table has that column without it")
    if folder is not None and readings:
        expected = "with readings it should be None, since a folder keeps metrics alone"
        raise ValueError(f"folder was {str(folder)!r}; {expected}")
    return readings


def _driven(scenarios, folder, workers, readings):
    """Return the Rows of all scenarios, and their places in these.

    What only the runs need, such as the keys, ends with this function: of a long campaign it would
    take as much memory as the table.
    """
    compiler = compiled.compiler()
    rows_folder = None if folder is None else store.open_folder(folder)
    rows = store.Rows(readings)
    killed = store.failed_row("BrokenProcessPool: every worker that ran it died")
    run_task = functools.partial(_run_task, readings=readings)
    keys = [*map(store.scenario_key, scenarios)]
    if rows_folder:
        for kept in store.load_rows(rows_folder, {*keys}):
            rows.add(kept)
    total = len({*keys})
    missing = {key: scenario for key, scenario in zip(keys, scenarios) if key not in rows}
    with (
        _progress_bar(total, total - len(missing)) as progress,
        contextlib.closing(run_all(missing, workers, run_task)) as results,
    ):
        try:
            for new_rows in results:
                if compiled.compiler() != compiler:
                    # The compiler failed. Uncompiled rows differ in the last bits, so start again.
                    return _driven(scenarios, folder, workers, readings)
                new_rows = {key: row or killed for key, row in new_rows.items()}
                rows.add(new_rows)
                if rows_folder:
                    store.save_rows(rows_folder, new_rows)
                progress.update(len(new_rows))
        except KeyboardInterrupt:
            n_done = total - sum(key not in rows for key in missing)
            rest = "the same call continues" if folder else "a folder would let it continue"
            raise KeyboardInterrupt(
                f"interrupted after {n_done} of {total} runs; {rest} from there"
            ) from None
    return rows, rows.places(keys)


def _varied_and_constant(scenarios):
    """Return ({parameter: values} of what varies or is an object, {parameter: value} of others)."""
    varied = {}
    constant = {}
    for field in fields(Scenario):
        values = [getattr(scenario, field.name) for scenario in scenarios]
        if _are_equal(values):
            constant[field.name] = values[0]
        elif values:
            varied[field.name] = values
    return varied, constant


def _are_equal(values):
    """Return whether these are all the same number, text, tuple or None; False if there is none.

    pandas copies constants deeply in each operation on a table, so objects are none.
    """
    if not values or type(values[0]) not in store.PLAIN:
        return False
    first = values[0]
    text = repr(first)
    return all(value is first or repr(value) == text for value in values)


@contextlib.contextmanager
def _progress_bar(total, done):
    """A progress bar of runs, which a terminal or a notebook shows after two seconds."""
    from tqdm.auto import tqdm

    # None: disabled unless it is a terminal or a notebook in which somebody waits.
    disabled = True if os.environ.get("RHEC_UNATTENDED") else None
    options = dict(desc="campaign", unit="run", leave=False, delay=_SHOWN_AFTER_S, disable=disabled)
    with tqdm(total=total, initial=done, **options) as bar:
        # By itself a bar appears only when the first runs have ended.
        timer = threading.Timer(_SHOWN_AFTER_S, bar.refresh)
        if not bar.disable:
            timer.start()
        try:
            yield bar
        finally:
            timer.cancel()


def run_all(scenarios, workers, run_task):
    """Yield {key: result} for parts of {key: scenario} as they finish, on workers that may die.

    Tasks that were pending when a worker died run again in smaller parts, at first as many at a
    time as before, then alone, until the parts are single runs. Thus a run that kills its worker
    is found, and work that others kill again and again is done in the end.

    Args:
        scenarios: {key: scenario}.
        workers: That of `campaign`.
        run_task: Function of a part of the scenarios that returns {key: result}, and that other
            processes can import.

    Yields:
        {key: result}, which may be empty; the result of a run that kills its workers is None.
    """
    if not scenarios:
        return
    plan = Plan(scenarios)
    pool = get_workers(workers, is_worth_spreading(plan.samples))
    # Lanes are compiled first, in parallel; otherwise workers would wait for one another.
    for _ in map_tasks(pool, compile_lanes, plan.worth_lanes()):
        yield {}  # lets the caller check the compiler
    tasks = plan.tasks(_TASKS_PER_WORKER * pool.count if pool else 1)
    for _ in range(2):
        lost = yield from _finished(map_tasks(pool, run_task, tasks))
        tasks = [part for task in lost for part in _parts(task)]
    deaths = collections.Counter()  # of workers that ran this key and nothing else
    while tasks:
        lost = yield from _finished(_one_by_one(pool, run_task, tasks))
        deaths.update(key for task in lost if len(task) == 1 for key in task)
        lethal = {key for key, count in deaths.items() if count == _DEATHS_OF_A_RUN}
        yield dict.fromkeys(lethal)
        tasks = [part for task in lost for part in _parts(task) if not lethal & part.keys()]


def _finished(results):
    """Yield the rows of (task, rows); return the tasks without rows, whose worker died."""
    lost = []
    for task, rows in results:
        if rows is None:
            lost.append(task)
        else:
            yield rows
    return lost


def _parts(task):
    """Return {key: scenario} divided into at most `_PARTS_OF_A_LOST_TASK` parts."""
    items = list(task.items())
    size = -(-len(items) // _PARTS_OF_A_LOST_TASK)
    return [dict(items[start : start + size]) for start in range(0, len(items), size)]


def _one_by_one(pool, function, tasks):
    """Yield (task, function(task) or None) like `map_tasks`, one task at a time.

    Before each task, a worker must have started and answered. Otherwise a worker that is killed
    while it starts would count as killed by the task.

    Args:
        pool: The workers.
        function: A function of a task.
        tasks: The tasks.
    """
    for task in tasks:
        for _ in range(_STARTS_OF_A_WORKER):
            if all(answer for _, answer in map_tasks(pool, str, ["ready"])):
                break
        yield from map_tasks(pool, function, [task])


def _run_task(scenarios, readings):
    """Return {key: row} of {key: scenario}."""
    row_of = functools.partial(_row_of, readings)
    in_lanes = run_in_lanes(scenarios, row_of)
    return {
        key: in_lanes[key] if key in in_lanes else _run_one(scenario, row_of)
        for key, scenario in scenarios.items()
    }


def _row_of(readings, run):
    """Return the row of a Run: its metrics and readings, or the reason why a reading failed."""
    try:
        read = {name: float(reading(run)) for name, reading in readings.items()}
        return run.metrics | read | dict(error="")
    except Exception as error:  # a function of the user's must not stop the other runs
        return store.failed_row(_reason(error))


def _run_one(scenario, row_of):
    """Return the row of a run, or the reason of its failure."""
    try:
        return row_of(simulate(scenario))
    except Exception as error:  # one failing run must not stop the others
        return store.failed_row(_reason(error))


def _reason(error):
    """One line that names an error."""
    return f"{type(error).__name__}: {textwrap.shorten(str(error), 300)}"
