"""What a map of the soil is worth: passes over the same rows, and over rows side by side.

On each field a robot drives the lap without a map, then again with the map of what it measured, and
so on. Every pass has noise of its own. Beside it drive, with the same noise, robots without a map
and robots that are told the truth: the traction oracle, and a robot with the true map, which knows
the yaw drift as well. All have the same weight R in a comparison. The map of a pass is made from
drives with R = `CHAIN_R`; what they measure hardly depends on R.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.simulation.worlds import WORLDS
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.soil_map import SoilMap
from rhec.workbench.studies.claims.run_sets import parallel_map
from rhec.workbench.studies.statistics import interval_text, over_seeds, ratio_of_means

__all__ = [
    "AIMS",
    "CHAIN_R",
    "GAINS",
    "MAP",
    "ORACLE",
    "PASSES",
    "SAME",
    "SIDE_BY_SIDE",
    "TRUE_MAP",
    "WITHOUT",
    "errors",
    "example",
    "lap",
    "ratios",
    "readable_ratios",
    "world",
]

GAINS = (10.0, 1.0, 0.1)
CHAIN_R = 0.1
PASSES = (1, 2, 3, 4)
SAME = "same rows"
SIDE_BY_SIDE = "rows side by side"
MAP = "with the map"
ORACLE = "traction oracle"
TRUE_MAP = "true map"
# Estimators without a map, which is what pass 1 has.
WITHOUT = {
    "bounded EKF": dict(estimator="bounded_ekf", process_noise="calibrated"),
    "yaw drift EKF": dict(estimator="yaw_drift_ekf", process_noise="calibrated"),
    "map EKF without a map": dict(estimator="map_ekf"),
}
# Set before the study: the error over that of the traction oracle, and of the best without a map.
AIMS = dict(oracle=1.05, without=0.90)
# Each pass has noise of its own: that of this number of seeds further on.
_SEEDS_APART = 10_000
# Rivals drive with the noise of these passes: they do not learn from pass to pass.
_RIVALS_AT = (2,)


class _Drive(NamedTuple):
    """One drive of the study, and its mean true error [m]."""

    way: str
    number: int
    r: float
    robot: str
    error_m: float


def world(name):
    """The fields of a world of the study.

    Args:
        name: One of rhec.WORLDS, or one of them with ", each track on its own soil".

    Returns:
        {name: value} of Scenario's fields.
    """
    base, *own = name.split(", ")
    return WORLDS[base] | (dict(soil_under="tracks") if own else {})


def lap(shift_m=0.0):
    """The paper's lap as a Path, moved to the left of its first row by `shift_m` [m]."""
    radius_m = paper.HEADLAND_RADIUS_M
    pieces = [(paper.ROW_LENGTH_M, 0.0), (np.pi * radius_m, 1 / radius_m)]
    return Path.from_segments(pieces * 2, (0.0, shift_m, 0.0), closed=True)


class _Field:
    """One field, with its soil, on which robots drive pass by pass."""

    def __init__(self, fields, seed):
        self._fields = fields
        self._seed = seed
        # The soil is that of the seed; the noise is that of a pass.
        self.soil = simulate(Scenario(**fields, seed=seed, duration_s=1.0)).terrain
        share = float(fields["soil_under"] == "tracks")
        self.true_map = SoilMap.of_terrain(self.soil, share)

    def drive(self, way, number, r, **robot):
        """The Run of one robot on the pass of this number."""
        shift_m = paper.ROW_SPACING_M * (number - 1) * (way == SIDE_BY_SIDE)
        place = dict(terrain=self.soil, path=lap(shift_m), seed=self._seed + _SEEDS_APART * number)
        return simulate(Scenario(**self._fields, **place, r=r, **robot))

    def maps(self, way, passes, first):
        """The maps before each of the passes, {number: SoilMap}, from that of the first pass on."""
        found = {2: first}
        for number in passes[2:]:
            run = self.drive(way, number - 1, CHAIN_R, **_told(found[number - 1]))
            found[number] = found[number - 1].update(run)
        return found


def _told(soil_map):
    return dict(estimator="map_ekf", soil_map=soil_map)


