"""`rhec.batch`: many runs of an estimator or controller, arrays (n, …) in and out.

Each run has its own memory, as if there were n objects. Its results are those of an object of its
own to the last bit, because both evaluate the same phases.
"""

import functools
import math
from typing import Annotated, Any, ClassVar, NamedTuple, overload

import numpy as np
from pydantic import Field

from rhec.core._casadi import cache, compiled
from rhec.core._casadi.packing import pack_array
from rhec.core._casadi.validation import Steps, Whole, checked, refuse, shown
from rhec.core.batch import functions
from rhec.core.batch.rows import evaluate_some, get_runs, set_runs, shared, to_lanes, zeros
from rhec.core.controller import rhc
from rhec.core.estimator import rhe
from rhec.core.estimator.base import variances_w
from rhec.core.estimator.ekf import EKF
from rhec.core.lanes import lanes
from rhec.core.model.limits import MAX_PLAUSIBLE_STATE
from rhec.core.solver.rti import IMPROVE

Runs = Annotated[Whole, Field(ge=1, le=10_000_000)]

_ONE_BY_ONE = (
    "no SIMD lanes, for want of a C++ compiler that can make them: a batch computes one run after "
    "the other, with the same results, some five times slower"
)


def _programs(build, structures):
    """The Programs of build(*structure) for each of these structures."""
    if not all(lanes.is_compiled(build, *structure) for structure in structures):
        compiled.announce(build)
    programs = lanes.programs(build, structures)
    if any(program.lanes == 1 for program in programs):
        cache.warn_once(_ONE_BY_ONE)
    return programs


class Estimates(NamedTuple):
    """Estimates of n runs: states x, inputs u of the last interval, parameters p.

    `covariance` (n, n_x + n_p, n_x + n_p) is that of each run's (x, p).
    """

    x: Any
    u: Any
    p: Any
    covariance: Any

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {np.shape(part)}" for name, part in self._asdict().items())
        return f"Estimates of {len(self.x)} runs: {shapes}"


class _Batch:
    """What the batches of RHC, RHE and EKF share.

    Attributes:
        n: Number of runs.
    """

    results: ClassVar[tuple[str, ...]]
    first_iterations: ClassVar[int] = 0  # before the feedback of a run's first sample

    def __init__(self, n, iteration, shift, constants, inputs):
        """Set up the memory.

        Args:
            n: Number of runs.
            iteration: Program that takes in a sample.
            shift: Program that moves the memory on by one sample, or None.
            constants: {name: array} of inputs that all runs share and that never change.
            inputs: {name: shape of one run} of the other inputs.
        """
        self.n = n
        self._iteration = iteration
        self._shift = shift
        self._shapes = inputs
        self._width = iteration.lanes
        sizes = iteration.sizes | (shift.sizes if shift else {})
        self._arguments = {
            name: shared(np.ravel(constants[name], order="F"), self._width)
            for name in sizes
            if name in constants and name not in inputs
        }
        self._memory = zeros(n, sizes["memory"], self._width)
        self._spare = zeros(n, sizes["memory"], self._width)
        self._results = self._zeros_of(iteration, self.results)
        self._is_new = np.ones(n, dtype=bool)  # whether a run's next sample is its first
        self._is_prepared = False

    def _zeros_of(self, program, names):
        """Return arrays for these results of a Program, by name."""
        lengths = {name: math.prod(program.shapes[name]) for name in names}
        return {name: zeros(self.n, lengths[name], self._width) for name in names}

    def __repr__(self) -> str:
        how = f"{self._width} at a time" if self._width > 1 else "one after the other"
        return f"{type(self).__name__}: {self.n} runs, {how}"

    def restart(self, runs: Any = slice(None)) -> None:
        """Let some runs begin anew: their next sample is their first.

        Args:
            runs: Numbers of the runs, or a mask (n,); by default all.

        Raises:
            ValueError: If there is no such run.
        """
        try:
            self._is_new[runs] = True
        except IndexError:
            expected = f"it should be numbers from 0 to {self.n - 1}, or a mask ({self.n},)"
            raise ValueError(f"runs was {shown(runs)}; {expected}") from None

    def prepare(self) -> None:
        """Do what is possible before the next sample; `feedback` does it if nobody has."""
        if self._shift and not self._is_prepared and not self._is_new.all():
            arguments = self._arguments | dict(memory=self._memory)
            self._shift.evaluate(len(self._memory), arguments, dict(memory=self._spare))
            self._memory, self._spare = self._spare, self._memory
        self._is_prepared = True

    def _run(self, values, iterations=None):
        """Take in one sample: {name: array (n, …), or (…) that is the same for all}.

        Do one full step, or iterations with a line search.
        """
        for name, value in values.items():
            rows = _checked_input(name, value, self.n, self._shapes[name])
            is_shared = len(rows) < self.n
            width = self._width
            self._arguments[name] = shared(rows[0], width) if is_shared else to_lanes(rows, width)
        self.prepare()
        new = np.flatnonzero(self._is_new)
        if len(new):
            set_runs(self._memory, new, self._first_memory(new))
        self._set_applied()
        self._is_new[:] = False
        self._is_prepared = False
        if iterations is not None:
            self._memory, self._spare = self._improve(np.arange(self.n), iterations)
            return
        if len(new) and self.first_iterations:
            self._improve(new, self.first_iterations)
        arguments = self._arguments | dict(memory=self._memory)
        results = self._results | dict(memory=self._spare)
        self._iteration.evaluate(len(self._memory), arguments, results)
        self._memory, self._spare = self._spare, self._memory

    def _improve(self, runs, iterations):
        """Iterate with a line search, each of these runs until it has converged.

        The memory gets the new unknowns.

        Returns:
            (expanded, memory): the memory that the next sample shifts, and that of this sample.
        """
        raise NotImplementedError

    def _set_applied(self):
        """Put into the memory what the caller says was applied before this sample: here nothing."""

    def _get(self, name, *shape):
        """Return a copy of a result, (n, *shape)."""
        return get_runs(self._results[name], np.arange(self.n)).reshape(self.n, *shape)

    def _first_memory(self, runs):
        """Return the memory (runs, length), or (length,), of runs that begin."""
        raise NotImplementedError


