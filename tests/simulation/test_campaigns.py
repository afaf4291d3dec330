"""Campaigns: the same rows wherever they run, whatever fails or is killed or interrupted."""

import concurrent.futures
import dataclasses
import errno
import functools
import io
import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import time
import tracemalloc
import warnings
from pathlib import Path
from types import SimpleNamespace

import loky
import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tqdm.auto
from helpers import own_controller
from own_steps import filter_of_yaw_rates, largest_error_m, lethal, untraceable
from storm import workers_of

import rhec
from rhec.cli import main
from rhec.core._casadi import compiled
from rhec.simulation.campaigns import batch, store, workers
from rhec.simulation.campaigns import campaign as campaigns

SHORT = rhec.Scenario(estimator="ekf", duration_s=6.0)
BROKEN = dataclasses.replace(SHORT, path=untraceable())
LETHAL = dataclasses.replace(SHORT, path=lethal())
ROOT = Path(rhec.__file__).parents[1]


def load_rows(folder):
    """{key: row} of all files in a campaign's folder."""
    return {key: row for rows in store.load_rows(folder) for key, row in rows.items()}


def short(seeds=4, **changes):
    return [dataclasses.replace(SHORT, seed=seed, **changes) for seed in range(seeds)]


def assert_equal_rows(one, other):
    """Equal to the last bit; a column with holes may be of another type.

    What varies in one table may be constant in the other.
    """
    both = [*store.failed_row("")]
    both += [name for name in one.columns if name in other.columns and name not in both]
    pd.testing.assert_frame_equal(
        one[both].reset_index(drop=True),
        other[both].reset_index(drop=True),
        check_exact=True,
        check_dtype=False,
    )


def rows_of(folder, scenarios):
    """The folders below this one that a campaign of these scenarios leaves there."""
    rhec.campaign(scenarios, folder)
    return folder.iterdir()


@pytest.fixture
def one_by_one(monkeypatch):
    """No run in lanes, which another campaign may have left in the cache."""
    monkeypatch.setattr(campaigns, "run_in_lanes", lambda *given: {})


@pytest.fixture
def ran(monkeypatch, one_by_one):
    """The scenarios that really ran."""
    ran = []
    monkeypatch.setattr(
        campaigns, "simulate", lambda scenario: ran.append(scenario) or rhec.simulate(scenario)
    )
    return ran


# Rows


def test_a_campaign_has_the_rows_of_simulate_in_order_and_equal_scenarios_run_once(ran):
    scenarios = [
        dataclasses.replace(SHORT, seed=seed, estimator=estimator)
        for seed in (5, 2, 5)
        for estimator in ("ekf", "oracle")
    ]
    table = rhec.campaign(scenarios)
    assert len(ran) == 4 and {*ran} == {*scenarios}
    assert (table["error"] == "").all() and len(table) == len(scenarios)
    runs = rhec.simulate(iter(scenarios))
    assert [run.scenario for run in runs] == scenarios and rhec.simulate([]) == []
    for run, (_, row) in zip(runs, table.iterrows()):
        np.testing.assert_equal({name: row[name] for name in run.metrics}, {**run.metrics})
        varied = dict(seed=row["seed"], estimator=row["estimator"])
        assert table.attrs | varied == dataclasses.asdict(run.scenario)


def test_what_varied_and_the_metrics_are_columns_and_constants_are_attributes():
    names = {field.name for field in dataclasses.fields(rhec.Scenario)}
    metrics = rhec.simulate(SHORT).metrics
    assert {name: type(value) for name, value in metrics.items()} == store.TYPES
    assert not names & {*metrics}
    for scenarios, varied in (
        ([], []),
        ([SHORT], []),
        ([*short(1), *short(2, duration_s=4.0)], ["duration_s", "seed"]),
        ([SHORT, dataclasses.replace(SHORT, r=1)], ["r"]),
    ):
        table = rhec.campaign(scenarios)
        assert len(table) == len(scenarios)
        assert list(table.columns) == [*varied, *metrics, "error"]
        constant = names - {*varied} if scenarios else {*()}
        assert table.attrs == {name: getattr(SHORT, name) for name in constant}
    # pandas copies attributes all the time; what may be large, such as a soil, is a column.
    soil = rhec.Terrain.uniform(0.9, 0.8)
    table = rhec.campaign(short(2, terrain=soil))
    assert list(table["terrain"]) == [soil] * 2 and "terrain" not in table.attrs


