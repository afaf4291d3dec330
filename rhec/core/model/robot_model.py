"""A system as its estimators and controllers see it: ẋ = f(x, u, p), z = h(x, u, p).

States x change; inputs u act over an interval; parameters p are constant over a horizon. Estimators
and controllers work on the joint state s = (x, p), in which the parameters are constant states. If
an output depends on inputs and anything else, the joint state also holds these last inputs, through
which that output is measured: s = (x, held inputs, p).

Known signals d, which f and h may read besides, are given with each sample: z_k comes with d_k,
which h reads at that sample, and f until the next one. They are neither estimated nor measured.
Behind the outputs they are the last entries of z, and behind the inputs those of v and of u.
"""

import functools
import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.sines import sines_by_addition
from rhec.core._casadi.validation import refuse, shown
from rhec.core.model.expressions import expression_of
from rhec.core.model.integration import RULES, Rule, integrate
from rhec.core.model.integration import rk4 as rk4
from rhec.core.model.known import checked_known
from rhec.core.model.limits import (
    MAX_MEASUREMENT,
    MAX_PLAUSIBLE_STATE,
    MAX_QP_ENTRY,
    is_valid_measurement,
)

# Standard deviations of inputs.
HELD_BY_NOISE = 10.0  # of a missing input, taken to be the last one: as a multiple of its sigma_v
SIGMA_HELD = 1.0  # the same in the input's unit, where it has no output of its own
SIGMA_UNMEASURED = 1e3  # [SIGMA_HELD] such an input is known from other outputs only


class MotionNoise(NamedTuple):
    """Noise that grows with the motion, as functions of an interval's measured inputs.

    `inputs` maps (u, R, c) to the mean and variances (n_u,) of the inputs, from their measurements
    u with variances R. `process` maps (u, W, dt_s, c) to the variances (n_s,) of the process noise
    of an interval of dt_s [s].
    """

    constants: Mapping[str, float]  # of c, by name, in order
    inputs: Callable
    process: Callable


