"""The exported C: its answers equal Python's on every machine, it needs libm alone, and no input
makes it fail; its report.
"""

import dataclasses
import functools
import json
import re
import shutil
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pandas as pd
import pytest
from helpers import no_compiler
from in_c import InC
from loops import live_step, own_estimator

import rhec
from notebooks.studies import exported_c, toolchain
from rhec import paper
from rhec.core._casadi import compiled
from rhec.embedded import c_writer, exported_functions
from rhec.simulation.columns import MEASUREMENTS

# The paper's loop, but for its horizons, which only compile longer.
PAPER = rhec.Scenario(duration_s=20.0, seed=1, estimation_horizon=3, prediction_horizon=3)
TOLERANCE = 1e-9
# Without optimising, frames are larger than the limit, which is for an export as it is meant to be.
QUICKLY = [flag.replace("-O3", "-O0") for flag in toolchain.FLAGS if "frame" not in flag]
needs_compiler = pytest.mark.skipif(not compiled.compiler(), reason="there is no C compiler")
SCENARIOS = {
    "paper": PAPER,
    "EKF": dataclasses.replace(PAPER, estimator="ekf", process_noise="prediction"),
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """name of a scenario -> its export, made once."""

    @functools.cache
    def export(name):
        return rhec.export(SCENARIOS[name], tmp_path_factory.mktemp("export") / "rhec")

    return export


@pytest.fixture(scope="module")
def built(exported, tmp_path_factory):
    """name of a scenario -> (this Machine, object files), made once."""

    @functools.cache
    def build(name):
        machine = toolchain.this_machine()
        if machine is None:
            pytest.skip("there is no C compiler")
        folder = tmp_path_factory.mktemp("built")
        return machine, toolchain.library(machine, exported(name), folder, QUICKLY)

    return build


@pytest.fixture
def robot(exported):
    """The paper's export, in C; not optimised, and the same answers."""
    if not compiled.compiler():
        pytest.skip("there is no C compiler")
    return InC(exported("paper"))


@pytest.fixture(scope="module")
def measured(exported):
    """The measurements (samples, 4) of the log in the paper's export."""
    return log_of(exported("paper"))[MEASUREMENTS].to_numpy()


def log_of(export):
    return pd.read_csv(export / "log.csv")


# Its answers equal Python's


def spoilt(measured):
    """A tenth of all entries is missing, infinite or absurd; four samples are missing."""
    z, rng = measured.copy(), np.random.default_rng(0)
    for value in (np.nan, np.inf, -1e300):
        z[rng.random(z.shape) < 0.1] = value
    z[40:44] = np.nan
    return z


def displaced(measured):
    """One sample 1 km off, then positions 5 m off for good, which the RHE takes at last, and some
    that scatter, of which it takes none for longer than its window.
    """
    z = measured.copy()
    z[10, :2] += (600.0, -800.0)
    z[20:, 0] += 5.0
    z[60:70, :2] += np.random.default_rng(0).uniform(-1e3, 1e3, (10, 2))
    return z


@pytest.mark.parametrize("spoil", [spoilt, displaced])
def test_answers_to_wrong_measurements_equal_pythons(spoil, robot, measured):
    z, live = spoil(measured), live_step(PAPER)
    answers = [[*estimate, omega] for estimate, omega, _ in map(robot.step, z)]
    expected = [live(row)[:7] for row in z]
    np.testing.assert_allclose(answers, expected, rtol=0, atol=TOLERANCE)
    if spoil is displaced:
        assert abs(answers[10][0] - answers[9][0]) < 1 > abs(answers[-1][0] - z[-1, 0])


def test_a_rejected_yaw_rate_is_no_reference_as_a_missing_one_is_none(robot, measured):
    """The last command stands in for either; beside a wild position a wild yaw rate is rejected."""
    commands = []
    for wild in (3.0, np.nan):
        robot.begin()
        z = measured[:11].copy()
        z[10] += (600.0, -800.0, 0.0, wild)
        commands.append([robot.step(row)[1] for row in z])
    np.testing.assert_allclose(commands[0], commands[1], rtol=0, atol=TOLERANCE)


@needs_compiler
def test_an_estimator_that_rejects_nothing_gives_the_path_each_valid_yaw_rate(exported, measured):
    """The first estimate is the same whatever the yaw rate, and the command before it is 0."""
    robot = InC(exported("EKF"))
    commands = []
    for omega in (0.0, np.nan, 1e9, 0.02):
        robot.begin()
        commands.append(robot.step([*measured[0, :3], omega])[1])
    assert commands[0] == commands[1] == commands[2] != commands[3]


# The clock that is read for the nth time shows n² ns.
CLOCK = """#define _POSIX_C_SOURCE 199309L
#include <time.h>
int clock_gettime(clockid_t id, struct timespec *t)
{
    static long n;
    *t = (struct timespec){0, (n + id * 0) * n};
    n++;
    return 0;
}
"""


def test_times_has_a_row_of_four_phases_for_each_sample(exported, built, tmp_path):
    machine, objects = built("EKF")
    (tmp_path / "clock.c").write_text(CLOCK)
    sources = [*objects, tmp_path / "clock.c"]
    program = toolchain.program(machine, exported("EKF"), "times", sources, QUICKLY)
    printed = toolchain.run(machine, program, exported("EKF") / "log.csv").stdout
    taken = np.loadtxt(printed.splitlines(), delimiter=",", skiprows=1)
    assert taken.shape == (len(log_of(exported("EKF"))), 4)
    begins = 5 * np.arange(len(taken))[:, None]
    np.testing.assert_array_equal(taken, 2 * (begins + np.arange(4)) + 1)


def test_the_closest_point_equals_path_project():
    rng = np.random.default_rng(2)
    for target in (
        rhec.Path.racetrack(30.0, 7.8),
        rhec.Path.from_segments([(3.0, 0.0), (4.0, 0.1), (20.0, -0.05)], start=(1.0, 2.0, 0.5)),
        rhec.Path.from_segments([(5.0, -0.3), (2.0, 0.0)]),
    ):
        xy = rng.uniform(-20, 40, (300, 2))
        xy[0] = target.segments[0, 1:3]  # its beginning, which is the end of a racetrack, too
        estimates = np.column_stack([xy, np.zeros((300, 4))]).T
        found = exported_functions.closest(len(target.segments))(
            estimate=estimates, segments=target.segments.T, length_m=target.length_m
        )["s_m"]
        _, s = target.project(xy)
        np.testing.assert_allclose(found.full().ravel(), s, atol=1e-6)


# How it is called


def test_implausible_entries_of_the_guess_are_replaced(robot, measured):
    robot.begin([np.nan, np.inf, 1e300, -1e9, np.nan, 50])
    nonsense, _, _ = robot.step(measured[0])
    robot.begin([0, 0, 0, 0, 1, 1])
    np.testing.assert_array_equal(nonsense, robot.step(measured[0])[0])
    for place, largest in enumerate((1e8, 1e8, 1e6, 100)):  # of what is plausible
        for share, is_used in ((0.9, True), (1.1, False)):
            guess = np.array([0, 0, 0, 0, 1, 1.0])
            guess[place] = share * largest
            robot.begin(guess)
            estimate, *_ = robot.step([np.nan] * 4)
            assert (abs(estimate[place]) > 0.8 * largest) == is_used


def test_a_single_number_that_is_overwritten_does_no_lasting_harm(robot, measured):
    """Whichever it is: after some samples nothing is predicted, planned or restarted."""
    doubles = np.frombuffer(robot.memory, dtype=float)
    for place in range(4, doubles.size):
        robot.begin()
        for z in measured[:3]:
            robot.step(z)
        doubles[place] = np.nan
        for z in measured[3:8]:
            estimate, omega, status = robot.step(z)
            assert abs(omega) <= paper.OMEGA_MAX_RADPS
        assert status == 0 and np.hypot(*(estimate[:2] - z[:2])) < 0.2, place


@needs_compiler
def test_a_lost_estimate_starts_again_at_the_position_with_the_yaw_it_had(exported, measured):
    """From there on it is that of a robot that has just begun with this pose and speed.

    The EKF takes a position as it is, and is lost where it has to go too far.
    """
    robot = InC(exported("EKF"))
    for z in measured[:50]:
        last, _, status = robot.step(z)
        assert status == 0
    far = measured[50] + [5e7, -3e7, 0, 0]
    estimate, _, status = robot.step(far)
    assert status & toolchain.STATUS["estimator_restarted"]
    np.testing.assert_array_equal(estimate, [far[0], far[1], last[2], far[2], 1, 1])
    begun = InC(exported("EKF"), guess=estimate)
    for z in measured[51:80]:
        after = robot.call("estimate", z, length=6)[0]
        np.testing.assert_array_equal(after, begun.call("estimate", z, length=6)[0])
    robot.begin()
    for z in measured[:50]:
        last, *_ = robot.step(z)
    half, _, status = robot.step([far[0], np.nan, np.nan, 0])  # what is missing is as it was
    assert status & toolchain.STATUS["estimator_restarted"]
    np.testing.assert_array_equal(half, [far[0], last[1], last[2], last[3], 1, 1])


# What it needs; fuzzing


STRICT = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"]
IN_CPP = """#include "rhec.h"
int main() { static rhec r; rhec_init(&r, &rhec_scenario, rhec_scenario_guess); }
"""


@needs_compiler
@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++", "clang++", "aarch64-linux-gnu-gcc"])
def test_no_compiler_warns(compiler, exported):
    """The header is for C++ as well."""
    if not shutil.which(compiler):
        pytest.skip(f"there is no {compiler}")
    for folder in map(exported, ("paper", "EKF")):
        sources, standard = sorted(folder.glob("*.c")), "-std=c99"
        if compiler.endswith("++"):
            sources, standard = ["-x", "c++", "-"], "-std=c++11"
        command = [compiler, standard, *STRICT, f"-I{folder}", *sources]
        subprocess.run(command, input=IN_CPP, text=True, check=True)


@needs_compiler
def test_it_needs_libm_alone_and_has_no_global_variables(built):
    """And what compilers themselves call."""
    _, objects = built("paper")
    own = {"rhec_scenario", "rhec_scenario_guess", "rhec_variances", "_GLOBAL_OFFSET_TABLE_"}
    libm = {*"sin cos sincos atan2 hypot floor fmin fmax fabs log sqrt".split()}
    undefined = output_of("nm", "-u", *objects).split()
    names = {name for name in undefined if name not in ("U", ":") and not name.endswith(".o:")}
    assert names <= own | libm | {"memcpy", "memset", "memmove"}
    for line in output_of("size", *objects).splitlines()[1:]:
        assert line.split()[1:3] == ["0", "0"]  # data, bss


def output_of(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


@needs_compiler
def test_sanitizers_find_nothing_while_fuzzing(exported, tmp_path):
    compiler = shutil.which("clang") or compiled.compiler()
    sanitizers = ["-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
    command = [compiler, "-std=c99", "-O0", *sanitizers, "-o", tmp_path / "fuzz"]
    probe = [*command, "-x", "c", "-"]
    if subprocess.run(probe, input="int main(void) { return 0; }", text=True).returncode:
        pytest.skip(f"{compiler} has no sanitizers")
    sources = [f"{exported('paper')}/{source}" for source in ("fuzz.c", *toolchain.LIBRARY)]
    # Of a number that no int holds this is undefined; few storms overwrite a flag with one.
    assert "((casadi_int) x)" not in (exported("paper") / "rhec_functions.h").read_text()
    subprocess.run([*command, f"-I{exported('paper')}", *sources, "-lm"], check=True)
    machine = toolchain.this_machine()
    came_back = toolchain.nonsense(machine, tmp_path / "fuzz", 1500, 1).iloc[0]
    samples, storms = came_back["samples"], came_back["storms"]
    # A storm lasts 1 to 60 samples, and 100 calm ones follow.
    assert samples >= 1500 and storms % 10 == 0 and 101 * storms <= samples <= 160 * storms
    assert came_back["still_lost"] < 0.2 * storms and came_back["unnoticed"] == 0
    assert 0 < came_back["estimator_restarted"] < 0.9 * samples


WRONG = """#include <stdlib.h>
static int wrong(int kind) { return *getenv("WRONG") == kind; }
"""


@needs_compiler
def test_fuzzing_detects_what_is_wrong_with_an_answer(exported, built, tmp_path, monkeypatch):
    """A command out of bounds, an estimate that is no number, and one that is wrong by a metre.

    And what is never solved begins anew once it was predicted for as long as it may be.
    """
    folder = exported("EKF")
    machine, (_, scenario) = built("EKF")
    text = (folder / "rhec.c").read_text()
    for right, changed in (
        ("*omega = r->omega[0];", "*omega *= wrong('c') ? 1.001 : 1;"),
        (
            "memcpy(estimate, r->estimate, sizeof r->estimate);",
            "estimate[5] *= wrong('n') ? 1e308 * 10 : 1; estimate[0] += wrong('m');",
        ),
    ):
        assert right in text
        text = text.replace(right, f"{right} {changed}")
    assert "= estimator_ok(r) ?" in text
    text = text.replace("= estimator_ok(r) ?", "= estimator_ok(r) && !wrong('u') ?")
    (tmp_path / "rhec.c").write_text(WRONG + text)
    sources = tmp_path / "rhec.c", folder / "fuzz.c", scenario
    command = [machine.compiler, *QUICKLY, f"-I{folder}", *sources, "-lm"]
    subprocess.run([*command, "-o", tmp_path / "fuzz"], cwd=tmp_path, check=True)

    def fuzzed(wrong):
        monkeypatch.setenv("WRONG", wrong)
        return toolchain.nonsense(machine, tmp_path / "fuzz", 1500, 0).iloc[0]

    with pytest.raises(RuntimeError, match="^fuzz failed: omega was -?0.1001$"):
        fuzzed("c")
    with pytest.raises(RuntimeError, match="^fuzz failed: estimate 5 was -?inf$"):
        fuzzed("n")
    off = fuzzed("m")
    assert off["still_lost"] == off["storms"] >= off["unnoticed"] > 0.5 * off["storms"]
    assert fuzzed("")["unnoticed"] == 0
    unsolved = fuzzed("u")
    patience = re.search(r"RHEC_PATIENCE (\d+)", (folder / "rhec_memory.h").read_text())[1]
    expected = unsolved["samples"] / (int(patience) + 1)
    assert unsolved["estimator_restarted"] == pytest.approx(expected, rel=0.05)


def test_an_export_is_as_far_from_python_as_its_log_says(exported, built, tmp_path, monkeypatch):
    """Also from a log of which one answer is 0.5 m off."""
    machine, objects = built("EKF")
    monkeypatch.setattr(toolchain, "arm", lambda: None)
    monkeypatch.setattr(toolchain, "library", lambda *_: objects)
    other = shutil.copytree(exported("EKF"), tmp_path / "other")
    log = log_of(other)
    log.loc[7, log.columns.difference(MEASUREMENTS)[0]] -= 0.5
    log.to_csv(other / "log.csv", index=False)
    for export, off in ((exported("EKF"), 0.0), (other, 0.5)):
        (row,) = exported_c.sizes(export).to_dict("records")
        assert row["machine"] == machine.name
        assert row["largest_difference"] == pytest.approx(off, abs=1e-6)
        assert f"RHEC_MEMORY_BYTES {row['memory_bytes']}" in (export / "rhec_memory.h").read_text()
        assert row | toolchain.sizes(machine, objects) == row


@needs_compiler
def test_header_and_readme_tell_the_period_and_the_sizes_of_memory_and_constants(exported):
    readme = (exported("paper") / "README.txt").read_text()
    memory, constants = re.findall(r"(?:whole memory|constants) +(\S+)", readme)
    assert float(re.search(r"every (\S+) ms", readme)[1]) == pytest.approx(1000 * paper.DT_S)
    program = (
        '#include "rhec.h"\n'
        "int header[sizeof(struct rhec) == RHEC_MEMORY_BYTES ? 1 : -1];\n"
        f"int memory[RHEC_MEMORY_BYTES == {memory} ? 1 : -1];\n"
        "int constants[sizeof(struct rhec_settings) + sizeof rhec_scenario_guess"
        f" == {constants} ? 1 : -1];\n"
    )
    compiler = toolchain.this_machine().compiler
    command = [compiler, f"-I{exported('paper')}", "-fsyntax-only", "-x", "c", "-"]
    subprocess.run(command, input=program, text=True, check=True)


def test_the_memory_of_the_default_scenario_is_that_of_its_page():
    header = c_writer.memory_header(exported_functions.export(rhec.Scenario(), False))
    memory = int(header.split("RHEC_MEMORY_BYTES ")[1].split()[0])
    page = (Path(rhec.__file__).parents[1] / "docs/embedded.md").read_text(encoding="utf-8")
    assert f"memory of the default scenario is {memory / 1024:.0f} KiB" in page


# The folder


def files_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_export_is_reproducible_and_tells_of_every_field(exported, tmp_path):
    again = files_of(rhec.export(PAPER, tmp_path / "again"))
    assert again == files_of(exported("paper"))
    fields = json.loads(again["scenario.json"])
    values = {name: tuple(v) if isinstance(v, list) else v for name, v in fields.items()}
    assert rhec.Scenario(**values) == PAPER
    assert {*fields} == {field.name for field in dataclasses.fields(rhec.Scenario)}


def test_a_readme_counts_each_phase_in_the_preparation_or_in_the_feedback(exported):
    readme = " ".join((exported("paper") / "README.txt").read_text().split())
    said = r"(\d+) scalar operations to prepare, and (\d+) from the measurement on"
    preparing, feeding = map(int, re.search(said, readme).groups())
    counts = {True: 0, False: 0}
    for name, phase in exported_functions.export(PAPER, False).phases.items():
        is_prepared = name.endswith(("expand", "shift", "linearise"))
        counts[is_prepared] += exported_functions.operations(phase.function)
    assert (preparing, feeding) == (counts[True], counts[False])


def test_an_export_tells_of_an_own_estimator_and_path_what_they_compute(tmp_path):
    own, path = own_estimator(), rhec.Path.racetrack(8.0, 4.0)
    with no_compiler():
        scenario = rhec.Scenario(estimator=own, path=path, duration_s=70.0)
        folder = rhec.export(scenario, tmp_path / "own", estimator_only=True)
    assert len(log_of(folder)) == 60.0 / paper.DT_S  # the example is not longer
    told = json.loads((folder / "scenario.json").read_text())
    assert told["duration_s"] == 70.0
    given = np.arange(own.numel_in(0)), [1.0, 2.0, 0.5, 0.1]
    for one, other in zip(ca.Function.deserialize(told["estimator"]["step"])(*given), own(*given)):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(told["path"]["segments"], path.segments)
