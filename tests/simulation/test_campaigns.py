"""Campaigns: the same rows wherever they run, whatever fails or is killed or interrupted."""

import concurrent.futures
import contextlib
import dataclasses
import errno
import functools
import io
import itertools
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
import warnings
from pathlib import Path

import casadi as ca
import loky
import numpy as np
import pandas as pd
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tqdm.auto
from helpers import own_controller, untraceable
from storm import workers_of

import rhec
from rhec.cli import main
from rhec.core._casadi import compiled
from rhec.simulation.campaigns import batch, store, workers
from rhec.simulation.campaigns import campaign as campaigns

SHORT = rhec.Scenario(estimator="ekf", duration_s=6.0)
BROKEN = dataclasses.replace(SHORT, path=untraceable())
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


@dataclasses.dataclass(frozen=True)
class Lethal(rhec.Path):
    """A path that kills every process but its own."""

    home: int = 0

    def poses(self, s):
        if os.getpid() != self.home:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().poses(s)


def own_estimator(**result):
    """An estimator that believes its measurements, or answers as told."""
    memory, z = ca.SX.sym("memory", 6), ca.SX.sym("z", 4)
    estimate = ca.vertcat(z[:2], memory[2] + 0.16 * z[3], z[2], 0.9, 0.8)
    return ca.Function("mine", [memory, z], [estimate, result.get("estimate", estimate)])


@pytest.fixture
def ran(monkeypatch):
    """The scenarios that really ran."""
    ran = []
    monkeypatch.setattr(
        campaigns, "simulate", lambda scenario: ran.append(scenario) or rhec.simulate(scenario)
    )
    return ran


# Rows


def test_a_campaign_has_a_row_for_each_scenario_in_order():
    several = dict(seed=(5, 2, 5), estimator=("ekf", "oracle"))
    scenarios = [
        dataclasses.replace(SHORT, **dict(zip(several, values)))
        for values in itertools.product(*several.values())
    ]
    table = rhec.campaign(scenarios)
    assert (table["error"] == "").all() and len(table) == len(scenarios)
    for scenario, (_, row) in zip(scenarios, table.iterrows()):
        metrics = rhec.simulate(scenario).metrics
        assert {key: row[key] for key in metrics} == pytest.approx(metrics, nan_ok=True)
        varied = dict(seed=row["seed"], estimator=row["estimator"])
        assert table.attrs | varied == dataclasses.asdict(scenario)


def test_what_varied_and_the_metrics_are_columns_and_constants_are_attributes():
    names = {field.name for field in dataclasses.fields(rhec.Scenario)}
    metrics = rhec.simulate(SHORT).metrics
    assert list(metrics) == list(store.failed_row(""))[:-1] and not names & {*metrics}
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


def test_equal_scenarios_run_once(ran):
    table = rhec.campaign([SHORT, *short(2), SHORT])
    assert ran == short(2) and list(table["seed"]) == [0, 0, 1, 0]


def test_a_failing_run_is_a_row_with_its_error():
    compiler = compiled.compiler()
    other = dataclasses.replace(BROKEN, seed=1)
    table = rhec.campaign([SHORT, BROKEN, other, *short(2)])
    good, metrics = table["error"] == "", set(store.failed_row("")) - {"error"}
    assert list(good) == [True, False, False, True, True]
    assert table.loc[~good, list(metrics - {"solver_ok"})].isna().all(axis=None)
    assert not table.loc[~good, "solver_ok"].any()
    assert table["error"].str.fullmatch(r"|\w+: .*").all() and table["error"].str.len().max() < 400
    assert list(table["path"]) == [None, BROKEN.path, BROKEN.path, None, None]
    assert compiled.compiler() == compiler  # it is not to blame
    assert_equal_rows(table[good], rhec.campaign([SHORT, *short(2)]))


def test_a_bar_shows_the_progress_of_what_takes_longer_than_two_seconds(monkeypatch, capfd):
    """Also where no run has ended yet; and nothing where nobody looks."""
    rhec.campaign([SHORT], workers=1)
    assert capfd.readouterr() == ("", "")
    shown = []

    class Bar(tqdm.auto.tqdm):
        def __init__(self, **options):
            super().__init__(**options | dict(disable=False, file=io.StringIO()))

        def refresh(self, *given, **named):
            shown.append(self.n)
            return super().refresh(*given, **named)

    monkeypatch.setattr(tqdm.auto, "tqdm", Bar)
    monkeypatch.setattr(campaigns, "_SHOWN_AFTER_S", 0.3)
    for seconds in (0.0, 1.0):
        shown.clear()
        slow = lambda scenario, s=seconds: time.sleep(s) or rhec.simulate(scenario)  # noqa: E731
        monkeypatch.setattr(campaigns, "simulate", slow)
        assert (rhec.campaign([SHORT], workers=1)["error"] == "").all()
        assert (0 in shown) == (seconds > 0)