@dataclass(frozen=True, kw_only=True)
class Model:
    """A robot, or any other system, whose motion can be written down in a few lines.

    Args:
        states: Names of the states x, such as "x_m". A single name need not be in a tuple; this
            holds for inputs, outputs and angles, too.
        inputs: Names of the inputs u, which act over an interval: measured, commanded, or both.
        parameters: {name: (lowest, highest)} of the parameters p; {name: None} without bounds.
        outputs: Names of the outputs z, which an estimator needs. An output named like a state,
            input or parameter measures just that.
        known: Names of known signals d, such as the direction of a row, which come with each
            sample. f and h are then functions of (x, u, p, d).
        f: (x, u, p) -> ẋ, CasADi expressions of shapes (n_x,), (n_u,), (n_p,) -> (n_x,), as one
            column or as a list. An argument can be unpacked: `a, b = x`.
        h: (x, u, p) -> the outputs with other names, in order; or all of z.
        max_measurement: Largest plausible size of each output; larger values count as missing.
            By default 1e8 in the output's unit: choose units in which no output is that large.
        angles: Names of the outputs that are angles [rad], which are measured up to full turns.
        heading: Name of the state that is the robot's heading [rad], if any. Where an estimate may
            be turned round, by half a turn, an RHE then tries the other direction, too. An RHC
            takes it and its references up to full turns: +3.1 and -3.1 are near each other.
        sigma_held: {name: standard deviation} of inputs that are not measured for a sample, and are
            taken to be the last ones then: how far such an input changes in a sample, in its unit.
            By default ten times its `sigma_v`. For an input without an output of its own it is the
            scale of its unit, by default 1, and 1000 times as much is "unknown".
        motion_noise: Noise that grows with the motion, if any.
        steps: Substeps of an interval, for a model that moves fast within one.
        rule: How a substep is integrated: "rk4", the explicit classical Runge-Kutta rule; or for a
            stiff model an implicit one, "radau3" or "radau5", Radau IIA of that order. A stiff
            model has modes that die out much faster than an interval.
        discrete: Whether f gives the next state, one sample later, instead of ẋ.
        state_bounds: {name: (lowest, highest)} of states that a RHE keeps within these bounds, at
            all nodes of its window.

    Raises:
        ValueError: If an argument is invalid.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...] = ()
    parameters: Mapping[str, tuple[float, float] | None] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    f: Callable[..., Any]
    h: Callable[..., Any] | None = None
    max_measurement: tuple[float, ...] | None = None
    angles: tuple[str, ...] = ()
    heading: str | None = None
    sigma_held: Mapping[str, float] = field(default_factory=dict)
    motion_noise: MotionNoise | None = None
    steps: int = 1
    rule: Rule = "rk4"
    discrete: bool = False
    state_bounds: Mapping[str, tuple[float, float]] | None = None

    def __post_init__(self) -> None:
        for name in ("states", "inputs", "outputs", "known", "angles"):
            object.__setattr__(self, name, _names_of(name, getattr(self, name)))
        _check_names(self)
        if not callable(self.f) or not callable(self.h or self.f):
            problem = f"f was {shown(self.f)}, h {shown(self.h)}"
            raise ValueError(f"{problem}; f and h should be functions of (x, u, p)")
        _check_integration(self)
        _check_bounds(self.parameters)
        _check_state_bounds(self)
        _check_limits(self.max_measurement, len(self.outputs))
        if not set(self.angles) <= set(self.outputs):
            refuse("angles was", self.angles, f"it should name some of {self.outputs}")
        if self.heading is not None and self.heading not in self.states:
            refuse("heading was", self.heading, f"it should be None or one of {self.states}")
        _check_sigma_held(self)
        if not isinstance(self.motion_noise, MotionNoise | None):
            refuse("motion_noise was", self.motion_noise, "it should be a MotionNoise or None")
        _ = self.dynamics, self.measurement  # an invalid f or h is refused at once

    def __repr__(self) -> str:
        parameters = (
            f"{name} in [{bounds[0]:g}, {bounds[1]:g}]" if bounds else name
            for name, bounds in self.parameters.items()
        )
        return (
            f"Model\n    states:     {', '.join(self.states)}"
            f"\n    inputs:     {', '.join(self.inputs) or 'none'}"
            f"\n    parameters: {', '.join(parameters) or 'none'}"
            f"\n    outputs:    {', '.join(self.outputs) or 'none'}"
            + (f"\n    known:      {', '.join(self.known)}" if self.known else "")
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of states, inputs and parameters: all that can be estimated."""
        return (*self.states, *self.inputs, *self.parameters)

    @property
    def acting(self) -> tuple[str, ...]:
        """Names of all that acts over an interval: inputs, then known signals."""
        return (*self.inputs, *self.known)

    @property
    def sampled(self) -> tuple[str, ...]:
        """Names of all that comes with a sample z: outputs, then known signals."""
        return (*self.outputs, *self.known)

    @property
    def limits(self) -> tuple[float, ...]:
        """Largest plausible size of each output."""
        return self.max_measurement or (MAX_MEASUREMENT,) * len(self.outputs)

    @functools.cached_property
    def dynamics(self) -> ca.Function:
        """(x, u, p) -> ẋ, or the next state of a discrete Model; u ends with what is known."""
        symbols = _symbols(self)
        slope = expression_of("f", self.f, arguments_of(self, *symbols), len(self.states))
        return ca.Function("f", symbols, [slope], ["x", "u", "p"], ["f"])

    @functools.cached_property
    def slopes(self) -> ca.Function:
        """(x, u, p) -> ∂f/∂x."""
        symbols = _symbols(self)
        by_x = ca.jacobian(self.dynamics(*symbols), symbols[0])
        return ca.Function("slopes", symbols, [ca.densify(by_x)])

    @functools.cached_property
    def measurement(self) -> ca.Function:
        """(x, u, p) -> z."""
        symbols = _symbols(self)
        values = dict(zip(self.names, ca.vertsplit(ca.vertcat(*arguments_of(self, *symbols)[:3]))))
        unnamed = [name for name in self.outputs if name not in values]
        if unnamed and self.h is None:
            expected = "it should be given, since nothing in the model has that name"
            raise ValueError(f"h was not given for the output {unnamed[0]!r}; {expected}")
        if self.h is not None:
            sizes = {len(self.outputs), len(unnamed) or len(self.outputs)}
            outputs = ca.vertsplit(expression_of("h", self.h, arguments_of(self, *symbols), *sizes))
            names = self.outputs if len(outputs) == len(self.outputs) else unnamed
            values |= dict(zip(names, outputs))
        z = (values[name] for name in self.outputs)
        return ca.Function("h", symbols, [ca.vertcat(ca.SX(0, 1), *z)])

    @functools.cached_property
    def key(self) -> str:
        """Everything that decides what is compiled for this model, as text."""
        functions = [self.dynamics, self.measurement]
        if self.motion_noise:
            functions.append(_noise_function(self))
        serialized = [function.serialize() for function in functions]
        integration = (self.steps, self.rule, self.discrete)
        named = (
            self.names,
            self.known,
            self.limits,
            self.angles,
            self.heading,
            sorted(self.sigma_held.items()),
        )
        return repr((*named, self.bounds, integration, serialized))

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self.key == other.key

    @property
    def bounds(self) -> dict[int, tuple[float, float]]:
        """Bounds of the bounded entries of the joint state, by their place in it."""
        place = self.joint_names.index
        # An infinite bound is a number here, because its product with a multiplier 0 is no number.
        return {
            place(name): (max(bounds[0], -MAX_QP_ENTRY), min(bounds[1], MAX_QP_ENTRY))
            for name, bounds in ((self.state_bounds or {}) | dict(self.parameters)).items()
            if bounds is not None
        }

    def simulate(
        self, x: Any, u: Any, p: Any = (), *, dt: float, known: Mapping[str, Any] | None = None
    ) -> np.ndarray:
        """Integrate from a state under inputs that are constant over each sample.

        Args:
            x: (n_x,) state at the beginning.
            u: (n, n_u) inputs, a row for each sample.
            p: (n_p,) parameters.
            dt: Length of a sample [s].
            known: {name: number, or (n,) numbers} of the Model's known signals.

        Returns:
            (n + 1, n_x) states, a row for each sample and the first of them x, by the Model's
            rule. `rhec.RHC` wants desired states as columns: x_ref is the transpose.

        Raises:
            ValueError: If an argument has another shape.
        """
        wanted = dict(x=(len(self.states),), p=(len(self.parameters),))
        given = dict(x=np.asarray(x, float).ravel(), p=np.asarray(p, float).ravel())
        for name, shape in wanted.items():
            if given[name].shape != shape:
                raise ValueError(f"{name} had shape {given[name].shape}; it should have {shape}")
        u = np.atleast_2d(np.asarray(u, float))
        if u.shape[1:] != (len(self.inputs),):
            raise ValueError(f"u had shape {u.shape}; it should have (n, {len(self.inputs)})")
        d = checked_known(self.known, known, np.full((len(self.known), len(u)), np.nan))
        u = np.hstack([u, d.T])
        step = interval(self, measured=False).step
        s = np.concatenate([given["x"], given["p"]])
        trajectory = [given["x"]]
        for row in u:
            s = np.array(step(s, row, dt)).ravel()
            trajectory.append(s[: len(self.states)])
        return np.array(trajectory)

    @functools.cached_property
    def input_outputs(self) -> dict[int, int]:
        """{place in u: place in z} of the inputs that have an output of their own."""
        x, u, p = _symbols(self)
        z = self.measurement(x, u, p)
        rows = {}
        for row, place in itertools.product(range(z.numel()), range(u.numel())):
            if ca.is_equal(z[row], u[place], 1):
                rows.setdefault(place, row)
        return rows

    @functools.cached_property
    def held_inputs(self) -> tuple[str, ...]:
        """Names of the last inputs that the joint state holds, because an output mixes them."""
        x, u, p = _symbols(self)
        z = self.measurement(x, u, p)
        others = set(range(z.numel())) - set(self.input_outputs.values())
        mixing = ca.vertcat(ca.SX(0, 1), *(z[row] for row in sorted(others)))
        return tuple(name for i, name in enumerate(self.inputs) if ca.depends_on(mixing, u[i]))

    @property
    def n_s(self) -> int:
        """Length of the joint state."""
        return len(self.joint_names)

    @functools.cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joint state's entries."""
        return (*self.states, *self.held_inputs, *self.parameters)


