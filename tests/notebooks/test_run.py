import base64
import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import nbformat
import papermill
import pytest
from helpers import NOTEBOOKS
from jupyter_server.services.contents.filemanager import FileContentsManager
from matplotlib_inline import backend_inline
from nbconvert import HTMLExporter
from nbformat import v4
from papermill.exceptions import PapermillExecutionError
from PIL import Image
from traitlets.config import PyFileConfigLoader

from notebooks import run as notebook
from notebooks.parameter_table import own_parameters, parameters_of
from notebooks.run import ParameterError, parameters
from rhec import style

CELL = """
from typing import Literal
from notebooks.run import real, whole

seed: int = 7  # as of rhec.Scenario
seeds: whole(2, 1000) = 20
speed_mps: float = 0.5  # [m/s] as of rhec.Scenario
delay_s: real(-10, 10) = 0
process_noise: Literal["printed", "prediction"] = "printed"
gains: list[real(0, 100)] = [1, 2.5]
is_robust: bool = False
file: str = "log.csv"
"""
ROOT = Path(__file__).parents[2]


def executed(cell=CELL, **injected):
    """Namespace of a notebook after its cell of parameters and the one that papermill adds."""
    namespace = {"In": ["", "%magic", cell]}
    exec(cell, namespace)
    return namespace | injected


@pytest.mark.parametrize(
    "name, value, sentence",
    [
        ("seeds", "9", "seeds was '9'; it should be a whole number"),
        ("seeds", 5000, "seeds was 5000; it should be at most 1000"),
        ("seed", -1, "seed was -1; it should be at least 0"),  # as a Scenario says
        ("delay_s", 11, "delay_s was 11; it should be at most 10"),
        (
            "process_noise",
            "guess",
            "process_noise was 'guess'; it should be 'printed' or 'prediction'",
        ),
        ("gains", [1, False], "gains[1] was False; it should be a number"),
        ("sed", 9, "sed was 9, but there is no such parameter; did you mean seed?"),
    ],
)
def test_a_refusal_says_what_was_given_and_what_may_be(name, value, sentence):
    with pytest.raises(ParameterError) as refusal:
        parameters(executed(**{name: value}))
    assert str(refusal.value) == sentence
    # Jupyter shows these lines in place of a traceback.
    assert refusal.value._render_traceback_() == [f"ParameterError: {sentence}"]


def test_values_within_the_types_pass():
    allowed = dict(seed=0, seeds=1000, speed_mps=1, gains=(), process_noise="prediction")
    parameters(executed(**allowed, is_robust=True))


def test_what_a_user_defines_when_ipython_starts_is_no_parameter(monkeypatch):
    monkeypatch.setattr(backend_inline, "set_matplotlib_formats", lambda *given, **options: None)
    ipython = SimpleNamespace(user_ns_hidden={"In": None, "mine": None})
    namespace = executed(mine=3, get_ipython=lambda: ipython)
    parameters(namespace)
    assert namespace["mine"] == 3


def test_the_cell_can_be_run_again():
    namespace = executed(sed=1, os=os, _private=0)
    with pytest.raises(ParameterError):
        parameters(namespace)
    parameters(namespace)  # the misspelt name is gone
    namespace["result"] = [1.0]  # the notebook's own
    parameters(namespace)


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_every_notebook_checks_its_parameters_and_the_table_has_them(path):
    cells = nbformat.read(path, 4).cells
    (tagged,) = (cell for cell in cells if "parameters" in cell.metadata.get("tags", ()))
    assert any("parameters(globals())" in cell.source for cell in cells)
    parameters(executed(tagged.source))
    defaults = {"__annotations__": {}}
    exec(tagged.source, defaults)
    found = {each.name: each for each in parameters_of(path)}
    assert [*found] == [*defaults["__annotations__"]]
    assert all(each.default == str(defaults[name]) for name, each in found.items())
    assert all(each.meaning and each.type for each in found.values())


