"""One judge for every RHE: what one sample does, and the acceptance table of `guard_table`."""

import bisect
import functools
from types import MappingProxyType

import casadi as ca
import guard_table as table
import numpy as np
import pytest

import rhec
from rhec.core.estimator import noise_level
from rhec.core.estimator.innovation_gate import InnovationGate

DRIVES = range(2)
NIGHTLY_DRIVES = range(1000, 1120)  # on which no number was chosen
SAMPLE = [case for i, case in enumerate(table.cases()) if i % 58 == 0]
SAMPLE += [
    table.Case("paper, printed", "first", "4 wild of 1000 m"),
    table.Case("paper, consistent", "later", "positions 0.3 m off, 26 s"),
    table.Case("bicycle", "later", table.TURNED),
]


def assert_kept(case, seeds, known=MappingProxyType({})):
    """Lost no more often than the EKF, no farther off, back no later; `ok` False where lost.

    A row that is known to break some of that does so by no more than it is known to.
    """
    ours, ekf, moved = table.rows_of(case, seeds)
    assert set(table.breaches(ours, ekf, moved)) == set(known), (ours, ekf, moved)
    assert all(getattr(ours, name) <= most for name, most in known.items()), ours


@pytest.mark.parametrize("case", SAMPLE, ids=" ".join)
def test_no_fault_costs_the_rhe_more_than_the_ekf(case):
    assert_kept(case, DRIVES)


@pytest.mark.nightly
@pytest.mark.parametrize("case", table.cases(), ids=" ".join)
def test_no_fault_costs_the_rhe_more_than_the_ekf_on_many_drives(case):
    assert_kept(case, NIGHTLY_DRIVES, table.KNOWN.get(case, {}))


@functools.cache
def found(robot, fault="none", when="later", judge=table.ANY):
    """The spoiled Drives, the estimates and `ok` of the RHE on them."""
    drives = table.spoiled(table.Case(robot, when, fault), DRIVES)
    return drives, *table.run(table.ROBOTS[robot].estimators(judge)["RHE"], drives)


ROBOTS = ["paper, printed", "paper, consistent", "bicycle", "unicycle"]
UP_TO_THREE = [name for name in table.WILD if name[0] in "123" and name[1] == " "]


@pytest.mark.parametrize("fault", UP_TO_THREE[::10])
@pytest.mark.parametrize("robot", ROBOTS)
def test_up_to_three_wild_samples_move_nothing(robot, fault):
    """They are not `ok`, and the estimates are those of the same samples without a position."""
    drives, places, ok = found(robot, fault)
    _, spared, _ = found(robot)
    assert np.linalg.norm(places - spared, axis=-1).max() < 0.05
    for first, last, flags in zip(drives.first, drives.last, ok):
        assert (~flags).nonzero()[0].tolist() == [*range(first, last + 1)]


@pytest.mark.parametrize("robot", ["bicycle", "unicycle"])
def test_a_wild_first_sample_is_judged_by_the_first_guess(robot):
    drives, places, ok = found(robot, "1 wild of 10000 m", "first")
    assert not ok[:, 0].any() and ok[:, 1:].all()
    assert np.linalg.norm(places - drives.places, axis=-1).max() < 1.5  # the guess is 0.3 m off


@pytest.mark.parametrize("robot", ROBOTS)
def test_drives_without_a_fault_keep_the_bits_that_they_have_if_no_sample_is_rejected(robot):
    """The paper's RHE keeps those of a window without a judge."""
    _, places, ok = found(robot)
    judge = None if robot.startswith("paper") else InnovationGate(rejects=False)
    _, unjudged, _ = found(robot, judge=judge)
    assert ok.all()
    np.testing.assert_array_equal(places, unjudged)


@pytest.mark.parametrize("size_m", [5, 100])
@pytest.mark.parametrize("robot", ROBOTS)
def test_positions_that_have_moved_for_good_are_taken_at_the_fourth(robot, size_m):
    drives, places, ok = found(robot, f"moved for good by {size_m} m")
    error = np.linalg.norm(places - drives.places, axis=-1)
    for first, flags, off in zip(drives.first, ok, error):
        assert (~flags).nonzero()[0].tolist() == [first, first + 1, first + 2]
        assert off[first + 3 :].max() < 0.5


@pytest.mark.parametrize("speed_mps", [10, 30])
def test_they_are_so_as_well_while_the_estimate_itself_moves(speed_mps):
    """Wrong encoders correct it at each sample by an amount that grows with the wrong speed."""
    drives = table.spoiled(table.Case("paper, printed", "later", "moved for good by 5 m"), DRIVES)
    z = drives.z.copy()
    for of_drive, first in zip(z, drives.first):
        of_drive[first:, 2] += speed_mps
    _, ok = table.run(table.paper_estimators("prediction")["RHE"], drives._replace(z=z))
    for flags, first in zip(ok, drives.first):
        assert flags[first : first + 5].tolist() == [False, False, False, True, True]