def _symbols(model):
    vectors = dict(x=model.states, u=model.acting, p=model.parameters)
    return [ca.SX.sym(letter, len(names)) for letter, names in vectors.items()]


def arguments_of(model, x, u, p):
    """What a user's function is called with, where u ends with what is known."""
    n_u = len(model.inputs)
    return [x, u[:n_u], p, *([u[n_u:]] if model.known else [])]


def _noise_function(model):
    """The Model's MotionNoise as a Function of (u, R, W, dt_s, c)."""
    u = ca.SX.sym("u", len(model.inputs))
    R = ca.SX.sym("R", u.numel())
    W = ca.SX.sym("W", model.n_s)
    dt_s = ca.SX.sym("dt_s")
    c = ca.SX.sym("c", len(model.motion_noise.constants))
    mean, variances = model.motion_noise.inputs(u, R, c)
    process = model.motion_noise.process(u, W, dt_s, c)
    return ca.Function("noise", [u, R, W, dt_s, c], [mean, variances, process])


def _names_of(field, names):
    """Names as a tuple, from a tuple, a list, or one name."""
    if isinstance(names, str):
        return (names,)
    if not isinstance(names, tuple | list):
        refuse(f"{field} was", names, "it should be a tuple of names, or one name")
    return tuple(names)


