"""The closed loop: one sample as a pure Function, a run as that Function scanned over time.

    noise_k ─► robot ─ z_k ─► estimator ─ ξ̂, p̂ ─► path ─ ξ_r, ω_r ─► controller ─ ω ─► robot …

Every tuning parameter is an argument of the Function, so that a change of a weight compiles
nothing. What changes the shape of the Function is in `_LoopStructure`.
"""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi import build, compiled, early, packing, scan
from rhec.core.controller import rhc
from rhec.core.model.limits import is_valid_measurement
from rhec.simulation import faults
from rhec.simulation.columns import COLUMNS, FLAGS, LOG, SENSORS
from rhec.simulation.metrics import metrics
from rhec.simulation.run import Run
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import plant_options as robot_options
from rhec.tracked_robot import rhc as paper_rhc
from rhec.tracked_robot import terrain
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.references import build_references
from rhec.tracked_robot.terrain import Terrain

_COMMANDS = ("lower", "upper", "caution", "r_speed", "speed_mps", "command_delay")


class _LoopStructure(NamedTuple):
    """What decides the shape of the loop's Function, and so what is compiled."""

    estimator: Choice
    prediction_horizon: int
    qp: str
    input_reference: str
    n_segments: int
    terrain_shape: tuple[int, int]
    faulty: bool  # whether sensors have faults: without, their code is left out
    cautious: bool
    controller: str
    observer: bool  # whether a disturbance observer runs
    soil_under: str
    traction_timing: str
    yaw_rate_interval: str
    options: tuple[str, ...]  # of the robot (`plant_options`)


class _Parts(NamedTuple):
    """The Functions that a sample calls, in this order."""

    soil: ca.Function
    measure: ca.Function
    sense: ca.Function | None  # gyro and heading; None without them
    deliver: ca.Function | None  # None where sensors have no faults
    estimate: ca.Function
    disturb: ca.Function | None  # the yaw rate's disturbance; None where nothing estimates it
    references: ca.Function
    control: ca.Function
    drive: ca.Function
    slip: ca.Function | None  # side slip that lasts; None without it
    pair: ca.Function | None  # None where ω belongs to the interval that ends at its sample


def _build_parts(structure):
    choice = structure.estimator
    # Loops share what does not depend on the estimator; it takes a third of a second to build.
    share = partial(_shared, compiled.loop_symbols())
    control = share(
        _build_control,
        structure.controller,
        structure.prediction_horizon,
        structure.qp,
        structure.n_segments,
        structure.traction_timing,
    )
    disturb = _build_disturb(structure)
    if disturb:
        control = _yaw_disturbance().compensated(control)
    if structure.cautious:
        # Imported here, like all that is not in the paper: a run imports only what it uses.
        from rhec.tracked_robot import cautious

        states = estimator_of(choice.estimator, choice.robust).states(choice)
        control = cautious.build_step(control, states, structure.n_segments, paper.DT_S)
    references = share(
        build_references,
        paper.DT_S,
        structure.prediction_horizon,
        structure.n_segments,
        structure.input_reference,
    )
    return _Parts(
        soil=share(robot.soil, structure.terrain_shape, structure.soil_under),
        measure=share(robot.measure, paper.DT_S),
        sense=robot_options.sense(structure.options, paper.DT_S),
        deliver=_build_deliver(choice.sensors) if structure.faulty else None,
        estimate=build_step(choice),
        disturb=disturb,
        references=references["references"],
        control=control,
        drive=share(robot.drive, paper.DT_S),
        slip=_build_slip(structure),
        pair=_build_pair(structure),
    )


@lru_cache(maxsize=16)
def _shared(kind, build, *arguments):
    """Return build(*arguments), made once; `kind` is that of the symbols that it may use."""
    return build(*arguments)


def _build_slip(structure):
    is_slipping = "side_slip" in structure.options
    return robot_options.slip_sideways(paper.DT_S) if is_slipping else None


def _build_pair(structure):
    if structure.yaw_rate_interval != "after":
        return None
    return robot.pair_with_next_interval(4 + len(structure.estimator.sensors))


