"""The audit of the interpretations: its analysis is that of the filters themselves, and its table
has the changes from the baseline.
"""

import numpy as np
import pandas as pd
import pytest
from helpers import choice_of

import rhec
from notebooks.studies import interpretations
from rhec import paper
from rhec.core._casadi.packing import pack_array
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

DT = paper.DT_S


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("sigma_x_m", [0.02, 10.0])
def test_the_steady_ekf_is_the_limit_of_the_filter(sigma_x_m):
    """Not on the yaw's own scale only: the covariance after thousands of samples on a straight
    along x.
    """
    choice = choice_of("ekf", 5)
    step = build_step(choice)
    guess = dict(zip(QUANTITIES, (0, 0, 0, 0.45, 1, 1)))
    m = pack_array(estimator_of("ekf").init(choice, guess, dict.fromkeys(QUANTITIES, 1)))
    x = 0.0
    for _ in range(4000):
        result = step(
            memory=m,
            z_N=(x, 0, 0.45, 0),
            V=np.square(paper.SIGMA_V),
            W=np.square([sigma_x_m, sigma_x_m, 0.1, 1e-6]),
        )
        m, x = result["memory"], x + DT * 0.45
    (row,) = interpretations.ekf_on_a_straight([sigma_x_m]).itertuples()
    assert np.sqrt(np.array(result["covariance"])[2, 2]) == pytest.approx(
        row.sigma_yaw_rad, rel=0.01
    )


def test_nothing_is_learnt_of_kappa_on_a_straight():
    """There its variance grows by σ_κ² a sample; in a curve it stays."""
    sigma = [0.1, 0.2]
    straight = [interpretations.rhe_sigma_kappa(sigma, 0.0, samples) for samples in (60, 120)]
    np.testing.assert_allclose(
        (straight[1] ** 2 - straight[0] ** 2) / 60, np.square(sigma), rtol=1e-3
    )
    curve = [interpretations.rhe_sigma_kappa(sigma, 0.07, samples) for samples in (60, 120)]
    assert np.all(
        curve[1] ** 2 - curve[0] ** 2 < 0.1 * (straight[1] ** 2 - straight[0] ** 2)
    ) and np.all(curve[1] < straight[1])


def test_the_analysis_is_of_what_the_rules_pick():
    """On the curve of the table the robot turns by the yaw rate that its radius asks for."""
    for estimator, place in (("ekf", 0), ("rhe", 5)):
        ends = [tuning.NOISES[estimator][rule].sigma_w[place] for rule in ("printed", "prediction")]
        assert [*interpretations.between_the_rules(estimator)[[0, -1]]] == pytest.approx(ends)
    (row,) = interpretations.sigma_kappa_table([0.1]).itertuples()
    omega_radps = 0.9 * paper.SPEED_MPS / (0.8 * paper.HEADLAND_RADIUS_M)
    expected = [interpretations.rhe_sigma_kappa([0.1], omega)[0] for omega in (0.0, omega_radps)]
    assert (row.straight, row.curve) == pytest.approx(expected)


def test_an_interpretation_is_compared_with_the_baseline_at_equal_seeds(monkeypatch):
    """Oracle: means of made-up drives, and Student's interval of three; no error is below 0."""
    rng = np.random.default_rng(0)
    names = ["mean_error_m", "mean_error_true_m", "mean_error_from_start_m", "violations"]
    asked = {}
    driven = {}

    def drive(scenarios, folder):
        asked.update(scenarios)
        for key, of in scenarios.items():
            numbers = rng.lognormal(sigma=2, size=(len(of), 5))
            driven[key] = pd.DataFrame(numbers, columns=[*names, "rms_kappa"])
        return driven

    monkeypatch.setattr(interpretations.run_sets, "drive", drive)
    table = interpretations.one_at_a_time("prediction", 3)
    table = table.set_index(["interpretation", "quantity"])
    results = {}
    for name in ("baseline", "G1", "G2", "G10", "G14"):
        rhe, ekf = (driven["baseline" if name == "G14" else name, of] for of in ("rhe", "ekf"))
        results[name] = rhe.assign(advantage_m=rhe["mean_error_true_m"] - ekf["mean_error_true_m"])
    results["G14"]["mean_error_m"] = results["G14"]["mean_error_from_start_m"]
    for name, result in results.items():
        for column, quantity in interpretations.QUANTITIES.items():
            row = table.loc[(name, quantity)]
            value = result[column]
            moved = result[column] - results["baseline"][column]
            for of, ends in ((value, "value low high"), (moved, "change change_low change_high")):
                half = 4.303 * of.std() / 3**0.5
                low = of.mean() - half
                if of is value and column != "advantage_m":
                    low = max(low, 0)
                expected = [of.mean(), low, of.mean() + half]
                assert [*row[ends.split()]] == pytest.approx(expected, rel=1e-3), (name, quantity)
    # G1 is the EKF's alone, and G2 the RHE's.
    rules = {key: {each.process_noise for each in of} for key, of in asked.items()}
    for key in (("G1", "ekf"), ("G2", "rhe")):
        assert rules.pop(key) == {"printed"}
    assert {*map(tuple, rules.values())} == {("prediction",)}
    assert all([each.seed for each in of] == [0, 1, 2] for of in asked.values())


def test_every_interpretation_is_a_scenario_and_another_one_than_the_default():
    for name, (_, fields, *_) in interpretations.INTERPRETATIONS.items():
        assert rhec.Scenario(**fields) != rhec.Scenario(), name
