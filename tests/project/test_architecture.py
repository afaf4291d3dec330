"""The house: who may import whom, what a module shows, and what the public face says of itself."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from dataclasses import is_dataclass
from pathlib import Path

import pytest

import rhec

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "rhec"

# Right uses left: a module imports from its own room and from the floors before its own.
FLOORS = [
    ["_casadi", "paper", "columns"],
    ["model"],
    ["solver"],
    ["estimator", "controller"],
    ["tracked_robot"],
    ["extensions"],
    ["scenario", "metrics"],
    ["simulation"],
    ["logs"],
    ["campaigns", "codegen"],
    ["studies"],
    ["plots"],
    ["workbench"],
]
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
CORE = ["model", "solver", "estimator", "controller"]
CORE += ["paper", "scenario", "metrics", "simulation"]
PICTURES = {"matplotlib", "PIL", "IPython", "ipywidgets"}
# A house for the paper needs 14,000 lines; 2,100 more hold rivals and fair rules, lanes and a cache
# that trusts nobody, and readers of logs that say what is wrong with one; 800 calibrate a log and
# compare robots, 650 slow down and search for the worst, 550 bring the field into a web page, 150
# compile what loops have in common once and leave no core idle.
MOST_ENTRIES, MOST_CORE_LINES, MOST_LINES = 20, 2500, 18_250


def dotted(file):
    """A file as it is imported, such as rhec.core.solver.rti."""
    parts = ["rhec", *file.relative_to(PACKAGE).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(name):
    """The room of a module, or of what the face shows of it; rhec itself is in none."""
    name = name.split(".")[1:2]
    return rhec._HOME.get(*name, *name).split(".")[0] if name else None


FILES = {dotted(file): file for file in sorted(PACKAGE.glob("**/*.py"))}
TREES = {name: ast.parse(file.read_text(encoding="utf-8")) for name, file in FILES.items()}
FILLED = [name for name, tree in TREES.items() if tree.body and not name.endswith("__main__")]


def imported(name):
    """All that a module imports anywhere in it, each as far as it is named: rhec.core.solver.rti."""
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{name}: a relative import hides its room"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("name", [name for name in FILES if room(name)])
def test_imports_run_one_way(name):
    for used in imported(name):
        if used.startswith("rhec.") and not room(used).startswith("__"):
            assert room(used) == room(name) or FLOOR[room(used)] < FLOOR[room(name)], used


def test_every_room_has_its_floor():
    assert {room(name) for name in FILES if room(name)} == set(FLOOR)


@pytest.mark.parametrize("name", [name for name in FILES if room(name) in [*CORE, "studies"]])
def test_core_and_studies_draw_nothing(name):
    assert PICTURES.isdisjoint(used.split(".")[0] for used in imported(name))


def test_the_core_is_there_before_pandas():
    core = [name for name in FILES if room(name) in [*CORE, "tracked_robot", "extensions"]]
    program = f"import sys, {', '.join(core)}; assert 'pandas' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_the_shelf_is_short_and_the_core_thin():
    entries = [path.name for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    assert len(entries) <= MOST_ENTRIES, entries
    lines = {name: len(file.read_text().splitlines()) for name, file in FILES.items()}
    assert sum(lines[name] for name in FILES if room(name) in CORE) <= MOST_CORE_LINES
    assert sum(lines.values()) <= MOST_LINES


@pytest.mark.parametrize("name", FILLED)
def test_a_module_says_what_it_shows(name):
    """`__all__` names what is there; a function or class outside it begins with an underscore."""
    if not any(not isinstance(node, ast.Expr) for node in TREES[name].body):
        return  # a sentence about its folder
    shown = importlib.import_module(name).__all__
    defined = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    own = {node.name for node in TREES[name].body if isinstance(node, defined)}
    hidden = {each for each in own if not each.startswith("_")}.difference(shown)
    assert not hidden, hidden
    for each in shown:
        assert hasattr(importlib.import_module(name), each), each


def words(file):
    return {*re.findall(r"\w+", file.read_text(encoding="utf-8"))}


@pytest.fixture(scope="module")
def used_in():
    """{file: the words in it} of all that may use a module."""
    patterns = ("rhec/**/*.py", "tests/**/*.py", "data/*.py", "notebooks/*.py", "notebooks/*.ipynb")
    return {file: words(file) for pattern in patterns for file in ROOT.glob(pattern)}


@pytest.mark.parametrize("name", [name for name in FILLED if name != "rhec"])
def test_what_a_module_shows_is_used_elsewhere(name, used_in):
    shown = {*getattr(importlib.import_module(name), "__all__", ())}
    unused = shown.difference(*(used_in[file] for file in used_in if file != FILES[name]))
    assert not unused, unused


# The public face


def public(name):
    """{how it is called: function} of what the face's `name` lets one call."""
    thing = getattr(rhec, name)
    if inspect.ismodule(thing):
        return {f"{name}.{each}": getattr(thing, each) for each in thing.__all__}
    if not inspect.isclass(thing):
        return {name: thing}
    own = {key: getattr(thing, key) for key in vars(thing) if not key.startswith("_")}
    methods = {key: each for key, each in own.items() if hasattr(each, "__code__")}
    return {f"{name}.{key}": each for key, each in methods.items()}


