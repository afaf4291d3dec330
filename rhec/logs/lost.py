"""Whether a replay has lost its robot, and what its log cannot tell: by innovations and bounds.

Lost is an estimate whose innovations y are large and point where the one before did, in the median
of SAMPLES while the robot moves: y_k' S⁻¹ y_{k-1} is about 0 where the estimate follows the robot,
also where the positions are worse than assumed or some are outliers. Lost is also one that has μ or
κ at their lower bound, as if the tracks did nothing: that is how a yaw half a turn wrong ends.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.simulation.columns import INNOVATION, SIGMA

__all__ = ["is_lost", "remarks"]

SAMPLES = 25
FAR = 5.0
LEAST_TRACTION = 0.02
_MOVING_MPS = 0.05
_TURNING_RADPS = 0.05
# driven, turned: less tells nothing of μ, of κ
_SEEN_M = 1.0
_SEEN_RAD = 0.5


def _persistence(samples, sigma_v):
    """y_k' S⁻¹ y_{k-1} of the positions (n,). After an update P⁺ = V - V S⁻¹ V, which gives S."""
    y = samples[INNOVATION].to_numpy()
    V = np.square(sigma_v[:2])
    P = np.square(samples[SIGMA[:2]].to_numpy())
    used = samples["position_accepted"].to_numpy()[:, None] == 1
    inverse = np.where(used, np.maximum(V - P, 0) / V**2, 1 / (V + P))
    before = samples[INNOVATION].ffill().shift().to_numpy()
    return (y * before * inverse).sum(axis=1)


def is_lost(samples, sigma_v):
    """Whether each of one segment's samples is lost, (n,); while the robot stands, as before."""
    moves = samples["nu_meas_mps"].abs() > _MOVING_MPS
    turns = samples["omega_meas_radps"].abs() > _TURNING_RADPS
    far = pd.Series(_persistence(samples, sigma_v), index=samples.index)
    lost = pd.Series(False, index=samples.index)
    for value, counted, beyond in (
        (far, moves | turns, FAR),
        (-samples["mu_hat"], moves, -LEAST_TRACTION),
        (-samples["kappa_hat"], turns, -LEAST_TRACTION),
    ):
        known = value[counted & value.notna()]
        median = known.rolling(SAMPLES, min_periods=SAMPLES // 2).median()
        lost |= (median > beyond).reindex(samples.index).ffill().eq(True)
    return lost.to_numpy()


def remarks(samples, arm_estimated):
    """What a user should know of a replay, in sentences."""
    lost = samples["lost"]
    said = []
    if lost.any():
        first_s = samples.loc[lost, "t_s"].iloc[0]
        said.append(
            f"The estimate is lost in {lost.mean():.1%} of the samples, first at {first_s:.1f} s: "
            "do not trust it there."
        )
    driven, turned = (
        paper.DT_S * samples[name].abs().sum() for name in ("nu_meas_mps", "omega_meas_radps")
    )
    if driven < _SEEN_M:
        said.append("μ cannot be seen: by its encoders the robot never moves.")
    if turned < _SEEN_RAD:
        said.append("κ cannot be seen: by its encoders the robot never turns.")
    if arm_estimated and turned < _SEEN_RAD:
        said.append("The antenna's place cannot be seen either.")
    elif arm_estimated:
        said.append(
            "The antenna's place is that from the centre of turning: where in the robot that lies "
            "cannot be told apart."
        )
    return said
