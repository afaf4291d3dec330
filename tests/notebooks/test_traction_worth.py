"""Tables and pictures of what estimating traction is worth, from errors that are made up."""

import numpy as np
import pandas as pd
import pytest

from notebooks.further import traction_worth

SEEDS = 40
# Errors over that of the paper's RHE, by loop, the best first.
FACTORS = {
    "full oracle": 0.02,
    "RHE with a gyro": 0.4,
    "yaw-drift EKF": 0.45,
    "drift oracle": 0.46,
    "RHE with yaw drift": 0.48,
    "EKF, traction two constants": 0.5,
    "traction oracle": 0.5045,
    "bounded EKF": 0.505,
    "RHE, traction two constants": 0.55,
    "RHE": 0.6,
    "EKF": 0.7,
    "RHE, as printed": 1.0,
    "EKF, as printed": 3.0,
}


@pytest.fixture(scope="module")
def tables():
    """Runs of all loops; the seeds' own errors are common to all."""
    rng = np.random.default_rng(0)
    fields = rng.uniform(0.03, 0.06, SEEDS)
    return {
        loop: pd.DataFrame(
            dict(
                seed=range(SEEDS),
                mean_error_true_m=FACTORS[loop] * fields * rng.uniform(0.99, 1.01, SEEDS),
                violations_true=0,
            )
        )
        for loop in traction_worth.LOOPS
    }


def test_the_best_comes_first_and_a_part_is_worth_a_ratio_at_equal_seeds(tables):
    table = traction_worth.worth_table(tables)
    assert list(table[table["quantity"] == traction_worth.ERROR]["loop"]) == list(FACTORS)
    worth = table[table["quantity"] == traction_worth.RATIO].set_index("loop")
    row = worth.loc["yaw drift as a state: EKF"]
    assert row["low"] < 0.45 / 0.505 < row["high"] and row["high"] - row["low"] < 0.02
    assert row["verdict"] == traction_worth.PAYS
    assert worth.loc["estimating the traction: EKF", "verdict"] == traction_worth.COSTS
    assert worth.loc["knowing the traction", "verdict"] == "undecided"