# What is kept


def test_what_is_kept_is_not_run_again(tmp_path, ran):
    first = rhec.campaign(short(), tmp_path)
    assert_equal_rows(first, rhec.campaign(short()))
    ran.clear()
    assert_equal_rows(rhec.campaign(short(), tmp_path), first)
    assert ran == []
    backwards = rhec.campaign(
        [*short(6)[::-1], dataclasses.replace(SHORT, estimator=own_estimator())], tmp_path
    )
    assert [scenario.seed for scenario in ran] == [5, 4, 0]
    assert_equal_rows(backwards[2:6][::-1], first)


def test_an_interrupted_campaign_goes_on(tmp_path, monkeypatch):
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
            assert "of 8 runs; the same call continues from there" in str(interrupt)
    monkeypatch.undo()
    assert interruptions >= 2 and len([scenario for scenario in runs if scenario]) == 8
    assert_equal_rows(table, rhec.campaign(short(8)))


def test_a_resumed_campaign_has_the_types_of_a_fresh_one(tmp_path):
    for scenarios in (short(), [*short(2), BROKEN]):
        fresh = rhec.campaign(scenarios, tmp_path)
        pd.testing.assert_frame_equal(rhec.campaign(scenarios, tmp_path), fresh, check_exact=True)
        assert fresh.dtypes.equals(rhec.campaign(scenarios).dtypes)


def test_what_changes_bits_is_part_of_what_a_row_was_made_by(tmp_path, monkeypatch):
    here = store.provenance()
    monkeypatch.setattr(store.platform, "libc_ver", lambda: ("glibc", "0.1"))
    assert store.provenance() != here
    monkeypatch.undo()
    (tmp_path / "processor").write_text("flags\t\t: fpu avx2\n")
    monkeypatch.setattr(compiled, "PROCESSOR", tmp_path / "processor")
    assert store.provenance() != here
    monkeypatch.undo()
    assert store.provenance() == here


def test_a_compiler_that_fails_on_the_way_mixes_no_rows(tmp_path, ran, monkeypatch):
    """What was compiled before and what runs on the virtual machine differ in their last bits."""
    monkeypatch.setattr(batch, "_TASK", 30)
    monkeypatch.setattr(campaigns, "run_in_lanes", lambda *given: {})
    real = compiled.compiler()
    monkeypatch.setattr(compiled, "compiler", lambda: None if len(ran) > 1 else real)
    # Other tests must not find what this one has built for the virtual machine.
    monkeypatch.setattr(compiled, "load", functools.cache(compiled.load.__wrapped__))
    rhec.campaign(short(), tmp_path)
    assert ran[2:] == short() or not real
    assert len(load_rows(store.open_folder(tmp_path))) == 4


def test_failures_are_tried_again(tmp_path, monkeypatch):
    monkeypatch.setattr(campaigns, "simulate", lambda scenario: 1 / 0)
    failed = rhec.campaign(short(), tmp_path)
    assert (failed["error"] == "ZeroDivisionError: division by zero").all()
    monkeypatch.undo()
    assert (rhec.campaign(short(), tmp_path)["error"] == "").all()


def test_other_code_keeps_other_rows(tmp_path, ran, monkeypatch):
    rhec.campaign(short(), tmp_path)
    here = store.provenance()
    for name in here:
        monkeypatch.setattr(store, "provenance", lambda name=name: here | {name: "another"})
        ran.clear()
        rhec.campaign(short(), tmp_path)
        assert ran == short()
    assert len(list(tmp_path.iterdir())) == 1 + len(here)


