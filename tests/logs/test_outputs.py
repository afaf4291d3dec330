"""Files that a replay leaves behind."""

import make_example_log
import numpy as np
import pandas as pd

import rhec
from rhec import paper
from rhec.logs.outputs import write_estimates


def test_a_replay_leaves_tables_and_paths(tmp_path):
    log = rhec.logs.read(make_example_log.FILE)[:300]
    estimates = rhec.replay(
        log,
        first_yaw_rad=0.4,
        process_noise="prediction",
        sigma_v=paper.SIGMA_V,
        speed_model="input",
    )
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
    # A path has one pose at a time, also where sensors have rows of their own.
    twice = pd.concat([estimates, estimates[100:103]]).sort_values("t_s", kind="stable")
    write_estimates(twice, tmp_path / "twice")
    for name in ("estimated.tum", "measured.tum"):
        assert (tmp_path / "twice" / name).read_text() == (tmp_path / "new" / name).read_text()
