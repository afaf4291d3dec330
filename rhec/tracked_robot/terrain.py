"""Simulated slip fields μ(x, y), κ(x, y): spatially correlated, in (0, 1], with patches of sudden
change.

A field is a Gaussian copula: a standard Gaussian field g with the correlation exp(-π/4 (r/ℓ)²) at
the distance r, whose every value becomes that of a beta distribution at the same quantile,
μ = F⁻¹(Φ(g)). So the traction has the wanted mean and deviation, and stays between 0 and 1.

All fields are cut from one pair of standard Gaussian fields that a geostatistics library (GSTools)
made once and `data/` holds, so that a run never depends on a library's random stream;
`data/make_standard_fields.py` makes that file again.
"""

import functools
import io
import zlib
from dataclasses import dataclass
from pathlib import Path as File
from typing import Annotated

import casadi as ca
import numpy as np
from pydantic import Field
from scipy.special import betaincinv, ndtr

from rhec.core._casadi.validation import NotNegative, Positive, Real, Whole, checked, numbers, shown
from rhec.files import replacing
from rhec.tracked_robot.options import Traction

# In a checkout data/ stands beside the package, in a wheel inside it.
_ROOTS = File(__file__).parents[1:3]
STANDARD_FIELDS = next(
    (root / "data" / "standard_gaussian_fields.npz" for root in _ROOTS if (root / "data").is_dir()),
    None,
)

CELLS_PER_LENGTH = 8  # of the standard fields: cells in one correlation length
_LOWEST = 0.01  # traction never vanishes: a robot that cannot move teaches nothing
_QUANTILES = np.linspace(-5, 5, 257)  # of the standard normal distribution
_MARGIN_M = 5.0  # of a field around its path
_CELL_M = 0.5  # of a random field, by default
_MOST_CELLS = 4_000_000  # of a random field: a square kilometre
_SMALL_M2 = 10_000.0  # a random field of this size or less takes 0.6 MB and is cached
_MOST_BYTES = 32 * _MOST_CELLS  # of a file, unpacked
_SHAPE_STEP = 128  # between the shapes of grids for which loops are compiled

Seed = Annotated[Whole, Field(ge=0)]
# A disc of sudden change: (x_m, y_m, radius_m, μ, κ)
Patch = tuple[Real, Real, Positive, Traction, Traction]


