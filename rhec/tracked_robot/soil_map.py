"""The map of the soil that earlier drives leave: mean and standard deviation of (μ, κ) on a grid.

A map is made of what the robot measured on its drives, never of the truth. `soil_pass` smooths each
drive, and `soil_field` makes a Gaussian process of all of them. `Scenario(soil_map=…)` with the
estimator "map_ekf" (`rhec.tracked_robot.map_ekf`) drives with it.
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path as File
from typing import Any

import numpy as np

from rhec import paper
from rhec.core._casadi.validation import refuse, shown
from rhec.tracked_robot import terrain, tuning
from rhec.tracked_robot.options import numbers

_CELL_M = 1.0  # a quarter of the simulated soil's correlation length
_MARGIN_M = 5.0  # of a map around the drives that it knows
_MOST_CELLS = 250_000  # of a map; a drive through one of this size takes 20 MB
_MOST_BYTES = 1_000_000_000  # of a file, unpacked
_MEASURED = ("x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps")
_ESTIMATED = ("x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps")
_GRIDS = ("mu", "kappa", "sigma_mu", "sigma_kappa", "slope_x", "slope_y", "sigma_slope")
_OTHERS = ("origin_m", "cell_m", "length_m", "constant_yaw", "statistics")
# No map is surer of the soil than this: soil changes between two drives, and tracks change it.
_LEAST_SIGMA = dict(mu=0.005, kappa=0.01, yaw=0.002)
# A robot without a map. With so long a correlation the traction is a random walk; per sample it has
# the noise that is the likeliest for the bounded EKF (`tuning`), and (last) for its drift in yaw.
# The length lets even the smallest noise there, 0.001, reach traction of any value: σ > 0.3.
_UNKNOWN_LENGTH_M = 20_000.0
_WALK = (*tuning.SIGMA_W["bounded_ekf"]["calibrated"][4:], 1e-4)


# Equal only to itself, so that caches can tell maps apart without comparing them.
@dataclass(frozen=True, eq=False, repr=False)
class SoilMap:
    """What is known of the soil, on a grid; bilinear between its points, constant beyond them.

    A robot whose tracks stand on unlike soil turns by g = (μ_r - μ_l) / b [1/m] for each metre that
    its tracks run. The map tells g by the slope of μ, times the share with which it turned the
    robot on earlier drives, and by what turned it everywhere.

    Attributes:
        mu: (m, n) mean of μ at (x, y) = origin_m + cell_m · (i, j).
        kappa: (m, n) mean of κ.
        sigma_mu: (m, n) standard deviation of μ.
        sigma_kappa: (m, n) standard deviation of κ.
        origin_m: (x, y) of the first point [m].
        cell_m: Distance of the points [m].
        length_m: Correlation length of the soil [m].
        slope_x: (m, n) share of the tracks' own soil times ∂μ/∂x [1/m]; None: 0.
        slope_y: (m, n) the same by y.
        sigma_slope: (m, n) standard deviation of both slopes [1/m]; None: 0.
        constant_yaw: Mean and standard deviation of the part of g that is alike everywhere [1/m].
        statistics: The `soil_field.Statistics` that the drives made likely, or None.
        evidence: What the drives said, a `soil_pass.Evidence`, to which `update` adds, or None.
    """

    mu: np.ndarray
    kappa: np.ndarray
    sigma_mu: np.ndarray
    sigma_kappa: np.ndarray
    origin_m: tuple
    cell_m: float
    length_m: float
    slope_x: np.ndarray | None = None
    slope_y: np.ndarray | None = None
    sigma_slope: np.ndarray | None = None
    constant_yaw: tuple = (0.0, 0.0)
    statistics: tuple | None = None
    evidence: tuple | None = None

    def __post_init__(self):
        for name in _GRIDS:
            values = getattr(self, name)
            if values is None:
                values = np.zeros(np.shape(self.mu))
            object.__setattr__(self, name, _checked_grid(name, values, np.shape(self.mu)))
        for name, least in (("origin_m", -np.inf), ("cell_m", 0.0), ("length_m", 0.0)):
            values = numbers(name, getattr(self, name))
            shape = (2,) if name == "origin_m" else ()
            if values.shape != shape or not (np.isfinite(values).all() and np.all(values > least)):
                expected = "two finite coordinates" if shape else "a length above 0 m"
                raise ValueError(f"{name} was {shown(getattr(self, name))}; it must be {expected}")

    def __repr__(self) -> str:
        rows, columns = self.mu.shape
        known = "" if self.evidence is None else f", from {len(self.evidence.place_m)} places"
        return f"SoilMap({rows} by {columns} points of {self.cell_m:g} m{known})"

    @classmethod
    def from_runs(
        cls,
        runs: Iterable[Any],
        sigma_v: tuple[float, ...] = paper.SIGMA_V,
        sigma_w: tuple[float, ...] | None = None,
    ) -> "SoilMap":
        """Make a map of what one or more drives measured.

        Args:
            runs: rhec.Runs; their measurements count, and their estimates are where the smoother
                begins.
            sigma_v: Standard deviations of the measurements (x, y, ν, ω) [m, m, m/s, rad/s].
            sigma_w: Standard deviations of the process noise of (x, y, θ, ν) per sample; None:
                those of the estimator "map_ekf".

        Returns:
            The SoilMap; of no drive, one that knows nothing.

        Raises:
            ValueError: If an argument is no list of runs with columns of measurements.
        """
        evidences = [_evidence_of(run, sigma_v, sigma_w) for run in _listed(runs)]
        return _learned(evidences) if evidences else unknown()

    def update(
        self,
        run: Any,
        sigma_v: tuple[float, ...] = paper.SIGMA_V,
        sigma_w: tuple[float, ...] | None = None,
    ) -> "SoilMap":
        """Make a map of the drives of this one and of another one.

        Args:
            run: The rhec.Run of the other drive.
            sigma_v: As in `from_runs`.
            sigma_w: As in `from_runs`.

        Returns:
            The SoilMap.

        Raises:
            ValueError: If `run` has no columns of measurements.
        """
        known = [self.evidence] if self.evidence else []
        return _learned([*known, _evidence_of(run, sigma_v, sigma_w)], self.statistics)

    @classmethod
    def of_terrain(
        cls, soil: terrain.Terrain, track_share: float = 0.0, length_m: float = 4.0
    ) -> "SoilMap":
        """Make a map that knows a simulated field exactly, the limit for every map.

        Args:
            soil: The rhec.Terrain.
            track_share: 1 where each track stands on the soil under it, 0 where none does.
            length_m: Correlation length of the soil [m].

        Returns:
            The SoilMap.
        """
        nothing = np.zeros(soil.mu.shape)
        slopes = track_share * np.array(np.gradient(soil.mu, soil.cell_m))
        known = soil.mu, soil.kappa, nothing, nothing, soil.origin_m, soil.cell_m, length_m
        return cls(*known, *slopes, nothing)

    def save(self, file: str | File) -> None:
        """Write the map as .npz: plain arrays, nothing that is executed on loading.

        Args:
            file: Where to.
        """
        arrays = {name: getattr(self, name) for name in (*_GRIDS, *_OTHERS)}
        if self.statistics is None:
            del arrays["statistics"]
        if self.evidence is not None:
            arrays |= self.evidence._asdict()
        terrain.save_arrays(file, arrays)

    @classmethod
    def load(cls, file: str | File) -> "SoilMap":
        """Read the map that `save` wrote; what is in the file is never executed.

        Args:
            file: Where from.

        Returns:
            The SoilMap.

        Raises:
            ValueError: For any other file.
        """
        try:
            return cls(**_read(file))
        except (FileNotFoundError, IsADirectoryError, PermissionError):
            raise
        # NumPy and zipfile raise all kinds of errors for a file that is none of theirs.
        except Exception as error:
            terrain.raise_if_out_of_memory(error)
            raise ValueError(
                f"file was {shown(str(file))}; it should be a map that SoilMap.save wrote "
                f"({shown(error)})"
            ) from None


def _checked_grid(name, values, shape):
    """Values as a grid of this shape, or one sentence on why they are none."""
    grid = numbers(name, values)
    if grid.ndim != 2 or min(grid.shape) < 2 or grid.shape != shape or grid.size > _MOST_CELLS:
        expected = f"it must be a grid of at least 2 by 2 and at most {_MOST_CELLS:,} points"
        raise ValueError(f"{name} had shape {grid.shape}; {expected}, the same for all")
    is_sigma = name.startswith("sigma")
    if not np.isfinite(grid).all() or (is_sigma and grid.min() < 0):
        limits = "finite numbers, at least 0" if is_sigma else "finite numbers"
        raise ValueError(f"{name} ranged from {grid.min()} to {grid.max()}; it must be {limits}")
    return grid


def _listed(runs):
    if not isinstance(runs, Iterable) or isinstance(runs, str | dict):
        refuse("runs was", runs, "it should be a list of rhec.Run")
    return list(runs)


def _evidence_of(run, sigma_v, sigma_w):
    # What learns a map is imported where one is learned: most runs have none, and it loads solvers.
    from rhec.tracked_robot import soil_pass

    sigma_w = sigma_w or tuning.SIGMA_W["map_ekf"]["calibrated"]
    columns = getattr(run, "columns", None)
    if not isinstance(columns, dict) or any(name not in columns for name in _MEASURED + _ESTIMATED):
        refuse("run was", run, "it should be a rhec.Run, with columns of what was measured")
    z = np.column_stack([columns[name] for name in _MEASURED])
    first = np.column_stack([columns[name] for name in _ESTIMATED])
    return soil_pass.evidence_of(z, first, sigma_v, sigma_w, paper.DT_S)


def _learned(evidences, first=None):
    """The map of what several drives say; the search of its statistics may begin at `first`."""
    from rhec.tracked_robot import soil_field

    evidence = soil_field.merged(evidences)
    statistics = soil_field.likeliest(evidence, first or soil_field.FIRST)
    return of_evidence(evidence, statistics, *_grid_around(evidence.place_m))


def _grid_around(place_m):
    """Origin [m] and shape of a grid around places (n, 2) [m]."""
    low = place_m.min(axis=0) - _MARGIN_M
    high = place_m.max(axis=0) + _MARGIN_M
    return tuple(low.tolist()), tuple(np.ceil((high - low) / _CELL_M).astype(int) + 1)


def of_evidence(evidence, statistics, origin_m, shape):
    """The SoilMap of an Evidence under the Statistics, on a grid of this origin [m] and shape."""
    from rhec.tracked_robot import soil_field

    i, j = np.indices(shape)
    place_m = np.array(origin_m) + _CELL_M * np.column_stack([i.ravel(), j.ravel()])
    field = soil_field.posterior(evidence, statistics, place_m)
    mean = field.mean.reshape(4, *shape)
    variance = field.variance.reshape(4, *shape)
    yaw, its_variance = field.constant_yaw
    return SoilMap(
        mu=mean[0],
        kappa=mean[1],
        sigma_mu=np.sqrt(variance[0]),
        sigma_kappa=np.sqrt(variance[1]),
        origin_m=origin_m,
        cell_m=_CELL_M,
        length_m=statistics.length_m,
        slope_x=mean[2],
        slope_y=mean[3],
        sigma_slope=np.sqrt(variance[2:].mean(axis=0)),
        constant_yaw=(float(yaw), float(np.sqrt(its_variance))),
        statistics=statistics,
        evidence=evidence,
    )


@functools.cache
def unknown():
    """The map of a robot without one: traction of any value, which is a random walk."""
    per_metre = np.square(_WALK) / (paper.SPEED_MPS * paper.DT_S)
    sigma = np.sqrt(per_metre * _UNKNOWN_LENGTH_M / 2)
    grid = np.ones((2, 2))
    return SoilMap(
        mu=grid,
        kappa=grid,
        sigma_mu=sigma[0] * grid,
        sigma_kappa=sigma[1] * grid,
        origin_m=(0.0, 0.0),
        cell_m=1.0,
        length_m=_UNKNOWN_LENGTH_M,
        constant_yaw=(0.0, float(sigma[2])),
    )


def _read(file):
    """The fields of a map by name from a file, which must not unpack to too much."""
    with np.load(file, allow_pickle=False) as data:
        unpacked = sum(member.file_size for member in data.zip.infolist())
        if unpacked > _MOST_BYTES:
            raise ValueError(f"unpacked {unpacked:,} bytes, at most {_MOST_BYTES:,}")
        fields = {name: data[name] for name in _GRIDS}
        fields |= {name: tuple(data[name].tolist()) for name in ("origin_m", "constant_yaw")}
        fields |= {name: data[name].item() for name in ("cell_m", "length_m")}
        if "statistics" in data:
            from rhec.tracked_robot.soil_field import Statistics
            from rhec.tracked_robot.soil_pass import Evidence

            fields["statistics"] = Statistics(*data["statistics"].tolist())
            fields["evidence"] = Evidence(*(data[name] for name in Evidence._fields))
    return fields


# What a run's loop is told of the map


def map_of(scenario):
    """The map that a Scenario's estimator is told."""
    return scenario.soil_map or unknown()