def test_a_failing_run_is_a_row_with_its_error():
    other = dataclasses.replace(BROKEN, seed=1)
    table = rhec.campaign([SHORT, BROKEN, other, *short(2)])
    good, metrics = table["error"] == "", set(store.failed_row("")) - {"error"}
    assert list(good) == [True, False, False, True, True]
    assert table.loc[~good, list(metrics - {"solver_ok"})].isna().all(axis=None)
    assert not table.loc[~good, "solver_ok"].any()
    assert table["error"].str.fullmatch(r"|\w+: .*").all() and table["error"].str.len().max() < 400
    assert list(table["path"]) == [None, BROKEN.path, BROKEN.path, None, None]
    assert_equal_rows(table[good], rhec.campaign([SHORT, *short(2)]))


def test_a_bar_shows_the_progress_of_what_takes_long(monkeypatch, one_by_one):
    """Also where no run has ended yet. At the end it is gone."""
    shown, stream = [], io.StringIO()

    class Bar(tqdm.auto.tqdm):
        def __init__(self, **options):
            super().__init__(**options | dict(disable=False, file=stream))

        def refresh(self, *given, **named):
            shown.append(self.n)
            return super().refresh(*given, **named)

    def slow(scenario):
        while shown_after_s < 1 and not shown:
            time.sleep(0.01)
        return rhec.simulate(scenario)

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    monkeypatch.setattr(campaigns, "simulate", slow)
    for shown_after_s in (60.0, 0.1):
        shown.clear()
        monkeypatch.setattr(campaigns, "_SHOWN_AFTER_S", shown_after_s)
        assert (rhec.campaign([SHORT], workers=1)["error"] == "").all()
        assert (0 in shown) == (shown_after_s < 1)
    assert not stream.getvalue().endswith("\n")


# What is kept


def test_what_is_kept_is_not_run_again_and_what_failed_is(tmp_path, ran):
    """The table of rows that are read has the bits and types of the one that was computed."""
    first = rhec.campaign([*short(), BROKEN], tmp_path)
    assert_equal_rows(first, rhec.campaign([*short(), BROKEN]))
    ran.clear()
    again = rhec.campaign([*short(), BROKEN], tmp_path)
    assert ran == [BROKEN]
    pd.testing.assert_frame_equal(again, first, check_exact=True)
    ran.clear()
    backwards = rhec.campaign(short(6)[::-1], tmp_path)
    assert [scenario.seed for scenario in ran] == [5, 4]
    assert_equal_rows(backwards[2:][::-1], first[:4])
    assert backwards.dtypes.equals(rhec.campaign(short(6)[::-1]).dtypes)


def test_an_interrupted_campaign_goes_on(tmp_path, monkeypatch, one_by_one):
    """Interrupted anywhere, again and again: each time it gets on, and what was finished is never
    run again.
    """
    monkeypatch.setattr(batch, "_TASK", 30)
    runs = []

    def tiring(scenario):
        if len(runs) % 3 == 2 and runs[-1] is not None:
            runs.append(None)
            raise KeyboardInterrupt
        runs.append(scenario)
        return rhec.simulate(scenario)

    monkeypatch.setattr(campaigns, "simulate", tiring)
    for interruptions in itertools.count():
        try:
            table = rhec.campaign(short(8), tmp_path)
            break
        except KeyboardInterrupt as interrupt:
            kept = len(load_rows(store.open_folder(tmp_path)))
            said = f"interrupted after {kept} of 8 runs; the same call continues from there"
            assert str(interrupt) == said
    monkeypatch.undo()
    assert interruptions >= 2 and len([scenario for scenario in runs if scenario]) == 8
    assert_equal_rows(table, rhec.campaign(short(8)))


