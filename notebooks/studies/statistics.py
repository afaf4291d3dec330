"""Intervals and verdicts: one kind of interval, and one rule that turns an interval into a verdict.

All intervals hold the truth with a probability of 95 %. Those of means, and of functions of means
such as a ratio, are Student's t with a jackknife standard error (`_estimate`; B. Efron and
R. Tibshirani, "An Introduction to the Bootstrap", 1993, ch. 11). Those of shares are by C. Clopper
and E. Pearson (Biometrika 26, 1934). `coverage` measures how often an interval holds the truth.

A claim about a mean, a difference, a ratio or a share *holds* if the whole interval lies between
its bounds, *does not hold* if none of it does, and is *undecided* otherwise. A bound that is
touched is not kept, since no change at all is no improvement. Each rule is a pure function of the
samples and the bounds.

What the paper reports has one rule, by which README and the ledger judge alike:

- A *number* (`verdict_on_number`) is *met* if the whole interval of our mean is within a tenth of
  it (a count of violations: a third), else *possible* if it lies in the middle 90 % of single
  drives, else *not met*. It is *lost* if the robot is: if its mean error is above the tolerance of
  the rows (`is_lost`).
- An *order* (`verdict_on_order`) has the whole paired interval on the paper's side. To beat a rival
  that is lost proves nothing.
- *Never* (`verdict_on_never`) asks for at least 95 % of the drives in which the oracle is without.
"""

from typing import NamedTuple

import numpy as np
from scipy import special

from rhec import paper

HOLDS = "holds"
FAILS = "does not hold"
UNDECIDED = "undecided"
UNTESTABLE = "cannot be tested here"
LOST = "its rival is lost"  # to beat a robot that left the path proves nothing
MET = "met"  # of a number that the paper reports, as are the next three
POSSIBLE = "possible"
NOT_MET = "not met"
LOST_ITSELF = "lost"
AS_PRINTED = "as printed"  # the condition that takes the paper to the letter
PREDICTION = "W by prediction"
# The condition of a claim by each rule that picks W, {process_noise: name}
CONDITIONS = {
    "printed": AS_PRINTED,
    "consistent": "W consistent",
    "prediction": PREDICTION,
    "tracking": "W by tracking",
}
CONFIDENCE = 0.95
EARLY_CONFIDENCE = 0.998  # of a look at few fields, before the last one
ALMOST_ALWAYS = 0.95  # "never": the share of drives without it
WITHIN = 0.1  # a mean meets a number of the paper if it is within this share of it
WITHIN_COUNTS = 1 / 3  # the same of violations, whose number grows with the metres of row
SINGLE_DRIVES = (0.05, 0.95)  # between these quantiles lie the middle 90 % of single drives
_RARE = 0.01  # an event that "may" happen is refuted once its share must be below this


class Interval(NamedTuple):
    """A statistic over n seeds with its 95 % interval: four columns of a table."""

    mean: float
    low: float
    high: float
    n: int


