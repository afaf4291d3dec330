"""Side slip that lasts: a replay notices it, and says how well it knows the yaw."""

import numpy as np
import pandas as pd
import pytest
from helpers import may_be_lost, recorded_log

import rhec
from rhec.logs import side_slip
from rhec.logs.scores import yaw_error
from rhec.tracked_robot import tuning

SLIP = tuple(tuning.SLIP.values())
SLIP_RAD = 0.3


@pytest.fixture(scope="module")
def ice():
    world = dict(side_slip_rad=SLIP_RAD, side_slip_time_s=5.0, seed=1000)
    return rhec.simulate(rhec.Scenario(**world)).log


def replayed(log, **arguments):
    result = rhec.replay(log, first_yaw_rad=0.3, **arguments)
    return result[result["t_s"] > 10]


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


@may_be_lost
def test_where_the_robot_slides_its_yaw_is_said_to_be_unknown(ice):
    with_slip = replayed(ice)
    without = replayed(ice, slip=(*SLIP, 0.0))
    error = yaw_error(with_slip).abs()
    is_unsure = with_slip["lost"] | (with_slip["sigma_theta_rad"] > 0.25)
    is_wrong = error > 0.5
    assert is_wrong.sum() > 20
    assert is_unsure[is_wrong].mean() > 0.9
    assert with_slip["lost"][error < 0.2].mean() < 0.02 < without["lost"].mean()
    nees = (error / with_slip["sigma_theta_rad"]) ** 2
    assert 0.1 < nees.mean() < 1.5
    assert rms(error) < rms(yaw_error(without))
    assert any("wanders off the yaw" in remark for remark in with_slip.attrs["remarks"])


def test_a_log_without_lasting_slip_gives_the_same_bits():
    log = recorded_log(5.0, 120.0, noise_m=0.05, seed=1)
    asked = rhec.replay(log, first_yaw_rad=0.7)
    pd.testing.assert_frame_equal(asked, rhec.replay(log, first_yaw_rad=0.7, slip=(*SLIP, 0.0)))


@may_be_lost
def test_lasting_slip_that_is_told_is_used(ice):
    """A tenth of it already makes the yaw less certain."""
    few = replayed(ice.head(200), slip=(*SLIP, 0.1))
    none = replayed(ice.head(200), slip=(*SLIP, 0.0))
    assert np.all(few["sigma_theta_rad"] > 1.1 * none["sigma_theta_rad"])
    assert not any("wanders off the yaw" in remark for remark in few.attrs["remarks"])


@pytest.mark.parametrize("turns", [0.0, 0.4])
@pytest.mark.parametrize("backwards", [False, True])
def test_the_slip_angle_is_that_of_the_path(turns, backwards):
    """A path that is made of a yaw and of a Gauss-Markov slip angle, with white noise."""
    rng = np.random.default_rng(1)
    n = 6000
    keep = np.exp(-0.2 / 2.0)
    beta = np.zeros(n)
    for k in range(1, n):
        beta[k] = keep * beta[k - 1] + np.sqrt(1 - keep**2) * SLIP_RAD * rng.standard_normal()
    omega = np.full(n, turns)
    nu = -1.0 if backwards else 1.0
    course = np.cumsum(omega) * 0.2 + beta
    path = np.cumsum(0.2 * nu * np.exp(1j * course)) + 0.02 * (
        rng.standard_normal(n) + 1j * rng.standard_normal(n)
    )
    samples = pd.DataFrame(
        dict(segment=0, x_meas_m=path.real, y_meas_m=path.imag, nu_meas_mps=nu)
        | dict(omega_meas_radps=omega, kappa_hat=1.0)
    )
    assert side_slip.slip_angle_rad(samples, 0.02) == pytest.approx(SLIP_RAD, rel=0.15)


def test_too_short_a_log_tells_no_slip_angle():
    samples = pd.DataFrame(
        dict(segment=[0, 0], x_meas_m=0.0, y_meas_m=0.0, nu_meas_mps=1.0)
        | dict(omega_meas_radps=0.0, kappa_hat=1.0)
    )
    assert side_slip.slip_angle_rad(samples, 0.02) == 0.0


@pytest.mark.parametrize("n", [4, 7])
def test_slip_has_five_constants_or_six(n):
    with pytest.raises(ValueError, match="slip was .*; it should have 5 or 6 entries"):
        rhec.Scenario(slip=(0.1,) * n)
