"""The Functions of an export, and the places of their arguments and results in the C memory.

They are the unchanged phases of estimator and controller (`solver.rti`) and three small Functions:
the initial memory from a guess, the closest point of the whole path, and the references. An
estimator with a single step, such as the EKF, is a feedback phase; its shift only copies memory.
"""

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, unpack
from rhec.core._casadi.packing import pack_array
from rhec.core.controller.rhc import FIRST_ITERATIONS
from rhec.core.controller.rhc import build_phases as build_controller
from rhec.core.controller.rhc import init as plan_init
from rhec.core.estimator.innovation_gate import patience
from rhec.core.estimator.rhe import Window
from rhec.core.estimator.rhe import build_phases as build_estimator
from rhec.core.estimator.rhe import init as window_init
from rhec.core.model.limits import is_valid_measurement
from rhec.core.solver.pivoting import MAX_SWEEPS
from rhec.core.solver.rti import IMPROVE
from rhec.core.wiring import in_two_memories, renamed, wired
from rhec.simulation import closed_loop
from rhec.tracked_robot import path, yaw_disturbance
from rhec.tracked_robot.estimators import Choice, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS
from rhec.tracked_robot.paper_rhc import problem_of_scenario
from rhec.tracked_robot.paper_rhe import init as window_init_by_name
from rhec.tracked_robot.references import build_references
from rhec.tracked_robot.sensors import records

# The entries of a measurement z of the paper's robot; those of other sensors follow.
MEASURED = "x", "y", "nu", "omega"

# Places in `struct rhec` that phases of different owners share, by the names of arguments and
# results. All other places belong to one owner: estimator, controller or path.
_SHARED = dict(
    z_N="z",
    accepted="estimator.accepted",
    covariance="estimator.covariance",
    estimate="estimate",
    command="omega",
    yaw_drift="estimator.yaw_drift",
    disturbance="path.disturbance",
    s_next_m="path.s_next_m",
    xi_ref="path.xi_ref",
    x_ref="path.xi_ref",
    omega_ref="path.omega_ref",
    u_ref="path.omega_ref",
)
_SHARED_BY_MODEL = dict(z_N="z", estimate="estimate", guess="guess")
_MOVED = dict(z_N="estimator.moved", estimate="estimate")  # before it is the measurement
# In the order of a sample; `improve` prepares a controller's first plan.
_PHASES = "start", "expand", "shift", "linearise", "feedback", "improve"


class _Start(NamedTuple):
    """The initial memory of an owner."""

    init: Callable  # function of an array (n,) that returns {name: array}
    name: str  # name of that array among the arguments
    n: int


class Recorded(NamedTuple):
    """The estimator that was judged on a log."""

    window: Window
    settings: dict  # {name: matrix}
    guess: dict  # {name: number} before the first sample, with place, yaw and speed 0
    sigma_guess: dict  # {name: standard deviation}
    inflation: float  # by which its standard deviations are multiplied
    headings: int  # first yaws that are tried
    move: ca.Function  # as of `recorded.build_move`


class Export(NamedTuple):
    """The content of the generated C."""

    phases: dict  # {name in C: Wired, at places in the C memory}
    memory: dict  # {place in struct rhec: number of doubles}
    settings: dict  # {name: matrix}
    guess: np.ndarray  # initial guess of the estimator; (x, y, θ, ν, μ, κ) for a scenario
    macros: dict  # {name in C: (value, comment)}
    # Of each entry of the estimate the place of its variance in the covariance, -1 without one.
    variances: tuple
    inflation: float = 1.0  # factor of the standard deviations

    @property
    def is_of_log(self) -> bool:
        """Whether it is the estimator of a log, whose first yaw is searched."""
        return "HEADINGS" in self.macros


