"""The pinned packages of environment.txt are versions that pyproject.toml allows."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from docs.site import packages
from docs.site.packages import closure, measure, megabytes

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
# One entry of environment.txt: the requirement, and its digests on the lines that follow.
ENTRY = re.compile(r"(?m)^([a-z0-9][^\\\n]*?) \\\n((?: +--hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)")


def required():
    """The requirements of the package, of its extras and of the developers."""
    project = PROJECT["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    lists += PROJECT["dependency-groups"].values()
    all_ = [Requirement(text) for each in lists for text in each]
    return [each for each in all_ if each.name != "rhec"]


def pinned(text, python):
    """{name: version} of what is pinned for a version of Python, on Linux."""
    system = {"python_version": python, "python_full_version": f"{python}.0"}
    system |= {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix"}
    entries = [Requirement(found[1]) for found in ENTRY.finditer(text)]
    apply = [each for each in entries if each.marker is None or each.marker.evaluate(system)]
    return {canonicalize_name(each.name): str(each.specifier)[2:] for each in apply}


@pytest.fixture(scope="module")
def environment():
    return (ROOT / "environment.txt").read_text(encoding="utf-8")


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


def test_packages_that_need_each_other_are_counted_once(monkeypatch):
    needs = dict(one=["other"], other=["one", "third"], third=["other"])
    monkeypatch.setattr(packages.metadata, "requires", needs.get)
    assert closure("one") == {"other", "third"}


def test_engines_are_pinned_beside_what_is_installed(environment):
    """No package of tests/engines.txt would replace one of environment.txt."""
    engines = pinned((ROOT / "tests/engines.txt").read_text(encoding="utf-8"), "3.11")
    assert {"distributed", "mpi4py", "ipyparallel"} <= {*engines}
    assert {*engines}.isdisjoint(pinned(environment, "3.11"))


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13", "3.14"])
def test_every_pin_satisfies_the_bounds_of_pyproject(environment, python):
    pins = pinned(environment, python)
    wrong = {
        str(each): pins.get(canonicalize_name(each.name))
        for each in required()
        if not each.specifier.contains(pins.get(canonicalize_name(each.name), "0"))
    }
    assert wrong == {}
    assert all(canonicalize_name(each.name) in pins for each in required())
