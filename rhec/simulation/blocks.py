"""The closed loop of a Scenario as a list of blocks.

    soil ─► sensors ─► (faults) ─► estimator ─► references ─► controller ─► robot

What a Scenario leaves out, such as faults or a gyro, is not in the list, and costs nothing.
"""

import functools

import casadi as ca

from rhec import paper
from rhec.core._casadi.build import casadi_function
from rhec.core.blocks import Block, split
from rhec.core.model.limits import is_valid_measurement
from rhec.simulation import faults
from rhec.simulation.columns import LOG
from rhec.simulation.controller import own_controller
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import plant_options as robot_options
from rhec.tracked_robot import rhc as paper_rhc
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import SPEED_MODELS
from rhec.tracked_robot.references import build_references

_ONE = (1, 1)
_NONE = ca.MX(0, 1)
_N_Z = 4  # entries of a measurement (x, y, ν, ω); those of other sensors follow
# What a controller reads and what it writes under names of its own: {its name: the signal}.
_OF_CONTROLLER = (
    dict(memory="controller", s_0="estimate", x_ref="xi_ref", u_ref="omega_ref"),
    dict(memory="controller", kkt="kkt_rhc", ok="ok_rhc"),
)
_LIMITS = SPEED_MODELS["parameter"].model.limits


def blocks_of(scenario, n_segments=None, terrain_shape=None):
    """The blocks of a scenario's loop.

    Args:
        scenario: The Scenario.
        n_segments: Number of the path's segments.
        terrain_shape: Shape of the grid of the soil's slip fields. Without these two, the blocks
            can be compared with those of other loops, but not be built.

    Returns:
        A tuple of Blocks, in the order in which a sample runs them.
    """
    sensors = scenario.sensors
    interval = scenario.yaw_rate_interval
    choice = Choice.of(scenario)
    has_yaw_drift = estimator_of(choice.estimator).has_yaw_drift(choice)
    horizon = scenario.prediction_horizon
    own = own_controller(scenario)
    return (
        *_ground(terrain_shape, scenario.soil_under),
        *_sensors(sensors, bool(scenario.faults), interval),
        *_estimator(choice),
        *_yaw_rate(len(sensors), interval, has_yaw_drift),
        *_references(horizon, n_segments, scenario.input_reference),
        *_controller(own, horizon, scenario.traction_timing, has_yaw_drift),
        *_motion(bool(scenario.side_slip_rad)),
        *_log(len(sensors), has_yaw_drift),
    )


def _blocks(parts):
    """Decorator: the blocks that a generator yields as a tuple, made once for its arguments.

    Equal loops of a campaign then consist of the same blocks, which are quickly compared.
    """

    @functools.lru_cache(maxsize=256)
    @functools.wraps(parts)
    def made(*arguments):
        return tuple(parts(*arguments))

    return made


@_blocks
def _ground(terrain_shape, soil_under):
    """The soil below the robot, and where the robot is."""
    yield Block(split, ("noise", tuple(robot.NOISE.items())), draws=("noise",))
    yield Block(robot.soil, (terrain_shape, soil_under), writes=dict(yaw_drift_radpm="yaw_drift"))
    yield Block(robot.truth)


@_blocks
def _sensors(sensors, is_faulty, yaw_rate_interval):
    """The measurement z, as it arrives."""
    n_sensors = len(sensors)
    n_z = _N_Z + n_sensors
    yield Block(robot.measure, (paper.DT_S,), remembers=("drift",))
    if "gyro" in sensors:
        yield Block(
            robot_options.gyro, (paper.DT_S,), remembers=("last_yaw",), draws=("gyro_noise",)
        )
    if "heading" in sensors:
        yield Block(robot_options.heading, (n_z - 1,), draws=("heading_noise",))
    if is_faulty:
        # Imported here, like all that is not in the paper: a run imports only what it uses.
        from rhec.simulation import fault_signals

        effects = "faults", tuple(faults.stream_shapes(n_sensors).items())
        yield Block(split, effects, draws=("faults",))
        yield Block(fault_signals.deliver, (n_sensors,), remembers=("past", "held"))
    if "heading" in sensors:
        yield Block(robot_options.within_a_turn, (n_z,))
    if yaw_rate_interval == "after":
        yield Block(robot.pair_with_next_interval, (n_z,), remembers=("newest_omega",))


