"""Scenarios A and B of the paper over many fields: the drives, and tables of means with intervals.

A field is one seed: its soil and its noise. The tables hold the paper's numbers as well, and the
verdicts on its words. Scenario B is driven on every pattern of turns (interpretation G18): where a
path always turns one way, its turns and the soil's one-sided slip add up, or cancel.
"""

from typing import get_args

import numpy as np
import pandas as pd

from notebooks.studies import statistics
from notebooks.studies.statistics import (
    LOST,
    always,
    difference_of_means,
    over_seeds,
    ratio_of_means,
    share,
    verdict,
)
from rhec import paper
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.scenario import Scenario
from rhec.simulation.simulate import simulate
from rhec.simulation.worlds import WORLDS
from rhec.style import label_of
from rhec.tracked_robot import tuning
from rhec.tracked_robot.path import Turns

# W by each rule, the same for RHE and EKF.
PROCESS_NOISES = tuning.RULES_IN_DEFAULT_WORLD
TURNS = get_args(Turns)
REPORTED = {  # (estimator, metric): the paper's number
    ("RHE", "mean_error_m"): paper.MEAN_ERROR_RHE_M,
    ("EKF", "mean_error_m"): paper.MEAN_ERROR_EKF_M,
    ("RHE", "violations"): paper.VIOLATIONS_RHE,
    ("EKF", "violations"): paper.VIOLATIONS_EKF,
    # No violation in "multiple experiments" of the RHE, 17 in the one drive of the EKF.
    ("RHE", "is_clean"): 1,
    ("EKF", "is_clean"): 0,
}
# Names, or a rhec.Estimator, which is called by its label.
_ESTIMATORS = ("rhe", "ekf")
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
    "is_clean": "share of drives without a violation",
    "rms_yaw_rad": "RMS error of yaw [rad]",
    "rms_mu": "RMS error of mu",
    "rms_kappa": "RMS error of kappa",
}
_ORDERED = ("mean_error_m", "violations")  # of which the paper says that the RHE has less
_COLUMNS_B = (
    "turns process_noise estimator quantity mean low high n p5 p95 paper claim verdict".split()
)
_AT_LEAST = 2  # "cannot reach in reasonable time", "oscillates": at least twofold


# Drives


def yaw_weights(look_ahead_m=0.5):
    """Scenario A's variants: {name: fields of Scenario}, with the paper's Q¹, Q² and Q³."""
    return {
        "Q1": dict(q=paper.Q1),
        "Q2": dict(q=paper.Q2),
        "Q2, look-ahead": dict(q=paper.Q2, look_ahead_m=look_ahead_m),
        "Q3": dict(q=paper.Q3),
    }


def scenario_a(seeds, seed, weights, folder=None, **fields):
    """Drive Scenario A: off the path at the start, with each yaw weight.

    Args:
        seeds: How many fields the statistics are over, from seed 0 on.
        seed: Field of the single runs.
        weights: {name: fields of Scenario}, as of `yaw_weights`.
        folder: Where the campaign keeps its rows.
        fields: Other fields of Scenario, the same for all drives.

    Returns:
        sweep: DataFrame, one row a drive (`rhec.campaign`), with the column `weight`.
        runs: {weight: Run} of the one seed.
    """
    scenarios = [
        Scenario(seed=number, **fields, **choice)
        for choice in weights.values()
        for number in range(seeds)
    ]
    sweep = campaign(scenarios, folder).assign(weight=np.repeat([*weights], seeds))
    runs = simulate([Scenario(seed=seed, **fields, **choice) for choice in weights.values()])
    return sweep, dict(zip(weights, runs))


def scenario_b(seeds, drives, beside=0, turns=TURNS[0], folder=None, **fields):
    """Drive Scenario B: rows and headlands, by RHE and EKF with W by each of PROCESS_NOISES.

    Args:
        seeds: How many fields the statistics are over, from seed 0 on.
        drives: How many fields to return whole runs of the RHE of, from seed 0 on.
        beside: How many fields the other patterns of turns are driven on, from seed 0 on.
        turns: Which way the path turns (G18).
        folder: Where the campaign keeps its rows.
        fields: Other fields of Scenario, the same for all drives.

    Returns:
        sweep: DataFrame, one row a drive (`rhec.campaign`), with the column `turns`, the pattern
            that was asked for first.
        runs: {process noise: Runs of the RHE, one a seed}.
    """

    def scenario(pattern, estimator, number, process_noise):
        choice = dict(turns=pattern, estimator=estimator, process_noise=process_noise)
        return Scenario(seed=number, **choice, **fields)

    patterns = [turns, *(pattern for pattern in TURNS if pattern != turns)]
    # Drives on one field follow each other, so that its soil is made once.
    every = [
        scenario(pattern, estimator, number, process_noise)
        for pattern in patterns
        for estimator in _ESTIMATORS
        for number in range(seeds if pattern == turns else beside)
        for process_noise in PROCESS_NOISES
    ]
    sweep = campaign(every, folder).assign(turns=[each.turns for each in every])
    runs = {
        process_noise: simulate(
            [scenario(turns, "rhe", number, process_noise) for number in range(drives)]
        )
        for process_noise in PROCESS_NOISES
    }
    return sweep, runs


def rhe_and_ekf(**fields):
    """{"RHE": Run, "EKF": Run} of one Scenario with these fields."""
    runs = simulate([Scenario(estimator=estimator, **fields) for estimator in _ESTIMATORS])
    return dict(zip(map(label_of, _ESTIMATORS), runs))


