"""The CasADi Functions with which the story takes one sample of the estimator apart.

They work on the memory of the loop's own RHE. `shift` and `solve` are the preparation and the
feedback of one sample. `kalman` is the extended Kalman filter of the same six states, `shortest`
the RHE whose window is one interval. `free` and `shortest_free` have no bounds on μ and κ. `reckon`
believes the encoders.
"""

import casadi as ca
import numpy as np

from docs.live.functions import argument_tables, c_module
from rhec import paper
from rhec.core._casadi.build import casadi_function, select_inputs, with_packed_memory
from rhec.core.estimator import ekf, rhe
from rhec.core.estimator.window_bounds import without_bounds
from rhec.tracked_robot.estimators import Choice
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS, f, rk4
from rhec.tracked_robot.paper_rhe import SIGMA_START, init, window_of

_RESULTS = ("estimate", "covariance", "m_N", "P_N", "s_N")


def build_tools(scenario):
    """Build the Functions for the RHE of a Scenario.

    Args:
        scenario: A Scenario with the estimator "rhe".

    Returns:
        {name: Function}: shift (memory, V, W), solve and free (memory, z_N, V, P_0), shortest,
        shortest_free and kalman (memory, z_N, V, W …), each with the next memory as its first
        result; reckon (pose, z_N) -> pose.
    """
    window = window_of(Choice.of(scenario))
    free = without_bounds(window)
    return dict(
        shift=_build_shift(window),
        solve=_build_solve("solve", window, window.memory),
        free=_build_solve("free", free, window.memory),
        shortest=_build_shortest("shortest", window),
        shortest_free=_build_shortest("shortest_free", free),
        kalman=_named("kalman", ekf.build(window.model, window.dt_s)["step"]),
        reckon=_build_reckon(),
    )


def _shortest(window):
    """One interval, with the arrival cost's mean from the filter itself."""
    return window._replace(N=1, arrival_mean="filtered")


def _build_shortest(name, window):
    return _named(name, rhe.build_phases(_shortest(window))["step"])


def _named(name, function):
    """The Function under another name."""
    symbols = function.mx_in()
    names = [function.name_in(), function.name_out(), {"allow_duplicate_io_names": True}]
    return ca.Function(name, symbols, function.call(symbols), *names)


def _build_shift(window):
    """The window one sample later; the newest measurement is still missing."""
    phase = rhe.build_phases(window)["shift"]
    inputs = {name: phase.size_in(name) for name in ("V", "W")}

    @with_packed_memory("shift", window.memory, ca.MX, **inputs)
    def shift(**values):
        return phase(**select_inputs(phase, values))

    return shift


def _build_solve(name, window, memory):
    """What the newest measurement makes of a shifted window, and the prediction of its node N.

    `memory` has its shapes, {name: shape}; a window without bounds takes those that it has of them.
    """
    phases = rhe.build_phases(window)
    inputs = {name: phases["feedback"].size_in(name) for name in ("z_N", "V")}
    inputs["P_0"] = phases["expand"].size_in("P_0")

    @with_packed_memory(name, memory, ca.MX, **inputs)
    def solve(**values):
        for phase in ("linearise", "feedback", "expand"):
            values |= phases[phase](**select_inputs(phases[phase], values))
        return {key: values[key] for key in (*_RESULTS, *memory)}

    return solve


def _build_reckon():
    """The pose one sample later for one who believes the encoders: eq. (2) with μ = κ = 1."""
    model = SPEED_MODELS["parameter"].model

    @casadi_function("reckon", pose=(3, 1), z_N=(len(model.outputs), 1))
    def reckon(pose, z_N):
        return dict(pose=rk4(f, pose, z_N[3], ca.vertcat(z_N[2], 1, 1), paper.DT_S))

    return reckon


def first_memories(scenario, guess):
    """The memories of both shortest windows and `kalman` before the first sample, {name: array}.

    `guess` is the loop's first guess of (x, y, θ, ν, μ, κ).
    """
    P = np.diag(np.square([SIGMA_START[name] for name in QUANTITIES]))
    memories = dict(kalman=np.concatenate([guess, P.ravel(), np.zeros(2)]))
    bounded = window_of(Choice.of(scenario))
    for name, window in dict(shortest=bounded, shortest_free=without_bounds(bounded)).items():
        window = _shortest(window)
        pieces = init(window, dict(zip(QUANTITIES, guess)))
        packed = [np.ravel(pieces[piece], order="F") for piece in window.memory]
        memories[name] = np.concatenate(packed)
    return memories


def c_text(functions):
    """The C text of the Functions; `run(i)` calls the i-th, with arrays of its own."""
    lines = []
    cases = []
    for i, (name, function) in enumerate(functions.items()):
        arguments = [f"at_{name}_{of}" for of in function.name_in()]
        results = [f"at_{name}_new_{of}" for of in function.name_out()]
        sizes = [function.nnz_in(j) for j in range(function.n_in())]
        sizes += [function.nnz_out(j) for j in range(function.n_out())]
        lines += [f"double {array}[{n}];" for array, n in zip(arguments + results, sizes)]
        lines += argument_tables(name, function, arguments, results)
        cases.append(f"  if (which == {i}) return {name}({name}_arg, {name}_res, iw, w, 0);")
    run = ["int run(int which) {", *cases, "  return 1;", "}"]
    return c_module(functions, lines, "\n".join(run) + "\n")