def export(scenario, estimator_only):
    """Return the Export of a scenario's estimator and, as a rule, its controller and path."""
    setup = closed_loop.set_up(scenario)
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator)
    settings = setup.settings | dict(length_m=setup.path.length_m)
    del settings["disturbance"]  # here it is a result, of an estimator that has the yaw drift
    stages, of_controller = problem_of_scenario(scenario)
    n_segments = len(setup.path.segments)
    if estimator.build_phases:
        estimate = estimator.build_phases(choice)
    else:
        estimate = _split_step(estimator.build_step(choice))
    n = len(QUANTITIES)

    def first_estimate(estimate):
        memory = estimator.init(choice, dict(zip(QUANTITIES, estimate)))
        return memory if estimator.build_phases else dict(memory=pack_array(memory))

    start = _Start(first_estimate, "estimate", n)
    phases = _bind_all("estimator", start, estimate, settings, _SHARED)
    has_gate = "rejected" in estimate["shift"].name_in()
    most = patience(choice.estimation_horizon) if has_gate else 0
    macros = _macros_on_a_path(scenario, stages.dt_s, most)
    has_yaw_drift = "yaw_drift" in estimate["feedback"].name_out()
    if has_yaw_drift:
        macros["YAW_DRIFT"] = 1, "the estimator has the yaw drift, which the controller cancels"
    covered = estimator.states(choice) if "covariance" in estimate["feedback"].name_out() else ()
    variances = _variances(QUANTITIES, covered)
    if estimator_only:
        for name in ("CONTROLLER", "MOST_GUESSES"):
            del macros[name]
        return _export(phases, settings, setup.guess, macros, variances)

    def first_plan(estimate):
        pose = estimate[:3]
        speed_and_traction = estimate[3:]
        return plan_init(stages, pose, speed_and_traction, of_controller)

    control = build_controller(stages)
    if has_yaw_drift:
        control = control | dict(feedback=_with_moved_bounds(control["feedback"]))
    references = build_references(stages.dt_s, stages.N, n_segments, scenario.input_reference)
    reports_accepted = "accepted" in estimate["feedback"].name_out()
    n_z = len(_measured(scenario))
    follow = _build_follow(references, reports_accepted, n_z, has_yaw_drift)
    start = _Start(first_plan, "estimate", n)
    phases |= _bind_all("controller", start, control, settings, _SHARED)
    for name, function in dict(closest=closest(n_segments), follow=follow).items():
        phases[f"path_{name}"] = _in_struct(wired(function), "path", (), settings, _SHARED)
    return _export(phases, settings, setup.guess, macros, variances)


def _variances(names, covered):
    """Of each name the place of its variance on the diagonal of a covariance, -1 without one.

    An estimator without a covariance has none.
    """
    covered = [*covered]
    if not covered:
        return ()
    return tuple(covered.index(name) if name in covered else -1 for name in names)


def export_recorded(recorded):
    """Return the Export of a Recorded."""
    window, guess = recorded.window, recorded.guess
    model, estimated = window.model, window.estimated
    names = tuple(dict.fromkeys((*model.joint_names, *model.inputs)))

    def first_memory(values):
        return window_init_by_name(window, dict(zip(names, values)), recorded.sigma_guess)

    @casadi_function("rhec_first", guess=(len(names), 1))
    def first(guess):
        value = dict(zip(names, ca.vertsplit(guess)))
        return dict(estimate=ca.vertcat(*(value[name] for name in estimated)))

    settings = recorded.settings
    start = _Start(first_memory, "guess", len(names))
    phases = _bind_all(
        "estimator", start, build_estimator(window), settings, _SHARED_BY_MODEL
    ) | dict(
        estimator_first=_in_struct(wired(first), "estimator", (), settings, _SHARED_BY_MODEL),
        estimator_move=_in_struct(wired(recorded.move), "estimator", (), settings, _MOVED),
    )
    macros = dict(
        DT_S=(window.dt_s, "time between samples [s]"),
        ESTIMATOR=(1, "the export has an estimator"),
        OUTPUTS=(len(model.outputs), ", ".join(model.outputs)),
        ESTIMATE=(len(estimated), ", ".join(estimated)),
        GUESS=(len(names), ", ".join(names)),
        GUESS_YAW=(names.index("theta_rad"), "place of the yaw in a guess; x and y are the first"),
        HEADINGS=(recorded.headings, "first yaws that are tried where none is known"),
    )
    values = np.array([guess.get(name, 0.0) for name in names])
    variances = _variances(estimated, model.joint_names)
    result = _export(phases, settings, values, macros, variances)
    return result._replace(inflation=recorded.inflation)


