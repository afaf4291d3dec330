"""The noise of positions is asked of the log."""

import numpy as np
import pandas as pd
import pytest
from helpers import may_be_unsure, recorded_log

import rhec
from rhec.logs.position_noise import LEAST_M, position_sigma_m
from rhec.logs.recording import prepare


def test_positions_that_are_missing_and_a_robot_that_stands_do_not_hide_the_noise():
    """While it stands, a receiver may smooth its positions."""
    log = recorded_log(10.0, 200.0)
    log[["x_m", "y_m", "speed_mps"]] *= 5.0
    rng = np.random.default_rng(0)
    log[["x_m", "y_m"]] += 0.05 * rng.standard_normal((len(log), 2))
    log.loc[rng.random(len(log)) < 0.3, ["x_m", "y_m"]] = np.nan
    stands = log.iloc[[900] * 4000].assign(speed_mps=0.0, yaw_rate_radps=0.0)
    stands[["x_m", "y_m"]] = 1e-4 * rng.standard_normal((len(stands), 2))
    both = pd.concat([log, stands], ignore_index=True)
    both["t_s"] = 0.1 * both.index
    assert position_sigma_m(prepare(both).rows) == pytest.approx(0.05, rel=0.15)


def test_no_noise_and_few_positions_give_the_least():
    for log in (recorded_log(), recorded_log(duration_s=2.0, noise_m=0.5)):
        assert position_sigma_m(prepare(log).rows) == LEAST_M


@may_be_unsure
def test_a_receiver_that_declares_more_is_believed():
    """White noise of 0.05 m, declared 1 m, as of errors that wander: σ of the estimate grows."""
    log = recorded_log(10.0, 60.0, noise_m=0.05)
    silent, declared = (
        rhec.replay(each, first_yaw_rad=0.4)["sigma_x_m"].iloc[-1]
        for each in (log, log.assign(position_sigma_m=1.0))
    )
    assert declared > 3 * silent
