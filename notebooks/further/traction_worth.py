"""What estimating the traction is worth: loops of estimator and controller, each at its own best.

R = 10, the paper's, leaves so slow a controller that the estimate must lead it. So controller and
estimator of each loop are tuned together (`notebooks.further.tune_loops`), for the default world.
The paper's own stand beside them as they are printed. What a part of a loop is worth is the ratio
of the true errors with it and without it, at equal seeds.

Every loop drives a first look of few fields (`notebooks.studies.two_looks`). The second look has
all fields, and only

- the paper's RHE and the oracles, with which the others are compared,
- the loops that may still be the best: none is excluded unless the interval of its error minus the
  leader's, at equal seeds, is above zero at 99.9 %,
- both loops of each part of WORTH of which the first look cannot say, at 99.9 %, whether it pays.
"""

import dataclasses
import itertools

import numpy as np
import pandas as pd

from notebooks.further.rivals import pure_pursuit
from notebooks.further.rivals.tuned_loops import TUNED
from notebooks.studies import two_looks
from notebooks.studies.statistics import (
    CONFIDENCE,
    FIRST_CONFIDENCE,
    UNDECIDED,
    difference_of_means,
    over_seeds,
    ratio_of_means,
)
from rhec.simulation.campaigns.campaign import campaign
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning

__all__ = [
    "COSTS",
    "ERROR",
    "GAINS",
    "LOOPS",
    "PAPERS",
    "PAYS",
    "RATIO",
    "VIOLATIONS",
    "WORTH",
    "by_gain",
    "drive",
    "in_two_looks",
    "scenarios",
    "worth_table",
]

PAPERS = "RHE, as printed"
_RHE = "RHE"
_BOUNDED = "bounded EKF"
_DRIFT = "yaw-drift EKF"
_PURSUIT = "bounded EKF, pure pursuit"
_TOLD = "traction oracle"  # knows (μ, κ), and estimates its pose
_FULL = "full oracle"  # knows its pose, too
LOOPS = {
    "EKF, as printed": dict(estimator="ekf"),
    PAPERS: dict(estimator="rhe"),
    _RHE: TUNED["rhe"],
    "RHE, traction two constants": TUNED["rhe_fixed"],
    _BOUNDED: TUNED["bounded_ekf"],
    "EKF, traction two constants": TUNED["fixed_traction"],
    _DRIFT: TUNED["yaw_drift_ekf"],
    _PURSUIT: TUNED["pure_pursuit"],
    _TOLD: TUNED["traction_oracle"],
    _FULL: TUNED["oracle"],
}
_ORACLES = (_TOLD, _FULL)  # they know what no robot knows
# What a part of a loop is worth: (what, the loop with it, the loop without it).
WORTH = [
    ("the weights R and q_θ, and W: RHE", _RHE, PAPERS),
    ("estimating the traction: EKF", _BOUNDED, "EKF, traction two constants"),
    ("estimating the traction: RHE", _RHE, "RHE, traction two constants"),
    ("a window", _RHE, _BOUNDED),
    ("yaw drift as a state: EKF", _DRIFT, _BOUNDED),
    ("pure pursuit in place of the RHC", _PURSUIT, _BOUNDED),
    ("knowing the traction", _TOLD, _BOUNDED),
]
PAYS = "pays"
COSTS = "costs"
ERROR = "mean true error [m]"
RATIO = "true error with it over without it"
VIOLATIONS = "violations on straights, true"
_MEANS = {ERROR: "mean_error_true_m", VIOLATIONS: "violations_true"}
# Loops whose error is shown over the controller's weight R, all else fixed.
GAINS = {
    "RHE, W printed": dict(),
    "RHE, consistent": dict(process_noise="consistent"),
    "bounded EKF, W by likelihood": dict(estimator="bounded_ekf", process_noise="likelihood"),
    "bounded EKF, W by tracking at R = 10": dict(
        estimator="bounded_ekf", sigma_w=tuning.SIGMA_W_TRACKING["bounded_ekf"]
    ),
    "yaw-drift EKF, W by likelihood": dict(estimator="yaw_drift_ekf"),
    "traction oracle, W by likelihood": dict(estimator="traction_oracle"),
}
_R = 10.0 ** np.arange(-3, 1.5, 0.5)


