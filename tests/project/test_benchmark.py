"""The benchmark: what it compares is the same problem, and what it reports is what was measured. No
time is asserted.
"""

import sys

import numpy as np
import pytest

from benchmark import acados_peer, instructions, peers, problems, step

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def run():
    return problems.drive(samples=20)


@pytest.fixture(scope="module")
def recorded(run):
    return problems.record(run)


def test_problems_are_the_full_windows_of_the_run(run, recorded):
    z = problems.measured(run)
    assert len(recorded) == 20
    for k, problem in enumerate(recorded):
        np.testing.assert_array_equal(problem.z, z[k : k + 16].T)
        assert np.linalg.eigvalsh(problem.H).min() > 0
        assert problem.xi_ref.shape == (
            3,
            16,
        ) and problem.omega_ref.shape == problem.omega_plan.shape == (15,)


@pytest.mark.parametrize("name", peers.PEERS)
def test_every_peer_finds_the_same_optimum(name, recorded):
    rhe, rhc = (make(recorded[0]) for make in peers.PEERS[name])
    row = step.difference(name, [(rhe(problem), rhc(problem)) for problem in recorded], recorded)
    assert step.agreed(row), row


def test_peers_are_sensitive_to_every_part_of_the_data(recorded):
    """Else agreement would prove little."""
    rhe, rhc = (make(recorded[0]) for make in peers.PEERS["Opti + IPOPT"])
    last = recorded[-1]
    for change in (dict(z=last.z + 0.01), dict(m=last.m + 0.01), dict(H=2 * last.H)):
        assert np.abs(rhe(last._replace(**change)) - last.estimate).max() > step.TOLERANCE
    for change in (
        dict(estimate=last.estimate + 0.01),
        dict(xi_ref=last.xi_ref + 0.01),
        dict(omega_ref=last.omega_ref + 0.01),
    ):
        assert np.abs(rhc(last._replace(**change)) - last.omega_plan).max() > step.TOLERANCE


def test_agreement_counts_the_iterations_that_convergence_takes(run, recorded):
    table, iterations = step.agreement(run, recorded)
    assert iterations > 1
    assert list(table["contestant"])[-iterations:] == [
        f"rhec, {n} iteration{'s' * (n > 1)} a sample" for n in range(1, iterations + 1)
    ]
    assert table["rhe_maximum"].iloc[-1] <= step.TOLERANCE < table["rhe_maximum"].iloc[-iterations]


def test_without_agreement_nothing_is_timed(run, recorded):
    wrong = [problem._replace(omega_plan=problem.omega_plan + 1e-5) for problem in recorded]
    with pytest.raises(SystemExit, match="nothing was timed"):
        step.agreement(run, wrong)


def test_contestants_take_turns_and_sums_are_sums():
    turns = []

    def contestant(name, times):
        return lambda number: turns.append((name, number)) or dict(times)

    parts = dict(zip(step.PHASES, (1.0, 2.0, 3.0, 4.0)))
    times = step.interleaved(
        {"A": contestant("A", parts), "B": contestant("B", {("closed loop", "overall"): 5.0})},
        rounds=2,
    )
    assert turns == [("A", 0), ("B", 0)] * 2 + [("A", 1), ("B", 1)]
    table = step.spread(times, ["contestant", "problem", "phase"]).set_index(
        ["contestant", "problem", "phase"]
    )["median_us"]
    assert (
        table["A", "RHE", "overall"] == 3
        and table["A", "RHC", "overall"] == 7
        and table["A", "RHE + RHC", "overall"] == 10
    )
    assert table["B", "closed loop", "overall"] == 5


def test_the_step_is_measured(monkeypatch):
    monkeypatch.setattr(step, "SAMPLES", 20)
    agreeing, table = step.measure(rounds=2, counted=False)
    whole = table[table["problem"].isin(step.WHOLE)].set_index("contestant")
    assert set(whole.index) == {
        "rhec, closed loop",
        "rhec, one iteration",
        "rhec, in C",
        "rhec, to convergence",
        *peers.PEERS,
        *(acados_peer.NAMES.values() if acados_peer.command() else []),
    }
    assert (table[["lower_quartile_us", "median_us", "upper_quartile_us"]] > 0).all(axis=None)
    if step.REFERENCE in peers.PEERS:
        assert whole.loc[step.REFERENCE, step.SPEEDUP] == 1


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


@pytest.mark.skipif(not instructions.available(), reason="valgrind is not installed")
def test_only_what_is_asked_for_is_counted(tmp_path):
    library = instructions.counter(tmp_path)
    script = f"import ctypes; c = ctypes.CDLL({library!r}); work = lambda n: sum(range(n))"
    for n in (100, 10_000, 20_000):
        script += f"; work(100000); c.begin(); work({n}); c.end(b'{n}')"
    command = [sys.executable, "-c", script]
    profiles = instructions.below_callgrind(tmp_path, command)
    few, some, more = (instructions.total(profiles[str(n)]) for n in (100, 10_000, 20_000))
    assert few < some / 2 and 0.9 < (more - few) / (some - few) / (19_900 / 9_900) < 1.1
