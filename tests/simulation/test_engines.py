"""Campaigns on engines of several processes, started for real: Dask, MPI, ipyparallel.

`make nightly` installs them (tests/engines.txt); what is missing is named by a skip.
"""

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import engines
import psutil
import pytest

import rhec
from rhec.simulation.campaigns import store

pytestmark = pytest.mark.nightly
ROOT = Path(rhec.__file__).parents[1]
DRIVES = 600
# That of the user, whose compilers optimise: with those that `conftest` sets later, so many drives
# would take minutes.
ENVIRONMENT = os.environ | dict(PYTHONPATH=f"{ROOT}:{ROOT}/tests")
# That of the package mpich, whose library mpi4py finds beside it.
MPIEXEC = Path(sys.executable).with_name("mpiexec")
MPI = [MPIEXEC, "-n", "3", sys.executable, "-m", "mpi4py.futures"]


def need(engine):
    """Skip a test where its engine is not installed."""
    modules = dict(here="rhec", own="loky", dask="distributed", mpi="mpi4py")
    module = modules.get(engine, engine)
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed: make .venv/engines")
    if engine == "mpi" and not MPIEXEC.exists():
        pytest.skip("mpich is not installed: make .venv/engines")


def begun(engine, *options, environment=None, **how):
    """The process of `tests/engines.py`, whose output is a pipe."""
    need(engine)
    begin = MPI if engine == "mpi" else [sys.executable]
    return subprocess.Popen(
        [*begin, "tests/engines.py", engine, *map(str, options)],
        env=ENVIRONMENT | (environment or {}),
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        **how,
    )


def started(engine, *options, **environment):
    """What `tests/engines.py` says after a campaign, as a dict, and how it ended."""
    process = begun(engine, *options, environment=environment)
    out, _ = process.communicate(timeout=550)
    line = next((line for line in out.splitlines() if line.startswith("{")), "{}")
    return json.loads(line), process.returncode


@pytest.fixture(scope="module")
def here():
    """The digest of all rows as one process makes them."""
    return started("here", DRIVES)[0]["digest"]


@pytest.mark.parametrize("engine", ["dask", "ipyparallel"])
def test_a_killed_worker_changes_no_bit(engine, here, tmp_path):
    said, code = started(engine, DRIVES, "--kill", "--folder", tmp_path)
    assert (code, said["rows"], said["failed"], said["killed"]) == (0, DRIVES, 0, 1)
    assert said["digest"] == here


def test_mpi_computes_the_same_bits_and_continues_after_a_killed_rank(here, tmp_path):
    """All of an MPI job ends with one of its processes; what is done is kept."""
    said, code = started("mpi", DRIVES, "--kill", "--folder", tmp_path)
    assert code and not said and list(tmp_path.glob("*/*.parquet"))
    said, code = started("mpi", DRIVES, "--folder", tmp_path)
    assert (code, said["failed"], said["digest"]) == (0, 0, here)


def processes_with(name, value):
    """The living processes in whose environment a variable has this value."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            zombie = process.status() == psutil.STATUS_ZOMBIE
            if process.environ().get(name) == value and not zombie:
                found.append(process)
    return found


@pytest.mark.parametrize("engine", ["own", "dask", "mpi"])
def test_ctrl_c_ends_all_processes_and_keeps_what_is_done(engine, tmp_path):
    """A terminal sends it to the workers, too."""
    process = begun(
        engine,
        *(20_000, "--folder", tmp_path),
        environment=dict(RHEC_TESTED=str(tmp_path)),
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    engines.wait(lambda: list(tmp_path.glob("*/*.parquet")) or process.poll() is not None)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode
    engines.wait(lambda: not processes_with("RHEC_TESTED", str(tmp_path)), seconds=60)
    kept = [len(rows) for (folder,) in [tmp_path.glob("*/")] for rows in store.load_rows(folder)]
    assert 0 < sum(kept) < 20_000
