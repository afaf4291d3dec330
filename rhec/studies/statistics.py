"""Intervals and verdicts: one bootstrap, and one rule that turns an interval into a verdict.

An interval is a 95 % one. A claim about a mean, a difference, a ratio or a share *holds* if the
whole interval lies between its bounds, *does not hold* if none of it does, and is *undecided*
otherwise. A bound that is touched is not included, since no change at all is no improvement. Each
rule is a pure function of what was measured and of a bound fixed before.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

__all__ = [
    "CONFIDENCE", "FAILS", "HOLDS", "UNDECIDED", "UNTESTABLE", "Finding", "Interval", "always",
    "combined", "difference", "difference_of_means", "equal", "mean", "over_seeds", "possible",
    "ratio", "ratio_of_means", "reported", "root_of_mean", "share", "verdict"
]  # fmt: skip

HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"
UNTESTABLE = "cannot be tested in simulation"
CONFIDENCE = 0.95
_RESAMPLES = {"BCa": 2_000, "percentile": 10_000}
_MIN_SINGLE_RUNS = 40  # fewer have no middle 95 %
_RARE = 0.01


class Interval(NamedTuple):
    """A mean (or another statistic) over n seeds and its interval: four columns of a table."""

    mean: float
    low: float
    high: float
    n: int


class Finding(NamedTuple):
    """A number, its interval, how many runs (or samples, or cases) are behind it, the verdict, and
    the bounds it was judged by.
    """

    value: float
    low: float
    high: float
    n: int
    verdict: str
    above: float = -np.inf
    below: float = np.inf


def verdict(low, high, above=-np.inf, below=np.inf):
    """HOLDS if the whole interval from `low` to `high` lies between the bounds, themselves not
    included, FAILS if none of it does, else UNDECIDED, also where there is none (NaN).
    """
    if np.isnan(low) or np.isnan(high):
        return UNDECIDED
    if above < low and high < below:
        return HOLDS
    return FAILS if high <= above or low >= below else UNDECIDED


# The bootstrap


def _bootstrap(statistic, samples, method):
    """Value and interval of a statistic of paired samples (n,) each, resampled together."""
    n = samples[0].size
    value = float(statistic(*samples, axis=-1)) if n else np.nan
    if n < 2:
        return value, np.nan, np.nan
    if all(np.ptp(sample) == 0 for sample in samples):  # BCa would divide by the spread
        return value, value, value
    options = dict(paired=True, vectorized=True, confidence_level=CONFIDENCE, method=method)
    options |= dict(n_resamples=_RESAMPLES[method], rng=np.random.default_rng(0))
    resampled = stats.bootstrap(samples, statistic, **options)
    low, high = (
        resampled.confidence_interval
        if method == "BCa"
        else np.quantile(resampled.bootstrap_distribution, [0.025, 0.975])
    )
    return value, float(low), float(high)


def over_seeds(statistic, *samples):
    """Estimate a statistic over seeds with its 95 % interval by the percentile bootstrap.

    Percentiles, and not BCa as in the rules below, because a table also shows what has no bias or
    acceleration: ratios to nothing, counts that are nearly all zero.

    Args:
        statistic: function of arrays and `axis`, e.g. `np.mean` or `ratio_of_means`.
        samples: one array (seeds,) each, in the same order of seeds; a seed that is missing (NaN)
            in one of them is left out.

    Returns:
        Interval, n the seeds that count; NaN for the numbers where n is below 2.
    """
    samples = np.column_stack(samples).astype(float)
    samples = samples[~np.isnan(samples).any(axis=1)].T
    n = samples.shape[1]
    if n < 2:
        return Interval(np.nan, np.nan, np.nan, n)
    return Interval(*_bootstrap(statistic, tuple(samples), "percentile"), n)


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
    value, low, high = _bootstrap(statistic, samples, "BCa")
    n = len(samples[0])
    return Finding(value, low, high, n, verdict(low, high, above, below), above, below)


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
    n, value, low, high = len(flags), np.nan, np.nan, np.nan
    if n:
        value = flags.mean()
        low, high = stats.binomtest(int(flags.sum()), n).proportion_ci(CONFIDENCE, method="exact")
    said = verdict(low, high, above, below)
    return Finding(float(value), float(low), float(high), n, said, above, below)


def always(flags):
    """An exact property: true in every case. One exception refutes it."""
    found = share(flags)
    said = UNDECIDED if found.n == 0 else HOLDS if found.value == 1 else FAILS
    return found._replace(verdict=said, above=1.0)


def possible(flags):
    """A thing that "might" happen is seen at least once. Not seen, it does not hold once so many
    cases were tried that its share must be below 1 %.
    """
    found = share(flags)
    said = HOLDS if found.value > 0 else FAILS if found.high < _RARE else UNDECIDED
    return found._replace(verdict=said, above=0.0)


def reported(values, paper):
    """A single number that the paper reports, of one drive or few, is usual here: it lies where the
    middle 95 % of single runs do.

    The interval is that of single runs, not of their mean; fewer than 40 runs cannot have one.
    """
    found, low, high, said = mean(values), np.nan, np.nan, UNDECIDED
    if found.n >= _MIN_SINGLE_RUNS:
        low, high = np.quantile(values, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        said = HOLDS if low <= paper <= high else FAILS
    return Finding(found.value, float(low), float(high), found.n, said, paper, paper)


def equal(value, expected, tolerance):
    """A number that follows without any run: within `tolerance` of `expected`."""
    value = float(value)
    said = UNDECIDED if np.isnan(value) else HOLDS if abs(value - expected) <= tolerance else FAILS
    return Finding(value, value, value, 1, said, expected - tolerance, expected + tolerance)


def combined(findings):
    """One verdict from the findings under several conditions {condition: Finding}, and the
    condition whose numbers stand for it.

    A claim that holds under some conditions only holds "under" the first of them; else the first
    condition speaks, and a single doubt keeps it open.
    """
    verdicts = {condition: found.verdict for condition, found in findings.items()}
    holding = [condition for condition, said in verdicts.items() if said == HOLDS]
    first = next(iter(findings))
    if len(holding) == len(findings):
        return HOLDS, first
    if holding:
        return f"{HOLDS} under {holding[0]}", holding[0]
    open_ = [condition for condition, said in verdicts.items() if said == UNDECIDED]
    return (UNDECIDED, open_[0]) if open_ else (verdicts[first], first)
