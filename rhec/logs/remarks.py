"""What to say of a replay: where its yaw is not known, and how often a sensor is left out."""

from rhec.logs.course import SIGMA_BY_COURSE
from rhec.logs.recording import moves
from rhec.simulation.columns import ACCEPTED, MEASUREMENTS, SENSORS, SIGMA

UNSURE_YAW_RAD = 0.25  # standard deviation of a yaw that is not known
_OFTEN = 0.1  # share of the samples
_NOTABLE = 0.01  # the same, of a fault
_MOVING_MPS = 0.05


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
            "slips sideways, positions wander, or a sensor is wrong"
        )
    told = "a heading" if by_course else "a gyro or a heading"
    return (
        f"The yaw is not known to {UNSURE_YAW_RAD} rad in {is_unsure.mean():.1%} of the drive, "
        f"because {why}; {told} in the log would tell it."
    )


def remarks(samples):
    """Sentences about a replay: where its yaw is not known, and how often a sensor is left out.

    Args:
        samples: DataFrame of a replay's samples.
    """
    unknown = unknown_yaw(samples)
    sentences = [unknown] if unknown else []
    for name, accepted in ACCEPTED.items():
        if accepted not in samples:
            continue
        left_out = (samples[SENSORS[name]].notna() & ~samples[accepted])[moves(samples)]
        if left_out.mean() > _NOTABLE:
            sentences.append(
                f"The {name} is left out in {left_out.mean():.1%} of the samples in which the "
                "robot moves: it repeats itself, or turns far more than the tracks."
            )
    return sentences
