"""What is done to the world × what is run in it: estimates and plans have to follow.

They do not depend on where, how turned and in which units a robot is, nor on what does not count.
Each row of the table is a robot, a run and a change. `make test` has each run of the live objects
with most changes once (QUICK says which), `make nightly` all rows. That exported C computes the
same, `tests/agreement` shows. A closed loop with its world is in
`tests/simulation/test_both_sides`.
"""

import functools
import itertools

import numpy as np
import pandas as pd
import pytest
from invariances import Change, Lane, Linear, largest_difference, told_in
from oracles import flat, mhe_instance, mpc_instance, plant
from robots import BICYCLE, CART, CART_POLE, CRAWLER, DT, SKID_STEERED, UNICYCLE

import rhec

pytestmark = pytest.mark.usefixtures("virtual_machine")
ROBOTS = {
    "crawler": CRAWLER,
    "bicycle": BICYCLE,
    "unicycle": UNICYCLE,
    "tracks": SKID_STEERED,
    "cart": CART,
    "cart-pole": CART_POLE,
}
SAMPLES, HORIZON = 50, 15
COMMANDS = 12

# What is done to the world

# Quantities that change signs in a mirror, and where a robot is taken for one that goes backwards.
SIDES = "y_m antenna_y_m theta_rad steering_rad steering_offset_rad yaw_rate_radps omega_radps"
SIDES += " position_m velocity_mps acceleration_mps2 bias_mps2 pole_rad pole_radps force_n"
AHEAD = "speed_mps nu_mps v_left_mps v_right_mps steering_rad steering_offset_rad lever_arm_m"
UTM_M = dict(x_m=5.8e6, y_m=4e5)
PLACES = UTM_M | {f"antenna_{name}": by for name, by in UTM_M.items()} | dict(position_m=5.8e6)


def names_of(robot):
    """All quantities of a robot."""
    return dict.fromkeys([*robot.states, *robot.inputs, *robot.parameters, *robot.outputs])


def flipped(robot, names):
    """The rows of a Linear: these change signs, and left and right change places."""
    other = {"left": "right", "right": "left"}
    sides = {name: "_".join(other.get(w, w) for w in name.split("_")) for name in names_of(robot)}
    return {name: {sides[name]: -1.0 if name in names.split() else 1.0} for name in sides}


def mirrored(robot):
    mirror = Linear(flipped(robot, SIDES))
    return told_in(mirror, mirror, keeps_model=True)


def backwards(robot):
    """The robot is taken to be turned by half a turn, and to drive backwards."""
    rows = flipped(robot, AHEAD)
    there, back = (Linear(rows, {"theta_rad": turn}) for turn in (np.pi, -np.pi))
    return told_in(there, back, keeps_model=True)


def moved(robot):
    back = {name: -by for name, by in PLACES.items()}
    return told_in(Linear({}, PLACES), Linear({}, back), keeps_model=True)


def turned(robot):
    """By 2 rad; a pole by a full turn."""

    def rotation(by, turn):
        c, s = np.cos(by), np.sin(by)
        pairs = (("x_m", "y_m"), ("antenna_x_m", "antenna_y_m"))
        rows = [{x: {x: c, y: -s}, y: {x: s, y: c}} for x, y in pairs]
        return Linear(rows[0] | rows[1], dict(theta_rad=by, pole_rad=turn))

    return told_in(rotation(2.0, 2 * np.pi), rotation(-2.0, -2 * np.pi), keeps_model=True)


def in_units(factor_of, second=1.0):
    """Quantities by a factor of their name, and times in units of which a second has so many."""

    def change(robot):
        factors = {name: factor_of(name) for name in names_of(robot)}
        there, back = (
            Linear({name: {name: factor**sign} for name, factor in factors.items()})
            for sign in (1, -1)
        )
        return told_in(there, back, time=second)

    return change


def physical(metre=1.0, radian=1.0, second=1.0):
    """A metre, a radian and a second have so many of the new units."""
    units = dict(m=metre, mps=metre / second, mps2=metre / second**2)
    units |= dict(rad=radian, radps=radian / second)
    return in_units(lambda name: units.get(name.split("_")[-1], 1.0), second)


