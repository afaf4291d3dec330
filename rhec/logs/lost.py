"""Detection of a lost estimate, and remarks on what a log does not determine.

An estimate is lost if successive innovations y are large and point in the same direction. The
measure is the median of y_k' S⁻¹ y_{k-1} over SAMPLES samples in which the robot moves. While the
estimate follows the robot, this median is about 0, even with outliers or noisier positions than
assumed. An estimate is also lost if μ or κ is at its lower bound, where a yaw error of half a turn
drives it, or if it says itself that it does not know the yaw.
"""

import numpy as np
import pandas as pd

from rhec import paper
from rhec.simulation.columns import GYRO_ACCEPTED, INNOVATION, SENSORS, SIGMA

SAMPLES = 25  # length of the medians
FAR = 5.0  # an estimate with a larger median is lost
LEAST_TRACTION = 0.02  # so is one with a smaller median of μ or κ
UNKNOWN_YAW_RAD = 0.5  # so is one with a larger median of the yaw's standard deviation
_UNSURE_YAW_RAD = 0.25  # a larger standard deviation is worth a remark
_AT_BOUND = 0.999  # of μ and κ
_OFTEN = 0.1  # share of the samples
_NOTABLE = 0.01  # the same, of a fault
_ABSURD_SLIP = 0.5  # standard deviation of the slip, as a share of the motion
# A robot below both limits stands.
_MOVING_MPS = 0.05
_TURNING_RADPS = 0.05
# A robot that drives less does not determine μ; one that turns less does not determine κ.
_LEAST_DRIVEN_M = 1.0
_LEAST_TURNED_RAD = 0.5


def _persistence(samples, sigma_v):
    """y_k' S⁻¹ y_{k-1} of the positions, (n,).

    After an update the covariance is P⁺ = V - V S⁻¹ V, from which S⁻¹ = (V - P⁺) / V². Without an
    update it is P, and S = P + V.
    """
    y = samples[INNOVATION].to_numpy()
    V = np.square(sigma_v[:2])
    P = np.square(samples[SIGMA[:2]].to_numpy())
    is_used = samples["position_accepted"].to_numpy()[:, None] == 1
    S_inverse = np.where(is_used, np.maximum(V - P, 0) / V**2, 1 / (V + P))
    y_before = samples[INNOVATION].ffill().shift().to_numpy()
    return (y * y_before * S_inverse).sum(axis=1)


def is_lost(samples, sigma_v):
    """Whether the estimate is lost at each sample of a segment, (n,).

    The answer does not change while the robot stands.

    Args:
        samples: DataFrame of one segment's samples.
        sigma_v: Standard deviations of the measurements.
    """
    moves = samples["nu_meas_mps"].abs() > _MOVING_MPS
    turns = samples["omega_meas_radps"].abs() > _TURNING_RADPS
    persistence = pd.Series(_persistence(samples, sigma_v), index=samples.index)
    lost = pd.Series(False, index=samples.index)
    for value, counts, limit in (
        (persistence, moves | turns, FAR),
        (-samples["mu_hat"], moves, -LEAST_TRACTION),
        (-samples["kappa_hat"], turns, -LEAST_TRACTION),
        (samples["sigma_theta_rad"], moves | turns, UNKNOWN_YAW_RAD),
    ):
        # Samples in which the robot stands carry no information and are left out of the medians.
        counted = value[counts & value.notna()]
        median = counted.rolling(SAMPLES, min_periods=SAMPLES // 2).median()
        lost |= (median > limit).reindex(samples.index).ffill().eq(True)
    return lost.to_numpy()


def remarks(samples, is_arm_estimated, slip=None):
    """Sentences about a replay: what not to trust and what helps, and what the log leaves open.

    Args:
        samples: DataFrame of a replay's samples, with `lost`.
        is_arm_estimated: Whether the place of the antenna is estimated.
        slip: Constants of the slip, as in `tuning.SLIP`; None: those.
    """
    lost = samples["lost"]
    sentences = []
    if lost.any():
        first_s = samples.loc[lost, "t_s"].iloc[0]
        sentences.append(
            f"The estimate is lost in {lost.mean():.1%} of the samples, first at {first_s:.1f} s: "
            "do not trust it there. rhec.doctor(log) says what is wrong with the log; a "
            "first_yaw_rad, a sigma_v, a gyro or rhec.calibrate(log) may help."
        )
    return sentences + _doubts(samples, slip) + _not_observable(samples, is_arm_estimated)


def _doubts(samples, slip):
    """Sentences about an uncertain yaw, a traction at its bound, and slip that no robot has."""
    sentences = []
    moves = samples["nu_meas_mps"].abs() > _MOVING_MPS
    turns = samples["omega_meas_radps"].abs() > _TURNING_RADPS
    unsure = samples["sigma_theta_rad"][moves] > _UNSURE_YAW_RAD
    if unsure.mean() > _OFTEN:
        sentences.append(
            f"The yaw is not known to {_UNSURE_YAW_RAD} rad in {unsure.mean():.1%} of the samples "
            "in which the robot moves: a gyro or a heading in the log would tell it."
        )
    for name, counts, cause in (
        ("μ", moves, "the wheels may be larger than the encoders' speeds assume"),
        ("κ", turns, "the driver may already have corrected the yaw rate for slip"),
    ):
        estimate = samples[dict(μ="mu_hat", κ="kappa_hat")[name]][counts]
        share = (estimate > _AT_BOUND).mean()
        if share > _OFTEN:
            sentences.append(
                f"{name} is at its bound 1 in {share:.1%} of the samples: {cause}; use raw track "
                "speeds with the true radius and track_width_m."
            )
    if GYRO_ACCEPTED in samples:
        left_out = (samples[SENSORS["gyro"]].notna() & ~samples[GYRO_ACCEPTED])[moves | turns]
        if left_out.mean() > _NOTABLE:
            sentences.append(
                f"The gyro is left out in {left_out.mean():.1%} of the samples in which the robot "
                "moves: it repeats itself, or turns far more than the tracks or the other way."
            )
    absurd = [f"{share:.2g}" for share in (slip or ())[:3] if share > _ABSURD_SLIP]
    if absurd:
        sentences.append(
            f"The slip's standard deviation is {', '.join(absurd)} of the motion, which no robot "
            "has: the positions probably wander; give their sigma_v."
        )
    return sentences


def _not_observable(samples, is_arm_estimated):
    """Sentences about what the motion does not determine."""
    sentences = []
    driven_m = paper.DT_S * samples["nu_meas_mps"].abs().sum()
    turned_rad = paper.DT_S * samples["omega_meas_radps"].abs().sum()
    if driven_m < _LEAST_DRIVEN_M:
        sentences.append("μ is not observable: according to its encoders the robot never moves.")
    if turned_rad < _LEAST_TURNED_RAD:
        sentences.append("κ is not observable: according to its encoders the robot never turns.")
    if is_arm_estimated and turned_rad < _LEAST_TURNED_RAD:
        sentences.append("The position of the antenna is not observable either.")
    elif is_arm_estimated:
        sentences.append(
            "The position of the antenna is relative to the centre of turning, whose place in the "
            "robot the log does not determine."
        )
    return sentences
