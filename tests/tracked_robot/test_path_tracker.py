"""References on a path for any Model, by the names of its states."""

import numpy as np
import pytest
from helpers import estimate_of

import rhec

PATH = rhec.Path.from_segments([(5.0, 0.0), (4.0, 0.3), (3.0, -0.5), (9.0, 0.0)], (1.0, 2.0, 0.4))
NAMES = dict(position=("x_m", "y_m"), heading="yaw_rad")


def test_points_are_those_of_the_path_by_names_in_any_order():
    """Oracle: the path's own projection and poses; the estimate moves along the path, beside it."""
    tracker = rhec.PathTracker(PATH, 8, 0.1, look_ahead_m=0.2, speed=0.7, **NAMES)
    papers = rhec.PathTracker(PATH, 8, 0.1, look_ahead_m=0.2)
    for s in np.arange(0.0, 12.0, 0.05):
        (pose,), _ = PATH.poses(np.array([s]))
        left = 0.1 * np.sin(s)
        x, y = pose[:2] + left * np.array([-np.sin(pose[2]), np.cos(pose[2])])
        found = estimate_of(roll=9.0, yaw_rad=pose[2] + 4 * np.pi, y_m=y, x_m=x)
        x_ref, yaw_rates = tracker.references(found)
        _, (closest,) = PATH.project(np.array([[x, y]]))
        assert abs(tracker.s_m - closest) < 1e-3
        wanted, curvature = PATH.poses(tracker.s_m + 0.2 + 0.07 * np.arange(9))
        np.testing.assert_allclose(x_ref[3], wanted[:, 0], atol=1e-9)
        np.testing.assert_allclose(x_ref[2], wanted[:, 1], atol=1e-9)
        np.testing.assert_allclose(x_ref[1], wanted[:, 2] + 4 * np.pi, atol=1e-9)
        assert not x_ref[0].any()
        np.testing.assert_allclose(yaw_rates, 0.7 * curvature[:-1], atol=1e-12)
        xi_ref, _ = papers.references((x, y, pose[2] + 4 * np.pi, 0.7, 1.0, 1.0), 0.0)
        np.testing.assert_allclose(xi_ref, x_ref[[3, 2, 1]], atol=1e-12)


def test_near_the_centre_of_an_arc_the_closest_point_is_followed():
    """As near as 0.23 of its radius, where a step along the path is 0.23 of one along the arc."""
    tracker = rhec.PathTracker(rhec.Path.from_segments([(12.0, 0.5)]), speed=0.7, **NAMES)
    for s in np.arange(0.0, 10.0, 0.05):
        x, y = 0.46 * np.sin(s / 2), 2 - 0.46 * np.cos(s / 2)
        tracker.references(estimate_of(x_m=x, y_m=y, yaw_rad=s / 2))
        assert abs(tracker.s_m - s) < 1e-5


def test_backwards_the_yaw_is_turned():
    ahead, back = (rhec.PathTracker(PATH, speed=v, **NAMES) for v in (0.5, -0.5))
    found = estimate_of(x_m=1.0, y_m=2.0, yaw_rad=0.4)
    turned = estimate_of(x_m=1.0, y_m=2.0, yaw_rad=0.4 + np.pi)
    for _ in range(2):
        first, second = ahead.references(found)[0], back.references(turned)[0]
    np.testing.assert_allclose(second, first + np.array([[0.0], [0.0], [np.pi]]), atol=1e-12)


@pytest.mark.parametrize("options", [NAMES | dict(speed=0.5), {}], ids=["Model", "paper"])
def test_after_a_restart_it_is_as_new(options):
    """Also where the first estimate or yaw rate is not finite."""
    used, new = (rhec.PathTracker(PATH, **options) for _ in range(2))

    def references(tracker, x_m, omega):
        named = estimate_of(x_m=x_m, y_m=3.0, yaw_rad=0.4)
        given = (named,) if options else ((x_m, 3.0, 0.4, 0.5, 0.9, 0.8), omega)
        return [*map(np.copy, tracker.references(*given)), tracker.s_m]

    for x_m in (5.0, 6.0, 7.0):
        references(used, x_m, 0.1)
    used.restart()
    for given in ((np.nan, np.nan), (3.0, np.nan), (4.0, 0.2)):
        np.testing.assert_equal(references(used, *given), references(new, *given))


def test_an_estimate_that_is_not_finite_keeps_the_references_of_the_last():
    tracker, other = (rhec.PathTracker(PATH, speed=0.5, **NAMES) for _ in range(2))
    good = estimate_of(x_m=3.0, y_m=3.0, yaw_rad=0.4)
    for each in (tracker, other):
        each.references(good)
    tracker.references(estimate_of(x_m=np.nan, y_m=3.0, yaw_rad=0.4))
    other.references(good)
    np.testing.assert_array_equal(tracker.references(good)[0], other.references(good)[0])
    assert np.isfinite(tracker.s_m)
