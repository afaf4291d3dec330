"""The noise of positions is asked of the log; robust handling loses nothing that plain keeps."""

import numpy as np
import pytest
from helpers import recorded_log

import rhec
from rhec.logs.position_noise import LEAST_M, position_sigma_m
from rhec.logs.recording import prepare
from rhec.workbench.studies.robustness_grid import Cell, grid, lost_cells, replays_of


def thinned(log, rate_hz):
    every = round(10 / rate_hz)
    log.loc[log.index % every > 0, ["x_m", "y_m"]] = np.nan
    return log


@pytest.mark.parametrize("rate_hz", [10.0, 5.0, 2.5, 1.0])
@pytest.mark.parametrize("sigma_m", [0.05, 0.3])
def test_the_noise_of_positions_is_found_at_every_rate(sigma_m, rate_hz):
    log = thinned(recorded_log(10.0, 200.0, noise_m=sigma_m, seed=4), rate_hz)
    assert position_sigma_m(prepare(log).rows) == pytest.approx(sigma_m, rel=0.15)


def test_no_noise_and_few_positions_give_the_least():
    for log in (recorded_log(), recorded_log(duration_s=2.0, noise_m=0.5)):
        assert position_sigma_m(prepare(log).rows) == LEAST_M


def test_a_receiver_that_declares_more_is_believed():
    """White noise of 0.05 m, declared 1 m, as of errors that wander: σ of the estimate grows."""
    log = recorded_log(10.0, 60.0, noise_m=0.05)
    silent, declared = (
        rhec.replay(each, first_yaw_rad=0.4)["sigma_x_m"].iloc[-1]
        for each in (log, log.assign(position_sigma_m=1.0))
    )
    assert declared > 3 * silent


def test_robust_handling_loses_no_cell_of_a_simulated_log():
    """A part of the study's grid, with the study's tolerance."""
    log = recorded_log(10.0, 150.0, noise_m=0.0, seed=1)
    faults = ("no fault", "dead left", "outage")
    cells = lost_cells(grid({"log": log}, range(2), (0.03, 0.1), (5.0, 1.0), faults))
    lost = cells[cells["yaw_rms_rad, is_lost"] | cells["worst_position_m, is_lost"]]
    assert len(cells) == 12 and lost.empty, lost.to_string()


def test_a_lost_cell_is_counted():
    """The same table with robust errors twice as large plus 1 is lost in each cell."""
    table = grid({"log": recorded_log(10.0, 100.0)}, [0], (0.03,), (5.0,), ("no fault",))
    robust = table["robust"]
    table.loc[robust, ["yaw_rms_rad", "worst_position_m"]] *= 2
    table.loc[robust, ["yaw_rms_rad", "worst_position_m"]] += 1
    cells = lost_cells(table)
    assert cells["yaw_rms_rad, is_lost"].all() and cells["worst_position_m, is_lost"].all()


def test_a_dead_encoder_never_takes_the_position_away():
    recording = prepare(recorded_log(10.0, 150.0, noise_m=0.02, seed=2))
    replays = replays_of(recording, Cell(0.0, 5.0, "dead left"), 0, 70.0)
    worst = {
        robust: np.hypot(s["x_hat_m"] - s["x_m"], s["y_hat_m"] - s["y_m"])[s["t_s"] > 20].max()
        for robust, s in replays.items()
    }
    assert worst[True] <= 1.1 * worst[False] + 0.1
