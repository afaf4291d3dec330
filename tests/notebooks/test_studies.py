"""What studies share: estimators that a replay of a log compares, and runs on many workers."""

from concurrent.futures import BrokenExecutor, Executor, Future

import pytest

import rhec
from notebooks.further import recorded_logs
from notebooks.studies.parallel import map_runs
from rhec.simulation.campaigns import campaign, workers


def test_the_papers_estimators_have_the_noise_that_was_asked_for():
    printed = recorded_logs.estimators("printed", {})
    assert {each["process_noise"] for name, each in printed.items() if name != "RHE"} == {"printed"}
    predicting = recorded_logs.estimators("soft_soil", {})
    noises = {each["process_noise"] for name, each in predicting.items() if name != "RHE"}
    assert noises == {"soft_soil"}
    for arguments in predicting.values():
        rhec.Scenario(**arguments)


class Deadly(Executor):
    """Workers in this process; who gets the scenario at place 1 dies."""

    def submit(self, function, task):
        future = Future()
        if isinstance(task, dict) and 1 in task:
            future.set_exception(BrokenExecutor())
        else:
            future.set_result(function(task))
        return future


def test_a_scenario_that_kills_its_workers_is_named(monkeypatch):
    deadly = workers.get_workers(Deadly(), large=True)
    monkeypatch.setattr(campaign, "get_workers", lambda count, large: deadly)
    scenarios = [rhec.Scenario(duration_s=2.0, seed=seed) for seed in range(3)]
    with pytest.raises(RuntimeError, match="every worker that ran scenario 1 died"):
        map_runs(_error, scenarios)
    assert map_runs(_error, scenarios[:1]) == [_error(rhec.simulate(scenarios[0]))]


def _error(run):
    return run.metrics["mean_error_m"]