def in_another_order(robot):
    return told_in(Linear(), Linear(), order=lambda names: (*names[1::2], *names[::2]))


def same(results):
    return results


def with_(**changes):
    """What else is told does not count."""
    return lambda robot: Change(lambda world: world | changes, same)


def lane_as_output(robot):
    """The bounds of a state are those of an output."""
    place = robot.states.index(lane_of(robot))

    def apply(world):
        return world | dict(lane=world["lane"]._replace(output=lambda x, u, p: x[place]))

    return Change(apply, same)


SYMMETRIC = dict(mirrored=mirrored, backwards=backwards, moved=moved, turned=turned)
TOLD = SYMMETRIC | {
    "in mm": physical(metre=1e3),
    "in degrees": physical(radian=180 / np.pi),
    "in ms": physical(second=1e3),
    "each in a unit of its own": in_units(lambda name: 10.0 ** (len(name) % 7 - 3)),
    "in another order": in_another_order,
}
LATER = {"after a restart": with_(before=20)}
CLOCK = {"by another clock": with_(start_s=1.7e9)}
SAME_PLAN = {
    "cost times 1e6": with_(cost=1e6),
    "cost times 1e-6": with_(cost=1e-6),
    "a redundant bound": with_(more=(-50.0, 50.0)),
    "a price that never counts": with_(more=rhec.Bound(-50.0, 50.0, linear=1e3)),
    "a lane as an output": lane_as_output,
}

# What is run


def lane_of(robot):
    """The state that is bounded."""
    return robot.states[1]


@functools.cache
def world_of(robot):
    """Samples of a drive, some of them wild or without positions or inputs; a plan to be made."""
    rng = np.random.default_rng(0)
    guess, z = mhe_instance(robot, rng, SAMPLES)
    measured = dict(zip(robot.outputs, z.T))
    moved = z + np.outer(
        np.arange(SAMPLES + 1) >= 40, [5.0 * (name in PLACES) for name in measured]
    )
    for name, values in measured.items():
        if name in robot.inputs:
            values[15:19] = np.nan
        elif name not in robot.parameters:
            values[22:24] = np.nan
            values[30:32] += 1.0 * (name in PLACES)
    joint = (*robot.states, *robot.parameters)
    plan = mpc_instance(robot, rng, HORIZON)
    place = robot.states.index(lane_of(robot))
    ends = np.sort([plan["x"][place], plan["x_ref"][place, 6]]) + [-0.02, 0.02]
    return dict(
        robot=robot,
        dt=DT,
        z=measured,
        z_moved=dict(zip(robot.outputs, moved.T)),
        guess=dict(zip(joint, guess)),
        x=dict(zip(robot.states, plan["x"])),
        p=dict(zip(robot.parameters, plan["p"])),
        x_ref=dict(zip(robot.states, plan["x_ref"])),
        u_ref=dict(zip(robot.inputs, plan["u_ref"])),
        lane=Lane(lane_of(robot), tuple(ends)),
        more=None,
        cost=1.0,
        before=0,
        start_s=0.0,
    )


def told(world, key, names):
    """Quantities of a world as an array, a row for each name."""
    return np.array([world[key][name] for name in names])


def by_name(names, rows):
    """{name: series} of the rows of results."""
    return dict(zip(names, np.array(rows).T))


def estimator(world, kind, **settings):
    """A live RHE or EKF; how noisy its robot is it is told by the robot."""
    robot = world["robot"]
    guess = tuple(told(world, "guess", (*robot.states, *robot.parameters)))
    settings = dict(dt=world["dt"], guess=guess) | robot.estimator | settings
    return kind(model=rhec.Model(**robot.model), **settings)


def steps_of(live, world, z):
    """The estimates of a live object that was restarted after some samples."""
    z = told(world, z, world["robot"].outputs).T
    for row in z[: world["before"]]:
        live.step(row)
    live.restart()
    return [live.step(row) for row in z]


