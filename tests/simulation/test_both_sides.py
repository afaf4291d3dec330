"""What is done to the world, and what must follow: a loop knows neither left from right nor where
it is.

The drive in a mirror is the mirror image of the drive: the path turns to the other side, the soil
lies on the other side, the other track slips more, and the noise of each sensor points to the other
side. The same holds for a world that is turned by a right angle and moved.
"""

import dataclasses
import functools

import numpy as np
import pytest

import rhec
from rhec.core._casadi import packing
from rhec.simulation.columns import COLUMNS
from rhec.tracked_robot import plant
from rhec.tracked_robot.path import path_of
from rhec.tracked_robot.terrain import random_for

pytestmark = pytest.mark.usefixtures("virtual_machine")
BY_M = 512.0, -2048.0
SHORT = dict(duration_s=30.0, row_length_m=6.0, headland_radius_m=7.0, start_offset_m=0.4)
SOFT = dict(mu_mean=0.85, mu_deviation=0.06, kappa_mean=0.8, kappa_deviation=0.1)
WORLD = rhec.Scenario(**SHORT, **SOFT, turns="left", slip_difference=0.02, start_yaw_rad=0.2)
LOOPS = {
    "RHE printed": dict(process_noise="printed"),
    "RHE by prediction": dict(process_noise="prediction"),
    "RHE, speed as input": dict(speed_model="input", input_reference="curvature"),
    "RHE, slipping": dict(speed_model="slipping"),
    "RHE of the yaw drift with a gyro": dict(
        yaw_drift=True, sensors=("gyro",), gyro_sigma_radps=0.0, gyro_bias_radps=0.0
    ),
    "EKF": dict(estimator="ekf", process_noise="prediction"),
    "EKF by tracking, backwards": dict(
        estimator="ekf", process_noise="tracking", backwards=True, rotation_centre_m=0.2
    ),
    "oracle": dict(estimator="oracle"),
}


def world(**fields):
    """WORLD with its soil as an object."""
    scenario = dataclasses.replace(WORLD, **fields)
    return dataclasses.replace(scenario, terrain=random_for(scenario, path_of(scenario)))


def segments(path, change):
    """A path whose poses (x, y, θ) and curvatures are changed."""
    s, *pose, c = path.segments.T
    return rhec.Path(np.column_stack([s, *change(*pose, c)]), path.length_m, path.closed)


def in_a_mirror(scenario):
    """The world in a mirror along the x axis; its path is the one that turns to the right."""
    soil = scenario.terrain
    last_m = soil.origin_m[1] + (soil.mu.shape[1] - 1) * soil.cell_m
    return dataclasses.replace(
        scenario,
        turns="right",
        terrain=rhec.Terrain(
            soil.mu[:, ::-1], soil.kappa[:, ::-1], (soil.origin_m[0], -last_m), soil.cell_m
        ),
        slip_difference=-scenario.slip_difference,
        start_offset_m=-scenario.start_offset_m,
        start_yaw_rad=-scenario.start_yaw_rad,
        guess_yaw_rad=-scenario.guess_yaw_rad,
    )


def turned_and_moved(scenario):
    """The world turned to the left by a right angle, and then moved by BY_M."""
    soil = scenario.terrain
    last_m = soil.origin_m[1] + (soil.mu.shape[1] - 1) * soil.cell_m
    fields = (np.rot90(field) for field in (soil.mu, soil.kappa))

    def elsewhere(x, y, theta, c):
        return BY_M[0] - y, BY_M[1] + x, theta + np.pi / 2, c

    return dataclasses.replace(
        scenario,
        path=segments(path_of(scenario), elsewhere),
        terrain=rhec.Terrain(*fields, np.add((-last_m, soil.origin_m[0]), BY_M), soil.cell_m),
    )


@functools.cache
def driven(loop):
    """A loop's scenario and its log, before anything is done to the world."""
    scenario = world(**LOOPS[loop])
    return scenario, rhec.simulate(scenario).log


# What becomes of the columns of a log; all others stay as they are.
AFTERWARDS = {
    in_a_mirror: lambda log: {
        name: -log[name]
        for name in (
            "y_m y_meas_m y_hat_m theta_rad theta_hat_rad omega_radps omega_meas_radps "
            "omega_cmd_radps curvature_radpm yaw_drift_radpm yaw_drift_hat_radpm gyro_meas_radps"
        ).split()
        if name in log
    },
    turned_and_moved: lambda log: {
        **{f"x{rest}_m": BY_M[0] - log[f"y{rest}_m"] for rest in ("", "_meas", "_hat")},
        **{f"y{rest}_m": BY_M[1] + log[f"x{rest}_m"] for rest in ("", "_meas", "_hat")},
        **{name: log[name] + np.pi / 2 for name in ("theta_rad", "theta_hat_rad")},
    },
}
# What becomes of the noise.
NOISE_AFTERWARDS = {
    in_a_mirror: lambda white, slow, bump, encoder: dict(
        white=white * [[1], [-1]], slow=slow * [[1], [-1]], bump=-bump, encoder=encoder[::-1]
    ),
    turned_and_moved: lambda white, slow, **same: dict(
        white=white[::-1] * [[-1], [1]], slow=slow[::-1] * [[-1], [1]], **same
    ),
}
# How well a minimum is found depends on rounding, not on the world.
NOT_COMPARED = ("kkt_rhe", "kkt_rhc")


def noise_after(change):
    """The noise of a seed as `plant.draw_noise` draws it, in the world that was changed."""
    draw = plant.draw_noise

    def drawn(seed, samples, faults=()):
        rows = []
        for row in draw(seed, samples, faults):
            noise = packing.unpack_array(row, plant.NOISE)
            speed = noise.pop("speed")
            rows.append(packing.pack_array(NOISE_AFTERWARDS[change](**noise) | dict(speed=speed)))
        return np.array(rows)

    return drawn


@pytest.mark.parametrize("change", AFTERWARDS, ids=lambda change: change.__name__)
@pytest.mark.parametrize("loop", LOOPS)
def test_a_drive_follows_its_world(loop, change, monkeypatch):
    scenario, log = driven(loop)
    expected = log.assign(**AFTERWARDS[change](log)).drop(columns=list(NOT_COMPARED))
    monkeypatch.setattr(plant, "draw_noise", noise_after(change))
    found = rhec.simulate(change(scenario)).log.drop(columns=list(NOT_COMPARED))
    assert set(expected) >= {*COLUMNS} - {*NOT_COMPARED}
    for name in expected:
        one, other = (np.array(each[name], dtype=float) for each in (found, expected))
        if name in ("theta_rad", "theta_hat_rad"):
            # Backwards, a mirror turns the robot by -π in place of π.
            one = other + np.angle(np.exp(1j * (one - other)))
        np.testing.assert_allclose(one, other, atol=1e-6, err_msg=name)