@pytest.mark.parametrize("robot", ["paper, printed", "unicycle"])
def test_scattered_positions_move_nothing_and_weigh_as_they_scatter(robot):
    """At first none is used; from the eighth on they count as noise of that size."""
    drives = table.spoiled(table.Case(robot, "later", "none"), DRIVES)
    rng = np.random.default_rng(1)
    z = drives.z.copy()
    z[:, 30:90, :2] += rng.uniform(-1e4, 1e4, z[:, 30:90, :2].shape)
    estimator = table.ROBOTS[robot].estimators()["RHE"]
    places, ok = table.run(estimator, drives._replace(z=z))
    most = noise_level.TUNED.patience
    error = np.linalg.norm(places - drives.places, axis=-1)
    assert not ok[:, 30 : 29 + most].any() and ok[:, 29 + most].all()
    # Each coordinate scatters by 5.8 km, the end of a line through 16 of them by half as much.
    assert error[:, 30 : 29 + most].max() < 1 and error.max() < 2900
    assert ok[:, -100:].all() and error[:, -100:].max() < 0.3


def test_the_longer_no_position_came_the_farther_the_next_may_be():
    """By the root of the number of samples, with the σ from before the gap."""
    straight = rhec.Model(
        states=("x", "y", "theta"),
        inputs=("v", "omega"),
        outputs=("x", "y", "v", "omega"),
        f=lambda x, u, p: ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1]),
    )
    noise = dict(sigma_v=[0.02] * 4, sigma_w=[0.01] * 3, guess=[0] * 3, sigma_guess=[0.1, 0.1, 0.3])
    live = rhec.RHE(model=straight, dt=0.2, horizon=5, **noise)

    def is_used(beside_m, missing):
        live.restart()
        for k in range(30):
            live.step([0.1 * k, 0.0, 0.5, 0.0])
        for _ in range(missing):
            live.step([np.nan, np.nan, 0.5, 0.0])
        live.step([0.1 * (30 + missing), beside_m, 0.5, 0.0])
        return live.ok

    grid = np.arange(0.0, 5.0, 0.01)

    def largest_m(missing):
        return grid[bisect.bisect(grid, False, key=lambda beside: not is_used(beside, missing))]

    assert largest_m(15) == pytest.approx(2 * largest_m(3), rel=0.1)


@pytest.mark.parametrize(
    "steering_rad, is_kept", [(0.2, True), (-0.3, True), (0.31, True), (1.0, False), (-1.0, False)]
)
def test_an_input_is_kept_within_those_of_the_window(steering_rad, is_kept):
    """Those from -0.3 to 0.3 rad were in the window, and σ is 0.02 rad or so."""
    live = rhec.RHE(
        model=table.model_of("bicycle"), dt=table.DT_S, horizon=5, **table.settings_of("bicycle")
    )
    kept = live.window.judge.build_kept(live.window)
    v = np.vstack([np.full(5, 1.0), np.linspace(-0.3, 0.3, 5)])
    z = np.array([5.0, 6.0, 1.0, steering_rad])
    found = kept(z, v, live.settings["V"]).full().ravel()
    np.testing.assert_array_equal(found, np.where([True, True, True, is_kept], z, np.nan))


def test_beside_a_wild_input_the_position_is_used():
    drives, places, ok = found("unicycle", "encoders wild 1 s")
    error = np.linalg.norm(places - drives.places, axis=-1)
    assert ok.all() and error.max() < 0.15


def test_a_live_estimator_tells_what_it_used_and_how_much_it_rejected():
    z = table.simulated_drives("bicycle", range(1)).z[0]
    settings = table.settings_of("bicycle")
    live = rhec.RHE(model=table.model_of("bicycle"), dt=table.DT_S, horizon=10, **settings)
    assert live.accepted.tolist() == [False] * 4 and live.rejected == 0
    for row in z[:40]:
        live.step(row)
    assert live.accepted.tolist() == [True] * 4 and live.rejected == 0
    assert live.ok and np.isfinite(live.kkt)
    live.step(z[40] + (1e3, 0.0, 0.0, 0.0))  # a position is judged as a whole
    assert live.accepted.tolist() == [False, False, True, True]
    assert live.rejected == pytest.approx(1 / 30)
    assert not live.ok and np.isnan(live.kkt) and "far from its prediction" in live.status
    live.step(z[41] + (0.0, 0.0, np.nan, 0.0))
    assert live.accepted.tolist() == [True, True, False, True]
    assert live.rejected == pytest.approx(29 / 30**2)
    live.step((np.nan, np.nan, *z[42, 2:]))  # there was nothing to judge
    assert live.rejected == pytest.approx(29 / 30**2)
    live.restart()
    assert not live.accepted.any() and live.rejected == 0
