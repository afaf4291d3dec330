"""The simulated robot of the closed loop against one in plain NumPy, and its position errors."""

import casadi as ca
import numpy as np
import pytest
from helpers import SIMPLE_WORLD
from oracles import DT, drive

import rhec
from rhec.core.model.robot_model import interval
from rhec.tracked_robot import plant
from rhec.tracked_robot.paper_rhe import settings_of
from rhec.tracked_robot.sensors import records
from rhec.tracked_robot.slipping import SLIPPING
from rhec.tracked_robot.speed_models import speed_model_of

pytestmark = pytest.mark.usefixtures("virtual_machine")
SUBSTEPS = 10
TRACKS = dict(soil_under="tracks", slip_difference=0.04, rotation_centre_m=-0.25)
RUTS = dict(rut_length_m=0.7, bump_sigma_radps=0.03)
SLOW = dict(gnss_slow_share=0.8, gnss_slow_time_s=400.0)
FIRM = dict(terrain=rhec.Terrain.uniform(1.0, 0.9), soil_under="tracks", slip_difference=0.2)
WORLDS = {
    "all at once": TRACKS | RUTS | SLOW | dict(duration_s=60.0, seed=2003),
    "backwards": TRACKS | RUTS | dict(backwards=True, track_width_m=0.55, duration_s=30.0),
    "tracks at their limit": FIRM | dict(speed_mps=1.4, omega_max_radps=1.5, start_offset_m=3.0),
}


def bilinear(field, terrain, xy):
    place = np.clip(
        (xy - np.array(terrain.origin_m)) / terrain.cell_m, 0, np.array(field.shape) - 1.0
    )
    i, j = np.minimum(place.astype(int), np.array(field.shape) - 2)
    u, v = place - (i, j)
    low = (1 - v) * field[i, j] + v * field[i, j + 1]
    return (1 - u) * low + u * ((1 - v) * field[i + 1, j] + v * field[i + 1, j + 1])


def driven_in_numpy(run):
    """Poses (n, 3) and measurements (n, 4) of a robot of two tracks that gets the run's commands.

    Between two steps of the speed loop the point about which it turns moves on an arc. The encoders
    report means over the sample before.
    """
    s, terrain, width_m = run.scenario, run.terrain, run.scenario.track_width_m
    noise = plant.draw_noise(s.seed, len(run.log))
    white, slow, bumps = noise[:, :2], noise[:, 2:4], noise[:, 4]
    encoders = noise[:, 5:25].reshape(-1, SUBSTEPS, 2)
    ahead = s.rotation_centre_m
    set_mps = -s.speed_mps if s.backwards else s.speed_mps
    x, y, theta = run.log[["x_m", "y_m", "theta_rad"]].iloc[0]
    tracks, integral, rut = np.full(2, set_mps), np.zeros(2), None
    reported = np.array([set_mps, 0.0])
    drift = slow[0]
    poses, z = [], []
    for k, omega in enumerate(run.log["omega_cmd_radps"]):
        poses.append((x, y, theta))
        if k:
            stays = np.exp(-DT / s.gnss_slow_time_s)
            drift = stays * drift + np.sqrt(1 - stays**2) * slow[k]
        share = s.gnss_slow_share
        off = s.gnss_sigma_m * (np.sqrt(1 - share) * white[k] + np.sqrt(share) * drift)
        z.append([x + off[0], y + off[1], *(reported + [s.speed_sigma_mps * noise[k, 25], 0])])
        across = width_m / 2 * np.array([-np.sin(theta), np.cos(theta)])
        across *= s.soil_under == "tracks"
        places = np.array([x, y]) + across, np.array([x, y]) - across
        mu_left, mu_right = (bilinear(terrain.mu, terrain, place) for place in places)
        mu_left *= 1 - s.slip_difference / 2
        mu_right = min(1.0, mu_right * (1 + s.slip_difference / 2))
        kappa = np.mean([bilinear(terrain.kappa, terrain, place) for place in places])
        speed = abs(tracks.mean())
        bump = bumps[k]
        if s.rut_length_m:
            keep = np.exp(-(mu_left + mu_right) / 2 * speed * DT / s.rut_length_m)
            rut = bump if rut is None else keep * rut + np.sqrt(1 - keep**2) * bump
            bump = rut * speed / 0.5
        target = set_mps + np.array([-1, 1]) * width_m / 2 * omega
        measured = np.empty((SUBSTEPS, 2))
        for step in range(SUBSTEPS):
            h = DT / SUBSTEPS
            measured[step] = tracks + s.encoder_sigma_mps * encoders[k, step]
            wanted = target + (target - measured[step]) + integral
            limited = np.clip(wanted, -1.5, 1.5)
            integral = integral + h * 10 * (target - measured[step]) * (wanted == limited)
            nu, spin = tracks.mean(), (tracks[1] - tracks[0]) / width_m
            rate = kappa * spin + (mu_right - mu_left) * nu / width_m
            moved = (mu_left + mu_right) / 2 * nu * h * np.sinc(rate * h / 2 / np.pi)
            x += moved * np.cos(theta + rate * h / 2)
            y += moved * np.sin(theta + rate * h / 2)
            turned = theta + rate * h + s.bump_sigma_radps * bump * h
            x += ahead * (np.cos(theta) - np.cos(turned))
            y += ahead * (np.sin(theta) - np.sin(turned))
            theta = turned
            tracks = tracks + h / 0.1 * (limited - tracks)
        left, right = measured.mean(axis=0)
        reported = np.array([(left + right) / 2, (right - left) / width_m])
    return np.array(poses), np.array(z)


