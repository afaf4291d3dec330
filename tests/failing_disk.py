"""Make every file operation of a task fail in turn, as SQLite's tests do (run by
`tests/project/test_failing_disk.py`, with failing_disk.c preloaded).

For each k, a child process runs the task in a fresh folder on a disk whose k-th operation fails,
alone or with all later ones: both in turn, of a long task one of them. It reports what was raised
and what was left. Then the task runs again in the same folder on a disk that works. Of a long task
every fifth k is taken.
"""

import contextlib
import ctypes
import functools
import gc
import hashlib
import io
import json
import os
import select
import shutil
import signal
import sys
import tempfile
import warnings
from pathlib import Path
from unittest import mock

import pandas as pd
from pyarrow import parquet

import rhec
from rhec import cli, embedded, style
from rhec.core._casadi import cache

LONG = 100  # operations of a long task
STRIDE = 5  # odd, so that both kinds are taken in turn
MOST_OPERATIONS = 1000  # a task that never ends without failure would be a loop
LONGEST_S = 60.0  # of a child that says nothing
SCENARIOS = [rhec.Scenario(duration_s=2.0, seed=seed) for seed in range(3)]


def campaign(folder):
    table = rhec.campaign(SCENARIOS, folder=folder / "rows", workers=1)
    # A run that fails is a row with its error, and is made again.
    for error in table["error"][table["error"] != ""]:
        raise RuntimeError(error)
    return table["mean_error_true_m"].tolist()


def command(folder):
    arguments = ["--seeds", "1", "-p", "duration_s", "2", "--folder", str(folder), "--workers", "1"]
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = cli.main(["campaign", *arguments])
    if code or ", 0 failed" not in said.getvalue():
        raise OSError(said.getvalue())
    file = folder / "campaign.parquet"
    table = parquet.read_table(file, columns=["mean_error_true_m"], use_threads=False)
    return table.to_pydict()


# Texts of an export take seconds to generate: here only writing them matters.
texts_once = functools.cache(embedded._of_scenario)


def export(folder):
    with mock.patch.object(embedded, "_of_scenario", texts_once):
        rhec.export(SCENARIOS[0], folder / "c")
    files = [file for file in (folder / "c").iterdir() if file.is_file()]
    return sorted((file.name, file.read_text()) for file in files)


def table(folder):
    style.save_table(pd.DataFrame(dict(a=[1.5, 2.5])), "one", "A caption.", folder=folder)
    return (folder / "one.csv").read_text()


def picture(folder):
    from matplotlib.figure import Figure

    # Small and without words, because most of the time goes into pixels and fonts.
    figure = Figure(figsize=(1, 1))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1])
    axes.set_axis_off()
    style.save(figure, "line", folder=folder)
    return [len((folder / f"line.{kind}").read_bytes()) > 500 for kind in ("png", "pdf")]


def soil(folder):
    rhec.Terrain.uniform(0.9, 0.8).save(folder / "soil.npz")
    return rhec.Terrain.load(folder / "soil.npz").mean.tolist()


def compiled(folder):
    def build(place):
        (place / "library").write_text("code")
        (place / "names").write_text("{}")

    os.environ["RHEC_CACHE"] = str(folder / "cache")
    return cache.load_or_build("name", build, lambda place: (place / "library").read_text())


TASKS = dict(
    campaign=campaign,
    command=command,
    export=export,
    table=table,
    picture=picture,
    soil=soil,
    compiled=compiled,
)


def set_disk(disk, folder, fails_at, ever_after):
    """Let the k-th operation below a folder fail; "" stops failing and counting."""
    name = (ctypes.c_char * 4096).in_dll(disk, "folder")
    name.value = b""
    ctypes.c_long.in_dll(disk, "calls").value = 0
    ctypes.c_long.in_dll(disk, "fails_ever_after").value = ever_after
    ctypes.c_long.in_dll(disk, "fails_at").value = fails_at
    name.value = str(folder).encode()


def attempt(task, folder, disk, fails_at, ever_after):
    """What a task returned, or the sentence of what it raised, on a disk that fails."""
    outcome = dict(result=None, error=None)
    set_disk(disk, folder, fails_at, ever_after)
    try:
        outcome["result"] = task(folder)
    except Exception as error:
        outcome["error"] = f"{type(error).__name__}: {error}"
    outcome["calls"] = ctypes.c_long.in_dll(disk, "calls").value
    set_disk(disk, "", 0, 0)
    return outcome


def in_a_child(function):
    """The JSON result of a function that runs in a forked process, which may die.

    A fork of a process that has had threads may wait for a lock that one of them held. That is no
    fault of the task, so a child that says nothing for long is killed and forked anew.
    """
    for _ in range(3):
        is_done, text = fork_once(function)
        if is_done:
            return json.loads(text) if text else None
    raise RuntimeError(f"three children said nothing for {LONGEST_S:.0f} s each")


def fork_once(function):
    """Whether a forked process ended in time, and what it wrote."""
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.close(reading)
        with os.fdopen(writing, "w") as pipe:
            json.dump(function(), pipe)
        os._exit(0)
    os.close(writing)
    is_done = bool(select.select([reading], [], [], LONGEST_S)[0])
    if not is_done:
        os.kill(child, signal.SIGKILL)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return is_done, text


def digests(folder):
    """{file: digest of its content}, for the files below a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()[:12]
        for path in files
    }


def one_point(task, disk, k, ever_after):
    """What happens if the k-th operation fails, and when the task runs again after that."""
    folder = Path(tempfile.mkdtemp())
    try:
        first = attempt(task, folder, disk, k, ever_after)
        left = digests(folder)
        again = attempt(task, folder, disk, 0, 0)
        point = dict(k=k, ever_after=ever_after, first=first, left=left, again=again)
        return point | dict(finally_there=digests(folder))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def main():
    warnings.simplefilter("ignore")
    name, library = sys.argv[1:]
    os.environ["RHEC_UNATTENDED"] = "1"
    task = TASKS[name]
    disk = ctypes.CDLL(library)
    warm = Path(tempfile.mkdtemp())
    task(warm)  # imports and compiles
    shutil.rmtree(warm)
    gc.freeze()  # else each child's collector would copy all memory that it shares
    reference = in_a_child(lambda: one_point(task, disk, 0, 0))
    count = reference["first"]["calls"]
    assert 0 < count < MOST_OPERATIONS, count
    points = points_of(task, disk, count)
    print(json.dumps(dict(reference=reference, points=points)))


def points_of(task, disk, count):
    """The points of a task with `count` operations; None where the process died.

    Of a long task every fifth operation fails, alone or with all later ones in turn.
    """
    every = range(1, count + 1)
    failures = [(k, ever) for k in every for ever in (0, 1)]
    if count >= LONG:
        failures = [(k, k % 2) for k in every[::STRIDE]]
    # Of a long task, a child takes several failures: most of the time would go into forks.
    size = 1 if count < 50 else 25
    points = []
    for begin in range(0, len(failures), size):
        batch = failures[begin : begin + size]
        done = in_a_child(lambda: [one_point(task, disk, *failure) for failure in batch])
        points += done or [None]
    return points


if __name__ == "__main__":
    main()
