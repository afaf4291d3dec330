"""An estimator of one's own in the place of the paper's, for `Scenario.estimator`."""

import functools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi.validation import refuse
from rhec.core.own_step import MEMORY, OwnStep, check_sizes, inputs_of, results_of
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimator_record import TOLD, EstimatorRecord
from rhec.tracked_robot.kinematics import OUTPUTS, QUANTITIES, YAW_DRIFT
from rhec.tracked_robot.paper_rhe import SIGMA_START
from rhec.tracked_robot.sensors import SENSORS, in_order, sigma_of_sensors

_ONE = (1, 1)
_INPUTS = MEMORY, "z_N"
_RESULTS = MEMORY, "estimate"
_FIRST = ("guess", "sigma")
_KNOWN_FIRST = (*QUANTITIES, YAW_DRIFT)


@dataclass(frozen=True, eq=False, repr=False)
class Estimator(OwnStep):
    """An estimator of one's own: one sample as a CasADi Function, and its first memory.

    The first two inputs of `step` are its memory and the measurement z = (x, y, ν, ω), with those
    of its `sensors` behind; its first two results are the next memory and the estimate
    (x, y, θ, ν, μ, κ), whatever they are called. What it may have besides goes by name. It may take

    - `V` (as long as z): the variances of the measurement noise, from the Scenario's `sigma_v` and
      the noise that it assumes of sensors, such as `sigma_gyro`,
    - `W` (n): the variances of its process noise, from the Scenario's `sigma_w` or `process_noise`,
    - `mean_traction` (2): the field's mean (μ, κ), which no recorded log has,
    - `traction` (2), `yaw_drift` (1) and `truth` (6): the true (μ, κ), yaw drift [rad/m] and
      (x, y, θ, ν, μ, κ), which no recorded log and no robot has,

    and it may return

    - `covariance` (n, n): of its states, which a controller may take,
    - `yaw_drift`: an estimated yaw drift [rad/m], which the loop cancels,
    - `accepted` (4): whether it used each entry of z (by default, each valid one),
    - `ok`: whether it solved its problem (by default 1), and `kkt`, how well (by default NaN),
    - `deviance`, of the innovation, and `restart`, whether it began anew, for the log.

    Args:
        step: The Function.
        memory: The first memory, numbers, behind the first guess of the estimate, with which it
            begins; numbers that are left out are 0.
        first: Instead of `memory`, a CasADi Function from the first `guess` (6), and from its
            standard deviations `sigma` (6), or (7) with that of the yaw drift, if it takes them, to
            the first memory.
        states: Names of what the covariance covers, in its order.
        noises: {process_noise: (sigma_w, sigma_v)}: W, and V where `sigma_v` is None, by the rules
            of `Scenario.process_noise`. None: `sigma_w` has to be given.
        sensors: Names of the sensors that it reads, those of `Scenario.sensors`. In whatever order
            they are given, z has them in the order of `help(rhec.Scenario)`.
        label: What figures and tables call it; None: by the name of its Function.
        colour: Its colour in figures, such as "#009E73"; None: one that follows from the label.

    Raises:
        ValueError: If names or lengths do not fit; one sentence.
    """

    first: ca.Function | None = None
    states: Sequence[str] = ()
    noises: Mapping[str, tuple] | None = None
    sensors: Sequence[str] = ()
    label: str | None = None
    colour: str | None = None

    _carried: ClassVar[tuple] = (
        "first",
        "_first_key",
        "states",
        "noises",
        "sensors",
        "label",
        "colour",
    )
    signals: ClassVar[dict] = dict(z_N=None, V=None, W=None) | TOLD
    results: ClassVar[dict] = dict(estimate=(6, 1), covariance=None, accepted=(4, 1), ok=_ONE)
    results |= dict(kkt=_ONE, deviance=_ONE, restart=_ONE, yaw_drift=_ONE)

    def __post_init__(self):
        if isinstance(self.step, ca.Function):
            object.__setattr__(self, "step", _named(self.step))
        super().__post_init__()
        self._check_sensors()
        self._check_look()
        size = self.step.size_in(MEMORY)
        check_sizes("input", {MEMORY: size}, {MEMORY: (size[0], 1)})
        check_sizes("result", results_of(self.step), {MEMORY: size})
        self._check_first(size)
        n, _ = results_of(self.step).get("covariance", (0, 0))
        states = tuple(self.states) or tuple(f"state {k}" for k in range(n))
        if len(states) != n:
            refuse("states was", states, f"it should have {n} names, as the covariance has rows")
        object.__setattr__(self, "states", states)
        n_w = self._n_sigma_w
        noises = {
            rule: tuning.Noise(sigma_w, sigma_v or paper.SIGMA_V)
            for rule, (sigma_w, sigma_v) in (self.noises or {}).items()
        }
        for rule, noise in noises.items():
            if len(noise.sigma_w) != n_w:
                refuse(f"sigma_w of {rule!r} was", noise.sigma_w, f"it should have {n_w} entries")
        object.__setattr__(self, "noises", noises)

    def _check_sensors(self):
        sensors = tuple(self.sensors)
        if not {*sensors} <= {*SENSORS} or len({*sensors}) < len(sensors):
            refuse("sensors was", self.sensors, f"it should name some of {(*SENSORS,)}, each once")
        object.__setattr__(self, "sensors", in_order(sensors))
        n_z = len(OUTPUTS) + len(sensors)
        check_sizes("input", inputs_of(self.step), dict(z_N=(n_z, 1), V=(n_z, 1)))

    def _check_look(self):
        object.__setattr__(self, "label", self.label or self.step.name())
        if not isinstance(self.label, str):
            refuse("label was", self.label, "it should be text, or None")
        if self.colour is not None and not re.fullmatch("#[0-9a-fA-F]{6}", str(self.colour)):
            refuse("colour was", self.colour, "it should be text such as '#009E73', or None")

    def _check_first(self, size):
        room = max(0, size[0] - len(QUANTITIES))
        if len(self.memory) > room:
            raise ValueError(
                f"memory had {len(self.memory)} numbers; behind the first guess the memory of step "
                f"has room for {room}"
            )
        if self.first is None:
            return
        if not isinstance(self.first, ca.Function) or not {*self.first.name_in()} <= {*_FIRST}:
            refuse("first was", self.first, f"it should be a CasADi Function of {_FIRST}, or None")
        if self.memory or self.first.size_out(0) != size:
            expected = f"it should return a memory of {size}, and memory should be ()"
            raise ValueError(f"first returned {self.first.size_out(0)}; {expected}")

    @property
    def identity(self) -> tuple[object, ...]:
        """All that tells it from others; label and colour change no run."""
        noises = tuple(self.noises.items())
        return self.key, self.memory, self._first_key, self.states, noises, self.sensors

    @functools.cached_property
    def _first_key(self):
        return self.first.serialize() if self.first else None

    @property
    def _n_sigma_w(self):
        return self.step.size1_in("W") if "W" in self.step.name_in() else 0

    @functools.cached_property
    def row(self):
        """What a loop must know of it."""
        taken = inputs_of(self.step)
        return EstimatorRecord(
            build_step=lambda choice: self.step,
            init=self._init,
            settings=self._settings,
            states=lambda choice: self.states,
            n_sigma_w=lambda choice: self._n_sigma_w,
            told=tuple(name for name in TOLD if name in taken),
            sensors=self.sensors,
            has_yaw_drift=lambda choice: "yaw_drift" in self.step.name_out(),
        )

    def _settings(self, scenario):
        V = np.square((*tuning.sigma_v_of(scenario), *sigma_of_sensors(scenario)))
        if not self._n_sigma_w:
            return dict(V=V)
        return tuning.variances_of(self, scenario) | dict(V=V)

    def _init(self, choice, guess, sigma=SIGMA_START):
        if self.first:
            given = dict(guess=guess, sigma=SIGMA_START | dict(sigma))
            arguments = [
                [given[name][quantity] for quantity in _KNOWN_FIRST[: self.first.size1_in(name)]]
                for name in self.first.name_in()
            ]
            return {MEMORY: self.first(*arguments).full().ravel(order="F")}
        length = self.step.numel_in(MEMORY)
        begin = [*guess.values()][: len(QUANTITIES)]
        return {MEMORY: np.concatenate([begin, self.memory, np.zeros(length)])[:length]}


def _named(step):
    """A step whose first two inputs and results have the names of the robot's estimators."""
    if step.n_in() < 2 or step.n_out() < 2:
        raise ValueError(
            f"step had {step.n_in()} inputs and {step.n_out()} results; it should have a memory "
            "and a measurement, and the next memory and an estimate"
        )
    inputs = step.mx_in()
    names = [*_INPUTS, *step.name_in()[2:]], [*_RESULTS, *step.name_out()[2:]]
    options = {"allow_duplicate_io_names": True}
    return ca.Function(step.name(), inputs, step.call(inputs), *names, options)
