"""The simulated robot: tracks, speed loop, sensors, soil."""

import numpy as np
import pytest
from oracles import DT, flat

from rhec.core._casadi import build as function
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import terrain

DRIVE, MEASURE = robot.drive(DT), robot.measure(DT)
QUIET = dict(
    bump=0,
    encoder=np.zeros((2, robot.SUBSTEPS)),
    track_width_m=0.4,
    rotation_centre_m=0,
    encoder_sigma_mps=0,
    bump_sigma_radps=0,
    rut_length_m=0,
    yaw_drift_radpm=0,
)


def driven(samples, traction=(1, 1), speed_mps=0.5, omega_radps=0.0, start_mps=0.5, **given):
    """The robot's memory after each of so many samples."""
    memory, history = robot.init((0.0, 0.0, 0.0), start_mps), []
    for _ in range(samples):
        step = DRIVE(
            **function.select_inputs(
                DRIVE,
                memory
                | QUIET
                | dict(traction=traction, speed_mps=speed_mps, omega_radps=omega_radps)
                | given,
            )
        )
        memory = memory | {name: np.array(value) for name, value in step.items()}
        history.append({name: flat(value) for name, value in memory.items()})
    return history


def test_on_firm_soil_it_reaches_the_commanded_speeds():
    for speed, omega in ((0.5, 0.0), (0.3, 0.1), (-0.6, -0.2)):
        end = driven(25, speed_mps=speed, omega_radps=omega, start_mps=0.0)[-1]
        np.testing.assert_allclose(
            end["tracks"], [speed - 0.2 * omega, speed + 0.2 * omega], atol=1e-6
        )
        np.testing.assert_allclose(end["encoders"], [speed, omega], atol=1e-6)


def test_the_soil_takes_its_share():
    """Ground speed μν, yaw rate κω; the encoders see nothing of it."""
    before, end = driven(26, traction=(0.7, 0.4), omega_radps=0.1)[-2:]
    moved = end["pose"] - before["pose"]
    assert np.hypot(*moved[:2]) == pytest.approx(0.7 * 0.5 * DT, rel=1e-5)
    assert moved[2] == pytest.approx(0.4 * 0.1 * DT, rel=1e-6)
    np.testing.assert_allclose(end["encoders"], [0.5, 0.1], atol=1e-6)


def test_the_encoders_report_means_over_the_sample():
    """So that what they report, integrated, is how far the robot went."""
    history = driven(10, speed_mps=0.5, omega_radps=0.3, start_mps=0.0)
    yaws = np.array([0.0, *(each["pose"][2] for each in history)])
    np.testing.assert_allclose(
        [each["encoders"][1] * DT for each in history], np.diff(yaws), atol=1e-12
    )


def test_no_track_is_faster_than_its_motor():
    for speed, omega in ((5.0, 0.0), (-5.0, 0.0), (1.4, 3.0)):
        history = driven(30, speed_mps=speed, omega_radps=omega)
        fastest = max(np.abs(each["tracks"]).max() for each in history)
        assert 1.45 < fastest <= 1.5
    assert np.abs(driven(30, speed_mps=5.0)[-1]["integral"]).max() < 5  # no wind-up


def test_a_bump_turns_the_robot_for_one_sample():
    plain, bumped = driven(1)[-1], driven(1, bump=2.0, bump_sigma_radps=0.05)[-1]
    assert bumped["pose"][2] - plain["pose"][2] == pytest.approx(2.0 * 0.05 * DT)
    np.testing.assert_array_equal(bumped["encoders"], plain["encoders"])


def test_encoder_noise_is_that_of_two_tracks_averaged():
    """What is reported beyond what was driven."""
    rng, sigma, errors = np.random.default_rng(0), 0.02, []
    for _ in range(2000):
        end = driven(1, encoder=rng.normal(size=(2, robot.SUBSTEPS)), encoder_sigma_mps=sigma)[-1]
        errors.append(end["encoders"] - end["pose"][[0, 2]] / DT)
    expected = np.array([1 / np.sqrt(2), np.sqrt(2) / 0.4]) * sigma / np.sqrt(robot.SUBSTEPS)
    np.testing.assert_allclose(np.std(errors, axis=0), expected, rtol=0.06)


def test_the_measured_speed_has_an_error_that_leaves_the_yaw_rate_alone():
    known = dict(pose=np.zeros(3), drift=np.zeros(2), encoders=np.array([0.5, 0.1]), running=0)
    known |= dict(white=np.zeros(2), slow=np.zeros(2))
    known |= dict(gnss_sigma_m=0, gnss_slow_share=0, gnss_slow_time_s=1, speed_sigma_mps=0.05)
    for speed in (0.0, 1.0, -2.0):
        z = flat(MEASURE(**known, speed=speed)["z"])
        np.testing.assert_allclose(z, [0, 0, 0.5 + 0.05 * speed, 0.1], rtol=0, atol=1e-15)


