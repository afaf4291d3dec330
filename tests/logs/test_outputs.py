"""Files that a replay leaves behind."""

import make_example_log
import numpy as np
import pandas as pd

import rhec
from rhec.logs.outputs import write_estimates, write_scores
from rhec.logs.scores import while_moving


def test_a_replay_leaves_tables_and_paths(tmp_path):
    log = rhec.logs.read(make_example_log.FILE)[:300]
    estimates = rhec.replay(log, first_yaw_rad=0.4, process_noise="calibrated", speed_model="input")
    write_estimates(estimates, tmp_path / "new")
    for table in (
        pd.read_csv(tmp_path / "new" / "estimates.csv"),
        pd.read_parquet(tmp_path / "new" / "estimates.parquet"),
    ):
        np.testing.assert_allclose(table["theta_hat_rad"], estimates["theta_hat_rad"])
    t, x, y, *nothing, qz, qw = np.loadtxt(tmp_path / "new" / "estimated.tum").T
    said = estimates.dropna(subset="x_hat_m")
    np.testing.assert_allclose([t, x, y], said[["t_s", "x_hat_m", "y_hat_m"]].T, atol=1e-8)
    turn = 2 * np.arctan2(qz, qw) - said["theta_hat_rad"]
    np.testing.assert_allclose(np.cos(turn), 1.0, atol=1e-9)
    assert not np.any(nothing)
    measured = np.loadtxt(tmp_path / "new" / "measured.tum")
    assert (
        len(measured) == estimates["x_meas_m"].notna().sum() and (np.diff(measured[:, 0]) > 0).all()
    )


def test_a_replay_leaves_its_scores_and_what_it_remarked(tmp_path):
    rows = [("EKF", "yaw", 3.0, 2.0, 4.0, 5), ("RHE", "yaw [rad]", 0.5, 0.25, 0.75, 5)]
    table = pd.DataFrame(rows, columns=["estimator", "quantity", "mean", "low", "high", "n"])
    write_scores(table, ["The estimate is lost."], tmp_path)
    title, *lines = (tmp_path / "scores.txt").read_text("utf-8").splitlines()
    assert "5 noise seeds" in title
    assert lines == ["yaw [rad]: 0.5 [0.25, 0.75]", "The estimate is lost."]


def test_a_fault_strikes_while_the_robot_moves():
    t = 0.2 * np.arange(500)
    drives, turns = (t > 30) & (t < 45), (t > 70) & (t < 95)
    samples = pd.DataFrame(
        dict(t_s=t, segment=0, nu_meas_mps=-0.5 * drives, omega_meas_radps=0.5 * turns)
    )
    for from_s, lasts_s, expected in ((0, 10, 30.2), (31, 10, 31), (40, 10, 70.2), (98, 1, 30.2)):
        assert abs(while_moving(samples, from_s, lasts_s) - expected) < 1e-6