def _build_control(controller, prediction_horizon, qp, n_segments, traction_timing):
    """The step of the controller, with the interface of the RHC's."""
    if controller == "speed_rhc":
        speed_rhc = _speed_rhc()
        return speed_rhc.build_step(speed_rhc.horizon_of(prediction_horizon), n_segments)
    horizon = paper_rhc.horizon_of(prediction_horizon, qp)
    if controller == "rhc":
        step = rhc.build_phases(horizon)["step"]
        if traction_timing == "feedback":
            return step
        return paper_rhc.with_online_traction(step, horizon, traction_timing)
    from rhec.tracked_robot import rival_controllers

    return rival_controllers.CONTROLLERS[controller](horizon)


def _speed_rhc():
    from rhec.tracked_robot import speed_rhc

    return speed_rhc


def _yaw_disturbance():
    from rhec.tracked_robot import yaw_disturbance

    return yaw_disturbance


def _build_disturb(structure):
    """The disturbance of the yaw rate by an observer, by the estimated yaw drift, or None."""
    if structure.observer:
        return _yaw_disturbance().build_observer(paper.DT_S)
    choice = structure.estimator
    if estimator_of(choice.estimator, choice.robust).has_yaw_drift:
        return _yaw_disturbance().build_from_drift()
    return None


def _build_deliver(sensors):
    from rhec.simulation import fault_signals

    return fault_signals.deliver(len(sensors))


def _memory_shapes(parts, structure):
    """Shapes of what one sample hands to the next."""
    return (
        robot.MEMORY
        | dict(
            estimator=(parts.estimate.numel_in(0), 1),
            s=(1, 1),
            command=(1, 1),
            controller=(parts.control.numel_in(0), 1),
        )
        | (_faulty_memory(structure) if parts.deliver else {})
        | robot_options.memory_of(structure.options)
        | (robot.PAIRED if parts.pair else {})
        | _observer_shapes(parts.disturb)
    )


def _faulty_memory(structure):
    return faults.memory_shapes(len(structure.estimator.sensors))


def _observer_shapes(disturb):
    """Shape of the observer's memory, where there is an observer."""
    has_memory = disturb and "memory" in disturb.name_in()
    return dict(observer=(disturb.numel_in("memory"), 1)) if has_memory else {}


def _settings_shapes(parts, structure):
    """Shapes of the arguments that stay the same over a run."""
    one = (1, 1)
    path = dict(segments=(5, structure.n_segments), period_m=one, look_ahead_m=one, backwards=one)
    weights = dict(Q=(3, 1), QN=(3, 1), R=one)
    commands = dict.fromkeys(_COMMANDS, one)
    if "observer_time_s" in (parts.disturb.name_in() if parts.disturb else ()):
        commands["observer_time_s"] = one
    slip = (parts.soil.numel_in("slip"), 1)
    soil = dict(origin_m=(2, 1), cell_m=one, slip=slip, mean_traction=(2, 1))
    # The rest are the estimator's, by the names it gives them. Truth and traction are no settings.
    tuning = {
        name: parts.estimate.size_in(name)
        for name in parts.estimate.name_in()[2:]
        if name not in ("truth", "traction")
    }
    world = robot.SENSORS | robot.BODY | robot_options.settings_of(structure.options)
    return world | path | weights | commands | soil | tuning