def _checked_input(name, value, n, shape):
    """Return an input as (n, length) or (1, length), each run's matrix column by column."""
    try:
        array = np.asarray(value)
        # Of what is no number, complex numbers and dates, too, could be cast.
        casting = "unsafe" if array.dtype == object else "same_kind"
        array = array.astype(float, casting=casting, copy=False)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it should be made of numbers") from None
    if array.shape == shape:
        array = array[None]
    elif array.shape != (n, *shape):
        expected = f"it should have {(n, *shape)}, or {shape} if it is the same for all runs"
        raise ValueError(f"{name} had shape {array.shape}; {expected}")
    return np.swapaxes(array, 1, -1).reshape(len(array), -1)


class _IteratedBatch(_Batch):
    """A batch of the real-time iteration."""

    def __init__(self, n, build, problem, source, inputs):
        parts = [(problem, part) for part in ("iteration", "shift", IMPROVE)]
        iteration, shift, self._improvement = _programs(build, parts)
        super().__init__(n, iteration, shift, source.iteration.arrays, inputs)
        names = ("converged", "done", "penalty_after")
        self._improved = self._zeros_of(self._improvement, names)

    def _improve(self, runs, iterations):
        penalty = self._improved["penalty_after"]
        penalty[:] = 0
        arguments = self._arguments | dict(memory=self._memory, penalty=penalty)
        results = self._results | self._improved
        results |= dict(memory=self._spare, current=self._memory)
        set_runs(self._spare, runs, get_runs(self._memory, runs))
        for _ in range(iterations):
            evaluate_some(self._improvement, runs, arguments, results)
            runs = runs[get_runs(self._improved["done"], runs)[:, 0] != 1]
            if not len(runs):
                break
        return self._spare, self._memory

    @property
    def ok(self) -> np.ndarray:
        """Whether the last step of each run (n,) was solved, as of a single object."""
        return self._get("ok") == 1

    @property
    def kkt(self) -> np.ndarray:
        """KKT tolerances (n,) of the linearisation points of the last step."""
        return self._get("kkt")


