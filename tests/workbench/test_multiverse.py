"""The multiverse: every drawn world is one that can be driven, verdicts follow the runs, and a
planted cause is found.
"""

import numpy as np
import pandas as pd
import pytest

import rhec
from rhec.simulation import closed_loop
from rhec.tracked_robot import terrain
from rhec.workbench.plots.multiverse import multiverse_map
from rhec.workbench.studies import multiverse
from rhec.workbench.studies.calibration import TRAINING_SEEDS
from rhec.workbench.studies.statistics import FAILS, HOLDS, UNDECIDED

WORLDS, SEEDS = 64, 5


@pytest.fixture(scope="module")
def drawn():
    return multiverse.sample_parameters(WORLDS)


def made_up(drawn, **errors):
    """Runs whose metrics are all one, but for mean errors {variant: (worlds, seeds)}."""
    metrics = (
        "settling_time_s",
        "mean_error_m",
        "mean_error_true_m",
        "max_error_true_m",
        "violations",
        "violations_true",
        "overshoot_m",
        "rms_mu",
        "rms_kappa",
        "rms_yaw_rad",
        "omega_peak_radps",
        "mu_deviation",
        "kappa_deviation",
    )
    runs = {
        variant: pd.DataFrame(1.0, range(len(drawn) * SEEDS), metrics).assign(arrived=True)
        for variant in multiverse.VARIANTS
    }
    for variant, values in errors.items():
        runs[variant]["mean_error_m"] = np.ravel(values)
    return runs


def test_worlds_fill_their_ranges_and_are_reproducible(drawn):
    for name, (least, most, logarithmic) in multiverse.UNKNOWNS.items():
        unit = (
            (np.log(drawn[name] / least) / np.log(most / least))
            if logarithmic
            else (drawn[name] - least) / (most - least)
        )
        assert (
            unit.between(0, 1).all()
            and unit.nunique() == WORLDS
            and unit.min() < 0.1
            and unit.max() > 0.9
        )
    pd.testing.assert_frame_equal(drawn, multiverse.sample_parameters(WORLDS))
    together = multiverse.sample_parameters(256).corr(method="spearman").to_numpy() - np.eye(
        len(drawn.columns)
    )
    assert np.abs(together).max() < 0.1


def test_every_world_can_be_driven_and_compiles_little_new(drawn):
    shapes = {terrain.common_shape(closed_loop.set_up(rhec.Scenario()).terrain)}
    largest = drawn.assign(
        radius=drawn["speed_mps"] * drawn["mu_mean"] / drawn["kappa_mean"] / drawn["turn_demand"]
    ).nlargest(3, "radius")
    for world in [*largest.drop(columns="radius").to_dict("records"), drawn.loc[0].to_dict()]:
        for variant in multiverse.VARIANTS:
            scenario = multiverse.scenario(world, variant, 2000)
            made = closed_loop.set_up(scenario)
            asked = (
                world["mu_mean"]
                * world["speed_mps"]
                / world["kappa_mean"]
                / scenario.headland_radius_m
            )
            assert asked == pytest.approx(0.1 * world["turn_demand"])
            shapes.add(terrain.common_shape(made.terrain))
    assert len(shapes) <= 2  # a loop is compiled for each


def test_seeds_are_neither_the_ledger_s_nor_the_calibration_s():
    assert multiverse.FIRST_SEED >= 1000 and max(TRAINING_SEEDS) < multiverse.FIRST_SEED


@pytest.mark.parametrize(
    "values, verdict",
    [
        ([0.5, 0.6, 0.4, 0.5, 0.5], HOLDS),
        ([-0.5, -0.6, -0.4, -0.5, -0.5], FAILS),
        ([0.5, -0.6, 0.4, -0.5, 0.1], UNDECIDED),
        ([True] * 5, HOLDS),
        ([True] * 4 + [False], FAILS),
        ([0.2] * 5, HOLDS),
        ([0.0] * 5, FAILS),  # at the bound, which is not included
    ],
)
def test_a_claim_in_a_world(values, verdict):
    assert multiverse.in_world(np.array(values)) == (verdict, pytest.approx(np.mean(values)))


def test_a_planted_cause_decides(drawn):
    """The EKF is made worse than the RHE by just so much as κ differs from 0.8: that unknown, and
    that direction, must come out.
    """
    rng = np.random.default_rng(0)
    advantage = 5 * (0.8 - drawn["kappa_mean"].to_numpy()[:, None]) + 0.1 * rng.normal(
        size=(WORLDS, SEEDS)
    )
    verdicts, margins = multiverse.judge(made_up(drawn, ekf_c=np.exp(advantage)), WORLDS)
    rows = multiverse.summary(drawn, verdicts, margins).set_index("id")
    row = rows.loc["B5 c"]
    assert (row.decided_by, row.direction) == (
        "kappa_mean",
        "less helps",
    ) and row.rank_correlation < -0.9
    assert (
        row.holds == (verdicts["B5 c"] == HOLDS).mean()
        and row.low < row.holds < row.high
        and row.worlds == WORLDS
    )
    assert 0.3 < row.holds < 0.7 and row.holds + row.undecided + row.fails == pytest.approx(1)
    assert rows.drop("B5 c")["decided_by"].eq("").all()


def test_noise_is_no_discovery(drawn):
    rng = np.random.default_rng(1)
    margins = pd.DataFrame(rng.normal(size=(WORLDS, 20)))
    _, discovered = multiverse.correlations(drawn, margins)
    assert discovered.to_numpy().mean() < 0.02


def test_the_map_shows_every_claim_and_unknown(drawn):
    verdicts, margins = multiverse.judge(made_up(drawn), WORLDS)
    correlations, discovered = multiverse.correlations(drawn, margins)
    bars, heat, _ = multiverse_map(
        multiverse.summary(drawn, verdicts, margins), correlations, discovered
    ).axes
    assert len(bars.get_yticklabels()) == len(multiverse.CLAIMS) and len(
        heat.get_xticklabels()
    ) == len(multiverse.UNKNOWNS)