def build_sample(*structure):
    """The closed loop of a _LoopStructure as a scan: {name: Function} of `scan.build_scan`.

    One sample is (memory, noise, settings …) -> (memory, row, …).
    """
    structure = _LoopStructure(*structure)
    traction_input = estimator_of(structure.estimator.estimator).traction_input
    parts = _build_parts(structure)
    memory = _memory_shapes(parts, structure)
    settings = _settings_shapes(parts, structure)
    stream = _stream_shapes(structure)
    shapes = dict(noise=(build.packed_size(stream), 1)) | settings

    @build.with_packed_memory("sample", memory, ca.MX, **shapes)
    def sample(noise, **signals):
        # Memory, noise and settings by name; each part picks its inputs from them.
        signals = signals | build.unpack(noise, stream)
        traction, yaw_drift = parts.soil.call([signals[name] for name in parts.soil.name_in()])
        truth, omega = _truth(signals, traction)
        measured = _measured(parts, signals, structure.options)
        passed = traction_input.select_traction(
            signals["mean_traction"], truth[4:], ca.vertcat(truth[4:], yaw_drift)
        )
        seen = measured["z"]
        if "observer" in memory:
            seen = _yaw_disturbance().corrected(seen, signals["observer"])
        estimated = _estimated(parts, signals | dict(traction=passed), seen, truth)
        omega_measured = _omega_measured(parts, signals, measured, estimated)
        disturbed = _disturbed(parts, signals, omega_measured, estimated)
        estimated |= disturbed
        target = _target(parts, signals, omega_measured, estimated)
        planned = _planned(parts, signals, estimated, target)
        driven = _driven(parts, signals, planned, traction, yaw_drift)
        of_sensors = measured["z"][4:]
        row = dict(truth=truth, omega=omega, yaw_drift=yaw_drift, z=measured["z"][:4])
        row |= _row(estimated, target, planned)
        following = dict(
            drift=measured["drift"],
            s=target["s"],
            covariance=estimated["covariance"],
            estimator=estimated["memory"],
            command=planned["command"],
            controller=planned["memory"],
        )
        # Sensors with faults remember earlier measurements.
        remembered = faults.MEMORY | robot.PAIRED | dict.fromkeys(["last_yaw"])
        stored = {name: measured[name] for name in memory if name in remembered}
        if "observer" in memory:
            stored["observer"] = disturbed["observer"]
        row = ca.vertcat(*(row[name] for name in LOG), of_sensors)
        return dict(row=row) | following | driven | stored

    return scan.build_scan(sample)


def _stream_shapes(structure):
    """Shapes of what a sample takes from the stream: noise, and faults where there are any."""
    stream = robot.noise_shapes(structure.options)
    if structure.faulty:
        stream |= faults.stream_shapes(len(structure.estimator.sensors))
    return stream


def _call(function, signals, **others):
    """Results by name of a Function that finds its inputs among these, `others` first."""
    return function(**build.select_inputs(function, signals | others))


def _truth(signals, traction):
    """The state (x, y, θ, ν, μ, κ) of the robot, and its tracks' yaw rate ω."""
    nu, omega = robot.body_speeds(signals["tracks"], signals["track_width_m"])
    return ca.vertcat(signals["pose"], nu, traction), omega


def _measured(parts, signals, options):
    """The measurement z that arrives, and what the sensors hand to the next sample."""
    measured = _call(parts.measure, signals)
    if parts.sense:
        measured |= _call(parts.sense, signals | measured)
    if parts.deliver:
        measured |= _call(parts.deliver, signals | measured)
    measured["z"] = robot_options.wrapped(measured["z"], options)
    if parts.pair:
        measured |= _call(parts.pair, signals | measured)
    return measured


def _estimated(parts, signals, z, truth):
    """The estimator's results, with NaN or a default for those that it does not have."""
    limits = SPEED_MODELS["parameter"].model.limits
    is_valid = [is_valid_measurement(z[row], limit) for row, limit in enumerate(limits)]
    signals = signals | dict(truth=truth)
    # A user's own estimator has none of these; every log has the same columns.
    nan = ca.DM.nan(1)
    defaults = dict(
        covariance=nan,
        kkt=nan,
        deviance=nan,
        ok=1,
        accepted=ca.vertcat(*is_valid),
        restart=ca.DM(0),
    )
    return defaults | _call_estimator(parts.estimate, signals["estimator"], z, signals)


def _call_estimator(step, memory, z, signals):
    """Results by name of a step (memory, z, settings …) -> (memory, estimate, …).

    A user's own step may call its memory, measurement and estimate as it likes, so these go by
    their places; everything else goes by name.
    """
    settings = [signals[name] for name in step.name_in()[2:]]
    names = ["memory", "estimate", *step.name_out()[2:]]
    return dict(zip(names, step.call([memory, z, *settings])))