# Equal only to itself, so that caches can tell fields apart without comparing them.
@dataclass(frozen=True, eq=False)
class Terrain:
    """Traction on a grid, between whose points it is bilinear, and beyond which it is constant.

    Attributes:
        mu: (m, n) traction μ at (x, y) = origin_m + cell_m · (i, j).
        kappa: (m, n) traction κ at the same points.
        origin_m: (x, y) of the first point [m].
        cell_m: Distance of the points [m].
    """

    mu: np.ndarray
    kappa: np.ndarray
    origin_m: tuple
    cell_m: float

    def __post_init__(self):
        for name in ("mu", "kappa"):
            object.__setattr__(self, name, _checked_field(name, getattr(self, name)))
        if self.mu.shape != self.kappa.shape:
            shapes = f"{self.mu.shape} and {self.kappa.shape}"
            raise ValueError(f"mu and kappa had shapes {shapes}; they must be the same")
        origin = numbers("origin_m", self.origin_m)
        if origin.shape != (2,) or not np.all(np.isfinite(origin)):
            expected = "it must be two finite coordinates"
            raise ValueError(f"origin_m was {shown(self.origin_m)}; {expected}")
        cell = numbers("cell_m", self.cell_m)
        if cell.shape or not 0 < cell < np.inf:
            raise ValueError(f"cell_m was {shown(self.cell_m)}; it must be above 0 m")

    def __repr__(self) -> str:
        rows, columns = self.mu.shape
        mu, kappa = self.mean
        return (
            f"Terrain({rows} by {columns} points of {self.cell_m:g} m, "
            f"mean mu {mu:.3f}, kappa {kappa:.3f})"
        )

    @classmethod
    def uniform(cls, mu: float, kappa: float) -> "Terrain":
        """One traction everywhere.

        Args:
            mu: Traction coefficient μ.
            kappa: Traction coefficient κ.

        Returns:
            The Terrain.
        """
        return cls([[mu, mu], [mu, mu]], [[kappa, kappa], [kappa, kappa]], (0.0, 0.0), 1.0)

    @classmethod
    @checked
    def random(
        cls,
        seed: Seed,
        box: tuple[Real, Real, Real, Real],
        mean: tuple[Traction, Traction],
        deviation: tuple[NotNegative, NotNegative],
        correlation_length_m: Positive,
        patches: tuple[Patch, ...] = (),
        cell_m: Positive = _CELL_M,
    ) -> "Terrain":
        """Beta-distributed fields, cut from the standard fields.

        Args:
            seed: Places two windows in the standard fields, turns and mirrors them.
            box: (x_min, x_max, y_min, y_max) [m].
            mean: Of (μ, κ).
            deviation: Standard deviation of (μ, κ).
            correlation_length_m: Correlation length ℓ of the traction [m].
            patches: ((x_m, y_m, radius_m, μ, κ), …), discs that replace the field.
            cell_m: Distance of the grid's points [m].

        Returns:
            The Terrain.

        Raises:
            ValueError: If an argument is invalid or the box too large.
        """
        x_min, x_max, y_min, y_max = box
        cells = np.ceil(np.array([x_max - x_min, y_max - y_min]) / cell_m)
        if not (np.all(cells >= 1) and np.prod(cells) <= _MOST_CELLS):
            raise ValueError(
                f"box was {shown(box)}; it must be (x_min, x_max, y_min, y_max) with 1 to "
                f"{_MOST_CELLS:,} cells of {cell_m:g} m"
            )
        n_i, n_j = (int(n) + 1 for n in cells)
        fields = _gaussian_fields(seed, n_i, n_j, cell_m, correlation_length_m)
        mu, kappa = map(_beta_from_gaussian, fields, mean, deviation)
        for x, y, radius, mu_inside, kappa_inside in patches:
            dx = x_min + cell_m * np.arange(n_i)[:, None] - x
            dy = y_min + cell_m * np.arange(n_j) - y
            inside = dx**2 + dy**2 <= radius * radius
            mu = np.where(inside, mu_inside, mu)
            kappa = np.where(inside, kappa_inside, kappa)
        return cls(mu, kappa, (float(x_min), float(y_min)), cell_m)

    @property
    def mean(self) -> np.ndarray:
        """Mean (μ, κ) of the field."""
        return np.array([self.mu.mean(), self.kappa.mean()])

    def save(self, file: str | File) -> None:
        """Write the fields as .npz: plain arrays, nothing that is executed on loading.

        Args:
            file: Where to.
        """
        arrays = dict(mu=self.mu, kappa=self.kappa, origin_m=self.origin_m, cell_m=self.cell_m)
        _save_arrays(file, arrays)

    @classmethod
    def load(cls, file: str | File) -> "Terrain":
        """Read the fields that `save` wrote; what is in the file is never executed.

        Args:
            file: Where from.

        Returns:
            The Terrain.

        Raises:
            ValueError: For any other file.
        """
        try:
            arrays = _read_arrays(file)
        except (FileNotFoundError, IsADirectoryError, PermissionError):
            raise
        # NumPy and zipfile raise all kinds of errors for a file that is none of theirs.
        except Exception as error:
            _raise_if_out_of_memory(error)
            raise ValueError(
                f"file was {shown(str(file))}; it should be a field that Terrain.save wrote "
                f"({shown(error)})"
            ) from None
        return cls(*arrays)


def _save_arrays(file, arrays):
    """Write {name: array} as .npz, or leave an older file as it was if writing fails."""
    content = io.BytesIO()
    try:
        np.savez_compressed(content, **arrays)
    except ValueError as error:
        _raise_if_out_of_memory(error)
        raise
    file = File(file)
    if file.suffix != ".npz":
        file = file.with_name(f"{file.name}.npz")
    with replacing(file) as unfinished:
        unfinished.write(content.getvalue())


def _checked_field(name, values):
    """Values as a grid of traction, or one sentence on why they are none."""
    field = numbers(name, values)
    if field.ndim != 2 or min(field.shape) < 2:
        expected = "it must be a grid of at least 2 by 2 points"
        raise ValueError(f"{name} had shape {field.shape}; {expected}")
    if not (np.all(field > 0) and np.all(field <= 1)):
        limits = f"{np.min(field)} to {np.max(field)}"
        raise ValueError(f"{name} ranged from {limits}; traction must lie in (0, 1]")
    return field


