"""Both scenarios over many fields: means with their intervals beside the numbers that the paper
reports, the verdicts on its words, and where the middle 90 % of the drives are.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.workbench.studies.statistics import (
    always,
    difference_of_means,
    over_seeds,
    ratio_of_means,
    verdict,
)

__all__ = ["REPORTED", "over_fields", "scenario_a_table", "scenario_b_table", "share_of_fields"]

REPORTED = {  # (estimator, metric): the paper's number
    ("RHE", "mean_error_m"): paper.MEAN_ERROR_RHE_M,
    ("EKF", "mean_error_m"): paper.MEAN_ERROR_EKF_M,
    ("RHE", "violations"): paper.VIOLATIONS_RHE,
    ("EKF", "violations"): paper.VIOLATIONS_EKF,
}
_QUANTITIES_A = {
    "settling_time_s": "settling time [s]",
    "overshoot_m": "overshoot [m]",
    "mean_error_m": "mean error, raw GNSS [m]",
    "mean_error_true_m": "mean error, true [m]",
}
_QUANTITIES_B = {
    "mean_error_m": "mean error, raw GNSS [m]",
    "mean_error_true_m": "mean error, true [m]",
    "violations": "violations on straights, raw GNSS",
    "violations_true": "violations on straights, true",
    "rms_yaw_rad": "RMS error of yaw [rad]",
    "rms_mu": "RMS error of mu",
    "rms_kappa": "RMS error of kappa",
}
_COLUMNS_B = "process_noise estimator quantity mean low high n p5 p95 paper claim verdict".split()
_AT_LEAST = 2  # "cannot reach in reasonable time", "oscillates": at least twofold


def over_fields(drives, column, pooled=1):
    """The 5th, 50th and 95th percentile, (3, samples / pooled), of a column of the log over Runs of
    one length, so many samples at a time together.
    """
    return np.nanpercentile(_pooled(drives, column, pooled), (5, 50, 95), axis=(0, 2))


def share_of_fields(drives, column, above, pooled=1):
    """Share of the samples, pooled as in `over_fields`, in which a column is above a bound."""
    return np.mean(_pooled(drives, column, pooled) > above, axis=(0, 2))


def _pooled(drives, column, pooled):
    values = np.array([run.columns[column] for run in drives])
    whole = values.shape[1] // pooled * pooled
    return values[:, :whole].reshape(len(drives), -1, pooled)


def _drives(values):
    """Mean, interval and the middle 90 % of a metric over drives, as columns of a table."""
    p5, p95 = np.percentile(values.dropna(), (5, 95)) if values.notna().any() else (np.nan, np.nan)
    return over_seeds(np.mean, values)._asdict() | dict(p5=p5, p95=p95)


def scenario_a_table(sweep):
    """Scenario A in numbers: means over seeds for each yaw weight, and the two ratios behind the
    paper's words. The settling time is that of the runs that settle.

    Args:
        sweep: rows of `rhec.campaign` with the column `weight` ("Q1", "Q2", …), the same seeds in
            the same order for each.

    Returns:
        DataFrame with columns weight, quantity, mean, low, high, n, p5, p95, claim, verdict.
    """
    runs = dict(list(sweep.groupby("weight", sort=False)))
    rows = [
        dict(weight=weight, quantity=quantity) | _drives(of_weight[column])
        for column, quantity in _QUANTITIES_A.items()
        for weight, of_weight in runs.items()
    ]
    for one, other, column, quantity in [
        ("Q1", "Q3", "settling_time_s", "settling time, ratio"),
        ("Q2", "Q3", "overshoot_m", "overshoot, ratio"),
    ]:
        ratio = over_seeds(ratio_of_means, runs[one][column], runs[other][column])
        said = verdict(ratio.low, ratio.high, above=_AT_LEAST)
        row = dict(weight=f"{one} / {other}", quantity=quantity) | ratio._asdict()
        rows.append(row | dict(claim=f"at least {_AT_LEAST}", verdict=said))
    return pd.DataFrame(rows).fillna({"claim": "", "verdict": ""})


def scenario_b_table(sweep):
    """Scenario B in numbers: means over seeds for each process noise and estimator, how RHE and EKF
    differ at equal seeds, and the paper's claims. The EKF takes μ and κ to be 1.

    Args:
        sweep: rows of `rhec.campaign`, the same seeds in the same order for each process noise and
            estimator.

    Returns:
        DataFrame with columns process_noise, estimator, quantity, mean, low, high, n, p5, p95,
        paper, claim, verdict.
    """
    rows = []
    for process_noise, of_noise in sweep.groupby("process_noise", sort=False):
        runs = {name.upper(): table for name, table in of_noise.groupby("estimator", sort=False)}
        for column, quantity in _QUANTITIES_B.items():
            about = dict(process_noise=process_noise, quantity=quantity)
            rows += [_of_estimator(about, name, column, runs[name][column]) for name in runs]
            if ("RHE", column) in REPORTED:
                rows.append(_gain(about, column, runs["RHE"][column], runs["EKF"][column]))
    return pd.DataFrame(rows)[_COLUMNS_B]


def _of_estimator(about, estimator, column, values):
    """A row on one estimator; a claim where the paper reports none at all."""
    reported = REPORTED.get((estimator, column), "")
    claim = ""
    said = ""
    if reported == 0:
        claim = "at most 0"
        said = always(values == 0).verdict
    return (
        about
        | _drives(values)
        | dict(estimator=estimator, paper=reported, claim=claim, verdict=said)
    )


def _gain(about, column, rhe, ekf):
    """A row on how much less the RHE has than the EKF at equal seeds."""
    gain = over_seeds(difference_of_means, rhe, ekf)
    reported = round(REPORTED["RHE", column] - REPORTED["EKF", column], 4)
    judged = dict(claim="below 0", verdict=verdict(gain.low, gain.high, below=0))
    return about | gain._asdict() | dict(estimator="RHE - EKF", paper=reported) | judged
