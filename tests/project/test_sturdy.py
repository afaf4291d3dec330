"""What a careless user, a hostile file name and a failing machine do to make and what it makes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import nbformat
import pandas as pd
import pytest
from matplotlib.figure import Figure
from nbformat import v4

from rhec.workbench import report, results
from rhec.workbench.plots import style

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
    assert arguments[3:] == ["-p", "q", "[1,1,1]", '["x_m=east", "y"]']


# Files in figures/


@needs_make
def test_clean_takes_no_name_from_the_environment(checkout):
    (checkout / "figures").mkdir()
    theirs = [checkout / f"figures/{name}" for name in ("thesis.tex", "bench_mine.tex")]
    for file in theirs:
        file.touch()
    (checkout / "figures/bench_step.csv").touch()
    run_make(checkout, "clean", MADE="figures/thesis.tex")
    run_make(checkout, "clean-benchmarks")
    assert all(file.exists() for file in theirs)
    assert not (checkout / "figures/bench_step.csv").exists()


def test_an_interrupted_picture_leaves_the_old_one(tmp_path, monkeypatch):
    figure = Figure()
    png = style.save(figure, "one", folder=tmp_path)
    whole = png.read_bytes(), png.with_suffix(".pdf").read_bytes()

    def interrupted(self, file, **options):
        Path(file).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", interrupted)
    with pytest.raises(KeyboardInterrupt):
        style.save(figure, "one", folder=tmp_path)
    assert (png.read_bytes(), png.with_suffix(".pdf").read_bytes()) == whole
    assert sorted(file.name for file in tmp_path.iterdir()) == ["one.pdf", "one.png"]


def test_an_interrupted_table_leaves_the_old_one(tmp_path, monkeypatch):
    table = pd.DataFrame(dict(a=[1]))
    csv = style.save_table(table, "one", "One", tmp_path)
    whole = csv.read_bytes()

    def interrupted(self, file, **options):
        Path(file).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(pd.DataFrame, "to_csv", interrupted)
    with pytest.raises(KeyboardInterrupt):
        style.save_table(table, "one", "One", tmp_path)
    assert csv.read_bytes() == whole
    assert sorted(file.name for file in tmp_path.iterdir()) == ["one.csv", "one.tex"]


FAILING = """
from pathlib import Path
Path("../figures/whole.png").write_text("made")
Path("../figures/half.png.unfinished").write_text("ha")
raise RuntimeError("as if interrupted")
"""


@needs_make
def test_clean_knows_what_an_interrupted_notebook_made(checkout):
    shutil.copytree(ROOT / "rhec", checkout / "rhec", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in ("notebooks", "figures"):
        (checkout / folder).mkdir()
    story = v4.new_notebook(cells=[v4.new_code_cell(FAILING)])
    nbformat.write(story, checkout / "notebooks/03_scenario_a.ipynb")
    command = [sys.executable, "-m", "rhec.workbench.notebook", "notebooks/03_scenario_a.ipynb"]
    environment = os.environ | dict(PYTHONPATH=str(checkout))
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and "as if interrupted" in done.stderr
    assert [file.name for file in (checkout / "figures").iterdir()] == ["whole.png"]
    run_make(checkout, "clean")
    assert not (checkout / "figures").exists()
    assert not (checkout / "build/notebooks").exists()


THEIRS = {
    "latin.csv": "ä;b".encode("latin-1"),
    "empty.csv": b"",
    "open.csv": b'"open\n1',
    "broken.png": b"no picture",
    "private.txt": b"secret",
}


@pytest.fixture
def figures(tmp_path):
    """A folder of figures with a person's own files among them."""
    folder = tmp_path / "figures"
    style.save_table(pd.DataFrame(dict(a=[1])), "table_one", "One", folder)
    style.save(Figure(), "fig99_one", folder=folder)
    for name, content in THEIRS.items():
        (folder / name).write_bytes(content)
    return folder


def test_results_read_no_table_of_ones_own(figures):
    for page in results.PAGES:
        (figures.parent / page).parent.mkdir(exist_ok=True)
        (figures.parent / page).write_text("# A page\n")
    results.main(figures.parent)


def test_the_report_publishes_what_make_made_alone(figures, tmp_path, monkeypatch):
    monkeypatch.setattr(report, "ROOT", tmp_path)
    story = tmp_path / "build/one.ipynb"
    story.parent.mkdir()
    nbformat.write(v4.new_notebook(cells=[v4.new_markdown_cell("# One")]), story)
    made = ["fig99_one.pdf", "fig99_one.png", "table_one.csv", "table_one.tex"]
    files = " ".join(f"figures/{name}" for name in made)
    story.with_suffix(".d").write_text(f"build/one.ipynb: x\nx:\nMADE += {files}\n")
    published = report.made_by([story], figures)
    assert published == {*made}
    monkeypatch.setattr(report, "ROOT", ROOT)
    report._lay_out(tmp_path / "source", [story], figures, False, published)
    copied = [file.name for file in (tmp_path / "source/figures").iterdir() if file.is_file()]
    assert sorted(copied) == made


def test_an_installed_package_writes_into_the_working_folder(tmp_path):
    packages = tmp_path / "site-packages"
    shutil.copytree(ROOT / "rhec", packages / "rhec", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "work").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", "from rhec.workbench.plots import style; print(style.FOLDER)"],
        cwd=tmp_path / "work",
        env=os.environ | dict(PYTHONPATH=str(packages)),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == str(tmp_path / "work/figures")
