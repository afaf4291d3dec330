"""Compiled Functions: found again, never out of date, whoever builds at the same time or is killed
doing so.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import rhec
from rhec._casadi import compiled

BUILD = "from rhec._casadi import compiled; from rhec.estimator import ekf; f = compiled.load(ekf.build_step, {dt})['step']; print(f(memory=[1]*22, V=[1]*4)['estimate'])"
needs_compiler = pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")


def start(cache, dt=0.2, package=Path(rhec.__file__).parents[1], **environment):
    """A process of its own that builds the EKF."""
    return subprocess.Popen(
        [sys.executable, "-c", BUILD.format(dt=dt)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        cwd=package,
        env=os.environ | dict(RHEC_CACHE=str(cache), PYTHONPATH=str(package)) | environment,
    )


def answer(process):
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return out


def libraries(cache):
    return sorted(path.parent.name for path in cache.glob("*/library.so"))


@needs_compiler
def test_processes_that_build_the_same_at_once_both_succeed(tmp_path):
    first, second, third = [start(tmp_path) for _ in range(3)]
    assert answer(first) == answer(second) == answer(third)
    assert len(libraries(tmp_path)) == len(list(tmp_path.iterdir())) == 1


@needs_compiler
def test_only_one_of_them_compiles(tmp_path):
    compiler, calls = tmp_path / "cc", tmp_path / "calls"
    compiler.write_text(f'#!/bin/sh\necho once >> {calls}\nexec cc "$@"\n')
    compiler.chmod(0o755)
    assert (
        len(
            {
                answer(process)
                for process in [start(tmp_path / "cache", CC=str(compiler)) for _ in range(3)]
            }
        )
        == 1
    )
    assert calls.read_text() == "once\n"


@needs_compiler
def test_what_is_built_is_found_again(tmp_path):
    answer(start(tmp_path))
    (library,) = tmp_path.glob("*/library.so")
    made = library.stat().st_mtime_ns
    answer(start(tmp_path))
    assert library.stat().st_mtime_ns == made


@needs_compiler
def test_whoever_waits_at_a_terminal_is_told_what_for_once(tmp_path):
    terminal, stderr = os.openpty()
    build = [sys.executable, "-c", BUILD.format(dt=0.2)]
    for _ in range(2):
        subprocess.run(
            build,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
            env=os.environ | dict(RHEC_CACHE=str(tmp_path / "one")),
            check=True,
        )
    assert os.read(terminal, 1000).decode().splitlines() == [
        "rhec: compiling the ekf, once (some seconds)"
    ]
    quiet = subprocess.run(
        build,
        capture_output=True,
        env=os.environ | dict(RHEC_CACHE=str(tmp_path / "two")),
        check=True,
    )
    assert quiet.stderr == b""


@needs_compiler
def test_another_structure_or_another_source_is_another_library(tmp_path):
    answer(start(tmp_path / "cache"))
    answer(start(tmp_path / "cache", dt=0.1))
    assert len(libraries(tmp_path / "cache")) == 2
    shutil.copytree(
        Path(rhec.__file__).parent, tmp_path / "rhec", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copytree(Path(rhec.__file__).parents[1] / "data", tmp_path / "data")
    answer(start(tmp_path / "cache", package=tmp_path))
    assert len(libraries(tmp_path / "cache")) == 2  # where it lies does not matter
    with open(tmp_path / "rhec" / "estimator" / "ekf.py", "a") as source:
        source.write("# a new idea\n")
    answer(start(tmp_path / "cache", package=tmp_path))
    assert len(libraries(tmp_path / "cache")) == 3


@needs_compiler
def test_a_killed_build_harms_no_later_one(tmp_path):
    compiler, started, cache = tmp_path / "cc", tmp_path / "started", tmp_path / "cache"
    compiler.write_text(
        f'#!/bin/sh\n[ -e {started} ] || {{ touch {started}; echo rubbish > library.so; sleep 60; }}\nexec cc "$@"\n'
    )
    compiler.chmod(0o755)
    killed = start(cache, CC=str(compiler))
    while not started.exists():
        assert killed.poll() is None, killed.communicate()
        time.sleep(0.01)
    time.sleep(0.1)
    os.killpg(killed.pid, signal.SIGKILL)
    killed.communicate()
    assert {path.name[:9] for path in cache.iterdir()} == {"building-"}
    answer(start(cache, CC=str(compiler)))
    assert len([name for name in libraries(cache) if not name.startswith("building-")]) == 1


@needs_compiler
def test_a_failed_build_says_so_and_leaves_nothing(tmp_path):
    process = start(tmp_path / "cache", CC=shutil.which("false"))
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0 and "false" in err
    assert list((tmp_path / "cache").iterdir()) == []


def test_without_a_compiler_it_works_and_says_so_once(tmp_path):
    process = start(tmp_path, PATH="/nowhere", CC="cc")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0 and err.count("no C compiler found") == 1
    assert list(tmp_path.iterdir()) == []
    if shutil.which("cc"):
        assert out == answer(start(tmp_path))


def test_a_function_bound_to_arrays_is_the_function():
    import casadi as ca

    matrix, vector = ca.SX.sym("matrix", ca.Sparsity.lower(3)), ca.SX.sym("vector", 3)
    function = ca.Function(
        "f",
        [matrix, vector],
        [matrix @ vector, ca.sumsqr(vector)],
        ["matrix", "vector"],
        ["product", "norm"],
    )
    bound = compiled.BufferedFunction(function)
    lower, ones = np.arange(1.0, 7.0), np.array([1.0, 10.0, 100.0])
    bound.set(matrix=lower, vector=ones)
    bound.call()
    np.testing.assert_array_equal(bound.results["product"], [1, 42, 653])
    mine, out = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    bound.read_from("vector", mine)
    bound.write_to("product", out)
    bound.call()
    np.testing.assert_array_equal(out, [1, 2, 3])
    assert bound.results["norm"] == 1
