"""Named worlds, and the soil of a scenario."""

import numpy as np
import pytest

import rhec
from rhec.simulation import closed_loop

pytestmark = pytest.mark.usefixtures("virtual_machine")


def test_a_world_is_what_differs_from_the_default():
    for name, world in rhec.WORLDS.items():
        scenario = rhec.Scenario(**world)
        default = rhec.Scenario()
        assert all(getattr(scenario, of) != getattr(default, of) for of in world), name


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
