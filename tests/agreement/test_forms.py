"""One loop in all its forms: live objects, the fused loop, lanes and exported C agree.

Runs of the paper's robot are compared with the compiled fused loop, those of any robot with its
live objects. Lanes have the same bits; the other forms differ by rounding.
"""

import dataclasses
import functools

import numpy as np
import pytest
from helpers import controller, estimator, no_compiler
from in_c import InC
from loops import LOOPS, SMALL, lanes_as_in_use, live_step, unlike
from oracles import mhe_instance, mpc_instance
from robots import ROBOTS, VARIANTS

import rhec
from notebooks.claims.live_robot import LiveRobot
from notebooks.studies import toolchain
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core.lanes import lanes
from rhec.simulation import closed_loop
from rhec.simulation.columns import COMMAND, ESTIMATE, MEASUREMENTS, POSE, SENSORS

TOLERANCE = 1e-9
ANSWERS = [*ESTIMATE, *COMMAND]


def compared(found, expected):
    np.testing.assert_allclose(found, expected, rtol=TOLERANCE, atol=TOLERANCE)


# The paper's robot: its loops are `loops.LOOPS`


def virtual_machine(scenario, run, folder):
    """The fused loop on CasADi's virtual machine."""
    with no_compiler():
        columns = rhec.simulate(scenario).columns
    for name, values in run.columns.items():
        compared(columns[name].astype(float), values.astype(float))


def live(scenario, run, folder):
    """Objects in plain Python, on a robot in plain Python."""
    robot = LiveRobot(scenario)
    step = live_step(scenario)
    rows = []
    for z in robot:
        answers = step(z)
        rows.append([*z[:4], *answers])
        robot.drive(answers[6])
    compared(rows, run.log[[*MEASUREMENTS, *ANSWERS, "kkt_rhe", "kkt_rhc"]].to_numpy(float))


def in_lanes(scenario, run, folder, load=lanes.load):
    """Eight runs that differ in all that no structure holds: side by side, the same bits."""
    if lanes.cpp_compiler() is None:
        pytest.skip("there is no C++ compiler")
    scenarios = [*unlike(scenario)]
    setups = [*map(closed_loop.set_up, scenarios)]
    (structure,) = {setup.structure for setup in setups}
    streams = [
        closed_loop.noise_and_faults(each.seed, each.faults, 100, setups[0].draws)
        for each in scenarios
    ]
    memories, settings = zip(*((setup.memory, setup.settings) for setup in setups))
    functions, block = (
        make(closed_loop.build_sample, *structure) for make in (compiled.load, load)
    )
    assert block.lanes in (2, 4, 8)
    at_once = np.array(runner.run(block, memories, streams, settings))
    for rows, *alone in zip(at_once, memories, streams, settings):
        np.testing.assert_array_equal(rows, runner.run_one(functions, *alone))
    if scenario == SMALL:
        ok = at_once[:, :, closed_loop.COLUMNS.index("ok")]
        assert ok.all(axis=1).any() and not ok.all(axis=1).all()


def in_c(scenario, run, folder, machine=toolchain.this_machine):
    """The exported C, which is given the log."""
    machine = machine()
    if machine is None:
        pytest.skip("there is no such compiler, or no emulator")
    export = rhec.export(scenario, folder / "export")
    quickly = [flag.replace("-O3", "-O0") for flag in toolchain.FLAGS if "frame" not in flag]
    objects = toolchain.library(machine, export, folder, quickly)
    program = toolchain.program(machine, export, "replay", objects, quickly)
    answers = toolchain.replay(machine, program, export / "log.csv")
    compared(answers[ANSWERS], run.log[ANSWERS])
    predicted = toolchain.STATUS["predicted"]
    np.testing.assert_array_equal(answers["status"], np.where(run.log["ok"] == 1, 0, predicted))
    assert toolchain.run(machine, program, export / "log.csv").returncode == 0


def as_in_use(scenario, run, folder):
    in_lanes(scenario, run, folder, lanes_as_in_use)


def on_arm(scenario, run, folder):
    in_c(scenario, run, folder, toolchain.arm)


def driven_by_yaw_rate():
    """The loops whose controller leaves the speed alone, which no log has.

    Of those that have further sensors one always; the form `live` compares what all have.
    """
    for name, loop in LOOPS.items():
        controller = loop.fields.get("controller")
        if controller is None or "speed_mps" not in controller.step.name_out():
            marks = () if name == "sensors and faults" else pytest.mark.nightly
            yield pytest.param(name, marks=marks)