def _omega_measured(parts, signals, measured, estimated):
    """The newest measured yaw rate; where it is rejected, the last command stands in for it."""
    accepted = estimated["accepted"][3]
    omega = measured["z"][3]
    if parts.pair:
        # The controller's reference is the newest yaw rate, which the estimator gets a sample on.
        omega = measured["newest_omega"]
        accepted = is_valid_measurement(omega, SPEED_MODELS["parameter"].model.limits[3])
    return ca.if_else(accepted, omega, signals["command"])


def _disturbed(parts, signals, omega_measured, estimated):
    """The disturbance of the yaw rate, and the observer's memory; nothing where none is estimated.

    An estimator's own results keep their names, so that the observer's memory has another one.
    """
    if not parts.disturb:
        return {}
    inputs = dict(memory=signals.get("observer"), omega_measured=omega_measured)
    result = _call(parts.disturb, signals | estimated, **inputs)
    renamed = dict(observer=result.pop("memory")) if "memory" in result else {}
    return dict(disturbance=result["disturbance"]) | renamed


def _target(parts, signals, omega_measured, estimated):
    """The references ξ_r, ω_r on the path, eq. (17)-(18)."""
    if "disturbance" in estimated:
        # The controller plans ω + d, so that the measured part of it has d, too.
        omega_measured += estimated["disturbance"]
    estimate = estimated["estimate"]
    return _call(parts.references, signals, estimate=estimate, omega_measured=omega_measured)


def _planned(parts, signals, estimated, target):
    """The controller's results: the newest command, its memory, and how well it solved its QP."""
    return _call(
        parts.control,
        signals | estimated | target,
        memory=signals["controller"],
        s_0=estimated["estimate"],
        x_ref=target["xi_ref"],
        u_ref=target["omega_ref"],
    )


def _driven(parts, signals, planned, traction, yaw_drift):
    """The robot's memory after one sample with the command."""
    # Eq. (13): the first input is applied at once, or one sample later (interpretation R10).
    applied = ca.if_else(signals["command_delay"], signals["command"], planned["command"])
    soil = dict(traction=traction, yaw_drift_radpm=yaw_drift)
    driven = _call(parts.drive, signals | planned, omega_radps=applied, **soil)
    if parts.slip:
        driven |= _call(parts.slip, signals, driven=driven["pose"])
    return driven


def _row(estimated, target, planned):
    """The parts of a row of the log that estimator, path and controller yield."""
    accepted = estimated["accepted"]
    return dict(
        estimate=estimated["estimate"],
        command=planned["command"],
        s=target["s"],
        curvature=target["curvature"],
        kkt_rhe=estimated["kkt"],
        kkt_rhc=planned["kkt"],
        deviance=estimated["deviance"],
        ok=ca.fmin(estimated["ok"], planned["ok"]),
        accepted=ca.vertcat(accepted[0] * accepted[1], accepted[2] * accepted[3]),
        restart=estimated["restart"],
    )


@dataclass(frozen=True)
class Setup:
    """A scenario turned into arrays.

    Attributes:
        structure: What decides the shape of the loop's Function.
        memory: The first memory, packed.
        layout: Shapes of the memory's pieces by name; of estimator and controller, of theirs.
        settings: The arguments that stay the same over the run, by name.
        path: The path to follow.
        terrain: The traction of the soil.
        guess: (x, y, θ, ν, μ, κ), the estimator's first.
    """

    structure: _LoopStructure
    memory: np.ndarray
    layout: dict
    settings: dict
    path: Path
    terrain: Terrain
    guess: np.ndarray

    def unpack(self, memory):
        """A memory's arrays by name; those of estimator and controller in dicts of their own."""
        nested = {name: shape for name, shape in self.layout.items() if isinstance(shape, dict)}
        sizes = {name: (build.packed_size(shapes), 1) for name, shapes in nested.items()}
        pieces = packing.unpack_array(memory, self.layout | sizes)
        inner = {name: packing.unpack_array(pieces[name], nested[name]) for name in nested}
        return pieces | inner