class Finding(NamedTuple):
    """The result of a rule.

    Args:
        value: The number that is judged.
        low, high: Its 95 % interval.
        n: How many runs, samples or cases are behind it.
        verdict: HOLDS, FAILS, UNDECIDED or UNTESTABLE.
        above, below: The bounds.
        p: Two-sided probability of a value as far off, if the truth lay on the nearer bound; NaN
            where nothing is left to chance.
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
    """The verdict on an interval.

    Args:
        low: Lower end of the interval; NaN if there is none.
        high: Its upper end.
        above: Lower bound, itself not included.
        below: Upper bound, itself not included.

    Returns:
        HOLDS if all of the interval lies between the bounds, FAILS if none of it does, else
        UNDECIDED.
    """
    if np.isnan(low) or np.isnan(high):
        return UNDECIDED
    if above < low and high < below:
        return HOLDS
    return FAILS if high <= above or low >= below else UNDECIDED


# What the paper reports


def is_lost(mean_error_m):
    """Whether a robot whose drives have this mean error is lost: it is beyond the tolerance."""
    return mean_error_m > paper.TOLERANCE_M


def verdict_on_number(low, high, single_low, single_high, number, within=WITHIN):
    """The verdict on a number that the paper reports of one drive.

    Args:
        low, high: Interval of our mean.
        single_low, single_high: The middle 90 % of single drives.
        number: The paper's.
        within: How near the mean must be, as a share of it.

    Returns:
        MET, POSSIBLE or NOT_MET; UNDECIDED where there is no interval.
    """
    if np.isnan(low) or np.isnan(high):
        return UNDECIDED
    if low >= (1 - within) * number and high <= (1 + within) * number:
        return MET
    return POSSIBLE if single_low <= number <= single_high else NOT_MET


def verdict_on_order(low, high, rival_error_m):
    """The verdict on "ours is less than the rival's".

    Args:
        low, high: Interval of the mean of ours - the rival's, paired.
        rival_error_m: Mean error of the rival.

    Returns:
        HOLDS, FAILS or UNDECIDED by the whole interval; LOST if the rival is.
    """
    return LOST if is_lost(rival_error_m) else verdict(low, high, below=0)


def verdict_on_never(low, high):
    """The verdict on "never", by the interval of the share of drives without it.

    Those drives alone count in which the oracle is without it, too.
    """
    return verdict(low, high, above=ALMOST_ALWAYS)


# Intervals


def _estimate(statistic, samples):
    """A statistic of paired samples, its standard error (jackknife), and the degrees of freedom.

    With θ₍ᵢ₎ the statistic without pair i, and θ₍.₎ their mean,

        error² = (n - 1) / n Σᵢ (θ₍ᵢ₎ - θ₍.₎)².

    The statistic depends on the samples' means alone, so θ₍ᵢ₎ is that of the n means that are left.
    The error is NaN where there is none.
    """
    n = len(samples[0])
    value = float(statistic(*samples, axis=-1)) if n else np.nan
    if n < 2:
        return value, np.nan, 0
    if all(np.ptp(sample) == 0 for sample in samples):
        return value, 0.0, n - 1
    means_without = [((sample.sum() - sample) / (n - 1))[:, None] for sample in samples]
    values_without = statistic(*means_without, axis=-1)
    # A ratio is infinite where its denominator is zero in all pairs that are left: such samples
    # cannot bound it, so it has no error and stays undecided.
    if not np.isfinite(values_without).all():
        return value, np.nan, n - 1
    return value, float(np.sqrt(n - 1) * np.std(values_without)), n - 1


def _interval(value, error, freedom, confidence=CONFIDENCE):
    """(low, high) = value ± t error, t the quantile (1 + confidence) / 2 of Student's t.

    At 95 % that is the 97.5 % quantile. Without an error both ends are NaN.
    """
    if np.isnan(error):
        return np.nan, np.nan
    half = float(special.stdtrit(freedom, (1 + confidence) / 2)) * error if error else 0.0
    return value - half, value + half


def over_seeds(statistic, *samples, least=-np.inf):
    """Estimate a statistic over seeds with its interval.

    Args:
        statistic: Function of arrays and `axis` that depends on their means alone, for example
            `np.mean` or `ratio_of_means`.
        samples: Arrays (seeds,) in the same order of seeds. A seed that is missing (NaN) in one of
            them is left out of all.
        least: What the statistic cannot be below, such as 0 of an error or a count.

    Returns:
        Interval, n the seeds that count; its numbers are NaN where n is below 2.
    """
    samples = np.column_stack(samples).astype(float)
    samples = samples[~np.isnan(samples).any(axis=1)].T
    if samples.shape[1] < 2:
        return Interval(np.nan, np.nan, np.nan, samples.shape[1])
    value, error, freedom = _estimate(statistic, samples)
    low, high = _interval(value, error, freedom)
    return Interval(value, max(low, least), high, freedom + 1)


def share_interval(k, n, confidence=CONFIDENCE):
    """Clopper and Pearson's interval of the share k / n.

    It reaches to the shares under which k, or what is further off, comes out with a probability of
    2.5 % at 95 % confidence: with B_q(a, b) the quantiles of the beta distribution,

        low = B_0.025(k, n - k + 1),  high = B_0.975(k + 1, n - k).

    Args:
        k: How often it was so; a share of an effective number n need not make it whole.
        n: Of how many cases, at least one.
        confidence: With which the interval holds the truth.

    Returns:
        low, high.
    """
    # scipy.stats has it, and takes half a second to load.
    low = special.betaincinv(k, n - k + 1, (1 - confidence) / 2) if k else 0.0
    high = special.betaincinv(k + 1, n - k, (1 + confidence) / 2) if k < n else 1.0
    return low, high


def coverage(statistic, *samples, trials=2000):
    """How often the 95 % interval holds the truth, by resampling.

    The samples stand for all pairs there are, so their statistic is the truth. Each trial draws
    pairs from them, with replacement.

    Args:
        statistic: As for `over_seeds`.
        samples: Arrays of one length, paired.
        trials: How many.

    Returns:
        The share of trials whose interval holds the truth; 0.95 if the intervals are right.
    """
    samples = [np.asarray(sample, dtype=float) for sample in samples]
    rng = np.random.default_rng(0)
    truth = float(statistic(*samples, axis=-1))
    n_held = 0
    for _ in range(trials):
        drawn = rng.integers(0, len(samples[0]), len(samples[0]))
        low, high = _interval(*_estimate(statistic, [sample[drawn] for sample in samples]))
        n_held += low <= truth <= high
    return n_held / trials


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


# Each rule has a `confidence`: the verdict needs an interval of that confidence on one side of the
# bound. The interval that a Finding shows is always the one of 95 %.


def _judged(statistic, samples, above, below, confidence, least=-np.inf):
    """The Finding of a statistic of paired samples; p by Student's t at the nearer bound."""
    value, error, freedom = _estimate(statistic, samples)
    low, high = _interval(value, error, freedom)
    low = max(low, least)
    off = min(abs(value - above), abs(value - below))
    p = 2 * special.stdtr(freedom, -off / error) if error else np.nan
    outcome = verdict(*_interval(value, error, freedom, confidence), above, below)
    return Finding(value, low, high, freedom + 1, outcome, above, below, float(p))


