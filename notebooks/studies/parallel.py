"""A function of many runs, or of many arguments, on all cores, in their order."""

from functools import partial

from rhec.simulation.campaigns.batch import Plan, compile_lanes, simulate_batch
from rhec.simulation.campaigns.workers import get_workers, is_worth_spreading, map_tasks


def map_runs(function, scenarios):
    """The function of the Run of each scenario, in their order.

    The function must be one that other processes can import.
    """
    if not scenarios:
        return []
    # Scenarios of one structure run together, in lanes, where that pays for compiling them.
    plan = Plan(dict(enumerate(scenarios)))
    large = is_worth_spreading(plan.samples)
    parallel_map(compile_lanes, plan.worth_lanes(), large)
    task = partial(_of_part, mean_samples=plan.mean_samples, function=function)
    results = parallel_map(task, plan.tasks(plan.samples_per_task), large)
    by_place = {place: result for part in results for place, result in part.items()}
    return [by_place[place] for place in range(len(scenarios))]


def _of_part(part, mean_samples, function):
    """{place: result} of {place: scenario}."""
    return dict(zip(part, simulate_batch(part.values(), function, mean_samples)))


def parallel_map(function, arguments, large=True):
    """The function of each argument, in order, on all cores where that pays.

    What a worker did not finish, because it was killed, is done here.

    Args:
        function: A function that other processes can import.
        arguments: Its arguments; one or two are left to this process.
        large: Whether they are work enough to start processes.
    """
    tasks = [(function, place, argument) for place, argument in enumerate(arguments)]
    workers = get_workers(None, large=large and len(tasks) > 2)
    if workers is None:
        answers = [(task, None) for task in tasks]
    else:
        answers = [*map_tasks(workers, _apply, tasks)]
    results = dict(answer or _apply(task) for task, answer in answers)
    return [results[place] for place in range(len(tasks))]


def _apply(task):
    """(place, result) of a task (function, place, argument)."""
    function, place, argument = task
    return place, function(argument)
