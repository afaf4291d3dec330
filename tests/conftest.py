import collections
import gc
import sys
from pathlib import Path

import pytest
from helpers import SIMPLE_WORLD, no_compiler

import rhec
from rhec.core._casadi import compiled
from rhec.core.lanes import lanes

HERE = Path(__file__).parent
UNOPTIMISED = HERE / "unoptimised"
# The files that take longest, some of them with --thorough alone. Parallel workers begin with
# them, so that no worker is left with one of them at the end.
LONGEST = (
    "agreement/test_forms.py",
    "logs/test_replay.py",
    "simulation/test_lanes.py",
    "simulation/test_campaigns.py",
    "embedded/test_export.py",
    "logs/test_findings.py",
    "logs/test_summary.py",
    "logs/test_calibrate.py",
    "core/test_any_robot.py",
    "notebooks/test_tutorial.py",
    "project/test_benchmark.py",
    "project/test_command_line.py",
    "explorer/test_explorer.py",
)


def pytest_addoption(parser):
    parser.addoption("--thorough", action="store_true", help="also run what is marked `nightly`")


def pytest_configure():
    """Compile without optimisation, which takes a tenth of the time; the results are the same.

    `test_early` shows that. The last flag counts, and libraries of other flags have other names:
    none of these is found by whoever computes with the optimised ones.
    """
    compiled.FLAGS = (*compiled.FLAGS, "-O0")
    # Tests, modules and CasADi's functions live as long as the session. To look for garbage among
    # them as often as Python does takes a twentieth of the time.
    gc.set_threshold(200_000, 20, 20)
    # `jsonschema` checks addresses by it, which no notebook has; its import takes two seconds.
    sys.modules.setdefault("rfc3987_syntax", None)


def pytest_collection_modifyitems(config, items):
    """Leave out what is `nightly`, and begin with the longest files; others keep their order."""
    if not config.getoption("--thorough"):
        left_out = _nightly(items)
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in left_out]
    rank = {HERE / name: place for place, name in enumerate(LONGEST)}
    assert all(file.exists() for file in rank)
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


def _nightly(items):
    """The set of tests with the marker `nightly`, but of `nightly(keep=2)` the first two cases."""
    cases = collections.Counter()
    left_out = set()
    for item in items:
        marker = item.get_closest_marker("nightly")
        if marker:
            function = item.path, item.originalname
            cases[function] += 1
            if cases[function] > marker.kwargs.get("keep", 0):
                left_out.add(item)
    return left_out


@pytest.fixture(scope="session", autouse=True)
def unoptimised_processes():
    """Processes that tests start compile as quickly. This one has its compilers already."""
    with pytest.MonkeyPatch.context() as patch:
        if compiled.compiler():
            patch.setenv("CC", str(UNOPTIMISED / "cc"))
        if lanes.cpp_compiler():
            patch.setenv("CXX", str(UNOPTIMISED / "c++"))
        yield


@pytest.fixture(scope="module")
def virtual_machine():
    """The module's tests need no compiled code: what they build is used for moments only.
    `tests/agreement` shows that both agree.
    """
    with no_compiler():
        yield


@pytest.fixture(scope="session")
def run():
    """One minute of the paper's loop in a simple world, calibrated."""
    scenario = rhec.Scenario(**SIMPLE_WORLD, process_noise="prediction", duration_s=60.0)
    with no_compiler():
        return rhec.simulate(scenario)
