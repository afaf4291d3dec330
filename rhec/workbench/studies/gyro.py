"""What a gyro and a heading are worth to the simulated robot, in pairs on the same seeds.

    python -m rhec.workbench.studies.gyro > results.csv

The RHE is the same with and without sensors: one ν an interval, W "consistent", of which σ_ω covers
what the soil turns the robot. Nothing is tuned for the gyro.
"""

import dataclasses
import sys

import numpy as np
import pandas as pd

from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate

SEEDS = range(200)  # held out
WORLDS = {"default": {}, "bumps x 3": dict(bump_sigma_radps=3 * Scenario.bump_sigma_radps)}
# Sensors, and errors of the gyro; "none" is what the others are compared with.
ROBOTS = {
    "none": dict(sensors=()),
    "gyro": dict(sensors=("gyro",)),
    "heading": dict(sensors=("heading",)),
    "gyro and heading": dict(sensors=("gyro", "heading")),
    "gyro, no bias, scale 1": dict(sensors=("gyro",), gyro_bias_radps=0.0, gyro_scale=1.0),
    "gyro, bias 0.05 rad/s": dict(sensors=("gyro",), gyro_bias_radps=0.05, gyro_scale=1.0),
    "gyro, scale 1.05": dict(sensors=("gyro",), gyro_bias_radps=0.0, gyro_scale=1.05),
}
# What a robot's metrics are divided by: those of this robot on the same seeds.
AGAINST = dict.fromkeys(ROBOTS, "none") | dict.fromkeys(
    ("gyro, bias 0.05 rad/s", "gyro, scale 1.05"), "gyro, no bias, scale 1"
)
METRICS = ("mean_error_true_m", "rms_yaw_rad")
_ESTIMATOR = Scenario(speed_model="input", process_noise="consistent")
_NORMAL_95 = 1.96


def measure(seeds=SEEDS, worlds=WORLDS, robots=ROBOTS):
    """Metrics of each run: a DataFrame with the columns world, robot, seed and METRICS."""
    rows = []
    for world, of_world in worlds.items():
        for robot, of_robot in robots.items():
            for seed in seeds:
                fields = dict(of_world) | of_robot
                run = simulate(dataclasses.replace(_ESTIMATOR, seed=seed, **fields))
                values = {name: run.metrics[name] for name in METRICS}
                rows.append(dict(world=world, robot=robot, seed=seed) | values)
    return pd.DataFrame(rows)


def table(runs):
    """Mean of each metric, and its ratio to that of the robot in AGAINST, with 95 % intervals.

    The ratio of two means a/b over n pairs has the standard deviation of (a_i - r b_i)/b̄, over √n
    (the delta method), with r = ā/b̄.

    Args:
        runs: As `measure` returns them.

    Returns:
        A DataFrame with a row for each world, robot and metric.
    """
    rows = []
    for world, of_world in runs.groupby("world", sort=False):
        by_robot = {
            robot: part.set_index("seed") for robot, part in of_world.groupby("robot", sort=False)
        }
        for robot, part in by_robot.items():
            for metric in METRICS:
                ratio = _ratio(part[metric], by_robot[AGAINST[robot]][metric])
                values = dict(metric=metric, **_mean(part[metric]), **ratio, n=len(part))
                rows.append(dict(world=world, robot=robot) | values | dict(against=AGAINST[robot]))
    return pd.DataFrame(rows)


def _mean(values):
    half = _NORMAL_95 * values.std(ddof=1) / np.sqrt(len(values))
    return dict(mean=values.mean(), low=values.mean() - half, high=values.mean() + half)


def _ratio(values, others):
    ratio = values.mean() / others.mean()
    rest = (values - ratio * others) / others.mean()
    half = _NORMAL_95 * rest.std(ddof=1) / np.sqrt(len(rest))
    return dict(ratio=ratio, ratio_low=ratio - half, ratio_high=ratio + half)


if __name__ == "__main__":
    table(measure()).to_csv(sys.stdout, index=False, float_format="%.4g")
