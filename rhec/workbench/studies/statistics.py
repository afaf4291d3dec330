"""Intervals and verdicts: one interval, and one rule that turns an interval into a verdict.

An interval is a 95 % one, in tables and rules alike: Student's t with the standard error by the
jackknife, of a mean or of any function of means; `coverage` measures how often it holds the truth.
A claim about a mean, a difference, a ratio or a share *holds* if the whole interval lies between
its bounds, *does not hold* if none of it does, and is *undecided* otherwise. A bound that is
touched is not included, since no change at all is no improvement. Each rule is a pure function of
what was measured and of a bound fixed before.
"""

from typing import NamedTuple

import numpy as np
from scipy import special

__all__ = [
    "AS_PRINTED",
    "CONFIDENCE",
    "FAILS",
    "HOLDS",
    "UNDECIDED",
    "UNTESTABLE",
    "Finding",
    "Interval",
    "always",
    "beside",
    "combined",
    "coverage",
    "difference",
    "difference_of_means",
    "equal",
    "mean",
    "over_seeds",
    "possible",
    "ratio",
    "ratio_of_means",
    "reported",
    "root_of_mean",
    "share",
    "verdict",
]

HOLDS = "holds"
FAILS = "does not hold"
UNDECIDED = "undecided"
UNTESTABLE = "cannot be tested here"
AS_PRINTED = "as printed"  # the condition that takes the paper to the letter
CONFIDENCE = 0.95
_MIN_SINGLE_RUNS = 40  # fewer have no middle 95 %
_RARE = 0.01
_NEAR = 0.25  # a mean is near a number of the paper if it is within a quarter of it


class Interval(NamedTuple):
    """A mean (or another statistic) over n seeds and its interval: four columns of a table."""

    mean: float
    low: float
    high: float
    n: int


class Finding(NamedTuple):
    """A number, its interval, how many runs (or samples, or cases) are behind it, the verdict, the
    bounds it was judged by, and the chance p that a value on the nearer bound came out as far off
    (two-sided; NaN where nothing was left to chance).
    """

    value: float
    low: float
    high: float
    n: int
    verdict: str
    above: float = -np.inf
    below: float = np.inf
    p: float = np.nan


def verdict(low, high, above=-np.inf, below=np.inf):
    """HOLDS if the whole interval from `low` to `high` lies between the bounds, themselves not
    included, FAILS if none of it does, else UNDECIDED, also where there is none (NaN).
    """
    if np.isnan(low) or np.isnan(high):
        return UNDECIDED
    if above < low and high < below:
        return HOLDS
    return FAILS if high <= above or low >= below else UNDECIDED


# Intervals


def _estimate(statistic, samples):
    """A statistic of paired samples (n,), its standard error, and the degrees of freedom.

    The jackknife leaves out one pair at a time; a function of means is then one of n new means.
    """
    n = len(samples[0])
    value = float(statistic(*samples, axis=-1)) if n else np.nan
    if n < 2:
        return value, np.nan, 0
    if all(np.ptp(sample) == 0 for sample in samples):
        return value, 0.0, n - 1
    without = [((sample.sum() - sample) / (n - 1))[:, None] for sample in samples]
    return value, float(np.sqrt(n - 1) * np.std(statistic(*without, axis=-1))), n - 1


def _interval(value, error, freedom):
    """(low, high) by Student's t."""
    if np.isnan(error):
        return np.nan, np.nan
    half = float(special.stdtrit(freedom, (1 + CONFIDENCE) / 2)) * error if error else 0.0
    return value - half, value + half


def over_seeds(statistic, *samples):
    """Estimate a statistic over seeds with its 95 % interval.

    Args:
        statistic: function of arrays and `axis` that depends on their means alone, e.g. `np.mean`
            or `ratio_of_means`.
        samples: one array (seeds,) each, in the same order of seeds; a seed that is missing (NaN)
            in one of them is left out.

    Returns:
        Interval, n the seeds that count; NaN for the numbers where n is below 2.
    """
    samples = np.column_stack(samples).astype(float)
    samples = samples[~np.isnan(samples).any(axis=1)].T
    if samples.shape[1] < 2:
        return Interval(np.nan, np.nan, np.nan, samples.shape[1])
    value, error, freedom = _estimate(statistic, samples)
    return Interval(value, *_interval(value, error, freedom), freedom + 1)


def coverage(statistic, *samples, n=None, trials=4000):
    """How often the interval of n pairs, drawn from these as from all there are, holds the value of
    them all.
    """
    samples = [np.asarray(sample, dtype=float) for sample in samples]
    rng = np.random.default_rng(0)
    truth = float(statistic(*samples, axis=-1))
    held = 0
    for _ in range(trials):
        drawn = rng.integers(0, len(samples[0]), n or len(samples[0]))
        low, high = _interval(*_estimate(statistic, [sample[drawn] for sample in samples]))
        held += low <= truth <= high
    return held / trials


