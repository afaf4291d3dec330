"""A system as its estimators and controllers see it: ẋ = f(x, u, p), z = h(x, u, p).

States x move; inputs u act over an interval; parameters p are constant over a horizon. Estimators
and controllers work on the joint state s = (x, p), in which the parameters are states that do not
move. An output that mixes inputs with anything else is measured through a copy of the last inputs,
which joins the state: s = (x, u, p).
"""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from rhec.core._casadi.sines import sines_by_addition
from rhec.core._casadi.validation import shown
from rhec.core.model.limits import MAX_MEASUREMENT, is_valid_measurement

__all__ = ["SIGMA_UNMEASURED", "Interval", "Model", "MotionNoise", "Output", "interval", "rk4"]

_SIGMA_HELD = 1.0  # of a missing input, which is the last one held
SIGMA_UNMEASURED = 1e3  # of an input that only other outputs tell of


class MotionNoise(NamedTuple):
    """Noise that grows with the motion: functions of an interval's measured inputs.

    inputs(u, R, c) -> (u, R): mean and variances (n_u,) of the inputs, from what their own outputs
    say of them; process(u, W, dt_s, c) -> W: variances (n_s,) of an interval of dt_s [s]; c: values
    of `constants` {name: value}, in order.
    """

    constants: Mapping[str, float]
    inputs: Callable
    process: Callable