def test_rows_are_kept_by_all_that_changes_bits(tmp_path, monkeypatch):
    real = compiled.compiler()
    processor = tmp_path / "processor"
    processor.write_text("flags\t\t: fpu avx2\n")
    version = store.importlib.metadata.version
    others = [
        (store.platform, "libc_ver", lambda: ("glibc", "0.1")),
        (store.platform, "machine", lambda: "another"),
        (compiled, "PROCESSOR", processor),
        (compiled, "compiler", lambda: None if real else "cc"),
        (compiled, "source_digest", lambda: "of other source"),
        (store.terrain, "STANDARD_FIELDS", processor),
    ]
    for library in ("casadi", "numpy", "scipy"):
        newer = lambda name, library=library: version(name) + "1" * (name == library)  # noqa: E731
        others.append((store.importlib.metadata, "version", newer))
    folders = {store.open_folder(tmp_path / "rows")}
    for place, name, other in others:
        with monkeypatch.context() as patch:
            patch.setattr(place, name, other)
            store._installed.cache_clear()
            folders.add(store.open_folder(tmp_path / "rows"))
    store._installed.cache_clear()
    assert len(folders) == 1 + len(others)
    assert store.open_folder(tmp_path / "rows") in folders


def test_a_compiler_that_fails_on_the_way_mixes_no_rows(tmp_path, ran, monkeypatch):
    """What was compiled before and what runs on the virtual machine differ in their last bits."""
    monkeypatch.setattr(batch, "_TASK", 30)
    real = compiled.compiler()
    monkeypatch.setattr(compiled, "compiler", lambda: None if len(ran) > 1 else real)
    # Other tests must not find what this one has built for the virtual machine.
    monkeypatch.setattr(compiled, "load", functools.cache(compiled.load.__wrapped__))
    rhec.campaign(short(), tmp_path)
    assert ran[2:] == short() or not real
    assert len(load_rows(store.open_folder(tmp_path))) == 4


def by_w(w):
    """An estimator that differs from another one in its W alone."""
    return filter_of_yaw_rates(noises=dict(prediction=((w,), None)))


SOIL = rhec.Terrain.uniform(0.7, 0.6)
# What differs by as little as there is of a number, and within an object.
DIFFERENT = [
    dict(r=np.nextafter(SHORT.r, 0)),
    dict(q=(*SHORT.q[:2], np.nextafter(SHORT.q[2], 0))),
    dict(seed=1),
    dict(turns="left"),
    dict(backwards=True),
    dict(faults=(rhec.Fault(kind="stuck"),)),
    dict(terrain=SOIL),
    dict(terrain=dataclasses.replace(SOIL, kappa=SOIL.kappa + np.diag([0, 1e-15]))),
    dict(path=rhec.Path.from_segments([(20.0, 0.0)])),
    dict(path=rhec.Path.from_segments([(20.0, 0.0)], start=(0.0, 1e-300, 0.0))),
    dict(controller=own_controller(SHORT)),
    dict(controller=own_controller(SHORT, gain=3.0)),
    dict(estimator=by_w(0.25)),
    dict(estimator=by_w(0.5)),
]


def test_whatever_differs_between_two_scenarios_is_told_apart():
    scenarios = [dataclasses.replace(SHORT, **fields) for fields in ({}, *DIFFERENT)]
    keys = [*map(store.scenario_key, scenarios)]
    assert len({*keys}) == len(keys)
    assert keys == [store.scenario_key(dataclasses.replace(scenario)) for scenario in scenarios]


def as_pipe(file):
    file.unlink()
    os.mkfifo(file)


def as_table(value):
    """What writes a table of a campaign's columns with this value in all of them."""
    table = pa.table({name: [value] for name in ("key", *store.TYPES)})
    return lambda file: pq.write_table(table, file)


SPOILT = {
    "truncated": lambda file: file.write_bytes(file.read_bytes()[:-100]),
    "of something else": lambda file: pq.write_table(pa.table(dict(key=["a"], x=[3.0])), file),
    "of other types": as_table("many"),
    "of nothing": as_table(None),
    "a pipe": as_pipe,
}


@pytest.mark.parametrize("how", SPOILT)
def test_a_file_that_cannot_be_read_is_left_aside(tmp_path, how):
    (folder,) = rows_of(tmp_path, short(2))
    (file,) = folder.iterdir()
    SPOILT[how](file)
    with pytest.warns(UserWarning, match="cannot be read .* repeated"):
        assert load_rows(folder) == {}