CALLABLE = {call: function for name in rhec.__all__ for call, function in public(name).items()}


def parameters(function):
    """Names of the parameters that a caller may give."""
    return [
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if name not in ("self", "cls") and parameter.kind is not parameter.VAR_KEYWORD
    ]


@pytest.mark.parametrize("name", rhec.__all__)
def test_a_name_on_the_face_is_documented(name):
    """One sentence first; a constructor's parameters are named in the class."""
    thing = getattr(rhec, name)
    text = inspect.getdoc(thing)
    assert re.match(r"[A-Z].*?[.:](\s|$)", text, re.S)
    if inspect.isclass(thing) and thing.__init__ is not object.__init__:
        text += thing.__init__.__doc__ or ""
        given = thing.__dataclass_fields__ if is_dataclass(thing) else parameters(thing.__init__)
        assert not [each for each in given if not re.search(rf"\b{each}\b", text)]


@pytest.mark.parametrize("call", CALLABLE)
def test_a_function_on_the_face_says_what_it_takes_and_gives(call):
    function = CALLABLE[call]
    text = inspect.getdoc(function) or ""
    assert re.match(r"[A-Z].*?\.(\s|$)", text, re.S), "one sentence comes first"
    if parameters(function):
        arguments = re.search(r"^Args:\n(.*?)(?:^\S|\Z)", text, re.S | re.M)
        assert arguments, "no Args"
        for name in parameters(function):
            assert re.search(rf"^ +\*?{name}\b.*:", arguments[1], re.M), f"{name} is not in Args"
    if inspect.signature(function).return_annotation not in (None, "None"):
        assert re.search(r"^Returns:\n|^Yields:\n", text, re.M) or not parameters(function)


@pytest.mark.parametrize("call", CALLABLE)
def test_a_function_on_the_face_is_annotated(call):
    signature = inspect.signature(CALLABLE[call])
    assert signature.return_annotation is not signature.empty
    for name in parameters(CALLABLE[call]):
        assert signature.parameters[name].annotation is not signature.empty, name


def test_type_checkers_see_the_face():
    """What `__getattr__` loads on first use stands behind TYPE_CHECKING, under the same names."""
    (block,) = [node for node in TREES["rhec"].body if isinstance(node, ast.If)]
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    seen = {
        alias.name: node.module
        == ("rhec" if (home := rhec._HOME.get(alias.name)) == alias.name else f"rhec.{home}")
        for node in block.body
        for alias in node.names
    }
    assert set(seen) == set(rhec.__all__) and all(seen.values())
