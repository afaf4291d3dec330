"""The drives of both scenarios, as the notebooks show them."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

import rhec
from notebooks.studies import scenario_tables, statistics, tables

SHORT = dict(duration_s=8.0)


def test_scenario_a_drives_each_weight_on_the_same_fields():
    weights = scenario_tables.yaw_weights()
    sweep, runs = scenario_tables.scenario_a(2, 1, weights, **SHORT)
    assert list(sweep["weight"].unique()) == list(runs) == list(weights)
    assert sweep["seed"].tolist() == [0, 1] * 4
    row = sweep[(sweep["weight"] == "Q2") & (sweep["seed"] == 1)].iloc[0]
    assert row["mean_error_from_start_m"] == runs["Q2"].metrics["mean_error_from_start_m"]
    shown = tables.readable(scenario_tables.scenario_a_table(sweep))
    assert list(shown.columns) == [*runs, "Q1 / Q3", "Q2 / Q3"] and len(shown) == 6
    words = " ".join(shown.to_numpy().ravel())
    assert "nan" not in words and "()" not in words  # nor has a number without a verdict a word


def test_scenario_b_has_the_means_and_ranges_of_its_drives():
    """Oracle: means and quantiles of pandas, and Student's t of seven drives. No metric is below 0,
    nor is the end of its interval. With W as printed the EKF is lost, and the RHE has a violation.
    """
    rng = np.random.default_rng(0)
    keys = ["turns", "process_noise", "estimator"]
    cases = ("left", "right"), ("consistent", "printed"), ("rhe", "ekf"), range(7)
    sweep = pd.MultiIndex.from_product(cases, names=[*keys, "seed"]).to_frame(index=False)
    names = scenario_tables._QUANTITIES_B
    for name in names:
        sweep[name] = rng.lognormal(-3, 1, len(sweep))
    is_printed = sweep["process_noise"] == "printed"
    is_rhe = sweep["estimator"] == "rhe"
    sweep["mean_error_m"] *= np.where(is_printed & ~is_rhe, 9, 1)
    sweep["violations"] = np.where(is_printed | ~is_rhe, rng.integers(0, 3, len(sweep)), 0)
    table = scenario_tables.scenario_b_table(sweep).set_index([*keys, "quantity"])
    sweep = sweep.assign(
        is_clean=sweep["violations"] == 0, estimator=sweep["estimator"].str.upper()
    )
    for column, quantity in names.items():
        drives = sweep.pivot(index="seed", columns=keys, values=column)
        for case in drives:
            row = table.loc[(*case, quantity)]
            assert row["mean"] == pytest.approx(drives[case].mean()) and row["n"] == 7
            assert row["paper"] == scenario_tables.REPORTED.get((case[-1], column), "")
            says_none = (case[-1], column) == ("RHE", "violations")
            assert row["claim"] == ("at most 0" if says_none else "")
            if says_none:
                assert row["verdict"] == ("does not hold" if "printed" in case else "holds")
            if column != "is_clean":
                ends = drives[case].quantile([0.05, 0.95])
                low = drives[case].mean() - 2.4469 * drives[case].std() / np.sqrt(7)
                assert [*row[["p5", "p95", "low"]]] == pytest.approx([*ends, max(low, 0)], rel=1e-3)
        if column in ("mean_error_m", "violations"):
            both = (drives.xs(name, axis=1, level="estimator") for name in ("RHE", "EKF"))
            for case, gain in np.subtract(*both).items():
                row = table.loc[(*case, "RHE - EKF", quantity)]
                half = 2.4469 * gain.std() / np.sqrt(7)
                expected = gain.mean(), gain.mean() - half, gain.mean() + half
                assert [*row[["mean", "low", "high"]]] == pytest.approx(expected, rel=1e-3)
                assert row["paper"] == dict(mean_error_m=-0.0091, violations=-17)[column]
                judged = statistics.verdict(*expected[1:], below=0)
                assert row["verdict"] == (statistics.LOST if "printed" in case else judged)
                share = table.loc[(*case, "P(RHE < EKF)", quantity), "mean"]
                assert share == pytest.approx((gain < 0).mean())


def test_scenario_a_has_the_means_of_its_drives_and_judges_their_ratios():
    rng = np.random.default_rng(0)
    weights = [*scenario_tables.yaw_weights()]
    sweep = pd.DataFrame(dict(weight=np.repeat(weights, 7), seed=[*range(7)] * 4))
    for name in scenario_tables._QUANTITIES_A:
        sweep[name] = 1 + 0.1 * rng.random(len(sweep))
    table = scenario_tables.scenario_a_table(sweep).set_index(["weight", "quantity"])
    by_weight = sweep.groupby("weight")
    for column, quantity in scenario_tables._QUANTITIES_A.items():
        for weight in weights:
            of = by_weight[column].get_group(weight)
            row = table.loc[(weight, quantity)]
            assert (row["mean"], row["p95"]) == pytest.approx((of.mean(), of.quantile(0.95)))
    for factor, verdict in ((2.5, "holds"), (2.0, "undecided"), (1.5, "does not hold")):
        slow, swings = (np.where(sweep["weight"] == q, factor, 1) for q in ("Q1", "Q2"))
        made = sweep.assign(
            settling_time_s=slow * sweep["settling_time_s"],
            overshoot_m=swings * sweep["overshoot_m"],
        )
        judged = scenario_tables.scenario_a_table(made).set_index("weight")["verdict"]
        assert judged["Q1 / Q3"] == judged["Q2 / Q3"] == verdict
    never = sweep.assign(settling_time_s=sweep["settling_time_s"].where(sweep["weight"] != "Q1"))
    table = scenario_tables.scenario_a_table(never).set_index(["weight", "quantity"])
    assert table.loc[("Q1", "settling time [s]"), "n"] == 0
    assert table.loc[("Q1 / Q3", "settling time, ratio"), "verdict"] == "undecided"


def test_numbers_and_differences_have_a_minus_and_words_keep_their_hyphens():
    text = "-0.3 [-1.2, -3e-05] on 2024-07-29, left-right, x - y"
    assert tables.with_minus(text) == "−0.3 [−1.2, −3e−05] on 2024-07-29, left-right, x − y"
    assert tables.three_digits(-1234.5) == "−1234" and tables.signed(0.5) == "+0.500"
    assert tables.interval_text(1.0, 1.0, 1.0) == "1.00"  # which has no width


def test_a_readable_table_has_a_column_a_variant_and_the_papers_after_them():
    names = ["process_noise", "estimator", "quantity", "mean", "low", "high", "paper", "verdict"]
    rows = [("printed", "RHE", "error", 0.04, 0.03, 0.05, 0.0423, "met")]
    rows += [("printed", "EKF", "error", 1.0, 0.9, 1.1, 0.0514, np.nan)]
    table = pd.DataFrame(rows, columns=names)
    (row,) = tables.readable(table).to_dict("records")
    assert tables.readable(table, transposed=True)["error"].to_dict() == row
    assert row == {
        "printed, RHE": "0.0400 [0.0300, 0.0500] (met)",
        "printed, EKF": "1.00 [0.900, 1.10]",
        "paper, RHE": "0.0423",
        "paper, EKF": "0.0514",
    }


def test_scenario_b_drives_both_estimators_under_every_process_noise():
    sweep, runs = scenario_tables.scenario_b(2, 1, beside=1, turns="right", **SHORT)
    driven = set(zip(sweep["turns"], sweep["process_noise"], sweep["estimator"]))
    assert driven == {
        (turns, w, name)
        for turns in scenario_tables.TURNS
        for w in scenario_tables.PROCESS_NOISES
        for name in ("rhe", "ekf")
    }
    fields = sweep.groupby("turns", sort=False)["seed"].agg(lambda seeds: sorted({*seeds}))
    assert list(fields) == [[0, 1], [0], [0], [0]] and fields.index[0] == "right"
    assert list(runs) == list(scenario_tables.PROCESS_NOISES)
    (run,) = runs["prediction"]
    assert run.scenario == rhec.Scenario(process_noise="prediction", turns="right", **SHORT)
    drive = SHORT | dict(turns="right")
    pair = scenario_tables.rhe_and_ekf(process_noise="prediction", seed=0, **drive)
    assert pair["RHE"].columns["x_m"].tolist() == run.columns["x_m"].tolist()
    assert pair["EKF"].scenario == dataclasses.replace(run.scenario, estimator="ekf")