def _measured(scenario):
    """Return the names of the entries of z: MEASURED, then those of the sensors."""
    return (*MEASURED, *(sensor.output for sensor in records(scenario.sensors)))


def _macros_on_a_path(scenario, dt_s, rejected):
    """Return the macros of a scenario's export.

    Its estimator restarts by itself once it has `rejected` so many samples, and that comes first.
    """
    n = len(QUANTITIES)
    measured = _measured(scenario)
    names = "x, y, theta, nu, mu, kappa"
    return dict(
        DT_S=(dt_s, "time between samples [s]"),
        ESTIMATOR=(1, "the export has an estimator"),
        CONTROLLER=(1, "the export has a controller"),
        PATH=(1, "a tracked robot follows a path"),
        OUTPUTS=(len(measured), ", ".join(measured)),
        ESTIMATE=(n, names),
        GUESS=(n, names),
        PATIENCE=(
            scenario.estimation_horizon + 1 + rejected,
            "largest number of predicted estimates in succession",
        ),
        MOST_GUESSES=(MAX_SWEEPS, "largest number of guesses of the active bounds for one plan"),
    )


def export_model(rhe=None, rhc=None):
    """Return the Export of the RHE, the RHC or both of a Model."""
    model = rhe.model if rhe else rhc.stages.model
    dt_s = rhe.window.dt_s if rhe else rhc.stages.dt_s
    macros = dict(DT_S=(dt_s, "time between samples [s]"))
    kinds = dict(STATES=model.states, INPUTS=model.acting, PARAMETERS=model.parameters)
    for name, names in (kinds | dict(OUTPUTS=model.sampled)).items():
        macros[name] = len(names), ", ".join(names) or "none"
    phases = {}
    settings = {}
    guess = np.zeros(1)
    variances = ()
    if rhe:
        guess, sigma_guess = rhe._guess
        settings |= rhe.settings
        start = _Start(
            lambda guess: window_init(rhe.window, guess, sigma_guess), "guess", len(guess)
        )
        estimate = build_estimator(rhe.window)
        phases |= _bind_all("estimator", start, estimate, settings, _SHARED_BY_MODEL)
        macros["ESTIMATOR"] = 1, "the export has an estimator"
        macros["ESTIMATE"] = len(model.names), ", ".join(model.names)
        variances = _variances(model.names, model.joint_names)
    if rhc:
        n_x = len(model.states)
        settings |= rhc.settings
        start = _Start(lambda s_0: rhc.first_memory(s_0[:n_x], s_0[n_x:]), "s_0", rhc.stages.n_s)
        control = build_controller(rhc.stages)
        phases |= _bind_all("controller", start, control, settings, _SHARED_BY_MODEL)
        macros["CONTROLLER"] = 1, "the export has a controller"
        macros["HORIZON"] = rhc.horizon, "intervals of a plan"
        if IMPROVE in control:
            macros["FIRST_ITERATIONS"] = FIRST_ITERATIONS, "most iterations for the first plan"
    macros["GUESS"] = len(guess), ", ".join(model.joint_names) if rhe else "unused"
    return _export(phases, settings, guess, macros, variances)


def _export(phases, settings, guess, macros, variances):
    """Return the Export of bound phases, with the memory and the settings that they use."""
    memory = {}
    used = set()
    for function, reads, writes in phases.values():
        sizes = [(place, function.nnz_in(name)) for name, place in reads.items()]
        sizes += [(place, function.nnz_out(name)) for name, place in writes.items()]
        for place, size in sizes:
            if place.startswith("settings->"):
                used.add(place.removeprefix("settings->"))
            else:
                memory[place] = max(size, 1)  # C has no empty arrays
    settings = {name: np.array(ca.DM(value)) for name, value in settings.items() if name in used}
    return Export(phases, memory, settings, guess, macros, variances)


