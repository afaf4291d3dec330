"""Each file operation fails in turn: nothing is lost, nothing is half-made, and one sentence says
what happened.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from failing_disk import TASKS

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


@pytest.mark.parametrize("task", TASKS)
def test_a_failing_disk_loses_nothing_and_is_one_sentence(task, disk):
    """One test a task, whose points share its start. Whoever says nothing has done all of it."""
    environment = os.environ | dict(LD_PRELOAD=str(disk), PYTHONPATH=str(HERE))
    command = [sys.executable, HERE / "failing_disk.py", task, disk]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    outcome = json.loads(done.stdout)
    reference, points = outcome["reference"], outcome["points"]
    assert all(points), "a process died"
    for point in points:
        first, again = point["first"], point["again"]
        if first["error"] is None:
            assert first["result"] == reference["first"]["result"]
        else:
            assert first["error"].startswith("OSError: ") and "Traceback" not in first["error"]
        for file, digest in point["left"].items():
            assert reference["left"].get(file) == digest, (point["k"], file)
        assert again["error"] is None and again["result"] == reference["again"]["result"]
        assert set(point["finally_there"]) == set(reference["finally_there"])
