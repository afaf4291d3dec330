import contextlib

import pytest

import rhec
from rhec.core._casadi import compiled


@contextlib.contextmanager
def no_compiler():
    """As on a machine without a C compiler."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "compiler", lambda: None)
        compiled.load.cache_clear()
        yield
    compiled.load.cache_clear()


@pytest.fixture(scope="module")
def virtual_machine():
    """The module's tests need no compiled code: what they build is used for moments only.
    `test_closed_loop` shows that both agree.
    """
    with no_compiler():
        yield


@pytest.fixture(scope="session")
def run():
    """One minute of the paper's loop, calibrated."""
    return rhec.simulate(rhec.Scenario(process_noise="calibrated", duration_s=60.0))
