"""The audit of the interpretations: its analysis is that of the filters themselves, and it sweeps
what it says.
"""

from pathlib import Path

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
from rhec.style import BLUE, GREY, VERMILLION
from rhec.tracked_robot import tuning
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES

DT = paper.DT_S
SHORT = dict(row_length_m=10.0, duration_s=40.0)  # with a curve
ROOT = Path(__file__).parents[2]


@pytest.mark.nightly(keep=1)
@pytest.mark.parametrize("sigma_x_m", [10.0, 0.02])
def test_the_steady_ekf_is_the_limit_of_the_filter(sigma_x_m):
    """Not on the yaw's own scale only: the covariance after thousands of samples on a straight
    along x.
    """
    choice = choice_of("ekf", 5)
    step = build_step(choice)
    guess = dict(zip(QUANTITIES, (0, 0, 0, 0.45, 1, 1)))
    m = pack_array(estimator_of("ekf").init(choice, guess, dict.fromkeys(QUANTITIES, 1)))
    sigma_theta = 0.1
    x = 0.0
    for _ in range(4000):
        result = step(
            memory=m,
            z_N=(x, 0, 0.45, 0),
            V=np.square(paper.SIGMA_V),
            W=np.square([sigma_x_m, sigma_x_m, sigma_theta, 1e-6]),
        )
        m, x = result["memory"], x + DT * 0.45
    (row,) = interpretations.ekf_on_a_straight([sigma_x_m], sigma_theta).itertuples()
    assert np.sqrt(np.array(result["covariance"])[2, 2]) == pytest.approx(
        row.sigma_yaw_rad, rel=0.01
    )


def test_nothing_is_learnt_of_kappa_on_a_straight(virtual_machine):
    """There its variance grows by σ_κ² a sample; in a curve it stays."""
    sigma = [0.1, 0.2]
    straight = [
        interpretations.rhe_sigma_kappa(sigma, 0.0, "printed", samples) for samples in (60, 120)
    ]
    np.testing.assert_allclose(
        (straight[1] ** 2 - straight[0] ** 2) / 60, np.square(sigma), rtol=1e-3
    )
    curve = [
        interpretations.rhe_sigma_kappa(sigma, 0.07, "printed", samples) for samples in (60, 120)
    ]
    assert np.all(
        curve[1] ** 2 - curve[0] ** 2 < 0.1 * (straight[1] ** 2 - straight[0] ** 2)
    ) and np.all(curve[1] < straight[1])


@pytest.fixture(scope="module")
def moved(virtual_machine):
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


def test_a_sweep_changes_one_number_of_w_and_is_drawn_as_it_was(virtual_machine, monkeypatch):
    asked = []
    simulate = interpretations.simulate
    monkeypatch.setattr(
        interpretations,
        "simulate",
        lambda scenarios: (
            asked.extend(scenarios)
            or simulate([rhec.Scenario(**SHORT, sigma_w=one.sigma_w) for one in scenarios])
        ),
    )
    runs, sweep = interpretations.swept("rhe", "printed", "kappa", (0.25, 0.01), 1)
    assert [scenario.sigma_w for scenario in asked] == [
        (*tuning.NOISES["rhe"]["printed"].sigma_w[:5], value) for value in (0.25, 0.01)
    ]
    assert list(sweep["sigma"]) == [0.25, 0.01] == list(runs) and isinstance(sweep, pd.DataFrame)
    straights = pd.DataFrame(dict(sigma_kappa=[0.25, 0.01], straight=1.0, curve=0.1))
    figure = plots.rhe_kappa(straights, sweep, runs, printed=0.25, prediction=0.01)
    *estimates, truth = (line.get_xydata() for line in figure.axes[2].lines)
    for drawn, run in zip(estimates, runs.values(), strict=True):
        np.testing.assert_array_equal(drawn, run.log[["t_s", "kappa_hat"]])
    np.testing.assert_array_equal(truth, run.log[["t_s", "kappa"]])
    analysis = interpretations.ekf_on_a_straight([0.01, 1.0])
    figure = plots.ekf_yaw(analysis, sweep, runs, printed=0.25, prediction=0.01)
    for line, run in zip(figure.axes[2].lines, reversed(runs.values()), strict=True):
        error_rad = run.log["theta_hat_rad"] - run.log["theta_rad"]
        np.testing.assert_allclose(line.get_ydata(), error_rad, atol=1e-12)


