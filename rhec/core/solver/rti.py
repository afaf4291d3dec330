"""The real-time iteration scheme: one Gauss-Newton step a sample, prepared before its data arrive.

Each sample has four phases, each a separate Function in `rhe` and `rhc`:

- shift: the horizon and the previous solution move on by one sample (warm start);
- linearise: integrate, differentiate, condense;
- feedback: the new data (a measurement, or an estimate and references) complete the QP, whose
  solution is the result;
- expand: the remaining unknowns, for the next linearisation, and the KKT tolerance.

The paper's preparation consists of expand, shift and linearise. Only feedback lies between a
measurement and the command. Iterating linearise, feedback and expand without shift converges to the
solution of the nonlinear problem.
"""

from typing import Any

import numpy as np

from rhec.core import wiring
from rhec.core._casadi.build import with_packed_memory
from rhec.core._casadi.compiled import BufferedFunction
from rhec.core._casadi.validation import Steps, checked, shown

NO_SAMPLE = "no sample was used yet"
PHASES = ("shift", "linearise", "feedback", "expand")
IMPROVE = "improve"  # optional: one iteration without shift, whose step may be shortened


def run_phases(phases, values):
    """Run all phases {name: Function} of one sample; each adds its results to `values`, by name."""
    return wiring.evaluated([wiring.wired(phases[name]) for name in PHASES], values)


def outer_inputs(phases, memory):
    """{name: sparsity} of inputs that neither the memory nor an earlier one of the phases gives."""
    found = wiring.outside(map(wiring.wired, phases))
    return {
        place: function.sparsity_in(name)
        for place, (function, name) in found.items()
        if place not in memory
    }


def chained(name, phases, memory, results, symbols, first):
    """Phases, one after the other, as one Function (memory, …) -> (memory, results …).

    Args:
        name: Of the Function.
        phases: The phases, Functions; each adds its results to the values, by name.
        memory: {name: shape} of the pieces of the memory, which is packed in one vector.
        results: Names of what it returns besides.
        symbols: SX or MX.
        first: Names of the inputs that follow the memory; the others follow these.
    """
    inputs = outer_inputs(phases, memory)
    inputs = {key: inputs[key] for key in first} | inputs

    @with_packed_memory(name, memory, symbols, **inputs)
    def chain(**values):
        values = wiring.evaluated(map(wiring.wired, phases), values)
        return {key: values[key] for key in (*memory, *results)}

    return chain


def iterate(phases, values):
    """Run an iteration without shift: linearise, feedback, expand.

    Expand's memory is that of the next sample, so its results do not join the others.

    Args:
        phases: {name: Function}.
        values: {name: expression} of the inputs.

    Returns:
        `values` with the results of linearise and feedback, by name; and those of expand.
    """
    before = [wiring.wired(phases[name]) for name in PHASES[1:3]]
    values = wiring.evaluated(before, values)
    expand = wiring.wired(phases["expand"])
    after = wiring.evaluated([expand], values)
    return values, {name: after[name] for name in expand.writes}


class RealTimeIteration:
    """The four compiled phases on shared NumPy arrays, the engine of RHE and RHC objects.

    The phases exchange data by array name: the output "K" of one phase and the input "K" of the
    next are the same array. The memory exists twice (`wiring.in_two_memories`): `expand` writes it
    to `previous`, and `shift` reads it there and writes `current`, where `linearise` and `feedback`
    read it.

    `memory` names the pieces of the memory, and `unknowns` those that an iteration improves.
    `constants` are values of inputs that never change.
    """

    def __init__(self, functions, memory, unknowns, **constants):
        self.unknowns = unknowns
        functions = {name: functions[name] for name in (*PHASES, IMPROVE) if name in functions}
        self.phases = {name: BufferedFunction(each) for name, each in functions.items()}
        self.arrays = {}
        for phase, part in wiring.in_two_memories(functions, memory).items():
            call = self.phases[phase]
            for name, place in part.reads.items():
                call.read_from(name, self.arrays.setdefault(place, call.arguments[name]))
            for name, place in part.writes.items():
                call.write_to(name, self.arrays.setdefault(place, call.results[name]))
        self.previous, self.current = (
            {name: self.arrays.pop(f"{version}.{name}") for name in memory}
            for version in ("previous", "current")
        )
        # Looking the bound methods up in each sample would take longer.
        self._shift = self.phases["shift"].call
        self._linearise = self.phases["linearise"].call
        self._feedback = self.phases["feedback"].call
        self._expand = self.phases["expand"].call
        self._improve = self.phases[IMPROVE].call if IMPROVE in self.phases else None
        self.set(self.arrays, constants)
        self.restart()

    def restart(self):
        """Let the next sample be the first; until then there is no result."""
        for name in ("ok", "share_after"):
            if name in self.arrays:
                self.arrays[name][:] = 0
        self.started = self.prepared = self.expanded = self.converged = False

    @staticmethod
    def set(arrays, values):
        """Copy values into the arrays of the same names."""
        for name, value in values.items():
            arrays[name][:] = np.ravel(value, order="F")

    def start(self, memory):
        """Start from this memory, which needs no shift before the next sample."""
        self.set(self.current, memory)
        self._linearise()
        self.started = self.prepared = True

    def prepare(self):
        """Do all work that is possible before the next sample arrives; none before the first."""
        if self.started and not self.prepared:
            self.expand()
            self._shift()
            self._linearise()
            self.prepared = True

    def feedback(self):
        """Solve with the new data, which the caller has copied into `arrays`."""
        if not self.prepared:
            raise RuntimeError("prepare() must be called before each feedback()")
        self._feedback()
        # Expanding now would delay the command.
        self.prepared = self.expanded = self.converged = False

    def expand(self):
        """Compute the remaining unknowns, once a sample."""
        if not self.expanded:
            self._expand()
            self.expanded = True

    @checked
    def solve(self, iterations: Steps):
        """Iterate Gauss-Newton steps on one problem, without shifting.

        Each step is shortened by a line search, and the iteration ends where it has converged, if
        the functions have a phase for that.
        """
        self.converged = False
        if self._improve:
            self._improve_repeatedly(iterations)
        else:
            self._repeat(iterations)
        # The memory still belongs to this sample; `prepare` has to shift it.
        self.prepared = False
        self.expanded = True

    def improve_first(self, iterations):
        """Iterate on the first sample before its feedback, because there is no plan to improve."""
        if self._improve:
            self._improve_repeatedly(iterations)
            self._linearise()

    def _repeat(self, iterations):
        for _ in range(iterations):
            self._linearise()
            self._feedback()
            self._expand()
            self._take_unknowns()

    def _improve_repeatedly(self, iterations):
        self.arrays["penalty"][:] = 0
        for _ in range(iterations):
            self._improve()
            self._take_unknowns()
            self.arrays["penalty"][:] = self.arrays["penalty_after"]
            self.converged = self.arrays["converged"].item() == 1
            if self.arrays["done"].item() == 1:
                return

    def _take_unknowns(self):
        # Without a shift the next linearisation is at the same sample's new solution.
        for name in self.unknowns:
            self.current[name][:] = self.previous[name]


