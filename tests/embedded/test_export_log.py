"""The estimator that was judged on a log, as C: estimates and standard deviations are Python's."""

import dataclasses
import subprocess

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from helpers import recorded_log
from oracles import DT, flat, move

import rhec
from notebooks.studies import toolchain
from rhec.embedded.exported_functions import operations
from rhec.embedded.recorded import build_move, example_of
from rhec.logs.recording import prepare
from rhec.simulation.columns import ESTIMATE, LEVER_ARM
from rhec.tracked_robot.estimators import Choice
from rhec.tracked_robot.paper_rhe import window_of

INFLATION = 1.5


def compiled_replay(folder, *sources):
    """The program of an export, compiled with warnings as errors."""
    machine = toolchain.this_machine()
    if machine is None:
        pytest.skip("there is no C compiler")
    flags = "-std=c99 -O0 -ffp-contract=off -Wall -Wextra -Wpedantic -Werror".split()
    names = ["rhec.c", "rhec_scenario.c", *sources, "replay.c"]
    command = [machine.compiler, *flags, *names, "-lm", "-o", "replay"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "replay"


def assert_replay_compares(program, example, folder):
    """The program agrees with an example as it is, and finds each answer that is changed."""
    last = example.columns[-1]
    for column, change, code, largest in (
        (last, 0.0, 0, None),
        (last, 1e-8, 1, 1e-8),
        ("kappa_hat", -1e-8, 1, 1e-8),
        ("x_hat_m", np.nan, 1, np.nan),
    ):
        changed = example.copy()
        changed.loc[len(example) // 2, column] += change
        changed.to_csv(folder / "log.csv", index=False)
        ended = subprocess.run([program, folder / "log.csv"], capture_output=True, text=True)
        compared, difference = ended.stderr.strip().split(": ")
        assert compared == f"largest difference in {len(example)} samples"
        assert ended.returncode == code and len(ended.stdout.splitlines()) >= len(example)
        if code:
            assert float(difference) == pytest.approx(largest, rel=0.1, nan_ok=True)
    ended = subprocess.run([program, "nowhere.csv"], capture_output=True, text=True)
    assert ended.returncode == 2 and "nowhere.csv, which cannot be read" in ended.stderr
    ended = subprocess.run([program], capture_output=True, text=True)
    assert ended.returncode == 2 and ended.stderr == f"usage: {program} log.csv\n"


def late_log():
    """Positions between the samples, late by what varies, and some encoders that are missing."""
    log = recorded_log(10.0, 60.0, start_rad=3.0, noise_m=0.02, seed=3, arm_m=(0.3, -0.1))
    log.loc[log.index % 3 > 0, ["x_m", "y_m"]] = np.nan
    log.loc[log.index % 37 < 6, ["speed_mps", "yaw_rate_radps"]] = np.nan
    return log


@pytest.fixture(scope="module")
def summary():
    """By its judge all standard deviations are too small."""
    found = rhec.log(late_log())
    return dataclasses.replace(found, judged=found.judged._replace(inflation=INFLATION))


@pytest.fixture(scope="module")
def folder(summary, tmp_path_factory):
    return rhec.export(summary, tmp_path_factory.mktemp("export") / "C")


@pytest.fixture(scope="module")
def program(folder):
    return compiled_replay(folder, "search.c")


def test_the_c_of_a_log_is_what_was_judged(summary, folder, program, tmp_path):
    example = pd.read_csv(folder / "log.csv")
    assert len(example) > 250
    assert_replay_compares(program, example, tmp_path)
    printed = subprocess.run([program, folder / "log.csv"], capture_output=True, text=True).stdout
    solved = [line.endswith(",0") for line in printed.splitlines()]
    assert solved == summary.way["ok"][-len(example) :].tolist()
    # It is the run that was judged, with its standard deviations, from its first position on.
    way = summary.way.dropna(subset=ESTIMATE[0])[-100:]
    hats = [*ESTIMATE, *LEVER_ARM]
    np.testing.assert_allclose(example[hats][-100:], way[hats], atol=1e-9)
    sigma = ["sigma_x_m", "sigma_mu", "sigma_kappa", "sigma_arm_left_m"]
    times = INFLATION / summary.numbers["inflation"]
    np.testing.assert_allclose(example[sigma][-100:], times * way[sigma], rtol=1e-9)
    readme = (folder / "README.txt").read_text()
    assert readme.count("scalar operations") == 1 and "rhec_search_init" in readme


@pytest.mark.parametrize("yaw_rad", [0.3, 0.35])
def test_without_encoders_at_the_start_the_c_chooses_the_same_direction(
    yaw_rad, summary, program, tmp_path
):
    """A robot in a curve, with a yaw between two of those that are tried."""
    turned = yaw_rad + 0.2 * np.arange(50)
    log = pd.DataFrame(dict(t_s=0.1 * np.arange(50), speed_mps=0.5, yaw_rate_radps=2.0))
    log = log.assign(x_m=0.25 * np.sin(turned), y_m=-0.25 * np.cos(turned))
    log.loc[2:21, ["speed_mps", "yaw_rate_radps"]] = np.nan
    example = example_of(summary.judged._replace(recording=prepare(log)))
    example.to_csv(tmp_path / "log.csv", index=False)
    ended = subprocess.run([program, tmp_path / "log.csv"], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr


def test_a_late_position_is_compared_with_where_the_robot_was_then():
    """Without noise it is not surprising, and becomes the position at the sample."""
    move_late = build_move(window_of(Choice.of(rhec.Scenario())))
    first, p, omega, age_s = (3.0, -2.0, 0.7), (0.5, 0.9, 0.8), 0.4, 0.15
    then, now = (flat(move(first, *p, omega, dt)[:2]) for dt in (DT - age_s, DT))
    z = [*then, p[0], omega]
    found = move_late(estimate=[*first, *p], measured=z, held=z, ages=[age_s] * 4)
    np.testing.assert_allclose(flat(found["z_N"]), [*now, p[0], omega], atol=1e-6)
    assert found["square"] < 1e-12


def test_a_refused_log_has_nothing_to_export(tmp_path):
    with pytest.raises(ValueError, match="the log has no estimator to export. No estimate: "):
        rhec.export(rhec.log(late_log().assign(x_m=1.0, y_m=1.0)), tmp_path / "C")
    assert not (tmp_path / "C").exists()


def test_an_example_begins_at_the_first_position(summary):
    log = late_log()
    log.loc[:20, ["x_m", "y_m"]] = np.nan  # the first one is seconds after the first row
    recording = prepare(log)
    example = example_of(summary.judged._replace(recording=recording))
    assert len(example) == len(recording.samples()[0]) - 11
    assert example[["x_meas_m", "y_meas_m"]].iloc[0].notna().all()
    assert (example["x_meas_m_age_s"] > 0).any()


def test_operations_are_counted_through_calls_branches_and_loops():
    """Of branches the longest counts, and a loop counts as often as it runs."""
    x = ca.SX.sym("x")
    short = ca.Function("short", [x], [x + 1])
    long = ca.Function("long", [x], [ca.sin(x) * x + ca.cos(x)])
    assert operations(long) > operations(short) > 0
    for one, other in ((short, long), (long, short)):
        assert operations(ca.Function.conditional("either", [one], other)) == operations(long)
    assert operations(long.map(7)) == 7 * operations(long)
    y = ca.MX.sym("y")
    twice = ca.Function("twice", [y], [long(long(y))])
    assert operations(twice) == 2 * operations(long) + 2  # an input and an output
    four, five = (ca.MX.sym("A", 3, n) for n in (4, 5))
    products = [ca.Function("of", [A], [A @ ca.MX.ones(A.size2())]) for A in (four, five)]
    # A product and a sum for each of three rows, and a constant.
    assert operations(products[1]) - operations(products[0]) == 2 * 3 + 1


def test_an_estimator_alone_has_no_controller(tmp_path):
    scenario = rhec.Scenario(duration_s=10, estimator="ekf")
    folder = rhec.export(scenario, tmp_path / "C", estimator_only=True)
    example = pd.read_csv(folder / "log.csv")
    assert len(example) == 50
    assert_replay_compares(compiled_replay(folder), example, tmp_path)
    header = (folder / "rhec_memory.h").read_text()
    assert "#define RHEC_CONTROLLER" not in header
    assert not {"times.c", "fuzz.c"} & {file.name for file in folder.iterdir()}
    assert "rhec_control" not in (folder / "README.txt").read_text()