FORMS = (virtual_machine, live, in_lanes, in_c)
# {loop: its forms in the quick tests}; tests/simulation/test_lanes.py runs more loops in lanes.
ALWAYS = {
    "rhe": (live,),
    "sensors and faults": (virtual_machine, live, in_lanes),
    "yaw drift with a gyro": (live, in_c),
    "everything else": (virtual_machine, in_c),
    "own controller": (virtual_machine, in_lanes),
}
NIGHTLY = [(name, form) for name in ("rhe", "own") for form in (as_in_use, on_arm)]


def forms_of(loop):
    """The forms that a loop has: not all are exported, and live objects are those of the paper."""
    return [form for form in FORMS if form.__name__ not in loop.without]


def loops_and_forms():
    for name, loop in LOOPS.items():
        for form in forms_of(loop):
            marks = () if form in ALWAYS.get(name, ()) else pytest.mark.nightly
            yield pytest.param(name, form, marks=marks, id=f"{name}, {form.__name__}")
    for name, form in NIGHTLY:
        yield pytest.param(name, form, marks=pytest.mark.nightly, id=f"{name}, {form.__name__}")


@functools.cache
def fused(name):
    """A loop's scenario and its run by the compiled fused loop."""
    scenario = dataclasses.replace(SMALL, **LOOPS[name].fields)
    return scenario, rhec.simulate(scenario)


@pytest.mark.parametrize("name", [*driven_by_yaw_rate()])
def test_a_robot_in_plain_python_has_all_that_the_loops_robot_has(name):
    """Driven by the commands of a run, whatever made them, it measures what the run measured."""
    scenario, run = fused(name)
    log = run.log
    columns = [*MEASUREMENTS, *(SENSORS[name] for name in SENSORS if name in scenario.sensors)]
    robot = LiveRobot(scenario)
    rows = []
    for z, command in zip(robot, log["omega_cmd_radps"]):
        rows.append([*z, *robot.pose])
        robot.drive(command)
    compared(rows, log[[*columns, *POSE]].to_numpy())


@pytest.mark.parametrize(("name", "form"), [*loops_and_forms()])
def test_a_loop_of_the_papers_robot_is_the_same_in_every_form(name, form, tmp_path):
    form(*fused(name), tmp_path)


# Any robot: an RHE and an RHC of each Model of `robots`. Beside the objects exported C alone has
# both: no loop of the simulated robot is made of a Model, and a replay scans the estimator alone.

EVERY_ROBOT = ROBOTS | VARIANTS
HORIZON = 3
SAMPLES = 40
OUTLIER = 25  # the sample that is 1 km off


def problem_of(robot):
    """A guess, measurements with gaps and one outlier, and references that keep bounds active."""
    rng = np.random.default_rng(0)
    guess, z = mhe_instance(robot, rng, SAMPLES, missing=0.1)
    z[OUTLIER] += 1000.0
    wanted = [mpc_instance(robot, rng, HORIZON) for _ in range(SAMPLES)]
    return guess, z[:SAMPLES], [(each["x_ref"], each["u_ref"]) for each in wanted]


@pytest.mark.skipif(not compiled.compiler(), reason="there is no C compiler")
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name == "bicycle" else pytest.mark.nightly)
        for name in EVERY_ROBOT
    ],
)
def test_a_loop_of_any_robot_is_the_same_in_exported_c(name, tmp_path):
    """Whether it was prepared in time or not."""
    robot = EVERY_ROBOT[name]
    guess, z, references = problem_of(robot)
    with no_compiler():
        mhe, mpc = estimator(robot, guess, horizon=HORIZON), controller(robot, horizon=HORIZON)
        c = InC(rhec.export((mhe, mpc), tmp_path / "rhec"))
    n_x, n_p, n_e = len(mhe.model.states), len(mhe.model.parameters), len(mhe.model.names)
    for k, (row, wanted) in enumerate(zip(z, references)):
        mhe.prepare()
        mpc.prepare()
        estimate = mhe.feedback(row)
        u = mpc.feedback(estimate.x, estimate.p, *wanted)
        if k % 3:
            c.prepare()
        known, status = c.call("estimate", row, length=n_e)
        command, _ = c.call("control", known[:n_x], known[n_e - n_p :], *wanted, length=len(u))
        compared([*known, *command], [*np.concatenate(estimate[:3]), *u])
        assert mhe.ok == (status == 0)
        assert k != OUTLIER or not mhe.ok
