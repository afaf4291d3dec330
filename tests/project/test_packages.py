"""The packages that are installed are versions that pyproject.toml allows."""

import re
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

from packaging.requirements import Requirement

from docs.site import packages
from docs.site.packages import closure, measure, megabytes

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def required():
    """The requirements of the package, of its extras and of the developers."""
    project = PROJECT["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    lists += PROJECT["dependency-groups"].values()
    all_ = [Requirement(text) for each in lists for text in each]
    return [each for each in all_ if each.name != "rhec"]


def test_a_user_of_notebooks_gets_no_builder_of_sites():
    lab = {Requirement(text).name for text in PROJECT["project"]["optional-dependencies"]["lab"]}
    assert lab.isdisjoint({"furo", "latex2mathml", "myst-nb", "sphinx", "typst"})
    assert {"jupyterlab", "papermill"} <= lab


def test_what_an_extra_adds_is_counted_once_and_with_all_that_it_needs(monkeypatch):
    alone = closure("rhec")
    assert {"casadi", "numpy", "annotated-types"} <= alone  # the last one is pydantic's
    assert alone.isdisjoint({"rhec", "matplotlib", "jupyterlab", "pytest"})
    assert {"matplotlib", "kiwisolver", "jupyterlab", "loky"} <= closure("rhec", "all")
    assert "jupyterlab" not in closure("rhec", "plots")
    monkeypatch.setattr(packages, "EXTRAS", ("", "plots", "logs"))
    table = measure().set_index("extra")
    assert table.loc["", "packages"] == len(alone)
    assert table.loc["plots", "packages"] == len(closure("rhec", "plots") - alone)
    assert table.loc["logs", "packages"] == len(closure("rhec", "logs") - alone)
    assert 0 < table.loc["plots", "megabytes"] < table.loc["", "megabytes"]
    assert megabytes("casadi") > megabytes("tqdm") > 0


def test_a_megabyte_is_a_million_bytes(tmp_path, monkeypatch):
    """Compiled bytes do not count: each machine makes its own."""
    for name in ("code.py", "code.pyc"):
        (tmp_path / name).write_bytes(bytes(3_000_000))
    files = [
        SimpleNamespace(suffix=file.suffix, locate=lambda file=file: file)
        for file in tmp_path.iterdir()
    ]
    monkeypatch.setattr(packages.metadata, "files", lambda name: files)
    assert megabytes("a package that is not installed") == 3.0


def test_packages_that_need_each_other_are_counted_once(monkeypatch):
    needs = dict(one=["other"], other=["one", "third"], third=["other"])
    monkeypatch.setattr(packages.metadata, "requires", needs.get)
    assert closure("one") == {"other", "third"}


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