def set_up(scenario):
    """The Setup of a scenario: path, soil, starting point and settings."""
    path = scenario.path or Path.racetrack(scenario.row_length_m, scenario.headland_radius_m)
    soil = scenario.terrain or terrain.random_for(scenario, path)
    shape = terrain.common_shape(soil)
    choice = Choice.of(scenario)
    structure = _LoopStructure(
        choice,
        scenario.prediction_horizon,
        scenario.qp,
        scenario.input_reference,
        len(path.segments),
        shape,
        bool(scenario.faults),
        scenario.cautious,
        scenario.controller,
        scenario.disturbance_observer,
        scenario.soil_under,
        scenario.traction_timing,
        scenario.yaw_rate_interval,
        options_of(scenario),
    )
    estimator = estimator_of(choice.estimator, choice.robust)
    pose = _start_pose(scenario, path)
    speed_mps = _signed_speed(scenario)
    guess = np.array([*pose + (0, 0, scenario.guess_yaw_rad), speed_mps, 1.0, 1.0])
    memory, layout = _pack(_first_memory(scenario, path, estimator, choice, pose, guess))
    settings = (
        _settings(scenario, path) | terrain.settings(soil, shape) | estimator.settings(scenario)
    )
    return Setup(structure, memory, layout, settings, path, soil, guess)


def options_of(scenario):
    """The options of a scenario's robot (`plant_options`)."""
    return robot_options.options_of(scenario.sensors, scenario.side_slip_rad)


def columns_of(scenario):
    """The columns that a run's loop yields, in order."""
    return [*COLUMNS, *(SENSORS[name] for name in SENSORS if name in scenario.sensors)]


def _signed_speed(scenario):
    return (-1.0 if scenario.backwards else 1.0) * scenario.speed_mps


def _start_pose(scenario, path):
    """Where the robot starts: beside the path's beginning, turned from it; backwards by π, too."""
    ((x, y, theta),), _ = path.poses([0.0])
    # (-sin θ, cos θ) points to the left.
    x -= scenario.start_offset_m * np.sin(theta)
    y += scenario.start_offset_m * np.cos(theta)
    theta += scenario.start_yaw_rad + np.pi * scenario.backwards
    return np.array([x, y, theta])


def _first_memory(scenario, path, estimator, choice, pose, guess):
    """The memory before the first sample, by name; estimator and controller have dicts."""
    others = faults.init(len(scenario.sensors)) if scenario.faults else {}
    others |= robot_options.init(options_of(scenario), pose)
    others |= dict(newest_omega=0.0) if scenario.yaw_rate_interval == "after" else {}
    if scenario.disturbance_observer:
        others |= dict(observer=_yaw_disturbance().init_observer())
    loop = dict(
        estimator=estimator.init(choice, dict(zip(QUANTITIES, guess))),
        s=path.project(pose[None, :2])[1],
        command=0.0,
        controller=_first_plan(scenario, guess),
    )
    return robot.init(pose, _signed_speed(scenario)) | loop | others


def _first_plan(scenario, guess):
    """The memory of the controller before the first sample, by name."""
    if scenario.controller == "speed_rhc":
        speed_rhc = _speed_rhc()
        horizon = speed_rhc.horizon_of(scenario.prediction_horizon)
        return speed_rhc.init(horizon, scenario.speed_mps)
    horizon = paper_rhc.horizon_of(scenario.prediction_horizon, scenario.qp)
    speed = dict(speed=np.array([scenario.speed_mps])) if scenario.cautious else {}
    return rhc.init(horizon, guess[:3], guess[3:]) | speed


def _pack(memory):
    """A memory by name in one vector, and its layout."""
    nested = {name: piece for name, piece in memory.items() if isinstance(piece, dict)}
    flat = memory | {name: packing.pack_array(piece) for name, piece in nested.items()}
    inner = {name: packing.shapes_of(piece) for name, piece in nested.items()}
    return packing.pack_array(flat), packing.shapes_of(flat) | inner


