"""The target of `tests/fuzz`: its stored corpus is harmless, and a defect does not escape it."""

import subprocess

import pytest
from fuzz import __main__ as fuzz

import rhec

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    folder = tmp_path_factory.mktemp("model") / "c"
    rhec.export(fuzz.bicycle(), folder)
    program = fuzz.build(folder)
    if program is None:
        pytest.skip("no compiler here has the sanitizers")
    return folder, program


def run(program, runs):
    command = [program, str(runs), "1", *fuzz.corpus()]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_defect_in_the_exported_code_is_found(model):
    """A write of one number behind the end of an array."""
    folder, _ = model
    source = folder / "rhec.c"
    text = source.read_text()
    head, body = text.rsplit("int rhec_estimate(", 1)
    defect = "double few[2]; for (volatile int k = 0; k < 3; k++) few[k] = 0; (void)few;"
    broken = body.replace("{", "{ " + defect, 1)
    source.write_text(f"{head}int rhec_estimate({broken}")
    try:
        done = run(fuzz.build(folder), 0)
    finally:
        source.write_text(text)
    assert done.returncode
    assert "out of bounds" in done.stderr or "stack-buffer-overflow" in done.stderr