def test_no_damaged_row_is_ever_taken(tmp_path, ran):
    """One bit anywhere in the file: either it does not matter, or its runs are repeated."""
    (folder,) = rows_of(tmp_path, short(3))
    (file,) = folder.iterdir()
    content, rows, left_aside = file.read_bytes(), load_rows(folder), 0
    for place in np.random.default_rng(0).integers(len(content), size=150):
        file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            got = load_rows(folder)
        assert (repr(got), len(caught)) in ((repr(rows), 0), ("{}", 1)), place
        left_aside += len(caught)
    assert left_aside > 50
    SPOILT["truncated"](file)
    with pytest.warns(UserWarning, match="cannot be read .* repeated"):
        rhec.campaign(short(3), tmp_path)
    assert ran == short(3) * 2 and repr(load_rows(folder)) == repr(rows)


def test_runs_that_share_fields_and_noise_are_neighbours():
    """Loops of eight seeds, which lanes compute together, then those of the next eight."""
    scenarios = {
        (estimator, seed): dataclasses.replace(SHORT, estimator=estimator, seed=seed)
        for estimator in ("rhe", "ekf")
        for seed in range(16)
    }
    (task,) = batch.Plan(scenarios).tasks(1)
    assert [seed // 8 for _, seed in task] == [0] * 16 + [1] * 16
    assert [estimator for estimator, _ in task] == (["rhe"] * 8 + ["ekf"] * 8) * 2


# Workers of its own


def test_it_is_the_same_on_any_workers_and_without(tmp_path, processes):
    """Readings of the runs, too. Executors are those of the caller: processes, and threads, which
    share compiled code.
    """
    scenarios = short(20) + [
        dataclasses.replace(SHORT, estimator=by_w(0.3)),
        dataclasses.replace(SHORT, terrain=rhec.Terrain.uniform(0.7, 0.6)),
        dataclasses.replace(SHORT, duration_s=0.2),
        BROKEN,
    ]
    readings = dict(largest_m=largest_error_m)
    here = rhec.campaign(scenarios, workers=1, readings=readings)
    assert here["largest_m"].notna().sum() == len(scenarios) - 1
    assert_equal_rows(rhec.campaign(scenarios, workers=2, readings=readings), here)
    workers.get_workers(3, large=True)  # others, which start later; those that there are end
    assert not workers_of(psutil.Process())
    # Ctrl-C is blocked for the workers alone, and only while they start.
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with concurrent.futures.ThreadPoolExecutor(3) as threads:
        for name, executor in dict(processes=processes, threads=threads).items():
            assert_equal_rows(rhec.campaign(scenarios, tmp_path / name, executor), here)
            assert_equal_rows(rhec.campaign(scenarios, tmp_path / name), here)
        assert threads.submit(int).result() == 0  # it is still the caller's


@pytest.mark.nightly
def test_what_kills_workers_is_a_row_with_its_error(tmp_path):
    """Nor has any of these processes a port that others could connect to. Those that died while
    they were idle are started anew.
    """
    scenarios = [*short(3), LETHAL, *short(40)]
    table = rhec.campaign(scenarios, tmp_path, workers=2)
    assert list(table.index[table["error"] != ""]) == [3]
    assert table.loc[3, "error"] == "BrokenProcessPool: every worker that ran it died"
    here = rhec.campaign(short(3) + short(40))
    assert_equal_rows(table.drop(index=3), here)
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    ports = [each for process in family for each in process.net_connections()]
    assert psutil.CONN_LISTEN not in [port.status for port in ports]
    for process in workers_of(psutil.Process()):
        process.kill()
    assert_equal_rows(rhec.campaign(short(3) + short(40), workers=2), here)


class _Dying(concurrent.futures.Executor):
    """Workers in this process that die again and again, more likely the more runs a task has."""

    _max_workers = 2

    def __init__(self, death):
        self.deaths = 0
        self.death = death
        self.random = np.random.default_rng(0)

    def submit(self, function, task):
        future = concurrent.futures.Future()
        if isinstance(task, dict) and self.random.random() < len(task) / 10:
            self.deaths += 1
            future.set_exception(self.death())
        else:
            future.set_result(function(task))
        return future


def test_work_whose_workers_are_killed_again_and_again_is_done_in_the_same_call():
    """Whether that is told as by loky, by Dask or by ipyparallel."""
    expected = rhec.campaign(short(40), workers=1)
    for death in (
        loky.process_executor.TerminatedWorkerError,
        type("KilledWorker", (Exception,), {}),
        type("RemoteError", (Exception,), dict(ename="EngineError")),
    ):
        dying = _Dying(death)
        assert_equal_rows(rhec.campaign(short(40), workers=dying), expected)
        assert dying.deaths > 4


SCRIPT = """
import os, rhec
class Own(rhec.Path):  # as a user writes it in a notebook
    pass
track = rhec.Path.racetrack(30.0, 7.8)
path = Own(track.segments, track.length_m, True)
scenarios = [rhec.Scenario(duration_s=2.0, seed=seed, path=path) for seed in range(2)]
table = rhec.campaign(scenarios, workers=2)
print(table["error"].tolist(), flush=True)
os.kill(os.getpid(), 9)
"""


@pytest.mark.nightly
def test_workers_of_a_script_without_guard_end_where_it_was_killed(tmp_path):
    """Soon, not only after the minute without work. Until then they keep the output open."""
    (tmp_path / "script.py").write_text(SCRIPT)
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "script.py"],
        env=os.environ | dict(PYTHONPATH=str(ROOT)),
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.stdout == "['', '']\n"
    assert time.monotonic() - began < 40


