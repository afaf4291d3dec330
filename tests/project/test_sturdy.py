"""What a careless user, a hostile file name and a failing machine do to make and what it makes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from nbformat import v4

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
def test_the_id_of_a_claim_is_data(checkout):
    for text in HOSTILE:
        assert run_make(checkout, "claim", f"ID={text}")[-1] == text
        assert run_make(checkout, "claim", ID=text)[-1] == text
        assert run_make(checkout, "claim", f"id={text}")[-1] == text
        assert not (checkout / "stolen").exists(), text


@needs_make
@pytest.mark.parametrize("variable", ["WHAT", "PYTHON_CPU_COUNT", "PYTHON"])
def test_nothing_in_a_variable_is_executed(checkout, variable):
    if variable == "PYTHON":  # which is used to set up .venv alone
        (checkout / ".venv/ready").unlink()
    for text in HOSTILE[:4]:
        run_make(checkout, "test", f"{variable}={text}")
        assert not (checkout / "stolen").exists(), text


@needs_make
def test_arguments_in_what_are_quoted_as_in_a_shell(checkout):
    arguments = run_make(checkout, "test", """WHAT=-k '[1,1,1] or y' tests/core""")
    assert arguments[-3:] == ["-k", "[1,1,1] or y", "tests/core"]


@needs_make
def test_an_environment_of_another_checkout_is_not_changed(checkout, tmp_path):
    other = (checkout / ".venv").rename(tmp_path / "other")
    (other / "ready").unlink()
    before = sorted(other.rglob("*"))
    (checkout / ".venv").symlink_to(other)
    environment = os.environ | dict(PYTHON=sys.executable)
    command = ["make", "-s", "test"]
    made = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    assert made.returncode and ".venv is a link to the environment of another" in made.stderr
    assert sorted(other.rglob("*")) == before


# Files in figures/


@needs_make
def test_clean_removes_what_was_made_alone(checkout):
    (checkout / "figures").mkdir()
    (checkout / "build").mkdir()
    theirs = checkout / "figures/thesis.tex"
    made = checkout / "figures/fig99 $(touch stolen).png"
    theirs.touch()
    made.touch()
    (checkout / "build/made").write_text(f"{made.relative_to(checkout)}\n")
    run_make(checkout, "clean", MADE="figures/thesis.tex")
    assert theirs.exists() and not made.exists() and not (checkout / "stolen").exists()


FAILING = """
from matplotlib.figure import Figure
from rhec import style
style.save(Figure(), "whole")
raise RuntimeError("as if interrupted")
"""


@pytest.mark.nightly
@needs_make
def test_clean_knows_what_an_interrupted_notebook_made(checkout):
    for package in ("rhec", "notebooks"):
        ignored = shutil.ignore_patterns("__pycache__", "*.ipynb")
        shutil.copytree(ROOT / package, checkout / package, ignore=ignored)
    story = v4.new_notebook(cells=[v4.new_code_cell(FAILING)])
    nbformat.write(story, checkout / "notebooks/03_scenario_a.ipynb")
    command = [sys.executable, "-m", "notebooks.run", "notebooks/03_scenario_a.ipynb"]
    # This Python's rhec is that of another checkout, as if .venv were linked or copied.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and "as if interrupted" in done.stderr
    made = sorted(file.name for file in (checkout / "figures").iterdir())
    assert made == ["whole.pdf", "whole.png"]
    run_make(checkout, "clean")
    assert not [*(checkout / "figures").iterdir()]
    assert not (checkout / "build/notebooks").exists()


@pytest.mark.nightly
def test_an_installed_package_writes_into_the_working_folder(tmp_path):
    packages = tmp_path / "site-packages"
    shutil.copytree(ROOT / "rhec", packages / "rhec", ignore=shutil.ignore_patterns("__pycache__"))
    work = tmp_path / "work"
    work.mkdir()
    command = [sys.executable, "-c", "from rhec import style; print(style.FOLDER)"]
    environment = os.environ | dict(PYTHONPATH=str(packages))
    printed = subprocess.check_output(command, cwd=work, env=environment, text=True)
    assert printed.strip() == str(work / "figures")
