"""Each file operation fails in turn: nothing is lost, nothing is half-made, and one sentence says
what happened."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from failing_disk import TASKS

from rhec.core._casadi import compiled

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


@pytest.fixture(scope="module", params=TASKS)
def outcome(request, disk):
    environment = os.environ | dict(LD_PRELOAD=str(disk), PYTHONPATH=str(HERE))
    command = [sys.executable, str(HERE / "failing_disk.py"), request.param, str(disk)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_failing_disk_is_one_sentence(outcome):
    assert all(outcome["points"]), "a process died"
    errors = [point["first"]["error"] for point in outcome["points"]]
    for error in filter(None, errors):
        assert error.startswith("OSError: "), error
        assert "Traceback" not in error
    # Whoever says nothing has done all of it.
    for point in outcome["points"]:
        if point["first"]["error"] is None:
            assert point["first"]["result"] == outcome["reference"]["first"]["result"]


def test_a_failing_disk_leaves_nothing_half_made(outcome):
    whole = outcome["reference"]["left"]
    for point in outcome["points"]:
        for file, digest in point["left"].items():
            assert whole.get(file) == digest, (point["k"], file)


def test_after_a_failing_disk_the_same_call_goes_on(outcome):
    for point in outcome["points"]:
        assert point["again"]["error"] is None
        assert point["again"]["result"] == outcome["reference"]["again"]["result"]
        assert set(point["finally_there"]) == set(outcome["reference"]["finally_there"])
