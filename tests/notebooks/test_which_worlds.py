"""The inverse problem: the method finds posteriors that are known, the files hold what the code
drives, and the worlds are such that they can be driven.
"""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from notebooks.studies import abc_regression, which_worlds

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
    return abc_regression.Simulations(unit, world, statistics, np.ones(1), flags, np.ones(20_000))


def test_posterior_is_the_known_one_and_the_priors_where_nothing_is_known(toy):
    draws = abc_regression.posterior(toy, np.array([OBSERVED]), 2000)
    unit, _ = abc_regression.resample(draws, 4000, np.random.default_rng(1))
    known = stats.truncnorm(-OBSERVED / SIGMA, (1 - OBSERVED) / SIGMA, OBSERVED, SIGMA)
    assert unit[:, 0].mean() == pytest.approx(known.mean(), abs=0.01)
    assert unit[:, 0].std() == pytest.approx(known.std(), rel=0.06)
    assert np.abs(np.quantile(unit[:, 1], [0.1, 0.5, 0.9]) - [0.1, 0.5, 0.9]).max() < 0.04
    without = abc_regression.posterior(toy, toy.statistics[7], 500, but_world=7)
    assert 7 not in toy.world[without.rows]
    assert draws.weights.sum() == pytest.approx(1)
    assert 500 < draws.effective_worlds <= 2000


def test_ranks_are_uniform_for_right_posteriors_and_not_for_narrow_ones(toy):
    rng = np.random.default_rng(2)
    rows = rng.choice(20_000, 300, replace=False)
    right = abc_regression.ranks(toy, rows, 1000, 99, rng)
    assert stats.kstest((right[:, 0] + 0.5) / 100, "uniform").pvalue > 0.01
    narrow = toy._replace(unit=np.clip(0.5 + 0.5 * (toy.unit - 0.5), 0, 1))
    found = abc_regression.posterior(narrow, np.array([OBSERVED]), 1000)
    wrong = np.sum(found.unit[:99, 0] < toy.unit[rows, 0, None], axis=1)
    assert stats.kstest((wrong + 0.5) / 100, "uniform").pvalue < 1e-6
    table = abc_regression.calibration(np.column_stack([right[:, 0], wrong]), 99, ["one", "two"])
    shares = table.loc["one", ["middle 50%", "middle 90%"]]
    assert [*shares] == pytest.approx([0.5, 0.9], abs=0.1)
    assert table.loc["two", "p"] < 1e-5 and 0.05 < table.loc["one", "p"] <= 1


def test_of_uniform_ranks_one_unknown_in_twenty_is_called_wrong():
    """Whichever of three it is, p is below 0.05 in that share of all checks, or less often."""
    rng = np.random.default_rng(3)
    tables = [
        abc_regression.calibration(rng.integers(0, 100, (50, 3)), 99, [*"abc"]) for _ in range(200)
    ]
    called = [(table["p"] < 0.05).any() for table in tables]
    assert 0.02 < np.mean(called) < 0.08


def test_worlds_of_a_second_round_count_as_the_prior_says():
    """Oracle: the posterior of the first parameter, from worlds that a wrong proposal drew, too."""
    rng = np.random.default_rng(5)
    near = abc_regression.Proposal(np.array([0.5, 0.0]), np.array([[0.3, 0.1], [0.1, 1.0]]))
    first, second = rng.random((2, 10_000, 2))
    unit = np.concatenate([first, near.unit_at(second)])
    weights = near.weights(unit, 0.5)
    assert weights.mean() == pytest.approx(1, abs=0.02) and weights.max() <= 2
    assert np.average(unit, axis=0, weights=weights) == pytest.approx([0.5, 0.5], abs=0.01)
    statistics = unit[:, :1] + SIGMA * rng.standard_normal((20_000, 1))
    table = abc_regression.Simulations(
        unit, np.arange(20_000), statistics, np.ones(1), np.zeros(2, bool), weights
    )
    draws = abc_regression.posterior(table, np.array([OBSERVED]), 2000)
    known = stats.truncnorm(-OBSERVED / SIGMA, (1 - OBSERVED) / SIGMA, OBSERVED, SIGMA)
    mean = np.average(draws.unit[:, 0], weights=draws.weights)
    assert mean == pytest.approx(known.mean(), abs=0.01)


