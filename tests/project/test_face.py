"""The public face: what each name says of itself, and what it may cost to import it.

Who may import whom is import-linter's to check (`make lint`, contracts in pyproject.toml).
"""

import ast
import inspect
import re
import subprocess
import sys
from dataclasses import is_dataclass
from pathlib import Path

import pytest

import rhec

ROOT = Path(__file__).parents[2]


def public(name):
    """{how it is called: function} of what the face's `name` lets a caller call."""
    thing = getattr(rhec, name)
    if inspect.ismodule(thing):
        return {f"{name}.{member}": getattr(thing, member) for member in thing.__all__}
    if not inspect.isclass(thing):
        return {name: thing}
    members = {key: getattr(thing, key) for key in vars(thing) if not key.startswith("_")}
    methods = {key: member for key, member in members.items() if hasattr(member, "__code__")}
    return {f"{name}.{key}": method for key, method in methods.items()}


CALLABLE = {call: function for name in rhec.__all__ for call, function in public(name).items()}


def parameters(function):
    """Names of the parameters that a caller may pass."""
    return [
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if name not in ("self", "cls") and parameter.kind is not parameter.VAR_KEYWORD
    ]


@pytest.mark.parametrize("name", rhec.__all__)
def test_a_name_on_the_face_is_documented(name):
    """One sentence comes first; a constructor's parameters are named in the class."""
    thing = getattr(rhec, name)
    text = inspect.getdoc(thing)
    assert re.match(r"[A-Z].*?[.:](\s|$)", text, re.S)
    if inspect.isclass(thing) and thing.__init__ is not object.__init__:
        text += thing.__init__.__doc__ or ""
        fields = thing.__dataclass_fields__ if is_dataclass(thing) else parameters(thing.__init__)
        assert not [field for field in fields if not re.search(rf"\b{field}\b", text)]


@pytest.mark.parametrize("call", CALLABLE)
def test_a_function_on_the_face_documents_arguments_and_result(call):
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


def modules_after(statement):
    """Names of the modules that are loaded after a statement, in a new process."""
    program = f"import sys, rhec\n{statement}\nprint(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True
    )
    return set(done.stdout.split())


@pytest.mark.parametrize("name", ["Model", "RHE", "RHC", "EKF"])
def test_the_core_stands_alone(name):
    """Neither a robot nor tables nor pictures come with what any robot needs."""
    loaded = modules_after(f"rhec.{name}")
    rooms = {module.split(".")[1] for module in loaded if module.startswith("rhec.")}
    assert rooms == {"core"}
    assert loaded.isdisjoint({"pandas", "matplotlib", "dask", "IPython"})


def test_a_run_needs_neither_tables_nor_pictures():
    loaded = modules_after("rhec.simulate(rhec.Scenario(estimator='oracle', duration_s=1.0))")
    assert loaded.isdisjoint({"pandas", "matplotlib", "dask", "IPython", "rhec.workbench"})


def packed(tree):
    """Lines that assign several names at once, but for swaps."""
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                if {*map(ast.unparse, targets)} != {*map(ast.unparse, values)}:
                    yield node.lineno


def test_a_line_holds_one_statement():
    files = sorted((ROOT / "rhec").rglob("*.py"))
    trees = {file: ast.parse(file.read_text(encoding="utf-8")) for file in files}
    assert [f"{file.name}:{line}" for file, tree in trees.items() for line in packed(tree)] == []
