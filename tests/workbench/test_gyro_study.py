"""The table of what a gyro is worth: pairs on the same seeds, with intervals that cover."""

import numpy as np
import pandas as pd
import pytest

from rhec.workbench.studies import gyro


def made_up(ratio, rng, n=100):
    """Runs of two robots whose seeds differ widely, and one is `ratio` times the other."""
    of_seed = rng.uniform(0.02, 0.2, n)
    rows = []
    for robot, factor in (("none", 1.0), ("gyro", ratio)):
        values = factor * of_seed * (1 + 0.05 * rng.standard_normal(n))
        rows.append(pd.DataFrame(dict(world="w", robot=robot, seed=range(n))))
        rows[-1][list(gyro.METRICS)] = np.column_stack([values, values])
    # The order of the seeds must not matter.
    return pd.concat([rows[0], rows[1].sample(frac=1.0, random_state=0)])


def test_ratios_of_pairs_are_sharp_and_their_intervals_cover():
    rng = np.random.default_rng(0)
    tables = [gyro.table(made_up(0.8, rng)).set_index(["robot", "metric"]) for _ in range(200)]
    rows = [table.loc["gyro", "rms_yaw_rad"] for table in tables]
    # 95 % of 200, within three standard deviations.
    assert 0.90 <= np.mean([row["ratio_low"] < 0.8 < row["ratio_high"] for row in rows]) <= 1.0
    widths = [row["ratio_high"] - row["ratio_low"] for row in rows]
    assert np.mean(widths) < 0.04  # of unpaired robots it would be 0.17
    assert {row["n"] for row in rows} == {100}


def test_the_study_runs_each_robot_on_each_seed():
    robots = {name: gyro.ROBOTS[name] for name in ("none", "heading")}
    runs = gyro.measure(range(1000, 1002), {"default": dict(duration_s=4.0)}, robots)
    assert len(runs) == 4 and runs.notna().all(axis=None)
    assert gyro.table(runs)["ratio"].iloc[0] == pytest.approx(1.0)
