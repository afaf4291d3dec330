"""Named worlds, and the robot of two tracks in the closed loop against one in plain NumPy."""

import numpy as np
import pytest
from helpers import SIMPLE_WORLD

import rhec
from rhec.simulation import closed_loop
from rhec.tracked_robot import plant

pytestmark = pytest.mark.usefixtures("virtual_machine")
DT, SUBSTEPS, WIDTH_M = 0.2, 10, 0.4
ALL_AT_ONCE = dict(
    soil_under="tracks",
    slip_difference=0.04,
    rotation_centre_m=-0.25,
    rut_length_m=0.7,
    bump_sigma_radps=0.03,
    gnss_slow_share=0.8,
    gnss_slow_time_s=400.0,
    duration_s=60.0,
    seed=2003,
)


@pytest.mark.parametrize("name", rhec.WORLDS)
def test_a_world_is_what_differs_from_the_default(name):
    world, default = rhec.WORLDS[name], rhec.Scenario()
    scenario = rhec.Scenario(**world, seed=3)
    assert {field: getattr(scenario, field) for field in world} == world
    assert all(value != getattr(default, field) for field, value in world.items())
    assert bool(world) == (name != "default")


def test_wet_patches_lie_where_the_path_turns_and_on_a_row():
    """The robot drives over each of them, on their soil; docs/world.md says where they are."""
    scenario = rhec.Scenario(**rhec.WORLDS["wet patches"])
    run = rhec.simulate(scenario)
    places = np.array([patch[:2] for patch in scenario.patches])
    _, s = run.path.project(places)
    assert (run.path.poses(s)[1] != 0).tolist() == [True, False, True]
    for x, y, radius_m, mu, kappa in scenario.patches:
        inside = np.hypot(run.log["x_m"] - x, run.log["y_m"] - y) < radius_m
        assert inside.sum() > 30
        assert (run.log.loc[inside, ["mu", "kappa"]].median() == [mu, kappa]).all()


@pytest.mark.parametrize("offset_m", [-3.0, 3.0])
def test_random_soil_lies_under_all_of_the_path_and_under_the_start(offset_m):
    setup = closed_loop.set_up(rhec.Scenario(start_offset_m=offset_m))
    soil = setup.terrain
    low = np.array(soil.origin_m)
    high = low + soil.cell_m * (np.array(soil.mu.shape) - 1)
    x_min, x_max, y_min, y_max = setup.path.box
    assert (low <= np.array([x_min, y_min]) - 3.0).all()
    assert (high >= np.array([x_max, y_max]) + 3.0).all()


def test_runs_of_the_simple_world_are_what_they_are():
    """Poses after 20 s and 59.8 s, as they were recorded."""
    of_rhe = dict(process_noise="printed", arrival_mean="smoothed")
    scenario = rhec.Scenario(**SIMPLE_WORLD, **of_rhe, turns="left", duration_s=60.0)
    log = rhec.simulate(scenario).log
    poses = [
        [9.057221325003816, 0.04861727825686246, 0.020332184396793324],
        [26.760545977761332, -0.06335782519152527, -0.04138414162906666],
    ]
    found = log[["x_m", "y_m", "theta_rad"]].iloc[[100, 299]]
    np.testing.assert_allclose(found, poses, rtol=0, atol=1e-6)


def bilinear(field, terrain, xy):
    place = np.clip(
        (xy - np.array(terrain.origin_m)) / terrain.cell_m, 0, np.array(field.shape) - 1.0
    )
    i, j = np.minimum(place.astype(int), np.array(field.shape) - 2)
    u, v = place - (i, j)
    low = (1 - v) * field[i, j] + v * field[i, j + 1]
    return (1 - u) * low + u * ((1 - v) * field[i + 1, j] + v * field[i + 1, j + 1])