def estimates(world, kind, z="z", **settings):
    live = estimator(world, kind, **settings)
    found = [np.concatenate(each[:3]) for each in steps_of(live, world, z)]
    return by_name(live.model.names, found)


def papers_estimates(world, process_noise):
    """The paper's own RHE."""
    names = (*world["robot"].states, *world["robot"].parameters)
    live = rhec.RHE(guess=tuple(told(world, "guess", names)), process_noise=process_noise)
    return by_name(names, [each[:6] for each in steps_of(live, world, "z")])


def replayed(world, estimator):
    robot = world["robot"]
    t_s = world["start_s"] + world["dt"] * np.arange(SAMPLES + 1)
    log = pd.DataFrame(dict(t_s=t_s) | world["z"])
    guess = tuple(told(world, "guess", (*robot.states, *robot.parameters)))
    settings = dict(model=rhec.Model(**robot.model), dt=world["dt"], guess=guess)
    settings |= dict(horizon=8) if estimator == "rhe" else {}
    found = rhec.replay(log, estimator, **settings, **robot.estimator)
    return {name: found[f"{name}_hat"].to_numpy() for name in robot.states}


def controller(world, in_lane):
    robot = world["robot"]
    settings = robot.controller
    settings |= {name: np.array(settings[name]) * world["cost"] for name in ("q", "r")}
    bounds = dict(robot.bounds)
    lane = world["lane"]
    if in_lane and lane.output:
        settings["outputs"] = {"lane": lane.output}
    if in_lane:
        bounds["lane" if lane.output else lane.name] = lane.ends
    if world["more"] is not None:
        bounds[robot.states[0]] = world["more"]
    settings |= dict(model=rhec.Model(**robot.model), dt=world["dt"], horizon=HORIZON)
    return rhec.RHC(**settings | dict(bounds=bounds))


def driven(world, command):
    """The commands {input: series} of a loop, by a function of x, p, x_ref and u_ref."""
    robot = world["robot"]
    step = plant(robot, world["dt"])
    x, p = told(world, "x", robot.states), told(world, "p", robot.parameters)
    references = told(world, "x_ref", robot.states), told(world, "u_ref", robot.inputs)
    found = []
    for _ in range(COMMANDS):
        found.append(np.ravel(command(x, p, *references)))
        x = flat(step(x, found[-1], p)[0])
    return by_name(robot.inputs, found)


def commands(world, in_lane):
    return driven(world, controller(world, in_lane).step)


def papers_commands(world):
    """The paper's own RHC."""
    rhc = rhec.RHC()

    def command(x, p, x_ref, u_ref):
        rhc.prepare()
        return rhc.feedback(x, p, x_ref, u_ref[0])

    return driven(world, command)


RUNS = {
    "RHE": (functools.partial(estimates, kind=rhec.RHE, horizon=8), TOLD | LATER),
    # Positions have moved for good, so that it restarts: along the axes of its states.
    "RHE that restarts": (
        functools.partial(estimates, kind=rhec.RHE, horizon=8, z="z_moved"),
        {name: change for name, change in TOLD.items() if name != "turned"},
    ),
    "EKF": (functools.partial(estimates, kind=rhec.EKF), TOLD | LATER),
    "RHC": (functools.partial(commands, in_lane=False), TOLD | SAME_PLAN),
    "RHC in a lane": (functools.partial(commands, in_lane=True), TOLD | SAME_PLAN),
    "replayed RHE": (functools.partial(replayed, estimator="rhe"), TOLD | CLOCK),
    "replayed EKF": (functools.partial(replayed, estimator="ekf"), TOLD | CLOCK),
}
PAPERS_RUNS = {
    f"paper's RHE {noise}": (
        functools.partial(papers_estimates, process_noise=noise),
        SYMMETRIC | LATER,
    )
    for noise in ("printed", "consistent", "prediction", "tracking")
}
PAPERS_RUNS["paper's RHC"] = (papers_commands, SYMMETRIC)
TABLE = [(robot, run, change) for robot in ROBOTS for run in RUNS for change in RUNS[run][1]]
PAPERS = [("crawler", run, change) for run in PAPERS_RUNS for change in PAPERS_RUNS[run][1]]


