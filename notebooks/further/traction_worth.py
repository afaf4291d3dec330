"""What estimating the traction is worth: loops of estimator and controller, each at its own best.

R = 10, the paper's, leaves so slow a controller that the estimate must lead it. So controller and
estimator of each loop are tuned together (`notebooks.further.tune_loops`), for the default world.
The paper's own stand beside them as they are printed. What a part of a loop is worth is the ratio
of the true errors with it and without it, at equal seeds. Other soils have a map
(`notebooks.further.traction_map`).
"""

import numpy as np
import pandas as pd

from notebooks.further.rivals.tuned_loops import TUNED
from notebooks.studies import parallel
from notebooks.studies.statistics import UNDECIDED, over_seeds, ratio_of_means
from rhec.simulation.scenario import Scenario

PAPERS = "RHE, as printed"
_RHE = "RHE"
_BOUNDED = "bounded EKF"
_DRIFT = "yaw-drift EKF"
_RHE_DRIFT = "RHE with yaw drift"
_RHE_GYRO = "RHE with a gyro"
_TOLD = "traction oracle"  # knows (μ, κ), and estimates its pose
_TOLD_DRIFT = "drift oracle"  # knows the yaw drift, too
_FULL = "full oracle"  # knows its pose, too
LOOPS = {
    "EKF, as printed": dict(estimator="ekf", process_noise="printed"),
    PAPERS: dict(estimator="rhe", process_noise="printed"),
    "EKF": TUNED["ekf"],
    _RHE: TUNED["rhe"],
    _RHE_DRIFT: TUNED["rhe_yaw_drift"],
    _RHE_GYRO: TUNED["rhe_gyro"],
    "RHE, traction two constants": TUNED["rhe_fixed"],
    _BOUNDED: TUNED["bounded_ekf"],
    "EKF, traction two constants": TUNED["fixed_traction"],
    _DRIFT: TUNED["yaw_drift_ekf"],
    _TOLD: TUNED["traction_oracle"],
    _TOLD_DRIFT: TUNED["drift_oracle"],
    _FULL: TUNED["oracle"],
}
# What a part of a loop is worth: (what, the loop with it, the loop without it).
WORTH = [
    ("the weights R and q_θ, and W: RHE", _RHE, PAPERS),
    ("estimating the traction: EKF", _BOUNDED, "EKF, traction two constants"),
    ("estimating the traction: RHE", _RHE, "RHE, traction two constants"),
    ("estimating the traction: RHE over the paper's EKF", _RHE, "EKF"),
    ("a window", _RHE, _BOUNDED),
    ("yaw drift as a state: EKF", _DRIFT, _BOUNDED),
    ("yaw drift as a parameter: RHE", _RHE_DRIFT, _RHE),
    ("a gyro: RHE", _RHE_GYRO, _RHE),
    ("knowing the traction", _TOLD, _BOUNDED),
    ("knowing the yaw drift, too", _TOLD_DRIFT, _TOLD),
]
PAYS = "pays"
COSTS = "costs"
ERROR = "mean true error [m]"
RATIO = "true error with it over without it"
VIOLATIONS = "violations on straights, true"
_MEANS = {ERROR: "mean_error_true_m", VIOLATIONS: "violations_true"}


def scenarios(loop, seeds):
    """The Scenarios of a loop, one a seed."""
    return [Scenario(**LOOPS[loop], seed=seed) for seed in seeds]


def drive(loops, seeds, folder=None):
    """{loop: rows of `rhec.campaign`} on every seed; the folder keeps the campaign's rows."""
    return parallel.drive({loop: scenarios(loop, seeds) for loop in loops}, folder, workers=1)


def _ratio(tables, one, other):
    """The Interval of the ratio of two loops' true errors at equal seeds."""
    errors = (tables[loop]["mean_error_true_m"] for loop in (one, other))
    return over_seeds(ratio_of_means, *errors)


def _says(interval):
    """What the ratio of the errors with a part and without it says of the part."""
    if interval.high < 1:
        return PAYS
    return COSTS if interval.low > 1 else UNDECIDED


def worth_table(tables):
    """Means over the seeds of every loop, the best first, and what each part of WORTH is worth."""
    order = sorted(tables, key=lambda loop: tables[loop]["mean_error_true_m"].mean())
    rows = [
        dict(loop=loop, quantity=quantity) | over_seeds(np.mean, tables[loop][column])._asdict()
        for loop in order
        for quantity, column in _MEANS.items()
    ]
    for what, *pair in WORTH:
        ratio = _ratio(tables, *pair)
        row = dict(loop=what, quantity=RATIO) | ratio._asdict()
        rows.append(row | dict(verdict=_says(ratio)))
    return pd.DataFrame(rows)