@dataclass(frozen=True, kw_only=True)
class Model:
    """A robot, or any other system, whose motion can be written down in some lines.

    Args:
        states: Names of the states x, such as "x_m".
        inputs: Names of the inputs u, which act over an interval: measured, commanded, or both.
        parameters: Name of each parameter in p: its bounds (lowest, highest), or None.
        outputs: Names of the outputs z. A name of a state, input or parameter is measured as it is.
        f: (x, u, p) -> ẋ, CasADi expressions of shapes (n_x,), (n_u,), (n_p,) -> (n_x,).
        h: (x, u, p) -> the outputs that are no such name, in order; or all of z.
        max_measurement: What each output can be at most; beyond, it is not measured.
        motion_noise: Noise in proportion to the motion, where it is not constant.

    Raises:
        ValueError: In one sentence, for what cannot be a model.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: Mapping[str, tuple[float, float] | None]
    outputs: tuple[str, ...]
    f: Callable[[Any, Any, Any], Any]
    h: Callable[[Any, Any, Any], Any] | None = None
    max_measurement: tuple[float, ...] | None = None
    motion_noise: MotionNoise | None = None

    def __post_init__(self) -> None:
        _check_names(self)
        if not callable(self.f) or not callable(self.h or self.f):
            wanted = "f and h should be functions of (x, u, p)"
            raise ValueError(f"f was {shown(self.f)}, h {shown(self.h)}; {wanted}")
        _check_bounds(self.parameters)
        limits = self.max_measurement
        if limits is not None and len(limits) != len(self.outputs):
            wanted = f"it should have {len(self.outputs)} entries, one for each output"
            raise ValueError(f"max_measurement was {shown(limits)}; {wanted}")
        _ = self.dynamics, self.measurement  # an f or h that cannot be is refused at once

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all that can be estimated: states, inputs, parameters."""
        return (*self.states, *self.inputs, *self.parameters)

    @property
    def limits(self) -> tuple[float, ...]:
        """What each output can be at most."""
        return self.max_measurement or (MAX_MEASUREMENT,) * len(self.outputs)

    @functools.cached_property
    def dynamics(self) -> ca.Function:
        """(x, u, p) -> ẋ."""
        return _expressions("f", self.f, self, len(self.states))

    @functools.cached_property
    def measurement(self) -> ca.Function:
        """(x, u, p) -> z."""
        x, u, p = symbols = _symbols(self)
        known = dict(zip(self.names, ca.vertsplit(ca.vertcat(x, u, p))))
        unnamed = [name for name in self.outputs if name not in known]
        if unnamed and self.h is None:
            wanted = "it should be given, since no state, input or parameter has that name"
            raise ValueError(f"h was not given for the output {unnamed[0]!r}; {wanted}")
        if self.h is not None:
            sizes = {len(self.outputs), len(unnamed) or len(self.outputs)}
            values = ca.vertsplit(_expressions("h", self.h, self, *sizes)(*symbols))
            known |= dict(
                zip(self.outputs if len(values) == len(self.outputs) else unnamed, values)
            )
        return ca.Function("h", [x, u, p], [ca.vertcat(*(known[name] for name in self.outputs))])

    @functools.cached_property
    def key(self) -> str:
        """All that decides what is compiled for this model, as text."""
        x, u, p = _symbols(self)
        functions = [self.dynamics, self.measurement]
        if self.motion_noise:
            R, W, dt_s = (ca.SX.sym(*of) for of in (("R", len(u.nz)), ("W", self.n_s), ("dt_s",)))
            c = ca.SX.sym("c", len(self.motion_noise.constants))
            noise = *self.motion_noise.inputs(u, R, c), self.motion_noise.process(u, W, dt_s, c)
            functions.append(ca.Function("noise", [u, R, W, dt_s, c], [*noise]))
        return repr((self.names, self.limits, self.bounds, [f.serialize() for f in functions]))

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self.key == other.key

    @property
    def bounds(self) -> dict[int, tuple[float, float]]:
        """Bounds of the joint state's entries that have some, by their place in it."""
        first = self.n_s - len(self.parameters)
        return {first + i: b for i, b in enumerate(self.parameters.values()) if b is not None}

    @functools.cached_property
    def input_outputs(self) -> dict[int, int]:
        """Place of each input that is measured as it is: the place of its output in z."""
        x, u, p = _symbols(self)
        z = self.measurement(x, u, p)
        found = {}
        for row in range(z.numel()):
            for place in range(u.numel()):
                if ca.is_equal(z[row], u[place], 1) and place not in found:
                    found[place] = row
        return found

    @functools.cached_property
    def holds_inputs(self) -> bool:
        """Whether the joint state holds the last inputs, because an output mixes them."""
        x, u, p = _symbols(self)
        z = self.measurement(x, u, p)
        own = set(self.input_outputs.values())
        return any(ca.depends_on(z[row], u) for row in range(z.numel()) if row not in own)

    @property
    def n_s(self) -> int:
        """Length of the joint state."""
        inputs = len(self.inputs) if self.holds_inputs else 0
        return len(self.states) + inputs + len(self.parameters)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint state's entries."""
        inputs = self.inputs if self.holds_inputs else ()
        return (*self.states, *inputs, *self.parameters)


def _symbols(model):
    sizes = dict(x=len(model.states), u=len(model.inputs), p=len(model.parameters))
    return tuple(ca.SX.sym(name, size) for name, size in sizes.items())


def _expressions(name, function, model, *sizes):
    """A user's f or h as a Function of (x, u, p), or in one sentence why it is none."""
    symbols = _symbols(model)
    try:
        value = ca.SX(function(*symbols))
    except Exception as error:
        wanted = "it should map CasADi expressions (x, u, p) to one expression"
        raise ValueError(f"{name} was refused ({shown(error)}); {wanted}") from error
    wanted = f"{name} was {shown(value)}"
    if value.numel() not in sizes or 1 not in value.shape:
        counts = " or ".join(map(str, sorted(sizes)))
        raise ValueError(f"{wanted}, of shape {value.shape}; it should be a column of {counts}")
    free = [s.name() for s in ca.symvar(value) if not ca.depends_on(ca.vertcat(*symbols), s)]
    if free:
        raise ValueError(f"{wanted}, with {free[0]!r} free; it should depend on x, u and p alone")
    return ca.Function(name, symbols, [ca.densify(ca.vec(value))], ["x", "u", "p"], [name])


