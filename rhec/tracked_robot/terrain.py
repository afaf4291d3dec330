"""Simulated slip fields μ(x, y), κ(x, y): spatially correlated, in (0, 1], with patches of sudden
change.

All fields are cut from one pair of standard Gaussian fields that a geostatistics library (GSTools)
made once and `data/` holds, so that a run never depends on a library's random stream;
`data/make_standard_fields.py` makes that file again.
"""

import functools
from dataclasses import dataclass
from pathlib import Path as File
from typing import Annotated

import casadi as ca
import numpy as np
from pydantic import Field
from scipy.special import betaincinv, ndtr

from rhec.core._casadi.validation import (
    NotNegative,
    Positive,
    Real,
    Traction,
    Whole,
    checked,
    numbers,
    shown,
)

# In a checkout data/ stands beside the package, in a wheel inside it.
_ROOTS = File(__file__).parents[1:3]
STANDARD_FIELDS = next(
    (root / "data" / "standard_gaussian_fields.npz" for root in _ROOTS if (root / "data").is_dir()),
    None,
)

__all__ = [
    "CELLS_PER_LENGTH",
    "LOWEST",
    "QUANTILES",
    "STANDARD_FIELDS",
    "Terrain",
    "beta_quantiles",
    "bilinear",
    "common_shape",
    "flat",
    "gaussian_fields",
    "lookup",
    "random_for",
    "settings",
]
CELLS_PER_LENGTH = 8  # of the standard fields: cells in one correlation length
LOWEST = 0.01  # traction never vanishes: a robot that cannot move teaches nothing
_MOST_CELLS = 4_000_000  # of a random field: a square kilometre
_SMALL_M2 = 10_000.0  # a random field so large, 0.6 MB, or smaller is kept for the next run
QUANTILES = np.linspace(-5, 5, 257)
_MOST_BYTES = 32 * _MOST_CELLS  # of a file, unpacked

Seed = Annotated[Whole, Field(ge=0)]
Patch = tuple[
    Real, Real, Positive, Traction, Traction
]  # disc of sudden change: (x_m, y_m, radius_m, μ, κ)