def scenarios(loop, seeds):
    """The Scenarios of a loop, one a seed."""
    every = [Scenario(**LOOPS[loop], seed=seed) for seed in seeds]
    if loop != _PURSUIT:
        return every
    controller = pure_pursuit.controller(every[0])
    return [dataclasses.replace(each, controller=controller) for each in every]


def drive(loops, seeds, folder=None):
    """{loop: rows of `rhec.campaign`} on every seed; the folder keeps the campaign's rows."""
    drives = {loop: scenarios(loop, seeds) for loop in loops}
    rows = campaign([*itertools.chain(*drives.values())], folder)
    parts = np.split(np.arange(len(rows)), len(drives)) if drives else []
    return {loop: rows.iloc[part] for loop, part in zip(drives, parts)}


def in_two_looks(first, seeds, folder=None):
    """{loop: rows} on the first seeds, and on all seeds of the loops that go on."""
    looks = two_looks.drive(
        LOOPS, first, seeds, lambda loops, seeds: drive(loops, seeds, folder), _undecided
    )
    return looks.tables


def _undecided(tables, confidence):
    """The loops that need a second look."""
    rivals = [loop for loop in tables if loop not in _ORACLES]
    leader = min(rivals, key=lambda loop: tables[loop]["mean_error_true_m"].mean())
    behind = {
        loop: over_seeds(difference_of_means, *_errors(tables, loop, leader), confidence=confidence)
        for loop in rivals
    }
    may_be_best = {loop for loop, difference in behind.items() if not difference.low > 0}
    pairs = [pair for _, *pair in WORTH if _says(tables, *pair, confidence) == UNDECIDED]
    return may_be_best | {PAPERS, *_ORACLES, *itertools.chain(*pairs)}


def _errors(tables, one, other):
    """The true errors of two loops at the seeds that both have: arrays (n,)."""
    errors = [tables[loop].set_index("seed")["mean_error_true_m"] for loop in (one, other)]
    return pd.concat(errors, axis=1, join="inner").to_numpy().T


def _ratio(tables, one, other, confidence=CONFIDENCE):
    """The Interval of the ratio of two loops' true errors."""
    return over_seeds(ratio_of_means, *_errors(tables, one, other), confidence=confidence)


def _says(tables, one, other, confidence):
    """What the ratio of the errors with a part and without it says of the part."""
    interval = _ratio(tables, one, other, confidence)
    if interval.high < 1:
        return PAYS
    return COSTS if interval.low > 1 else UNDECIDED


def worth_table(tables):
    """Means over the seeds of every loop, the best first, and what each part of WORTH is worth.

    The intervals are those of 95 %; a part that the first look decided has its verdict at 99.9 %.
    """
    # In the order of the ratios to one loop, at equal seeds.
    order = sorted(tables, key=lambda loop: _ratio(tables, loop, PAPERS).mean)
    rows = [
        dict(loop=loop, quantity=quantity) | over_seeds(np.mean, tables[loop][column])._asdict()
        for loop in order
        for quantity, column in _MEANS.items()
    ]
    most = max(len(of_loop) for of_loop in tables.values())
    for what, *pair in WORTH:
        ratio = _ratio(tables, *pair)
        confidence = CONFIDENCE if ratio.n == most else FIRST_CONFIDENCE
        row = dict(loop=what, quantity=RATIO) | ratio._asdict()
        rows.append(row | dict(verdict=_says(tables, *pair, confidence)))
    return pd.DataFrame(rows)


def by_gain(seeds, folder=None, weights=_R):
    """Mean true errors of GAINS over the weight R of the yaw rate, one row a drive."""
    every = [*itertools.product(GAINS.items(), weights, seeds)]
    drives = [Scenario(**fields, r=float(r), seed=seed) for (_, fields), r, seed in every]
    labels = [label for (label, _), _, _ in every]
    columns = ["loop", "r", "seed", "mean_error_true_m"]
    return campaign(drives, folder).assign(loop=labels)[columns]