def _check_names(model):
    if not model.states:
        refuse("states was", model.states, "it should be a tuple of names, or one name")
    if not isinstance(model.parameters, Mapping):
        refuse("parameters was", model.parameters, "it should be a dict of names to bounds or None")
    named = {
        "states, inputs, parameters": model.names,
        "outputs": model.outputs,
        "states, inputs, parameters, known": (*model.names, *model.known),
        "outputs, known": model.sampled,
    }
    for where, names in named.items():
        for name in names:
            if not isinstance(name, str) or not name.isidentifier():
                expected = "it should be a word of letters, digits and _, such as 'x_m'"
                refuse(f"a name in {where} was", name, expected)
            if names.count(name) > 1:
                raise ValueError(f"{name!r} was twice in {where}; a name should be there once")


def _check_integration(model):
    if isinstance(model.steps, bool) or not isinstance(model.steps, int) or model.steps < 1:
        refuse("steps was", model.steps, "it should be a whole number, 1 or more")
    if model.rule not in RULES:
        refuse("rule was", model.rule, f"it should be one of {RULES}")
    if not isinstance(model.discrete, bool):
        refuse("discrete was", model.discrete, "it should be True or False")
    if model.discrete and (model.steps, model.rule) != (1, "rk4"):
        given = f"steps was {model.steps} and rule {model.rule!r} for a discrete Model"
        raise ValueError(f"{given}; its f is the whole step, so they should not be given")


def _check_bounds(parameters):
    for name, bounds in parameters.items():
        try:
            lowest, highest = (-1.0, 1.0) if bounds is None else bounds
            is_valid = float(lowest) < float(highest) and not isinstance(lowest, str)
        except Exception:  # CasADi's symbols raise errors of their own
            is_valid = False
        if not is_valid:
            expected = "it should be (lowest, highest), the first below the second, or None"
            refuse(f"the bounds of {name!r} were", bounds, expected)