class RHCBatch(_IteratedBatch):
    """Model predictive control of n runs, as by n objects RHC; `rhec.batch` makes it.

    Attributes:
        n: Number of runs.
    """

    results = functions.CONTROLLER_RESULTS
    first_iterations = rhc.FIRST_ITERATIONS

    def __init__(self, source: rhc.RHC, n: int):
        problem = self._problem = source.problem
        self._structure = source.structure
        inputs = dict(s_0=(problem.n_s,), x_ref=(problem.n_x, problem.N + 1))
        inputs |= dict(u_ref=(problem.n_u, problem.N))
        self._first_values = functools.partial(rhc.init, source.structure, settings=source.settings)
        if source.structure is not problem:
            inputs |= dict(y_ref=source.structure.references["y_ref"])
        super().__init__(n, functions.build_controller, source.structure, source, inputs)
        if "y_ref" in inputs:
            self._arguments["y_ref"] = shared(np.zeros(np.prod(inputs["y_ref"])), self._width)

    def feedback(
        self, x: Any, p: Any, x_ref: Any, u_ref: Any, y_ref: Any = None, u_before: Any = None
    ) -> np.ndarray:
        """Inputs to apply now, by one Gauss-Newton step, eq. (13).

        An argument that is the same for all runs may have the shape of one.

        Args:
            x: (n, n_x) estimated states.
            p: (n, n_p) estimated parameters.
            x_ref: (n, n_x, N+1) desired states; node 0 is now and has no weight.
            u_ref: (n, n_u, N) desired inputs.
            y_ref: (n, n_y, N+1) desired outputs; None: the last ones, at first 0.
            u_before: (n, n_u) inputs that were applied in the interval before, from which changes
                are counted; None, or an entry that is not finite: those of the last sample.

        Returns:
            (n, n_u) inputs of the first interval.

        Raises:
            ValueError: If an argument is invalid.
        """
        self._run(self._problems(x, p, x_ref, u_ref, y_ref, u_before))
        return self.u_plan[:, :, 0]

    @checked
    def solve(
        self,
        x: Any,
        p: Any,
        x_ref: Any,
        u_ref: Any,
        iterations: Steps = 20,
        y_ref: Any = None,
        u_before: Any = None,
    ) -> Any:
        """Iterate to convergence on the nonlinear problems.

        Args:
            x: (n, n_x) estimated states, and the next three as in `feedback`.
            p: (n, n_p) estimated parameters.
            x_ref: (n, n_x, N+1) desired states.
            u_ref: (n, n_u, N) desired inputs.
            iterations: Gauss-Newton steps, at most; a run ends once it has converged.
            y_ref: (n, n_y, N+1) desired outputs; None: the last ones, at first 0.
            u_before: Inputs of the interval before, as in `feedback`.

        Returns:
            (n, n_u) inputs of the first interval.

        Raises:
            ValueError: If an argument is invalid.
        """
        self._run(self._problems(x, p, x_ref, u_ref, y_ref, u_before), iterations)
        return self.u_plan[:, :, 0]

    @property
    def u_plan(self) -> np.ndarray:
        """Planned inputs (n, n_u, N)."""
        return self._get("u_plan", self._problem.N, self._problem.n_u).swapaxes(1, 2)

    def _problems(self, x, p, x_ref, u_ref, y_ref, u_before):
        """Return the inputs of a sample, by name, and keep the commands before it."""
        self._before = None
        if u_before is not None:
            rhc.refuse_before(self._structure, u_before)
            u = _checked_input("u_before", u_before, self.n, (self._problem.n_u,))
            self._before = u[:, list(self._problem.command)]
        given = dict(s_0=self._joined(x, p), x_ref=x_ref, u_ref=u_ref)
        if y_ref is None:
            return given
        if "y_ref" not in self._shapes:
            refuse("y_ref was", y_ref, "it should be None, since there are no outputs")
        return given | dict(y_ref=y_ref)

    def _set_applied(self):
        """Put the commands before this sample into the memory of each run, where they are known."""
        if self._before is None:
            return
        names = [*self._structure.memory]
        lengths = [math.prod(shape) for shape in self._structure.memory.values()]
        first = sum(lengths[: names.index("before")])
        place = slice(first, first + self._before.shape[1])
        before = self._memory[:, place]  # a view
        runs = np.arange(self.n)
        is_number = np.abs(self._before) <= MAX_PLAUSIBLE_STATE
        set_runs(before, runs, np.where(is_number, self._before, get_runs(before, runs)))

    def _joined(self, x, p):
        """Return the joint states (n, n_s)."""
        n_x = self._problem.n_x
        given = (("x", x, n_x), ("p", p, self._problem.n_s - n_x))
        parts = [_checked_input(name, value, self.n, (size,)) for name, value, size in given]
        return np.hstack([np.broadcast_to(part, (self.n, part.shape[1])) for part in parts])

    def _first_memory(self, runs):
        n_x = self._problem.n_x
        joint = get_runs(self._arguments["s_0"], runs)
        return np.array([pack_array(self._first_values(s[:n_x], s[n_x:])) for s in joint])


class _EstimatorBatch(_Batch):
    """A batch of estimators of a Model."""

    def _estimates(self):
        """Return the Estimates of the last step."""
        model = self._model
        n_x = len(model.states)
        n_s = model.n_s
        n_p = len(model.parameters)
        values = self._get("estimate", len(model.names))
        covariance = self._get("covariance", n_s, n_s)
        if model.held_inputs:
            places = [*range(n_x), *range(n_s - n_p, n_s)]
            covariance = covariance[:, places][:, :, places]
        x, u, p = np.split(values, [n_x, len(model.names) - n_p], axis=1)
        return Estimates(x, u, p, covariance)

    def _first_memory(self, runs):
        return self._first