GNSS = dict(speed=1.0, speed_sigma_mps=0.0, pose=[3.0, -2.0, 0.4], encoders=[0.5, 0.1])


def test_the_position_error_has_the_deviation_and_correlation_time_asked_for():
    rng, samples, time_s = np.random.default_rng(1), 8_000, 2.0
    drift, errors = np.zeros(2), np.empty((samples, 2))
    # 0.05² = 0.03² + 0.04², of which the latter varies slowly.
    gnss = GNSS | dict(gnss_sigma_m=0.05, gnss_slow_share=0.64, gnss_slow_time_s=time_s)
    for k, (white, slow) in enumerate(rng.normal(size=(samples, 2, 2))):
        result = MEASURE(drift=drift, running=k > 0, white=white, slow=slow, **gnss)
        drift, z = flat(result["drift"]), flat(result["z"])
        errors[k] = z[:2] - GNSS["pose"][:2]
        np.testing.assert_array_equal(z[2:], GNSS["encoders"])
    assert np.std(errors) == pytest.approx(0.05, rel=0.04)
    assert np.abs(errors.mean()) < 3 * 0.04 / np.sqrt(samples * DT / time_s)
    for lag in (5, 10, 20):
        covariance = np.mean(errors[lag:] * errors[:-lag])
        assert covariance == pytest.approx(0.04**2 * np.exp(-lag * DT / time_s), abs=0.04**2 * 0.1)
    assert abs(np.mean(errors[:, 0] * errors[:, 1])) < 0.05**2 * 0.08


def test_a_slow_position_error_is_there_from_the_first_sample_on():
    """Else a drive that is short beside the time constant would have hardly any."""
    gnss = GNSS | dict(gnss_sigma_m=0.02, gnss_slow_share=1.0, gnss_slow_time_s=900.0)
    for slow in ([1.0, -2.0], [0.5, 3.0]):
        z = flat(MEASURE(drift=[7.0, 7.0], running=0, white=[9.0, 9.0], slow=slow, **gnss)["z"])
        np.testing.assert_allclose(z[:2] - GNSS["pose"][:2], 0.02 * np.array(slow), atol=1e-15)


# Two tracks, the centre of rotation, ruts


def test_turning_on_the_spot_keeps_the_centre_of_rotation_where_it_is():
    history = driven(50, speed_mps=0.0, omega_radps=0.5, start_mps=0.0, rotation_centre_m=0.3)
    poses = np.array([each["pose"] for each in history])
    assert poses[-1, 2] > 4
    x, y, theta = poses.T
    np.testing.assert_allclose(x + 0.3 * np.cos(theta), 0.3, atol=1e-12)
    np.testing.assert_allclose(y + 0.3 * np.sin(theta), 0.0, atol=1e-12)


def soil_at(pose, under, slip_difference, fields):
    shape = fields.mu.shape
    found = robot.soil(shape, under)
    settings = terrain.settings(fields, shape)
    settings |= dict(slip_difference=slip_difference, track_width_m=0.4)
    result = found(pose=pose, **function.select_inputs(found, settings))
    return [*flat(result["traction"]), float(result["yaw_drift_radpm"])]


def test_no_track_has_more_grip_than_firm_soil():
    firm = terrain.Terrain.uniform(1.0, 0.9)
    expected = [0.95, 0.9, 0.1 / (0.4 * 0.95)]
    np.testing.assert_allclose(soil_at([0.2, 0.2, 0.1], "centre", 0.2, firm), expected, atol=1e-12)


def ruts(samples, speed_mps, length_m):
    """Yaw that bumps add in each sample [rad], driving straight; and the noise behind it."""
    drawn = np.random.default_rng(0).normal(size=samples)
    memory = robot.init((0.0, 0.0, 0.0), speed_mps)
    yaws = [0.0]
    given = QUIET | dict(bump_sigma_radps=0.02, rut_length_m=length_m, traction=(0.8, 1.0))
    given |= dict(speed_mps=speed_mps, omega_radps=0.0)
    for noise in drawn:
        step = DRIVE(**function.select_inputs(DRIVE, memory | given | dict(bump=noise)))
        memory |= {name: np.array(value) for name, value in step.items()}
        yaws.append(flat(memory["pose"])[2])
    return np.diff(yaws), drawn


def test_a_robot_that_stands_is_not_turned_by_ruts():
    assert not ruts(20, 0.0, 0.4)[0].any()
    # Twice as fast over the same ground: twice the yaw rate.
    np.testing.assert_allclose(ruts(1, 1.0, 0.4)[0], 2 * ruts(1, 0.5, 0.4)[0])
