"""What studies share: estimators that a replay of a log compares, runs on many workers, C."""

import subprocess

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import consistency, faults, recorded_logs, transfer, unknowns
from notebooks.studies import interpretations, order, order_in_worlds, parallel, tables, toolchain
from rhec import style


def test_the_papers_estimators_have_the_noise_that_was_asked_for():
    printed = recorded_logs.estimators("printed", {})
    assert {each["process_noise"] for name, each in printed.items() if name != "RHE"} == {"printed"}
    predicting = recorded_logs.estimators("soft_soil", {})
    noises = {each["process_noise"] for name, each in predicting.items() if name != "RHE"}
    assert noises == {"soft_soil"}
    for arguments in predicting.values():
        rhec.Scenario(**arguments)


def published(name):
    return pd.read_csv(style.ROOT / f"data/results/{name}.csv")


# {table of data/results: what a notebook shows of it, and what names its rows and its columns}
SHOWN = {
    "audit_order": (order.readable_order, "variation", "process_noise"),
    "audit_interpretations": (interpretations.readable_changes, "interpretation", "quantity"),
    "inverse_rules": (order_in_worlds.readable_rules, "rule for W", "turns"),
    "table_unknowns": (unknowns.readable_errors, "robot", "world"),
    "table_replay": (tables.readable, "quantity", "estimator"),
    "table_consistency": (consistency.verdicts, "estimator", None),
    "table_recorded_yaw": (transfer.of_the_page, "log", None),
    "table_faults": (faults.readable_fault_table, "case", None),
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_table_for_readers_has_the_order_of_what_it_shows(name):
    """The rows of the published tables are in no alphabetical order."""
    show, rows, columns = SHOWN[name]
    table = published(name)
    shown = show(table.assign(seed=0))
    told = shown.reset_index()
    told = told[rows] if rows in told else told.iloc[:, 0]
    expected = list(dict.fromkeys(table[rows].astype(str)))
    if name == "table_faults":
        expected = list(dict.fromkeys(table["family"] + ": " + table["case"]))
    elif name == "table_unknowns":
        expected = [*unknowns.ROBOTS]
    found = list(dict.fromkeys(told))
    assert found == [tables.with_minus(each) for each in expected]
    assert found != sorted(found)
    if columns:
        assert list(shown.columns) == list(dict.fromkeys(table[columns]))


def test_a_scenario_that_kills_its_workers_is_named(monkeypatch):
    parts = [{0: 1.0, 2: 3.0}, {1: None}]
    monkeypatch.setattr(parallel, "run_all", lambda *given: parts)
    with pytest.raises(RuntimeError, match="every worker that ran scenario 1 died"):
        parallel.map_runs(None, range(3))
    parts[1] = {1: 2.0}
    assert parallel.map_runs(None, range(3)) == [1.0, 2.0, 3.0]


def test_the_true_error_of_a_robot_that_is_lost_is_infinite(monkeypatch):
    rows = pd.DataFrame(dict(mean_error_true_m=[0.1, np.nan]))
    monkeypatch.setattr(parallel, "drive", lambda groups, workers: dict.fromkeys(groups, rows))
    assert [*parallel.true_errors(dict(one=[]))["one"]] == [0.1, np.inf]


@pytest.mark.skipif(toolchain.this_machine() is None, reason="there is no C compiler")
def test_a_stack_is_as_deep_as_the_largest_sum_over_a_chain_of_calls(tmp_path):
    """One calls two and three, two calls four; libm has no node."""
    machine = toolchain.this_machine()
    (tmp_path / "code.c").write_text("const char constant[40] = {1};")
    subprocess.run([machine.compiler, "-c", "code.c"], cwd=tmp_path, check=True)
    graph = [
        f'node: {{ title: "{name}" label: "{name}\\n{size} bytes (static)" }}'
        for name, size in dict(one=16, two=32, three=100, four=80).items()
    ]
    graph += [
        f'edge: {{ sourcename: "{caller}" targetname: "{called}" }}'
        for caller, called in (("one", "two"), ("one", "three"), ("two", "four"), ("four", "sin"))
    ]
    (tmp_path / "code.ci").write_text("\n".join(graph))
    found = toolchain.sizes(machine, [tmp_path / "code.o"])
    assert found["stack_bytes"] == 16 + 32 + 80 and 40 <= found["code_bytes"] < 400


def test_arm_is_emulated_where_there_are_a_cross_compiler_and_an_emulator(monkeypatch):
    found = {"aarch64-linux-gnu-gcc": "/bin/cross", "qemu-aarch64": "/bin/qemu"}
    monkeypatch.setattr(toolchain.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(toolchain.shutil, "which", found.get)
    assert toolchain.arm() == ("aarch64", "/bin/cross", ("/bin/qemu",))
    for name in [*found]:
        monkeypatch.setattr(toolchain.shutil, "which", {**found, name: None}.get)
        assert toolchain.arm() is None
