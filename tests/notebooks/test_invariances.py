"""What is done to the samples of a claim, and what must follow for its verdict and its interval."""

from typing import NamedTuple

import numpy as np
import pytest

from notebooks.studies import statistics

RNG = np.random.default_rng(1)
SHARED = RNG.normal(size=60)
ONE, OTHER = 2 + RNG.normal(size=60) + SHARED, 1 + SHARED
ONE_LOST = RNG.normal(size=60) < 1.2, RNG.normal(size=60) < 1.4
BOUNDS = dict(above=0.4, below=1.3)
UNIT = 1000.0  # metres told in millimetres


class Judged(NamedTuple):
    """A rule, its samples and bounds, its value, and how that follows."""

    rule: object
    samples: tuple
    value: float
    bounds: dict
    has_unit: bool = False  # whether its value has the unit of the samples
    has_sign: bool = False  # whether it is that of the mirrored samples with the other sign


MEAN = ONE.mean()
GAIN = (ONE - OTHER).mean()
FLAGS, ORACLE = ONE_LOST
RULES = {
    "mean": Judged(statistics.mean, (ONE,), MEAN, BOUNDS, True, True),
    "difference": Judged(statistics.difference, (ONE, OTHER), GAIN, BOUNDS, True, True),
    "ratio": Judged(statistics.ratio, (ONE, OTHER), MEAN / OTHER.mean(), BOUNDS),
    "share twice": Judged(statistics.share_twice, (ONE, OTHER), np.mean(ONE > 2 * OTHER), BOUNDS),
    "share less": Judged(statistics.share_less, (ONE, OTHER), np.mean(ONE < OTHER), BOUNDS),
}
OF_FLAGS = {
    "share": Judged(statistics.share, (FLAGS,), FLAGS.mean(), dict(above=0.5)),
    "relative to oracle": Judged(
        statistics.relative_to_oracle, ONE_LOST, FLAGS[ORACLE].mean(), dict(above=0.5)
    ),
}
ALL = RULES | OF_FLAGS


@pytest.mark.parametrize("name", ALL)
def test_a_rule_holds_above_its_bound_fails_below_it_and_is_open_where_it_is_near(name):
    judged = ALL[name]
    found = judged.rule(*judged.samples, above=0.0)
    assert found.low < found.value < found.high and found.value == pytest.approx(judged.value)
    assert found.n == (ORACLE.sum() if name == "relative to oracle" else 60)
    for bound, above, below in (
        (found.low - 1e-9, statistics.HOLDS, statistics.FAILS),
        (found.value, statistics.UNDECIDED, statistics.UNDECIDED),
        (found.high + 1e-9, statistics.FAILS, statistics.HOLDS),
    ):
        assert judged.rule(*judged.samples, above=bound).verdict == above
        if name != "relative to oracle":
            assert judged.rule(*judged.samples, below=bound).verdict == below


def scaled(factor, values):
    return tuple(factor * sample for sample in values)


def assert_finding(found, expected, factor=1.0):
    """The same verdict, n and p; value and interval are larger by a factor."""
    ends = sorted((factor * expected.low, factor * expected.high))
    assert (found.verdict, found.n) == (expected.verdict, expected.n)
    np.testing.assert_allclose(
        [found.value, found.low, found.high], [factor * expected.value, *ends], rtol=1e-9
    )
    np.testing.assert_allclose(found.p, expected.p, rtol=1e-6)


@pytest.mark.parametrize("name", ALL)
def test_a_finding_does_not_depend_on_the_order_of_the_drives(name):
    judged = ALL[name]
    order = np.random.default_rng(2).permutation(60)
    in_order = judged.rule(*(sample[order] for sample in judged.samples), **judged.bounds)
    assert_finding(in_order, judged.rule(*judged.samples, **judged.bounds))


@pytest.mark.parametrize("name", RULES)
def test_a_finding_follows_the_unit_of_the_samples(name):
    judged = RULES[name]
    expected = judged.rule(*judged.samples, **judged.bounds)
    factor = UNIT if judged.has_unit else 1.0
    bounds = {end: factor * value for end, value in judged.bounds.items()}
    assert_finding(judged.rule(*scaled(UNIT, judged.samples), **bounds), expected, factor)


@pytest.mark.parametrize("name", [name for name in RULES if RULES[name].has_sign])
def test_a_finding_in_a_mirror_is_the_mirror_image(name):
    judged = RULES[name]
    expected = judged.rule(*judged.samples, **judged.bounds)
    bounds = dict(above=-judged.bounds["below"], below=-judged.bounds["above"])
    assert_finding(judged.rule(*scaled(-1.0, judged.samples), **bounds), expected, -1.0)


def test_a_pair_exchanged_has_the_inverse_ratio():
    bounds = dict(above=0.4, below=1 / 0.4)
    one, other = statistics.ratio(ONE, OTHER, **bounds), statistics.ratio(OTHER, ONE, **bounds)
    assert other.verdict == one.verdict and other.value == pytest.approx(1 / one.value)
