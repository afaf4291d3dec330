"""An impossible position must not cost the paper's RHE more than the EKF of the same data."""

import dataclasses
import functools

import numpy as np
import pytest

import rhec
from rhec.core._casadi.packing import pack_array
from rhec.core.estimator import rhe as core_rhe
from rhec.core.estimator.innovation_gate import InnovationGate
from rhec.simulation.columns import MEASUREMENTS, POSE
from rhec.tracked_robot import estimators, position_check
from rhec.tracked_robot import rhe as paper_rhe
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.kinematics import QUANTITIES

BAD = 60  # the sample with a wrong position
SAMPLES = BAD + 101
DRIVES = 12
RHES = ("rhe", "rhe_fixed_traction", "rhe_no_slip")


@functools.cache
def drives():
    """Measurements (drives, n, 4) and true poses (drives, n, 3), without outliers."""
    scenarios = [rhec.Scenario(duration_s=0.2 * SAMPLES, seed=seed) for seed in range(DRIVES)]
    logs = [run.log[:SAMPLES] for run in rhec.simulate(scenarios)]
    return tuple(np.array([log[columns] for log in logs]) for columns in (MEASUREMENTS, POSE))


def with_outliers(z, size_m):
    z = z.copy()
    for seed, rows in enumerate(z):
        rows[BAD, :2] += np.random.default_rng([seed, size_m]).uniform(-size_m, size_m, 2)
    return z


@functools.cache
def step_of(name, is_checked=True):
    """The step of the loop, and the function that makes its first memory."""
    choice = Choice.of(rhec.Scenario(estimator=name))
    if not is_checked:
        window = paper_rhe.window_of(choice)._replace(judge=None)
        step = core_rhe.build_phases(window)["step"]
        return step.map(DRIVES), functools.partial(paper_rhe.init, window)
    estimator = estimators.estimator_of(name)
    return estimator.build_step(choice).map(DRIVES), functools.partial(estimator.init, choice)


def estimated(name, z, **options):
    """Poses (drives, n, 3) by the step of the loop, and `ok` and `restart` (drives, n)."""
    step, init = step_of(name, **options)
    settings = estimators.estimator_of(name).settings(rhec.Scenario(estimator=name))
    constants = {
        key: np.tile(np.reshape(value, (-1, 1)), len(z))
        for key, value in (dict(traction=np.ones(2)) | settings).items()
        if key in step.name_in()
    }
    sigma = paper_rhe.SIGMA_START | dict(theta_rad=np.pi / 2)
    firsts = [dict(zip(QUANTITIES, (*row[:2], 0.0, row[2], 1.0, 1.0))) for row in z[:, 0]]
    memory = np.array([pack_array(init(first, sigma)) for first in firsts]).T
    poses = []
    flags = []
    for k in range(z.shape[1]):
        result = step(memory=memory, z_N=z[:, k].T, **constants)
        memory = result["memory"]
        poses.append(result["estimate"].full()[:3].T)
        shown = dict(ok=np.ones((1, len(z))), restart=np.zeros((1, len(z)))) | result
        flags.append([np.array(shown[key])[0] == 1 for key in ("ok", "restart")])
    ok, restart = np.array(flags).transpose(1, 2, 0)
    return np.swapaxes(poses, 0, 1), ok, restart


def error_m(poses, truth):
    return np.linalg.norm(poses[..., :2] - truth[..., :2], axis=-1)


@pytest.mark.parametrize(
    ("name", "size_m"), [("rhe", 10), ("rhe", 100), *((name, 1000) for name in RHES)]
)
def test_after_one_wrong_position_it_is_lost_no_more_often_than_the_ekf(name, size_m):
    """Lost: more than 0.5 m wrong 20 s later."""
    z, truth = drives()
    z = with_outliers(z, size_m)
    lost_by_ekf = (error_m(estimated("ekf", z)[0], truth)[:, -1] > 0.5).sum()
    poses, ok, restart = estimated(name, z)
    error = error_m(poses, truth)
    assert (error[:, -1] > 0.5).sum() <= lost_by_ekf
    assert not (ok & (error > 0.5))[:, 30:].any()
    assert not restart.any()


def test_without_the_check_drives_are_lost():
    z, truth = drives()
    poses, ok, _ = estimated("rhe", with_outliers(z, 1000), is_checked=False)
    assert (error_m(poses, truth)[:, -1] > 0.5).sum() >= 2
    assert ok.all()


def test_where_no_position_is_impossible_each_bit_is_as_without_the_check():
    z, _ = drives()
    checked, ok, restart = estimated("rhe", z)
    unchecked, *_ = estimated("rhe", z, is_checked=False)
    assert ok.all() and not restart.any()
    np.testing.assert_array_equal(checked, unchecked)


