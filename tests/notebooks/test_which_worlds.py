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


def test_a_simulation_counts_as_much_as_its_prior_says(toy):
    """Oracle: with a prior of 2θ instead of 1 the posterior is that of the product."""
    tilted = toy._replace(prior=2 * toy.unit[:, 0])
    draws = abc_regression.posterior(tilted, np.array([OBSERVED]), 2000)
    theta = np.linspace(0, 1, 2001)
    density = theta * stats.norm.pdf(theta, OBSERVED, SIGMA)
    mean = np.sum(theta * density) / density.sum()
    assert np.average(draws.unit[:, 0], weights=draws.weights) == pytest.approx(mean, abs=0.012)


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


def test_a_proposal_lies_about_the_draws_and_leaves_alone_what_they_do_not_tell(toy):
    draws = abc_regression.posterior(toy, np.array([0.8]), 1000)
    found = abc_regression.proposal(draws, np.array([False, False]))
    points = found.unit_at(np.random.default_rng(6).random((4000, 2)))
    assert np.median(points[:, 0]) == pytest.approx(0.8, abs=0.02)
    assert found.mean[1] == 0 and [*found.covariance[1]] == [0, 1]
    kept = abc_regression.proposal(draws, np.array([True, False]))
    assert not kept.mean.any() and np.array_equal(kept.covariance, np.eye(2))


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


def test_bumps_let_the_yaw_walk_as_far_as_the_prior_says():
    """Oracle: a Gauss-Markov yaw rate along the way, summed up, over 40 m on 4000 ways."""
    world = which_worlds.worlds_at(which_worlds.first_round(4).unit).iloc[1]
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


@pytest.fixture(scope="module")
def world():
    """The fields of a world of the prior."""
    unit = which_worlds.first_round(8).unit
    return which_worlds.fields_of(which_worlds.worlds_at(unit).iloc[3])


def test_excursions_are_counted(world):
    """A robot that leaves the tolerance for 3 samples, returns, and leaves it 4 s later."""
    printed = which_worlds.VARIANTS["rhe_printed"]
    run = rhec.simulate(which_worlds.scenario(world | dict(duration_s=30.0), printed, 7))
    c = run.columns
    c["error_m"][:] = 0.0
    c["on_straight"][:] = True
    for sample in (60, 61, 62, 82):
        c["error_m"][sample] = 0.2
    assert which_worlds.count_excursions(run, 5.0) == 2


def test_a_prior_on_the_printed_w_is_what_it_says():
    drives = which_worlds.prior_drives().iloc[: 16 * which_worlds.FIELDS]
    design = which_worlds.first_round(16)
    for printed in (0.5, 0.8):
        table = which_worlds.simulations(drives, design, printed=printed)
        weights = table.prior.reshape(len(which_worlds.CHOICES), -1).sum(axis=1)
        by_choice = dict(zip(which_worlds.CHOICES, weights))
        for place in (0, 1):
            of_printed = sum(by_choice[c] for c in by_choice if c[place] in which_worlds.PRINTED)
            assert of_printed / table.prior.sum() == pytest.approx(printed)


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


def test_the_posterior_rests_on_as_many_worlds_as_it_says():
    """At least 300 effective worlds, of which those that are driven again are some 150 or more.

    Each world is among the draws that are driven again as often as its weight says, rounded up or
    down for each of its simulations, whichever way these were ordered.
    """
    drives = which_worlds.prior_drives()
    table = which_worlds.simulations(drives, which_worlds.both_rounds(drives))
    draws = abc_regression.posterior(table, which_worlds.observed(), which_worlds.KEEP)
    assert draws.effective_worlds > 300
    driven = which_worlds.posterior_table()
    n_worlds = table.world.max() + 1
    worlds = table.world[draws.rows]
    counts = np.bincount(driven["world"], minlength=n_worlds)
    wanted = len(driven) * draws.weights
    assert np.all(counts >= np.bincount(worlds, np.floor(wanted), minlength=n_worlds))
    assert np.all(counts <= np.bincount(worlds, np.ceil(wanted), minlength=n_worlds))
    assert which_worlds.effective_number(driven["world"]) > 150


