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

BUILD = """
import rhec
model = rhec.Model(
    states=("x_m",), inputs=("v_mps",), parameters={{}}, outputs=("x_m", "v_mps"),
    f=lambda x, u, p: u,
)
one = (1.0,)
ekf = rhec.EKF(
    model=model, dt={dt}, sigma_v=(1.0, 1.0), sigma_w=one, guess=one, sigma_guess=one
)
ekf.prepare()
print(ekf.feedback((2.0, 3.0)))
"""
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
def test_processes_may_build_the_same_at_once(tmp_path):
    first, second, third = [start(tmp_path) for _ in range(3)]
    assert answer(first) == answer(second) == answer(third)
    assert len(libraries(tmp_path)) == len(list(tmp_path.iterdir())) == 1


@needs_compiler
def test_one_of_several_processes_compiles(tmp_path):
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
def test_a_library_is_reused(tmp_path):
    answer(start(tmp_path))
    (library,) = tmp_path.glob("*/library.so")
    made = library.stat().st_mtime_ns
    answer(start(tmp_path))
    assert library.stat().st_mtime_ns == made


@needs_compiler
def test_a_compilation_is_announced_once_at_a_terminal(tmp_path):
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
def test_an_edit_compiles_again_only_where_c_is_made(tmp_path):
    package = tmp_path / "rhec"
    shutil.copytree(Path(rhec.__file__).parent, package)
    answer(start(tmp_path / "cache", package=tmp_path))
    for room in ("plots", "studies", "workbench", "campaigns", "logs"):
        for source in (package / room).glob("**/*.py"):
            source.write_text(source.read_text() + "# another colour\n")
    answer(start(tmp_path / "cache", package=tmp_path))
    assert len(libraries(tmp_path / "cache")) == 1
    rooms = ("model", "solver", "estimator", "controller", "tracked_robot", "extensions")
    for edited, room in enumerate(rooms, 2):
        source = next(each for each in (package / room).glob("*.py") if each.stem != "__init__")
        source.write_text(source.read_text() + "# another idea\n")
        answer(start(tmp_path / "cache", package=tmp_path))
        assert len(libraries(tmp_path / "cache")) == edited


@needs_compiler
def test_a_killed_build_is_built_again(tmp_path):
    compiler, started, cache = tmp_path / "cc", tmp_path / "started", tmp_path / "cache"
    compiler.write_text(
        f"#!/bin/sh\n[ -e {started} ] || "
        f"{{ touch {started}; echo rubbish > library.so; sleep 60; }}\n"
        'exec cc "$@"\n'
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
def test_a_failed_build_raises_and_leaves_no_files(tmp_path):
    process = start(tmp_path / "cache", CC=shutil.which("false"))
    _, err = process.communicate(timeout=60)
    assert process.returncode != 0 and "false" in err
    assert list((tmp_path / "cache").iterdir()) == []


def test_without_a_compiler_results_agree_and_one_line_says_so(tmp_path):
    process = start(tmp_path, PATH="/nowhere", CC="cc")
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0 and err.count("no C compiler found") == 1
    assert list(tmp_path.iterdir()) == []
    if shutil.which("cc"):
        assert out == answer(start(tmp_path))


def test_a_buffered_function_computes_what_the_function_does():
    import casadi as ca

    matrix, vector = ca.SX.sym("matrix", ca.Sparsity.lower(3)), ca.SX.sym("vector", 3)
    function = ca.Function(
        "f",
        [matrix, vector],
        [matrix @ vector, ca.sumsqr(vector)],
        ["matrix", "vector"],
        ["product", "norm"],
    )
    buffered = compiled.BufferedFunction(function)
    lower, ones = np.arange(1.0, 7.0), np.array([1.0, 10.0, 100.0])
    buffered.set(matrix=lower, vector=ones)
    buffered.call()
    np.testing.assert_array_equal(buffered.results["product"], [1, 42, 653])
    mine, out = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    buffered.read_from("vector", mine)
    buffered.write_to("product", out)
    buffered.call()
    np.testing.assert_array_equal(out, [1, 2, 3])
    assert buffered.results["norm"] == 1