def alternately(run, robots, without=()):
    """Rows of the changes with these robots in turn, but for some changes."""
    changes = [change for change in RUNS[run][1] if change not in without]
    return {(robots[k % len(robots)], run, change) for k, change in enumerate(changes)}


# Of units those in which each quantity has one of its own, and those of time.
UNITS = ("in mm", "in degrees")
QUICK = alternately("RHE", ("crawler", "bicycle"), UNITS)
QUICK |= alternately("RHE that restarts", ("bicycle",), (*SYMMETRIC, *UNITS, "in ms"))
QUICK |= alternately("EKF", ("tracks", "unicycle"))
# Rows that are never near their bounds are beside those of a lane.
WIDE = ("a redundant bound", "a price that never counts")
QUICK |= alternately("RHC", ("unicycle", "cart-pole"), (*UNITS, *WIDE, "a lane as an output"))
QUICK |= alternately("RHC in a lane", ("cart", "crawler"), UNITS)
# A replay otherwise is its live estimator, as `test_any_robot` shows.
QUICK |= {("bicycle", "replayed RHE", *CLOCK), ("tracks", "replayed EKF", *CLOCK)}
QUICK |= {row for row in PAPERS if row[1] in ("paper's RHE printed", "paper's RHC")}


def rows():
    for row in [*TABLE, *PAPERS]:
        yield pytest.param(row, marks=() if row in QUICK else pytest.mark.nightly, id=" ".join(row))


@functools.cache
def first_results(robot, run):
    run, _ = (RUNS | PAPERS_RUNS)[run]
    return run(world_of(ROBOTS[robot]))


@pytest.mark.parametrize("row", [*rows()])
def test_estimates_and_commands_follow(row):
    robot, name, change = row
    run, changes = (RUNS | PAPERS_RUNS)[name]
    first = first_results(robot, name)
    robot = ROBOTS[robot]
    assert largest_difference(first, run, world_of(robot), changes[change](robot)) < 1e-6


def plans(world, in_lane):
    """The commands that a plan has after few and many iterations."""
    robot = world["robot"]
    quantities = dict(x=robot.states, p=robot.parameters, x_ref=robot.states, u_ref=robot.inputs)
    given = {key: told(world, key, names) for key, names in quantities.items()}
    mpc = controller(world, in_lane)
    found = []
    for iterations in (1, 2, 4, 8):
        mpc.restart()
        mpc.solve(**given, iterations=iterations)
        found.append(mpc.u_plan.T)
    return by_name(robot.inputs, np.concatenate(found))


UNITS_OF_THEIR_OWN = "each in a unit of its own"
QUICK |= {("cart-pole", True, UNITS_OF_THEIR_OWN), ("bicycle", False, UNITS_OF_THEIR_OWN)}
QUICK |= {("cart", True, "mirrored")}


def steps():
    """From afar rounding decides how the bicycle comes into its lane."""
    changes = UNITS_OF_THEIR_OWN, "mirrored", "cost times 1e-6"
    for row in itertools.product(ROBOTS, (True, False), changes):
        if row[:2] != ("bicycle", True):
            yield pytest.param(*row, marks=() if row in QUICK else pytest.mark.nightly)


@pytest.mark.parametrize("robot, in_lane, change", [*steps()])
def test_each_iteration_goes_as_far_whatever_the_units_and_sides_are(robot, in_lane, change):
    """From far away, where steps are shortened, so that what is missing between nodes counts."""
    robot, rng = ROBOTS[robot], np.random.default_rng(7)
    far = {name: x + 4 * rng.normal() for name, x in world_of(robot)["x"].items()}
    world = world_of(robot) | dict(x=far)
    change = RUNS["RHC"][1][change](robot)
    run = functools.partial(plans, in_lane=in_lane)
    assert largest_difference(run(world), run, world, change) < 1e-6
