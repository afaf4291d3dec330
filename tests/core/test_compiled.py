"""Compiled Functions: found again, never out of date, whoever builds at the same time or is killed
doing so.
"""

import fcntl
import functools
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import casadi as ca
import pytest

import rhec
from rhec.core._casadi import cache, compiled
from rhec.core.lanes import lanes

BUILD = """
import rhec
model = rhec.Model(states="x_m", inputs="v_mps", outputs=("x_m", "v_mps"), f=lambda x, u, p: u)
one = (1.0,)
ekf = rhec.EKF(model=model, dt=0.2, sigma_v=(1.0, 1.0), sigma_w=one, guess=one, sigma_guess=one)
print(ekf.step((2.0, 3.0)))
"""
needs_compiler = pytest.mark.skipif(not shutil.which("cc"), reason="there is no C compiler")


@needs_compiler
def test_one_of_several_processes_compiles_into_a_private_cache(tmp_path):
    compiler, calls = tmp_path / "cc", tmp_path / "calls"
    compiler.write_text(f'#!/bin/sh\n[ "$1" = --version ] || echo once >> {calls}\nexec cc "$@"\n')
    compiler.chmod(0o755)
    environment = os.environ | dict(RHEC_CACHE=str(tmp_path / "cache"), CC=str(compiler))
    command = [sys.executable, "-c", BUILD]
    options = dict(cwd=Path(rhec.__file__).parents[1], env=environment, stdout=subprocess.PIPE)
    processes = [subprocess.Popen(command, **options) for _ in range(2)]
    answers = [process.communicate(timeout=60)[0] for process in processes]
    assert answers[0] == answers[1] != b""
    assert calls.read_text() == "once\n"
    assert (tmp_path / "cache").stat().st_mode & 0o777 == 0o700


