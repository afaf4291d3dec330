"""Types that Scenario, terrain, RHE and RHC share; Scenario says what each option means."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from rhec.core._casadi.validation import NotNegative, Positive, Real
from rhec.tracked_robot.sensors import SENSORS, in_order

ProcessNoise = Literal["printed", "consistent", "prediction", "tracking", "soft_soil"]
SpeedModel = Literal["parameter", "input", "slipping"]
# Standard deviations of (x, y, ν, ω), constants of `tuning.SLIP`, weights of (x, y, θ), and μ or κ.
SigmaV = tuple[Positive, Positive, Positive, Positive]
Slip = tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative]
# Sensors besides GNSS and encoders, the noise of a gyro: constant [rad/s], and as a share of ω.
Sensors = Annotated[tuple[Literal[tuple(SENSORS)], ...], AfterValidator(in_order)]
SigmaGyro = tuple[Positive, NotNegative]
Weights = tuple[NotNegative, NotNegative, NotNegative]
Traction = Annotated[Real, Field(gt=0, le=1)]