def test_whatever_differs_between_two_scenarios_is_told_apart():
    """Each field alone, by as little as there is of a number; and parts of soils, paths, steps."""
    soil, path = rhec.Terrain.uniform(0.7, 0.6), rhec.Path.from_segments([(20.0, 0.0)])
    changes = dict(
        estimator="rhe", process_noise="prediction", sigma_v=(0.1,) * 4, sigma_w=(1.0,) * 4,
        speed_model="input", slip=(0.2, 0.1, 0.1, 0.02, 0.05), arrival_mean="smoothed",
        input_reference="curvature", command_delay=1,
        traction_timing="sample_before", controller=own_controller(SHORT), soil_under="centre",
        backwards=True, turns="left", path=path, terrain=soil, patches=((0.0, 0.0, 1.0, 0.5, 0.5),),
        faults=(rhec.Fault(kind="stuck"),),
    )  # fmt: skip
    only_of_the_rhe = ("sensors", "sigma_gyro", "sigma_heading", "yaw_drift")
    for field in dataclasses.fields(SHORT):
        if field.name not in changes and field.name not in only_of_the_rhe:
            old = getattr(SHORT, field.name)
            if isinstance(old, int):
                changes[field.name] = old + 1
            elif isinstance(old, float):
                changes[field.name] = np.nextafter(old, 0.85)
            else:
                changes[field.name] = (9.0, *old[1:])
    sensing = dict(estimator="rhe", sensors=("gyro", "heading"))
    more = [
        dict(
            terrain=rhec.Terrain(soil.mu, np.nextafter(soil.kappa, 1), soil.origin_m, soil.cell_m)
        ),
        dict(path=rhec.Path.from_segments([(20.0, 0.0)], start=(0.0, 1e-300, 0.0))),
        dict(estimator=own_estimator()),
        dict(estimator=own_estimator(estimate=ca.DM.ones(6))),
        dict(controller=own_controller(SHORT, gain=3.0)),
        sensing,
        sensing | dict(sigma_gyro=(0.03, 0.1)),
        sensing | dict(sigma_heading=0.05),
        dict(estimator="rhe", yaw_drift=True, sigma_w=None),
    ]
    more += [{name: value} for name, value in changes.items()]
    scenarios = [SHORT, *(dataclasses.replace(SHORT, **each) for each in more)]
    keys = [store.scenario_key(scenario) for scenario in scenarios]
    assert len(set(keys)) == len(keys)
    assert keys == [store.scenario_key(dataclasses.replace(each)) for each in scenarios]


def truncated(file):
    file.write_bytes(file.read_bytes()[:-100])


def of_something_else(file):
    pq.write_table(pa.table(dict(key=["a"], price=[3.0])), file)


def of_other_types(file):
    table = pq.read_table(file)
    place = table.column_names.index("violations")
    many = pa.array(["many"] * len(table))
    pq.write_table(table.set_column(place, "violations", many), file)


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "spoil",
    [
        truncated,
        of_something_else,
        of_other_types,
        lambda file: file.write_bytes(b""),
        lambda file: file.write_text("key,scenario\n"),
    ],
)
def test_a_file_that_cannot_be_read_is_made_again(tmp_path, ran, spoil):
    first = rhec.campaign(short(), tmp_path)
    (file,) = tmp_path.glob("*/*.parquet")
    spoil(file)
    ran.clear()
    with pytest.warns(UserWarning, match="cannot be read .* repeated"):
        again = rhec.campaign(short(), tmp_path)
    assert_equal_rows(again, first)
    assert ran == short()
    assert_equal_rows(rhec.campaign(short(), tmp_path), first)


def test_a_file_that_went_through_pandas_is_read(tmp_path, ran):
    """There NaN is written as null."""
    scenarios = [*short(3), dataclasses.replace(SHORT, estimator="oracle", seed=9)]
    first = rhec.campaign(scenarios, tmp_path)
    (file,) = tmp_path.glob("*/*.parquet")
    nulls = sum(column.null_count for column in pq.read_table(file).columns)
    pd.read_parquet(file).to_parquet(file)
    assert sum(column.null_count for column in pq.read_table(file).columns) > nulls == 0
    ran.clear()
    assert_equal_rows(rhec.campaign(scenarios, tmp_path), first)
    assert ran == []


def test_what_is_no_file_is_left_aside(tmp_path, ran):
    """A pipe would be waited for, a loop of links is none, and nothing is in a folder."""
    first = rhec.campaign(short(), tmp_path)
    (folder,) = tmp_path.iterdir()
    os.mkfifo(folder / "a.parquet")
    (folder / "b.parquet").symlink_to("b.parquet")
    (folder / "c.parquet").mkdir()
    ran.clear()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert_equal_rows(rhec.campaign(short(), tmp_path), first)
    assert ["it is no file" in str(each.message) for each in caught] == [True] * 3
    assert ran == []


