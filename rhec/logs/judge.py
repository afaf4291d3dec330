"""How well the RHE does on a log without truth: positions that are hidden, and a smoothed yaw.

Positions are hidden from the estimator for HIDDEN_S at a time. Where it says too much of what it
knows, its standard deviations are made larger by one factor (`inflation`), as Birge (1932) does
with those of measurements that scatter more than they say.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.logs.likelihood import Z_95
from rhec.logs.motion import moves
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, SIGMA

HIDDEN_S = 10.0
_EVERY_S = 30.0  # in which positions are hidden for HIDDEN_S
_LEAST_AFTER_S = 5.0  # since the last position; a shorter time tests nothing
_FROM_M = 8.0  # distance driven in a segment from which on the yaw has converged
_COVERED = 0.95  # share of the errors that should be within
_BOTH = 2.236  # standard deviations that hold 95 % of both coordinates of a position


def hidden_errors(recording, estimate, sigma_v=(0.0, 0.0)):
    """Errors of an estimator at the last position of each stretch of hidden ones, a DataFrame.

    The estimator runs for each part of _EVERY_S that may be hidden, so that all positions of a
    segment but its first ones are hidden once.

    Args:
        recording: The Recording.
        estimate: The estimator: a function from a Recording to its samples.
        sigma_v: Standard deviations of the positions (x, y) themselves [m].

    Returns:
        after_s, time since the last position that was not hidden; error_m, distance from the hidden
        one; and ratio, the larger error of x and y over its 95 % limit.
    """
    rows = recording.rows
    first_s = rows.groupby("segment")["t_s"].first()
    since_s = rows["t_s"] - rows["segment"].map(first_s)
    shown = pd.concat(recording.samples())[MEASUREMENTS[:2]].to_numpy()
    tables = []
    for begin_s in np.arange(0.0, _EVERY_S, HIDDEN_S):
        is_hidden = ((since_s - begin_s) % _EVERY_S < HIDDEN_S) & (since_s >= HIDDEN_S)
        masked = rows.copy()
        masked.loc[is_hidden, MEASUREMENTS[:2]] = np.nan
        samples = estimate(recording.with_rows(masked))
        sample_s = samples["t_s"] - samples["segment"].map(first_s)
        off = samples[ESTIMATE[:2]].to_numpy() - shown
        limits = _BOTH * np.hypot(samples[SIGMA[:2]].to_numpy(), sigma_v[:2])
        errors = pd.DataFrame(
            dict(
                segment=samples["segment"],
                stretch=begin_s + (sample_s - begin_s) // _EVERY_S * _EVERY_S,
                # The last position was measured one sample before the first that is hidden.
                after_s=(sample_s - begin_s) % _EVERY_S + paper.DT_S,
                error_m=np.hypot(*off.T),
                ratio=(np.abs(off) / limits).max(axis=1),
            )
        )
        counts = (sample_s > HIDDEN_S) & (errors["after_s"] < HIDDEN_S + paper.DT_S / 2)
        tables.append(errors[counts & (errors["after_s"] >= _LEAST_AFTER_S)].dropna())
    return pd.concat(tables).groupby(["segment", "stretch"]).last()


def inflation(*ratios):
    """The factor of at least 1 by which limits hold _COVERED of each series of ratios.

    Of n errors that is the nearest whole number, about the median of what right limits hold: of 18
    they hold 17, and one far outside tells nothing.

    Args:
        *ratios: Errors over their 95 % limits (n,); an empty series says nothing.
    """
    needed = [np.sort(each)[round(_COVERED * len(each)) - 1] for each in ratios if len(each)]
    return float(max(1.0, *needed)) if needed else 1.0


def judge(recording, estimate, smoothed, sigma_v):
    """Samples of an estimator on a log, as a robot runs it on its way, and {name: number} of them.

    Their standard deviations are as the estimator says, and by "inflation" too small.

    Args:
        recording: The Recording.
        estimate: The estimator, causal: a function from a Recording to its samples.
        smoothed: Smoothed samples, whose yaw is the reference.
        sigma_v: Standard deviations of the positions (x, y) [m].
    """
    samples = estimate(recording)
    hidden = hidden_errors(recording, estimate, sigma_v)
    step_m = paper.DT_S * samples[MEASUREMENTS[2]].abs().fillna(0.0)
    driven_m = step_m.groupby(samples["segment"]).cumsum()
    yaw = ESTIMATE[2]
    counts = moves(samples) & (driven_m > _FROM_M) & (samples[yaw] + smoothed[yaw]).notna()
    apart = ((samples[yaw] - smoothed[yaw] + np.pi)[counts] % (2 * np.pi) - np.pi).abs()
    ratio = apart / (Z_95 * samples[SIGMA[2]][counts])
    factor = inflation(hidden["ratio"], ratio)
    numbers = dict(
        hidden=len(hidden),
        hidden_covered=int((hidden["ratio"] <= 1).sum()),
        hidden_error_m=float(hidden["error_m"].median()) if len(hidden) else np.nan,
        yaw_in_95=float((ratio <= 1).mean()),
        yaw_sigma_rad=factor * float(samples[SIGMA[2]][counts].median()),
        inflation=factor,
    )
    return samples, numbers
