"""The closed loop of a Scenario as a list of parts, each with its first values and settings.

    soil ─► sensors ─► (faults) ─► estimator ─► references ─► controller ─► robot

What a Scenario leaves out, such as faults or a gyro, is not in the list, and costs nothing.
"""

import functools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function
from rhec.core.blocks import Part, block_of, split
from rhec.core.model.limits import is_valid_measurement
from rhec.simulation import faults
from rhec.simulation.columns import LOG
from rhec.simulation.controller import Controller
from rhec.tracked_robot import paper_rhc, terrain
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot.estimators import Choice, build_step, estimator_of
from rhec.tracked_robot.kinematics import OUTPUTS, QUANTITIES, SPEED_MODELS
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.references import build_references, padded_segments
from rhec.tracked_robot.sensors import records, rows_of_yaws, within_a_turn
from rhec.tracked_robot.terrain import Terrain

_ONE = (1, 1)
_NONE = ca.MX(0, 1)
_N_Z = len(OUTPUTS)  # entries of a measurement (x, y, ν, ω); those of other sensors follow
# What a controller reads and what it writes under names of its own: {its name: the signal}.
_OF_CONTROLLER = dict(
    reads=dict(memory="controller", s_0="estimate", x_ref="xi_ref", u_ref="omega_ref"),
    writes=dict(memory="controller", kkt="kkt_rhc", ok="ok_rhc"),
)
_LIMITS = SPEED_MODELS["parameter"].model.limits


class World(NamedTuple):
    """Where a run takes place and begins."""

    path: Path
    soil: Terrain
    pose: Any  # (3,) at the start
    speed_mps: float  # the set one, negative backwards
    guess: Any  # (x, y, θ, ν, μ, κ), the estimator's first
    soil_shape: tuple | None = None  # of the soil's grid in the loop; None: the next usual one


def parts_of(scenario, world=None):
    """The Parts of a scenario's loop, in the order in which a sample runs them.

    Args:
        scenario: The Scenario.
        world: Its World. Without one, the parts are blocks alone, which can be compared with those
            of other loops, but not be built.
    """
    yield from measuring(scenario, world)
    yield from _estimator(scenario, world)
    yield from _yaw_rate(scenario)
    yield from _references(scenario, world)
    yield from _controller(scenario, world)
    yield from moving(scenario, world)
    yield Part(block_of(row_of_log, _n_z(scenario), has_yaw_drift(scenario)))


def blocks_of(scenario):
    """The blocks of a scenario's loop, but for the sizes of path and soil: to compare loops."""
    return tuple(part.block for part in parts_of(scenario))


def measuring(scenario, world):
    """The Parts of a scenario's robot that act before the estimator: from the soil to z."""
    yield from _ground(scenario, world)
    yield from _sensors(scenario, world)


def _n_z(scenario):
    """Length of a measurement."""
    return _N_Z + len(scenario.sensors)


def has_yaw_drift(scenario):
    """Whether the yaw drift is estimated."""
    choice = Choice.of(scenario)
    return estimator_of(choice.estimator).has_yaw_drift(choice)


def _fields(scenario, names):
    """{name: value} of a scenario's parameters."""
    return {name: getattr(scenario, name) for name in names}


def _ground(scenario, world):
    """The soil below the robot, and where the robot is."""
    noise = block_of(split, "noise", tuple(robot.NOISE.items()), draws=("noise",))
    yield Part(noise, streams=dict(noise=robot.draw_noise))
    shape = world and (world.soil_shape or terrain.common_shape(world.soil))
    soil = block_of(
        robot.soil, shape, scenario.soil_under, writes=dict(yaw_drift_radpm="yaw_drift")
    )
    yield Part(soil, settings=terrain.settings(world.soil, shape) if world else {})
    yield Part(block_of(robot.truth))


def _sensors(scenario, world):
    """The measurement z, as it arrives."""
    sensors = scenario.sensors
    measure = block_of(robot.measure, paper.DT_S, remembers=("drift",))
    yield Part(measure, dict(drift=np.zeros(2)), _fields(scenario, robot.SENSORS))
    for n_z, sensor in enumerate(records(sensors), _N_Z):
        yield _sensor(sensor, n_z, scenario, world)
    if scenario.faults:
        yield from _faults(sensors)
    yaws = rows_of_yaws(sensors)
    if yaws:
        yield Part(block_of(within_a_turn, _n_z(scenario), yaws))