def test_a_worker_whose_compiler_fails_on_the_way_is_refused(monkeypatch, one_by_one):
    """What it would compute on the virtual machine differs in its last bits."""

    def failing(scenario):
        run = rhec.simulate(scenario)
        monkeypatch.setattr(compiled, "compiler", lambda: None if real else "cc")
        return run

    real = compiled.compiler()
    monkeypatch.setattr(campaigns, "simulate", failing)
    refused = pytest.raises(RuntimeError, match=f"C compiler {not real}, but the caller has")
    with concurrent.futures.ThreadPoolExecutor(1) as threads, refused:
        rhec.campaign(short(1), workers=threads)


# Executors of the caller


@pytest.fixture(scope="module")
def processes():
    """A process of the standard library."""
    spawn = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(1, spawn) as pool:
        yield pool


def test_a_worker_that_would_compute_other_bits_is_refused(processes, monkeypatch):
    """The sentence says what to do; for processors, to keep them apart."""
    remedies = {"C compiler": "CC should"} | dict.fromkeys(
        ["machine", "C library", "vector instructions"], "start the campaign and its workers on"
    )
    for name in store.provenance():
        monkeypatch.setattr(store, "provenance", lambda name=name: {name: "another"})
        sentence = f"has {name} .*, but the caller has another, so their results may differ; "
        with pytest.raises(RuntimeError, match=sentence + remedies.get(name, "install the same")):
            rhec.campaign(short(), workers=processes)
        monkeypatch.undo()


def test_an_executor_whose_worker_died_says_how_to_go_on(tmp_path, processes):
    """A pool of the standard library starts no other process: no test after this one uses it."""
    with pytest.raises(RuntimeError, match="ProcessPoolExecutor died, .* new executor"):
        rhec.campaign([*short(2), LETHAL], tmp_path, processes)


def test_an_interrupted_campaign_leaves_its_executor_without_its_tasks(monkeypatch):
    class Waiting(concurrent.futures.Executor):
        """It finishes its first task only."""

        def __init__(self):
            self.futures = []

        def submit(self, function, task):
            self.futures.append(concurrent.futures.Future())
            if len(self.futures) == 1:
                self.futures[0].set_result(function(task))
            return self.futures[-1]

    def interrupt(self, new_rows):
        raise KeyboardInterrupt

    waiting = Waiting()
    monkeypatch.setattr(store.Rows, "add", interrupt)
    with pytest.raises(KeyboardInterrupt, match="interrupted after 0 of 80 runs"):
        rhec.campaign(short(80), workers=waiting)
    assert len(waiting.futures) > 2 and all(each.cancelled() for each in waiting.futures[1:])


def test_without_locks_that_processes_share_a_campaign_stays_here(monkeypatch):
    """As where /dev/shm is read-only."""

    def refused():
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(multiprocessing, "Lock", refused)
    assert workers.get_workers(None, large=True) is None
    with pytest.raises(OSError, match=r"workers=2 needs locks .*Read-only.*; workers=1 needs none"):
        rhec.campaign(short(), workers=2)