def _checked(*samples):
    """Samples as arrays of one length without missing values."""
    samples = [np.asarray(sample, dtype=float) for sample in samples]
    lengths = [len(sample) for sample in samples]
    if len(set(lengths)) > 1:
        raise ValueError(f"samples had lengths {lengths}; paired samples should have one")
    if any(np.isnan(sample).any() for sample in samples):
        raise ValueError("samples had missing values; a claim should say first what they mean")
    return samples


def mean(values, above=-np.inf, below=np.inf, confidence=CONFIDENCE, least=-np.inf):
    """Judge that a mean, which cannot be below `least`, lies between the bounds."""
    return _judged(np.mean, _checked(values), above, below, confidence, least)


def difference(one, other, above=-np.inf, below=np.inf, confidence=CONFIDENCE):
    """Judge that the mean of one - other, paired by their order, lies between the bounds."""
    one, other = _checked(one, other)
    return _judged(np.mean, [one - other], above, below, confidence)


def ratio(one, other, above=-np.inf, below=np.inf, confidence=CONFIDENCE):
    """Judge that the ratio of two paired samples' means lies between the bounds."""
    return _judged(ratio_of_means, _checked(one, other), above, below, confidence)


def share(flags, above=-np.inf, below=np.inf, confidence=CONFIDENCE):
    """Judge that the share k / n of true flags lies between the bounds.

    The interval is that of `share_interval`. p is twice the smaller tail of the binomial
    distribution at the nearer bound.
    """
    flags = np.asarray(flags, dtype=bool)
    n = len(flags)
    if not n:
        return Finding(np.nan, np.nan, np.nan, 0, UNDECIDED, above, below)
    k = int(flags.sum())
    value = k / n
    low, high = share_interval(k, n)
    outcome = verdict(*share_interval(k, n, confidence), above, below)
    bound = above if abs(value - above) <= abs(value - below) else below
    p = np.nan
    if 0 < bound < 1:
        tails = special.bdtr(k, n, bound), special.bdtrc(k - 1, n, bound)
        p = min(1.0, 2 * float(min(tails)))
    return Finding(value, float(low), float(high), n, outcome, above, below, p)


def share_twice(one, other, **bounds):
    """Judge the share of pairs in which one is more than twice the other, as `share` does."""
    one, other = _checked(one, other)
    return share(one > 2 * other, **bounds)


def share_less(one, other, **bounds):
    """Judge the share of pairs in which one is less than the other, as `share` does."""
    one, other = _checked(one, other)
    return share(one < other, **bounds)


def relative_to_oracle(flags, oracle, above, confidence=CONFIDENCE):
    """Judge a share of flags relative to the oracle: fields where the oracle fails are left out."""
    flags, oracle = _checked(flags, oracle)
    return share(flags[oracle > 0], above, confidence=confidence)


def always_relative_to_oracle(flags, oracle, confidence=CONFIDENCE):
    """Judge that flags are true wherever the oracle's are. One exception refutes it."""
    flags, oracle = _checked(flags, oracle)
    return always(flags[oracle > 0], confidence)


def always(flags, confidence=CONFIDENCE):
    """Judge an exact property, true in every case. One exception refutes it."""
    outcome = share(flags)
    exact = UNDECIDED if outcome.n == 0 else HOLDS if outcome.value == 1 else FAILS
    return outcome._replace(verdict=exact, above=1.0)


def possible(flags, confidence=CONFIDENCE):
    """Judge that what "may" happen does happen.

    It holds if one flag is true. If none is, it does not hold once the interval of its share ends
    below 1 %.
    """
    outcome = share(flags, below=_RARE, confidence=confidence)
    seen = HOLDS if outcome.value > 0 else FAILS if outcome.verdict == HOLDS else UNDECIDED
    return outcome._replace(verdict=seen, above=0.0, below=np.inf, p=np.nan)


