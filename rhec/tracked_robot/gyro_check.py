"""Which samples of a recorded gyro a replay leaves out. Not in the paper.

- *Absurd*: a yaw rate far beyond that of the tracks. It is the gyro's fault, not the soil's.
- *Stuck or dead*: the last measurement again, but for rounding. A gyro has noise.
"""

import numpy as np

_MOST_RADPS = 1.0  # of a gyro, besides
_MOST_SHARE = 2.0  # this share of the tracks' yaw rate
_ROUNDING_RADPS = 1e-9  # of means over a sample


def are_accepted(gyro, omega):
    """Whether each measurement of a recorded gyro is used, (n,).

    Args:
        gyro: Series (n,) of measurements [rad/s], NaN where there is none.
        omega: Series (n,) of yaw rates of the tracks [rad/s], without NaN.
    """
    is_absurd = gyro.abs() > _MOST_RADPS + _MOST_SHARE * omega.abs()
    is_stuck = (gyro - gyro.ffill().shift()).abs() <= _ROUNDING_RADPS
    return np.array(gyro.notna() & ~is_absurd & ~is_stuck)