def ratio_of_means(one, other, axis):
    """Ratio of two means; infinite or NaN where there is nothing to divide by."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.mean(one, axis) / np.mean(other, axis)


def difference_of_means(one, other, axis):
    """Difference of two means."""
    return np.mean(one, axis) - np.mean(other, axis)


def root_of_mean(squares, axis):
    """Root of a mean, for squared errors."""
    return np.sqrt(np.mean(squares, axis))


# Rules


def _judged(statistic, samples, above, below):
    """The Finding of a statistic of paired samples."""
    value, error, freedom = _estimate(statistic, samples)
    low, high = _interval(value, error, freedom)
    said = verdict(low, high, above, below)
    off = min(abs(value - above), abs(value - below))
    p = 2 * special.stdtr(freedom, -off / error) if error else np.nan
    return Finding(value, low, high, freedom + 1, said, above, below, float(p))


def _checked(*samples):
    """Samples as arrays of one length. A claim must say itself what a missing number means."""
    samples = [np.asarray(sample, dtype=float) for sample in samples]
    lengths = [len(sample) for sample in samples]
    if len(set(lengths)) > 1:
        raise ValueError(f"samples had lengths {lengths}; paired samples should have one")
    if any(np.isnan(sample).any() for sample in samples):
        raise ValueError("samples had missing values; a claim should say first what they mean")
    return samples


def mean(values, above=-np.inf, below=np.inf):
    """A mean lies between the bounds."""
    return _judged(np.mean, _checked(values), above, below)


def difference(one, other, above=-np.inf, below=np.inf):
    """The mean of one - other, paired by their order, lies between the bounds."""
    one, other = _checked(one, other)
    return _judged(np.mean, [one - other], above, below)


def ratio(one, other, above=-np.inf, below=np.inf):
    """The ratio of two paired samples' means lies between the bounds."""
    return _judged(ratio_of_means, _checked(one, other), above, below)


def share(flags, above=-np.inf, below=np.inf):
    """The share of flags that are true lies between the bounds; interval by Clopper and Pearson."""
    flags = np.asarray(flags, dtype=bool)
    n = len(flags)
    value = np.nan
    low = np.nan
    high = np.nan
    p = np.nan
    if n:
        from scipy import stats  # takes half a second, and most studies never ask for a share

        value = flags.mean()
        k = int(flags.sum())
        low, high = stats.binomtest(k, n).proportion_ci(CONFIDENCE, method="exact")
        bound = above if abs(value - above) <= abs(value - below) else below
        if 0 < bound < 1:
            tails = stats.binom.cdf(k, n, bound), stats.binom.sf(k - 1, n, bound)
            p = min(1.0, 2 * min(tails))
    said = verdict(low, high, above, below)
    return Finding(float(value), float(low), float(high), n, said, above, below, float(p))


def beside(flags, best, above):
    """The share of flags among the cases that the best possible masters, too: what nobody can do is
    held against nobody.
    """
    flags, best = _checked(flags, best)
    return share(flags[best > 0], above)


def always(flags):
    """An exact property: true in every case. One exception refutes it."""
    found = share(flags)
    said = UNDECIDED if found.n == 0 else HOLDS if found.value == 1 else FAILS
    return found._replace(verdict=said, above=1.0)


def possible(flags):
    """A thing that "may" happen was found. Not found, it does not hold once so many cases were
    tried that its share must be below 1 %.
    """
    found = share(flags)
    said = HOLDS if found.value > 0 else FAILS if found.high < _RARE else UNDECIDED
    return found._replace(verdict=said, above=0.0)


def reported(values, paper):
    """A single number that the paper reports, of one drive or few, is usual here: it lies where the
    middle 95 % of single runs do, and the mean is within a quarter of it. (Without the second, the
    more runs differ the more numbers would be usual.)

    The interval is that of single runs, not of their mean; fewer than 40 runs cannot have one.
    """
    near = mean(values, above=(1 - _NEAR) * paper, below=(1 + _NEAR) * paper)
    low = np.nan
    high = np.nan
    said = UNDECIDED
    if near.n >= _MIN_SINGLE_RUNS:
        low, high = np.quantile(values, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        said = near.verdict if low <= paper <= high else FAILS
    return Finding(near.value, float(low), float(high), near.n, said, paper, paper)


def equal(value, expected, tolerance):
    """A number that follows without any run: within `tolerance` of `expected`."""
    value = float(value)
    said = UNDECIDED if np.isnan(value) else HOLDS if abs(value - expected) <= tolerance else FAILS
    return Finding(value, value, value, 1, said, expected - tolerance, expected + tolerance)


def combined(findings):
    """One verdict from the findings under several conditions {condition: Finding}, the first of
    them the paper to the letter, and the condition whose numbers stand for it.

    A claim that does not hold under all of them "holds as printed" or, if not that, "holds with"
    the first that it holds with; "only" where it does not hold otherwise. If it holds under none,
    the first speaks, and a single doubt keeps it open.
    """
    said = {condition: found.verdict for condition, found in findings.items()}
    first = next(iter(said))
    holding = [condition for condition, each in said.items() if each == HOLDS]
    if len(holding) == len(said):
        return HOLDS, first
    if holding and first == holding[0]:
        only = "only " * (len(holding) == 1 and UNDECIDED not in said.values())
        return f"{HOLDS} {only}{first}", first
    if holding:
        only = "only " * (said[first] == FAILS)
        return f"{HOLDS} {only}with {holding[0]}", holding[0]
    open_ = [condition for condition, each in said.items() if each == UNDECIDED]
    return (UNDECIDED, open_[0]) if open_ else (said[first], first)