def reported(values, errors_m, number, within=WITHIN, confidence=CONFIDENCE):
    """Judge a number that the paper reports of one drive, see `verdict_on_number`.

    At an early look, which asks for more confidence, it is UNDECIDED as long as more drives may
    well change the word: an interval, of the mean, of the mean error or of the share of drives
    below the number, reaches over the edge at which the word changes.

    Args:
        values: Of each drive.
        errors_m: Mean error of each drive: LOST_ITSELF if their mean says so.
        number: The paper's.
        within: How near the mean must be, as a share of it.
        confidence: That the verdict needs.

    Returns:
        Finding. Its interval is the middle 90 % of single drives, its bounds are those of the mean.
    """
    values, errors_m = _checked(values, errors_m)
    bounds = dict(above=(1 - within) * number, below=(1 + within) * number)
    of_mean = mean(values, **bounds, confidence=confidence)
    single = np.quantile(values, SINGLE_DRIVES) if len(values) else (np.nan, np.nan)
    outcome = verdict_on_number(of_mean.low, of_mean.high, *single, number, within)
    of_error = mean(errors_m, above=paper.TOLERANCE_M, confidence=confidence)
    if is_lost(of_error.value):
        may_change = of_error.verdict == UNDECIDED
        outcome = LOST_ITSELF
    else:
        may_change = _may_change(of_mean.verdict, values, number, confidence)
    if confidence > CONFIDENCE and may_change:
        outcome = UNDECIDED
    low, high = map(float, single)
    return of_mean._replace(low=low, high=high, verdict=outcome, p=np.nan)


def _may_change(nearness, values, number, confidence):
    """Whether more drives may change the word for a reported number, at this confidence."""
    if nearness == HOLDS:
        return False
    usual = share(values < number, *SINGLE_DRIVES, confidence=confidence)
    return UNDECIDED in (nearness, usual.verdict)


def equal(value, expected, tolerance):
    """Judge that a number which follows without any run is within `tolerance` of `expected`."""
    value = float(value)
    outcome = HOLDS if abs(value - expected) <= tolerance else FAILS
    outcome = UNDECIDED if np.isnan(value) else outcome
    return Finding(value, value, value, 1, outcome, expected - tolerance, expected + tolerance)


def between(value, above=-np.inf, below=np.inf):
    """Judge that a number which follows without any run lies between the bounds.

    Nothing in it is left to chance, so that both ends of its interval are the number itself.
    """
    value = float(value)
    outcome = verdict(value, value, above, below)
    return Finding(value, value, value, 1, outcome, above, below)


def combined(findings):
    """One verdict from the findings under several conditions.

    A claim that does not hold under all of them "holds as printed" or, if not that, "holds with"
    the first condition that it holds with; "only" where no other lets it hold. If it holds under
    none, the first condition decides, unless one is undecided: then the claim is, too. Conditions
    under which the rival is lost do not count, unless it is under all.

    A number that is met lets a claim hold. If it is met under none and possible under one, the
    claim is POSSIBLE.

    Args:
        findings: {condition: Finding}; the first condition is the paper as printed.

    Returns:
        The verdict, and the condition whose numbers stand for it.
    """
    every = {
        condition: _OF_NUMBERS.get(finding.verdict, finding.verdict)
        for condition, finding in findings.items()
    }
    verdicts = {condition: of for condition, of in every.items() if of != LOST} or every
    first = next(iter(verdicts))
    holding = [condition for condition, outcome in verdicts.items() if outcome == HOLDS]
    if len(holding) == len(verdicts):
        return HOLDS, first
    if holding:
        only = "only " * (len(holding) == 1 and UNDECIDED not in verdicts.values())
        departs = "with " * (holding[0] != next(iter(findings)))
        return f"{HOLDS} {only}{departs}{holding[0]}", holding[0]
    for outcome in (UNDECIDED, POSSIBLE):
        open_ = [condition for condition in verdicts if verdicts[condition] == outcome]
        if open_:
            return outcome, open_[0]
    return verdicts[first], first


# What a word on a number says of the claim
_OF_NUMBERS = {MET: HOLDS, NOT_MET: FAILS, LOST_ITSELF: FAILS}


def combined_possible(findings):
    """As `combined`, of what "may" happen: it holds if it happens under one condition."""
    for condition, finding in findings.items():
        if finding.verdict == HOLDS:
            return HOLDS, condition
    return combined(findings)