def _check_names(model):
    for field in ("states", "inputs", "outputs"):
        names = getattr(model, field)
        if not isinstance(names, tuple) or not names and field != "inputs":
            raise ValueError(f"{field} was {shown(names)}; it should be a tuple of names")
    if not isinstance(model.parameters, Mapping):
        wanted = "it should be a dict of names to bounds or None"
        raise ValueError(f"parameters was {shown(model.parameters)}; {wanted}")
    for field, names in (
        ("states, inputs, parameters", (*model.states, *model.inputs, *model.parameters)),
        ("outputs", model.outputs),
    ):
        for name in names:
            if not isinstance(name, str) or not name.isidentifier():
                wanted = "it should be a word of letters, digits and _, such as 'x_m'"
                raise ValueError(f"a name in {field} was {shown(name)}; {wanted}")
            if names.count(name) > 1:
                raise ValueError(f"{name!r} was twice in {field}; a name should be there once")


def _check_bounds(parameters):
    for name, bounds in parameters.items():
        try:
            lowest, highest = (-1.0, 1.0) if bounds is None else bounds
            fine = bool(lowest < highest) and not isinstance(lowest, str)
        except (TypeError, ValueError):
            fine = False
        if not fine:
            wanted = "it should be (lowest, highest), the first below the second, or None"
            raise ValueError(f"the bounds of {name!r} were {shown(bounds)}; {wanted}")


class Output(NamedTuple):
    """One output as a function of the joint state: z_row = h(s), with H = ∂h/∂s."""

    row: int
    limit: float
    h: ca.Function  # s -> ()
    H: ca.Function  # s -> (1, n_s)
    affine: bool

    def predicted(self, s, s_bar):
        """The output at s, linearised at s_bar where it is not affine."""
        return self.h(s) if self.affine else self.h(s_bar) + self.H(s_bar) @ (s - s_bar)

    def is_valid(self, z):
        """1 where z holds a measurement of this output."""
        return is_valid_measurement(z[self.row], self.limit)


class Interval(NamedTuple):
    """One shooting interval of a model's joint state s, and how it is measured."""

    step: ca.Function  # (s, v, dt_s) -> s at the interval's end
    linearised: ca.Function  # (s, v, dt_s) -> (the same, D, B = ∂s⁺/∂v), A = ∂s⁺/∂s = A_0 + D
    A_0: ca.DM  # entries of A that are constant: written into the code, they cost next to nothing
    n_s: int
    n_v: int
    outputs: tuple[Output, ...]  # that measure the joint state
    input_outputs: dict[int, tuple[int, float]]  # place in v: place in z, limit
    mixing_outputs: dict[int, list[tuple[int, float]]]  # place in v: others that tell of it
    bounds: dict[int, tuple[float, float]]  # place in s: (lowest, highest)
    motion_noise: MotionNoise | None

    def input_noise(self, z, v, V, c=None):
        """Mean and variances (n_v,) of the inputs v before z, as far as it measures them.

        A missing input is the last one held.
        """
        mean = []
        variance = []
        for place in range(self.n_v):
            if place in self.input_outputs:
                row, limit = self.input_outputs[place]
                valid = is_valid_measurement(z[row], limit)
                mean.append(ca.if_else(valid, z[row], v[place]))
                variance.append(ca.if_else(valid, V[row], _SIGMA_HELD**2))
            else:
                valid = [is_valid_measurement(z[row], of) for row, of in self.mixing_outputs[place]]
                mean.append(v[place])
                told = sum(valid, ca.SX(0))
                variance.append(ca.if_else(told, SIGMA_UNMEASURED**2, _SIGMA_HELD**2))
        noise = ca.vertcat(*mean), ca.vertcat(*variance)
        return self.motion_noise.inputs(*noise, c) if self.motion_noise else noise

    def process_noise(self, v, W, dt_s, c=None):
        """Variances (n_s,) of the process noise of an interval of dt_s [s]."""
        return self.motion_noise.process(v, W, dt_s, c) if self.motion_noise else W