@_blocks
def _estimator(choice):
    """The estimate, and how it came about."""
    traction_input = estimator_of(choice.estimator).traction_input
    yield Block(known_traction, (traction_input,))
    yield Block(default_results, (_N_Z + len(choice.sensors),))
    reads = dict(memory="estimator", z_N="z", traction="known_traction")
    writes = dict(memory="estimator", kkt="kkt_rhe", ok="ok_rhe", yaw_drift="yaw_drift_hat")
    yield Block(build_step, (choice,), reads, writes, remembers=("estimator",))


@_blocks
def _yaw_rate(n_sensors, yaw_rate_interval, has_yaw_drift):
    """The newest yaw rate; where the yaw drift is estimated, the disturbance that it makes, too."""
    if yaw_rate_interval == "after":
        # The estimator gets the newest yaw rate one sample later.
        yield Block(waiting_yaw_rate)
    else:
        yield Block(newest_yaw_rate, (_N_Z + n_sensors,))
    if has_yaw_drift:
        from rhec.tracked_robot import yaw_disturbance

        yield Block(yaw_disturbance.counted_in, reads=dict(yaw_drift="yaw_drift_hat"))


@_blocks
def _references(horizon, n_segments, input_reference):
    """The references ξ_r, ω_r on the path."""
    arguments = paper.DT_S, horizon, n_segments, input_reference
    yield Block(build_references, arguments, remembers=("s",))


@_blocks
def _controller(own, horizon, traction_timing, has_yaw_drift):
    """The command, of a user's `own` Controller or of the paper's RHC."""
    takes = own.step.name_in() if own else ("memory",)
    remembers = ("command", "controller") if "memory" in takes else ("command",)
    if own:
        control = Block(own_step, (own,), *_OF_CONTROLLER, remembers)
    else:
        control = Block(
            paper_rhc.build_step, (horizon, traction_timing), *_OF_CONTROLLER, remembers
        )
    is_compensated = has_yaw_drift and "disturbance" not in takes
    yield from _compensated(control) if is_compensated else (control,)


def _compensated(control):
    """The block of a controller that knows no disturbance, between two that compensate it."""
    from rhec.tracked_robot import yaw_disturbance

    return Block(yaw_disturbance.moved_bounds), control, Block(yaw_disturbance.taken_off)


@_blocks
def _motion(slips_sideways):
    """The robot's motion until the next sample."""
    yield Block(applied_command, reads=dict(last="command@last"))
    yield Block(
        robot.drive,
        (paper.DT_S,),
        reads=dict(omega_radps="applied", yaw_drift_radpm="yaw_drift"),
        remembers=("pose", "tracks", "integral", "encoders", "rut", "running"),
    )
    if slips_sideways:
        yield Block(
            robot_options.slip_sideways,
            (paper.DT_S,),
            reads=dict(pose="pose@last", driven="pose", running="running@last"),
            remembers=("slip_angle",),
            draws=("side_slip_noise",),
        )


@_blocks
def _log(n_sensors, has_yaw_drift):
    """The row of the log."""
    yield Block(row_of_log, (_N_Z + n_sensors, has_yaw_drift))


def known_traction(traction_input):
    """The Function that selects what an estimator is told of the soil: of most, nothing."""

    @casadi_function("known_traction", ca.MX, mean_traction=(2, 1), traction=(2, 1), yaw_drift=_ONE)
    def known(mean_traction, traction, yaw_drift):
        with_drift = ca.vertcat(traction, yaw_drift)
        passed = traction_input.select_traction(mean_traction, traction, with_drift)
        return dict(known_traction=passed)

    return known


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


def waiting_yaw_rate():
    """`newest_yaw_rate`, of a yaw rate that the estimator gets only with the next sample."""

    @casadi_function("waiting_yaw_rate", newest_omega=_ONE, command=_ONE)
    def newest(newest_omega, command):
        is_valid = is_valid_measurement(newest_omega, _LIMITS[3])
        return dict(omega_measured=ca.if_else(is_valid, newest_omega, command))

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
