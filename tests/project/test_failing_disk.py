"""Each file operation fails in turn, or each large allocation: nothing is lost, nothing is
half-made, and one sentence says what happened."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from failing_disk import DIED, TASKS

from rhec.core._casadi import compiled

pytestmark = pytest.mark.nightly

HERE = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    """A library that fails the k-th file operation below a folder."""
    if not compiled.compiler() or not sys.platform.startswith("linux"):
        pytest.skip("the failing disk needs a C compiler and Linux")
    library = tmp_path_factory.mktemp("disk") / "disk.so"
    source = HERE / "failing_disk.c"
    command = [compiled.compiler(), "-shared", "-fPIC", "-O1", source, "-o", library, "-ldl"]
    subprocess.run(command, check=True)
    return library


def outcome_of(task, disk, what, stride=1):
    """What `failing_disk.py` says of a task: a reference without failure, and the points."""
    environment = os.environ | dict(LD_PRELOAD=str(disk), PYTHONPATH=str(HERE))
    command = [sys.executable, str(HERE / "failing_disk.py"), task, str(disk), what, str(stride)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


# One test per task: pytest-xdist would run the task again for each test on another worker.
@pytest.mark.parametrize("task", TASKS)
def test_a_failing_disk_loses_nothing_and_is_one_sentence(task, disk, thorough):
    outcome = outcome_of(task, disk, "disk", stride=1 if thorough else 5)
    assert all(outcome["points"]), "a process died"
    for error in errors_of(**outcome):
        assert error.startswith("OSError: "), error
    check_errors_are_one_sentence(**outcome)
    check_nothing_is_half_made(**outcome)
    check_the_same_call_goes_on(**outcome)


@pytest.mark.parametrize("task", TASKS)
def test_missing_memory_loses_nothing_and_is_said_so(task, disk):
    outcome = outcome_of(task, disk, "memory")
    drives = task in ("campaign", "command")
    for error in errors_of(**outcome):
        # Pillow's encoder says "codec configuration error" for it.
        assert re.search("memory|alloc|MemoryError|codec", error), error
        assert error != DIED or drives
    check_errors_are_one_sentence(**outcome)
    # A campaign without some of its runs has files of other rows, under other names.
    names = [{*point["left"]} for point in (outcome["reference"], *outcome["points"])]
    for left, point in zip(names[1:], outcome["points"]):
        more = {name for name in left - names[0] if not (drives and name.endswith(".parquet"))}
        assert not more or point["first"]["error"] == DIED, more
    check_the_same_call_goes_on(**outcome, with_the_same_files=not drives)


def errors_of(reference, points):
    return [point["first"]["error"] for point in points if point["first"]["error"]]


def check_errors_are_one_sentence(reference, points):
    for error in errors_of(reference, points):
        assert "Traceback" not in error
    # Whoever says nothing has done all of it.
    for point in points:
        if point["first"]["error"] is None:
            assert point["first"]["result"] == reference["first"]["result"]


def check_nothing_is_half_made(reference, points):
    whole = reference["left"]
    for point in points:
        for file, digest in point["left"].items():
            assert whole.get(file) == digest, (point["k"], file)


def check_the_same_call_goes_on(reference, points, with_the_same_files=True):
    for point in points:
        assert point["again"]["error"] is None
        assert point["again"]["result"] == reference["again"]["result"]
        if with_the_same_files:
            assert set(point["finally_there"]) == set(reference["finally_there"])