def _sensor(sensor, n_z, scenario, world):
    """A Sensor, which appends its measurement to the n_z entries of z."""
    noise = f"{sensor.name}_noise"
    remembered = {signal: f"{sensor.name}_{signal}" for signal in sensor.remembers}
    settings = {name: of.parameter for name, of in sensor.settings.items()}
    block = block_of(
        sensor.measure,
        paper.DT_S,
        n_z,
        reads=settings | remembered | dict(noise=noise),
        writes=remembered,
        remembers=tuple(remembered.values()),
        draws=(noise,),
    )
    first = {remembered[signal]: of(world.pose) for signal, of in sensor.remembers.items() if world}
    return Part(
        block, first, _fields(scenario, settings.values()), {noise: robot.Normal(sensor.stream)}
    )


def _faults(sensors):
    """What faults do to the measurement."""
    # Imported here, like all that is not in the paper: a run imports only what it uses.
    from rhec.simulation import fault_signals

    n = len(sensors)
    effects = block_of(split, "faults", tuple(faults.stream_shapes(n).items()), draws=("faults",))
    yield Part(effects, streams=dict(faults=fault_signals.FaultStream(sensors, paper.DT_S)))
    deliver = block_of(fault_signals.deliver, n, remembers=("past", "held"))
    yield Part(deliver, faults.init(n))


def _estimator(scenario, world):
    """The estimate, and how it came about."""
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator)
    yield Part(block_of(default_results, _n_z(scenario)))
    step = block_of(
        build_step,
        choice,
        reads=dict(memory="estimator", z_N="z"),
        writes=dict(memory="estimator", kkt="kkt_rhe", ok="ok_rhe", yaw_drift="yaw_drift_hat"),
        remembers=("estimator",),
    )
    if not world:
        yield Part(step)
        return
    first = dict(estimator=_first_memory(choice, tuple(world.guess)))
    yield Part(step, first, estimator.settings(scenario))


@functools.lru_cache  # the runs of a campaign share it
def _first_memory(choice, guess):
    return estimator_of(choice.estimator).init(choice, dict(zip(QUANTITIES, guess)))


def _yaw_rate(scenario):
    """The newest yaw rate; where the yaw drift is estimated, the disturbance that it makes, too."""
    yield Part(block_of(newest_yaw_rate, _n_z(scenario)))
    if has_yaw_drift(scenario):
        from rhec.tracked_robot import yaw_disturbance

        counted_in = block_of(yaw_disturbance.counted_in, reads=dict(yaw_drift="yaw_drift_hat"))
        yield Part(counted_in)


def _references(scenario, world):
    """The references ξ_r, ω_r on the path."""
    segments = padded_segments(world.path) if world else ()
    arguments = paper.DT_S, scenario.prediction_horizon, len(segments), scenario.input_reference
    reads = dict(segments="padded_segments")
    references = block_of(build_references, *arguments, reads=reads, remembers=("s_m",))
    if not world:
        yield Part(references)
        return
    path = world.path
    settings = dict(
        padded_segments=segments.T,
        segments=path.segments.T,  # for a controller of one's own
        period_m=path.period_m,
        look_ahead_m=scenario.look_ahead_m,
        backwards=float(scenario.backwards),
    )
    yield Part(references, dict(s_m=path.project(world.pose[None, :2])[1]), settings)


