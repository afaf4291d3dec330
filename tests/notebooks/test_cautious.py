"""The cautious controller: as fast as two chance constraints allow."""

import dataclasses

import numpy as np
import pytest
from oracles import flat

import rhec
from notebooks.further.rivals import cautious
from notebooks.rivals import RIVALS
from rhec import paper
from rhec.tracked_robot.kinematics import QUANTITIES

SET, OMEGA, SLOWEST = 0.5, paper.OMEGA_MAX_RADPS, cautious.SLOWEST_MPS["row"]
CHANGE = cautious.ACCELERATION_MPS2 * paper.DT_S
# A straight along x, a curve to the left, a straight.
PATH = rhec.Path.from_segments([(20.0, 0.0), (10.0, 0.15), (20.0, 0.0)])
SURE = np.diag([1e-4, 1e-4, 1e-6, 1e-4, 1e-4, 1e-4])


@pytest.fixture(scope="module")
def settled():
    """Where the speed settles: the Function, called until it changes no more."""
    speed = cautious.build_speed(QUANTITIES, len(PATH.segments), paper.DT_S)

    def settled(s, left=0.0, yaw=0.0, mu=0.9, kappa=0.8, P=SURE, caution=1.0, set_mps=SET):
        (pose,), _ = PATH.poses([s])
        x, y = pose[:2] + left * np.array([-np.sin(pose[2]), np.cos(pose[2])])
        now, last = SET, None
        while now != last:
            now, last = flat(
                speed(
                    speed=now, s_m=s, estimate=[x, y, pose[2] + yaw, SET, mu, kappa], covariance=P,
                    upper=OMEGA, segments=PATH.segments.T, period_m=PATH.period_m,
                    speed_mps=set_mps, caution=caution,
                )["speed"]
            )[0], now  # fmt: skip
            assert last is None or abs(now - last) <= CHANGE * (1 + 1e-12)
        return now

    return settled


@pytest.mark.parametrize("caution", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("kappa", [0.5, 0.65, 0.9])
def test_in_a_curve_the_soil_gives_the_yaw_rate_even_if_it_is_worse(settled, kappa, caution):
    v = settled(25.0, kappa=kappa, caution=caution)
    worse = max(kappa - caution * 0.01, 0), min(0.9 + caution * 0.01, 1)
    assert v == pytest.approx(min(SET, worse[0] * OMEGA / (0.15 * worse[1])))


@pytest.mark.parametrize("to_m", [0.55, 0.6, 0.8])
def test_before_a_curve_it_brakes_in_time(settled, to_m):
    kappa, v = 0.3, settled(20.0 - to_m, kappa=0.3)
    there = (kappa - 0.01) * OMEGA / (0.15 * 0.91)
    left_m = v**2 / (2 * cautious.ACCELERATION_MPS2) - there**2 / (2 * cautious.ACCELERATION_MPS2)
    assert v == pytest.approx(min(SET, v)) and left_m <= to_m - cautious.NOSE_M + 1e-12
    assert settled(5.0, kappa=kappa) == settled(31.0, kappa=kappa) == SET


def test_the_less_room_the_slower_down_to_the_slowest(settled):
    speeds = [settled(5.0, left=left) for left in np.linspace(0, 0.15, 31)]
    assert speeds[0] == SET and speeds[-1] == SLOWEST and np.all(np.diff(speeds) <= 0)
    assert settled(5.0, left=0.09, yaw=0.05) < settled(5.0, left=0.09, yaw=-0.05)
    assert settled(5.0, left=0.09) == pytest.approx(settled(5.0, left=-0.09))
    # Who has a row yet to reach drives there at the set speed.
    assert settled(5.0, left=1.0) == settled(5.0, left=-1.0) == SET


@pytest.mark.parametrize("place", [0, 1, 2, 4, 5])
def test_less_sure_is_slower_and_no_caution_does_not_care(settled, place):
    """Of x, y, θ, μ or κ; x counts where the path runs along y, too."""
    unsure = SURE + np.diag(np.eye(6)[place] * 0.005)
    where = dict(s=25.0, left=0.07) if place < 3 else dict(s=25.0, kappa=0.68)
    assert settled(P=unsure, **where) < settled(P=SURE, **where)
    assert settled(P=unsure, caution=0.0, **where) == settled(P=SURE, caution=0.0, **where)


def test_backwards_it_looks_where_it_drives(settled):
    """Turned round, and driving backwards, the robot does the same."""
    for yaw in (0.05, -0.05):
        forwards = settled(5.0, left=0.09, yaw=yaw)
        assert settled(5.0, left=0.09, yaw=yaw + np.pi, set_mps=-SET) == pytest.approx(forwards)


def test_what_makes_no_sense_makes_it_slow(settled):
    assert settled(5.0, yaw=np.nan) == SLOWEST
    for absurd in (np.nan, np.inf, 1e300):
        with np.errstate(invalid="ignore"):
            assert settled(5.0, P=SURE * absurd) == SLOWEST
        assert settled(25.0, kappa=-absurd) == cautious.SLOWEST_MPS["curve"]


# In the loop


def test_on_a_wet_patch_it_is_slow_and_stays_nearer():
    """κ halves where the row turns; beside it, the same drive at a constant speed."""
    patch = dict(patches=((36.0, 4.0, 3.0, 0.9, 0.35),), duration_s=120.0, seed=1)
    plain = rhec.Scenario(estimator=RIVALS["yaw_drift_ekf"], **patch)
    slow = rhec.simulate(dataclasses.replace(plain, controller=cautious.controller(plain)))
    error = slow.metrics["max_error_true_m"]
    assert error < rhec.simulate(plain).metrics["max_error_true_m"] / 2
    log = slow.log
    wet = np.hypot(log["x_m"] - 36, log["y_m"] - 4) < 3
    assert log["nu_mps"][wet].mean() < 0.35
    before = log["on_straight"] & (log["t_s"] > slow.metrics["settling_time_s"] + 5)
    assert log["nu_mps"][before].mean() > 0.45
    after = slice(round(5 * (slow.metrics["settling_time_s"] + 5)), None)
    assert slow.metrics["mean_speed_mps"] == pytest.approx(log["nu_mps"][after].mean())
