"""Estimators that a replay of a log compares."""

import rhec
from notebooks.further import recorded_logs


def test_the_papers_estimators_have_the_noise_that_was_asked_for():
    printed = recorded_logs.estimators("printed", {})
    assert {each["process_noise"] for name, each in printed.items() if name != "RHE"} == {"printed"}
    predicting = recorded_logs.estimators("soft_soil", {})
    noises = {each["process_noise"] for name, each in predicting.items() if name != "RHE"}
    assert noises == {"soft_soil"}
    for arguments in predicting.values():
        rhec.Scenario(**arguments)
