"""Functions of an export, and the place in the C's memory of each of their arguments and results.

They are the phases of estimator and controller (see `solver.rti`), unchanged, and small
ones around them: the first memory from a guess, the closest point of the whole path, the
references. An estimator that is one step, such as the EKF, is all feedback; its preparation only
moves its memory on.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function, pack_array, select_inputs, unpack
from rhec.core.controller.rhc import build_phases as build_controller
from rhec.core.controller.rhc import init as plan_init
from rhec.core.estimator.rhe import build_phases as build_estimator
from rhec.core.estimator.rhe import init as window_init
from rhec.core.model.limits import is_valid_measurement
from rhec.core.solver.pivoting import MAX_SWEEPS
from rhec.simulation import closed_loop
from rhec.tracked_robot import path
from rhec.tracked_robot.cautious import build_speed
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS
from rhec.tracked_robot.references import build_references
from rhec.tracked_robot.rhc import horizon_of

__all__ = ["Export", "closest", "export", "export_model"]

# Places in `struct rhec` that the phases share; all else that they pass on is their owner's.
_SHARED = dict(
    z_N="z",
    accepted="estimator.accepted",
    covariance="estimator.covariance",
    estimate="estimate",
    command="omega",
    command_speed="nu",
    s_next="path.s_next",
    xi_ref="path.xi_ref",
    x_ref="path.xi_ref",
    omega_ref="path.omega_ref",
    u_ref="path.omega_ref",
)
_SHARED_BY_MODEL = dict(z_N="z", estimate="estimate", guess="guess")
_ORDER = "start", "expand", "shift", "linearise", "feedback"


class _Phase(NamedTuple):
    """A Function, and places in the C's memory of its arguments and of its results, in order."""

    function: ca.Function
    reads: list
    writes: list


class Export(NamedTuple):
    """All that the C is written from.

    phases    name in C: (function, reads, writes)
    memory    place in struct rhec: number of doubles
    settings  name: matrix
    guess     the estimator's first; of a scenario (x, y, θ, ν, μ, κ)
    macros    name in C: (value, comment)
    """

    phases: dict
    memory: dict
    settings: dict
    guess: np.ndarray
    macros: dict


def export(scenario):
    """The phases of a scenario's estimator and controller, bound to the C's memory, and the
    scenario's settings.
    """
    setup = closed_loop.set_up(scenario)
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator, choice.robust)
    # An EKF is given what the closed loop gives it.
    traction = estimator.traction_input.select_traction(setup.settings["mean_traction"], None)
    settings = setup.settings | dict(traction=traction, length_m=setup.path.length_m)
    if estimator.build_phases:
        estimate = estimator.build_phases(choice)
    else:
        estimate = _one_step(estimator.build_step(choice))
    horizon = horizon_of(scenario.prediction_horizon, scenario.qp)

    def first_estimate(estimate):
        memory = estimator.init(choice, dict(zip(QUANTITIES, estimate)))
        return memory if estimator.build_phases else dict(memory=pack_array(memory))

    def first_plan(estimate):
        return plan_init(horizon, estimate[:3], estimate[3:]) | dict(speed=estimate[3])

    n_segments = len(setup.path.segments)
    control = build_controller(horizon)
    if scenario.cautious:
        speed = build_speed(estimator.states(choice), n_segments, horizon.dt_s)
        control = _with_speed(control, speed, estimate["feedback"])
    references = build_references(horizon.dt_s, horizon.N, n_segments, scenario.input_reference)[
        "references"
    ]
    follow = _follow(references, "accepted" in estimate["feedback"].name_out())
    starts = [_start(first, estimate=6) for first in (first_estimate, first_plan)]
    phases = _bind_all("estimator", starts[0], estimate, settings, _SHARED)
    phases |= _bind_all("controller", starts[1], control, settings, _SHARED)
    phases |= {
        f"path_{name}": _bind(f, name, "path", {}, settings, _SHARED)
        for name, f in (("closest", closest(n_segments)), ("follow", follow))
    }
    macros = dict(
        DT_S=(horizon.dt_s, "time between samples [s]"),
        PATIENCE=(scenario.estimation_horizon + 1, "most predicted estimates in a row"),
        MOST_GUESSES=(MAX_SWEEPS, "of the active bounds, for one plan"),
    )
    return _export(phases, settings, setup.guess, macros)