class OneCall:
    """One call a sample, for estimators and controllers with `prepare()` and `feedback(…)`."""

    def step(self, *sample: Any, **named: Any) -> Any:
        """One sample of a loop that prepares nothing: `prepare()`, then `feedback(…)`.

        Args:
            sample: Arguments of `feedback`.
            named: Arguments of `feedback` by name.

        Returns:
            What `feedback` returns.
        """
        self.prepare()
        return self.feedback(*sample, **named)


class RealTimeLoop(OneCall):
    """What RHE and RHC objects share; subclasses set `iteration` and `_inputs`, views by name."""

    iteration: RealTimeIteration
    _unsolved: str  # why a step has no solution, and what it leads to

    def prepare(self) -> None:
        """Do all work that is possible before the next sample (paper: preparation part)."""
        self.iteration.prepare()

    def _set_inputs(self, **values):
        """Copy the new data in; the first ones also start the iteration."""
        inputs = self._inputs
        for name, value in values.items():
            copy_checked(name, value, inputs[name])
        if not self.iteration.started:
            self._start()

    @property
    def ok(self) -> bool:
        """Whether the last step was solved, and the last `solve` ended near a solution.

        Where a step was not solved, its result is the shifted previous solution. A `solve` ended
        near a solution if another iteration would lower the cost by less than a tenth of it. That
        is relative to the cost, and `kkt` is not: where the cost is 100, a `kkt` of 7.7 is `ok`.
        """
        return self.iteration.arrays["ok"].item() == 1

    @property
    def status(self) -> str:
        """Why the last step was not `ok`, as a sentence; empty if it was."""
        if self.ok:
            return ""
        if not self.iteration.started:
            return NO_SAMPLE
        if np.isnan(self.kkt):
            return self._unsolved
        return "the iterations ended far from a solution; more of them would help"

    @property
    def converged(self) -> bool:
        """Whether the last `solve` ended at a solution; never after `feedback`, which is one step.

        The next step would then lower the cost by less than 1e-10 of it.
        """
        return self.ok and self.iteration.converged

    @property
    def kkt(self) -> float:
        """KKT tolerance of the linearisation point of the last feedback; NaN if unsolved."""
        self.iteration.expand()
        return self.iteration.arrays["kkt"].item()


def copy_checked(name, value, array):
    """Copy an argument into its array; refuse one of another shape, or one that is not numeric."""
    shape = getattr(value, "shape", None)
    if shape == (array.size, 1) and array.ndim == 1:  # a column, such as CasADi's DM
        value = np.asarray(value).ravel()
        shape = array.shape
    try:
        if shape is None and isinstance(value, tuple) and array.shape == (len(value),):
            for i, number in enumerate(value):  # faster than via an array for a few numbers
                array[i] = number
            return
        shape = np.shape(value) if shape is None else shape
        if shape == array.shape:
            array[...] = value
            return
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it should be made of numbers") from None
    turned = f"; {name}.T has that" if shape == array.shape[::-1] else ""
    raise ValueError(f"{name} had shape {shape}; it should have {array.shape}{turned}")