def common_shape(soil_map, step=32):
    """The next of a few grid shapes, so that another map seldom needs compiling."""
    points = soil_map.mu.shape
    # The map of a robot that knows nothing is the same everywhere.
    return points if max(points) == 2 else tuple(-(-n // step) * step for n in points)


def settings(soil_map):
    """The map's settings of a run's loop by name, on the grid of `common_shape`."""
    shape = common_shape(soil_map)
    yaw, sigma_yaw = soil_map.constant_yaw
    is_unknown = soil_map is unknown()
    least = dict.fromkeys(_LEAST_SIGMA, 0.0) if is_unknown else _LEAST_SIGMA
    variance = [
        np.maximum(getattr(soil_map, f"sigma_{name}"), least[name]) ** 2 for name in ("mu", "kappa")
    ]
    of_yaw = soil_map.sigma_slope**2 + max(sigma_yaw, least["yaw"]) ** 2
    pairs = dict(
        map_traction=(soil_map.mu, soil_map.kappa),
        map_slope=(soil_map.slope_x, soil_map.slope_y),
        map_variance=variance,
        map_yaw_variance=(of_yaw, of_yaw),
    )
    return {name: terrain.flat_pair(*grids, shape) for name, grids in pairs.items()} | dict(
        map_origin_m=np.array(soil_map.origin_m),
        map_cell_m=soil_map.cell_m,
        map_length_m=soil_map.length_m,
        map_yaw=yaw,
    )
