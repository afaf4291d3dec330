"""The inverse problem: the method finds posteriors that are known, the files hold what the code
drives, and the worlds are such that they can be driven.
"""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import rhec
from notebooks.studies import abc_regression, which_worlds
from rhec import paper

SIGMA = 0.1  # noise of the toy problem
OBSERVED = 0.4


@pytest.fixture(scope="module")
def toy():
    """θ uniform on [0, 1], observed with Gaussian noise; and a second θ that nothing depends on."""
    rng = np.random.default_rng(0)
    unit = rng.random((20_000, 2))
    statistics = unit[:, :1] + SIGMA * rng.standard_normal((20_000, 1))
    world = np.arange(20_000)
    flags = np.zeros(2, bool)
    return abc_regression.Simulations(unit, world, statistics, np.ones(1), flags)


def test_posterior_is_the_known_one_and_the_priors_where_nothing_is_known(toy):
    draws = abc_regression.posterior(toy, np.array([OBSERVED]), 2000)
    unit, _ = abc_regression.resample(draws, 4000, np.random.default_rng(1))
    known = stats.truncnorm(-OBSERVED / SIGMA, (1 - OBSERVED) / SIGMA, OBSERVED, SIGMA)
    assert unit[:, 0].mean() == pytest.approx(known.mean(), abs=0.01)
    assert unit[:, 0].std() == pytest.approx(known.std(), rel=0.06)
    assert np.abs(np.quantile(unit[:, 1], [0.1, 0.5, 0.9]) - [0.1, 0.5, 0.9]).max() < 0.04
    assert draws.weights.sum() == pytest.approx(1)
    assert 500 < draws.effective_worlds <= 2000


def test_regression_corrects_what_a_wide_tolerance_leaves(toy):
    """With two fifths of all simulations kept, the plain ones are far too wide."""
    draws = abc_regression.posterior(toy, np.array([OBSERVED]), 8000)
    plain = toy.unit[toy.world[draws.rows], 0]
    assert np.sqrt(np.cov(draws.unit[:, 0], aweights=draws.weights)) < 1.1 * SIGMA
    assert plain.std() > 1.15 * SIGMA


def test_ranks_are_uniform_for_right_posteriors_and_not_for_narrow_ones(toy):
    rng = np.random.default_rng(2)
    rows = rng.choice(20_000, 300, replace=False)
    right = abc_regression.ranks(toy, rows, 1000, 99, rng)
    assert stats.kstest((right[:, 0] + 0.5) / 100, "uniform").pvalue > 0.01
    narrow = toy._replace(unit=np.clip(0.5 + 0.5 * (toy.unit - 0.5), 0, 1))
    found = abc_regression.posterior(narrow, np.array([OBSERVED]), 1000)
    wrong = np.sum(found.unit[:99, 0] < toy.unit[rows, 0, None], axis=1)
    assert stats.kstest((wrong + 0.5) / 100, "uniform").pvalue < 1e-6
    shares = abc_regression.coverage(right, 99, (0.5, 0.9))[:, 0]
    assert np.abs(shares - [0.5, 0.9]).max() < 0.1


def test_the_own_world_of_a_truth_is_left_out(toy):
    draws = abc_regression.posterior(toy, toy.statistics[7], 500, but_world=7)
    assert 7 not in toy.world[draws.rows]


def test_a_draw_comes_as_often_as_its_weight_says():
    weights = np.array([0.5, 0.3, 0.2])
    draws = abc_regression.Draws(np.eye(3), weights, np.array([4, 5, 6]), 3.0)
    _, rows = abc_regression.resample(draws, 1000, np.random.default_rng(0))
    assert [*np.bincount(rows)[4:]] == pytest.approx(1000 * weights, abs=1)


def test_the_papers_own_numbers_meet_all_statements():
    statistics = which_worlds.observed()[None]
    assert which_worlds.meets(statistics).all()
    worse = statistics + [[0.3, 0.3, 1.0, 3.0, 0.1, 0.1, 0.1, 0.1]]
    assert not which_worlds.meets(worse).any()


def test_worlds_of_the_prior_fill_their_ranges():
    worlds = which_worlds.worlds_at(which_worlds.sample_unit(256))
    for name, prior in which_worlds.PRIORS.items():
        assert worlds[name].between(prior.least, prior.most).all()
        middle = np.sqrt(prior.least * prior.most) if prior.logarithmic else None
        middle = (prior.least + prior.most) / 2 if middle is None else middle
        assert np.mean(worlds[name] < middle) == pytest.approx(0.5, abs=0.02) or name == (
            "command_delay"
        )


