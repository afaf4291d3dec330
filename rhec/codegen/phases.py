"""What an export is made of: the CasADi Functions, and which piece of the C's memory each of their
arguments and results is.

They are the phases of RHE and RHC (see `gauss_newton`), unchanged, and small ones around them: the
first memory from a guess, the closest point of the whole path, the references. An estimator that is
one step, such as the EKF, is all feedback; what it has to prepare is to move its memory on.
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

# Where in `struct rhec` the phases meet; whatever else they pass on is their owner's.
SHARED = dict(
    z_N="z",
    z_used="estimator.z_used",
    estimate="estimate",
    command="omega",
    xi_ref="path.xi_ref",
    omega_ref="path.omega_ref",
)


class Phase(NamedTuple):
    """A Function; from where in the memory it reads its arguments and where it writes its results,
    one place each, in their order.
    """

    function: ca.Function
    reads: list
    writes: list


class Export(NamedTuple):
    """All that the C is written from."""

    phases: dict  # name in C: Phase
    memory: dict  # place in struct rhec: how many doubles
    settings: dict  # name: matrix, as the scenario has it
    guess: (
        np.ndarray
    )  # (x, y, θ, ν, μ, κ): where the scenario's estimator believes the robot to start


def export(scenario):
    """The phases of a scenario's estimator and controller, bound to the C's memory, and the
    scenario's settings.
    """
    world = simulation.set_up(scenario)
    choices = (
        scenario.estimation_horizon,
        scenario.speed_model,
        scenario.arrival_mean,
        scenario.qp,
        scenario.robust,
    )
    functions = dict(
        estimator=(
            rhe.build_phases(paper.DT_S, *choices)
            if scenario.estimator == "rhe"
            else in_one_step(
                estimators.step(estimators.estimator_key(scenario.estimator), *choices)
            )
        ),
        controller=rhc.build_phases(paper.DT_S, scenario.prediction_horizon, scenario.qp),
    )
    first = dict(
        estimator=lambda guess: estimators.first_memory(scenario, guess),
        controller=lambda guess: pack_array(
            rhc.init(guess[:3], guess[3:], scenario.prediction_horizon)
        ),
    )
    settings = world.settings | dict(
        traction=np.ones(2), length_m=world.path.length_m
    )  # the EKF is told what the closed loop tells it

    phases = {}
    for owner, of in functions.items():
        pieces = {
            name: of["shift"].size_in(name)
            for name in of["shift"].name_in()
            if name in of["shift"].name_out()
        }
        of = dict(start=started(f"rhec_{owner}_start", first[owner], pieces)) | of
        phases |= {
            f"{owner}_{name}": bound(of[name], name, owner, pieces, settings)
            for name in ("start", "expand", "shift", "linearise", "feedback")
            if name in of
        }
    n_segments = len(world.path.segments)
    references = path.build_references(
        paper.DT_S, scenario.prediction_horizon, n_segments, scenario.input_reference
    )["references"]
    believed = "z_used" if "z_used" in functions["estimator"]["feedback"].name_out() else "z_N"
    phases |= {
        f"path_{name}": bound(f, name, "path", {}, settings)
        for name, f in dict(
            closest=closest(n_segments), follow=follow(references, believed)
        ).items()
    }

    memory, used = dict(z=4, estimate=6, omega=1), set()
    for phase in phases.values():
        f = phase.function
        sizes = [*map(f.nnz_in, range(f.n_in())), *map(f.nnz_out, range(f.n_out()))]
        for place, size in zip(phase.reads + phase.writes, sizes):
            if place.startswith("settings->"):
                used.add(place.removeprefix("settings->"))
            else:
                memory[place] = max(size, 1)  # C has no empty arrays
    return Export(
        phases,
        memory,
        {name: np.array(ca.DM(settings[name])) for name in settings if name in used},
        world.guess,
    )


def bound(f, phase, owner, pieces, settings):
    """A phase with its places. The memory's pieces exist twice (see `gauss_newton.Iteration`):
    `shift` takes them from previous to current.
    """

    def place(name, version):
        if name in pieces:
            return f"{owner}.{version}.{name}"
        return f"settings->{name}" if name in settings else SHARED.get(name, f"{owner}.{name}")

    reading, writing = ("previous", "current") if phase == "shift" else ("current", "previous")
    return Phase(
        f,
        [place(name, reading) for name in f.name_in()],
        [place(name, writing) for name in f.name_out()],
    )


def started(name, first_memory, pieces):
    """The first memory, piece by piece, as a Function of the guess. first_memory copies entries of
    the guess and adds constants: it is affine.
    """
    constant = first_memory(np.zeros(6))
    slopes = np.column_stack(
        [np.nan_to_num(first_memory(one) - constant) for one in np.eye(6)]
    )  # a window of NaN does not depend on the guess
    return casadi_function(
        name,
        lambda estimate: unpack(ca.SX(constant) + ca.sparsify(ca.DM(slopes)) @ estimate, pieces),
        dict(estimate=(6, 1)),
    )


def in_one_step(step):
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
    return dict(
        shift=casadi_function(
            "rhec_estimator_shift", lambda memory: dict(memory=memory), dict(memory=size), ca.MX
        ),
        feedback=feedback,
    )


def closest(n_segments):
    """The point of the whole path closest to the estimate, as `Path.project` finds it: its arc
    length [m].
    """

    def body(estimate, segments, length_m):
        best_distance, best_s = ca.inf, 0
        ends = [segments[0, i] for i in range(1, n_segments)] + [length_m]
        for segment, end in zip(ca.horzsplit(segments), ends):
            s, x, y, theta, c = ca.vertsplit(segment)
            across, up, length, curved = (
                estimate[0] - x,
                estimate[1] - y,
                end - s,
                ca.fmax(ca.fabs(c), 1e-12),
            )
            along = ca.cos(theta) * across + ca.sin(theta) * up
            left = ca.cos(theta) * up - ca.sin(theta) * across
            angle = ca.atan2(curved * along, 1 - c * left)
            along = ca.if_else(c == 0, along, (angle + 2 * ca.pi * (angle < 0)) / curved)
            for candidate in (
                ca.fmin(ca.fmax(along, 0), length),
                0,
            ):  # beyond an arc its beginning may be closer than its end
                px, py, _ = path.advance(x, y, theta, c, candidate, ca)
                distance = ca.hypot(estimate[0] - px, estimate[1] - py)
                better = distance < best_distance - 1e-9  # of equals, the first
                best_distance, best_s = (
                    ca.if_else(better, distance, best_distance),
                    ca.if_else(better, s + candidate, best_s),
                )
        return dict(s=best_s)

    return casadi_function(
        "rhec_closest", body, dict(estimate=(6, 1), segments=(5, n_segments), length_m=(1, 1))
    )


def follow(references, believed):
    """The references from the last arc length on, for the yaw rate as measured; where that is
    missing, as last commanded. believed: name of the readings.
    """
    given = {
        name: references.size_in(name) for name in references.name_in() if name != "omega_measured"
    }

    def body(command, **given):
        z = given.pop(believed)
        found = references(
            **given, omega_measured=ca.if_else(is_valid_measurement(z, 3), z[3], command)
        )
        return dict(s_next=found.pop("s")) | found

    return casadi_function(
        "rhec_follow", body, given | {believed: (4, 1)} | dict(command=(1, 1)), ca.MX
    )