def test_the_defaults_by_which_a_changed_notebook_is_known_are_those_of_the_notebooks():
    """`python -m notebooks.parameter_table` writes them."""
    assert json.loads(notebook.DEFAULTS.read_text()) == own_parameters()


@pytest.fixture
def as_it_is():
    """Figures after a test go where they went before."""
    yield
    style.set_changed("", {})


def cell_of(path):
    """The cell with the parameters of a notebook."""
    cells = nbformat.read(path, 4).cells
    return next(cell.source for cell in cells if "parameters" in cell.metadata.get("tags", ()))


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_no_notebook_with_other_parameters_writes_to_figures(path, as_it_is, monkeypatch, capsys):
    """Whether they are injected, or the cell itself is edited, and whoever runs it."""
    monkeypatch.delenv("RHEC_FIGURES", raising=False)
    monkeypatch.setattr(style, "FOLDER", Path("figures"))
    cell = cell_of(path)
    name, default = next(
        (key.partition(":")[0], value)
        for key, value in own_parameters()[path.stem].items()
        if "seed" in key or "fields" in key or "worlds" in key
    )
    assert re.search(rf"^{name}: .* = {default}\b", cell, re.M)
    edited = re.sub(rf"^({name}: .* = ){default}\b", rf"\g<1>{default + 2}", cell, flags=re.M)
    for namespace in (executed(cell, **{name: default + 2}), executed(edited)):
        parameters(executed(cell))
        assert style.set_changed("", {}) == Path("figures") and capsys.readouterr().out == ""
        parameters(namespace)
        told = capsys.readouterr().out
        assert told == (
            f"With {name} = {default + 2}: figures and tables go to "
            f"figures/{path.stem}/{name}={default + 2}\n"
        )


def toy(folder, source, tags=()):
    """A notebook of one cell of code; its path."""
    cell = v4.new_code_cell(source, metadata={"tags": [*tags]})
    nbformat.write(v4.new_notebook(cells=[cell]), folder / "toy.ipynb")
    return folder / "toy.ipynb"


