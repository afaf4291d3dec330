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
from rhec.logs import replay
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS
from rhec.tracked_robot.choice import Choice

__all__ = ["ERRORS", "MAX_LOG_SAMPLES", "MAX_SAMPLES"]
__all__ += ["argument_tables", "build_functions", "build_replay", "c_module", "c_text"]
__all__ += ["c_text_of_replay"]

MAX_SAMPLES = 1200  # of a run: four minutes
MAX_LOG_SAMPLES = 72_000  # of a reader's own log: four hours
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
    structure = closed_loop.set_up(scenario).structure
    return dict(sample=closed_loop.build_sample(*structure)["step"], errors=_build_errors())


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


def build_replay(scenario):
    """Build the Function of a reader's own log for the estimator of a Scenario.

    Args:
        scenario: A Scenario as `rhec.logs.replay.replay_scenario` returns it, without sensors.

    Returns:
        {"replay": Function (memory, stream, settings …) -> (memory, row)}. The memory is that of
        `rhec.logs.replay.first_memory`, then the last measurements (4,); a sample of the stream is
        z (4,) and the position's age [s]; a row begins with the estimate and its standard
        deviations and ends with the innovation of the position (2,).
    """
    choice = Choice.of(scenario)
    names = replay.quantities_of(choice.sensors)
    step = replay.build_replay(*choice)["step"]
    motion = replay.motion_of(replay.model_of(choice), names)
    n = step.numel_in(0)
    memory = ca.MX.sym("memory", n + 4)
    stream = ca.MX.sym("stream", step.numel_in(1))
    z = stream[:4]
    age_s = ca.if_else(stream[4] >= 0, stream[4], 0)
    held = ca.if_else(ca.fabs(z) < np.inf, z, memory[n:])
    _, predicted = motion(memory[n - len(names) : n], held, paper.DT_S - age_s)
    settings = step.mx_in()[2:]
    after, row, *_ = step.call([memory[:n], stream, *settings])
    results = [ca.vertcat(after, held), ca.vertcat(row, z[:2] - predicted[:2])]
    inputs = ["memory", "stream", *step.name_in()[2:]]
    options = {"allow_duplicate_io_names": True}
    return dict(
        replay=ca.Function(
            "replay", [memory, stream, *settings], results, inputs, ["memory", "row"], options
        )
    )


def c_text_of_replay(functions):
    """The C text that estimates a whole log, of the Function of `build_replay`."""
    return c_text(functions, ("stream", "row"), MAX_LOG_SAMPLES, _LOOP_C.with_name("own_log.c"))


def c_text(functions, logged=_LOGGED, samples=MAX_SAMPLES, loop=_LOOP_C):
    """The C text of a run: CasADi's C of the Functions, their arrays and arguments, and the loop.

    The arrays whose names are in `logged` hold one entry for each of so many samples.
    """
    lengths = {}
    for function in functions.values():
        lengths |= {name: function.nnz_in(name) for name in function.name_in()}
        lengths |= {name: function.nnz_out(name) for name in function.name_out()}
    lines = [
        f"enum {{ {name.upper()} = {lengths[name]} }};" for name in sorted({*logged, "memory"})
    ]
    for name, length in lengths.items():
        # The memory has one entry more than the run has samples: the first.
        entries = samples + 1 if name in logged else 1
        lines.append(f"double at_{name}[{length * entries}];")
    for name, function in functions.items():
        arguments = [f"at_{of}" for of in function.name_in()]
        results = [f"at_{of}" for of in function.name_out()]
        lines += argument_tables(name, function, arguments, results)
    return c_module(functions, lines, loop.read_text(encoding="utf-8"))


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
