"""Whether a sample of a gyro is left out, by what it and the tracks say. Not in the paper.

A replay leaves these samples out with each estimator; other loops have no such check.

- *Absurd*: a yaw rate far beyond that of the tracks.
- *Stuck or dead*: the last measurement again, but for rounding. A gyro has noise.
- *Opposite*: over seconds the gyro turns the other way than the tracks. A robot whose tracks spin
  turns less than they do, or not at all, but not the other way. With the yaw rates g of the gyro
  and ω of the tracks, and sums that forget by a factor a sample,

      Σ gω < -OPPOSITE Σ ω²

  begins it where the robot turns, and Σ gω > OPPOSITE Σ ω² ends it.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec.core.model.limits import MAX_MEASUREMENT, is_valid_measurement


class Tuned(NamedTuple):
    """The numbers that were chosen, not derived; no seeds are recorded on which they were."""

    # name: value  # [unit] meaning
    most_radps: float = 1.0  # [rad/s] a gyro beyond this, and
    most_share: float = 2.0  # [1] this share of the tracks' yaw rate: its fault, not the soil's
    opposite: float = 0.3  # [1] share of Σ ω² by which the gyro turns the other way, or the same
    rounding_radps: float = 1e-9  # [rad/s] of means over a sample
    forgetting: float = 0.9  # [1] of the sums, per sample
    least_squares: float = 0.2  # [rad²/s²] Σ ω² of a robot that turns: 0.2 rad/s for 1 s at 5 Hz


TUNED = Tuned()


class Gyro(NamedTuple):
    """What is remembered of a gyro."""

    last: ca.SX  # its last measurement [rad/s], NaN before the first one
    product: ca.SX  # Σ gω [rad²/s²]
    square: ca.SX  # Σ ω² [rad²/s²]
    is_opposite: ca.SX  # 1 while it turns the other way than the tracks


def checked(gyro, omega, before):
    """The measurement of a gyro, or NaN if it is to be left out, and the Gyro after it.

    Args:
        gyro: The measurement [rad/s], NaN where there is none.
        omega: The yaw rate of the tracks [rad/s].
        before: The Gyro before this sample.
    """
    has_gyro = is_valid_measurement(gyro, MAX_MEASUREMENT)
    is_absurd = ca.fabs(gyro) > TUNED.most_radps + TUNED.most_share * ca.fabs(omega)
    is_stuck = ca.fabs(gyro - before.last) <= TUNED.rounding_radps
    counts = has_gyro * (1 - is_absurd) * (1 - is_stuck)
    product = ca.if_else(counts, TUNED.forgetting * before.product + gyro * omega, before.product)
    square = ca.if_else(counts, TUNED.forgetting * before.square + omega**2, before.square)
    turns = square > TUNED.least_squares
    begins = turns * (product < -TUNED.opposite * square)
    ends = turns * (product > TUNED.opposite * square)
    is_opposite = ca.logic_or(begins, before.is_opposite * (1 - ends))
    used = ca.if_else(counts * (1 - is_opposite), gyro, ca.DM.nan(1))
    return used, Gyro(ca.if_else(has_gyro, gyro, before.last), product, square, is_opposite)


def are_accepted(gyro, omega):
    """Whether each measurement of a recorded gyro is used, (n,).

    Args:
        gyro: (n,) measurements [rad/s], NaN where there is none.
        omega: (n,) yaw rates of the tracks [rad/s], without NaN.
    """
    z = ca.SX.sym("z", 2)
    memory = ca.SX.sym("memory", len(Gyro._fields))
    used, after = checked(z[0], z[1], Gyro(*ca.vertsplit(memory)))
    step = ca.Function("gyro_check", [memory, z], [ca.vertcat(*after), used])
    first = [np.nan, 0.0, 0.0, 0.0]
    _, result = step.mapaccum(len(gyro))(first, np.stack([gyro, omega]))
    return np.isfinite(np.array(result).ravel())
