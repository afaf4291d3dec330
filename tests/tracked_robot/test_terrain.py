"""Simulated slip fields."""

import zipfile

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.special import betainc, ndtri

import rhec
from rhec.tracked_robot import terrain

BOX = (-3.0, 17.0, 5.0, 25.0)
MEAN, DEVIATION = (0.9, 0.8), (0.04, 0.08)


def field(seed, **given):
    return rhec.Terrain.random(
        seed, **dict(box=BOX, mean=MEAN, deviation=DEVIATION, correlation_length_m=4.0) | given
    )


@pytest.fixture(scope="module")
def fields():
    """Four hundred seeds: (400, 2, 41, 41)."""
    return np.array([(each.mu, each.kappa) for each in map(field, range(400))])


def test_each_of_sixteen_draws_turns_or_mirrors_a_field_in_another_way():
    """Each of them shows the whole field, of unlike numbers, that repeats itself."""
    field = 1.0 + np.arange(49).reshape(7, 7)
    step = 1.0, terrain.CELLS_PER_LENGTH
    made = [terrain._window(field, 7, 7, 7, step, (0, 0, turn)) for turn in range(16)]
    assert len({each.tobytes() for each in made}) == 16
    assert all({*np.abs(each).ravel()} == {*field.ravel()} for each in made)


def test_traction_is_above_0_and_at_most_1():
    for seed in range(20):
        wild = field(seed, mean=(0.5, 0.99), deviation=(0.45, 0.05))
        for values in (wild.mu, wild.kappa):
            assert np.all((values > 0) & (values <= 1))


def test_a_seed_is_a_field():
    one, again, other = field(3), field(3), field(4)
    for name in ("mu", "kappa"):
        np.testing.assert_array_equal(getattr(one, name), getattr(again, name))
        assert np.abs(getattr(one, name) - getattr(other, name)).mean() > 0.01
    assert np.abs((one.mu - 0.9) / 0.04 - (one.kappa - 0.8) / 0.08).mean() > 0.1


def test_mean_and_deviation_are_those_asked_for(fields):
    """Within three standard errors over the seeds."""
    for values, mean, deviation in zip(np.moveaxis(fields, 1, 0), MEAN, DEVIATION):
        for statistic, expected in ((values, mean), (np.square(values - mean), deviation**2)):
            each = statistic.mean(axis=(1, 2))
            assert abs(each.mean() - expected) < 3 * each.std() / np.sqrt(len(each))


def test_neighbours_are_alike_and_less_so_with_distance(fields):
    """Gaussian correlation: exp(-π/4 (r/ℓ)²), so exp(-π/4) at one correlation length, in either
    direction; μ and κ know nothing of each other.
    """
    standard = (fields - np.reshape(MEAN, (2, 1, 1))) / np.reshape(DEVIATION, (2, 1, 1))
    for metres in (2.0, 4.0, 8.0):
        cells, expected = int(metres / 0.5), np.exp(-np.pi / 4 * (metres / 4) ** 2)
        for each in (
            standard[:, :, cells:, :] * standard[:, :, :-cells, :],
            standard[:, :, :, cells:] * standard[:, :, :, :-cells],
        ):
            np.testing.assert_allclose(each.mean(axis=(0, 2, 3)), expected, atol=0.06)
    assert abs((standard[:, 0] * standard[:, 1]).mean()) < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_in_finer_cells_its_gaussian_field_is_interpolated(seed):
    """Of cells a third as wide every third point is that of the others; between them it is linear
    in either direction.
    """
    half = dict(mean=(0.5, 0.5), deviation=(0.1, 0.1))  # the beta distribution of α = β = 12
    made = field(seed, **half), field(seed, cell_m=0.5 / 3, **half)
    coarse, fine = (ndtri(betainc(12, 12, each.mu)) for each in made)
    n, m = coarse.shape
    for a in range(3):
        for b in range(3):
            rows = coarse[:-1] + a / 3 * (coarse[1:] - coarse[:-1])
            expected = rows[:, :-1] + b / 3 * (rows[:, 1:] - rows[:, :-1])
            found = fine[a : 3 * (n - 1) : 3, b : 3 * (m - 1) : 3]
            np.testing.assert_allclose(found, expected, atol=1e-2)