def test_truths_are_of_different_worlds_and_as_likely_as_the_prior_says(toy):
    """Of the four simulations of a world two are nine times as likely as the others."""
    numbers = np.arange(20_000)
    table = toy._replace(world=numbers // 4, prior=np.where(numbers % 2, 1.0, 9.0))
    rng = np.random.default_rng(1)
    rows = which_worlds.truths(table, 500, rng, None)
    assert len({*table.world[rows]}) == len(rows) == 500
    assert np.mean(rows % 2 == 0) == pytest.approx(0.9, abs=0.04)
    near = abc_regression.Draws(np.zeros((40, 2)), np.ones(40), np.arange(100, 140), 10.0)
    few = which_worlds.truths(table, 500, rng, near)
    assert {*table.world[few]} == {*range(25, 35)} and {*few} <= {*near.rows}


def test_what_the_posterior_depends_on_is_told_alike(monkeypatch):
    """By violations and with even odds it is that of all simulations that are kept."""
    monkeypatch.setattr(which_worlds, "KEPT", which_worlds.KEPT[-1:])
    monkeypatch.setattr(which_worlds, "PRIORS_ON_PRINTED", which_worlds.PRIORS_ON_PRINTED[::2])
    drives = which_worlds.prior_drives()
    design = which_worlds.both_rounds(drives)
    usual = which_worlds.by_kept(which_worlds.simulations(drives, design), 500, 1).iloc[0]
    table = which_worlds.sensitivity(drives, design, 500, 1)
    readings = ("violations", "excursions")
    assert [*table.index] == [(counts, prior) for counts in readings for prior in ("50%", "95%")]
    assert table.iloc[0].to_dict() == usual.drop("largest distance").to_dict()
    for _, rows in table.groupby(level=0):
        printed = rows[["RHE printed", "RHE smoothed"]].astype(float).sum(axis=1)
        assert (np.diff(printed) > 0).all()
        np.testing.assert_allclose(printed + rows["RHE free"].astype(float), 1, atol=2e-3)
    assert len(table.drop_duplicates()) == 4


def test_files_hold_what_the_code_drives(monkeypatch):
    """Each robot on both fields of a world with ruts shorter than a sample, and of the next one."""
    monkeypatch.setattr(which_worlds, "_BLOCK", 1)
    stored = which_worlds.prior_drives()
    first = which_worlds.FIRST_ROUND + 9
    unit = which_worlds.both_rounds(stored).unit[first : first + 2]
    now = which_worlds.drive_round(unit, first)
    then = stored.loc[first : first + 1]
    assert list(now.columns) == list(then.columns)
    assert [*now.index] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    np.testing.assert_allclose(now, then, rtol=2e-3)


def test_the_posterior_and_the_two_middle_worlds_were_driven_as_they_are_now():
    """One world of each, on its own fields, which no world of either round has."""
    drives = which_worlds.posterior_drives()
    first = dict(posterior=0, default=which_worlds.DRAWS)
    first["centre"] = first["default"] + which_worlds.COPIES
    worlds = which_worlds.middle_worlds() | dict(posterior=which_worlds.posterior_worlds()[2])
    variants = {name: which_worlds.VARIANTS[name] for name in ("rhe_free", "ekf_free")}
    for name, world in worlds.items():
        assert len(drives[name]) % which_worlds.FIELDS == 0
        place = first[name] + 2
        seed = which_worlds.UNUSED_SEED + which_worlds.FIELDS * place
        now = which_worlds.drive([world], seed, variants)
        then = drives[name].loc[place]
        for variant in variants:
            error_m = then[variant]["error"].to_numpy()
            assert now[variant]["error"].to_numpy() == pytest.approx(error_m, rel=1e-3)


def test_the_files_in_git_are_those_that_the_drives_give(monkeypatch, tmp_path):
    """Of both rounds, and of the posterior, whose worlds were drawn in another order once."""
    stored = which_worlds.prior_drives()
    last = which_worlds.read(which_worlds.POSTERIOR_DRIVES).astype(np.float16)
    worlds = which_worlds.posterior_table()
    for name in ("PRIOR_DRIVES", "POSTERIOR_WORLDS", "POSTERIOR_DRIVES"):
        monkeypatch.setattr(which_worlds, name, tmp_path / name)

    def drive_round(unit, first_world):
        return stored.loc[first_world : first_world + len(unit) - 1]

    monkeypatch.setattr(which_worlds, "drive_round", drive_round)
    monkeypatch.setattr(which_worlds, "drive_posterior", lambda: last)
    which_worlds.main()
    pd.testing.assert_frame_equal(which_worlds.prior_drives(), stored)
    made = which_worlds.posterior_table()
    assert list(made) == list(worlds) and len(made) == len(worlds)
    written = which_worlds.read(which_worlds.POSTERIOR_DRIVES)
    pd.testing.assert_frame_equal(written, last.astype(float))
