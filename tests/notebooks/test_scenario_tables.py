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


def test_the_tables_of_skewed_drives_have_their_means_and_ranges():
    """Oracle: NumPy's mean and percentiles, and Student's t of the paired difference."""
    rng = np.random.default_rng(0)
    n = 7
    sweep = pd.DataFrame(
        [
            dict(turns=turns, process_noise=rule, estimator=name, seed=seed)
            for turns in ("alternate", "left")
            for rule in ("consistent", "printed")
            for name in ("rhe", "ekf")
            for seed in range(n)
        ]
    )
    for name in scenario_tables._QUANTITIES_B:
        sweep[name] = rng.lognormal(-3, 1, len(sweep))
    sweep["violations"] = rng.integers(0, 3, len(sweep))
    names = scenario_tables._QUANTITIES_B
    key = ["turns", "process_noise", "estimator", "quantity"]
    table = scenario_tables.scenario_b_table(sweep).set_index(key)
    for (turns, rule), of in sweep.assign(is_clean=sweep["violations"] == 0).groupby(key[:2]):
        both = {name.upper(): each.set_index("seed") for name, each in of.groupby("estimator")}
        for column, quantity in names.items():
            for name, drives in both.items():
                row = table.loc[(turns, rule, name, quantity)]
                assert row["mean"] == pytest.approx(drives[column].mean()) and row["n"] == n
                if column != "is_clean":
                    ends = np.percentile(drives[column], (5, 95))
                    assert (row["p5"], row["p95"]) == pytest.approx(tuple(ends))
                    # No metric is negative, nor is the lower end of its interval.
                    low = row["mean"] - 2.447 * drives[column].std() / np.sqrt(n)
                    assert row["low"] == pytest.approx(max(low, 0), rel=0.01)
                reported = scenario_tables.REPORTED.get((name, column), "")
                assert row["paper"] == reported
                says_none = column == "violations" and name == "RHE"
                assert row["claim"] == ("at most 0" if says_none else "")
            if column in ("mean_error_m", "violations"):
                gain = both["RHE"][column] - both["EKF"][column]
                row = table.loc[(turns, rule, "RHE - EKF", quantity)]
                half = 2.447 * gain.std() / np.sqrt(n)
                wanted = (gain.mean(), gain.mean() - half, gain.mean() + half)
                assert (row["mean"], row["low"], row["high"]) == pytest.approx(wanted, rel=1e-3)
                assert row["paper"] == dict(mean_error_m=-0.0091, violations=-17)[column]
                row = table.loc[(turns, rule, "P(RHE < EKF)", quantity)]
                assert row["mean"] == pytest.approx((gain < 0).mean())
    assert len(table) == 4 * (8 * 2 + 2 * 2)
    weights = [*scenario_tables.yaw_weights()]
    of_a = pd.DataFrame(dict(weight=np.repeat(weights, n), seed=[*range(n)] * 4))
    for name in scenario_tables._QUANTITIES_A:
        of_a[name] = rng.lognormal(0, 1, len(of_a))
    shown = scenario_tables.scenario_a_table(of_a).set_index(["weight", "quantity"])
    for weight, of in of_a.groupby("weight"):
        for column, quantity in scenario_tables._QUANTITIES_A.items():
            row = shown.loc[(weight, quantity)]
            assert row["mean"] == pytest.approx(of[column].mean())
            assert row["p95"] == pytest.approx(np.percentile(of[column], 95))
    ratio = shown.loc[("Q1 / Q3", "settling time, ratio")]
    slow, fast = (shown.loc[(q, "settling time [s]"), "mean"] for q in ("Q1", "Q3"))
    assert ratio["mean"] == pytest.approx(slow / fast) and ratio["claim"] == "at least 2"
    about_1 = 1 + 0.1 * rng.random(len(of_a))
    for factor, verdict in ((2.5, "holds"), (2.0, "undecided"), (1.5, "does not hold")):
        slow, swinging = (np.where(of_a["weight"] == q, factor, 1) * about_1 for q in ("Q1", "Q2"))
        made = of_a.assign(settling_time_s=slow, overshoot_m=swinging)
        judged = scenario_tables.scenario_a_table(made).set_index("weight")["verdict"]
        assert judged["Q1 / Q3"] == judged["Q2 / Q3"] == verdict
    never = of_a.assign(settling_time_s=of_a["settling_time_s"].where(of_a["weight"] != "Q1"))
    shown = scenario_tables.scenario_a_table(never).set_index(["weight", "quantity"])
    assert shown.loc[("Q1", "settling time [s]"), "n"] == 0
    assert shown.loc[("Q1 / Q3", "settling time, ratio"), "verdict"] == "undecided"


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


def test_at_most_none_includes_none_and_a_rival_that_is_lost_proves_nothing():
    """Below zero does not include zero. The EKF is lost with W as printed."""
    sweep = pd.DataFrame(
        [
            dict(turns="left", process_noise=noise, estimator=name, mean_error_m=mean_error_m)
            for noise, ekf_m in (("printed", 1.0), ("prediction", 0.05))
            for name, mean_error_m in (("rhe", 0.03), ("ekf", ekf_m))
        ]
        * 3
    )
    others = {*scenario_tables._QUANTITIES_B} - {"mean_error_m", "is_clean"}
    sweep = sweep.assign(**dict.fromkeys(others, 0.0))

    def verdicts(sweep):
        table = scenario_tables.scenario_b_table(sweep)
        judged = table[table["claim"] != ""].groupby("process_noise")
        return {noise: [*rows["verdict"]] for noise, rows in judged}

    none = verdicts(sweep)
    assert none["printed"] == [statistics.LOST, "holds", statistics.LOST]
    assert none["prediction"] == ["holds", "holds", "does not hold"]
    once = verdicts(sweep.assign(violations=1.0 * (np.arange(len(sweep)) == 0)))
    assert (once["printed"][1], once["prediction"][1]) == ("does not hold", "holds")
