"""Every tuned noise in one place, with its source: standard deviations per sample.

Each is named by the rule that picked it, W and V alike. All but the last were tuned in the default
world, with the arrival mean "filtered", on training seeds that no result uses
(`notebooks/studies/calibration.py` writes `tuned.csv`, with the seeds and the objective of each):

- "printed" is the paper's, to the letter (interpretations G1, G2).
- "consistent" has a covariance that is as large as the errors (NEES ≈ 1).
- "prediction" predicts the measurements of the next sample best. It needs no truth.
- "tracking" has the least true error of a robot that drives with the paper's weights, R = 10.
- "soft_soil" is as "prediction" on soil that slips as much as that under recorded robots, which
  they are used on (`calibration.SOFT_SOIL`).

Through σ_ω noise of the yaw enters the window of an RHE: tuned, it includes all turning that no
encoder measures. The filters do not use it.
"""

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rhec import paper

FILE = Path(__file__).with_name("tuned.csv")
RULES = ("printed", "consistent", "prediction", "tracking", "soft_soil")
RULES_IN_DEFAULT_WORLD = RULES[:4]  # all but the one for recorded robots
DEFAULT_RULE = "prediction"  # of every estimator: the one that needs no truth


class Noise(NamedTuple):
    """What an estimator assumes of noise.

    Attributes:
        sigma_w: Of (x, y, θ, ν, μ, κ) [m, m, rad, m/s, 1, 1], or of the first four where the
            traction is not estimated; with the yaw drift [rad/m] last where that is.
        sigma_v: Of the measured (x, y, ν, ω) [m, m, m/s, rad/s].
    """

    sigma_w: tuple
    sigma_v: tuple


# Before the first sample the yaw drift is unknown: two per cent of slip between the tracks [rad/m].
SIGMA_YAW_DRIFT = 0.05


def _printed():
    """The paper's noises: those of the RHE for every estimator that has as many states."""
    of_rhe = Noise(paper.SIGMA_W_RHE, paper.SIGMA_V)
    return {
        "rhe": of_rhe,
        # The yaw drift is not in the paper. What the paper prints as W is P_0, too: each quantity
        # may change in a sample by as much as is unknown of it at the start. So may this one.
        "rhe_yaw_drift": Noise((*of_rhe.sigma_w, SIGMA_YAW_DRIFT), of_rhe.sigma_v),
        "ekf": Noise(paper.SIGMA_W_EKF, paper.SIGMA_V),
        "bounded_ekf": of_rhe,
    }


def _numbers(text):
    """Numbers that spaces separate."""
    return tuple(map(float, text.split()))


def read(file, printed):
    """{estimator: {rule: Noise}} of a table such as tuned.csv, in the order of RULES.

    Args:
        file: Its Path.
        printed: {estimator: Noise} of the rule "printed".
    """
    found = {estimator: {"printed": noise} for estimator, noise in printed.items()}
    with file.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            noise = Noise(_numbers(row["sigma_w"]), _numbers(row["sigma_v"]))
            found.setdefault(row["estimator"], {})[row["process_noise"]] = noise
    return {
        estimator: {rule: by_rule[rule] for rule in RULES if rule in by_rule}
        for estimator, by_rule in found.items()
    }


NOISES = read(FILE, _printed())
# The speed model "slipping". Source: in the middle of what `rhec.calibrate` finds for four recorded
# logs, three of robots with wheels and one with tracks. The noise grows with the motion.
# Of (μ, κ), with the distance d that the tracks ran, as √d [1/√m].
SLIPPING_NOISE = Noise((0.006, 0.01), paper.SIGMA_V)
SLIP = dict(
    # Standard deviation of the slip speed ahead, as a share of ν [1].
    share_nu=0.1,
    # Standard deviation of the slip in turning, as a share of ω [1].
    share_omega=0.17,
    # Standard deviation of the slip speed to the side, as a share of bω [1].
    share_side=0.09,
    # Standard deviation of the yaw from bumps, growing as √d [rad/√m].
    sigma_bumps=0.015,
    # The mean slip speed to the side is -side_slip_s·νω [s].
    side_slip_s=0.05,
)
SIGMA_SIDE_SLIP_AT_REST = 1e-3  # [m/s], by choice: keeps the variance above 0


def process_noise_of(scenario):
    """The rule that picked the noise of a Scenario's estimator: its own, or the default."""
    return scenario.process_noise or DEFAULT_RULE


def noises_of(estimator):
    """{rule: Noise} of an estimator, by its name or as it brings them along; {} if it has none."""
    return NOISES.get(estimator, {}) if isinstance(estimator, str) else estimator.noises


def noise_of(estimator, scenario):
    """The Noise of an estimator by the rule of a Scenario; what has none takes that of the RHE."""
    return (noises_of(estimator) or NOISES["rhe"])[process_noise_of(scenario)]


def name_of_noise(scenario):
    """Name in NOISES of a Scenario's estimator: an RHE with the yaw drift has noises of its own."""
    return f"{scenario.estimator}_yaw_drift" if scenario.yaw_drift else scenario.estimator


def sigma_v_of(scenario):
    """Standard deviations of the measurements that a Scenario's estimator assumes."""
    return scenario.sigma_v or noise_of(name_of_noise(scenario), scenario).sigma_v


def variances_of(name, scenario):
    """The settings V and W of a Scenario's estimator, by its name or as it brings them along."""
    sigma_w = scenario.sigma_w
    if sigma_w is None:
        sigma_w = noise_of(name, scenario).sigma_w
    return dict(V=np.square(sigma_v_of(scenario)), W=np.square(sigma_w))