def test_a_lock_is_that_of_the_file_that_is_there(tmp_path, monkeypatch):
    """Who waited for a lock whose file its holder removed waits for that of the next file."""
    lock = tmp_path / "lock"
    taken = []

    def flock(file, operation):
        take(file, operation)
        if not taken:
            lock.unlink()
        taken.append(file)

    take = fcntl.flock
    monkeypatch.setattr(fcntl, "flock", flock)
    with cache.locked(lock):
        assert len(taken) == 2
        with lock.open("a") as other, pytest.raises(BlockingIOError):
            take(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    assert not lock.exists()


def test_nothing_but_sources_that_make_functions_makes_another_digest(tmp_path, monkeypatch):
    """Where they lie does not matter, nor what editors and Python leave beside them."""
    for name in ("one", "other"):
        folder = tmp_path / name / "core"
        for place in ("estimator", ".ipynb_checkpoints", "__pycache__"):
            (folder / place).mkdir(parents=True)
        (folder / "estimator/ekf.py").write_text("old")
    (folder / ".ipynb_checkpoints/ekf-checkpoint.py").write_text("older")
    (folder / "__pycache__/ekf.pyc").write_text("compiled")
    digests = []
    for name, idea in (("one", "old"), ("other", "old"), ("other", "new")):
        monkeypatch.setattr(compiled, "_PACKAGE", tmp_path / name)
        (tmp_path / name / "core/estimator/ekf.py").write_text(idea)
        digests.append(compiled.source_digest.__wrapped__())
    assert digests[0] == digests[1] != digests[2]


# A compiler, a disk or a cache that fails is no reason to fail

OTHER_CACHE = "rhec: compiled code is kept in "
VIRTUAL_MACHINE = "on CasADi's virtual machine the results are the same, about five times slower\n"


def build_increment():
    x = ca.SX.sym("x")
    return dict(increment=ca.Function("increment", [x], [x + 1]))


@pytest.fixture
def said(tmp_path, monkeypatch, capsys):
    """Loads a Function, as a process that has not compiled yet, and returns what it says."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "elsewhere"))
    monkeypatch.setattr(compiled, "_failed", set())
    monkeypatch.setattr(compiled, "_working_compiler", compiled._working_compiler.__wrapped__)
    monkeypatch.setattr(cache, "warn_once", functools.cache(cache.warn_once.__wrapped__))

    def load():
        for _ in range(2):
            functions = compiled.load.__wrapped__(build_increment)
            assert functions["increment"](1.0) == 2.0
        return capsys.readouterr().err

    return load


FAILING = {
    "finds no header": """[ "$1" = --version ] || { echo "x.h:1: error: no y.h" >&2; exit 1; }""",
    "says no": "exit 1",
    "dies": "kill -9 $$",
    "dies at work": '[ "$1" = --version ] || kill -9 $$',
    "is no program": None,
}


@pytest.mark.parametrize("how", FAILING)
def test_a_compiler_that_fails_leaves_the_virtual_machine_and_no_files(
    tmp_path, monkeypatch, said, how
):
    compiler = tmp_path / "cc"
    compiler.write_text(f"#!/bin/sh\n{FAILING[how]}\n" if FAILING[how] else "rubbish")
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", str(compiler))
    line = said()
    assert str(compiler) in line and line.endswith(VIRTUAL_MACHINE) and line.count("\n") == 1
    assert ("error: no y.h" in line) == (how == "finds no header")
    assert not list(tmp_path.glob("cache/*")) and not list(tmp_path.glob("elsewhere/*/*"))


@pytest.fixture
def hanging(tmp_path, monkeypatch):
    """The path of a compiler that never ends."""
    path = tmp_path / "cc"
    path.write_text("#!/bin/sh\nexec sleep 60\n")
    path.chmod(0o755)
    monkeypatch.setenv("CC", str(path))
    monkeypatch.setenv("CXX", str(path))
    monkeypatch.setattr(compiled, "_ANSWER_S", 0.3)
    monkeypatch.setattr(compiled, "_COMPILE_S", 0.3)
    return path


def test_a_compiler_that_hangs_is_a_compiler_that_fails(hanging, tmp_path, monkeypatch):
    assert compiled._working_compiler.__wrapped__() is None
    with pytest.raises(OSError, match="did not end in 0.3 s"):
        compiled.run_compiler([str(hanging)], tmp_path)
    monkeypatch.setattr(compiled, "compiler", lambda: "cc")
    assert lanes.cpp_compiler.__wrapped__() is None


@needs_compiler
@pytest.mark.parametrize("everywhere", [False, True])
def test_a_cache_that_cannot_be_used_is_replaced(tmp_path, monkeypatch, said, everywhere):
    """By a temporary one, and without any folder for code by the virtual machine."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "file/cache"))
    elsewhere = tmp_path / ("file/x" if everywhere else "elsewhere")
    monkeypatch.setenv("TMPDIR", str(elsewhere))
    line = said()
    assert line.count("\n") == 1
    if everywhere:
        assert line.startswith("rhec: nothing more is compiled, since ")
        assert line.endswith(VIRTUAL_MACHINE)
    else:
        assert line.startswith(f"{OTHER_CACHE}{elsewhere}/rhec-{os.geteuid()}, since ")
        assert len(list(elsewhere.glob("rhec-*/*/library.so"))) == 1


def test_without_a_compiler_one_line_says_so_unless_none_was_wanted(tmp_path, monkeypatch, said):
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("CC", "cc")
    line = said()
    assert "no C compiler found" in line and line.count("\n") == 1
    monkeypatch.setenv("CC", "")
    assert said() == ""
    assert not list(tmp_path.glob("cache/*")) and not list(tmp_path.glob("elsewhere/*"))


def build_text(text):
    """What fills a folder with a text, in place of code."""
    return lambda folder: (folder / "library").write_text(text)


def load_text(folder):
    text = (folder / "library").read_text()
    if text == "nonsense":
        raise RuntimeError("it does not load")
    return text


def test_whatever_makes_a_library_names_it(monkeypatch):
    given = [(build_increment, ()), (build_increment, (1,)), (build_increment, (), "optimised")]
    names = [compiled.library_name(*each) for each in (*given, (build_text, ()))]
    for place, name, other in (
        (compiled, "FLAGS", ("-O1",)),
        (compiled, "compiler", lambda: "another"),
        (compiled, "source_digest", lambda *modules: "another"),
        (ca, "__version__", "another"),
        (compiled.platform, "machine", lambda: "another"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(place, name, other)
            names.append(compiled.library_name(build_increment, ()))
    assert len({*names}) == len(names)


BROKEN = {
    "half a library": lambda folder: (folder / "library").write_text("ne"),
    "no library": lambda folder: (folder / "library").unlink(),
    "no list": lambda folder: (folder / "content.json").unlink(),
    "an empty list": lambda folder: (folder / "content.json").write_text(""),
    "one file more": lambda folder: (folder / "more").touch(),
    "an empty folder": lambda folder: [file.unlink() for file in folder.iterdir()],
    "a build that was killed": lambda folder: folder.rename(folder.parent / "building-name-dead"),
}


def test_what_is_broken_in_the_cache_or_does_not_load_is_built_anew(tmp_path, monkeypatch):
    """A compiler may write nonsense and end with 0; once it is mended, all is built."""
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "other"))
    folder = tmp_path / "cache/name"
    with pytest.raises(cache.UnusableError):
        cache.load_or_build("name", build_text("nonsense"), load_text)
    assert not cache.contains("name")
    assert cache.load_or_build("name", build_text("new"), load_text) == "new"
    assert cache.load_or_build("name", build_text("never"), load_text) == "new"
    whole = sorted(folder.iterdir())
    for number, spoil in enumerate(BROKEN.values()):
        assert cache.contains("name")
        spoil(folder)
        assert not cache.contains("name")
        text = f"new {number}"
        assert cache.load_or_build("name", build_text(text), load_text) == text
        assert sorted(folder.iterdir()) == whole
    assert [path.name for path in folder.parent.iterdir()] == ["name"]
    assert not list((tmp_path / "other").glob("*/name"))


# No one else's code is loaded


def given_away(path):
    if os.geteuid():
        pytest.skip("only root may give files away")
    os.chown(path, 65534, -1)


def file_in_its_place(path):
    shutil.rmtree(path)
    path.touch()


UNUSED = {f"{mode:o}": lambda path, mode=mode: path.chmod(mode) for mode in (0o720, 0o702)}
UNUSED |= {"of another user": given_away, "a file": file_in_its_place}


@pytest.mark.parametrize("how", UNUSED)
def test_only_a_cache_that_no_other_can_write_to_is_used(tmp_path, monkeypatch, capsys, how):
    """What lies there was perhaps put there by others."""
    place = tmp_path / "cache"
    monkeypatch.setenv("RHEC_CACHE", str(place))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert cache.load_or_build("name", build_text("planted"), load_text) == "planted"
    UNUSED[how](place)
    assert not cache.contains("name")
    assert cache.load_or_build("name", build_text("own"), load_text) == "own"
    line = f"{OTHER_CACHE}{tmp_path}/rhec-{os.geteuid()}, since "
    line += "[Errno 17]" if how == "a file" else f"{place} belongs to "
    assert capsys.readouterr().err.startswith(line)


def test_a_link_in_place_of_the_temporary_folder_is_not_followed(tmp_path, monkeypatch):
    """Who made the link chose what would be loaded."""
    others = tmp_path / "others"
    others.mkdir(mode=0o700)
    (tmp_path / f"rhec-{os.geteuid()}").symlink_to(others)
    (tmp_path / "file").touch()
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "file/x"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with pytest.raises(cache.UnusableError):
        cache.load_or_build("name", lambda folder: None, lambda folder: None)
    assert not list(others.iterdir())


LINE = "rhec: compiling the test compiled, once (some seconds)\n"
ANNOUNCED = {"notebook": (LINE, ""), "terminal": ("", LINE), "pipe": ("", "")}


@needs_compiler
@pytest.mark.parametrize("where", ANNOUNCED)
def test_a_compilation_is_announced_once_to_whoever_waits(tmp_path, monkeypatch, capsys, where):
    """A notebook shows stderr as if it were an error."""
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path))
    monkeypatch.delenv("RHEC_UNATTENDED", raising=False)
    monkeypatch.setattr(compiled.multiprocessing, "parent_process", lambda: None)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    if where == "notebook":
        monkeypatch.setitem(sys.modules, "ipykernel", compiled)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: where == "terminal")
    for _ in range(2):
        compiled.load.__wrapped__(build_increment)
    assert capsys.readouterr() == ANNOUNCED[where]


def test_a_function_that_calls_qpoases_is_left_out_of_the_library():
    """CasADi makes no C of it."""
    x = ca.SX.sym("x")
    solve = ca.qpsol("qp", "qpoases", dict(x=x, f=x**2), dict(printLevel="none"))
    g = ca.MX.sym("g")
    solved = ca.Function("solved", [g], [solve(lbx=g)["x"]])
    names, text = compiled.library_text(build_increment() | dict(solved=solved))
    assert names == dict(increment="increment", solved=None)
    assert "increment" in text and "solved" not in text


def test_a_function_that_is_called_often_is_not_inlined():
    """Nine times in one body is often; twice is not."""

    def called(name, times):
        x = ca.SX.sym("x")
        inner = ca.Function(f"{name}_inner", [x], [ca.sin(x) * x + 1])
        y = z = ca.MX.sym("y")
        for _ in range(times):
            z = inner(z)
        return ca.Function(name, [y], [z])

    _, text = compiled.library_text(dict(often=called("often", 9), rare=called("rare", 2)))
    marked = re.findall(r"/\* (\w+):.*\nstatic __attribute__\(\(noinline\)\) int", text)
    assert marked == ["often_inner"]
