"""Studies that carry the cells of the notebooks: replays of a log, faults, and a robot of two
tracks.
"""

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec.workbench.plots.style import ROOT
from rhec.workbench.studies import ensured, multiverse, robustness, your_robot
from rhec.workbench.studies.claims import summary
from rhec.workbench.studies.replay_study import ReplayStudy

LOG = ROOT / "data/example_log.csv"


@pytest.fixture(scope="module")
def study():
    return ReplayStudy(LOG, seeds=2, first_yaw_rad=[0.1])


def test_a_study_replays_its_log_as_the_public_function_does(study):
    assert study.rhe == dict(
        robust=False, track_width_m=None, position_delay_s=0.0, trust_log=False
    )
    expected = rhec.replay(rhec.logs.read(LOG), first_yaw_rad=0.1, smooth=True)
    pd.testing.assert_frame_equal(study.estimates, expected)


def test_a_study_scores_five_estimators(study):
    assert list(study.table["estimator"].unique()) == [*study.estimators, "augmented EKF"]
    assert study.has_true_yaw and (study.table["n"] == 2).all()
    assert study.unusable_rows.loc["rows"].item() == len(study.log)


def test_numbers_of_the_user_replace_those_of_the_calibration(tmp_path):
    sigma_v = [0.01, 0.01, 0.02, 0.03]
    log = pd.read_csv(LOG)
    log[: len(log) // 4].to_csv(tmp_path / "log.csv", index=False)
    study = ReplayStudy(tmp_path / "log.csv", calibrated=True, sigma_v=sigma_v)
    calibration = rhec.calibrate(study.log)
    assert study.rhe["sigma_v"] == tuple(sigma_v)
    assert study.rhe["slip"] == calibration["slip"]


def test_columns_take_the_names_that_they_have_in_the_file(tmp_path):
    log = pd.read_csv(LOG).rename(columns={"x_m": "here", "y_m": "there"})
    log.to_csv(tmp_path / "log.csv", index=False)
    study = ReplayStudy(tmp_path / "log.csv", columns=["x_m=here", "y_m=there"])
    expected = rhec.logs.read(LOG)
    pd.testing.assert_frame_equal(study.log[expected.columns], expected)


def test_faults_are_shown_with_one_row_a_case():
    runs, _ = robustness.study(
        rhec.Scenario(), [0, 1], robustness._HANDLING, {"none": robustness.CASES["none"]}
    )
    shown = robustness.readable_fault_table(robustness.fault_table(runs))
    assert list(shown.index) == ["none: no fault"]
    assert shown.loc["none: no fault", "recovered, on"] == "2 of 2"
    counts = robustness.verdict_counts(robustness.fault_table(runs))
    assert list(counts["runs"]) == [2, 2] and list(counts["cases"]) == [1, 1]


def test_all_hard_cases_exist():
    assert all(case in robustness.CASES[family] for family, case in robustness.HARD)


def test_shares_and_speeds_are_shown_with_their_intervals():
    row = dict(soil="default soil", estimator="RHE", mode="cautious", set_mps=0.5)
    row |= dict(speed_mps=0.48, speed_low=0.47, speed_high=0.49, promise="whole path")
    row |= dict(worst_m=0.1234, share=0.9, low=0.8, high=0.95, n=50)
    table = pd.DataFrame([row, row | dict(promise="rows")])
    (shown,) = ensured.readable_front(table).itertuples()
    assert shown.share == "0.900 [0.800, 0.950]" and shown.speed_mps == "0.480 [0.470, 0.490]"
    row = dict(id="A1 c", claim="…", holds=0.5, low=0.4, high=0.6, undecided=0.5, worlds=80)
    assert multiverse.readable_summary(pd.DataFrame([row]))["holds"].item() == (
        "0.500 [0.400, 0.600]"
    )


def test_the_ledger_is_shown_in_parts():
    row = dict(id="A1", claim="…", test="…", paper=1.0, value=2.0, low=1.5, high=2.5, n=9)
    row |= dict(section="…", bound="> 1", unit="m", conditions="…", reached="…", why="…")
    row |= dict(verdict="holds", kind="holds", p=0.01, p_adjusted=0.02)
    row |= dict(quote="…", basis=summary.TESTED, beside="…")
    fails = row | dict(id="A2", verdict="does not hold", kind="does not hold")
    partly = row | dict(id="A3", verdict="holds as printed", kind="holds as printed")
    table = pd.DataFrame([row, fails, partly])
    assert summary.readable_ledger(table)["value"].tolist() == ["2.00 [1.50, 2.50]"] * 3
    assert list(summary.failing(table).index) == ["A2"]
    assert list(summary.depending(table).index) == ["A3"]
    assert summary.lost(table).empty


def test_a_robot_of_two_tracks_turns_to_the_slower_side():
    robot = your_robot.TwoTracks(0.6, 10.0, [0.0, 0.0], [0.0, 0.5])
    straight = robot.move(np.zeros(3), np.array([0.5, 0.5]), (0, 0))
    np.testing.assert_allclose(straight, [0.1, 0, 0], atol=1e-12)
    assert robot.move(np.zeros(3), np.array([0.5, 0.5]), (0, 0.5))[2] < 0
    assert robot.slips[0].tolist() == [0, 0] and robot.slips[-1].tolist() == [0, 0.5]
    last_m = 10.0 * 0.5 + your_robot.HORIZON * your_robot.DT_S * 0.5
    assert robot.path.length_m > last_m