@dataclass(frozen=True, eq=False)  # the same only if it is itself, so that caches may know it
class Terrain:
    """Traction on a grid: mu[i, j], kappa[i, j] at (x, y) = origin_m + cell_m · (i, j); between the
    points it is bilinear, beyond them constant.
    """

    mu: np.ndarray
    kappa: np.ndarray
    origin_m: tuple
    cell_m: float

    def __post_init__(self):
        for name in ("mu", "kappa"):
            field = numbers(name, getattr(self, name))
            if field.ndim != 2 or min(field.shape) < 2:
                raise ValueError(
                    f"{name} had shape {field.shape}; it must be a grid of at least 2 by 2 points"
                )
            if not (np.all(field > 0) and np.all(field <= 1)):
                raise ValueError(
                    f"{name} ranged from {np.min(field)} to {np.max(field)}; "
                    "traction must lie in (0, 1]"
                )
            object.__setattr__(self, name, field)
        if self.mu.shape != self.kappa.shape:
            raise ValueError(
                f"mu and kappa had shapes {self.mu.shape} and {self.kappa.shape}; "
                "they must be the same"
            )
        origin = numbers("origin_m", self.origin_m)
        cell = numbers("cell_m", self.cell_m)
        if origin.shape != (2,) or not np.all(np.isfinite(origin)):
            raise ValueError(
                f"origin_m was {shown(self.origin_m)}; it must be two finite coordinates"
            )
        if cell.shape or not 0 < cell < np.inf:
            raise ValueError(f"cell_m was {shown(self.cell_m)}; it must be above 0 m")

    @classmethod
    def uniform(cls, mu: float, kappa: float) -> "Terrain":
        """One traction everywhere.

        Args:
            mu: Traction coefficient μ.
            kappa: Traction coefficient κ.

        Returns:
            The Terrain.
        """
        return cls(*([[value, value], [value, value]] for value in (mu, kappa)), (0.0, 0.0), 1.0)

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
        cell_m: Positive = 0.5,
    ) -> "Terrain":
        """Beta-distributed fields, cut from the standard fields.

        Args:
            seed: Places two windows in the standard fields, turns and mirrors them.
            box: (x_min, x_max, y_min, y_max) [m].
            mean: Of (μ, κ).
            deviation: Standard deviation of (μ, κ).
            correlation_length_m: How far traction is alike [m].
            patches: ((x_m, y_m, radius_m, μ, κ), …), discs that replace the field.
            cell_m: Distance of the grid's points [m].

        Returns:
            The Terrain.

        Raises:
            ValueError: In one sentence, for what makes no field.
        """
        x_min, x_max, y_min, y_max = box
        cells = np.ceil(np.array([x_max - x_min, y_max - y_min]) / cell_m)
        if not (np.all(cells >= 1) and np.prod(cells) <= _MOST_CELLS):
            raise ValueError(
                f"box was {shown(box)}; it must be (x_min, x_max, y_min, y_max) with 1 to "
                f"{_MOST_CELLS:,} cells of {cell_m:g} m. "
                "A path or a start that takes the robot so far needs a terrain of its own"
            )
        i, j = (np.arange(int(n) + 1) for n in cells)
        fields = gaussian_fields(seed, len(i), len(j), cell_m, correlation_length_m)
        mu, kappa = map(_beta_from_gaussian, fields, mean, deviation)
        for x, y, radius, mu_patch, kappa_patch in patches:
            dx = x_min + cell_m * i[:, None] - x
            dy = y_min + cell_m * j - y
            inside = dx**2 + dy**2 <= radius * radius
            mu = np.where(inside, mu_patch, mu)
            kappa = np.where(inside, kappa_patch, kappa)
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
        np.savez_compressed(
            file, mu=self.mu, kappa=self.kappa, origin_m=self.origin_m, cell_m=self.cell_m
        )

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
            with np.load(file, allow_pickle=False) as data:
                unpacked = sum(member.file_size for member in data.zip.infolist())
                if unpacked > _MOST_BYTES:
                    raise ValueError(f"unpacked {unpacked:,} bytes, at most {_MOST_BYTES:,}")
                given = (
                    data["mu"],
                    data["kappa"],
                    tuple(data["origin_m"].tolist()),
                    data["cell_m"].item(),
                )
        except (FileNotFoundError, IsADirectoryError, PermissionError):
            raise
        except (
            Exception
        ) as error:  # whatever NumPy and zipfile make of a file that is none of theirs
            raise ValueError(
                f"file was {shown(str(file))}; it should be a field that Terrain.save wrote "
                f"({shown(error)})"
            ) from None
        return cls(*given)


def random_for(scenario, path):
    """The random field a scenario's statistics and seed describe, with a margin around the path."""
    (x_min, x_max, y_min, y_max) = path.box
    margin = 5.0 + abs(scenario.start_offset_m)
    box = x_min - margin, x_max + margin, y_min - margin, y_max + margin
    make = _random if (box[1] - box[0]) * (box[3] - box[2]) < _SMALL_M2 else Terrain.random
    return make(
        scenario.seed,
        box,
        (scenario.mu_mean, scenario.kappa_mean),
        (scenario.mu_deviation, scenario.kappa_deviation),
        scenario.correlation_length_m,
        scenario.patches,
    )


@functools.lru_cache(maxsize=64)  # what runs of a few seeds have in common, not to be written to
def _random(*given):
    terrain = Terrain.random(*given)
    terrain.mu.setflags(write=False), terrain.kappa.setflags(write=False)
    return terrain


