"""Types that Scenario, terrain, RHE and RHC share; Scenario says what each option means."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from rhec.core._casadi.validation import NotNegative, Positive, Real, shown

ProcessNoise = Literal["printed", "likelihood", "consistent", "tracking"]
SpeedModel = Literal["parameter", "input", "slipping"]


# Standard deviations of (x, y, ν, ω), constants of `tuning.SLIP`, weights of (x, y, θ), and μ or κ.
SigmaV = tuple[Positive, Positive, Positive, Positive]
Slip = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]
# Sensors besides GNSS and encoders, the noise of a gyro: constant [rad/s], and as a share of ω.
Sensors = tuple[Literal["gyro", "heading"], ...]
SigmaGyro = tuple[Positive, NotNegative]
Weights = tuple[NotNegative, NotNegative, NotNegative]
Traction = Annotated[Real, Field(gt=0, le=1)]


def numbers(name, value):
    """Return the value as an array of numbers, or say in one sentence why it is none."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{name} was {shown(value)}; it must be made of numbers") from None