def _bind_all(owner, start, functions, settings, shared):
    """Return {name in C: Wired} of the phases of an owner, including its start."""
    shift = functions["shift"]
    memory = {name: shift.size_in(name) for name in shift.name_in() if name in shift.name_out()}
    functions = functions | dict(start=_build_start(f"rhec_{owner}_start", start, memory))
    parts = in_two_memories(functions, memory)
    return {
        f"{owner}_{name}": _in_struct(parts[name], owner, memory, settings, shared)
        for name in _PHASES
        if name in parts
    }


def _in_struct(part, owner, memory, settings, shared):
    """Return a Wired phase with its places in the C memory."""

    def place_of(name):
        if name.partition(".")[2] in memory:
            return f"{owner}.{name}"
        if name in settings:
            return f"settings->{name}"
        return shared.get(name, f"{owner}.{name}")

    return renamed(part, place_of)


def _build_start(name, start, shapes):
    """Return the Function that computes the initial memory, {name: shape}, from the guess.

    start.init is affine: memory = constant + slopes · guess. Its values for zero and for the unit
    vectors determine both.
    """

    def first_memory(values):
        memory = start.init(values)
        return pack_array({piece: memory[piece] for piece in shapes})

    constant = first_memory(np.zeros(start.n))
    slopes = np.column_stack([first_memory(unit) - constant for unit in np.eye(start.n)])
    # Missing measurements are NaN for any guess, so their slope is 0, not NaN.
    slopes = ca.sparsify(ca.DM(np.nan_to_num(slopes)))

    @casadi_function(name, **{start.name: (start.n, 1)})
    def function(**values):
        return unpack(ca.SX(constant) + slopes @ values[start.name], shapes)

    return function


def _split_step(step):
    """Return an estimator's step (memory, z, …) -> (memory, estimate, …) as two phases."""
    _, _, *settings = step.name_in()
    _, _, *others = step.name_out()
    symbols = step.mx_in()
    feedback = ca.Function(
        "rhec_estimator_feedback",
        symbols,
        step.call(symbols),
        ["memory", "z_N", *settings],
        ["memory", "estimate", *others],
        {"allow_duplicate_io_names": True},
    )

    @casadi_function("rhec_estimator_shift", ca.MX, memory=step.size_in(0))
    def shift(memory):
        return dict(memory=memory)

    return dict(shift=shift, feedback=feedback)


def closest(n_segments):
    """Return the Function for the arc length [m] of the path's point closest to the estimate."""

    @casadi_function("rhec_closest", estimate=(6, 1), segments=(5, n_segments), length_m=(1, 1))
    def closest(estimate, segments, length_m):
        x = estimate[0]
        y = estimate[1]
        best_distance = ca.inf
        best_s = 0
        ends = [segments[0, i] for i in range(1, n_segments)] + [length_m]
        for segment, end in zip(ca.horzsplit(segments), ends):
            s, x_0, y_0, theta, curvature = ca.vertsplit(segment)
            place = _place_on_segment(x - x_0, y - y_0, theta, curvature)
            # For a point beyond the end of an arc, its beginning may be closer than its end.
            for candidate in (ca.fmin(ca.fmax(place, 0), end - s), 0):
                nearest_x, nearest_y, _ = path.advance(x_0, y_0, theta, curvature, candidate, ca)
                distance = ca.hypot(x - nearest_x, y - nearest_y)
                better = distance < best_distance - 1e-9  # the first of equal distances wins
                best_distance = ca.if_else(better, distance, best_distance)
                best_s = ca.if_else(better, s + candidate, best_s)
        return dict(s_m=best_s)

    return closest