def test_a_swept_value_is_drawn_with_its_means_and_the_two_that_the_rules_pick():
    """Oracle: mean and Student's interval of three seeds."""
    rng = np.random.default_rng(0)
    columns = ("rms_yaw_rad", "rms_kappa_straights", "rms_kappa_curves")
    sweep = pd.DataFrame([dict(sigma=sigma, seed=n) for sigma in (0.01, 0.25) for n in range(3)])
    sweep = sweep.assign(**{name: rng.lognormal(size=6) for name in columns})
    run = rhec.simulate(rhec.Scenario(duration_s=100.0))
    given = dict(runs={0.25: run, 0.01: run}, printed=0.25, prediction=0.01)
    analysis = interpretations.ekf_on_a_straight([0.01, 0.1, 1.0])
    gains, yaw, _ = plots.ekf_yaw(analysis, sweep, **given).axes
    sigmas = pd.DataFrame(dict(sigma_kappa=[0.01, 0.25], straight=[2.0, 3.0], curve=[0.1, 0.2]))
    stated, simulated, time = plots.rhe_kappa(sigmas, sweep, **given).axes
    curves = [
        (gains, analysis[["gain_position", "gain_yaw_radpm"]], ()),
        (yaw, analysis[["sigma_yaw_rad"]], ("rms_yaw_rad",)),
        (stated, sigmas[["straight", "curve"]], ()),
        (simulated, None, ("rms_kappa_straights", "rms_kappa_curves")),
    ]
    for axes, table, means in curves:
        assert axes.get_xscale() == "log"
        upright = [line for line in axes.lines if [*line.get_ydata()] == [0, 1]]
        assert [line.get_xdata()[0] for line in upright] == [0.25, 0.01]
        assert [line.get_label() for line in upright] == ["printed", "prediction"]
        for line, name in zip(axes.lines, () if table is None else table):
            np.testing.assert_array_equal(line.get_ydata(), table[name])
        for bars, name in zip(axes.containers, means, strict=True):
            of = sweep.groupby("sigma")[name]
            np.testing.assert_allclose(bars.lines[0].get_ydata(), of.mean())
            half = [np.ptp(segment[:, 1]) / 2 for segment in bars.lines[2][0].get_segments()]
            np.testing.assert_allclose(half, 4.303 * of.std() / 3**0.5, rtol=1e-3)
    levels = [line.get_ydata()[0] for axes in (stated, simulated) for line in axes.lines]
    assert sum(level == pytest.approx(12**-0.5) for level in levels) == 2  # any κ in [0, 1]
    begins_s = run.log["t_s"][~run.log["on_straight"]].min()
    low_s, high_s = time.get_xlim()
    assert low_s < begins_s < high_s and len(time.collections) == 1


def test_each_reading_has_a_line_of_its_own_name_and_colour():
    """Vermillion where the interval of the change is above 0, blue where it is below."""
    table = pd.read_csv(ROOT / "data/results/audit_interpretations.csv")
    figure = plots.forest(table, "printed")
    panels = figure.axes[: len(plots.QUANTITIES)]
    labels = [label.get_text() for label in panels[0].get_yticklabels()]
    for axes, quantity in zip(panels, plots.QUANTITIES.values()):
        rows = table[(table["quantity"] == quantity) & (table["interpretation"] != "baseline")]
        assert labels == [f"{row.words}  {row.interpretation}" for row in rows.itertuples()]
        colours = {line.get_ydata()[0]: line.get_color() for line in axes.lines[:-1]}
        for place, row in enumerate(rows.itertuples()):
            sign = (row.change_low > 0) - (row.change_high < 0)
            assert colours[place] == {1: VERMILLION, 0: GREY, -1: BLUE}[sign]
    assert text_defects(figure) == []