def on_soft_soil(fields, **others):
    """Runs of the RHE on soft soil with the W by prediction there, one a field from seed 0 on."""
    soft = WORLDS["soft"] | dict(process_noise="soft_soil") | others
    return simulate([Scenario(seed=number, **soft) for number in range(fields)])


# What many drives have in common


def over_fields(drives, column):
    """The 5th, 50th and 95th percentile of a column of the log over Runs of one length."""
    return np.nanpercentile([run.columns[column] for run in drives], (5, 50, 95), axis=0)


# Tables


def _mean_and_range(values):
    """Mean, interval and the middle 90 % of a metric over drives, as columns of a table.

    No metric of the tables is negative.
    """
    p5, p95 = np.percentile(values.dropna(), (5, 95)) if values.notna().any() else (np.nan, np.nan)
    return over_seeds(np.mean, values, least=0.0)._asdict() | dict(p5=p5, p95=p95)


def single_runs(runs):
    """The quantities of Scenario A of single runs {weight: Run}: one row a weight."""
    return pd.DataFrame(
        {
            quantity: {weight: run.metrics[column] for weight, run in runs.items()}
            for column, quantity in _QUANTITIES_A.items()
        }
    )


def scenario_a_table(sweep):
    """Scenario A in numbers: means over seeds, and the two ratios behind the paper's words.

    The settling time is that of the runs that settle.

    Args:
        sweep: Of `scenario_a`: the same seeds in the same order for each weight.

    Returns:
        DataFrame with columns weight, quantity, mean, low, high, n, p5, p95, claim, verdict.
    """
    runs = dict(list(sweep.groupby("weight")))
    rows = [
        dict(weight=weight, quantity=quantity) | _mean_and_range(of_weight[column])
        for column, quantity in _QUANTITIES_A.items()
        for weight, of_weight in runs.items()
    ]
    for one, other, column, quantity in [
        ("Q1", "Q3", "settling_time_s", "settling time, ratio"),
        ("Q2", "Q3", "overshoot_m", "overshoot, ratio"),
    ]:
        ratio = over_seeds(ratio_of_means, runs[one][column], runs[other][column])
        judged = verdict(ratio.low, ratio.high, above=_AT_LEAST)
        row = dict(weight=f"{one} / {other}", quantity=quantity) | ratio._asdict()
        rows.append(row | dict(claim=f"at least {_AT_LEAST}", verdict=judged))
    return pd.DataFrame(rows).fillna({"claim": "", "verdict": ""})


def scenario_b_table(sweep):
    """Scenario B in numbers: means over seeds, how RHE and EKF differ, and the paper's claims.

    The EKF takes μ and κ to be 1.

    Args:
        sweep: Of `scenario_b`: the same seeds in the same order for each process noise and
            estimator of a pattern of turns.

    Returns:
        DataFrame with columns turns, process_noise, estimator, quantity, mean, low, high, n, p5,
        p95, paper, claim, verdict.
    """
    sweep = sweep.assign(is_clean=sweep["violations"] == 0)
    rows = []
    for (turns, process_noise), drives in sweep.groupby(["turns", "process_noise"], sort=False):
        by_estimator = drives.groupby("estimator", sort=False)
        runs = {label_of(estimator): table for estimator, table in by_estimator}
        for column, quantity in _QUANTITIES_B.items():
            about = dict(turns=turns, process_noise=process_noise, quantity=quantity)
            for name, table in runs.items():
                rows.append(about | _of_estimator(name, column, table[column]))
            if column in _ORDERED:
                both = [runs[name][column] for name in ("RHE", "EKF")]
                gain = _gain(column, *both) | (dict(verdict=LOST) if is_lost(runs["EKF"]) else {})
                rows += [about | gain, about | _share_below(*both)]
    return pd.DataFrame(rows)[_COLUMNS_B]


def _of_estimator(estimator, column, values):
    """Columns of a row on one estimator; a claim where the paper reports none at all."""
    reported = REPORTED.get((estimator, column), "")
    found = _share(values) if values.dtype == bool else _mean_and_range(values)
    row = found | dict(estimator=estimator, paper=reported, claim="", verdict="")
    if column == "violations" and reported == 0:
        row |= dict(claim="at most 0", verdict=always(values == 0).verdict)
    return row


def is_lost(drives):
    """Whether the robot of a campaign's rows is lost, as `statistics.is_lost` says."""
    return statistics.is_lost(drives["mean_error_m"].mean())


def _share_below(rhe, ekf):
    """Columns of a row on the share of fields in which the RHE has less than the EKF."""
    row = dict(estimator="P(RHE < EKF)", paper="", claim="", verdict="")
    return row | _share(rhe.to_numpy() < ekf.to_numpy())


def _share(flags):
    """Columns of a row on the share of drives of which something is so."""
    found = share(flags)
    return dict(mean=found.value, low=found.low, high=found.high, n=found.n)


def _gain(column, rhe, ekf):
    """Columns of a row on how much less the RHE has than the EKF at equal seeds."""
    gain = over_seeds(difference_of_means, rhe, ekf)
    # The paper gives four decimals.
    reported = round(REPORTED["RHE", column] - REPORTED["EKF", column], 4)
    judged = dict(claim="below 0", verdict=verdict(gain.low, gain.high, below=0))
    return gain._asdict() | dict(estimator="RHE - EKF", paper=reported) | judged