def _check_state_bounds(model):
    if not isinstance(model.state_bounds, Mapping | None):
        refuse("state_bounds was", model.state_bounds, "it should be a dict of names to bounds")
    for name in model.state_bounds or {}:
        if name not in model.states:
            refuse("a name in state_bounds was", name, f"it should be one of {model.states}")
        if model.state_bounds[name] is None:
            refuse(f"the bounds of {name!r} were", None, "it should be (lowest, highest)")
    _check_bounds(model.state_bounds or {})


def _check_sigma_held(model):
    if not isinstance(model.sigma_held, Mapping):
        refuse("sigma_held was", model.sigma_held, "it should be a dict of inputs to numbers")
    for name, sigma in model.sigma_held.items():
        if name not in model.inputs:
            refuse("a name in sigma_held was", name, f"it should be one of {model.inputs}")
        is_number = isinstance(sigma, int | float) and not isinstance(sigma, bool)
        if not is_number or not 0 < sigma < MAX_PLAUSIBLE_STATE**0.5:
            refuse(f"sigma_held of {name!r} was", sigma, "it should be a number above 0")


def _check_limits(limits, n_z):
    if limits is None:
        return
    try:
        is_valid = len(limits) == n_z and all(0 < limit <= MAX_PLAUSIBLE_STATE for limit in limits)
    except Exception:  # CasADi's symbols raise errors of their own
        is_valid = False
    if not is_valid:
        entries = f"{n_z} entries, one for each output"
        expected = f"it should have {entries}, each above 0 and at most {MAX_PLAUSIBLE_STATE:g}"
        refuse("max_measurement was", limits, expected)


class Output(NamedTuple):
    """One output as a function of the joint state: z_row = h(s), with H = ∂h/∂s."""

    row: int
    limit: float
    h: ca.Function  # (s, known signals) -> ()
    H: ca.Function  # (s, known signals) -> (1, n_s)
    affine: bool
    is_angle: bool = False  # whether it is measured up to full turns
    known: tuple[int, ...] = ()  # places in z of the known signals

    def value(self, s, z):
        """The output at s, with what is known in z."""
        return self.h(s, *(z[row] for row in self.known))

    def slope(self, s, z):
        """H at s, with what is known in z."""
        return self.H(s, *(z[row] for row in self.known))

    def residual(self, z, s, s_bar):
        """The measurement in z minus the output at s; of an angle within ±π.

        An output that is not affine is linearised at s_bar.
        """
        if self.affine:
            predicted = self.value(s, z)
        else:
            predicted = self.value(s_bar, z) + self.slope(s_bar, z) @ (s - s_bar)
        difference = z[self.row] - predicted
        if not self.is_angle:
            return difference
        return difference - 2 * ca.pi * ca.floor(difference / (2 * ca.pi) + 0.5)

    def is_valid(self, z):
        """1 where z holds a measurement of this output."""
        return is_valid_measurement(z[self.row], self.limit)


