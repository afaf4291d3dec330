"""What a careless user, a hostile file name and a failing machine can do to make and its products."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
needs_make = pytest.mark.skipif(not shutil.which("make"), reason="there is no make")

# Stands in for the project's Python: it executes `-c`, and else notes its arguments, one a line.
PYTHON = f"""#!/bin/sh
if [ "$1" = -c ]; then
    shift
    exec {sys.executable} -c 'import sys; sys.executable = ".venv/bin/python"; \
exec(sys.argv.pop(1))' "$@"
fi
printf '%s\\n' "$@" > arguments
"""


@pytest.fixture
def checkout(tmp_path):
    """The Makefile with a Python that only notes how it was called."""
    folder = tmp_path / "checkout"
    (folder / ".venv/bin").mkdir(parents=True)
    for name in ("Makefile", ".gitignore", "environment.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    python = folder / ".venv/bin/python"
    python.write_text(PYTHON)
    python.chmod(0o755)
    (folder / ".venv/ready").touch()
    return folder


def run_make(folder, *arguments, **environment):
    """Run make, and return what the project's Python was called with."""
    (folder / "arguments").unlink(missing_ok=True)
    subprocess.run(
        ["make", "-s", *arguments],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        timeout=60,
    )
    noted = folder / "arguments"
    return noted.read_text().splitlines() if noted.exists() else None


HOSTILE = ["$(shell touch stolen)", "; touch stolen", "`touch stolen`", "$$(touch stolen)"]
HOSTILE += ['" ; touch stolen ; "', "' ; touch stolen ; '", "a b $HOME"]


@needs_make
@pytest.mark.parametrize("text", HOSTILE)
@pytest.mark.parametrize("goal", ["replay", "calibrate"])
def test_a_logs_name_is_data(checkout, goal, text):
    name = f"logs/a{text}.csv"
    assert run_make(checkout, goal, f"LOG={name}")[-1] == name
    assert run_make(checkout, goal, LOG=name)[-1] == name
    assert not (checkout / "stolen").exists()


@needs_make
@pytest.mark.parametrize("text", HOSTILE)
@pytest.mark.parametrize(
    "goal, variable", [("soak", "SAMPLES"), ("storm", "RUNS"), ("recordings", "HOST")]
)
def test_every_variable_is_data(checkout, goal, variable, text):
    assert run_make(checkout, goal, f"{variable}={text}")[-1] == text
    assert not (checkout / "stolen").exists()


@needs_make
@pytest.mark.parametrize("variable", ["WHAT", "PYTHON", "PYTHON_CPU_COUNT"])
@pytest.mark.parametrize("text", HOSTILE[:4])
def test_nothing_in_a_variable_is_executed(checkout, variable, text):
    if variable == "PYTHON":  # which is used to set up .venv alone
        (checkout / ".venv/ready").unlink()
    run_make(checkout, "campaign", f"{variable}={text}")
    assert not (checkout / "stolen").exists()


@needs_make
def test_arguments_in_what_are_quoted_as_in_a_shell(checkout):
    arguments = run_make(checkout, "campaign", """WHAT=-p q [1,1,1] '["x_m=east", "y"]'""")
    assert arguments[2:] == ["-p", "q", "[1,1,1]", '["x_m=east", "y"]']
