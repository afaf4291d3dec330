"""The CasADi Functions of the live page, and the C text of a run that is made from them.

The sample is the one that `rhec.simulate` runs. Errors are the page's own expression, since its
path is always the default racetrack, for which the closest point has a closed form.
"""

from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.c_text import generate_c
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS

__all__ = ["ERRORS", "MAX_SAMPLES", "argument_tables", "build_functions", "c_module", "c_text"]

MAX_SAMPLES = 1200  # of a run: four minutes
# Outputs of the Function `errors`, in this order.
ERRORS = ("error_m", "error_true_m", "left_m", "on_straight")
# Arrays that hold one entry per sample; all others hold one entry.
_LOGGED = ("memory", "noise", "row", "covariance", "errors")
_LOOP_C = Path(__file__).parent / "loop.c"


def build_functions(scenario):
    """Build the Functions that the page calls for the structure of a Scenario.

    Args:
        scenario: A Scenario on the default racetrack.

    Returns:
        {name: Function}: sample (memory, noise, settings …) -> (memory, row, covariance), and
        errors (row) -> ERRORS.
    """
    setup = closed_loop.set_up(scenario)
    return dict(sample=closed_loop.build_sample(*setup.structure)["step"], errors=_build_errors())


def left_of_racetrack(x, y):
    """Distance of (x, y) to the left of the default racetrack [m].

    The racetrack is the set of points at distance r from the segment c(a) = (a, r), 0 ≤ a ≤ L,
    which joins the centres of both headlands. It is driven counterclockwise, so that its inside
    is on the left: left = r - |(x, y) - c(clip(x, 0, L))|.
    """
    along = ca.fmin(ca.fmax(x, 0), paper.ROW_LENGTH_M)
    radius = paper.HEADLAND_RADIUS_M
    return radius - ca.sqrt((x - along) ** 2 + (y - radius) ** 2)


def _build_errors():
    """{row of the log} -> ERRORS; error_m is NaN where no position was measured."""

    @casadi_function("errors", row=(len(COLUMNS), 1))
    def errors(row):
        c = SimpleNamespace(**dict(zip(COLUMNS, ca.vertsplit(row))))
        is_measured = (ca.fabs(c.x_meas_m) < np.inf) * (ca.fabs(c.y_meas_m) < np.inf)
        error = ca.fabs(left_of_racetrack(c.x_meas_m, c.y_meas_m))
        left = left_of_racetrack(c.x_m, c.y_m)
        on_straight = (c.x_m >= 0) * (c.x_m <= paper.ROW_LENGTH_M)
        measured = ca.if_else(is_measured, error, np.nan)
        return dict(errors=ca.vertcat(measured, ca.fabs(left), left, on_straight))

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
    lines = [f"enum {{ {name.upper()} = {lengths[name]} }};" for name in sorted(_LOGGED)]
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