def test_no_damaged_row_is_ever_taken(tmp_path):
    """One bit anywhere in the file: either it does not matter, or the file is left aside."""
    rhec.campaign(short(3), tmp_path)
    (file,) = tmp_path.glob("*/*.parquet")
    content, rows, left_aside = file.read_bytes(), load_rows(file.parent), 0
    for place in np.random.default_rng(0).integers(len(content), size=300):
        file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            got = load_rows(file.parent)
        assert (repr(got), len(caught)) in ((repr(rows), 0), ("{}", 1)), place
        left_aside += len(caught)
    assert left_aside > 100


def test_runs_that_share_fields_and_noise_are_neighbours():
    """Loops of eight seeds, which lanes compute together, then those of the next eight."""
    scenarios = {
        (estimator, seed): dataclasses.replace(SHORT, estimator=estimator, seed=seed)
        for estimator in ("rhe", "ekf")
        for seed in range(16)
    }
    (task,) = batch.Plan(scenarios).tasks()
    assert [seed // 8 for _, seed in task] == [0] * 16 + [1] * 16
    assert [estimator for estimator, _ in task] == (["rhe"] * 8 + ["ekf"] * 8) * 2


# Workers of its own


def test_it_is_the_same_on_any_number_of_workers_and_without():
    """Also where workers died while they were idle."""
    scenarios = short(20) + [
        dataclasses.replace(SHORT, estimator=own_estimator()),
        dataclasses.replace(SHORT, terrain=rhec.Terrain.uniform(0.7, 0.6)),
        dataclasses.replace(SHORT, duration_s=0.2),
        BROKEN,
    ]
    here = rhec.campaign(scenarios)
    for number in (2, 2):
        assert_equal_rows(rhec.campaign(scenarios, workers=number), here)
        for process in workers_of(psutil.Process()):
            process.kill()


@pytest.mark.nightly
def test_a_killed_workers_runs_are_redone_and_what_kills_workers_is_a_row_with_its_error(
    tmp_path, monkeypatch
):
    track = rhec.Path.racetrack(30.0, 7.8)
    lethal = dataclasses.replace(
        SHORT, path=Lethal(track.segments, track.length_m, True, home=os.getpid())
    )
    scenarios = [*short(3), lethal, *short(40)]
    killed, keep = [], store.save_rows

    def kill_a_worker_and_keep(*given):
        if not killed:
            killed.append(workers_of(psutil.Process())[0])
            killed[0].kill()
        keep(*given)

    monkeypatch.setattr(store, "save_rows", kill_a_worker_and_keep)
    table = rhec.campaign(scenarios, tmp_path, workers=2)
    assert killed and not killed[0].is_running()
    assert list(table.index[table["error"] != ""]) == [3]
    assert table.loc[3, "error"] == "BrokenProcessPool: every worker that ran it died"
    assert_equal_rows(table.drop(index=3), rhec.campaign(short(3) + short(40)))
    # Nor has any of these processes a port that others could connect to.
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    ports = [each for process in family for each in process.net_connections()]
    assert psutil.CONN_LISTEN not in [port.status for port in ports]


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


@pytest.mark.parametrize(
    "death",
    [
        loky.process_executor.TerminatedWorkerError,
        type("KilledWorker", (Exception,), {}),
        type("RemoteError", (Exception,), dict(ename="EngineError")),
    ],
)
def test_work_whose_workers_are_killed_again_and_again_is_done_in_the_same_call(death):
    """Whether that is told as by loky, by Dask or by ipyparallel."""
    dying = _Dying(death)
    table = rhec.campaign(short(80), workers=dying)
    assert dying.deaths > 10
    assert_equal_rows(table, rhec.campaign(short(80), workers=1))


def _kill_while_sending():
    """Kill this process as soon as its main thread writes to a pipe."""
    main = threading.main_thread().ident
    while sys._current_frames()[main].f_code.co_name != "_send":
        time.sleep(0)
    os.kill(os.getpid(), signal.SIGKILL)


def _large_result(task):
    if task == 1:
        threading.Thread(target=_kill_while_sending, daemon=True).start()
    return bytes(10_000_000)


@pytest.mark.nightly
def test_a_worker_that_dies_while_it_sends_its_result_stops_nothing():
    done = []

    def run():
        pool = workers.get_workers(2, large=True)
        done.extend(task for task, _ in workers.map_tasks(pool, _large_result, range(3)))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(60)
    assert sorted(done) == [0, 1, 2]


SCRIPT = """
import sys, rhec

class Shifted(rhec.Path):
    def poses(self, s):
        poses, curvatures = super().poses(s)
        return poses + SHIFT, curvatures

SHIFT = (0.0, 0.5, 0.0)
track = rhec.Path.racetrack(30.0, 7.8)
path = Shifted(track.segments, track.length_m, True)
scenarios = [
    rhec.Scenario(estimator="ekf", duration_s=6.0, seed=seed, path=path) for seed in range(8)
]
table = rhec.campaign(scenarios, workers=2)
assert (table["error"] == "").all(), table["error"]
print(table.drop(columns="path").equals(rhec.campaign(scenarios).drop(columns="path")))
"""


@pytest.mark.nightly
@pytest.mark.parametrize("from_stdin", [False, True])
def test_a_script_without_guard_and_what_is_typed_start_workers(tmp_path, from_stdin):
    """Classes and constants of `__main__` reach the workers; no process is left behind."""
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "-" if from_stdin else "script.py"],
        input=SCRIPT if from_stdin else None,
        env=os.environ | dict(PYTHONPATH=str(ROOT)),
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert (done.stdout, done.stderr) == ("True\n", "")


