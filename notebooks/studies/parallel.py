"""A function of many runs, or of many arguments, on all cores, in their order."""

import itertools
from functools import partial

import numpy as np

from rhec.simulation.campaigns.batch import simulate_batch
from rhec.simulation.campaigns.campaign import campaign, run_all
from rhec.simulation.campaigns.workers import get_workers, map_tasks


def map_runs(function, scenarios):
    """The function of the Run of each scenario, in their order.

    The function must be one that other processes can import. Runs are spread, and done again where
    a worker is killed, as those of `rhec.campaign`.

    Raises:
        RuntimeError: If a run kills each worker.
    """
    results = {}
    for part in run_all(dict(enumerate(scenarios)), None, partial(_of_part, function)):
        results |= part
    if lethal := [place for place, result in results.items() if result is None]:
        raise RuntimeError(f"every worker that ran scenario {lethal[0]} died")
    return [results[place] for place in range(len(scenarios))]


def _of_part(function, part):
    """{place: result} of {place: scenario}."""
    return dict(zip(part, simulate_batch(part.values(), function)))


def drive(groups, folder=None, workers=None):
    """Drive {name: scenarios} as one campaign: {name: rows of `rhec.campaign`}.

    Args:
        groups: The scenarios of each name.
        folder, workers: As for `rhec.campaign`.
    """
    table = campaign([*itertools.chain(*groups.values())], folder, workers)
    ends = np.cumsum([len(scenarios) for scenarios in groups.values()])
    places = np.split(np.arange(len(table)), ends[:-1])
    return {name: table.iloc[at].reset_index(drop=True) for name, at in zip(groups, places)}


def true_errors(groups):
    """{name: mean true errors (n,) [m]} of {name: scenarios}, driven in this process; inf of one
    that is lost.
    """
    return {
        name: rows["mean_error_true_m"].fillna(np.inf).to_numpy()
        for name, rows in drive(groups, workers=1).items()
    }


def parallel_map(function, arguments):
    """The function of each argument, in order, on all cores.

    What a worker did not finish, because it was killed, is done here.

    Args:
        function: A function that other processes can import.
        arguments: Its arguments; one or two are left to this process.
    """
    tasks = [*enumerate(arguments)]
    workers = get_workers(None, large=len(tasks) > 2)
    apply = partial(_apply, function)
    answers = map_tasks(workers, apply, tasks)
    results = dict(answer or apply(task) for task, answer in answers)
    return [results[place] for place in range(len(tasks))]


def _apply(function, task):
    """(place, result) of a task (place, argument)."""
    place, argument = task
    return place, function(argument)
