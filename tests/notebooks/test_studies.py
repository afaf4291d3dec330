"""Studies that carry the cells of the notebooks: replays of a log, and faults."""

import pytest

import rhec
from notebooks.further import faults, recorded_logs
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


def test_all_hard_cases_exist():
    assert all(case in faults.CASES[family] for family, case in faults.HARD)
