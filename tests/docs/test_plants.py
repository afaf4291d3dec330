"""The plants of the live page's robot view."""

import numpy as np

from docs.live.plants import plants_of
from rhec import paper
from rhec.simulation import closed_loop
from rhec.simulation.scenario import Scenario


def test_a_robot_in_the_middle_of_its_row_is_one_tolerance_away_from_the_leaves():
    path = closed_loop.set_up(Scenario()).path
    plants = plants_of(path)
    for place, away in ((plants[:, :2], 0.0), (plants[:, 2:], 0.1)):
        distance, _ = path.project(place)
        free = paper.ROBOT_WIDTH_M / 2 + paper.TOLERANCE_M
        np.testing.assert_allclose(distance, free + away, atol=1e-9)
    # Beside four rows of 30 m, of which the first and the last go on by an eighth of the distance
    # of two rows, one plant on either side every 0.15 m; none on the way back along the headland.
    assert len(plants) == 2 * round((4 * 30.0 + 2 * 7.8 / 4) / 0.15)
    assert len(np.unique(plants.round(6), axis=0)) == len(plants)
    assert plants[:, 0].min() > -7.8 / 4 - 0.15
