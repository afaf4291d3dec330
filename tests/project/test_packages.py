"""The packages that are installed are versions that pyproject.toml allows."""

import re
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

from packaging.requirements import Requirement

from docs.site import packages

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def required():
    """The requirements of the package, of its extras and of the developers."""
    project = PROJECT["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    lists += PROJECT["dependency-groups"].values()
    all_ = [Requirement(text) for each in lists for text in each]
    return [each for each in all_ if each.name != "rhec"]


def test_what_an_extra_adds_is_counted_once_and_with_all_that_it_needs(monkeypatch):
    """Two need each other; the extra of a package brings another one."""
    needs = dict(
        rhec=["one", 'two; extra == "plots"', 'three; extra == "logs"'],
        one=["other"], other=["one"], two=["one", "four"], three=["Four[big]"],
        four=['five; extra == "big"'],
    )  # fmt: skip
    sizes = dict(one=1.0, other=2.0, two=4.0, three=8.0, four=16.0, five=32.0)
    monkeypatch.setattr(packages.metadata, "requires", needs.get)
    monkeypatch.setattr(packages, "megabytes", sizes.get)
    monkeypatch.setattr(packages, "EXTRAS", ("", "plots", "logs"))
    table = packages.measure()
    assert table["packages"].tolist() == [2, 2, 3]
    assert table["megabytes"].tolist() == [3.0, 20.0, 56.0]


def test_a_megabyte_is_a_million_bytes(tmp_path, monkeypatch):
    """Compiled bytes do not count: each machine makes its own."""
    for name in ("code.py", "code.pyc"):
        (tmp_path / name).write_bytes(bytes(3_000_000))
    files = [
        SimpleNamespace(suffix=file.suffix, locate=lambda file=file: file)
        for file in tmp_path.iterdir()
    ]
    monkeypatch.setattr(packages.metadata, "files", lambda name: files)
    assert packages.megabytes("a package that is not installed") == 3.0


def test_engines_are_pinned_beside_what_is_installed():
    """No package of tests/engines.txt would replace one of environment.txt."""
    engines, others = (
        {*re.findall(r"(?m)^([\w.-]+)==", (ROOT / file).read_text(encoding="utf-8"))}
        for file in ("tests/engines.txt", "environment.txt")
    )
    assert {"distributed", "mpi4py", "ipyparallel"} <= engines
    assert engines.isdisjoint(others) and {"casadi", "numpy"} <= others


def test_what_is_installed_satisfies_the_bounds_of_pyproject():
    """`make lock` pins the same for other versions of Python."""
    versions = {str(each): metadata.version(each.name) for each in required()}
    assert {
        each for each in required() if not each.specifier.contains(versions[str(each)])
    } == set()