def _settings(scenario, path):
    """The settings of robot, path and controller."""
    q = np.array(scenario.q)
    of_options = robot_options.settings_of(options_of(scenario))
    world = {name: getattr(scenario, name) for name in robot.SENSORS | robot.BODY | of_options}
    return world | dict(
        look_ahead_m=scenario.look_ahead_m,
        caution=scenario.caution,
        segments=path.segments.T,
        period_m=path.period_m,
        backwards=float(scenario.backwards),
        Q=q,
        QN=scenario.qn_factor * q,
        R=scenario.r,
        r_speed=scenario.r_speed,
        lower=-scenario.omega_max_radps,
        upper=scenario.omega_max_radps,
        speed_mps=_signed_speed(scenario),
        command_delay=float(scenario.command_delay),
        observer_time_s=scenario.observer_time_s,
    )


def noise_and_faults(seed, scheduled, samples, options=()):
    """The stream that a run is scanned over: noise and the scheduled Faults, one row a sample.

    `options` are those of the robot.
    """
    noise = robot.draw_noise(seed, samples, options)
    if not scheduled:
        return noise
    from rhec.simulation import fault_signals

    sensors = tuple(name for name in options if name in SENSORS)
    stream = fault_signals.stream(scheduled, samples, paper.DT_S, seed, sensors)
    return np.hstack([noise, stream])


def simulate_setup(scenario, setup):
    """The Run of a scenario that is set up."""
    functions = early.load(build_sample, *setup.structure)
    samples = round(scenario.duration_s / paper.DT_S)
    stream = noise_and_faults(scenario.seed, scenario.faults, samples, options_of(scenario))
    _, rows = scan.scan(functions, setup.memory, stream, setup.settings)
    return finish(scenario, setup, rows)


def finish(scenario, setup, rows):
    """The Run whose loop yielded these rows (n, LOG): its columns and metrics."""
    (run,) = finish_all([scenario], [setup], [rows])
    return run


def finish_all(scenarios, setups, logs):
    """The Runs whose loops yielded these logs: each has the bits that it has alone.

    Runs on one path are projected on it at once: NumPy spends most of a short array's time in
    calls.

    Args:
        scenarios: Of the runs.
        setups: Their Setups.
        logs: Their rows (n, LOG), of any lengths.

    Returns:
        A list of Runs, in their order.
    """
    columns = [_columns_of(scenario, rows) for scenario, rows in zip(scenarios, logs)]
    on_path = {}
    for place, setup in enumerate(setups):
        on_path.setdefault(id(setup.path), []).append(place)
    poses = {}
    for places in on_path.values():
        poses |= zip(places, _add_errors(setups[places[0]].path, [columns[k] for k in places]))
    return [
        Run(scenario, metrics(columns[k], poses[k]), setup.path, setup.terrain, columns[k])
        for k, (scenario, setup) in enumerate(zip(scenarios, setups))
    ]


def _columns_of(scenario, rows):
    """The columns by name of a log's rows (n, columns), without those that need the path."""
    columns = {"t_s": np.arange(len(rows)) * paper.DT_S}
    columns |= dict(zip(columns_of(scenario), np.ascontiguousarray(rows.T)))
    return columns | {name: columns[name] == 1 for name in FLAGS}


def _add_errors(path, runs):
    """Add the distances to the path to the columns of runs.

    Returns:
        The poses of the path (n, 3) at the points closest to each robot.
    """
    lengths = [len(columns["t_s"]) for columns in runs]
    measured, true = (
        np.column_stack([np.concatenate([columns[name] for columns in runs]) for name in names])
        for names in (("x_meas_m", "y_meas_m"), ("x_m", "y_m"))
    )
    # A position of which one coordinate is missing or infinite is none.
    measured[~np.isfinite(measured).all(axis=1)] = np.nan
    distance, s = path.project(np.concatenate([measured, true]))
    poses, curvatures = path.poses(s[len(true) :])
    errors, true_errors = np.split(distance, 2)
    ends = np.cumsum(lengths)[:-1]
    parts = (np.split(values, ends) for values in (errors, true_errors, curvatures == 0, poses))
    found = []
    for columns, error, true_error, on_straight, pose in zip(runs, *parts):
        columns |= dict(error_m=error, error_true_m=true_error, on_straight=on_straight)
        found.append(pose)
    return found
