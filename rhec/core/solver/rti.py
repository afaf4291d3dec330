"""The real-time iteration scheme: one Gauss-Newton step a sample, prepared before its data arrive.

Each sample has four phases, each a Function of its own in `rhe` and `rhc`:
    shift      the horizon moves on by one sample, the previous solution with it (warm start)
    linearise  integrate, differentiate, condense
    feedback   what is new (a measurement; an estimate and references) and the QP: the answer
    expand     the rest of the solution, for the next linearisation, and the KKT tolerance
The paper's preparation is expand, shift and linearise; only feedback lies between a measurement
and the command. Iterating linearise, feedback and expand without shift converges to the solution
of the nonlinear problem.
"""

import numpy as np

from rhec.core._casadi.compiled import BufferedFunction
from rhec.core._casadi.validation import Steps, checked, shown

__all__ = ["PHASES", "RealTimeIteration", "RealTimeLoop", "copy_checked"]

PHASES = ("shift", "linearise", "feedback", "expand")


class RealTimeIteration:
    """The four phases on shared NumPy arrays, compiled: what RHE and RHC objects are made of.

    Arrays of the same name are one array. The memory exists twice, because a Function must not
    write what it still reads: `expand` leaves it in `previous`, `shift` takes it from there to
    `current`, where `linearise` and `feedback` read it.

    Args:
        functions: The compiled phases, by name.
        memory: Names of the memory's pieces.
        unknowns: Those of them that an iteration improves.
        constants: Values of inputs that stay, by name.
    """

    def __init__(self, functions, memory, unknowns, **constants):
        self.unknowns = unknowns
        self.phases = {name: BufferedFunction(functions[name]) for name in PHASES}
        shifted = self.phases["shift"].arguments
        self.previous = {name: np.zeros(shifted[name].shape) for name in memory}
        self.current = {name: array.copy() for name, array in self.previous.items()}
        self.arrays = {}
        for phase, call in self.phases.items():
            last = self.previous
            now = self.current
            reads, writes = (last, now) if phase == "shift" else (now, last)
            for name, array in call.arguments.items():
                home = reads if name in memory else self.arrays
                call.read_from(name, home.setdefault(name, array))
            for name, array in call.results.items():
                home = writes if name in memory else self.arrays
                call.write_to(name, home.setdefault(name, array))
        calls = (phase.call for phase in self.phases.values())  # found once: finding takes longer
        self._shift, self._linearise, self._feedback, self._expand = calls
        self.set(self.arrays, constants)
        self.started = self.prepared = self.expanded = False

    @staticmethod
    def set(arrays, values):
        """Copy values into arrays of the same names."""
        for name, value in values.items():
            arrays[name][:] = np.ravel(value, order="F")

    def start(self, memory):
        """Begin at this memory, already in place for the sample that comes."""
        self.set(self.current, memory)
        self._linearise()
        self.started = self.prepared = True

    def prepare(self):
        """All that can be done before the next sample arrives; before the first, nothing."""
        if self.started and not self.prepared:
            self.expand()
            self._shift()
            self._linearise()
            self.prepared = True

    def feedback(self):
        """The answer to what is new."""
        if not self.prepared:
            raise RuntimeError("prepare() must be called before each feedback()")
        self._feedback()
        self.prepared = self.expanded = False

    def expand(self):
        """Once a sample: the rest of the solution."""
        if not self.expanded:
            self._expand()
            self.expanded = True

    @checked
    def solve(self, iterations: Steps):
        """Gauss-Newton to convergence: one problem, linearised again and again."""
        for _ in range(iterations):
            self._linearise()
            self._feedback()
            self._expand()
            for name in self.unknowns:
                self.current[name][:] = self.previous[name]
        self.prepared = False
        self.expanded = True


class RealTimeLoop:
    """What the objects for a loop of one's own share, whose `iteration` is a RealTimeIteration."""

    iteration: RealTimeIteration

    def prepare(self) -> None:
        """All that can be done before the next sample arrives (paper: preparation part)."""
        self.iteration.prepare()

    @property
    def ok(self) -> bool:
        """Whether the last step was solved; if not, its answer is the shifted previous solution."""
        return self.iteration.arrays["ok"].item() == 1

    @property
    def kkt(self) -> float:
        """KKT tolerance of the linearisation point of the last feedback."""
        self.iteration.expand()
        return self.iteration.arrays["kkt"].item()


def copy_checked(name, value, array):
    """Copy an argument into its array, or say in one sentence why it does not fit."""
    shape = getattr(value, "shape", None)
    try:
        if shape is None and isinstance(value, tuple) and array.shape == (len(value),):
            for i, number in enumerate(value):  # a few numbers: faster than an array of them
                array[i] = number
            return
        shape = np.shape(value) if shape is None else shape
        if shape == array.shape:
            array[...] = value
            return
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it should be made of numbers") from None
    raise ValueError(f"{name} had shape {shape}; it should have {array.shape}")
