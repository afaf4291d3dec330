"""The Functions that a batch evaluates, made of the phases that a single object evaluates.

Each is built as {block: Function}, as `rhec.core.lanes.lanes.load` takes it. All of a run's memory
is one vector, the first argument and the first result.
"""

import casadi as ca

from rhec.core._casadi.build import select_inputs, with_packed_memory
from rhec.core.controller import rhc
from rhec.core.estimator import ekf, rhe

# What a sample returns besides the memory.
CONTROLLER_RESULTS = ("u_plan", "ok", "kkt")
ESTIMATOR_RESULTS = ("estimate", "covariance", "ok", "kkt")
FILTER_RESULTS = ("estimate", "covariance")

_ITERATION = ("linearise", "feedback", "expand")


def build_controller(horizon, part):
    """Build a part, "shift" or "iteration", of the RHC of a Horizon."""
    return _build(rhc.build_phases(horizon), horizon.memory, part, CONTROLLER_RESULTS)


def build_estimator(window, part):
    """Build a part, "shift" or "iteration", of the RHE of a Window."""
    return _build(rhe.build_phases(window, None), window.memory, part, ESTIMATOR_RESULTS)


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
    is_shift = part == "shift"
    chain = [phases[name] for name in (["shift"] if is_shift else _ITERATION)]
    known = {*memory}
    inputs = {}
    for phase in chain:
        inputs |= {key: phase.sparsity_in(key) for key in phase.name_in() if key not in known}
        known.update(phase.name_out())

    @with_packed_memory("block", memory, ca.MX, **inputs)
    def block(**values):
        for phase in chain:
            values |= phase(**select_inputs(phase, values))
        return {name: values[name] for name in (*memory, *(() if is_shift else results))}

    return dict(block=block)