@pytest.mark.parametrize("size_m", [5, 1000])
def test_positions_that_have_moved_for_good_are_taken_after_three_more(size_m):
    z, truth = drives()
    moved = np.zeros((SAMPLES, 3))
    moved[30:, :2] = size_m
    poses, ok, restart = estimated("rhe", z + np.pad(moved[:, :2], ((0, 0), (0, 2))))
    assert not ok[:, 30:33].any() and ok[:, 33:].all()
    assert restart[:, 33].all() and restart.sum() == DRIVES
    assert error_m(poses, truth + moved)[:, 33:].max() < 0.5


@pytest.mark.parametrize("kind", ["stuck", "burst"])
def test_where_the_estimate_is_wrong_before_a_leap_each_bit_is_as_without_the_check(kind):
    """A receiver that was stuck for 7 s, and a burst of outliers of 2 m, the first of which is
    within reach.
    """
    z, _ = drives()
    z = z.copy()
    if kind == "stuck":
        z[:, 40:75, :2] = z[:, 40:41, :2]
    else:
        angle = np.cumsum(np.random.default_rng(1).uniform(2, 4, (DRIVES, 35)), axis=1)
        z[:, 40:75, :2] += 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    steps = np.linalg.norm(np.diff(z[..., :2], axis=1), axis=-1)
    assert (steps.max(axis=1) > 2.5).all()
    checked, ok, _ = estimated("rhe", z)
    unchecked, *_ = estimated("rhe", z, is_checked=False)
    assert ok.all()
    np.testing.assert_array_equal(checked, unchecked)


def test_of_scattered_positions_none_is_used_for_a_time():
    z, truth = drives()
    z = z.copy()
    z[:, 30:, :2] += np.random.default_rng(1).uniform(-1000, 1000, z[:, 30:, :2].shape)
    poses, ok, restart = estimated("rhe", z)
    most = position_check.most_rejected(0.2)
    assert not ok[:, 30 : 30 + most].any()
    assert restart[:, 30 + most].all()
    assert error_m(poses, truth)[:, 30 : 30 + most].max() < 5


def test_the_live_estimator_is_that_of_the_loop():
    z, _ = drives()
    z = with_outliers(z, 1000)
    z[:, -30:, 0] += 20.0
    poses, ok, _ = estimated("rhe", z)
    live = rhec.RHE()
    for k, row in enumerate(z[0]):
        live.prepare()
        assert live.feedback(row).pose == pytest.approx(poses[0, k], abs=1e-9)
        assert live.ok == ok[0, k]
        assert np.isnan(live.kkt) != ok[0, k]


def test_a_closed_loop_drives_on_after_a_wrong_position():
    fault = rhec.Fault(kind="outliers", start_s=10.0, duration_s=0.2, size_m=1000.0)
    scenario = rhec.Scenario(duration_s=40.0, faults=(fault,))
    hit = rhec.simulate(scenario)
    spared = rhec.simulate(dataclasses.replace(scenario, faults=()))
    assert (~hit.log.ok).sum() == 1
    assert (hit.log.position_accepted == hit.log.ok).all()
    assert spared.log.position_accepted.all()
    assert hit.log.error_true_m.max() < spared.log.error_true_m.max() + 0.05


def test_the_gate_of_any_model_judges_the_papers_window_as_well():
    """A window has one judge, whichever it is; without an outlier both keep each bit."""
    z, _ = drives()
    choice = Choice.of(rhec.Scenario())
    window = paper_rhe.window_of(choice)._replace(judge=InnovationGate())
    phases = core_rhe.build_phases(window)
    settings = estimators.estimator_of("rhe").settings(rhec.Scenario())
    first = dict(zip(QUANTITIES, (*z[0, 0, :2], 0.0, z[0, 0, 2], 1.0, 1.0)))
    sigma = paper_rhe.SIGMA_START | dict(theta_rad=np.pi / 2)
    memory = pack_array(paper_rhe.init(window, first, sigma))
    unchecked, *_ = estimated("rhe", z[:1].repeat(DRIVES, axis=0), is_checked=False)
    settings |= dict(m_0=paper_rhe.init(window, first, sigma)["m"])
    given = {key: settings[key] for key in phases["step"].name_in() if key in settings}
    for row, pose in zip(z[0], unchecked[0]):
        result = phases["step"](memory=memory, z_N=row, **given)
        memory = result["memory"]
        np.testing.assert_array_equal(result["estimate"].full()[:3, 0], pose)