def _controller(scenario, world):
    """The command, of a user's Controller or of the paper's RHC."""
    own = scenario.controller if isinstance(scenario.controller, Controller) else None
    stages, settings = paper_rhc.problem_of_scenario(scenario)
    takes = own.step.name_in() if own else ("memory",)
    remembers = ("command", "controller") if "memory" in takes else ("command",)
    if own:
        control = block_of(own_step, own, **_OF_CONTROLLER, remembers=remembers)
    else:
        control = block_of(
            paper_rhc.build_step,
            stages,
            scenario.traction_timing,
            **_OF_CONTROLLER,
            remembers=remembers,
        )
    part = Part(control)
    if world:
        plan = paper_rhc.first_plan(scenario, world.guess)
        first = dict(command=0.0, controller=np.array(own.memory) if own else plan)
        # No disturbance of the yaw rate, where none is estimated.
        part = Part(control, first, settings | dict(disturbance=0.0))
    is_compensated = has_yaw_drift(scenario) and "disturbance" not in takes
    yield from _compensated(part) if is_compensated else (part,)


def _compensated(part):
    """The part of a controller that knows no disturbance, between two that compensate it."""
    from rhec.tracked_robot import yaw_disturbance

    moved, taken_off = yaw_disturbance.moved_bounds, yaw_disturbance.taken_off
    return Part(block_of(moved)), part, Part(block_of(taken_off))


def moving(scenario, world):
    """The Parts of a scenario's robot that act after the controller: the motion that it commands.

    They read what `measuring` wrote, and the `command` of this sample and of the last.
    """
    applied = block_of(applied_command, reads=dict(last="command@last"))
    yield Part(applied, settings=dict(command_delay=float(scenario.command_delay)))
    drive = block_of(
        robot.drive,
        paper.DT_S,
        reads=dict(omega_radps="applied", yaw_drift_radpm="yaw_drift"),
        remembers=("pose", "tracks", "integral", "encoders", "rut", "running"),
    )
    if world:
        settings = _fields(scenario, robot.BODY) | dict(speed_mps=world.speed_mps)
        yield Part(drive, robot.init(world.pose, world.speed_mps), settings)
    else:
        yield Part(drive)


def default_results(n_z):
    """What is logged of an estimator or controller that does not return it itself.

    All logs thus have the same columns. Blocks that follow overwrite what they return.
    """
    nan = ca.DM.nan(1)

    @casadi_function("default_results", z=(n_z, 1))
    def default(z):
        accepted = [is_valid_measurement(z[row], limit) for row, limit in enumerate(_LIMITS)]
        of_estimator = dict(covariance=nan, deviance=nan, kkt_rhe=nan, ok_rhe=1, restart=0)
        return of_estimator | dict(accepted=ca.vertcat(*accepted), kkt_rhc=0, ok_rhc=1)

    return default


def newest_yaw_rate(n_z):
    """The newest measured yaw rate; where it is rejected, the last command stands in for it."""

    @casadi_function("newest_yaw_rate", z=(n_z, 1), accepted=(_N_Z, 1), command=_ONE)
    def newest(z, accepted, command):
        return dict(omega_measured=ca.if_else(accepted[3], z[3], command))

    return newest


def own_step(controller):
    """The Function of a user's Controller."""
    return controller.step


def applied_command():
    """Eq. (13): the first input is applied at once, or one sample later (interpretation G10)."""

    @casadi_function("applied_command", command=_ONE, last=_ONE, command_delay=_ONE)
    def applied(command, last, command_delay):
        return dict(applied=ca.if_else(command_delay, last, command))

    return applied


def row_of_log(n_z, has_yaw_drift):
    """The Function that puts a row of the log together, see `columns.of_run`.

    A measurement has n_z entries.
    """
    shapes = {name: (len(columns), 1) for name, columns in LOG.items() if name != "ok"}
    shapes |= dict(z=(n_z, 1), accepted=(_N_Z, 1), ok_rhe=_ONE, ok_rhc=_ONE)
    shapes |= dict(yaw_drift_hat=_ONE) if has_yaw_drift else {}

    @casadi_function("row_of_log", ca.MX, **shapes)
    def row(z, accepted, ok_rhe, ok_rhc, yaw_drift_hat=_NONE, **parts):
        of_log = parts | dict(
            z=z[:_N_Z],
            ok=ca.fmin(ok_rhe, ok_rhc),
            accepted=ca.vertcat(accepted[0] * accepted[1], accepted[2] * accepted[3]),
        )
        return dict(row=ca.vertcat(*(of_log[name] for name in LOG), z[_N_Z:], yaw_drift_hat))

    return row
