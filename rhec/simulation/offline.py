"""A scenario's estimator on the recorded measurements of Runs."""

import functools

import numpy as np

from rhec.core import runner
from rhec.core._casadi import early
from rhec.core._casadi.packing import pack_array
from rhec.core.lanes import lanes
from rhec.simulation.closed_loop import first_guess
from rhec.simulation.columns import TRUTH, measured_of
from rhec.tracked_robot.estimators import Choice, build_step, estimator_of, states_of
from rhec.tracked_robot.kinematics import QUANTITIES

SETTLED_S = 20.0  # by then the exact first guess no longer matters
# What a log has of what an estimator may be told, sample by sample.
_TOLD = dict(traction=["mu", "kappa"], yaw_drift=["yaw_drift_radpm"], truth=TRUTH)


@functools.lru_cache
def _build(outputs, choice):
    """An estimator's step over measurements, and what it is told."""
    step = build_step(choice)
    missing = [name for name in outputs if name not in step.name_out()]
    if missing:
        returned = f"it returns {', '.join(step.name_out())}"
        raise ValueError(f"the estimator {step.name()!r} returns no {missing[0]!r}; {returned}")
    streamed = [name for name in estimator_of(choice.estimator).told if name in _TOLD]
    return runner.build_recorded(step, outputs, streamed)


def columns(run, names):
    """Columns of a run's log, (n, names); pandas takes longer than the estimators that use them.

    Raises:
        ValueError: If the run has no such column.
    """
    for name in names:
        if name not in run.columns:
            its = f"its sensors were {run.scenario.sensors!r}"
            raise ValueError(f"the run has no column {name!r}; {its}")
    return np.array([run.columns[name] for name in names]).T


def run_estimator_on_all(scenario, runs, *outputs):
    """Outputs of the scenario's estimator on the measurements of Runs: a list of {name: array}.

    The estimator has the first guess of the run. It runs in lanes where there are any.
    """
    structure = outputs, Choice.of(scenario)
    step = _build(*structure)["step"]
    memories, streams, settings = zip(*(_arguments(step, scenario, run) for run in runs))
    (program,) = lanes.programs(_build, [structure])
    rows = runner.run(program, memories, streams, settings)
    return [runner.by_name(step, of_run) for of_run in rows]


def deviances(scenario, noises, runs):
    """-2 log likelihood of each Run's measurements under each noise of the scenario's estimator.

    Args:
        scenario: The Scenario, whose own noise does not count.
        noises: `tuning.Noise` records.
        runs: Runs.

    Returns:
        (noises, runs).
    """
    structure = ("deviance",), Choice.of(scenario)
    step = _build(*structure)["step"]
    memories, streams, settings = zip(*(_arguments(step, scenario, run) for run in runs))
    variances = [dict(V=np.square(of.sigma_v), W=np.square(of.sigma_w)) for of in noises]
    n = len(noises)
    (program,) = lanes.programs(_build, [structure])
    of_both = [of_run | of_noise for of_noise in variances for of_run in settings]
    rows = runner.run(program, memories * n, streams * n, of_both)
    return np.reshape([of.sum() for of in rows], (n, len(runs)))


def run_estimator(scenario, run, *outputs):
    """Outputs of the scenario's estimator on the measurements of a run, as {name: array}."""
    functions = early.load(_build, outputs, Choice.of(scenario))
    return runner.record(functions, *_arguments(functions["step"], scenario, run))


def _arguments(step, scenario, run):
    """The estimator's first memory, the stream (n, columns) of its inputs, and its settings."""
    choice = Choice.of(scenario)
    estimator = estimator_of(choice.estimator)
    guess = first_guess(run.scenario, run.path)
    memory = pack_array(estimator.init(choice, dict(zip(QUANTITIES, guess))))
    told = [column for name in estimator.told for column in _TOLD.get(name, ())]
    settings = estimator.settings(scenario) | dict(mean_traction=run.terrain.mean)
    return memory, columns(run, [*measured_of(scenario.sensors), *told]), settings


def sigma_of_traction(run):
    """The standard deviations of a run's traction estimates, which are not in its log.

    The estimator runs again, and is compiled if necessary.

    Returns:
        {"mu", "kappa": standard deviations (n,)}, as far as they are among its states.
    """
    states = states_of(run.scenario)
    places = {name: states.index(name) for name in ("mu", "kappa") if name in states}
    if not places:
        return {}
    recorded = run_estimator(run.scenario, run, "estimate", "covariance")
    variances = np.diagonal(recorded["covariance"], axis1=1, axis2=2)
    return {name: np.sqrt(variances[:, place]) for name, place in places.items()}
