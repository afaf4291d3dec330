"""The wheel, installed beside nothing but what it asks for, works outside the checkout."""

import json
import re
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.utils import canonicalize_name

import rhec
from docs.site.packages import closure

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[2]
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
SCENARIO = dict(duration_s=20.0, process_noise="prediction", seed=3)

# The folder of the wheel comes first, that of the checkout is gone, extras cannot be imported.
SETTING = """
import json, sys
root, wheel, extras, scenario = map(json.loads, sys.argv[1:])
sys.path[:] = [wheel, *(path for path in sys.path if path not in ("", root))]

class NotInstalled:
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in extras:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NotInstalled)
import rhec
assert rhec.__file__.startswith(wheel), rhec.__file__
scenario = rhec.Scenario(**scenario)
"""
WHAT_IT_DOES = {
    "simulate": "rhec.simulate(scenario).metrics",
    "replay": "rhec.replay(rhec.simulate(scenario).log)['mu_hat'].tolist()",
    "export": "sorted(path.name for path in rhec.export(scenario, 'exported').iterdir())",
    "campaign": "rhec.campaign([scenario], workers=1)[['mean_error_m', 'error']].values.tolist()",
}


@pytest.fixture(scope="module")
def extras():
    """Modules of this environment that a plain install does not bring."""
    brought = closure("rhec") | {"rhec"}
    return sorted(
        module
        for module, distributions in metadata.packages_distributions().items()
        if brought.isdisjoint(map(canonicalize_name, distributions))
    )


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of this checkout, made without a network."""
    folder = tmp_path_factory.mktemp("wheel")
    make = [*PIP, "wheel", "--no-deps", "--no-build-isolation", "-w", folder, ROOT]
    subprocess.run(make, check=True)
    (file,) = folder.glob("rhec-*.whl")
    return file


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A folder with the package alone, outside the checkout."""
    folder = tmp_path_factory.mktemp("installed")
    subprocess.run([*PIP, "install", "--no-deps", "--target", folder, wheel], check=True)
    return folder


def test_a_plain_install_brings_no_laboratory(extras):
    assert {"casadi", "numpy", "pandas", "pydantic"}.isdisjoint(extras)
    assert {"jupyterlab", "papermill", "loky", "pyarrow", "matplotlib"} < {*extras}


def test_the_wheel_holds_the_package_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.partition("/")[0] for name in names} == {
        "rhec",
        f"rhec-{rhec.__version__}.dist-info",
    }
    assert not any("__pycache__" in name for name in names)
    tracked = subprocess.run(
        ["git", "ls-files", "rhec"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    data = "rhec/data/standard_gaussian_fields.npz"
    assert {*tracked.stdout.split(), data} <= {*names} and "rhec/py.typed" in names


def test_one_version_everywhere():
    assert metadata.version("rhec") == rhec.__version__
    assert f"\nversion: {rhec.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    newest = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest[1] == rhec.__version__


@pytest.mark.parametrize("name", WHAT_IT_DOES)
def test_it_works_outside_the_checkout_as_inside(name, installed, extras, tmp_path, monkeypatch):
    given = map(json.dumps, (str(ROOT), str(installed), extras, SCENARIO))
    program = f"{SETTING}\nprint(json.dumps({WHAT_IT_DOES[name]}))"
    process = subprocess.run(
        [sys.executable, "-c", program, *given], cwd=tmp_path, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stderr
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    ours = eval(WHAT_IT_DOES[name], dict(rhec=rhec, scenario=rhec.Scenario(**SCENARIO)))
    theirs = json.loads(process.stdout)
    assert theirs == json.loads(json.dumps(ours))
