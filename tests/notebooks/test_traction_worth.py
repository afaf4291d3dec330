"""Tables and pictures of what estimating traction is worth, from errors that are made up."""

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.further import traction_worth
from notebooks.further.rivals import pure_pursuit
from notebooks.further.traction_worth_plots import over_gain, ranked

SEEDS = 40
PURSUIT = "bounded EKF, pure pursuit"
# Errors over that of the paper's RHE, by loop, the best first.
FACTORS = {
    "full oracle": 0.02,
    "traction oracle": 0.44,
    "yaw-drift EKF": 0.45,
    "EKF, traction two constants": 0.5,
    "bounded EKF": 0.505,
    PURSUIT: 0.506,
    "RHE, traction two constants": 0.55,
    "RHE": 0.6,
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


def means_of(table):
    return table[table["quantity"] == traction_worth.ERROR]


def worth_of(table):
    return table[table["quantity"] == traction_worth.RATIO].set_index("loop")


def test_the_best_comes_first(tables):
    assert list(means_of(traction_worth.worth_table(tables))["loop"]) == list(FACTORS)


def test_what_a_part_is_worth_is_a_ratio_at_equal_seeds(tables):
    worth = worth_of(traction_worth.worth_table(tables))
    row = worth.loc["yaw drift as a state: EKF"]
    assert row["low"] < 0.45 / 0.505 < row["high"] and row["high"] - row["low"] < 0.02
    assert row["verdict"] == traction_worth.PAYS
    assert worth.loc["estimating the traction: EKF", "verdict"] == traction_worth.COSTS
    assert worth.loc["pure pursuit in place of the RHC", "verdict"] == "undecided"


def looked(tables, monkeypatch, first):
    """`in_two_looks` on runs that are made up, and which runs were asked for."""
    asked = []

    def drive(loops, seeds, folder=None):
        asked.append(({*loops}, seeds))
        return {loop: tables[loop][tables[loop]["seed"].isin(seeds)] for loop in loops}

    monkeypatch.setattr(traction_worth, "drive", drive)
    return traction_worth.in_two_looks(first, SEEDS), asked


def test_the_second_look_is_at_what_the_first_leaves_open(tables, monkeypatch):
    found, asked = looked(tables, monkeypatch, 10)
    # The leader, the paper's RHE, the oracles, and both loops of what is undecided.
    on = {"yaw-drift EKF", "RHE, as printed", "full oracle", "traction oracle"}
    on |= {"EKF, traction two constants", "bounded EKF", PURSUIT}
    assert asked == [({*FACTORS}, range(10)), (on, range(10, SEEDS))]
    assert {loop for loop, rows in found.items() if len(rows) == SEEDS} == on
    same, asked = looked(tables, monkeypatch, SEEDS)
    assert {len(rows) for rows in same.values()} == {SEEDS} and len(asked) == 1


def test_what_the_first_look_decided_comes_out_as_with_all_fields(tables, monkeypatch):
    found, _ = looked(tables, monkeypatch, 10)
    worth = worth_of(traction_worth.worth_table(found))
    of_all = worth_of(traction_worth.worth_table(tables))
    pd.testing.assert_series_equal(worth["verdict"], of_all["verdict"])
    row = worth.loc["the weights R and q_θ, and W: RHE"]
    assert row["n"] == 10 and row["verdict"] == traction_worth.PAYS


def test_easy_fields_of_a_first_look_put_nobody_first(tables):
    easy = {
        loop: rows.assign(mean_error_true_m=rows["mean_error_true_m"] * (1 + (rows["seed"] >= 10)))
        for loop, rows in tables.items()
    }
    easy["RHE"] = easy["RHE"][:10]
    means = means_of(traction_worth.worth_table(easy))
    assert list(means["loop"]) == list(FACTORS)
    assert not means["mean"].is_monotonic_increasing


def test_the_best_is_seldom_left_behind_after_the_first_look():
    """All loops are equally good: each is left behind as rarely as 99.9 % says."""
    rng = np.random.default_rng(1)
    rivals = [*traction_worth.LOOPS][:8]
    n_behind = 0
    for _ in range(300):
        first = {
            loop: pd.DataFrame(dict(seed=range(20), mean_error_true_m=rng.normal(1.0, 0.3, 20)))
            for loop in traction_worth.LOOPS
        }
        n_behind += rivals[0] not in traction_worth._undecided(first, 0.999)
    rate = 0.001 / 2 * (len(rivals) - 1)
    assert n_behind / 300 < rate + 3 * np.sqrt(rate / 300)


def test_pictures_show_every_loop(tables):
    found = tables | {"EKF, as printed": tables["EKF, as printed"][:30]}
    (axes,) = ranked(found, traction_worth.worth_table(found)).axes
    assert [label.get_text() for label in axes.get_yticklabels()] == list(FACTORS)
    texts = [text.get_text() for text in axes.texts]
    assert sum(text.endswith("*") for text in texts) == 1 and "30 off scale" in texts
    rows = [
        dict(loop=name, r=r, seed=seed, mean_error_true_m=0.02 + 0.001 * seed)
        for name in traction_worth.GAINS for r in (0.1, 1.0) for seed in range(5)
    ]  # fmt: skip
    (axes,) = over_gain(pd.DataFrame(rows)).axes
    assert len(axes.get_legend().get_texts()) == len(traction_worth.GAINS)


def test_all_loops_are_scenarios():
    for loop in traction_worth.LOOPS:
        one, other = traction_worth.scenarios(loop, range(2))
        assert (one.seed, other.seed) == (0, 1)
        assert isinstance(one.controller, rhec.Controller) == (loop == PURSUIT)
        if loop == PURSUIT:
            assert one.controller == pure_pursuit.controller(one)


def test_rows_of_a_drive_belong_to_their_loop(monkeypatch):
    short = {"EKF": dict(estimator="ekf", duration_s=20.0), "RHE": dict(duration_s=20.0)}
    monkeypatch.setattr(traction_worth, "LOOPS", short)
    for loop, rows in traction_worth.drive(short, range(2)).items():
        for row in rows.itertuples():
            metrics = rhec.simulate(rhec.Scenario(**short[loop], seed=row.seed)).metrics
            assert row.mean_error_true_m == pytest.approx(metrics["mean_error_true_m"], rel=1e-12)
    assert traction_worth.drive([], range(2)) == {}


def test_the_error_over_the_gain_is_that_of_single_runs(monkeypatch):
    short = dict(estimator="ekf", duration_s=20.0)
    monkeypatch.setattr(traction_worth, "GAINS", {"EKF": short})
    for row in traction_worth.by_gain([3], weights=(0.1, 10.0)).itertuples():
        expected = rhec.simulate(rhec.Scenario(**short, r=row.r, seed=3))
        assert row.mean_error_true_m == pytest.approx(
            expected.metrics["mean_error_true_m"], rel=1e-12
        )
