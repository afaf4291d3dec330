"""The promises of docs/threat_model.md and SECURITY.md that no other test covers."""

import re
from pathlib import Path

import casadi as ca
import pytest
import yaml

import rhec
from docs.site import report

ROOT = Path(__file__).parents[2]


def test_files_of_an_export_name_their_licence():
    for file in (ROOT / "rhec/embedded/c").iterdir():
        assert re.search("SPDX-License-Identifier: MIT", file.read_text()), file.name


def test_helpers_of_casadi_in_an_export_are_under_the_licence_that_is_named(tmp_path):
    """Only one of them, of three lines, has no licence of its own."""
    folder = rhec.export(rhec.Scenario(duration_s=4), tmp_path / "c")
    code = (folder / "rhec_functions.h").read_text()
    helpers = {*re.findall(r"#define (casadi_[a-z]\w+) CASADI_PREFIX", code)} - {"casadi_axpy"}
    runtime = Path(ca.__file__).parent / "include/casadi/core/runtime"
    files = [runtime / f"{name}.hpp" for name in helpers]
    texts = [file.read_text() for file in files if file.exists()]
    assert len(texts) > 3
    assert all("MIT No Attribution" in text for text in texts)
    assert "MIT-0" in (folder / "README.txt").read_text()


@pytest.mark.parametrize("package", report.SHOWN)
def test_the_site_has_the_licences_of_what_it_shows(package):
    text = report.licence(package)
    assert "Copyright" in text and "WARRANT" in text


def test_a_release_is_of_what_passed_and_was_installed_and_run():
    """In this order, in one job; what is published is the file that was run."""
    jobs = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text())["jobs"]
    text = "".join(str(step) for step in jobs["wheel"]["steps"])
    order = ["bash .ci/run", "test_wheel.py", "pip wheel", "user/bin/pip install"]
    order += ["user/bin/rhec simulate", "upload-artifact"]
    places = [text.index(step) for step in order]
    assert places == sorted(places)
    assert jobs["publish"]["needs"] == "wheel"
    assert "pip" not in "".join(str(step) for step in jobs["publish"]["steps"][:-1])


def test_actions_are_pinned_by_digest():
    for file in (ROOT / ".github/workflows").iterdir():
        jobs = yaml.safe_load(file.read_text())["jobs"]
        used = [step["uses"] for job in jobs.values() for step in job["steps"] if "uses" in step]
        assert used and all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", action) for action in used), file