class Interval(NamedTuple):
    """One shooting interval of a model's joint state s, and how s and the inputs v are measured."""

    step: ca.Function  # (s, v, dt_s) -> s⁺ at the interval's end
    linearised: ca.Function  # (s, v, dt_s) -> (s⁺, D, B = ∂s⁺/∂v), where ∂s⁺/∂s = A_0 + D
    A_0: ca.DM  # the constant entries of ∂s⁺/∂s: as numbers in the code they cost next to nothing
    n_s: int
    n_v: int
    outputs: tuple[Output, ...]  # those that measure the joint state
    input_outputs: dict[int, tuple[int, float]]  # place in v: place in z, limit
    mixing_outputs: dict[int, list[tuple[int, float]]]  # the same of all other outputs of it
    bounds: dict[int, tuple[float, float]]  # place in s: (lowest, highest)
    sigma_held: dict[int, float]  # place in v: as the Model says, where it does
    motion_noise: MotionNoise | None
    known: dict[int, int]  # place in v: place in z of known signals, which no unknown is fitted to

    @property
    def sparsities(self):
        """Sparsities of the interval's end F, of D and of B, by name."""
        return {name: self.linearised.sparsity_out(i) for i, name in enumerate("FDB")}

    def input_noise(self, z, v, V, c=None, held=None):
        """Mean and variances (n_v,) of the inputs, given the measurements z and the last inputs v.

        A missing input is taken to be the last one, with the variance `held`; None: as the Model
        says, by default a multiple of its measurements' variance.
        """
        mean = []
        variance = []
        for place in range(self.n_v - len(self.known)):
            sigma = self.sigma_held.get(place)
            if place in self.input_outputs:
                row, limit = self.input_outputs[place]
                is_valid = is_valid_measurement(z[row], limit)
                by_noise = V[row] * HELD_BY_NOISE**2
                missing = held if held is not None else sigma**2 if sigma else by_noise
                mean.append(ca.if_else(is_valid, z[row], v[place]))
                variance.append(ca.if_else(is_valid, V[row], missing))
            else:
                sigma = sigma or SIGMA_HELD
                others = self.mixing_outputs[place]
                valid = [is_valid_measurement(z[row], limit) for row, limit in others]
                n_valid = sum(valid, ca.DM(0))
                missing = sigma**2 if held is None else held
                mean.append(v[place])
                variance.append(ca.if_else(n_valid, (SIGMA_UNMEASURED * sigma) ** 2, missing))
        mean, variance = ca.vertcat(*mean), ca.vertcat(*variance)
        if self.motion_noise:
            mean, variance = self.motion_noise.inputs(mean, variance, c)
        # What is known has no slopes B, so that its variance is a number that nothing reads.
        known = [v[place] for place in self.known]
        return ca.vertcat(mean, *known), ca.vertcat(variance, *(1 for _ in known))

    def with_known(self, v, z):
        """Inputs v (n_v,) of the interval that begins at a sample z, with what is known there."""
        v = type(v)(v)
        for place, row in self.known.items():
            v[place] = z[row]
        return v

    def without_measurements(self, z):
        """A sample z (n_z,) in which nothing was measured; what is known stays."""
        known = [z[row] for row in self.known.values()]
        return ca.vertcat(ca.DM.nan(z.numel() - len(known)), *known)

    def process_noise(self, v, W, dt_s, c):
        """Variances (n_s,) of the process noise of an interval of dt_s [s]."""
        return self.motion_noise.process(v, W, dt_s, c) if self.motion_noise else W