@functools.cache
def interval(model, measured=True):
    """The shooting interval of a Model, by one Runge-Kutta step; that of a controller if not
    `measured`: without outputs, and without the last inputs that some outputs need.
    """
    x, u, p = _symbols(model)
    last = ca.SX.sym("last", len(model.inputs))
    dt_s = ca.SX.sym("dt_s")
    x_next = ca.cse(rk4(model.dynamics, x, u, p, dt_s))
    if measured and model.holds_inputs:
        # An interval of no length lies before the first sample: no input is known there.
        s = ca.vertcat(x, last, p)
        s_next = ca.vertcat(x_next, ca.if_else(dt_s > 0, u, last), p)
    else:
        s = ca.vertcat(x, p)
        s_next = ca.vertcat(x_next, p)
    z = model.measurement(x, last, p)
    rows = [row for row in range(z.numel()) if row not in model.input_outputs.values()]
    rows = rows if measured else []
    # Backwards, sums over the stages are made once for all that they are differentiated by.
    J = ca.jacobian(s_next, ca.vertcat(s, u), {"helper_options": {"ad_weight": 1}})
    A = ca.sparsify(J[:, : s.numel()])
    B = J[:, s.numel() :]
    constant = ca.DM(A.sparsity(), [float(a) if a.is_constant() else 0 for a in A.nz[:].elements()])
    A_0 = ca.sparsify(constant)
    if model.motion_noise:  # enters to first order: what it fitted is no information on s
        u_bar = u * ca.DM([float(i in model.input_outputs) for i in range(u.numel())])
        s_next, A, B = ca.substitute([s_next, A, B], [u], [u_bar])
        s_next += B @ (u - u_bar)
    s_next, D, B = sines_by_addition([s_next, ca.sparsify(A - A_0), B])
    limits = model.limits
    inputs = [s, u, dt_s]
    return Interval(
        step=ca.Function("interval", inputs, [s_next], {"cse": True}),
        linearised=ca.Function("linearised", inputs, [s_next, D, B], {"cse": True}),
        A_0=A_0,
        n_s=s.numel(),
        n_v=u.numel(),
        outputs=tuple(_output(row, limits[row], z[row], s) for row in rows),
        input_outputs={u: (row, limits[row]) for u, row in model.input_outputs.items()},
        mixing_outputs={
            place: [(row, limits[row]) for row in rows if ca.depends_on(z[row], last[place])]
            for place in range(u.numel())
        },
        bounds=model.bounds,
        motion_noise=model.motion_noise,
    )


def _output(row, limit, z_row, s):
    """The Output whose value is the expression z_row of the joint state s."""
    H = ca.jacobian(z_row, s)
    h = ca.Function("h", [s], [z_row])
    slope = ca.Function("H", [s], [ca.sparsify(H)])
    return Output(row, limit, h, slope, not ca.depends_on(H, s))


def rk4(f, x, u, p, dt_s):
    """One classical Runge-Kutta step, eq. (3).

    Args:
        f: (x, u, p) -> ẋ.
        x: State at the interval's beginning.
        u: Input, held.
        p: Parameters.
        dt_s: Length of the interval [s].

    Returns:
        The state at its end.
    """
    k1 = f(x, u, p)
    k2 = f(x + dt_s / 2 * k1, u, p)
    k3 = f(x + dt_s / 2 * k2, u, p)
    x_4 = x + dt_s / 2 * k3 + dt_s / 2 * k3
    k4 = f(x_4, u, p)
    mean = x + dt_s * (1 / 6) * (k1 + 2 * k2 + 2 * k3 + k4)
    # A slope that stays leads there exactly, and to no other sum in a sine.
    stays = [ca.is_equal(*slopes, 9) for slopes in zip(*map(ca.vertsplit, (k1, k4)))]
    return ca.vertcat(*(x_4[i] if same else mean[i] for i, same in enumerate(stays)))