def _raise_if_out_of_memory(error):
    """Raise a MemoryError if that is behind an error of zipfile or zlib, which is not the file's.

    zlib's error -4 is Z_MEM_ERROR. If compressing lacks memory, zipfile cannot close the archive,
    and raises a ValueError while it handles the MemoryError.
    """
    lacks_memory = isinstance(error, zlib.error) and str(error).startswith("Error -4 ")
    if lacks_memory or MemoryError in (type(error), type(error.__context__)):
        raise MemoryError("there was not enough memory for the arrays") from None


def _read_arrays(file):
    """(mu, kappa, origin_m, cell_m) of a file, which must not unpack to too much."""
    with np.load(file, allow_pickle=False) as data:
        unpacked = sum(member.file_size for member in data.zip.infolist())
        if unpacked > _MOST_BYTES:
            raise ValueError(f"unpacked {unpacked:,} bytes, at most {_MOST_BYTES:,}")
        origin_m = tuple(data["origin_m"].tolist())
        return data["mu"], data["kappa"], origin_m, data["cell_m"].item()


def box_of(scenario, path):
    """The box of a scenario's random field, that of the path with a margin, and its area [m²].

    Raises:
        ValueError: If it is too large for a random field.
    """
    x_min, x_max, y_min, y_max = path.box
    margin = _MARGIN_M + abs(scenario.start_offset_m)
    box = x_min - margin, x_max + margin, y_min - margin, y_max + margin
    length = box[1] - box[0]
    width = box[3] - box[2]
    if not np.ceil(length / _CELL_M) * np.ceil(width / _CELL_M) <= _MOST_CELLS:
        names = ["path"] if scenario.path else ["row_length_m", "headland_radius_m", "turns"]
        given = ", ".join(f"{name} {shown(getattr(scenario, name))}" for name in names)
        raise ValueError(
            f"start_offset_m was {scenario.start_offset_m!r} with {given}; they need a field of "
            f"{length:.4g} m by {width:.4g} m, and a random one should be at most a square "
            "kilometre: make them smaller, or pass a terrain"
        )
    return box, length * width


def random_for(scenario, path):
    """The random field of a scenario's statistics and seed, with a margin around the path."""
    box, area_m2 = box_of(scenario, path)
    make = _cached_random if area_m2 < _SMALL_M2 else Terrain.random
    return make(
        scenario.seed,
        box,
        (scenario.mu_mean, scenario.kappa_mean),
        (scenario.mu_deviation, scenario.kappa_deviation),
        scenario.correlation_length_m,
        scenario.patches,
    )


@functools.lru_cache(maxsize=64)  # a campaign runs several scenarios on the field of a seed
def _cached_random(*arguments):
    """Terrain.random, whose arrays cannot be written to, since several runs share them."""
    terrain = Terrain.random(*arguments)
    terrain.mu.setflags(write=False)
    terrain.kappa.setflags(write=False)
    return terrain


def lookup(shape):
    """The traction at a place as a Function (xy, origin_m, cell_m, slip) -> traction (2,) = (μ, κ).

    It is bilinear on a grid of this shape and constant beyond its edges. slip: see `flat`.
    """
    xy = ca.MX.sym("xy", 2)
    origin_m = ca.MX.sym("origin_m", 2)
    cell_m = ca.MX.sym("cell_m")
    slip = ca.MX.sym("slip", 2 * shape[0] * shape[1])
    axes = [np.arange(points, dtype=float) for points in shape]
    # "exact": the cell of an evenly spaced grid is computed, not searched.
    grid = ca.interpolant("slip_fields", "linear", axes, 2, {"lookup_mode": ["exact", "exact"]})
    place = ca.fmin(ca.fmax((xy - origin_m) / cell_m, 0), np.array(shape) - 1.0)
    return ca.Function(
        "slip",
        [xy, origin_m, cell_m, slip],
        [grid(place, slip)],
        ["xy", "origin_m", "cell_m", "slip"],
        ["traction"],
    )


