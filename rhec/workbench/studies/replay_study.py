"""The scores of a replayed log over noise seeds, as a table."""

import itertools

import numpy as np
import pandas as pd

from rhec.workbench.studies.statistics import over_seeds

__all__ = ["replay_table"]

_QUANTITIES = dict(
    yaw_rms_rad="RMS error of yaw [rad]",
    yaw_rms_slow_rad="RMS error of yaw without fast spins [rad]",
    position_rms_m="RMS error of position [m]",
    innovation_rms_m="RMS innovation [m]",
    mu_median="median of mu",
    mu_regression="mu by regression",
    mu_difference="median - regression, mu",
    kappa_median="median of kappa",
    kappa_regression="kappa by regression",
    kappa_difference="median - regression, kappa",
    nees_yaw="squared yaw error by its variance",
    inside_95="yaw errors within 95 % bounds",
    outside="samples with mu or kappa outside [0, 1]",
    not_ok="failed steps",
)


def replay_table(trials):
    """Means of scores over noise seeds.

    Args:
        trials: {name: rows of `rhec.logs.scores.trials`}.

    Returns:
        DataFrame with columns estimator, quantity, mean, low, high, n.
    """
    rows = []
    for (name, scores), (column, quantity) in itertools.product(
        trials.items(), _QUANTITIES.items()
    ):
        if column in scores:
            interval = over_seeds(np.mean, scores[column])._asdict()
            rows.append(dict(estimator=name, quantity=quantity) | interval)
    return pd.DataFrame(rows)