@pytest.fixture
def command(monkeypatch):
    """The command line, a function of its words."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["notebook", *words])
        notebook.main()

    return run


def test_help_of_a_notebook_names_its_parameters(command, capsys):
    command("notebooks/03_scenario_a.ipynb", "--help")
    shown = capsys.readouterr().out
    assert "start_offset_m [m]: number, -5 to 5 (default: 1.0)" in shown
    assert "seeds: whole number, 2 to 1000 (default: 400)" in shown
    assert "process_noise: printed, consistent, prediction or tracking" in shown
    assert "-p seed 0" in shown
    command()
    assert "NOTEBOOK" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words, sentence",
    [
        (["toy.ipynb", "-p", "rhec", "1"], "rhec was 1, but there is no such parameter; did you "),
        (["none.ipynb"], "NOTEBOOK was none.ipynb; it must be an existing .ipynb file\n"),
        ([__file__], f"NOTEBOOK was {__file__}; it must be an existing .ipynb file\n"),
        (["toy.ipynb", "--output", "out"], "--output was out; it must be a file's name that ends "),
    ],
)
def test_the_runner_refuses_what_the_notebook_itself_uses_and_what_is_no_notebook(
    words, sentence, command, tmp_path, monkeypatch, capsys
):
    toy(tmp_path, "seed: int = 7", ["parameters"])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as refusal:
        command(*words)
    assert refusal.value.code == 2 and capsys.readouterr().err.startswith(sentence)


@pytest.mark.parametrize(
    "words, values, output",
    [
        (["notebooks/further/faults.ipynb"], {}, "further/faults.ipynb"),
        (["notebooks/02_equations.ipynb", "-p", "n", "3"], {"n": 3}, "02_equations-custom.ipynb"),
    ],
)
def test_an_executed_notebook_goes_where_make_looks_and_one_with_other_values_beside_it(
    words, values, output, command, monkeypatch, capsys
):
    ran = []
    monkeypatch.setattr(notebook, "run", lambda *given: ran.append(given[1:]))
    command(*words)
    assert ran == [(values, ROOT / "build/notebooks" / output)]


def test_every_notebook_is_made_by_make():
    makefile = (ROOT / "Makefile").read_text().replace("\\\n", " ")
    names = " ".join(re.findall("^(?:FIGURES|STUDIES) := (.*)$", makefile, re.M)).split()
    assert {*names} >= {each.stem for each in ROOT.glob("notebooks/*.ipynb")}


def test_outputs_that_jupyterlab_saves_are_no_edit(command, tmp_path, monkeypatch):
    edit = f"from pathlib import Path\nPath({str(tmp_path / 'toy.ipynb')!r}).touch()"
    path = toy(tmp_path, edit)
    output = tmp_path / "out.ipynb"
    words = str(path), "--output", str(output)
    command(*words)
    # For make the output is older than what was edited while it ran.
    assert output.stat().st_mtime_ns < path.stat().st_mtime_ns
    made = output.read_bytes()
    shutil.copy(output, path)
    command(*words, "--if-edited")
    assert output.read_bytes() == made and output.stat().st_mtime >= path.stat().st_mtime
    edited = []
    monkeypatch.setattr(notebook, "run", lambda *given: edited.append(given))
    toy(tmp_path, "1 + 2")
    command(*words, "--if-edited")
    assert edited == [(path, {}, output)]


@pytest.mark.parametrize(
    "values, asked, figures",
    [({}, None, None), ({"seed": 3}, None, "out"), ({"seed": 3}, "mine", "mine")],
)
def test_figures_of_other_values_go_beside_the_output_or_where_their_user_wants_them(
    values, asked, figures, monkeypatch
):
    """Of the notebook's own values `make clean` has a list; what others made stays."""
    monkeypatch.delenv("RHEC_FIGURES", raising=False)
    if asked:
        monkeypatch.setenv("RHEC_FIGURES", asked)
    before = dict(os.environ)
    with notebook._environment(Path("toy.ipynb"), values, Path("out.ipynb")):
        assert os.environ.get("RHEC_FIGURES") == figures
        assert ("RHEC_MADE" in os.environ) == (figures is None)
        assert os.environ["RHEC_NOTEBOOK"] == "toy.ipynb"
    assert dict(os.environ) == before


def test_a_notebook_that_takes_long_says_below_which_heading_it_is(monkeypatch, capfd):
    monkeypatch.setattr(notebook, "_TELL_S", 0.2)
    cells = v4.new_markdown_cell("# A heading\nand words"), v4.new_code_cell("# a comment")
    with notebook._telling("toy") as on_cell_start:
        for place, cell in enumerate(cells):
            on_cell_start(cell, place)
        time.sleep(0.5)
    told = capfd.readouterr().out
    assert told.endswith("\n") and {*told.splitlines()} == {"toy: 0 s, at “A heading”"}
    time.sleep(0.3)
    assert capfd.readouterr().out == ""


def test_a_kernel_that_dies_before_the_first_cell_starts_again_and_no_other_does(monkeypatch):
    """Three times, as papermill tells of it."""
    begun = []

    def execute(*_, on_cell_start, **options):
        begun.append(0)
        if len(begun) == cell_in:
            on_cell_start(cell="its first", cell_index=0)
        if len(begun) < alive:
            raise RuntimeError("Kernel died")
        return "executed"

    monkeypatch.setattr(papermill, "execute_notebook", execute)
    for cell_in, alive, starts in ((3, 3, 3), (1, 3, 1), (9, 4, 3)):
        begun.clear()
        dies = alive > starts
        with pytest.raises(RuntimeError) if dies else contextlib.nullcontext():
            assert notebook._executed(Path("toy.ipynb"), {}, lambda *_: None) == "executed"
        assert len(begun) == starts