def test_a_cluster_that_a_variable_names_runs_large_campaigns(monkeypatch):
    executor = concurrent.futures.ThreadPoolExecutor(1)
    client = SimpleNamespace(get_executor=lambda pure: executor)
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(Client={"there": client}.get))
    monkeypatch.setenv("RHEC_DASK", "there")
    assert workers.get_workers(None, large=True).pool is executor
    assert workers.get_workers(None, large=False) is None
    assert workers.get_workers(1, large=True) is None


# Without what is optional


def test_without_loky_and_pyarrow_it_runs_in_this_process_and_says_what_to_install(monkeypatch):
    for module in ("loky", "pyarrow"):
        monkeypatch.setitem(sys.modules, module, None)
    assert workers.get_workers(None, large=True) is None
    for asked, needed in ((dict(workers=2), "loky"), (dict(folder="rows"), "pyarrow")):
        ((name, value),) = asked.items()
        sentence = f"^{name}={value!r} needs {needed}, which is not installed: pip install {needed}"
        with pytest.raises(ImportError, match=sentence):
            rhec.campaign(short(), **asked)


# From the command line


def test_the_command_runs_every_combination_and_goes_on_from_what_is_there(tmp_path, capsys):
    words = "campaign -p estimator ekf oracle -p q [1,1,1] [1,1,0] -p duration_s 6 --seeds 5"
    for _ in range(2):
        assert main([*words.split(), "--folder", str(tmp_path)]) == 0
        assert "20 runs, 0 failed" in capsys.readouterr().out
    table = pd.read_parquet(tmp_path / "campaign.parquet")
    assert len(table) == 20 and (table.groupby("estimator").size() == 10).all()
    scenario = rhec.Scenario(estimator="oracle", q=(1, 1, 0), duration_s=6.0, seed=4)
    assert table.iloc[-1]["mean_error_m"] == rhec.simulate(scenario).metrics["mean_error_m"]


ALL = loky.cpu_count()


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "told, cores", [("3", 3), ("", ALL), ("default", ALL), ("0", ALL), ("²", ALL)]
)
def test_a_campaign_takes_as_many_cores_as_python_is_told(monkeypatch, told, cores):
    monkeypatch.setenv("PYTHON_CPU_COUNT", told)
    pool = workers.get_workers(None, large=True)
    assert (pool.count if pool else 1) == cores


# Readings


def test_a_reading_is_a_column_of_what_a_function_says_of_each_run():
    """A run that failed has none, and a function that fails is the run's error."""
    scenarios = [*short(), BROKEN]
    table = rhec.campaign(scenarios, readings=dict(largest_m=largest_error_m))
    runs = rhec.simulate(short())
    largest = [run.columns["error_true_m"].max() for run in runs]
    np.testing.assert_array_equal(table["largest_m"], [*largest, np.nan])
    assert_equal_rows(table.drop(columns="largest_m"), rhec.campaign(scenarios, workers=1))
    table = rhec.campaign([SHORT], readings=dict(none=lambda run: 1 / 0))
    assert table["error"][0] == "ZeroDivisionError: division by zero"
    assert np.isnan(table["none"][0])


# Memory


def finished(missing, workers, run_task):
    """In place of the runs: their rows, in parts."""
    keys = [*missing]
    for begin in range(0, len(keys), 300):
        row = store.failed_row("")
        yield {key: dict(row) for key in keys[begin : begin + 300]}


@pytest.mark.nightly
def test_the_caller_of_a_long_campaign_needs_little_memory_beside_its_scenarios(monkeypatch):
    """At most 500 bytes a run, so 50 MB for 100,000."""
    monkeypatch.setattr(campaigns, "run_all", finished)
    scenarios = [rhec.Scenario(seed=seed) for seed in range(6000)]
    rhec.campaign(scenarios[:10])  # imports
    peaks = []
    for n in (2000, 6000):
        tracemalloc.start()
        table = rhec.campaign(scenarios[:n])
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(table) == n
    assert peaks[1] - peaks[0] < 500 * 4000