def export_model(rhe=None, rhc=None):
    """The phases of the RHE, the RHC or both of a Model, bound to the C's memory."""
    model = rhe.model if rhe else rhc.problem.model
    phases = {}
    settings = {}
    guess = np.zeros(1)
    macros = dict(DT_S=(rhe.window.dt_s if rhe else rhc.problem.dt_s, "time between samples [s]"))
    for name in ("states", "inputs", "parameters", "outputs"):
        names = getattr(model, name)
        macros[name.upper()] = len(names), ", ".join(names) or "none"
    if rhe:
        guess = rhe._guess[0]
        settings = settings | rhe.settings
        start = _start(
            lambda guess: window_init(rhe.window, guess, rhe._guess[1]), guess=len(guess)
        )
        estimate = build_estimator(rhe.window)
        phases |= _bind_all("estimator", start, estimate, settings, _SHARED_BY_MODEL)
        macros |= dict(
            ESTIMATOR=(1, "there is one"), ESTIMATE=(len(model.names), ", ".join(model.names))
        )
    if rhc:
        n_x = len(model.states)
        settings = settings | rhc.settings
        start = _start(
            lambda s_0: plan_init(rhc.problem, s_0[:n_x], s_0[n_x:]), s_0=rhc.problem.n_s
        )
        phases |= _bind_all(
            "controller", start, build_controller(rhc.problem), settings, _SHARED_BY_MODEL
        )
        macros |= dict(CONTROLLER=(1, "there is one"), HORIZON=(rhc.horizon, "intervals of a plan"))
    macros["GUESS"] = len(guess), ", ".join(model.joint_names) if rhe else "unused"
    return _export(phases, settings, guess, macros)


def _export(phases, settings, guess, macros):
    """The Export of phases that are bound, with the memory and the settings that they use."""
    memory = {}
    used = set()
    for f, reads, writes in phases.values():
        sizes = [*map(f.nnz_in, range(f.n_in())), *map(f.nnz_out, range(f.n_out()))]
        for place, size in zip(reads + writes, sizes):
            if place.startswith("settings->"):
                used.add(place.removeprefix("settings->"))
            else:
                memory[place] = max(size, 1)  # C has no empty arrays
    used = {name: np.array(ca.DM(value)) for name, value in settings.items() if name in used}
    return Export(phases, memory, used, guess, macros)


def _bind_all(owner, start, functions, settings, shared):
    """{name in C: _Phase} of an owner's phases. start(name, shapes) makes the one that makes its
    first memory.
    """
    shift = functions["shift"]
    memory = {name: shift.size_in(name) for name in shift.name_in() if name in shift.name_out()}
    functions = functions | dict(start=start(f"rhec_{owner}_start", memory))
    return {
        f"{owner}_{name}": _bind(functions[name], name, owner, memory, settings, shared)
        for name in _ORDER
        if name in functions
    }


def _bind(f, phase, owner, memory, settings, shared):
    """A phase with its places. Memory exists twice (see `rti.RealTimeIteration`): `shift`
    takes it from previous to current.
    """

    def place(name, version):
        if name in memory:
            return f"{owner}.{version}.{name}"
        return f"settings->{name}" if name in settings else shared.get(name, f"{owner}.{name}")

    reading, writing = ("previous", "current") if phase == "shift" else ("current", "previous")
    reads = [place(name, reading) for name in f.name_in()]
    return _Phase(f, reads, [place(name, writing) for name in f.name_out()])


def _start(init, **size):
    """A Function of the guess, of this name and size, for `_bind_all`. init copies entries of the
    guess to the first memory and adds constants: it is affine.
    """
    ((guess, n),) = size.items()

    def make(name, shapes):
        def first(values):
            memory = init(values)
            return pack_array({piece: memory[piece] for piece in shapes})

        constant = first(np.zeros(n))
        slopes = np.column_stack([first(unit) - constant for unit in np.eye(n)])
        # missing measurements are NaN for any guess
        slopes = ca.sparsify(ca.DM(np.nan_to_num(slopes)))

        @casadi_function(name, **{guess: (n, 1)})
        def start(**values):
            return unpack(ca.SX(constant) + slopes @ values[guess], shapes)

        return start

    return make