@pytest.mark.parametrize(
    "error, code, said",
    [
        (("OSError", "[Errno 28] No space left: 'fig.png'"), 1, "toy: [Errno 28] No space left: "),
        (("KeyboardInterrupt", ""), 130, "toy: interrupted\n"),
        (("ParameterError", "seed was -1; it should be more"), 2, "seed was -1; it should be more"),
        (("KeyError", "'x'"), 1, "\n-----"),
    ],
)
def test_a_cell_that_fails_is_told_in_a_sentence_where_it_can_be(
    error, code, said, command, tmp_path, monkeypatch, capsys
):
    def run(*given):
        raise PapermillExecutionError(0, 1, "a cell", *error, [])

    monkeypatch.setattr(notebook, "run", run)
    with pytest.raises(SystemExit) as ended:
        command(str(toy(tmp_path, "1 + 1")))
    assert ended.value.code == code and capsys.readouterr().err.startswith(said)


def test_pictures_have_the_captions_above_them_as_alternative_texts():
    """A cell may describe its own; nbconvert writes them into its pages."""
    caption = "**Figure 1.** The `error` by [GNSS](there.md)." + " More." * 99
    caption = f"**Figure 0.** Another.\n\n{caption}\n\nWords after."
    pixels = io.BytesIO()
    Image.new("L", (9, 9)).save(pixels, "png")
    png = {"image/png": base64.b64encode(pixels.getvalue()).decode()}
    outputs = [
        v4.new_output("display_data", png, metadata=metadata)
        for metadata in ({}, {"image/png": {"alt": "its own"}})
    ]
    cells = [v4.new_markdown_cell(caption), v4.new_code_cell("new('L')", outputs=outputs)]
    executed = v4.new_notebook(cells=cells)
    notebook._describe_pictures(executed)
    page, _ = HTMLExporter().from_notebook_node(executed)
    one, other = re.findall(r'<img alt="(.*?)"', page)
    assert one.startswith("Figure 1. The error by GNSS. More.") and len(one) <= 250
    assert other == "its own" and "No description has been provided" not in page


def test_make_says_whether_anything_but_the_notebook_changed(tmp_path):
    """Only then do equal cells mean equal outputs."""
    for name in ("Makefile", "environment.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("rhec", "notebooks", "build/notebooks", ".venv"):
        (tmp_path / name).mkdir(parents=True)
    module = tmp_path / "notebooks/module.py"
    path = tmp_path / "notebooks/02_equations.ipynb"
    made = tmp_path / "build/notebooks/02_equations.ipynb"
    for age, each in enumerate([made, path, module, tmp_path / ".venv/ready"]):
        each.touch()
        os.utime(each, (10**9 + age, 10**9 + age))
    for name in ("environment.txt", "pyproject.toml"):
        os.utime(tmp_path / name, (0, 0))

    def command():
        line = ["make", "-n", "build/notebooks/02_equations.ipynb"]
        return subprocess.run(line, cwd=tmp_path, capture_output=True, text=True).stdout

    assert "notebooks.run" in command() and "--if-edited" not in command()
    os.utime(module, (0, 0))
    assert "--if-edited" in command()
    made.touch()
    assert "notebooks.run" not in command()


def test_jupyterlab_saves_a_notebook_that_was_run_as_git_holds_it(tmp_path):
    config = PyFileConfigLoader("jupyter_server_config.py", str(ROOT / ".jupyter")).load_config()
    contents = FileContentsManager(config=config, root_dir=str(tmp_path))
    held = (ROOT / "notebooks/05_computation_times.ipynb").read_text(encoding="utf-8")
    found = nbformat.reads(held, 4)
    found.metadata["language_info"] = dict(name="python", version="3.13.1")
    for count, cell in enumerate(cell for cell in found.cells if cell.cell_type == "code"):
        cell.execution_count = count + 1
        cell.outputs = [v4.new_output("stream", text="a result\n")]
    (tmp_path / "notebooks").mkdir()
    saved = {}
    for name in ("notebooks/one.ipynb", "mine.ipynb"):
        contents.save(dict(type="notebook", format="json", content=found), name)
        saved[name] = (tmp_path / name).read_text(encoding="utf-8")
    assert saved["notebooks/one.ipynb"] == held
    assert "a result" in saved["mine.ipynb"]
