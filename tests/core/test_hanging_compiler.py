"""A compiler that hangs is a compiler that fails."""

import pytest

from rhec.core._casadi import compiled
from rhec.core.lanes import lanes


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


def test_a_compiler_that_never_tells_its_version_is_none(hanging):
    assert compiled._working_compiler.__wrapped__() is None


def test_a_compiler_of_lanes_that_never_tells_its_macros_is_none(hanging, monkeypatch):
    monkeypatch.setattr(compiled, "compiler", lambda: "cc")
    assert lanes.cpp_compiler.__wrapped__() is None


def test_a_compiler_that_never_ends_fails(hanging, tmp_path):
    with pytest.raises(OSError, match="did not end in 0.3 s"):
        compiled.run_compiler([str(hanging)], tmp_path)