@functools.cache
def interval(model, measured=True):
    """The shooting interval of a Model: its step in time, the step's derivatives, its outputs.

    A controller's interval is not `measured`: it has no outputs, nor the last inputs in s.
    """
    x, u, p = _symbols(model)
    u_last = ca.SX.sym("last", u.numel())
    n_u = len(model.inputs)
    n_z = len(model.outputs)
    known = range(n_u, u.numel()) if measured else ()
    dt_s = ca.SX.sym("dt_s")
    end = integrate(model, x, u, p, dt_s)
    x_next = ca.cse(end.x)
    s = ca.vertcat(x, p)
    s_next = ca.vertcat(x_next, p)
    held = [model.inputs.index(name) for name in model.held_inputs]
    if measured and held:
        # An interval before the first sample has no length, and its input is unknown.
        s = ca.vertcat(x, u_last[held], p)
        s_next = ca.vertcat(x_next, ca.if_else(dt_s > 0, u[held], u_last[held]), p)
    J = _derivatives_by(s, u, s_next, end.jacobian, (x, p))
    s_next, A_0, D, B = _split_derivatives(model, s, u, s_next, J, len(known))
    limits = model.limits
    z = model.measurement(x, u_last, p)
    input_rows = model.input_outputs.values()
    rows = [row for row in range(z.numel()) if measured and row not in input_rows]
    inputs = [s, u, dt_s]
    return Interval(
        step=ca.Function("interval", inputs, [s_next], {"cse": True}),
        linearised=ca.Function("linearised", inputs, [s_next, D, B], {"cse": True}),
        A_0=A_0,
        n_s=s.numel(),
        n_v=u.numel(),
        outputs=tuple(
            _output(
                row, n_z, limits[row], z[row], s, model.outputs[row] in model.angles, u_last[n_u:]
            )
            for row in rows
        ),
        input_outputs={place: (row, limits[row]) for place, row in model.input_outputs.items()},
        mixing_outputs={
            place: [(row, limits[row]) for row in rows if ca.depends_on(z[row], u_last[place])]
            for place in range(n_u)
        },
        bounds=model.bounds,
        sigma_held={model.inputs.index(name): sigma for name, sigma in model.sigma_held.items()},
        motion_noise=model.motion_noise,
        known={place: n_z + place - n_u for place in known},
    )


def _derivatives_by(s, u, s_next, jacobian, x_and_p):
    """∂s⁺/∂(s, u); that of the states may be given, by (x, u, p)."""
    n_x, n_p = (part.numel() for part in x_and_p)
    n_u = u.numel()
    # In reverse mode, sums over the Runge-Kutta stages appear once for all derivatives.
    reverse = {"helper_options": {"ad_weight": 1}}
    if jacobian is None:
        return ca.jacobian(s_next, ca.vertcat(s, u), reverse)
    held = ca.SX(n_x, s.numel() - n_x - n_p)
    by_x, by_u, by_p = ca.horzsplit(jacobian, [0, n_x, n_x + n_u, n_x + n_u + n_p])
    others = ca.jacobian(s_next[n_x:], ca.vertcat(s, u), reverse)
    return ca.vertcat(ca.horzcat(by_x, held, by_p, by_u), others)


def _split_derivatives(model, s, u, s_next, J, n_known):
    """s⁺ and its derivatives ∂s⁺/∂s = A_0 + D and B = ∂s⁺/∂u, with A_0 constant.

    B has no entries in the last n_known columns.
    """
    A = ca.sparsify(J[:, : s.numel()])
    B = ca.horzcat(J[:, s.numel() : J.size2() - n_known], ca.SX(J.size1(), n_known))
    constants = [float(a) if a.is_constant() else 0 for a in A.nz[:].elements()]
    A_0 = ca.sparsify(ca.DM(A.sparsity(), constants))
    if model.motion_noise:
        # Inputs without an output of their own are noise, such as slip. The interval is linear in
        # them, about zero: a value that was fitted to the noise must not change A and B.
        n_u = len(model.inputs)
        is_noise = (place < n_u and place not in model.input_outputs for place in range(u.numel()))
        u_bar = u * ca.DM([float(not noise) for noise in is_noise])
        s_next, A, B = ca.substitute([s_next, A, B], [u], [u_bar])
        s_next += B @ (u - u_bar)
    s_next, D, B = sines_by_addition([s_next, ca.sparsify(A - A_0), B])
    return s_next, A_0, D, B


def _output(row, n_z, limit, z_row, s, is_angle, known):
    """The Output whose value is the expression z_row of the joint state s and what is known."""
    H = ca.jacobian(z_row, s)
    places = [place for place in range(known.numel()) if ca.depends_on(z_row, known[place])]
    inputs = [s, *(known[place] for place in places)]
    h = ca.Function("h", inputs, [z_row])
    slope = ca.Function("H", inputs, [ca.sparsify(H)])
    rows = tuple(n_z + place for place in places)
    return Output(row, limit, h, slope, not ca.depends_on(H, s), is_angle, rows)