def test_a_median_of_worlds_has_the_interval_of_its_order_statistics(monkeypatch):
    """Oracle: of n draws, the rank of the median is normal with a deviation of √n / 2."""
    n, rng = 400, np.random.default_rng(0)
    fields = {name: rng.permutation(n) for name in which_worlds._CENTRE_STEPS}
    table = pd.DataFrame(fields | dict(world=np.arange(n)))
    monkeypatch.setattr(which_worlds, "posterior_table", lambda: table)
    found = which_worlds.beside_the_default()
    half = (found["high"] - found["low"]).mean() / 2
    assert half == pytest.approx(1.96 * np.sqrt(n) / 2, rel=0.04)
    assert (found["low"] < found["median"]).all() and (found["median"] < found["high"]).all()
    assert list(found["p95"] - found["p5"]) == pytest.approx([0.9 * (n - 1)] * len(found))


@pytest.mark.parametrize("world", [5, which_worlds.FIRST_ROUND + 7])
def test_files_hold_what_the_code_drives(world):
    """Each robot on both fields, and all that is kept of its drives."""
    stored = which_worlds.prior_drives()
    unit = which_worlds.both_rounds(stored).unit
    fields = which_worlds.fields_of(which_worlds.worlds_at(unit[[world]]).iloc[0])
    seed = which_worlds.FIRST_SEED + which_worlds.FIELDS * world
    now = which_worlds.kept(which_worlds.drive([fields], seed)).astype(float)
    then = stored.loc[[world]]
    assert list(now.columns) == list(then.columns)
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


def test_shares_count_drives():
    """Two worlds; in the first, one of two drives is the paper's, in the second none."""
    statistics = np.tile(which_worlds.observed() + 1.0, (4, 1))
    statistics[0] = which_worlds.observed()
    table = which_worlds.shares(statistics)
    assert table.loc["all statements together", "drives"] == 1 / 4
    statistics[0, 4] = 1.0  # its estimates are off the bound, which is none of the four numbers
    table = which_worlds.shares(statistics)
    assert table.loc["the four numbers together", "drives"] == 1 / 4
    assert table.loc["all statements together", "drives"] == 0
    assert (table["drives_low"] <= table["drives"]).all()
    assert (table["drives"] <= table["drives_high"]).all()


def test_worlds_that_come_twice_count_less():
    assert which_worlds.effective_number([3, 5, 8, 9]) == 4
    assert which_worlds.effective_number([3, 3, 3, 3]) == 1
    assert which_worlds.effective_number([3, 3, 5]) == pytest.approx(9 / 5)


def test_an_interrupted_campaign_goes_on_with_the_blocks_that_it_kept(monkeypatch, tmp_path):
    drives = which_worlds.prior_drives()
    driven = []

    def look_up(worlds, first_seed):
        first = first_seed - which_worlds.FIRST_SEED
        driven.append(first // which_worlds.FIELDS)
        return drives.iloc[first : first + which_worlds.FIELDS * len(worlds)]

    monkeypatch.setattr(which_worlds, "drive", look_up)
    monkeypatch.setattr(which_worlds, "_BLOCK", 4)
    unit = which_worlds.first_round(12).unit
    few = which_worlds.drive_round(unit[:4], 0, tmp_path)
    more = which_worlds.drive_round(unit, 0, tmp_path)
    assert driven == [0, 4, 8]
    assert len(few) == 4 * which_worlds.FIELDS
    pd.testing.assert_frame_equal(
        more, drives.iloc[: 12 * which_worlds.FIELDS], rtol=1e-3, check_names=False
    )


def test_the_files_in_git_are_those_that_the_drives_give(monkeypatch, tmp_path):
    """Of both rounds, and of the posterior, whose worlds were drawn in another order once."""
    stored = which_worlds.prior_drives()
    last = which_worlds.read(which_worlds.POSTERIOR_DRIVES).astype(np.float16)
    worlds = which_worlds.posterior_table()
    for name in ("PRIOR_DRIVES", "POSTERIOR_WORLDS", "POSTERIOR_DRIVES"):
        monkeypatch.setattr(which_worlds, name, tmp_path / name)

    def drive_round(unit, first_world, folder):
        assert folder == tmp_path
        return stored.loc[first_world : first_world + len(unit) - 1]

    monkeypatch.setattr(which_worlds, "drive_round", drive_round)
    monkeypatch.setattr(which_worlds, "drive_posterior", lambda: last)
    monkeypatch.setattr("sys.argv", ["which_worlds", "--folder", str(tmp_path)])
    which_worlds.main()
    pd.testing.assert_frame_equal(which_worlds.prior_drives(), stored)
    made = which_worlds.posterior_table()
    assert list(made) == list(worlds) and len(made) == len(worlds)
    written = which_worlds.read(which_worlds.POSTERIOR_DRIVES)
    pd.testing.assert_frame_equal(written, last.astype(float))