def test_bumps_let_the_yaw_walk_as_far_as_the_prior_says():
    """Oracle: a Gauss-Markov yaw rate along the way, summed up, over 40 m on 4000 ways."""
    world = which_worlds.worlds_at(which_worlds.sample_unit(4)).iloc[1]
    fields = which_worlds.fields_of(world)
    step_m = 0.02
    keep = np.exp(-step_m / fields["rut_length_m"])
    noise = np.random.default_rng(0).standard_normal((2000, 4000))
    rut = noise[0]
    yaw = np.zeros(4000)
    for row in noise:
        rut = keep * rut + np.sqrt(1 - keep**2) * row
        yaw += rut * fields["bump_sigma_radps"] / paper.SPEED_MPS * step_m
    expected = world["bump_diffusion_radpsqrtm"] * np.sqrt(40.0)
    assert yaw.std() == pytest.approx(expected, rel=0.06)


def test_posterior_worlds_can_be_driven_and_lie_in_the_prior():
    worlds = which_worlds.posterior_worlds()
    assert len(worlds) == which_worlds.DRAWS
    for world in worlds:
        scenario = rhec.Scenario(**world)
        turn = scenario.mu_mean * scenario.speed_mps / scenario.headland_radius_m
        assert turn < scenario.kappa_mean * scenario.omega_max_radps
    table = pd.DataFrame(worlds)
    for name in set(which_worlds.PRIORS) & set(table):
        prior = which_worlds.PRIORS[name]
        assert table[name].between(prior.least * (1 - 1e-4) - 1e-6, prior.most + 1e-4).all() or (
            prior.least < 0
        )


def test_the_centre_is_a_world_in_the_middle():
    centre = which_worlds.centre()
    rhec.Scenario(**centre)
    table = which_worlds.posterior_table()
    for name in set(centre) & set(table.select_dtypes("number")) - {"command_delay"}:
        assert 0.4 < np.mean(table[name] <= centre[name]) < 0.6, name


def test_files_hold_what_the_code_drives():
    world = 5
    fields = which_worlds.fields_of(which_worlds.worlds_at(which_worlds.sample_unit()).iloc[world])
    seed = which_worlds.FIRST_SEED + which_worlds.FIELDS * world
    now = which_worlds.drive([fields], seed, variants=("ekf_calibrated",))["ekf_calibrated"]
    then = which_worlds.prior_drives().loc[world]["ekf_calibrated"]
    assert np.array_equal(now["violations"].clip(upper=254), then["violations"])
    assert np.abs(np.log(now["error"].to_numpy() / then["error"].to_numpy())).max() < 0.0101


def test_bytes_hold_a_table_up_to_rounding():
    drives = which_worlds.prior_drives().iloc[:64]
    again = which_worlds._unpacked(which_worlds._packed(drives))
    pd.testing.assert_frame_equal(again, drives)


def test_shares_count_drives_and_worlds():
    """Two worlds; in the first, two of eight drives are the paper's, in the second none."""
    statistics = np.tile(which_worlds.observed() + 1.0, (16, 1))
    statistics[:2] = which_worlds.observed()
    table = which_worlds.shares(statistics)
    assert table.loc["all statements together", "drives"] == 2 / 16
    assert table.loc["all statements together", "worlds"] == 1 / 2
    statistics[0, 4] = 1.0  # its estimates are off the bound, which is none of the four numbers
    table = which_worlds.shares(statistics)
    assert table.loc["the four numbers together", "drives"] == 2 / 16
    assert table.loc["all statements together", "drives"] == 1 / 16
    assert (table["drives_low"] <= table["drives"]).all()
    assert (table["drives"] <= table["drives_high"]).all()


def test_an_interrupted_campaign_goes_on_with_the_blocks_that_it_kept(monkeypatch, tmp_path):
    drives = which_worlds.prior_drives()
    driven = []

    def look_up(fields, first_seed):
        first = first_seed - which_worlds.FIRST_SEED
        driven.append(first // which_worlds.FIELDS)
        return drives.iloc[first : first + which_worlds.FIELDS * len(fields)]

    monkeypatch.setattr(which_worlds, "drive", look_up)
    monkeypatch.setattr(which_worlds, "_BLOCK", 4)
    few = which_worlds.drive_prior(3, tmp_path)
    more = which_worlds.drive_prior(10, tmp_path)
    assert driven == [0, 4, 8]
    assert len(few) == 3 * which_worlds.FIELDS
    stored = which_worlds._packed(drives.iloc[: 10 * which_worlds.FIELDS])
    assert np.array_equal(more, stored)
