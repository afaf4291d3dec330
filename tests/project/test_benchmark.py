"""The benchmark: what it compares is the same problem, and what it reports is what was measured. No
time is asserted.
"""

import importlib
import sys

import casadi as ca
import numpy as np
import pytest

from benchmark import acados_peer, floor, instructions, lines, peers, problems, step

nightly = pytest.mark.nightly


@pytest.fixture(scope="module", params=["robot", "rod"])
def loop(request):
    """A short loop of each system."""
    if request.param == "robot":
        return problems.robot(horizon=15, samples=20)
    return problems.rod(states=3, samples=20)


@pytest.fixture(scope="module")
def recorded(loop):
    return problems.record(loop)


@nightly
@pytest.mark.parametrize("name", peers.PEERS)
def test_every_peer_finds_the_same_optimum(name, loop, recorded):
    rhe, rhc = (make(loop.case, recorded[0]) for make in peers.PEERS[name])
    row = step.difference(name, [(rhe(problem), rhc(problem)) for problem in recorded], recorded)
    assert step.agreed(row), row


@nightly
def test_agreement_counts_the_iterations_that_convergence_takes(loop, recorded):
    table, iterations = step.agreement(loop, recorded)
    assert iterations > 1
    assert list(table["contestant"])[-iterations:] == [
        f"rhec, {n} iteration{'s' * (n > 1)} a sample" for n in range(1, iterations + 1)
    ]
    assert table["rhe_maximum"].iloc[-1] <= step.TOLERANCE < table["rhe_maximum"].iloc[-iterations]


@nightly
def test_who_does_not_agree_is_not_timed(loop, capsys, monkeypatch):
    def wrong(case, first):
        return lambda problem: problem.estimate + 2 * step.TOLERANCE_OF_INTERIOR_POINTS

    def right(case, first):
        return lambda problem: problem.plan

    monkeypatch.setattr(peers, "PEERS", {"nobody": (wrong, right), "somebody": (right_rhe, right)})
    monkeypatch.setattr(acados_peer, "command", lambda: None)
    _, table = step.measure(loop, rounds=2)
    assert "nobody" not in {*table["contestant"]} and "somebody" in {*table["contestant"]}
    assert "nobody is left out" in capsys.readouterr().out


def right_rhe(case, first):
    return lambda problem: problem.estimate


def test_contestants_take_turns_and_sums_are_sums():
    turns = []

    def contestant(name, times):
        return lambda number: turns.append((name, number)) or dict(times)

    parts = dict(zip(step.PHASES, (1.0, 2.0, 3.0, 4.0)))
    whole = {("closed loop", "overall"): 5.0}
    both = dict(A=contestant("A", parts), B=contestant("B", whole))
    table = step.spread(step.interleaved(both, rounds=2), ["contestant", "problem", "phase"])
    assert turns == [("A", 0), ("B", 0)] * 2 + [("A", 1), ("B", 1)]
    overall = table[table["phase"] == "overall"].set_index("problem")["median_us"]
    assert overall.to_dict() == {"RHE": 3, "RHC": 7, "RHE + RHC": 10, "closed loop": 5}


@nightly
def test_the_step_is_measured(loop):
    agreeing, table = step.measure(loop, rounds=2)
    whole = table[table["problem"].isin(step.WHOLE)].set_index("contestant")
    wanted = {step.FROM_PYTHON, instructions.IN_C, step.CONVERGED, *peers.PEERS}
    wanted |= {instructions.CLOSED_LOOP} if loop.case.papers else set()
    wanted |= {*(acados_peer.NAMES.values() if acados_peer.command() else [])}
    assert {*whole.index} == wanted
    assert (table[["lower_quartile_us", "median_us", "upper_quartile_us"]] > 0).all(axis=None)
    assert whole.loc[step.FROM_PYTHON, "ratio"] == 1


# What needs no measurement


def test_operations_are_counted_without_what_only_moves_values():
    x = ca.SX.sym("x", 2)
    product = ca.Function("f", [x], [x[0] * x[1] + ca.sin(x[0]), x[1]])
    assert floor.operations(product) == {ca.OP_MUL: 1, ca.OP_ADD: 1, ca.OP_SIN: 1}
    y = ca.MX.sym("y", 2)
    first, _ = product(y)
    outer = ca.Function("g", [y], [first * y])  # a call, and a product of two entries
    assert floor.operations(outer) == {ca.OP_MUL: 3, ca.OP_ADD: 1, ca.OP_SIN: 1}


def test_lines_that_hold_code_are_counted():
    text = (
        '"""A page."""\n\n# why\nx = (\n    1,\n)\n\n\ndef f():\n    """Text\n    of f."""\n'
        "    return x  # it\n"
    )
    assert lines.count(text) == 5


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("task", lines.TASKS)
def test_both_ways_to_write_a_tutorial_come_to_the_same(task):
    ours = importlib.import_module(f"benchmark.tutorials.{task}_rhec").LAST
    if task == "mpc":
        np.testing.assert_allclose(ours, 0.0, atol=2e-3)
    else:
        np.testing.assert_allclose(ours, 2.25e-4, rtol=0.02)
    if peers.do_mpc:
        with peers.quiet():
            theirs = importlib.import_module(f"benchmark.tutorials.{task}_do_mpc").LAST
        np.testing.assert_allclose(ours, theirs, atol=1e-3 if task == "mpc" else 0, rtol=0.02)


CALLGRIND = """\
fn=(1) main
12 100
cfn=(2) rhe_feedback
calls=3 40
13 600
fn=(2)
40 600
fn=(3) other
cfn=(2)
calls=1 40
+2 400
cfn=(4) block
calls=2 7
* 64
"""


def test_instructions_a_call_are_read_from_callgrinds_file(tmp_path):
    profile = tmp_path / "callgrind.out"
    profile.write_text(CALLGRIND)
    assert instructions.per_call(profile) == {"rhe_feedback": 250, "block": 32}


@nightly
@pytest.mark.skipif(not instructions.available(), reason="valgrind is not installed")
def test_only_what_is_asked_for_is_counted(tmp_path):
    library = instructions.counter(tmp_path)
    script = f"import ctypes; c = ctypes.CDLL({library!r}); work = lambda n: sum(range(n))"
    for n in (100, 10_000, 20_000):
        script += f"; work(100000); c.begin(); work({n}); c.end(b'{n}')"
    command = [sys.executable, "-I", "-S", "-c", script]  # valgrind makes each import slow
    profiles = instructions.below_callgrind(tmp_path, command)
    few, some, more = (instructions.total(profiles[str(n)]) for n in (100, 10_000, 20_000))
    assert few < some / 2 and 0.9 < (more - few) / (some - few) / (19_900 / 9_900) < 1.1