def driven_in_numpy(run):
    """Poses of a robot of two tracks that gets the run's commands and noise, (n, 3).

    Between two steps of the speed loop the point about which it turns moves on an arc.
    """
    s, terrain = run.scenario, run.terrain
    noise = plant.draw_noise(s.seed, len(run.log))
    bumps, encoders = noise[:, 4], noise[:, 5:25].reshape(-1, SUBSTEPS, 2)
    ahead = s.rotation_centre_m
    x, y, theta = run.log[["x_m", "y_m", "theta_rad"]].iloc[0]
    tracks, integral, rut = np.full(2, s.speed_mps), np.zeros(2), None
    poses = []
    for k, omega in enumerate(run.log["omega_cmd_radps"]):
        poses.append((x, y, theta))
        across = WIDTH_M / 2 * np.array([-np.sin(theta), np.cos(theta)])
        places = np.array([x, y]) + across, np.array([x, y]) - across
        mu_left, mu_right = (bilinear(terrain.mu, terrain, place) for place in places)
        mu_left *= 1 - s.slip_difference / 2
        mu_right = min(1.0, mu_right * (1 + s.slip_difference / 2))
        kappa = np.mean([bilinear(terrain.kappa, terrain, place) for place in places])
        speed = tracks.mean()
        keep = np.exp(-(mu_left + mu_right) / 2 * speed * DT / s.rut_length_m)
        rut = bumps[k] if rut is None else keep * rut + np.sqrt(1 - keep**2) * bumps[k]
        bump_radps = s.bump_sigma_radps * rut * speed / 0.5
        target = s.speed_mps + np.array([-1, 1]) * WIDTH_M / 2 * omega
        for step in range(SUBSTEPS):
            h = DT / SUBSTEPS
            measured = tracks + s.encoder_sigma_mps * encoders[k, step]
            wanted = target + (target - measured) + integral
            limited = np.clip(wanted, -1.5, 1.5)
            integral = integral + h * 10 * (target - measured) * (wanted == limited)
            nu, spin = tracks.mean(), (tracks[1] - tracks[0]) / WIDTH_M
            rate = kappa * spin + (mu_right - mu_left) * nu / WIDTH_M
            moved = (mu_left + mu_right) / 2 * nu * h * np.sinc(rate * h / 2 / np.pi)
            x += moved * np.cos(theta + rate * h / 2)
            y += moved * np.sin(theta + rate * h / 2)
            turned = theta + rate * h + bump_radps * h
            x += ahead * (np.cos(theta) - np.cos(turned))
            y += ahead * (np.sin(theta) - np.sin(turned))
            theta = turned
            tracks = tracks + h / 0.1 * (limited - tracks)
    return np.array(poses)


def test_the_closed_loop_drives_as_two_tracks_in_numpy():
    run = rhec.simulate(rhec.Scenario(**SIMPLE_WORLD | ALL_AT_ONCE))
    poses = run.log[["x_m", "y_m", "theta_rad"]]
    np.testing.assert_allclose(poses, driven_in_numpy(run), rtol=0, atol=1e-8)
    drift = run.log["yaw_drift_radpm"]
    assert 0.04 < drift.mean() < 0.2 and drift.std() > 0.005


def test_what_slips_more_on_one_side_turns_while_it_drives_straight():
    """At νμd/b, with nothing else that turns it: no noise, and no command to speak of."""
    d = 0.02
    quiet = dict(encoder_sigma_mps=0.0, bump_sigma_radps=0.0, mu_deviation=0.0)
    scenario = rhec.Scenario(
        **SIMPLE_WORLD | quiet | dict(slip_difference=d),
        omega_max_radps=1e-9,
        start_offset_m=0.0,
        duration_s=20.0,
    )
    yaw = rhec.simulate(scenario).log["theta_rad"].to_numpy()
    np.testing.assert_allclose(np.diff(yaw) / DT, 0.5 * 0.9 * d / WIDTH_M, rtol=0, atol=1e-8)