def _one_step(step):
    """An estimator's step (memory, z, …) -> (memory, estimate, …) as two phases."""
    symbols = step.mx_in()
    inputs = ["memory", "z_N", *step.name_in()[2:]]
    outputs = ["memory", "estimate", *step.name_out()[2:]]
    options = {"allow_duplicate_io_names": True}
    feedback = ca.Function(
        "rhec_estimator_feedback", symbols, step.call(symbols), inputs, outputs, options
    )

    @casadi_function("rhec_estimator_shift", ca.MX, memory=step.size_in(0))
    def shift(memory):
        return dict(memory=memory)

    return dict(shift=shift, feedback=feedback)


def _with_speed(control, speed, estimate):
    """The phases of an RHC with the speed as a second command, as in `cautious.build_step`.

    The last one is memory; whatever that holds, the next is between 0 and the set speed.
    """
    shift = control["shift"]
    feedback = control["feedback"]

    def inputs(*functions):
        return {name: f.sparsity_in(name) for f in functions for name in f.name_in()}

    @casadi_function("rhec_cautious_shift", ca.MX, speed=(1, 1), **inputs(shift))
    def moved(speed, **plan):
        return shift(**plan) | dict(speed=speed)

    given = inputs(speed, feedback) | dict(s_next=(1, 1))  # s is the RHC's
    if "covariance" in estimate.name_out():  # in C, only its nonzeros are passed on
        given["covariance"] = estimate.sparsity_out("covariance")

    @casadi_function("rhec_cautious_feedback", ca.MX, **given)
    def answer(**known):
        planned = feedback(**select_inputs(feedback, known))
        set_speed = known["speed_mps"]
        last = ca.fmin(ca.fabs(known["speed"]), ca.fabs(set_speed))
        known |= dict(s=known["s_next"], speed=last)
        newest = speed(**select_inputs(speed, known))["speed"]
        return planned | dict(speed=newest, command_speed=ca.sign(set_speed) * newest)

    return control | dict(shift=moved, feedback=answer)


def closest(n_segments):
    """The point of the whole path closest to the estimate, as `Path.project` finds it: its arc
    length [m].
    """

    @casadi_function("rhec_closest", estimate=(6, 1), segments=(5, n_segments), length_m=(1, 1))
    def closest(estimate, segments, length_m):
        x = estimate[0]
        y = estimate[1]
        best_distance = ca.inf
        best_s = 0
        ends = [segments[0, i] for i in range(1, n_segments)] + [length_m]
        for segment, end in zip(ca.horzsplit(segments), ends):
            s, x_0, y_0, theta, curvature = ca.vertsplit(segment)
            curved = ca.fmax(ca.fabs(curvature), 1e-12)
            along = ca.cos(theta) * (x - x_0) + ca.sin(theta) * (y - y_0)
            left = ca.cos(theta) * (y - y_0) - ca.sin(theta) * (x - x_0)
            angle = ca.atan2(curved * along, 1 - curvature * left)
            arc = (angle + 2 * ca.pi * (angle < 0)) / curved
            along = ca.if_else(curvature == 0, along, arc)
            # beyond an arc its beginning may be closer than its end
            for candidate in (ca.fmin(ca.fmax(along, 0), end - s), 0):
                px, py, _ = path.advance(x_0, y_0, theta, curvature, candidate, ca)
                distance = ca.hypot(x - px, y - py)
                better = distance < best_distance - 1e-9  # of equals, the first
                best_distance = ca.if_else(better, distance, best_distance)
                best_s = ca.if_else(better, s + candidate, best_s)
        return dict(s=best_s)

    return closest


def _follow(references, gated):
    """The references from the last arc length on, for the measured yaw rate; where that is missing
    or rejected, for the last command.
    """
    inputs = {name: references.size_in(name) for name in references.name_in()}
    del inputs["omega_measured"]
    inputs |= dict(z_N=(4, 1), command=(1, 1)) | (dict(accepted=(4, 1)) if gated else {})
    limit = SPEED_MODELS["parameter"].model.limits[3]

    @casadi_function("rhec_follow", ca.MX, **inputs)
    def follow(z_N, command, accepted=None, **inputs):
        used = accepted[3] if gated else is_valid_measurement(z_N[3], limit)
        target = references(**inputs, omega_measured=ca.if_else(used, z_N[3], command))
        return dict(s_next=target.pop("s")) | target

    return follow
