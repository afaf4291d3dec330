"""The target path and the references on it."""

import functools
import itertools
from typing import get_args

import numpy as np
import pytest

import rhec
from rhec.tracked_robot import references as refs
from rhec.tracked_robot.path import Turns

RACETRACK = rhec.Path.racetrack(30.0, 7.8)
PATTERNS = get_args(Turns)
PATHS = {turns: rhec.Path.rows(30.0, 7.8, turns) for turns in PATTERNS}
PATHS |= {
    "open": rhec.Path.from_segments(
        [(5.0, 0.0), (4.0, 0.3), (3.0, -0.5), (2.0, 0.0)], start=(1.0, 2.0, 0.7)
    ),
    "clockwise circle": rhec.Path.from_segments(
        [(2 * np.pi * 3, -1 / 3)], start=(0.0, 0.0, 1.0), closed=True
    ),
    "more than half a turn": rhec.Path.from_segments([(10.0, 0.5)]),
}
every_path = pytest.mark.parametrize("name", PATHS)
HORIZON = 15


@functools.cache
def references(n_segments, input_reference):
    return refs.build_references(0.2, HORIZON, n_segments, input_reference)


def along(path, s, **given):
    """The references' Function on this path, with ordinary arguments where none are given."""
    segments = given.pop("segments", path.segments)
    function = references(len(segments), given.pop("input_reference", "measured"))
    (pose,), _ = path.poses([s])
    given = (
        dict(
            s_m=s, estimate=[*pose, 0.5, 0.9, 0.8], omega_measured=0.03, look_ahead_m=0, backwards=0
        )
        | given
    )
    result = function(segments=segments.T, period_m=path.period_m, **given)
    return {
        key: np.array(value) if value.numel() > 1 else float(value) for key, value in result.items()
    }


@every_path
def test_segments_without_length_change_no_reference(name):
    path = PATHS[name]
    segments = refs.padded_segments(path)
    assert len(segments) % 12 == 0 and len(segments) - len(path.segments) < 12
    for s in np.linspace(-5, path.length_m + 5, 9):
        filled = along(path, s, segments=segments)
        np.testing.assert_equal(filled, along(path, s))


def test_a_path_may_be_given_as_lists():
    path = PATHS["open"]
    listed = rhec.Path(path.segments.tolist(), path.length_m, path.closed)
    np.testing.assert_array_equal(listed.poses([4.0, 6.0])[0], path.poses([4.0, 6.0])[0])


def test_a_path_may_be_shorter_than_a_metre():
    path = rhec.Path.from_segments([(0.3, 2.0)])
    np.testing.assert_allclose(path.poses([0.2])[0], [[np.sin(0.4) / 2, np.sin(0.2) ** 2, 0.4]])


@pytest.mark.parametrize("turns", PATTERNS)
def test_a_path_turns_to_the_sides_that_it_says(turns):
    """Within 300 s at 0.5 m/s; its rows are as long as asked for."""
    path = PATHS[turns]
    s, c = path.segments[:, 0], path.segments[:, 4]
    sides = dict(alternate=[1, -1, 1], left=[1, 1], right=[-1, -1], figure_of_eight=[1, -1])
    assert list(np.sign(c[(c != 0) & (s < 140.0)])) == sides[turns]
    assert path.closed and path.segments[0].tolist() == [0, 0, 0, 0, 0]
    np.testing.assert_allclose(np.diff([*s, path.length_m])[c == 0][:2], 30.0)
    np.testing.assert_allclose(np.abs(c[c != 0][0]), 1 / 7.8)


@every_path
def test_arc_length_yaw_and_curvature_belong_together(name):
    """dr/ds = (cos θ, sin θ), dθ/ds = c, also where segments meet: there is no step."""
    path, d = PATHS[name], 1e-6
    joints = np.append(path.segments[1:, 0], [path.length_m] if path.closed else [])
    s = np.linspace(0.013, path.length_m - 0.017, 58)
    (here, c), (there, _) = path.poses(s), path.poses(s + d)
    slope = np.column_stack([np.cos(here[:, 2]), np.sin(here[:, 2]), c])
    np.testing.assert_allclose((there - here) / d, slope, atol=1e-5)
    before, after = path.poses(joints - d)[0], path.poses(joints + d)[0]
    np.testing.assert_allclose(before[:, :2], after[:, :2], atol=4 * d)
    np.testing.assert_allclose(np.exp(1j * before[:, 2]), np.exp(1j * after[:, 2]), atol=4 * d)


