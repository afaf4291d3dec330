"""The drives of both scenarios, as the notebooks show them."""

import rhec
from notebooks.studies import scenario_tables, tables

SHORT = dict(duration_s=20.0)


def test_scenario_a_drives_each_weight_on_the_same_fields(virtual_machine):
    sweep, runs = scenario_tables.scenario_a(2, seed=1, **SHORT)
    assert list(sweep["weight"].unique()) == list(runs) == list(scenario_tables.yaw_weights())
    assert sweep["seed"].tolist() == [0, 1] * 4
    row = sweep[(sweep["weight"] == "Q2") & (sweep["seed"] == 1)].iloc[0]
    assert row["mean_error_from_start_m"] == runs["Q2"].metrics["mean_error_from_start_m"]
    shown = tables.readable(scenario_tables.scenario_a_table(sweep))
    assert list(shown.columns) == [*runs, "Q1 / Q3", "Q2 / Q3"] and len(shown) == 6


def test_scenario_b_drives_both_estimators_under_both_process_noises(virtual_machine):
    sweep, runs = scenario_tables.scenario_b(2, 1, **SHORT)
    assert len(sweep) == 8 and {name: list(of) for name, of in runs.items()} == dict.fromkeys(
        scenario_tables.PROCESS_NOISES, ["RHE", "EKF"]
    )
    (run,) = runs["likelihood"]["EKF"]
    scenario = rhec.Scenario(estimator="ekf", process_noise="likelihood", **SHORT)
    assert run.scenario == scenario
    pair = scenario_tables.rhe_and_ekf(process_noise="likelihood", seed=0, **SHORT)
    assert pair["EKF"].columns["x_m"].tolist() == run.columns["x_m"].tolist()
