"""The audit of the interpretations: its analysis is that of the filters themselves, and it sweeps
what it says.
"""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest
from helpers import choice_of
from text_boxes import text_defects

import rhec
from notebooks.plots import interpretations as plots
from notebooks.studies import interpretations
from rhec import paper
from rhec.core._casadi.packing import pack_array
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

DT = paper.DT_S
# Its curve is driven from about 13 to 27 s.
_BENT = rhec.Path.from_segments([(6.0, 0.0), (6.0, 0.15), (20.0, 0.0)])
SHORT = dict(path=_BENT, duration_s=40.0)


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


@pytest.fixture(scope="module")
def moved():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            interpretations,
            "INTERPRETATIONS",
            {name: interpretations.INTERPRETATIONS[name] for name in ("G3 a", "G10")},
        )
        patch.setattr(
            interpretations, "Scenario", lambda **fields: rhec.Scenario(duration_s=20.0, **fields)
        )
        yield interpretations.one_at_a_time("prediction", 3)


def test_one_interpretation_at_a_time_is_compared_with_the_baseline_at_equal_seeds(moved):
    assert (
        set(moved["interpretation"]) == {"baseline", "G1", "G2", "G3 a", "G10", "G14"}
        and (moved["n"] == 3).all()
    )
    assert (
        moved.loc[moved["interpretation"] == "baseline", ["change", "change_low", "change_high"]]
        == 0
    ).all(axis=None)
    of = moved.set_index(["interpretation", "quantity"])
    for name in ("G2", "G3 a", "G10"):
        row = of.loc[(name, "mean error, true [m]")]
        assert (
            row["change"]
            == pytest.approx(row["value"] - of.loc[("baseline", "mean error, true [m]"), "value"])
            and row["change"] != 0
        )
    assert (
        of.loc[("G1", "mean error, true [m]"), "change"]
        == 0
        != of.loc[("G1", "true error, RHE - EKF [m]"), "change"]
    )  # G1 is the EKF's alone


def test_a_rare_count_has_an_interval_from_zero_on_and_a_difference_has_not(monkeypatch):
    names = ["mean_error_m", "mean_error_true_m", "mean_error_from_start_m", "violations"]
    rare = pd.DataFrame(dict.fromkeys([*names, "rms_kappa"], [0.0, 0.0, 1.0]))
    ekf = rare.assign(mean_error_true_m=0.0)
    monkeypatch.setattr(
        interpretations.run_sets,
        "drive",
        lambda scenarios, folder: {key: rare if key[1] == "rhe" else ekf for key in scenarios},
    )
    table = interpretations.one_at_a_time("prediction", 3)
    assert ((table["low"] < 0) == (table["quantity"] == "true error, RHE - EKF [m]")).all()
    assert (table["low"] <= 0).all() and (table["high"] > 1).all()


@pytest.mark.parametrize(
    "estimator, places, state", [("rhe", (5,), "kappa_hat"), ("ekf", (0, 1), "theta_hat_rad")]
)
def test_a_sweep_moves_one_number_of_w(estimator, places, state, monkeypatch):
    """From its value as printed to that by prediction; the ends are drawn as they were."""
    asked = []
    simulate = interpretations.simulate

    def driven(scenarios):
        asked.extend(scenarios)
        short = rhec.Scenario(**SHORT, process_noise="prediction")
        return simulate([dataclasses.replace(short, seed=each.seed) for each in scenarios])

    monkeypatch.setattr(interpretations, "simulate", driven)
    runs, sweep = interpretations.swept(estimator, 2)
    printed, prediction = (
        np.array(tuning.NOISES[estimator][rule].sigma_w) for rule in ("printed", "prediction")
    )
    moving = np.isin(np.arange(len(printed)), places)
    values = list(sweep["sigma"].unique())
    assert list(runs) == [values[0], values[-1]] == [*printed[moving][:1], *prediction[moving][:1]]
    assert values == sorted(values, reverse=True)
    for scenario, row in zip(asked, sweep.itertuples(), strict=True):
        assert (scenario.seed, scenario.estimator) == (row.seed, estimator)
        assert scenario.sigma_w == tuple(np.where(moving, row.sigma, printed).tolist())
    log = runs[values[0]].log
    late = log[log["t_s"] >= 20]
    straight = late["on_straight"]
    error = late["kappa_hat"] - late["kappa"]
    of_first = sweep[sweep["seed"] == 0].iloc[0]
    yaw = late["theta_hat_rad"] - late["theta_rad"]
    expected = (yaw, error[straight], error[~straight])
    for name, errors in zip(interpretations._RMS, expected):
        assert of_first[name] == pytest.approx(np.sqrt((errors**2).mean()))
    truth = state.replace("_hat", "")
    figure = plots.errors_over_time(runs, state, truth, "error [-]", (10, 30))
    (axes,) = figure.axes
    rules = "as printed", "by prediction"
    for line, sigma, rule in zip(axes.lines, runs, rules, strict=True):
        np.testing.assert_array_equal(line.get_xdata(), log["t_s"])
        np.testing.assert_allclose(line.get_ydata(), log[state] - log[truth], atol=1e-12)
        assert line.get_label() == rf"$\sigma$ = {sigma:g}, {rule}"
    assert axes.get_xlim() == (10, 30) and len(axes.collections) == 1
    assert text_defects(figure) == []


def test_a_sweep_is_told_with_its_means_beside_the_analysis():
    """Oracle: mean and Student's interval of three seeds."""
    errors = np.random.default_rng(0).lognormal(size=6)
    sweep = pd.DataFrame([dict(sigma=sigma, seed=n) for sigma in (1.0, 0.01) for n in range(3)])
    sweep = sweep.assign(rms_yaw_rad=errors)
    analysis = interpretations.ekf_on_a_straight([1.0, 0.01])
    shown = interpretations.readable_sweep(analysis, sweep, "rms_yaw_rad")
    *stated, simulated = shown.columns
    np.testing.assert_allclose(shown[stated], analysis[stated], atol=5e-5)
    assert [*shown.index] == ["1", "0.01"]
    for text, of in zip(shown[simulated], (errors[:3], errors[3:])):
        half = 4.303 * of.std(ddof=1) / 3**0.5
        expected = of.mean(), max(of.mean() - half, 0), of.mean() + half
        found = [float(number) for number in re.findall(r"[\d.]+", text)]
        assert found == pytest.approx(expected, rel=6e-3)