@every_path
def test_the_projection_is_the_closest_of_finely_sampled_points(name):
    path = PATHS[name]
    s = np.linspace(0, path.length_m - 1e-9, 20_001)
    samples = path.poses(s)[0][:, :2]
    near = samples.min(axis=0) - 3, samples.max(axis=0) + 3
    xy = np.random.default_rng(0).uniform(*near, (40, 2))
    distance, where = path.project(xy)
    brute = np.array([np.hypot(*(samples - point).T).min() for point in xy])
    np.testing.assert_allclose(distance, brute, atol=1e-3)
    assert np.all(distance <= brute + 1e-12)
    there = path.poses(np.minimum(where, s[-1]))[0][:, :2]
    np.testing.assert_allclose(np.hypot(*(there - xy).T), distance, atol=1e-6)


def test_the_closest_point_is_followed_at_the_robots_pace():
    """Two Newton steps a sample keep up with a robot half a metre off, joints included."""
    s, length = 0.0, RACETRACK.length_m
    for place in np.arange(0, 1.2 * length, 0.09):
        (pose,), _ = RACETRACK.poses([place])
        beside = pose + [-0.5 * np.sin(pose[2]), 0.5 * np.cos(pose[2]), 0]
        s = along(RACETRACK, s, estimate=[*beside, 0.5, 0.9, 0.8])["s_m"]
        assert s == pytest.approx(place, abs=0.02)
    assert s > length  # where it counts on


@pytest.mark.parametrize("backwards", [0, 1])
@pytest.mark.parametrize("turns", [-7, 0, 30])
def test_the_yaw_reference_is_in_the_turn_of_the_estimate(turns, backwards):
    """Backwards it is half a turn further."""
    for s, off in itertools.product((3.0, 40.0, 70.0, 100.0), (-3.0, 0.0, 1.0, 3.0)):
        (pose,), _ = RACETRACK.poses([s])
        theta = pose[2] + off + 2 * np.pi * turns
        estimate = [*pose[:2], theta, -0.5 if backwards else 0.5, 0.9, 0.8]
        xi_ref = along(RACETRACK, s, estimate=estimate, backwards=backwards)["xi_ref"]
        assert np.all(np.abs(xi_ref[2] - theta) <= np.pi + 1e-9)
        expected, _ = RACETRACK.poses(s + 0.09 * np.arange(HORIZON + 1))
        np.testing.assert_allclose(xi_ref[:2], expected[:, :2].T, atol=1e-9)
        yaw = expected[:, 2] + np.pi * backwards
        np.testing.assert_allclose(np.exp(1j * xi_ref[2]), np.exp(1j * yaw), atol=1e-9)


def test_a_path_that_comes_back_turned_is_not_closed():
    """A loop of three quarters of a circle ends where it begins, but crosswise."""
    loop = [(1.0, 0.0), (1.5 * np.pi, 1.0), (1.0, 0.0)]
    with pytest.raises(ValueError, match=r"ends .* m and 1\.57 rad from where it begins"):
        rhec.Path.from_segments(loop, closed=True)


def test_a_closed_path_goes_round_and_an_open_one_straight_on_at_both_ends():
    points = along(RACETRACK, RACETRACK.length_m - 0.5)["xi_ref"]
    np.testing.assert_allclose(points[:2, -1], RACETRACK.poses([0.85])[0][0, :2], atol=1e-9)
    path = PATHS["open"]
    points = along(path, path.length_m - 0.5)["xi_ref"].T
    (end,), _ = path.poses([path.length_m - 1e-9])
    onwards = end + [0.85 * np.cos(end[2]), 0.85 * np.sin(end[2]), 0]
    np.testing.assert_allclose(points[-1], onwards, atol=1e-6)
    # As GNSS noise may have it at the start.
    behind = np.array([1.0 - 0.05 * np.cos(0.7), 2.0 - 0.05 * np.sin(0.7), 0.7])
    np.testing.assert_allclose(path.poses([-0.05])[0][0], behind)
    assert along(path, -0.05, estimate=[*behind, 0.5, 0.9, 0.8])["s_m"] == pytest.approx(-0.05)


def test_the_input_reference_is_the_measured_yaw_rate_or_what_the_curve_asks_for():
    np.testing.assert_array_equal(along(RACETRACK, 29.5)["omega_ref"], np.full((1, HORIZON), 0.03))
    omega = along(RACETRACK, 29.5, input_reference="curvature")["omega_ref"].ravel()
    expected = np.where(29.5 + 0.09 * np.arange(HORIZON) >= 30, 0.5 * 0.9 / 7.8 / 0.8, 0)
    np.testing.assert_allclose(omega, expected, atol=1e-12)
    assert 0 < np.count_nonzero(omega) < HORIZON
