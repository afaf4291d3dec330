"""Gyro and heading of the simulated robot: what they measure, what faults do, what they gain."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec import paper
from rhec.explorer import controls
from rhec.simulation import closed_loop
from rhec.simulation.offline import run_estimator
from rhec.tracked_robot.paper_rhe import settings_of
from rhec.tracked_robot.plant import Normal, draw_noise
from rhec.tracked_robot.sensors import SENSORS

pytestmark = pytest.mark.usefixtures("virtual_machine")
BOTH = ("gyro", "heading")
SHORT = rhec.Scenario(
    duration_s=60.0, process_noise="consistent", speed_model="input", sensors=BOTH, seed=3
)


def changed(**fields):
    return rhec.simulate(dataclasses.replace(SHORT, **fields))


def test_they_measure_the_yaw_up_to_full_turns_and_its_rate_over_ground():
    """Deviations of 300 samples: their own are known to 4 %. On the way the yaw passes π."""
    path = rhec.Path.from_segments([(90.0, 0.0)], start=(0.0, 0.0, 3.1))
    run = changed(path=path, start_offset_m=-1.0)
    log, scenario = run.log, run.scenario
    rate = np.diff(log["theta_rad"]) / paper.DT_S
    rest = log["gyro_meas_radps"][1:] - scenario.gyro_scale * rate - scenario.gyro_bias_radps
    assert rest.std() == pytest.approx(scenario.gyro_sigma_radps, rel=0.15)
    assert abs(rest.mean()) < 4 * scenario.gyro_sigma_radps / np.sqrt(len(rest))
    off = log["heading_meas_rad"] - log["theta_rad"]
    off = (off + np.pi) % (2 * np.pi) - np.pi
    assert off.std() == pytest.approx(scenario.heading_sigma_rad, rel=0.15)
    assert log["heading_meas_rad"].abs().max() <= np.pi < log["theta_rad"].abs().max()
    assert log["heading_meas_rad"].diff().abs().max() > 6.0
    assert run.metrics["rms_yaw_rad"] < 0.03


def test_other_random_streams_stay_as_they_are():
    """The noise of a seed begins the same, however many samples and sensors there are."""
    gyro, heading = (Normal(SENSORS[name].stream) for name in BOTH)
    plain = closed_loop.noise_and_faults(5, (), 50, (draw_noise, gyro))
    both = closed_loop.noise_and_faults(5, (), 60, (draw_noise, gyro, heading))
    np.testing.assert_array_equal(both[:50, : plain.shape[1]], plain)


def test_an_oracle_drives_a_robot_with_sensors_as_one_without():
    """It needs none of them, but their measurements are there for other estimators."""
    oracle = dict(estimator="oracle", duration_s=20.0)
    plain, both = (changed(**oracle, sensors=sensors) for sensors in ((), BOTH))
    pd.testing.assert_frame_equal(both.log[plain.log.columns], plain.log)
    estimate = run_estimator(SHORT, both, "estimate")["estimate"]
    assert np.abs(estimate[:, 2] - both.log["theta_rad"]).max() < 0.1
    with pytest.raises(ValueError, match=r"^the run has no column 'gyro_meas_radps'; its sensors"):
        run_estimator(SHORT, plain, "estimate")
    with pytest.raises(ValueError, match=r"^the estimator 'oracle' returns no 'deviance'; it ret"):
        run_estimator(plain.scenario, plain, "deviance")


@pytest.mark.parametrize("name", SENSORS)
def test_all_that_belongs_to_a_sensor_is_there(name):
    """Parameters of its noise, a slider, and an argument of the live RHE."""
    sensor = SENSORS[name]
    parameters = {setting.parameter for setting in sensor.settings.values()}
    assert {sensor.sigma, *parameters} <= {field.name for field in dataclasses.fields(SHORT)}
    assert (name,) in dict(controls.CONTROLS["sensors"].options).values()
    noise = (0.5, 0.25)[: len(sensor.noise)]
    fields = {sensor.sigma: noise if len(noise) > 1 else noise[0]}
    live = rhec.RHE(sensors=(name,), **fields)
    assert live.settings["V"][4] == 0.25
    assert settings_of(rhec.Scenario(sensors=(name,), **fields))["V"][4] == 0.25
    # 1, 2 and 4 are the streams of plant and faults.
    assert sensor.stream not in (1, 2, 4)
    for other in {*SENSORS} - {name}:
        for what in ("stream", "output", "sigma", "column", "recorded_column"):
            assert getattr(SENSORS[other], what) != getattr(sensor, what)
    # Whatever the order in which they are named, they come in that of their measurements.
    backwards = dataclasses.replace(SHORT, sensors=BOTH[::-1])
    assert backwards == SHORT
    assert rhec.RHE(sensors=BOTH[::-1]).model.outputs[4:] == ("gyro_radps", "heading_rad")


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("speed_model", ["parameter", "input", "slipping"])
def test_sensors_that_never_deliver_leave_the_estimate_as_it_is(speed_model):
    """Up to rounding: the equations of a silent sensor have no weight."""
    silent = tuple(rhec.Fault(kind="missing", channel=name) for name in BOTH)
    fields = dict(speed_model=speed_model, duration_s=20.0)
    without = changed(**fields, sensors=())
    with_both = changed(**fields, faults=silent)
    assert with_both.log["gyro_meas_radps"].isna().all()
    for name in ("x_hat_m", "theta_hat_rad", "kappa_hat", "omega_cmd_radps"):
        np.testing.assert_allclose(with_both.log[name], without.log[name], atol=1e-6)


def test_yaw_and_drive_are_better_with_a_gyro_still_better_with_a_heading_and_best_with_both():
    """Means of three training seeds, in the order of docs/world.md."""
    errors = []
    for sensors in ((), ("gyro",), ("heading",), BOTH):
        runs = [changed(sensors=sensors, seed=seed).metrics for seed in range(1000, 1003)]
        errors.append([(run["rms_yaw_rad"], run["mean_error_true_m"]) for run in runs])
    none, gyro, heading, both = np.mean(errors, axis=1)
    assert (gyro < 0.75 * none).all() and (heading < gyro).all() and (both < heading).all()


@pytest.mark.parametrize("missing", [np.nan, np.inf])
def test_a_first_heading_that_is_missing_is_none(missing):
    """The estimate then begins as that of a robot without one."""
    plain, with_heading = (rhec.RHE(sensors=sensors) for sensors in ((), ("heading",)))
    expected = plain.feedback((1.0, 2.0, 0.5, 0.1))
    found = with_heading.feedback((1.0, 2.0, 0.5, 0.1, missing))
    np.testing.assert_allclose([*found.pose, *found.p], [*expected.pose, *expected.p], atol=1e-9)
