"""What a map of the soil is worth: passes over the same rows, and over rows side by side.

On each field a robot drives the lap without a map, then again with the map of what it measured, and
so on. Every pass has noise of its own. Beside it drive, with the same noise, robots without a map
and robots that are told the truth: the traction oracle, and a robot with the true map, which knows
the yaw drift as well. All have the same weight R in a comparison, or each its own tuned noise and
gains (`rhec.tracked_robot.tuned_loops`); a robot with a map has those of the EKF with yaw drift, of
which the map replaces the noise of the soil. The map of a pass is made from drives with
R = `CHAIN_R`; what they measure hardly depends on R.
"""

import dataclasses
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
from rhec.tracked_robot.tuned_loops import TUNED
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
    "TUNED_GAINS",
    "WITHOUT",
    "best_without",
    "errors",
    "example",
    "lap",
    "ratios",
    "readable_ratios",
    "world",
]

TUNED_GAINS = "tuned"
GAINS = ("10", "0.1", TUNED_GAINS)  # weights R, as texts
CHAIN_R = 0.1
PASSES = (1, 2, 3)
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


class _Drive(NamedTuple):
    """One drive of the study, and its mean true error [m]."""

    way: str
    number: int
    gains: str
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
        constant_yaw = fields["slip_difference"] * self.soil.mean[0] / fields["track_width_m"]
        true_map = SoilMap.of_terrain(self.soil, share)
        self.true_map = dataclasses.replace(true_map, constant_yaw=(constant_yaw, 0.0))

    def drive(self, way, number, **robot):
        """The Run of one robot on the pass of this number."""
        shift_m = paper.ROW_SPACING_M * (number - 1) * (way == SIDE_BY_SIDE)
        place = dict(terrain=self.soil, path=lap(shift_m), seed=self._seed + _SEEDS_APART * number)
        return simulate(Scenario(**self._fields, **place, **robot))

    def maps(self, way, passes, first):
        """The maps before each of the passes, {number: SoilMap}, from that of the first pass on."""
        found = {2: first}
        for number in passes[2:]:
            run = self.drive(way, number - 1, **_with_map(found[number - 1]), r=CHAIN_R)
            found[number] = found[number - 1].update(run)
        return found


def _with_map(soil_map):
    return dict(estimator="map_ekf", soil_map=soil_map)


def _with_gains(robot, gains, tuned):
    """A robot's fields of Scenario with an R, or with tuned noise and gains, or None without any.

    `tuned` has fields by estimator. Robots that are told the soil have the noise of the pose and
    the controller of the EKF with yaw drift.
    """
    if gains != TUNED_GAINS:
        return robot | dict(r=float(gains))
    estimator = robot["estimator"]
    if estimator not in ("map_ekf", "traction_oracle"):
        return tuned.get(estimator)
    like = tuned.get("yaw_drift_ekf")
    return like and robot | {name: like[name] for name in ("q", "r")} | dict(
        sigma_w=tuple(like["sigma_w"][:4])
    )


def _drives_on(seed, fields, passes, gains, tuned):
    """All _Drives on the field of a seed."""
    field = _Field(fields, seed)
    first = field.drive(SAME, 1, **WITHOUT["bounded EKF"], r=CHAIN_R)
    first = SoilMap.from_runs([first])
    rivals = WITHOUT | {
        ORACLE: dict(estimator="traction_oracle"),
        TRUE_MAP: _with_map(field.true_map),
    }
    contestants = [
        (way, number, MAP, _with_map(known))
        for way in (SAME, SIDE_BY_SIDE)
        for number, known in field.maps(way, passes, first).items()
    ]
    contestants += [(SAME, number, *rival) for number in passes[1:] for rival in rivals.items()]
    drives = []
    for way, number, name, robot in contestants:
        for gain in gains:
            equipped = _with_gains(robot, gain, tuned)
            if equipped:
                error_m = field.drive(way, number, **equipped).metrics["mean_error_true_m"]
                drives.append(_Drive(way, number, gain, name, error_m))
    return drives


def errors(name, seeds, passes=PASSES, gains=GAINS):
    """Mean true errors of all robots on the fields of the seeds.

    Args:
        name: Of a `world`.
        seeds: Of the fields.
        passes: Numbers of the passes, from 1 on.
        gains: Weights R as texts, or TUNED_GAINS.

    Returns:
        DataFrame with the columns way, number (of the pass), gains, robot, seed, error_m.
    """
    about = dict(fields=world(name), passes=passes, gains=gains, tuned=TUNED.get(name, {}))
    of_seeds = parallel_map(partial(_drives_on, **about), [*seeds])
    rows = [
        drive._asdict() | dict(seed=seed)
        for seed, drives in zip(seeds, of_seeds)
        for drive in drives
    ]
    return pd.DataFrame(rows)


def best_without(table):
    """The robot without a map whose mean error is the least, for each choice of gains."""
    of_rivals = table[table["robot"].isin(WITHOUT)]
    means = of_rivals.groupby(["gains", "robot"])["error_m"].mean().unstack()
    return means.idxmin(axis=1).to_dict()


def ratios(table):
    """Errors with the map over those of the rivals, paired by field.

    A rival drives the same rows with the noise of the same pass, also where the map's rows lie
    beside them.

    Args:
        table: Of `errors`.

    Returns:
        DataFrame with the columns way, number, gains, quantity, mean, low, high (95 %), n.
    """
    best = best_without(table)
    rows = []
    for gains, part in table.groupby("gains", sort=False):
        errors_m = {
            key: of_robot.set_index("seed")["error_m"]
            for key, of_robot in part.groupby(["robot", "way", "number"], sort=False)
        }
        others = [ORACLE, TRUE_MAP, *([best[gains]] if gains in best else [])]
        for (robot, way, number), own in errors_m.items():
            if robot != MAP:
                continue
            about = dict(way=way, number=number, gains=gains)
            rows.append(about | dict(quantity="error [m]") | over_seeds(np.mean, own)._asdict())
            for name in others:
                other = errors_m[name, SAME, number].reindex(own.index)
                quantity = "over the best without a map" if name in WITHOUT else f"over the {name}"
                interval = over_seeds(ratio_of_means, own, other)._asdict()
                rows.append(about | dict(quantity=quantity) | interval)
    return pd.DataFrame(rows)


def readable_ratios(table):
    """The table of `ratios` for readers: a row a way, gains and quantity, a column a pass."""
    cells = [interval_text(row.mean, row.low, row.high) for row in table.itertuples()]
    shown = table.assign(cell=cells, number=[f"pass {number}" for number in table["number"]])
    order = ["way", "gains", "quantity"]
    return shown.pivot_table("cell", order, "number", aggfunc="first", sort=False)


def example(name, seed, passes=2):
    """The soil of one field and the robot's map of it after some passes over the same rows.

    Args:
        name: Of a `world`.
        seed: Of the field.
        passes: How many.

    Returns:
        The Terrain, the SoilMap, and the last Run.
    """
    field = _Field(world(name), seed)
    run = field.drive(SAME, 1, **WITHOUT["bounded EKF"], r=CHAIN_R)
    known = SoilMap.from_runs([run])
    for number in range(2, passes + 1):
        run = field.drive(SAME, number, **_with_map(known), r=CHAIN_R)
        known = known.update(run)
    return field.soil, known, run
