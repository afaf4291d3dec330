"""Gyro and heading of the simulated robot: what they measure, what faults do, what they gain."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec import paper
from rhec.explorer import controls
from rhec.simulation import closed_loop, fault_signals, faults
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


def of_gyro(kind, **fields):
    return rhec.Fault(kind=kind, channel="gyro", **dict(start_s=20.0, duration_s=20.0) | fields)


@pytest.fixture(scope="module")
def measured(virtual_machine):
    return changed()


def test_they_measure_the_yaw_and_its_rate_over_ground(measured):
    """Deviations of 300 samples: their own are known to 4 %."""
    log, scenario = measured.log, measured.scenario
    rate = np.diff(log["theta_rad"]) / paper.DT_S
    rest = log["gyro_meas_radps"][1:] - scenario.gyro_scale * rate - scenario.gyro_bias_radps
    assert rest.std() == pytest.approx(scenario.gyro_sigma_radps, rel=0.15)
    assert abs(rest.mean()) < 4 * scenario.gyro_sigma_radps / np.sqrt(len(rest))
    off = log["heading_meas_rad"] - log["theta_rad"]
    off = (off + np.pi) % (2 * np.pi) - np.pi
    assert off.std() == pytest.approx(scenario.heading_sigma_rad, rel=0.15)


def test_a_heading_is_measured_up_to_full_turns():
    path = rhec.Path.from_segments([(90.0, 0.0)], start=(0.0, 0.0, 3.1))
    run = changed(path=path, start_offset_m=-1.0)
    log = run.log
    assert log["heading_meas_rad"].abs().max() <= np.pi < log["theta_rad"].abs().max()
    assert log["heading_meas_rad"].diff().abs().max() > 6.0
    assert run.metrics["rms_yaw_rad"] < 0.03


def test_other_random_streams_stay_as_they_are():
    """The robot of an oracle drives the same path, and the noise of a seed begins the same."""
    plain = closed_loop.noise_and_faults(5, (), 50)
    gyro_noise, heading_noise = (Normal(SENSORS[name].stream) for name in BOTH)
    gyro, both = (gyro_noise,), (gyro_noise, heading_noise)
    for others in ((), gyro, both):
        longer = closed_loop.noise_and_faults(5, (), 60, (draw_noise, *others))
        np.testing.assert_array_equal(longer[:50, : plain.shape[1]], plain)
    # A gyro's noise is the same with and without a heading.
    alone, first = (
        closed_loop.noise_and_faults(5, (), 50, (draw_noise, *others))[:, plain.shape[1]]
        for others in (gyro, both)
    )
    np.testing.assert_array_equal(alone, first)


def test_sensors_come_in_the_order_of_their_measurements():
    """A fault of a gyro touches the gyro, in whatever order the sensors were named."""
    backwards = dataclasses.replace(SHORT, sensors=BOTH[::-1])
    assert backwards == SHORT and backwards.sensors == BOTH
    live = rhec.RHE(sensors=BOTH[::-1])
    assert live.model.outputs[4:] == ("gyro_radps", "heading_rad")


def test_an_oracle_drives_a_robot_with_sensors_as_one_without():
    """It needs none of them, but their measurements are there for other estimators."""
    plain, both = (changed(estimator="oracle", sensors=sensors) for sensors in ((), BOTH))
    pd.testing.assert_frame_equal(both.log[plain.log.columns], plain.log)
    estimate = run_estimator(SHORT, both, "estimate")["estimate"]
    assert np.abs(estimate[:, 2] - both.log["theta_rad"]).max() < 0.1
    with pytest.raises(ValueError, match=r"^the run has no column 'gyro_meas_radps'; its sensors"):
        run_estimator(SHORT, plain, "estimate")
    with pytest.raises(ValueError, match=r"^the estimator 'oracle' returns no 'deviance'; it ret"):
        run_estimator(plain.scenario, plain, "deviance")


@pytest.mark.parametrize("name", SENSORS)
def test_all_that_belongs_to_a_sensor_is_there(name):
    """Parameters and sliders of its noise, an argument of the live RHE, and a channel of faults."""
    sensor = SENSORS[name]
    parameters = {setting.parameter for setting in sensor.settings.values()}
    assert {sensor.sigma, *parameters} <= {field.name for field in dataclasses.fields(SHORT)}
    assert parameters <= controls.CONTROLS.keys()
    assert (name,) in dict(controls.CONTROLS["sensors"].options).values()
    noise = (0.5, 0.25)[: len(sensor.noise)]
    fields = {sensor.sigma: noise if len(noise) > 1 else noise[0]}
    live = rhec.RHE(sensors=(name,), **fields)
    assert live.settings["V"][4] == 0.25
    assert settings_of(rhec.Scenario(sensors=(name,), **fields))["V"][4] == 0.25
    assert rhec.Fault(kind="dead", channel=name).channel == name


def test_no_two_sensors_share_a_random_stream_or_a_name():
    """1, 2 and 4 are the streams of plant and faults."""
    streams = [1, 2, 4, *(sensor.stream for sensor in SENSORS.values())]
    assert len({*streams}) == len(streams)
    for what in ("output", "sigma", "column", "recorded_column"):
        assert len({getattr(sensor, what) for sensor in SENSORS.values()}) == len(SENSORS)


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


@pytest.mark.parametrize(
    "kind, value", [("missing", np.nan), ("infinite", np.inf), ("dead", 0.0), ("stuck", None)]
)
def test_a_fault_touches_the_gyro_alone(kind, value, measured):
    faulty = changed(faults=(of_gyro(kind),))
    during = slice(100, 200)
    np.testing.assert_array_equal(faulty.log[:100], measured.log[:100])
    got = faulty.log["gyro_meas_radps"][during]
    expected = measured.log["gyro_meas_radps"][99] if value is None else value
    np.testing.assert_allclose(got, np.full(100, expected))
    # The next position comes from the same robot.
    np.testing.assert_array_equal(faulty.log["x_meas_m"][:101], measured.log["x_meas_m"][:101])
    assert faulty.metrics["solver_ok"]


def test_faults_of_sensors_are_the_same_on_a_recorded_stream(measured):
    several = [
        of_gyro("latency", delay_s=0.3),
        rhec.Fault(kind="stuck", channel="heading", start_s=5.0, duration_s=3.0),
        rhec.Fault(kind="rate", channel="all", start_s=30.0, duration_s=9.0, rate_hz=2.0),
        rhec.Fault(kind="dead", channel="gyro", start_s=50.0, duration_s=1.0),
    ]
    names = "x_meas_m y_meas_m nu_meas_mps omega_meas_radps gyro_meas_radps heading_meas_rad"
    z = measured.log[names.split()].to_numpy(copy=True)
    z[:, 5] = np.unwrap(z[:, 5])
    deliver, memory, rows = fault_signals.deliver(2), faults.init(2), []
    shapes = faults.stream_shapes(2)
    ends = np.cumsum([n for n, _ in shapes.values()])[:-1]
    for sample, row in zip(z, fault_signals.stream(several, len(z), paper.DT_S, 0, BOTH)):
        signals = dict(zip(shapes, np.split(row, ends)))
        result = deliver(z=sample, **memory, **signals, track_width_m=0.4)
        memory = {name: result[name] for name in memory}
        rows.append(result["z"].full().ravel())
    expected = fault_signals.corrupted(z, several, measured.log["t_s"], 0.4, 0, BOTH)
    np.testing.assert_allclose(rows, expected, rtol=1e-9, atol=1e-9)


def test_a_gyro_and_a_heading_make_yaw_and_path_better():
    """Means of four training seeds."""
    seeds = range(1000, 1004)
    means = {}
    for sensors in ((), ("gyro",), BOTH):
        fields = dict(sensors=sensors)
        runs = rhec.simulate([dataclasses.replace(SHORT, seed=k, **fields) for k in seeds])
        means[sensors] = [
            np.mean([run.metrics[name] for run in runs])
            for name in ("rms_yaw_rad", "mean_error_true_m")
        ]
    assert means["gyro",][0] < 0.75 * means[()][0]
    assert means[BOTH][0] < 0.6 * means[()][0]
    assert means[BOTH][1] < 0.85 * means[()][1]


def test_a_run_is_a_log_for_replay_and_its_sensors_are_checked_there():
    log = changed(duration_s=120.0).log
    estimates = rhec.replay(log, first_yaw_rad=0.0)
    assert "gyro_bias_hat_radps" in estimates
    for name, words in (
        ("gyro_meas_radps", "counted clockwise"),
        ("heading_meas_rad", "clockwise"),
    ):
        with pytest.raises(ValueError, match=words):
            rhec.replay(log.assign(**{name: -log[name]}))
