"""Rules that turn numbers into a verdict. Each is a pure function of what was measured and of a
bound fixed before; each can come out either way.

The interval is a 95 % one. A claim about a mean, a difference, a ratio or a share *holds* if the
whole interval lies between its bounds, the bounds themselves not included, *does not hold* if none
of it does, and is *undecided* otherwise.
"""

from typing import NamedTuple

import numpy as np
from scipy import stats

HOLDS, FAILS, UNDECIDED, UNTESTABLE = (
    "holds",
    "does not hold",
    "undecided",
    "cannot be tested in simulation",
)
CONFIDENCE = 0.95
RESAMPLES = 2000


class Finding(NamedTuple):
    """What was found: the number, its interval, how many runs (or samples, or cases) are behind it,
    the verdict, and the bounds it was judged by.
    """

    ours: float
    low: float
    high: float
    n: int
    verdict: str
    above: float = -np.inf
    below: float = np.inf


def judged(low, high, above=-np.inf, below=np.inf):
    """The verdict on an interval that should lie between `above` and `below`."""
    if np.isnan(low) or np.isnan(high):
        return UNDECIDED
    if above < low and high < below:
        return HOLDS
    return FAILS if high <= above or low >= below else UNDECIDED


def _samples(*samples):
    """The samples as arrays of floats, of one length, nothing missing: a claim must say itself what
    a missing number means.
    """
    arrays = [np.asarray(sample, dtype=float) for sample in samples]
    if len({len(array) for array in arrays}) > 1:
        raise ValueError(
            f"samples had lengths {[len(array) for array in arrays]}; paired samples should have one"
        )
    if any(np.isnan(array).any() for array in arrays):
        raise ValueError(
            "samples had missing values; a claim should say what they mean before it is judged"
        )
    return arrays


def _bootstrapped(statistic, samples, above, below):
    """`statistic` of paired samples with its BCa bootstrap interval."""
    n = len(samples[0])
    ours = float(statistic(*samples, axis=-1)) if n else np.nan
    if n < 2:
        return Finding(ours, np.nan, np.nan, n, UNDECIDED, above, below)
    if all(
        np.ptp(sample) == 0 for sample in samples
    ):  # nothing varies, and BCa would divide by that
        low = high = ours
    else:
        low, high = stats.bootstrap(
            samples,
            statistic,
            paired=True,
            vectorized=True,
            n_resamples=RESAMPLES,
            confidence_level=CONFIDENCE,
            method="BCa",
            rng=np.random.default_rng(0),
        ).confidence_interval
    return Finding(ours, float(low), float(high), n, judged(low, high, above, below), above, below)


def mean(values, above=-np.inf, below=np.inf):
    """A mean lies between the bounds."""
    return _bootstrapped(np.mean, _samples(values), above, below)


def difference(one, other, above=-np.inf, below=np.inf):
    """The mean of one - other, paired by their order, lies between the bounds."""
    one, other = _samples(one, other)
    return _bootstrapped(np.mean, [one - other], above, below)


def ratio(one, other, above=-np.inf, below=np.inf):
    """The ratio of two paired samples' means lies between the bounds."""
    return _bootstrapped(
        lambda one, other, axis: np.mean(one, axis) / np.mean(other, axis),
        _samples(one, other),
        above,
        below,
    )


def share(flags, above=-np.inf, below=np.inf):
    """The share of flags that are true lies between the bounds; interval by Clopper and Pearson."""
    flags = np.asarray(flags, dtype=bool)
    if len(flags) == 0:
        return Finding(np.nan, np.nan, np.nan, 0, UNDECIDED, above, below)
    low, high = stats.binomtest(int(flags.sum()), len(flags)).proportion_ci(
        CONFIDENCE, method="exact"
    )
    return Finding(
        float(flags.mean()),
        float(low),
        float(high),
        len(flags),
        judged(low, high, above, below),
        above,
        below,
    )


def always(flags):
    """An exact property: true in every case. One exception refutes it."""
    found = share(flags)
    return found._replace(
        verdict=UNDECIDED if found.n == 0 else HOLDS if found.ours == 1 else FAILS, above=1.0
    )


def possible(flags, rare=0.01):
    """What "might" happen: seen at least once. Not seen, it does not hold once so many cases were
    tried that its share must be below `rare`.
    """
    found = share(flags)
    return found._replace(
        verdict=HOLDS if found.ours > 0 else FAILS if found.high < rare else UNDECIDED, above=0.0
    )


def reported(values, paper):
    """A single number that the paper reports, of one drive or few, is usual here: it lies where the
    middle 95 % of single runs do.

    The interval is that of single runs, not of their mean; fewer than 40 runs cannot have one.
    """
    (values,) = _samples(values)
    if len(values) < 40:
        return Finding(
            float(values.mean()) if len(values) else np.nan,
            np.nan,
            np.nan,
            len(values),
            UNDECIDED,
            paper,
            paper,
        )
    low, high = np.quantile(values, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Finding(
        float(values.mean()),
        float(low),
        float(high),
        len(values),
        HOLDS if low <= paper <= high else FAILS,
        paper,
        paper,
    )


def equal(value, expected, tolerance):
    """A number that follows without any run: within `tolerance` of `expected`."""
    value = float(value)
    verdict = (
        UNDECIDED if np.isnan(value) else HOLDS if abs(value - expected) <= tolerance else FAILS
    )
    return Finding(value, value, value, 1, verdict, expected - tolerance, expected + tolerance)


def combined(findings):
    """One verdict from the findings under several readings {reading: Finding}, and the reading
    whose numbers stand for it.

    A claim that holds under some readings only holds "under" the first of them; else the first
    reading speaks, and a single doubt keeps it open.
    """
    verdicts = {process_noise: found.verdict for process_noise, found in findings.items()}
    holding = [process_noise for process_noise, verdict in verdicts.items() if verdict == HOLDS]
    first = next(iter(findings))
    if len(holding) == len(findings):
        return HOLDS, first
    if holding:
        return f"{HOLDS} under {holding[0]}", holding[0]
    open_ = [process_noise for process_noise, verdict in verdicts.items() if verdict == UNDECIDED]
    return (UNDECIDED, open_[0]) if open_ else (verdicts[first], first)