def flat(terrain, shape=None):
    """Both fields (2 · rows · columns,) in the order in which `lookup` reads them.

    On a larger grid of the given shape the fields are continued as they are beyond their edges.
    """
    rows, columns = terrain.mu.shape
    fields = np.empty((2, *(shape or terrain.mu.shape)), order="F")
    fields[:, :rows, :columns] = terrain.mu, terrain.kappa
    fields[:, rows:, :columns] = fields[:, rows - 1 : rows, :columns]
    fields[:, :, columns:] = fields[:, :, columns - 1 : columns]
    return fields.ravel(order="F")


def settings(terrain, shape):
    """The soil's settings of a run's loop by name, on a grid of this shape."""
    return dict(
        origin_m=np.array(terrain.origin_m),
        cell_m=terrain.cell_m,
        slip=flat(terrain, shape),
        mean_traction=terrain.mean,
    )


def common_shape(terrain):
    """The next of a few grid shapes, so that another path or start seldom needs compiling."""
    return tuple(-(-points // _SHAPE_STEP) * _SHAPE_STEP for points in terrain.mu.shape)


def _beta_from_gaussian(gaussian, mean, deviation):
    """A standard Gaussian field g, point by point as F⁻¹(Φ(g)) of the beta distribution F."""
    if deviation < 1e-6:  # as good as none, and its square may vanish
        return np.full(gaussian.shape, float(mean))
    values = _beta_quantiles(mean, deviation)
    return np.clip(np.interp(gaussian, _QUANTILES, values), _LOWEST, 1)


@functools.lru_cache
def _beta_quantiles(mean, deviation):
    """Values of the beta distribution on (0, 1) where the standard normal one has _QUANTILES.

    Its parameters are α = m ν and β = (1 - m) ν, with ν = m (1 - m) / σ² - 1 for the mean m and
    the deviation σ.
    """
    nu = mean * (1 - mean) / deviation**2 - 1
    return betaincinv(mean * nu, (1 - mean) * nu, ndtr(_QUANTILES))


@functools.lru_cache(maxsize=1)  # runs of one seed follow each other
def _gaussian_fields(seed, n_i, n_j, cell_m, correlation_length_m):
    """Two windows (n_i, n_j) of the standard fields, placed, turned and mirrored by the seed."""
    # NumPy guarantees generate_state to stay the same between versions, a Generator's stream not.
    draws = np.random.SeedSequence(seed).generate_state(8).reshape(2, 4)
    standard, period = _standard_fields()
    step = cell_m, correlation_length_m
    return [
        _window(field, period, n_i, n_j, step, draw[:3]) for field, draw in zip(standard, draws)
    ]


def _window(field, period, n_i, n_j, step, draw):
    """A window (n_i, n_j) of a standard field; each bit of the third draw turns or mirrors it."""
    cell_m, correlation_length_m = step
    offset_i, offset_j, turn = draw
    is_upright = turn & 1
    shape = (n_i, n_j) if is_upright else (n_j, n_i)
    i, j = (np.arange(n) * cell_m / correlation_length_m * CELLS_PER_LENGTH for n in shape)
    rows = (i * (1 if turn & 2 else -1) + offset_i) % period
    columns = (j * (1 if turn & 4 else -1) + offset_j) % period
    gaussian = _bilinear(field, rows, columns)
    return (gaussian if is_upright else gaussian.T) * (1 if turn & 8 else -1)


def _bilinear(field, rows, columns):
    """A field that repeats itself, interpolated at the crossings of rows (m,) and columns (n,).

    The rows and columns are places in [0, period), in cells; the result is (m, n).
    """
    i = rows.astype(int)
    j = columns.astype(int)
    u = (rows - i)[:, None]
    v = columns - j
    period = len(field)
    # Places in the flattened field, of which `take` is much faster than of two indices.
    row = period * i[:, None]
    next_row = period * ((i + 1) % period)[:, None]
    next_j = (j + 1) % period
    return (
        (1 - u) * (1 - v) * field.take(row + j)
        + u * (1 - v) * field.take(next_row + j)
        + (1 - u) * v * field.take(row + next_j)
        + u * v * field.take(next_row + next_j)
    )


@functools.cache
def _standard_fields():
    """Two standard Gaussian fields, (2, period, period), one value a cell; and the period."""
    with np.load(STANDARD_FIELDS, allow_pickle=False) as data:
        fields = data["fields"].astype(float)
    return fields, fields.shape[1]