@pytest.mark.nightly
def test_workers_end_where_their_parent_was_killed(tmp_path):
    """Soon, not only after the minute without work."""
    script = "import os, rhec; rhec.campaign([rhec.Scenario(duration_s=2.0)] * 2, workers=2)"
    process = subprocess.Popen(
        [sys.executable, "-c", script + "; os.kill(os.getpid(), 9)"],
        env=os.environ | dict(PYTHONPATH=str(ROOT)),
        start_new_session=True,
    )
    process.wait(timeout=60)
    deadline = time.monotonic() + 30
    while left_of_group(process.pid):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def by_script(code, folder, package=ROOT):
    """What becomes of Python code in a process of its own, which finds the package in a folder."""
    return subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | dict(PYTHONPATH=str(package)),
        capture_output=True,
        text=True,
        timeout=120,
        cwd=folder,
    )


OTHER_CODE = """
import rhec
from pathlib import Path
from rhec.simulation.campaigns import store

store.provenance()  # of the code that this process has loaded
with open(Path(rhec.__file__).parent / "core/estimator/ekf.py", "a") as source:
    source.write("# a new idea\\n")
scenarios = [rhec.Scenario(estimator="ekf", duration_s=6.0, seed=seed) for seed in range(4)]
try:
    rhec.campaign(scenarios, workers=2)
except RuntimeError as error:
    print(error)
"""