@pytest.mark.parametrize("world", WORLDS)
def test_the_closed_loop_drives_and_measures_as_two_tracks_in_numpy(world):
    run = rhec.simulate(rhec.Scenario(**SIMPLE_WORLD | dict(duration_s=30.0) | WORLDS[world]))
    poses, z = driven_in_numpy(run)
    np.testing.assert_allclose(run.log[["x_m", "y_m", "theta_rad"]], poses, rtol=0, atol=1e-8)
    measured = run.log[["x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"]]
    np.testing.assert_allclose(measured, z, rtol=0, atol=1e-8)
    drift = run.log["yaw_drift_radpm"]
    assert drift.std() > 0.005 or world == "tracks at their limit" and 0 < drift.max() < 0.3


def test_slip_of_the_noise_grows_in_proportion_to_the_motion_and_bumps_with_the_way():
    """Variances at 0 to 3 times a motion: a s² + b s, with b where bumps turn the robot alone.

    What the soil changes by depends on how fast the tracks are, whichever way either turns.
    """
    noise = SLIPPING.model.motion_noise
    constants = ca.DM([*noise.constants.values()])
    motion = np.array([0.5, 0.3, 0.0, 0.0, 0.0])
    found = [noise.inputs(ca.DM(s * motion), ca.DM.zeros(5), constants)[1] for s in range(4)]
    rest, once, twice, thrice = (np.array(each).ravel() for each in found)
    np.testing.assert_allclose(thrice - rest, 3 * (twice - once), rtol=1e-9, atol=1e-15)
    *others, turning = (twice - rest) / np.where(once > rest, once - rest, 1)
    np.testing.assert_allclose(others, [0, 0, 4, 4], atol=1e-9)
    assert 2 < turning < 4
    half_width_m = noise.constants["track_width_m"] / 2
    ahead, *others = (
        np.array(noise.process(ca.DM([*u, 0, 0, 0]), ca.DM.ones(7), DT, constants))
        for u in ((0.3, 0.0), (-0.3, 0.0), (0.0, 0.3 / half_width_m), (0.0, -0.3 / half_width_m))
    )
    for other in others:
        np.testing.assert_allclose(other, ahead, rtol=1e-12)


