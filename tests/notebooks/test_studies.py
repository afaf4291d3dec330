"""Studies that carry the cells of the notebooks: replays of a log, and faults."""

import pytest

import rhec
from notebooks.further import faults, recorded_logs
from notebooks.further.recorded import scores
from rhec.style import ROOT

LOG = ROOT / "data/example_log.csv"
FLAT = dict(noise_m=0.02, yaw_error_rad=0.3)


@pytest.fixture(scope="module")
def log():
    log = rhec.logs.read(LOG)
    return log[: len(log) // 4]


def test_a_study_scores_five_estimators(log):
    estimators = recorded_logs.estimators("printed", dict(trust_log=True))
    assert estimators["RHE"] == dict(trust_log=True)
    assert all(each["trust_log"] for each in estimators.values())
    trials = recorded_logs.trials(log, range(2), estimators, **FLAT)
    table = recorded_logs.replay_table(trials)
    assert list(table["estimator"].unique()) == [*estimators] and len(estimators) == 5
    assert (table["n"] == 2).all()


def test_the_papers_estimators_have_the_noise_that_was_asked_for():
    printed = recorded_logs.estimators("printed", {})
    assert {each["process_noise"] for name, each in printed.items() if name != "RHE"} == {"printed"}
    likeliest = recorded_logs.estimators("likelihood", {})
    noises = {each["process_noise"] for name, each in likeliest.items() if name != "RHE"}
    assert noises == {"soft_soil"}
    for arguments in likeliest.values():
        rhec.Scenario(**arguments)


def test_faults_of_a_log_are_scored(log):
    samples = scores.perturbed_replay(log, 0, **FLAT)
    cases = recorded_logs.fault_cases(samples)
    few = {name: cases[name] for name in ("none", "outliers")}
    rows = recorded_logs.fault_scores(log, few, 1, **FLAT)
    means = recorded_logs.fault_means(rows)
    assert [*means.index] == [*few]
    worst_m = means["worst_position_m"]
    assert worst_m["none"] < worst_m["outliers"] and (means["outside"] == 0).all()


@pytest.mark.nightly
def test_faults_are_shown_with_one_row_a_case():
    runs, _ = faults.study(
        rhec.Scenario(), [0, 1], faults._ESTIMATORS, {"none": faults.CASES["none"]}
    )
    shown = faults.readable_fault_table(faults.fault_table(runs))
    assert list(shown.index) == ["none: no fault"]
    assert shown.loc["none: no fault", "recovered, RHE"] == "2 of 2"
    counts = faults.verdict_counts(faults.fault_table(runs))
    assert list(counts["runs"]) == [2, 2] and list(counts["cases"]) == [1, 1]
