"""The Functions that a batch evaluates, made of the phases that a single object evaluates.

Each is built as {block: Function}, as `rhec.core.lanes.lanes.load` takes it. All of a run's memory
is one vector, the first argument and the first result.
"""

import casadi as ca

from rhec.core._casadi.build import select_inputs, with_packed_memory
from rhec.core.controller import rhc
from rhec.core.estimator import ekf, rhe
from rhec.core.solver.rti import IMPROVE, chained

# What a sample returns besides the memory.
CONTROLLER_RESULTS = ("u_plan", "ok", "kkt")
ESTIMATOR_RESULTS = ("estimate", "covariance", "ok", "kkt")
FILTER_RESULTS = ("estimate", "covariance")

_ITERATION = ("linearise", "feedback", "expand")
_IMPROVED = ("converged", "done", "penalty_after")  # besides, by an iteration with a line search


def build_controller(horizon, part):
    """Build a part, "shift", "iteration" or "improve", of the RHC of a Horizon."""
    phases = rhc.build_phases(horizon)
    if part == IMPROVE:
        return _build_improve(phases, horizon.memory, ("s", "u"), CONTROLLER_RESULTS)
    return _build(phases, horizon.memory, part, CONTROLLER_RESULTS)


def build_estimator(window, part):
    """Build a part, "shift", "iteration" or "improve", of the RHE of a Window."""
    if part == IMPROVE:
        phases = rhe.build_solvable(window)
        return _build_improve(phases, window.memory, rhe.UNKNOWNS, ESTIMATOR_RESULTS)
    return _build(rhe.build_phases(window), window.memory, part, ESTIMATOR_RESULTS)


def build_filter(model, dt_s):
    """Build the sample of an EKF."""
    step = ekf.build(model, dt_s)["step"]
    inputs = {name: ca.MX.sym(name, step.sparsity_in(name)) for name in step.name_in()}
    results = step(**inputs)
    names = ("memory", *FILTER_RESULTS)
    signature = ([*inputs], names, dict(allow_duplicate_io_names=True))
    outputs = [results[name] for name in names]
    block = ca.Function("block", [*inputs.values()], outputs, *signature)
    return dict(block=block)


def _build(phases, memory, part, results):
    """Build some phases, one after the other; `memory` {name: shape} are its pieces."""
    if part == "shift":
        return dict(block=chained("block", [phases["shift"]], memory, (), ca.MX))
    order = [phases[name] for name in _ITERATION]
    return dict(block=chained("block", order, memory, results, ca.MX))


def _build_improve(phases, memory, unknowns, results):
    """Build an iteration with a line search.

    It returns two memories: `memory` as expand leaves it, which the next sample shifts, and
    `current`, in which only the unknowns are new, from which the next iteration goes on.
    """
    improve = phases[IMPROVE]
    inputs = {name: improve.sparsity_in(name) for name in improve.name_in() if name not in memory}

    @with_packed_memory("block", memory, ca.MX, **inputs)
    def block(**values):
        after = improve(**select_inputs(improve, values))
        pieces = values | {name: after[name] for name in unknowns}
        current = ca.veccat(*(ca.densify(pieces[name]) for name in memory))
        names = (*memory, *results, *_IMPROVED)
        return {name: (values | after)[name] for name in names} | dict(current=current)

    return dict(block=block)
