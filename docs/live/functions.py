"""The CasADi Functions of the live page, and the C text of a run that is made from them.

The sample is the one that `rhec.simulate` runs, for any path of up to twelve segments and any soil
on a grid of up to this size. Errors are counted from the closest point of the whole path, as
`rhec.tracked_robot.path.Path.project` finds it.
"""

import pathlib
from types import SimpleNamespace

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.c_text import generate_c
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS
from rhec.simulation.parts import parts_of
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot.path import SAME_M, advance, ahead_and_left, on_arc, on_line
from rhec.tracked_robot.references import padded_segments

MAX_SAMPLES = round(Scenario.duration_s / paper.DT_S)  # of a run: four minutes
# Outputs of the Function `errors`, in this order.
ERRORS = ("error_m", "error_true_m", "left_m", "on_straight")
# Arrays that hold one entry per sample; all others hold one entry.
_LOGGED = ("memory", "noise", "row", "covariance", "errors")
_LOOP_C = pathlib.Path(__file__).parent / "loop.c"


def build_functions(scenario, soil_shape):
    """Build the Functions that the page calls for the structure of a Scenario.

    Args:
        scenario: The Scenario.
        soil_shape: Shape of the grid of its soil.

    Returns:
        {name: Function}: sample (memory, noise, settings …) -> (memory, row, covariance), and
        errors (row, padded_segments, length_m) -> ERRORS.
    """
    _, settings = closed_loop.set_up(scenario).structure
    world = closed_loop.world_of(scenario)
    world = world._replace(soil_shape=tuple(soil_shape))
    loop = tuple(part.block for part in parts_of(scenario, world))
    sample = closed_loop.build_sample(loop, settings)["step"]
    return dict(sample=sample, errors=_build_errors(len(padded_segments(world.path))))


def closest(x, y, segments, length_m):
    """Where (x, y) is, seen from the closest point of the whole path, as CasADi expressions.

    Args:
        x, y: Place [m].
        segments: (5, M) with columns (s, x, y, θ, c) as in `Path`.
        length_m: Length of the path [m].

    Returns:
        Its distance [m], how far it is to the left of the path [m], and the curvature there.
    """
    columns = ca.horzsplit(segments)
    ends = [*(column[0] for column in columns[1:]), length_m]
    best = ca.vertcat(np.inf, 0, columns[0])
    for column, end in zip(columns, ends):
        s, x_0, y_0, theta, c = ca.vertsplit(column)
        ahead, left = ahead_and_left(x - x_0, y - y_0, theta, ca)
        turns = c != 0
        (line,) = on_line(ahead, left, end - s, ca)
        arc, beginning = on_arc(ahead, left, ca.if_else(turns, c, 1), end - s, ca)
        # The beginning of a line is no closer than what on_line found.
        nearest = [ca.if_else(turns, *both) for both in zip(arc, line)]
        for distance, place in (nearest, beginning):
            found = ca.vertcat(distance, place, column)
            best = ca.if_else(distance < best[0] - SAME_M, found, best)
    distance, place, _, x_0, y_0, theta, c = ca.vertsplit(best)
    x_p, y_p, theta_p = advance(x_0, y_0, theta, c, place, ca)
    _, across = ahead_and_left(x - x_p, y - y_p, theta_p, ca)
    return distance, across, c


def _build_errors(n_segments):
    """{row of the log} -> ERRORS; error_m is NaN where no position was measured."""

    @casadi_function(
        "errors", row=(len(COLUMNS), 1), padded_segments=(5, n_segments), length_m=(1, 1)
    )
    def errors(row, padded_segments, length_m):
        c = SimpleNamespace(**dict(zip(COLUMNS, ca.vertsplit(row))))
        is_measured = (ca.fabs(c.x_meas_m) < np.inf) * (ca.fabs(c.y_meas_m) < np.inf)
        error, _, _ = closest(c.x_meas_m, c.y_meas_m, padded_segments, length_m)
        error_true, left, curvature = closest(c.x_m, c.y_m, padded_segments, length_m)
        measured = ca.if_else(is_measured, error, np.nan)
        return dict(errors=ca.vertcat(measured, error_true, left, curvature == 0))

    return errors


def c_text(functions):
    """The C text of a run: CasADi's C of the Functions, their arrays and arguments, and the loop.

    Args:
        functions: As `build_functions` returns them.

    Returns:
        C with the entry `run`; its arrays hold a run of up to MAX_SAMPLES.
    """
    lengths = {}
    for function in functions.values():
        lengths |= {name: function.nnz_in(name) for name in function.name_in()}
        lengths |= {name: function.nnz_out(name) for name in function.name_out()}
    lines = [f"enum {{ {name.upper()} = {lengths[name]} }};" for name in _LOGGED]
    for name, length in lengths.items():
        # The memory has one entry more than the run has samples: the first.
        entries = MAX_SAMPLES + 1 if name in _LOGGED else 1
        lines.append(f"double at_{name}[{length * entries}];")
    for name, function in functions.items():
        arguments = [f"at_{of}" for of in function.name_in()]
        results = [f"at_{of}" for of in function.name_out()]
        lines += argument_tables(name, function, arguments, results)
    return c_module(functions, lines, _LOOP_C.read_text(encoding="utf-8"))


def argument_tables(name, function, arguments, results):
    """The C lines of the two tables with which a Function of CasADi's C is called.

    `arguments` and `results` are the names of its arrays.
    """
    inputs = ", ".join(arguments)
    outputs = ", ".join(results)
    return [
        f"static const double *{name}_arg[{function.sz_arg()}] = {{{inputs}}};",
        f"static double *{name}_res[{function.sz_res()}] = {{{outputs}}};",
    ]


def c_module(functions, lines, entry):
    """One C text: CasADi's C of the Functions, the lines, room for one call, and the entry."""
    n_iw = max(function.sz_iw() for function in functions.values())
    n_w = max(function.sz_w() for function in functions.values())
    room = [f"static long long iw[{n_iw + 1}];", f"static double w[{n_w + 1}];"]
    casadi_c = generate_c([*functions.values()], "code.c")
    return casadi_c + "\n".join([*lines, *room]) + "\n" + entry
