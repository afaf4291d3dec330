"""The share of fields in which the promise is kept, beside the speed."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import rhec
from rhec.workbench.plots.ensured import fronts
from rhec.workbench.studies import ensured, worst_case

SHORT = dict(row_length_m=6.0, headland_radius_m=6.0, start_offset_m=0.1, estimator="oracle")
DRIVE = rhec.Scenario(**SHORT, duration_s=150.0)


def driven(run):
    """The samples of the first lap that count, recounted."""
    after = run.log["t_s"] >= run.metrics["settling_time_s"] + 5 - 1e-9
    return run.log[after & (run.log["s_m"] < run.path.length_m)]


def test_a_lap_is_judged_from_settling_to_the_end_of_the_path():
    run = rhec.simulate(DRIVE)
    log, lap = driven(run), ensured.lap(run)
    assert lap.error_m == pytest.approx(log["error_true_m"].max())
    assert lap.speed_mps == pytest.approx(log["nu_mps"].mean())
    assert lap.whole == (log["error_true_m"].max() <= 0.12)
    assert len(log) < len(run.log) - 100  # what came after the lap does not count


def test_who_has_not_driven_the_path_has_not_kept_the_promise():
    lap = ensured.lap(rhec.simulate(dataclasses.replace(DRIVE, duration_s=60.0)))
    assert not (lap.whole or lap.rows or lap.corners) and np.isnan(lap.error_m)


def test_a_front_counts_fields_and_its_verdict_needs_share_and_speed():
    labels = ("default soil", "full oracle")
    drives = {
        (*labels, ensured.CONSTANT, 0.4): SHORT | dict(speed_mps=0.4),
        (*labels, ensured.CONSTANT, 0.7): SHORT | dict(speed_mps=0.7, bump_sigma_radps=0.3),
    }
    table = ensured.front(drives, range(12))
    whole = table[table["promise"] == ensured.PROMISES["whole"]].set_index("set_mps")
    kept = [
        ensured.lap(rhec.simulate(rhec.Scenario(**SHORT, speed_mps=0.4, seed=k, duration_s=150.0)))
        for k in range(12)
    ]
    assert whole["share"][0.4] == np.mean([lap.whole for lap in kept])
    assert whole["low"][0.4] < whole["share"][0.4] or whole["share"][0.4] == 0
    assert whole["share"][0.7] < whole["share"][0.4]
    assert whole["speed_mps"][0.4] == pytest.approx(0.4, abs=0.005)

    def verdict(least_share, least_speed_mps):
        return ensured.judged(whole[:1], least_share, least_speed_mps)["verdict"].item()

    assert verdict(0.3, 0.3) == "holds"
    assert verdict(0.999, 0.3) == "undecided"
    assert verdict(0.3, 0.45) == "does not hold"
    assert len(fronts(table, (0.95, 0.47)).axes) == len(ensured.PROMISES)


def made_up_laps(fields_within):
    """`ensured.laps` of drives of which so many in a hundred fields are within the tolerance."""

    def laps(scenarios):
        within = [
            scenario.seed % 100 < fields_within[scenario.estimator, scenario.cautious]
            for scenario in scenarios
        ]
        columns = dict.fromkeys(ensured.PROMISES, within)
        return pd.DataFrame(columns | dict(speed_mps=0.5, error_m=0.1))

    return laps


def test_the_tolerance_has_a_second_look_where_the_first_is_undecided(monkeypatch):
    proposal = ensured.ESTIMATORS[ensured.PROPOSAL]["estimator"]
    within = {(proposal, True): 100, (proposal, False): 97, ("rhe", False): 40}
    monkeypatch.setattr(ensured, "laps", made_up_laps(within))
    table = ensured.tested(200, 1000)
    whole = table[table["promise"] == ensured.PROMISES["whole"]].set_index(["estimator", "mode"])
    said = {place: (row["n"], row["verdict"]) for place, row in whole.iterrows()}
    assert said == {
        (ensured.PROPOSAL, ensured.CAUTIOUS): (200, "holds"),
        ("RHE, as printed", ensured.CONSTANT): (200, "does not hold"),
        (ensured.PROPOSAL, ensured.CONSTANT): (1000, "holds"),
    }
    one_look = ensured.tested(200, 200)
    assert set(one_look["n"]) == {200}
    assert list(one_look["verdict"].unique()) == ["holds", "undecided", "does not hold"]
    # The interval that is shown is the one of 95 %: 40 of 100, twice.
    low, high = whole.loc[("RHE, as printed", ensured.CONSTANT), ["low", "high"]]
    assert stats.beta.cdf([low, high], [80, 81], [121, 120]) == pytest.approx([0.025, 0.975])


def test_a_lap_is_that_of_the_longest_drive_and_is_driven_once(monkeypatch):
    """The second robot starts so far away that it is late, and the third never comes back."""
    driven = []

    def map_runs(function, scenarios):
        driven.extend(scenarios)
        return [function(rhec.simulate(scenario)) for scenario in scenarios]

    monkeypatch.setattr(ensured, "map_runs", map_runs)
    monkeypatch.setattr(ensured, "_known_laps", {})
    late = SHORT | dict(start_offset_m=0.6, kappa_mean=0.6, mu_deviation=0.0)
    changes = dict(speed_mps=0.4), dict(mu_mean=0.8, terrain=rhec.Terrain.uniform(0.7, 0.8)), {}
    scenarios = [rhec.Scenario(**late | change, seed=5) for change in changes]
    scenarios[2] = dataclasses.replace(scenarios[2], omega_max_radps=1e-9)
    driven_laps = ensured.laps([*scenarios, scenarios[0]])
    longest = [
        ensured.lap(rhec.simulate(dataclasses.replace(each, duration_s=ensured._longest_s(each))))
        for each in scenarios
    ]
    pd.testing.assert_frame_equal(driven_laps, pd.DataFrame([*longest, longest[0]]))
    assert np.isnan(driven_laps["error_m"]).tolist() == [False, False, True, False]
    assert len(driven) == 3 + 2  # two were not back in the usual time
    assert ensured.laps(scenarios[:1]).equals(driven_laps[:1]) and len(driven) == 5


def test_every_drive_can_be_asked_for():
    every = ensured.drives(
        ensured.SOILS, ensured.ESTIMATORS, [ensured.CONSTANT, ensured.CAUTIOUS], [0.3, 0.6]
    )
    assert len(every) == 3 * len(ensured.ESTIMATORS) * 2 * 2
    for (_, _, mode, speed), fields in every.items():
        scenario = rhec.Scenario(**fields)
        assert scenario.speed_mps == speed and scenario.cautious == (mode == ensured.CAUTIOUS)


CHOSEN = dict(
    mu=-1.0, kappa=1.0, patch_mu=1.0, patch_kappa=-1.0, patch_radius_m=3.0, patch_s_m=10.0,
    bump_period_s=2.0, bump_phase=0.0, gnss_period_s=4.0, gnss_phase=0.0, gnss_angle_rad=0.0,
)  # fmt: skip


def test_a_drive_chosen_against_the_robot_keeps_the_bounds():
    unsteered = dict(omega_max_radps=1e-9, encoder_sigma_mps=0.0, duration_s=40.0)
    unsteered |= dict(estimator="oracle", start_offset_m=0.0)
    level, base = 0.5, rhec.Scenario(**rhec.WORLDS["former"] | unsteered)
    run = worst_case.drive(base, level, **CHOSEN)
    log, sigmas = run.log, 2 * level
    assert log["mu"].min() == pytest.approx(0.9 - sigmas * 0.04)
    assert log["mu"].max() == pytest.approx(0.9 + sigmas * 0.04)
    assert log["kappa"].min() == pytest.approx(0.8 - sigmas * 0.08)
    assert log["kappa"].max() == pytest.approx(0.8 + sigmas * 0.08)
    off = log["x_meas_m"] - log["x_m"]
    np.testing.assert_allclose(np.abs(off), sigmas * 0.03, atol=1e-9)
    assert 2 * 40 / 4 - 2 <= np.sum(np.diff(np.sign(off)) != 0) <= 2 * 40 / 4
    np.testing.assert_allclose(log["y_meas_m"], log["y_m"], atol=1e-9)
    turned = np.diff(log["theta_rad"]) / 0.2
    np.testing.assert_allclose(np.abs(turned), sigmas * 0.02, rtol=1e-6)
    assert 2 * 40 / 2 - 2 <= np.sum(np.diff(np.sign(turned)) != 0) <= 2 * 40 / 2


def test_what_the_search_finds_can_be_driven_again():
    (found,) = worst_case.search([0.5], evaluations=44, estimator="oracle").to_dict("records")
    chosen = {name: found[name] for name in CHOSEN}
    base = rhec.Scenario(estimator="oracle", duration_s=160.0, start_offset_m=0.0)
    columns = worst_case.drive(base, 0.5, **chosen).columns
    lap = columns["s_m"] < 30 + np.pi * base.headland_radius_m
    assert columns["error_true_m"][lap].max() == pytest.approx(found["worst_m"])
    assert found["drives"] <= 44 and found["seed"] == 0
