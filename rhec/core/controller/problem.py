"""The options of an RHC of a Model: a structure that is compiled, and numbers that are not."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.validation import numbers, of_length, refuse
from rhec.core.controller.bounds import NONE, bounds_of
from rhec.core.controller.stages import Outputs, Stages, linearised_outputs
from rhec.core.model.expressions import expression_of
from rhec.core.model.limits import MAX_QP_ENTRY
from rhec.core.model.robot_model import Model, arguments_of
from rhec.core.solver.interior_point import NO_PRICE

_DEFINITE = -1e-9  # smallest eigenvalue of a weight, relative to its largest


class Options(NamedTuple):
    """All that a user says of an RHC; `rhec.RHC` describes it."""

    model: Model
    command: tuple[str, ...]
    q: Any
    r: Any
    dt: float
    horizon: int
    bounds: Any = None
    qn_factor: float = 1.0
    qn: Any = None
    outputs: Any = None
    q_y: Any = None
    qn_y: Any = None
    r_delta: Any = None
    delta_bounds: Any = None
    terminal_bounds: Any = None


class Problem(NamedTuple):
    """What an RHC solves."""

    stages: Stages  # what is compiled
    settings: dict[str, np.ndarray]  # the numbers: weights, bounds and prices


def problem_of(options: Options) -> Problem:
    """Check the options, and separate the structure from the numbers.

    Args:
        options: The Options.

    Returns:
        The Problem.

    Raises:
        ValueError: If an option is invalid.
    """
    _check_command(options)
    model = options.model
    places = tuple(model.inputs.index(name) for name in options.command)
    outputs = _outputs_of(options)
    weights = _weights_of(options, outputs)
    bounds = _bounds_of(options, outputs)
    has_changes = options.r_delta is not None or bool(bounds["change"])
    stages = Stages(
        model, places, options.dt, options.horizon, outputs, has_changes=has_changes, damped=True
    )
    _check_zeros(options, stages, weights)
    is_bounded = bool(bounds["end"]) or not {*bounds["path"]} <= {*options.command}
    has_matrices = any(weight.ndim == 2 for weight in weights.values())
    if is_bounded or has_matrices or has_changes or outputs.names:
        weights = {name: w if w.ndim == 2 else np.diag(w) for name, w in weights.items()}
        stages, bounds = _general(stages, bounds)
    else:
        stages = stages._replace(outputs=None)
        pairs = [bounds["path"].get(name, NONE) for name in options.command]
        lower, upper = np.clip([(b.lowest, b.highest) for b in pairs], *_LIMITS).T
        bounds = dict(lower=lower, upper=upper)
    numbers = weights | bounds
    wanted = stages.weights | stages.bounds
    settings = {name: numbers[name] for name in numbers if name in wanted and numbers[name].size}
    return Problem(stages, settings)


_LIMITS = (-MAX_QP_ENTRY, MAX_QP_ENTRY)


def _check_command(options):
    """Refuse names of commands that are no inputs."""
    command = options.command
    inputs = options.model.inputs
    if not command:
        raise ValueError(f"command was (); it should name some of {inputs}")
    if not set(command) <= set(inputs) or len(set(command)) < len(command):
        refuse("command was", command, f"it should name some of {inputs}, each once")


# Outputs


def _outputs_of(options):
    """The Outputs of (x, u, p) that are weighed or bounded."""
    model = options.model
    given = options.outputs or ()
    if isinstance(given, str) or not isinstance(given, tuple | list | Mapping):
        expected = "it should be a tuple of the model's outputs, or a dict of names to functions"
        refuse("outputs was", given, expected)
    names = tuple(given)
    for name in names:
        if name in model.names:
            refuse("outputs was", names, f"{name!r} is in the model; q, r and bounds can name it")
    symbols = [model.dynamics.sx_in(i) for i in range(3)]
    if isinstance(given, Mapping):
        of = arguments_of(model, *symbols)
        values = [expression_of(f"outputs[{name!r}]", given[name], of, 1) for name in names]
    else:
        unknown = [name for name in names if name not in model.outputs]
        if unknown:
            expected = f"it should name some of {model.outputs}, or be a dict of names to functions"
            refuse("outputs was", names, expected)
        z = model.measurement(*symbols)
        values = [z[model.outputs.index(name)] for name in names]
    return Outputs(names, ca.Function("outputs", symbols, [ca.vertcat(ca.SX(0, 1), *values)]))


# Weights


def _weights_of(options, outputs):
    """Weights by name: diagonals (n,), or matrices (n, n) where the user gave one."""
    n_x = len(options.model.states)
    n_c = len(options.command)
    n_y = len(outputs.names)
    Q = _weight("q", options.q, n_x, "state")
    weights = dict(Q=Q, QN=options.qn_factor * Q, R=_weight("r", options.r, n_c, "commanded input"))
    if options.qn is not None:
        weights["QN"] = _weight("qn", options.qn, n_x, "state")
    Q_y = np.zeros(n_y) if options.q_y is None else _weight("q_y", options.q_y, n_y, "output")
    weights |= dict(Q_y=Q_y, QN_y=options.qn_factor * Q_y)
    if options.qn_y is not None:
        weights["QN_y"] = _weight("qn_y", options.qn_y, n_y, "output")
    weights["R_delta"] = np.zeros(n_c)
    if options.r_delta is not None:
        weights["R_delta"] = _weight("r_delta", options.r_delta, n_c, "commanded input")
    return weights


def _weight(name, value, n, of):
    """A weight as a diagonal (n,), or as a matrix (n, n) that is symmetric and not negative."""
    weight = numbers(name, value).copy()
    if weight.ndim != 2:
        of_length(name, value if np.ndim(value) else (value,), n, of)
    if weight.shape not in ((n,), (n, n)):
        refuse(f"{name} was", value, f"it should have {n} entries, or be {n} by {n}, for each {of}")
    if not np.all(np.abs(weight) <= 1e100):
        refuse(f"{name} was", value, "it should be made of numbers of at most 1e100")
    if weight.ndim == 1 and weight.min(initial=0.0) < 0:
        place = int(np.argmin(weight))
        refuse(f"{name}[{place}] was", float(weight[place]), "it should not be negative")
    if weight.ndim == 2:
        scale = np.abs(weight).max(initial=0.0)
        if np.abs(weight - weight.T).max(initial=0.0) > 1e-9 * scale:
            refuse(f"{name} was", value, "as a matrix it should be symmetric")
        if np.linalg.eigvalsh(weight).min(initial=0.0) < _DEFINITE * scale:
            refuse(f"{name} was", value, "as a matrix it should have no negative eigenvalue")
    return weight


def _check_zeros(options, stages, weights):
    """Refuse a command without a weight that nothing weighed depends on after one interval.

    The QP would have no unique solution at the last interval, whatever the state.
    """

    def diagonal(name):
        weight = weights[name]
        return weight if weight.ndim == 1 else np.diag(weight)

    if np.all(diagonal("R") + diagonal("R_delta")):
        return
    linearised = linearised_outputs(stages)
    C = linearised.sparsity_out("C")
    through = linearised.sparsity_out("E")
    moved = stages.interval.sparsities["B"]
    for i, (name, place) in enumerate(zip(options.command, stages.command)):
        if diagonal("R")[i] > 0 or diagonal("R_delta")[i] > 0:
            continue
        states = [row for row in range(stages.n_x) if moved.has_nz(row, place)]
        weighed = any(diagonal("QN")[row] > 0 for row in states)
        for y in range(stages.n_y):
            by_state = diagonal("QN_y")[y] > 0 and any(C.has_nz(y, row) for row in states)
            direct = diagonal("Q_y")[y] > 0 and through.has_nz(y, place)
            weighed = weighed or by_state or direct
        if not weighed:
            expected = (
                f"it should be above 0, since nothing that is weighed at the horizon's end depends "
                f"on {name!r} within one interval"
            )
            refuse(f"r[{i}] was", 0.0, expected)


# Bounds


def _bounds_of(options, outputs):
    """Bounds {name: Bound} along the horizon, at its end, and of changes."""
    states = (*options.model.states, *outputs.names)
    path = bounds_of("bounds", options.bounds, (*options.command, *states))
    for name in options.command:
        if name in path and path[name].is_soft:
            raise ValueError(f"bounds of {name!r} had a price; those of a command should be hard")
    end = bounds_of("terminal_bounds", options.terminal_bounds, states)
    for name, bound in end.items():
        if name in path and (bound.is_soft, bound.prices) != (
            path[name].is_soft,
            path[name].prices,
        ):
            raise ValueError(
                f"the prices of {name!r} in terminal_bounds were {bound.prices}; they should be "
                f"those in bounds, {path[name].prices}"
            )
    path = bounds_of("state_bounds", options.model.state_bounds, options.model.states) | path
    change = bounds_of("delta_bounds", options.delta_bounds, options.command)
    return dict(path=path, end=end, change=change)


def _general(stages, bounds):
    """The Stages with rows for these bounds {kind: {name: Bound}}, and the numbers of all rows."""
    path = bounds["path"] | {(name,): bound for name, bound in bounds["change"].items()}
    end = bounds["end"]
    names = stages.quantities
    commands = names[stages.n_x : stages.n_x + stages.n_c]
    bounded = [
        place
        for place, name in enumerate(names)
        if name not in commands and (name in path or name in end)
    ]
    stages = stages._replace(is_general=True, bounded=tuple(bounded))
    along = [path.get(names[place], NONE) for place in stages.rows]
    # What does not count at the end has no bound there, either.
    last = [end.get(names[place], bound) for place, bound in zip(stages.rows, along)]
    numbers = dict(
        lower=[bound.lowest for bound in along],
        upper=[bound.highest for bound in along],
        lower_N=[bound.lowest for bound in last],
        upper_N=[bound.highest for bound in last],
    )
    numbers = {name: np.clip(value, *_LIMITS) for name, value in numbers.items()}
    priced = [a if a.is_soft else b for a, b in zip(along, last)][stages.n_c :]
    prices = [bound.prices if bound.is_soft else (NO_PRICE, 0.0) for bound in priced]
    linear, quadratic = np.reshape(prices, (-1, 2)).T
    return stages, numbers | dict(linear=linear, quadratic=quadratic)
