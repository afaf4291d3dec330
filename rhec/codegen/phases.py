"""Functions of an export, and the place in the C's memory of each of their arguments and results.

They are the phases of estimator and controller (see `solver.gauss_newton`), unchanged, and small
ones around them: the first memory from a guess, the closest point of the whole path, the
references. An estimator that is one step, such as the EKF, is all feedback; its preparation only
moves its memory on.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import paper, simulation
from rhec._casadi.build import casadi_function, pack_array, unpack
from rhec.controller import rhc
from rhec.estimator import base as estimators
from rhec.estimator import rhe
from rhec.estimator.kalman import is_valid_measurement
from rhec.model import path

__all__ = ["NOT_EXPORTED", "Export", "Phase", "closest", "export"]

# Estimators that are given what no robot knows
NOT_EXPORTED = dict(oracle="the truth", traction_oracle="the true traction")
# Places in `struct rhec` that the phases share; all else that they pass on is their owner's.
_SHARED = dict(
    z_N="z",
    z_used="estimator.z_used",
    estimate="estimate",
    command="omega",
    xi_ref="path.xi_ref",
    omega_ref="path.omega_ref",
)
_ORDER = "start", "expand", "shift", "linearise", "feedback"


class Phase(NamedTuple):
    """A Function, and places in the C's memory of its arguments and of its results, in order."""

    function: ca.Function
    reads: list
    writes: list


class Export(NamedTuple):
    """All that the C is written from.

    phases    name in C: Phase
    memory    place in struct rhec: number of doubles
    settings  name: matrix, as the scenario has it
    guess     (x, y, θ, ν, μ, κ): where the scenario's estimator believes the robot to start
    """

    phases: dict
    memory: dict
    settings: dict
    guess: np.ndarray


def export(scenario):
    """The phases of a scenario's estimator and controller, bound to the C's memory, and the
    scenario's settings.
    """
    setup, horizon = simulation.set_up(scenario), scenario.prediction_horizon
    settings = setup.settings | dict(
        traction=_given_traction(scenario, setup), length_m=setup.path.length_m
    )
    estimator = _estimator_phases(scenario)
    controller = rhc.build_phases(paper.DT_S, horizon, scenario.qp)

    def first_plan(guess):
        return pack_array(rhc.init(guess[:3], guess[3:], horizon))

    n_segments = len(setup.path.segments)
    references = path.build_references(paper.DT_S, horizon, n_segments, scenario.input_reference)[
        "references"
    ]
    accepted = "z_used" if "z_used" in estimator["feedback"].name_out() else "z_N"
    phases = (
        _with_start(
            "estimator", estimator, lambda guess: estimators.first_memory(scenario, guess), settings
        )
        | _with_start("controller", controller, first_plan, settings)
        | dict(
            path_closest=_bind(closest(n_segments), "closest", "path", {}, settings),
            path_follow=_bind(_follow(references, accepted), "follow", "path", {}, settings),
        )
    )
    memory, used = dict(z=4, estimate=6, omega=1), set()
    for f, reads, writes in phases.values():
        sizes = [*map(f.nnz_in, range(f.n_in())), *map(f.nnz_out, range(f.n_out()))]
        for place, size in zip(reads + writes, sizes):
            if place.startswith("settings->"):
                used.add(place.removeprefix("settings->"))
            else:
                memory[place] = max(size, 1)  # C has no empty arrays
    used = {name: np.array(ca.DM(value)) for name, value in settings.items() if name in used}
    return Export(phases, memory, used, setup.guess)


def _given_traction(scenario, setup):
    """Traction (2,) that the estimator is given, as in the closed loop."""
    mean = setup.settings["mean_traction"]
    return mean if scenario.estimator == "fixed_traction" else np.ones(2)


def _estimator_phases(scenario):
    """The phases of a scenario's estimator, by name."""
    choices = (
        scenario.estimation_horizon,
        scenario.speed_model,
        scenario.arrival_mean,
        scenario.qp,
        scenario.robust,
    )
    if scenario.estimator == "rhe":
        return rhe.build_phases(paper.DT_S, *choices)
    return _one_step(estimators.step(estimators.estimator_key(scenario.estimator), *choices))


def _with_start(owner, functions, first_memory, settings):
    """{name in C: Phase} of an owner's phases and of the start that makes its first memory."""
    shift = functions["shift"]
    memory = {name: shift.size_in(name) for name in shift.name_in() if name in shift.name_out()}
    functions = dict(start=_start(f"rhec_{owner}_start", first_memory, memory)) | functions
    return {
        f"{owner}_{name}": _bind(functions[name], name, owner, memory, settings)
        for name in _ORDER
        if name in functions
    }


def _bind(f, phase, owner, memory, settings):
    """A phase with its places. Memory exists twice (see `gauss_newton.RealTimeIteration`): `shift`
    takes it from previous to current.
    """

    def place(name, version):
        if name in memory:
            return f"{owner}.{version}.{name}"
        return f"settings->{name}" if name in settings else _SHARED.get(name, f"{owner}.{name}")

    reading, writing = ("previous", "current") if phase == "shift" else ("current", "previous")
    reads = [place(name, reading) for name in f.name_in()]
    return Phase(f, reads, [place(name, writing) for name in f.name_out()])


def _start(name, first_memory, shapes):
    """The first memory, piece by piece, as a Function of the guess. first_memory copies entries of
    the guess and adds constants: it is affine.
    """
    constant = first_memory(np.zeros(6))
    slopes = np.column_stack([first_memory(unit) - constant for unit in np.eye(6)])
    slopes = ca.sparsify(ca.DM(np.nan_to_num(slopes)))  # missing measurements are NaN for any guess
    return casadi_function(
        name,
        lambda estimate: unpack(ca.SX(constant) + slopes @ estimate, shapes),
        dict(estimate=(6, 1)),
    )


def _one_step(step):
    """An estimator's step (memory, z, …) -> (memory, estimate, …) as two phases."""
    symbols, size = step.mx_in(), step.size_in(0)
    feedback = ca.Function(
        "rhec_estimator_feedback",
        symbols,
        step.call(symbols),
        ["memory", "z_N", *step.name_in()[2:]],
        ["memory", "estimate", *step.name_out()[2:]],
        {"allow_duplicate_io_names": True},
    )
    shift = casadi_function(
        "rhec_estimator_shift", lambda memory: dict(memory=memory), dict(memory=size), ca.MX
    )
    return dict(shift=shift, feedback=feedback)


def closest(n_segments):
    """The point of the whole path closest to the estimate, as `Path.project` finds it: its arc
    length [m].
    """

    def body(estimate, segments, length_m):
        x, y = estimate[0], estimate[1]
        best_distance, best_s = ca.inf, 0
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

    return casadi_function(
        "rhec_closest", body, dict(estimate=(6, 1), segments=(5, n_segments), length_m=(1, 1))
    )


def _follow(references, accepted):
    """The references from the last arc length on, for the measured yaw rate; where that is missing,
    for the last command. accepted: name of the measurements.
    """
    inputs = {name: references.size_in(name) for name in references.name_in()}
    inputs |= {accepted: (4, 1), "command": (1, 1)}
    del inputs["omega_measured"]

    def body(command, **inputs):
        z = inputs.pop(accepted)
        measured = ca.if_else(is_valid_measurement(z, 3), z[3], command)
        target = references(**inputs, omega_measured=measured)
        return dict(s_next=target.pop("s")) | target

    return casadi_function("rhec_follow", body, inputs, ca.MX)