def _place_on_segment(dx, dy, theta, curvature):
    """Return the arc length from a segment's beginning to the closest point of its line or circle.

    dx, dy: Position of the point relative to that beginning [m].
    """
    curved = ca.fmax(ca.fabs(curvature), 1e-12)  # avoids a division by zero for lines
    along = ca.cos(theta) * dx + ca.sin(theta) * dy
    left = ca.cos(theta) * dy - ca.sin(theta) * dx
    angle = ca.atan2(curved * along, 1 - curvature * left)
    arc = (angle + 2 * ca.pi * (angle < 0)) / curved
    return ca.if_else(curvature == 0, along, arc)


def _with_moved_bounds(feedback):
    """The controller's feedback phase with the input `disturbance`, by which its bounds move."""
    move = yaw_disturbance.moved_bounds()
    shapes = {name: feedback.sparsity_in(name) for name in feedback.name_in()}

    @casadi_function("rhc_feedback_moved", ca.MX, **shapes, disturbance=(1, 1))
    def moved(lower, upper, disturbance, **inputs):
        return feedback(**inputs, **move(lower=lower, upper=upper, disturbance=disturbance))

    return moved


def _build_follow(references, reports_accepted, n_z, has_yaw_drift):
    """Return the Function of the references, starting at the last arc length.

    The reference yaw rate is the measured one or, if that is missing or rejected, the last command.
    reports_accepted: Whether the estimator reports which measurements it accepted.
    n_z: Length of a measurement.
    has_yaw_drift: Whether the estimator has the yaw drift, whose disturbance counts in then.
    """
    shapes = {name: references.size_in(name) for name in references.name_in()}
    del shapes["omega_measured"]
    shapes |= dict(z_N=(n_z, 1), command=(1, 1))
    if reports_accepted:
        shapes["accepted"] = (len(MEASURED), 1)
    if has_yaw_drift:
        shapes |= dict(yaw_drift=(1, 1), upper=(1, 1))
    counted_in = yaw_disturbance.counted_in()
    omega = MEASURED.index("omega")
    limit = SPEED_MODELS["parameter"].model.limits[omega]

    @casadi_function("rhec_follow", ca.MX, **shapes)
    def follow(z_N, command, accepted=None, yaw_drift=None, upper=None, **inputs):
        is_used = is_valid_measurement(z_N[omega], limit)
        if reports_accepted:
            is_used = accepted[omega]
        omega_measured = ca.if_else(is_used, z_N[omega], command)
        disturbance = {}
        if has_yaw_drift:
            given = dict(estimate=inputs["estimate"], yaw_drift=yaw_drift, upper=upper)
            disturbance = counted_in(**given, omega_measured=omega_measured)
            omega_measured = disturbance.pop("omega_measured")
        target = references(**inputs, omega_measured=omega_measured)
        return dict(s_next_m=target.pop("s_m")) | target | disturbance

    return follow


def operations(function):
    """Return how many scalar operations a Function takes at most; of branches the longest counts.

    Its loops are unrolled or of fixed length, so that this is a bound of its time.
    """
    kind = function.class_name()
    if kind == "SXFunction":
        return function.n_instructions()
    if kind != "MXFunction":
        inner = [operations(each) for each in function.find_functions(0)]
        return max(inner, default=0) * max(_repetitions(function), 1)
    total = 0
    for k in range(function.n_instructions()):
        node = function.instruction_MX(k)
        if function.instruction_id(k) in (ca.OP_INPUT, ca.OP_OUTPUT):
            total += 1
        elif function.instruction_id(k) == ca.OP_CALL:
            total += operations(node.which_function())
        elif function.instruction_id(k) == ca.OP_MTIMES:
            total += 2 * node.numel() * node.dep(1).size2()
        else:
            total += max(node.numel(), 1)
    return total


def _repetitions(function):
    """Return how often a Map repeats its Function; 1 for a Switch."""
    inner = function.find_functions(0)
    if function.class_name() == "Switch" or not inner:
        return 1
    return function.numel_out(0) // max(inner[0].numel_out(0), 1)
