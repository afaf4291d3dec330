"""Loops that are compiled early: the same bits, replaced when they are run often, both at once."""

import threading
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import rhec
from rhec.core import runner
from rhec.core._casadi import compiled, early
from rhec.simulation import closed_loop

pytestmark = pytest.mark.skipif(not compiled.compiler(), reason="there is no C compiler")
STREAM = np.random.default_rng(0).normal(size=(100, 2))


def build_pendulum(n):
    """A scan with sine, square root and quotient, which a compiler might be tempted to reorder."""
    memory, push = ca.MX.sym("memory", 2), ca.MX.sym("push", 2)
    angle, rate = memory[0], memory[1]
    for _ in range(n):
        rate = rate - 0.1 * ca.sin(angle) + 0.1 * push[0] / (1 + ca.sqrt(ca.fabs(rate * push[1])))
        angle = angle + 0.1 * rate
    after = ca.vertcat(angle, rate)
    names = ["memory", "push"], ["next", "row"]
    return runner.build(ca.Function("step", [memory, push], [after, after * 1.1], *names))


def rows_of(functions):
    return runner.run_one(functions, np.zeros(2), STREAM, {})


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("RHEC_CACHE", str(tmp_path / "cache"))
    forget_libraries()
    yield tmp_path / "cache"
    forget_libraries()


def forget_libraries():
    wait()  # a thread that an earlier test began would look for what is forgotten
    compiled.load.cache_clear()
    early._threads.clear()
    early._opened.clear()
    early._optimising.cache_clear()


def compiling():
    """The threads that compile just now."""
    return [thread for thread in threading.enumerate() if thread.name == early.THREAD]


def wait():
    """Wait until nothing compiles."""
    for thread in compiling():
        thread.join()


def n_libraries(folder):
    return len([*folder.glob("*/library.so")])


def test_a_structure_that_is_loaded_often_is_replaced_with_the_same_bits(cache):
    first = early.load(build_pendulum, 3)
    rows = rows_of(first)
    assert n_libraries(cache) == 1
    for _ in range(early.WORTH_OPTIMISING - 1):
        assert early.load(build_pendulum, 3) is first
    wait()
    optimised = early.load(build_pendulum, 3)
    assert optimised is not first
    assert n_libraries(cache) == 2
    for library in cache.glob("*/library.so"):  # the environment that built it may go
        assert str(Path(ca.__file__).parents[1]).encode() not in library.read_bytes()
    assert compiled.is_compiled(build_pendulum, 3)
    np.testing.assert_array_equal(rows_of(optimised), rows)
    assert early.load(build_pendulum, 3) is optimised


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize(
    "fields", [dict(estimation_horizon=2, prediction_horizon=2), {}, dict(speed_model="slipping")]
)
def test_an_optimised_closed_loop_has_the_same_bits(cache, monkeypatch, fields):
    """All other tests compile without optimisation (tests/conftest.py)."""
    setup = closed_loop.set_up(rhec.Scenario(duration_s=40.0, **fields))
    noise = closed_loop.noise_and_faults(0, (), 200)
    rows = []
    for level in ("-O0", "-O2"):
        monkeypatch.setattr(compiled, "FLAGS", (*compiled.FLAGS, level))  # the last one counts
        compiled.load.cache_clear()
        functions = compiled.load(closed_loop.build_sample, *setup.structure)
        rows.append(runner.run_one(functions, setup.memory, noise, setup.settings))
    assert n_libraries(cache) == 2
    np.testing.assert_array_equal(*rows)


def test_another_process_makes_no_c_of_what_was_compiled_early(cache, monkeypatch):
    """Neither to run it nor to optimise it; nor is anything early where the optimised one is."""
    rows = rows_of(early.load(build_pendulum, 3))
    forget_libraries()
    monkeypatch.setattr(compiled, "library_text", None)
    assert early.is_compiled(build_pendulum, 3)
    for _ in range(early.WORTH_OPTIMISING):
        early.load(build_pendulum, 3)
    wait()
    np.testing.assert_array_equal(rows_of(early.load(build_pendulum, 3)), rows)
    forget_libraries()
    assert early.load(build_pendulum, 3) is compiled.load(build_pendulum, 3)
    assert n_libraries(cache) == 2


def test_what_is_sure_to_run_often_is_optimised_at_once(cache):
    first = early.load(build_pendulum, 3)
    early.optimise(build_pendulum, [(3,), (4,)])
    for _ in range(early.WORTH_OPTIMISING):
        early.optimise(build_pendulum, [(3,)])
        assert len(compiling()) <= 1
    wait()
    assert early.load(build_pendulum, 3) is not first
    assert n_libraries(cache) == 2


def test_what_is_begun_is_compiled_once(cache):
    early.begin(build_pendulum, [(3,), (3,)])
    early.begin(build_pendulum, [(3,)])
    assert len(compiling()) <= 1
    early.load(build_pendulum, 3)
    assert not compiling()
    assert n_libraries(cache) == 1


def test_without_a_compiler_not_even_an_early_library_is_used(cache, monkeypatch):
    """Else one of two runs that are compared is compiled and the other one is not."""
    compiled_early = early.load(build_pendulum, 3)
    monkeypatch.setattr(compiled, "compiler", lambda: None)
    interpreted = early.load(build_pendulum, 3)
    assert interpreted["block"].class_name() != compiled_early["block"].class_name()
    monkeypatch.undo()


def test_structures_compile_at_the_same_time(cache, monkeypatch):
    """Each compiler waits until the other one has begun; alone it would wait in vain."""
    both = threading.Barrier(2, timeout=60)
    run = compiled.run_compiler

    def run_with_the_other(command, folder):
        both.wait()
        run(command, folder)

    monkeypatch.setattr(compiled, "run_compiler", run_with_the_other)
    early.begin(build_pendulum, [(4,), (5,)])
    one, other = (early.load(build_pendulum, n) for n in (4, 5))
    assert n_libraries(cache) == 2
    assert not np.array_equal(rows_of(one), rows_of(other))


def test_where_optimising_fails_the_first_library_stays(cache, monkeypatch):
    first = early.load(build_pendulum, 3)

    def fail(command, folder):
        raise OSError("no compiler")

    monkeypatch.setattr(compiled, "run_compiler", fail)
    early.optimise(build_pendulum, [(3,)])
    wait()
    assert early.load(build_pendulum, 3) is first
    assert n_libraries(cache) == 1