def lookup(shape):
    """(xy, origin_m, cell_m, slip) -> traction (2,) = (μ, κ), bilinear on a grid of this shape,
    constant beyond its edges; slip: see `flat`.
    """
    xy = ca.MX.sym("xy", 2)
    origin_m = ca.MX.sym("origin_m", 2)
    cell_m = ca.MX.sym("cell_m")
    slip = ca.MX.sym("slip", 2 * shape[0] * shape[1])
    axes = [np.arange(points, dtype=float) for points in shape]
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
    """Both fields in the order `lookup` reads them, continued to a larger grid of this shape as
    they are beyond their edges.
    """
    rows, columns = terrain.mu.shape
    fields = np.empty((2, *(shape or terrain.mu.shape)), order="F")
    fields[:, :rows, :columns] = terrain.mu, terrain.kappa
    fields[:, rows:, :columns] = fields[:, rows - 1 : rows, :columns]
    fields[:, :, columns:] = fields[:, :, columns - 1 : columns]
    return fields.ravel(order="F")


def settings(terrain, shape):
    """What a run's loop must be told of its soil, on a grid of this shape, by name."""
    place = dict(origin_m=np.array(terrain.origin_m), cell_m=terrain.cell_m)
    return place | dict(slip=flat(terrain, shape), mean_traction=terrain.mean)


def common_shape(terrain, step=160):
    """The next of a few grid shapes, so that another path or start seldom needs compiling."""
    return tuple(-(-points // step) * step for points in terrain.mu.shape)


def _beta_from_gaussian(gaussian, mean, deviation):
    """A standard Gaussian field reshaped, point by point, to the beta distribution on (0, 1) with
    that mean and standard deviation.
    """
    if deviation < 1e-6:  # as good as none, and its square may vanish
        return np.full(gaussian.shape, float(mean))
    values = beta_quantiles(mean, deviation)
    return np.clip(np.interp(gaussian, QUANTILES, values), LOWEST, 1)


@functools.lru_cache
def beta_quantiles(mean, deviation):
    """Values of that beta distribution where the standard normal distribution has QUANTILES."""
    nu = mean * (1 - mean) / deviation**2 - 1
    return betaincinv(mean * nu, (1 - mean) * nu, ndtr(QUANTILES))


@functools.lru_cache(maxsize=1)  # what runs of one seed have in common
def gaussian_fields(seed, n_i, n_j, cell_m, correlation_length_m):
    """Two windows (n_i, n_j) of the standard fields, placed, turned and mirrored by the seed."""
    # generate_state is guaranteed to stay the same between versions of NumPy; a Generator's
    # stream is not
    draws = np.random.SeedSequence(seed).generate_state(8).reshape(2, 4)
    standard, period = _standard_fields()
    fields = []
    for field, (offset_i, offset_j, turn, _) in zip(standard, draws):
        shape = (n_i, n_j) if turn & 1 else (n_j, n_i)
        places = [np.arange(n) * cell_m / correlation_length_m * CELLS_PER_LENGTH for n in shape]
        rows = (places[0] * (1 if turn & 2 else -1) + offset_i) % period
        columns = (places[1] * (1 if turn & 4 else -1) + offset_j) % period
        gaussian = bilinear(field, rows, columns)
        fields.append((gaussian if turn & 1 else gaussian.T) * (1 if turn & 8 else -1))
    return fields


def bilinear(field, rows, columns):
    """A field that repeats itself, given at the corners of square cells, at the crossings (m, n) of
    rows (m,) and columns (n,) in [0, its period), counted in cells.
    """
    i = rows.astype(int)
    j = columns.astype(int)
    u = (rows - i)[:, None]
    v = columns - j
    period = len(field)
    before = period * i[:, None]
    after = period * ((i + 1) % period)[:, None]
    after_j = (j + 1) % period
    return (
        (1 - u) * (1 - v) * field.take(before + j)
        + u * (1 - v) * field.take(after + j)
        + (1 - u) * v * field.take(before + after_j)
        + u * v * field.take(after + after_j)
    )


@functools.cache
def _standard_fields():
    """Two standard Gaussian fields, (2, period, period), one value a cell; and the period."""
    with np.load(STANDARD_FIELDS, allow_pickle=False) as data:
        fields = data["fields"].astype(float)
    return fields, fields.shape[1]