@pytest.mark.nightly
def test_workers_with_other_code_are_refused(tmp_path):
    """The package was edited after the caller had loaded it and before its workers started."""
    for name in ("rhec", "data"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    done = by_script(OTHER_CODE, tmp_path, package=tmp_path)
    sentence = (
        r"the worker on \S+ has source of rhec \w+, but the caller has \w+, so their results may "
        r"differ; install the same rhec and packages on all machines and start the workers anew\n"
    )
    assert re.fullmatch(sentence, done.stdout), done


@pytest.mark.skipif(not compiled.compiler(), reason="there is no C compiler")
def test_workers_without_the_callers_compiler_are_refused(monkeypatch):
    """What they would compute on the virtual machine differs in its last bits."""
    monkeypatch.setenv("CC", "")  # the caller has found its compiler already
    with pytest.raises(
        RuntimeError, match="has C compiler False, but the caller has True, .*CC should"
    ):
        rhec.campaign(short(), workers=3)


# Executors of the caller


@pytest.fixture(scope="module")
def processes():
    """Two processes of the standard library."""
    with concurrent.futures.ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool:
        yield pool


def test_any_executor_computes_the_same_rows(tmp_path, processes):
    """Processes, and threads, which share compiled code."""
    scenarios = [*short(20), BROKEN]
    here = rhec.campaign(scenarios)
    with concurrent.futures.ThreadPoolExecutor(3) as threads:
        for name, executor in dict(processes=processes, threads=threads).items():
            table = rhec.campaign(scenarios, tmp_path / name, executor)
            assert_equal_rows(table, here)
            assert_equal_rows(rhec.campaign(scenarios, tmp_path / name), here)
        assert threads.submit(int).result() == 0  # it is still the caller's


def test_an_executor_whose_worker_died_says_how_to_go_on(tmp_path):
    """A pool of the standard library starts no other process; what is done is kept."""
    track = rhec.Path.racetrack(30.0, 7.8)
    lethal = dataclasses.replace(
        SHORT, path=Lethal(track.segments, track.length_m, True, home=os.getpid())
    )
    context = multiprocessing.get_context("spawn")
    sentence = "ProcessPoolExecutor died, .* new executor"
    with (
        concurrent.futures.ProcessPoolExecutor(1, context) as pool,
        pytest.raises(RuntimeError, match=sentence),
    ):
        rhec.campaign([*short(2), lethal], tmp_path, pool)


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


@pytest.mark.parametrize("name", [*store.provenance()])
def test_a_worker_that_would_compute_other_bits_is_refused(processes, monkeypatch, name):
    """The sentence says what to do; for processors, to keep them apart."""
    monkeypatch.setattr(store, "provenance", lambda: {name: "another"})
    sentence = f"has {name} .*, but the caller has another, so their results may differ; "
    remedies = {"C compiler": "CC should"} | dict.fromkeys(
        ["machine", "C library", "vector instructions"], "start the campaign and its workers on"
    )
    with pytest.raises(RuntimeError, match=sentence + remedies.get(name, "install the same")):
        rhec.campaign(short(), workers=processes)


def test_without_locks_that_processes_share_a_campaign_stays_here(monkeypatch):
    """As where /dev/shm is read-only."""

    def refused():
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(multiprocessing, "Lock", refused)
    assert workers.get_workers(None, large=True) is None
    with pytest.raises(OSError, match=r"workers=2 needs locks .*Read-only.*; workers=1 needs none"):
        rhec.campaign(short(), workers=2)


# Without what is optional

WITHOUT = """
import sys
sys.modules.update(dict.fromkeys(["loky", "pyarrow"]))
import rhec
assert "pandas" not in sys.modules
scenarios = [rhec.Scenario(estimator="ekf", duration_s=6.0, seed=seed) for seed in range(4)]
print(rhec.campaign(scenarios, workers=1).to_csv() == rhec.campaign(scenarios).to_csv())
for asked in (dict(workers=2), dict(folder="rows")):
    try:
        rhec.campaign(scenarios, **asked)
    except ImportError as error:
        print(error)
"""


@pytest.mark.nightly
def test_without_loky_and_pyarrow_it_runs_in_this_process_and_says_what_to_install(tmp_path):
    done = by_script(WITHOUT, tmp_path)
    assert done.stderr == "" and done.stdout.splitlines() == [
        "True",
        "workers=2 needs loky, which is not installed: pip install loky",
        "folder='rows' needs pyarrow, which is not installed: pip install pyarrow",
    ]
    assert list(tmp_path.iterdir()) == []


# From the command line


def command(folder, *arguments):
    """The command for 20 runs, or with the arguments in place of these."""
    twenty = "-p estimator ekf oracle -p q [1,1,1] [1,1,0] -p duration_s 6 --seeds 5".split()
    begin = [sys.executable, "-m", "rhec", "campaign", "--folder", str(folder)]
    return [*begin, *(arguments or twenty)]


def run_command(*given):
    ended = subprocess.run(command(*given), capture_output=True, text=True, timeout=120, cwd=ROOT)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def test_the_command_runs_every_combination_and_goes_on_from_what_is_there(tmp_path, capsys):
    for _ in range(2):
        assert main(command(tmp_path)[3:]) == 0
        assert "20 runs, 0 failed" in capsys.readouterr().out
    table = pd.read_parquet(tmp_path / "campaign.parquet")
    assert len(table) == 20 and (table.groupby("estimator").size() == 10).all()
    scenario = rhec.Scenario(estimator="oracle", q=(1, 1, 0), duration_s=6.0, seed=4)
    assert table.iloc[-1]["mean_error_m"] == rhec.simulate(scenario).metrics["mean_error_m"]


def left_of_group(group):
    """Processes of a group that still run."""
    left = []
    for process in psutil.process_iter(["status"]):
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            if process.pid != group and os.getpgid(process.pid) == group:
                left.append(process)
    return [process for process in left if process.info["status"] != psutil.STATUS_ZOMBIE]


@pytest.mark.nightly
def test_ctrl_c_in_a_terminal_ends_it_in_a_sentence_and_the_same_command_goes_on(tmp_path):
    """The terminal sends the signal to the workers, too."""
    drives = "-p estimator ekf -p duration_s 60 --workers 2 --seeds".split()
    process = subprocess.Popen(
        command(tmp_path, *drives, "3000"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while not list(tmp_path.glob("*/*.parquet")):
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    interrupted = re.fullmatch(
        r"rhec: interrupted after (\d+) of 3000 runs; the same call continues from there\n", err
    )
    assert (process.returncode, out) == (130, "") and interrupted, err
    (rows,) = tmp_path.glob("*/")
    assert 0 < int(interrupted[1]) == len(load_rows(rows)) < 3000
    # loky's tracker of resources ends a moment after the campaign.
    deadline = time.monotonic() + 10
    while left_of_group(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left_of_group(process.pid)
    kept = load_rows(rows)
    again = run_command(tmp_path, *drives, "5")
    drives = [rhec.Scenario(estimator="ekf", duration_s=60.0, seed=seed) for seed in range(5)]
    keys = kept.keys() | set(map(store.scenario_key, drives))
    assert "5 runs, 0 failed" in again and load_rows(rows).keys() == keys
    assert sum(pq.read_metadata(file).num_rows for file in rows.glob("*.parquet")) == len(keys)


ALL = loky.cpu_count()


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "told, cores", [("3", 3), ("", ALL), ("default", ALL), ("0", ALL), ("²", ALL)]
)
def test_a_campaign_takes_as_many_cores_as_python_is_told(monkeypatch, told, cores):
    monkeypatch.setenv("PYTHON_CPU_COUNT", told)
    pool = workers.get_workers(None, large=True)
    assert (pool.count if pool else 1) == cores


# One verb for runs


def test_simulate_takes_one_scenario_or_several_in_their_order():
    scenarios = [*short(3), dataclasses.replace(SHORT, estimator="oracle"), *short(1)]
    runs = rhec.simulate(iter(scenarios))
    assert [run.scenario for run in runs] == scenarios and rhec.simulate([]) == []
    for run, scenario in zip(runs, scenarios):
        pd.testing.assert_frame_equal(run.log, rhec.simulate(scenario).log, check_exact=True)


# Readings


def largest_error_m(run):
    return run.columns["error_true_m"].max()


def never_read(run):
    raise LookupError("nothing there")


@pytest.mark.parametrize("workers", [1, 2])
def test_a_reading_is_a_column_of_what_a_function_says_of_each_run(workers):
    scenarios = short()
    table = rhec.campaign(scenarios, workers=workers, readings=dict(largest_m=largest_error_m))
    runs = rhec.simulate(scenarios)
    assert [*table["largest_m"]] == [run.columns["error_true_m"].max() for run in runs]
    assert_equal_rows(table.drop(columns="largest_m"), rhec.campaign(scenarios, workers=1))


def test_a_run_that_failed_or_cannot_be_read_has_no_reading():
    table = rhec.campaign([SHORT, BROKEN], readings=dict(largest_m=largest_error_m))
    assert [*np.isnan(table["largest_m"])] == [False, True]
    table = rhec.campaign([SHORT], readings=dict(none=never_read))
    assert table["error"][0] == "LookupError: nothing there" and np.isnan(table["none"][0])


def test_estimators_of_one_step_that_begin_otherwise_are_other_rows():
    """Their first memories and their W are what they bring along, beside the step."""
    memory, z, W = ca.SX.sym("memory", 6), ca.SX.sym("z", 4), ca.SX.sym("W", 1)
    estimate = ca.vertcat(z[:2], memory[2], z[2], ca.sqrt(W), 1)
    names = ["memory", "z", "W"], ["memory", "estimate"], {"allow_duplicate_io_names": True}
    step = ca.Function("by_w", [memory, z, W], [estimate, estimate], *names)
    own = [rhec.Estimator(step, noises=dict(prediction=((w,), None))) for w in (0.25, 0.5)]
    table = rhec.campaign([dataclasses.replace(SHORT, estimator=each) for each in own])
    assert table["rms_mu"][0] > table["rms_mu"][1]
    keys = {store.scenario_key(dataclasses.replace(SHORT, estimator=each)) for each in own}
    assert len(keys) == 2


# Memory


def finished(missing, workers, run_task):
    """In place of the runs: their rows, in parts."""
    keys = [*missing]
    for begin in range(0, len(keys), 300):
        row = store.example_metrics() | dict(error="")
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