@pytest.mark.parametrize("speed_model", ["slipping", "input"])
def test_a_gyro_bias_walks_as_far_in_two_short_samples_as_in_a_long_one(speed_model):
    """Its variance is σ² t, however the time t is cut, in settings or in the noise of a model."""
    scenario = rhec.Scenario(sensors=("gyro",), speed_model=speed_model)
    model = speed_model_of(speed_model, ("gyro",)).model
    bias = model.joint_names.index("gyro_bias_radps")

    def variance(dt_s):
        settings = settings_of(scenario, dt_s)
        if not model.motion_noise:
            return settings["W"][bias]
        u = ca.DM.zeros(len(model.inputs))
        noise = model.motion_noise.process(u, settings["W"], dt_s, settings["c"])
        return float(noise[bias])

    (gyro,) = records(("gyro",))
    (walk,) = (each.walk for each in gyro.unknowns if each.name == "gyro_bias_radps")
    assert variance(0.1) == pytest.approx(walk**2 * 0.1, rel=1e-12)
    assert variance(0.2) == pytest.approx(2 * variance(0.1), rel=1e-12)


def of_a_circle(omega_radps, sigma_gyro, speed_model):
    """Estimates and variances after 10 s on a circle by perfect sensors."""
    start = (0, 0, 0, 0.5, 1, 1)
    how = dict(speed_model=speed_model, sensors=("gyro",), sigma_gyro=sigma_gyro)
    rhe = rhec.RHE(guess=start, **how)
    _, z = drive(start, np.full(50, omega_radps))
    for row in z[1:]:
        estimate = rhe.step((*row, omega_radps))
    return np.array(estimate[:6]), np.diag(estimate.covariance)


@pytest.mark.parametrize("omega_radps", [0.3, -0.1])
def test_noise_of_a_gyro_in_proportion_to_a_constant_yaw_rate_is_constant_noise(omega_radps):
    """Where tracks slip; other speed models have the constant part alone, as Scenario says."""
    sigma = 0.01
    share = 0.2
    alike = dict(slipping=(np.hypot(sigma, share * omega_radps), 0.0), parameter=(sigma, 0.0))
    for speed_model, constant in alike.items():
        one, of_one = of_a_circle(omega_radps, (sigma, share), speed_model)
        other, of_other = of_a_circle(omega_radps, constant, speed_model)
        np.testing.assert_allclose(one, other, atol=1e-9)
        np.testing.assert_allclose(
            of_one[[0, 1, 2, -2, -1]], of_other[[0, 1, 2, -2, -1]], rtol=1e-6
        )


def test_an_interval_is_linear_in_the_slip_that_was_fitted_to_noise():
    """F(s, v) = F(s, v̄) + B (v - v̄), and its slopes are those at v̄, without slip."""
    of_robot = interval(SLIPPING.model)
    rng = np.random.default_rng(0)
    s, v = rng.normal(size=of_robot.n_s), rng.normal(size=of_robot.n_v)
    without = v * (np.arange(of_robot.n_v) < 2)
    end, *slopes = (np.array(each) for each in of_robot.linearised(s, v, DT))
    there, *expected = (np.array(each) for each in of_robot.linearised(s, without, DT))
    for found, wanted in zip(slopes, expected):
        np.testing.assert_allclose(found, wanted, atol=1e-12)
    np.testing.assert_allclose(there, of_robot.step(s, without, DT), atol=1e-12)
    np.testing.assert_allclose(end[:, 0] - there[:, 0], expected[1] @ (v - without), atol=1e-12)


@pytest.mark.parametrize("speed_mps, place", [(0.0, 4), (0.5, 5)])
def test_an_estimate_of_traction_may_be_none(speed_mps, place):
    """Eq. (14): of tracks that run in place, μ is 0; of a robot that they do not turn, κ is."""
    mhe = rhec.RHE(process_noise="prediction")
    for k in range(100):
        found = mhe.step([1.0 + speed_mps * DT * k, 2.0, 0.5, 0.1])
    assert 0 <= [*found.pose, *found.p][place] < 0.02
