"""A recorded log through the paper's estimators and the default one: as it is, and made harder.

The harder replays add white noise to the positions and an error to the first yaw
(`notebooks.further.recorded.scores`). Their scores are means over noise seeds.
"""

import itertools

import numpy as np
import pandas as pd

from notebooks.further.recorded import scores
from notebooks.studies.statistics import over_seeds

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
# Arguments of `rhec.replay` that belong to the log, and hold for every estimator.
_OF_THE_LOG = ("track_width_m", "position_delay_s", "trust_log")


def of_the_log(replaying):
    """Those arguments of a replay that belong to the log, as `rhec.log` takes them."""
    return {name: replaying[name] for name in _OF_THE_LOG if name in replaying}


def estimators(process_noise, of_the_rhe):
    """{name: arguments of `rhec.replay`} of the RHE, which has its own, and of two others.

    The noise of the others is "printed" or "soft_soil": soil under recorded robots slips more than
    that of the default world.
    """
    given = of_the_log(of_the_rhe)
    noise = dict(process_noise=process_noise)
    papers = {"RHE, ν over the window": dict(speed_model="parameter"), "EKF": dict(estimator="ekf")}
    return {"RHE": of_the_rhe} | {name: given | noise | of for name, of in papers.items()}


def trials(log, seeds, estimators, **perturbation):
    """{estimator: scores, a row a noise seed}, of `estimators` on a log with a perturbation."""
    return {
        name: pd.DataFrame(
            [
                scores.score(scores.perturbed_replay(log, seed, **perturbation, **arguments))
                for seed in seeds
            ]
        )
        for name, arguments in estimators.items()
    }


def replay_table(trials):
    """Means of the scores of `trials` over noise seeds, with intervals."""
    rows = []
    for (name, of_seeds), (column, quantity) in itertools.product(
        trials.items(), _QUANTITIES.items()
    ):
        if column in of_seeds:
            least = -np.inf if column.endswith("difference") else 0.0
            interval = over_seeds(np.mean, of_seeds[column], least=least)._asdict()
            rows.append(dict(estimator=name, quantity=quantity) | interval)
    return pd.DataFrame(rows)
