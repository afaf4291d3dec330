"""What to say of a replay: where its yaw is not known, and what the log leaves open."""

from rhec import paper
from rhec.logs.course import SIGMA_BY_COURSE
from rhec.simulation.columns import ESTIMATE, GYRO_ACCEPTED, MEASUREMENTS, SENSORS, SIGMA

UNSURE_YAW_RAD = 0.25  # standard deviation of a yaw that is not known
_AT_BOUND = 0.999  # of μ and κ
_OFTEN = 0.1  # share of the samples
_NOTABLE = 0.01  # the same, of a fault
# A robot below both limits stands.
_MOVING_MPS = 0.05
_TURNING_RADPS = 0.05
# A robot that drives less does not determine μ; one that turns less does not determine κ.
_LEAST_DRIVEN_M = 1.0
_LEAST_TURNED_RAD = 0.5


def unknown_yaw(samples):
    """In which share of the drive the yaw is not known, and why, as a sentence; or None.

    Args:
        samples: DataFrame of a replay's samples.
    """
    moving = samples[samples[MEASUREMENTS[2]].abs() > _MOVING_MPS]
    is_unsure = moving[SIGMA[2]] > UNSURE_YAW_RAD
    if not is_unsure.mean() > _OFTEN:
        return None
    by_course = (moving[SIGMA_BY_COURSE] > UNSURE_YAW_RAD)[is_unsure].mean() > 0.5
    why = "positions and encoders say little of it"
    if by_course:
        why = (
            "the course turns where encoders and gyro do not, or is not along the yaw: the robot "
            "slips sideways, positions wander, or a sensor is wrong (rhec.doctor)"
        )
    told = "a heading" if by_course else "a gyro or a heading"
    return (
        f"The yaw is not known to {UNSURE_YAW_RAD} rad in {is_unsure.mean():.1%} of the drive, "
        f"because {why}; {told} in the log would tell it."
    )


def remarks(samples, is_arm_estimated):
    """Sentences about a replay: what not to trust and what helps, and what the log leaves open.

    Args:
        samples: DataFrame of a replay's samples.
        is_arm_estimated: Whether the place of the antenna is estimated.
    """
    unknown = unknown_yaw(samples)
    sentences = [unknown] if unknown else []
    return sentences + _doubts(samples) + _not_observable(samples, is_arm_estimated)


def _doubts(samples):
    """Sentences about a traction at its bound, and a gyro that is left out."""
    sentences = []
    moves = samples[MEASUREMENTS[2]].abs() > _MOVING_MPS
    turns = samples[MEASUREMENTS[3]].abs() > _TURNING_RADPS
    for name, column, counts, cause in (
        ("μ", ESTIMATE[4], moves, "the wheels may be larger than the encoders' speeds assume"),
        ("κ", ESTIMATE[5], turns, "the driver may have a wheel_separation_multiplier, for read"),
    ):
        share = (samples[column][counts] > _AT_BOUND).mean()
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
    return sentences


def _not_observable(samples, is_arm_estimated):
    """Sentences about what the motion does not determine."""
    sentences = []
    driven_m = paper.DT_S * samples[MEASUREMENTS[2]].abs().sum()
    turned_rad = paper.DT_S * samples[MEASUREMENTS[3]].abs().sum()
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
