"""The noise of positions is asked of the log; robust handling loses nothing that plain keeps."""

import numpy as np
import pytest
from helpers import recorded_log

import rhec
from notebooks.further.recorded import scores
from rhec.logs.position_noise import LEAST_M, position_sigma_m
from rhec.logs.recording import prepare


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


def replays_of(log, seed, noise_m, **fault):
    """The plain and the robust replay of a log with noise, and with a fault after a minute."""
    start_s = scores.while_moving(scores.perturbed_replay(log, 0), 60.0, 30.0)
    faults = (rhec.Fault(start_s=start_s, **fault),) if fault else ()
    return (
        scores.perturbed_replay(log, seed, noise_m=noise_m, faults=faults, robust=robust)
        for robust in (False, True)
    )


def errors_of(samples):
    """RMS error of the yaw [rad] and largest error of the position [m]."""
    counted = samples[scores.distance_driven(samples) >= scores.FROM_M]
    x, y = (counted[f"{name}_hat_m"] - counted[f"{name}_m"] for name in "xy")
    return scores.rms(scores.yaw_error(counted)), np.hypot(x, y).max()


@pytest.mark.parametrize("noise_m", [0.03, 0.1])
@pytest.mark.parametrize("rate_hz", [5.0, 1.0])
@pytest.mark.parametrize(
    "fault",
    [{}, dict(kind="dead", channel="left", duration_s=30.0), dict(kind="missing", duration_s=20.0)],
)
def test_robust_handling_loses_nothing_that_plain_keeps(fault, rate_hz, noise_m):
    """Up to a tenth of its errors, in the mean over two noise seeds."""
    log = thinned(recorded_log(10.0, 150.0, noise_m=0.0, seed=1), rate_hz)
    errors = [
        [errors_of(samples) for samples in replays_of(log, seed, noise_m, **fault)]
        for seed in range(2)
    ]
    (plain_rad, plain_m), (robust_rad, robust_m) = np.mean(errors, axis=0)
    assert robust_rad <= 1.1 * plain_rad + 0.01
    assert robust_m <= 1.1 * plain_m + 0.1


def test_a_dead_encoder_never_takes_the_position_away():
    log = thinned(recorded_log(10.0, 150.0, noise_m=0.02, seed=2), 5.0)
    fault = dict(kind="dead", channel="left", duration_s=30.0)
    plain_m, robust_m = (
        np.hypot(s["x_hat_m"] - s["x_m"], s["y_hat_m"] - s["y_m"])[s["t_s"] > 20].max()
        for s in replays_of(log, 0, 0.0, **fault)
    )
    assert robust_m <= 1.1 * plain_m + 0.1