class RHEBatch(_IteratedBatch, _EstimatorBatch):
    """Moving horizon estimation of n runs, as by n objects RHE; `rhec.batch` makes it.

    Attributes:
        n: Number of runs.
    """

    results = functions.ESTIMATOR_RESULTS

    def __init__(self, source: rhe.RHE, n: int):
        self._model = source.model
        self._first = pack_array(rhe.init(source.window, *source._guess) | dict(age=0.0))
        inputs = dict(z_N=(len(source.model.outputs),))
        self._W = source.settings["W"]
        self._is_noisy = source.window.noisy
        if self._is_noisy:
            inputs |= dict(W=self._W.shape)
        super().__init__(n, functions.build_estimator, source.window, source, inputs)

    def feedback(self, z: Any, sigma_w: Any = None) -> Estimates:
        """Estimate from the newest measurements, as single objects do.

        Args:
            z: (n, n_z) measurements; an entry that is not finite counts as missing.
            sigma_w: (n, n_x + n_p) standard deviations of the process noise since the last sample,
                of an estimator with `noise_in_window`; None: those that it was made with.

        Returns:
            Estimates: x (n, n_x), u (n, n_u), p (n, n_p), covariances of (x, p).

        Raises:
            ValueError: If an argument is invalid.
        """
        self._run(self._sample(z, sigma_w))
        return self._estimates()

    def _sample(self, z, sigma_w):
        """Return the inputs of a sample, by name."""
        if not self._is_noisy:
            if sigma_w is not None:
                rhe.refuse_noise(sigma_w)
            return dict(z_N=z)
        if sigma_w is None:
            return dict(z_N=z, W=self._W)
        length = len(self._model.states) + len(self._model.parameters)
        _checked_input("sigma_w", sigma_w, self.n, (length,))
        return dict(z_N=z, W=variances_w(self._model, sigma_w))

    @checked
    def solve(self, z: Any, iterations: Steps = 20, sigma_w: Any = None) -> Any:
        """Iterate to convergence on the nonlinear problems.

        Args:
            z: (n, n_z) measurements, as in `feedback`.
            iterations: Gauss-Newton steps, at most; a run ends once it has converged.
            sigma_w: Standard deviations of the process noise, as in `feedback`.

        Returns:
            Estimates, as `feedback`.

        Raises:
            ValueError: If an argument is invalid.
        """
        self._run(self._sample(z, sigma_w), iterations)
        return self._estimates()


class EKFBatch(_EstimatorBatch):
    """Extended Kalman filters of n runs, as by n objects EKF; `rhec.batch` makes it.

    Attributes:
        n: Number of runs.
    """

    results = functions.FILTER_RESULTS

    def __init__(self, source: EKF, n: int):
        self._model = source.model
        self._first = source.first_memory
        inputs = dict(z_N=(len(source.model.outputs),))
        (program,) = _programs(functions.build_filter, [(source.model, source.dt_s)])
        super().__init__(n, program, None, source.settings, inputs)

    def feedback(self, z: Any) -> Estimates:
        """Estimate from the newest measurements, as single objects do.

        Args:
            z: (n, n_z) measurements; an entry that is not finite counts as missing.

        Returns:
            Estimates: x (n, n_x), u (n, n_u), p (n, n_p), covariances of (x, p).

        Raises:
            ValueError: If z has another shape.
        """
        self._run(dict(z_N=z))
        return self._estimates()


_BATCHES = {rhc.RHC: RHCBatch, rhe.RHE: RHEBatch, EKF: EKFBatch}


@overload
def batch(source: rhc.RHC, n: int) -> RHCBatch: ...


@overload
def batch(source: rhe.RHE, n: int) -> RHEBatch: ...


@overload
def batch(source: EKF, n: int) -> EKFBatch: ...


@checked
def batch(source: Any, n: Runs) -> Any:
    """Make n runs of an estimator or controller of any Model, computed several at a time.

    The batch has the methods of a single object, with arrays (n, …) for arguments and results. Each
    run begins as a new object does, and has the results of an object of its own to the last bit:
    what one run is given, such as measurements that are not finite, does not affect the others.
    `restart(runs)` lets runs begin anew.

    The processor computes as many runs at a time as its registers hold numbers, eight with AVX-512,
    four with AVX. That takes a C++ compiler. Without one the runs are computed one after the other.

    Args:
        source: A rhec.RHC, rhec.RHE or rhec.EKF with a model. The batch has its settings; its
            memory is not used and does not change.
        n: Number of runs.

    Returns:
        RHCBatch, RHEBatch or EKFBatch.

    Raises:
        ValueError: If an argument is invalid.
    """
    batch_class = _BATCHES.get(type(source))
    if batch_class is None:
        expected = "it should be a rhec.RHC, rhec.RHE or rhec.EKF with a model"
        paper = isinstance(source, rhc.RHC | rhe.RHE)
        refuse("source was", source, expected + ("; for the paper's, use rhec.campaign" * paper))
    return batch_class(source, n)