def _drives_on(seed, fields, passes, gains):
    """All _Drives on the field of a seed."""
    field = _Field(fields, seed)
    first = SoilMap.from_runs([field.drive(SAME, 1, CHAIN_R, **WITHOUT["bounded EKF"])])
    rivals = WITHOUT | {ORACLE: dict(estimator="traction_oracle"), TRUE_MAP: _told(field.true_map)}
    drives = []
    for way in (SAME, SIDE_BY_SIDE):
        contestants = [
            (number, MAP, _told(known)) for number, known in field.maps(way, passes, first).items()
        ]
        contestants += [(number, *rival) for number in _RIVALS_AT for rival in rivals.items()]
        for r in gains:
            for number, name, robot in contestants:
                error_m = field.drive(way, number, r, **robot).metrics["mean_error_true_m"]
                drives.append(_Drive(way, number, r, name, error_m))
    return drives


def errors(fields, seeds, passes=PASSES, gains=GAINS):
    """Mean true errors of all robots on the fields of the seeds.

    Args:
        fields: {name: value} of Scenario's fields, a world.
        seeds: Of the fields.
        passes: Numbers of the passes, from 1 on.
        gains: Weights R.

    Returns:
        DataFrame with the columns way, number (of the pass), r, robot, seed, error_m.
    """
    of_seeds = parallel_map(
        partial(_drives_on, fields=fields, passes=passes, gains=gains), [*seeds]
    )
    rows = [
        drive._asdict() | dict(seed=seed)
        for seed, drives in zip(seeds, of_seeds)
        for drive in drives
    ]
    return pd.DataFrame(rows)


def best_without(table):
    """The robot without a map whose mean error is the least, for each R: {r: name}."""
    of_rivals = table[table["robot"].isin(WITHOUT)]
    means = of_rivals.groupby(["r", "robot"])["error_m"].mean().unstack()
    return means.idxmin(axis=1).to_dict()


def ratios(table):
    """Errors with the map over those of the rivals, paired by field.

    The noise of a rival is that of another pass where it did not drive in the same one, so the
    pairs share the soil but not the noise there.

    Args:
        table: Of `errors`.

    Returns:
        DataFrame with the columns way, number, r, quantity ("error [m]", "over …"), mean, low, high
        (95 %), n.
    """
    best = best_without(table)
    rows = []
    for (way, r), part in table.groupby(["way", "r"], sort=False):
        robots = {
            name: of_robot.pivot(index="seed", columns="number", values="error_m")
            for name, of_robot in part.groupby("robot")
        }
        others = {f"over {ORACLE}": ORACLE, f"over {TRUE_MAP}": TRUE_MAP}
        others[f"over the best without a map ({best[r]})"] = best[r]
        for number, mapped in robots[MAP].items():
            about = dict(way=way, number=number, r=r)
            rows.append(about | dict(quantity="error [m]") | over_seeds(np.mean, mapped)._asdict())
            for quantity, name in others.items():
                at = min(_RIVALS_AT, key=lambda rival: abs(rival - number))
                interval = over_seeds(ratio_of_means, mapped, robots[name][at])
                rows.append(about | dict(quantity=quantity) | interval._asdict())
    return pd.DataFrame(rows)


def readable_ratios(table):
    """The table of `ratios` for readers: a row for each way, R and quantity, a column a pass."""
    cells = [interval_text(row.mean, row.low, row.high) for row in table.itertuples()]
    shown = table.assign(cell=cells, number=[f"pass {number}" for number in table["number"]])
    return shown.pivot_table(
        "cell", ["way", "r", "quantity"], "number", aggfunc="first", sort=False
    )


def example(fields, seed, passes=2):
    """The soil of one field and the robot's map of it after some passes over the same rows.

    Args:
        fields: {name: value} of Scenario's fields, a world.
        seed: Of the field.
        passes: How many.

    Returns:
        The Terrain, the SoilMap, and the last Run.
    """
    field = _Field(fields, seed)
    run = field.drive(SAME, 1, CHAIN_R, **WITHOUT["bounded EKF"])
    known = SoilMap.from_runs([run])
    for number in range(2, passes + 1):
        run = field.drive(SAME, number, CHAIN_R, **_told(known))
        known = known.update(run)
    return field.soil, known, run