def test_a_field_does_not_depend_on_how_much_of_it_is_cut_out():
    small, large = field(5), field(5, box=(BOX[0], BOX[1] + 7, BOX[2], BOX[3] + 3))
    np.testing.assert_allclose(
        large.mu[: small.mu.shape[0], : small.mu.shape[1]], small.mu, atol=1e-12
    )


def test_a_patch_replaces_the_field_within_its_radius():
    plain, patched = (
        field(6),
        field(6, patches=((5.0, 12.0, 3.0, 0.3, 0.2), (5.0, 12.0, 1.0, 0.6, 0.5))),
    )
    x, y = BOX[0] + 0.5 * np.arange(41)[:, None], BOX[2] + 0.5 * np.arange(41)
    distance = np.hypot(x - 5.0, y - 12.0)
    np.testing.assert_array_equal(
        patched.mu, np.select([distance <= 1, distance <= 3], [0.6, 0.3], plain.mu)
    )
    np.testing.assert_array_equal(
        patched.kappa, np.select([distance <= 1, distance <= 3], [0.5, 0.2], plain.kappa)
    )


def test_what_is_saved_is_what_is_loaded(tmp_path):
    made = field(7)
    made.save(tmp_path / "field.npz")
    loaded = rhec.Terrain.load(tmp_path / "field.npz")
    np.testing.assert_array_equal(loaded.mu, made.mu)
    np.testing.assert_array_equal(loaded.kappa, made.kappa)
    assert (loaded.origin_m, loaded.cell_m) == (made.origin_m, made.cell_m) == ((-3.0, 5.0), 0.5)


def test_a_file_that_would_run_code_is_refused(tmp_path):
    mu = np.array([[object()] * 2] * 2, dtype=object)
    file = tmp_path / "field.npz"
    np.savez(file, mu=mu, kappa=np.ones((2, 2)), origin_m=(0, 0), cell_m=1.0)
    with pytest.raises(ValueError, match="allow_pickle"):
        rhec.Terrain.load(file)


def test_a_file_that_unpacks_to_more_than_the_most_is_refused_before_it_is(tmp_path, monkeypatch):
    file = tmp_path / "field.npz"
    field(7).save(file)
    with zipfile.ZipFile(file) as packed:
        size = sum(member.file_size for member in packed.infolist())
    monkeypatch.setattr(terrain, "_MOST_BYTES", size)
    rhec.Terrain.load(file)
    monkeypatch.setattr(terrain, "_MOST_BYTES", size - 1)
    monkeypatch.setattr(np.lib.format, "read_array", pytest.fail)
    with pytest.raises(ValueError, match=f"{size:,} bytes, at most {size - 1:,}"):
        rhec.Terrain.load(file)


def test_between_the_points_it_is_bilinear_and_beyond_them_constant():
    """Also on a larger grid, which several fields have in common."""
    made, rng = field(8, box=(-3.0, 12.0, 5.0, 15.0)), np.random.default_rng(0)
    axes = [origin + made.cell_m * np.arange(n) for origin, n in zip(made.origin_m, made.mu.shape)]
    reference = [RegularGridInterpolator(axes, values) for values in (made.mu, made.kappa)]
    low, high = np.array([[axis[0], axis[-1]] for axis in axes]).T
    corners = [low, high, (low[0], high[1])]
    xy = np.array([*rng.uniform(low - 3, high + 3, (300, 2)), *corners, (-1e6, 1e6)])
    expected = [each(np.clip(xy, low, high)) for each in reference]
    for shape in (made.mu.shape, terrain.common_shape(made)):
        soil = made.origin_m, made.cell_m, terrain.flat(made, shape)
        np.testing.assert_allclose(terrain.lookup(shape)(xy.T, *soil), expected, atol=1e-12)
