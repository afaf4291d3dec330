"""The sensors that a robot may have besides GNSS and encoders, each one record. Not in the paper.

A record holds all that there is to know of a sensor: what it measures, how large its noise is
taken to be, how it is simulated, and how its columns are called. The Model of the robot, the blocks
of the closed loop, the columns of logs, the channels of faults, the explorer's sliders, the
calibration of recorded logs and the exported C take their lists from SENSORS. To add a sensor, add
a record to SENSORS and its parameters, `sigma` and those of `settings`, to Scenario.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from rhec.core._casadi.build import casadi_function
from rhec.tracked_robot.kinematics import OUTPUTS

_ONE = (1, 1)
# What a sensor may measure that others ask for.
YAW = "theta_rad"
YAW_RATE = "yaw_rate_radps"


class Unknown(NamedTuple):
    """A parameter of a sensor that the estimator estimates."""

    name: str  # among the parameters of the Model
    label: str
    unit: str
    bounds: tuple[float, float]
    guess: float
    sigma: float  # standard deviation of the guess
    hat: str  # column of its estimate
    walk: float = 0.0  # its random walk [its unit/√s]

    @property
    def sigma_column(self):
        """The column of its standard deviation."""
        return f"sigma_{self.name}"


class Noise(NamedTuple):
    """A standard deviation of a sensor's noise that the estimator assumes."""

    unit: str
    default: float
    label: str = ""  # behind "noise of the …"


class Setting(NamedTuple):
    """A parameter of Scenario that says how a simulated sensor measures, and its slider."""

    parameter: str
    label: str
    high: float
    low: float | None = None


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """A sensor besides GNSS and encoders.

    Attributes:
        name: Its name in `Scenario.sensors`, and the channel of its faults.
        output: Its output of the Model.
        limit: Largest plausible size of a measurement, in its unit.
        measures: YAW, YAW_RATE, or the name of anything else that it measures. A measured yaw is
            known up to full turns.
        h: (values, slopes) -> what the Model says that it measures. Both are expressions by name:
            of states, inputs and parameters, and of the derivatives of the states.
        unknowns: Parameters of it that are estimated.
        error: Its error in proportion to the yaw rate of the tracks, as an input of those Models
            whose noise grows with the motion; None if there is none.
        sigma: The parameter of Scenario with its noise, if that is not the default: a number, or a
            tuple for more than one entry of `noise`.
        noise: Standard deviations of its noise: the constant part, and where it has an `error` the
            share of the yaw rate.
        measure: (dt_s, n_z) -> Function of the simulated sensor, which appends its measurement to
            the n_z entries of z. It may take signals of the loop, such as the true `pose` (3), its
            `noise` (standard normal), what it remembers, and `settings`.
        settings: {input of that Function: Setting}.
        remembers: {what that Function returns for the next sample: (pose) -> its first value}.
        stream: Number of the random stream of its noise; 1, 2 and 4 belong to plant and faults.
        column: Of its measurements in a run's log.
        recorded_column: Of its measurements in a recorded log.
        is_mean: Whether it measures a mean over a sample.
        accepts: (measurements, yaw rates of the tracks), both Series (n,) -> which of them a replay
            uses; None for all.
    """

    name: str
    output: str
    limit: float
    measures: str
    h: Callable[[Mapping, Mapping], Any]
    unknowns: tuple[Unknown, ...] = ()
    error: str | None = None
    sigma: str
    noise: tuple[Noise, ...]
    measure: Callable[[float, int], ca.Function]
    settings: Mapping[str, Setting]
    remembers: Mapping[str, Callable] = field(default_factory=dict)
    stream: int
    column: str
    recorded_column: str
    is_mean: bool = False
    accepts: Callable | None = None

    def sigma_of(self, scenario):
        """The standard deviations of its `noise` that an estimator assumes.

        They are those of a Scenario, or of what has its parameters; else the default ones.
        """
        given = getattr(scenario, self.sigma, None)
        if given is None:
            return tuple(entry.default for entry in self.noise)
        return given if len(self.noise) > 1 else (given,)


# The simulated sensors


def measured_yaw_rate(dt_s, n_z):
    """A gyro as a Function that appends its measurement to the n_z entries of z.

    It measures s (θ_k - θ_{k-1})/Δt + β + σ w, the mean yaw rate over ground since the last sample,
    with the scale s and the bias β. In the first sample θ_{k-1} = θ_k.

    Args:
        dt_s: Length of a sample Δt [s].
        n_z: Entries of z before it.
    """

    @casadi_function(
        "gyro",
        z=(n_z, 1),
        pose=(3, 1),
        last_yaw=_ONE,
        bias=_ONE,
        sigma=_ONE,
        scale=_ONE,
        noise=_ONE,
    )
    def gyro(z, pose, last_yaw, bias, sigma, scale, noise):
        yaw = pose[2]
        rate = (yaw - last_yaw) / dt_s
        error = bias + sigma * noise
        return dict(z=ca.vertcat(z, scale * rate + error), last_yaw=yaw)

    return gyro


def measured_yaw(dt_s, n_z):
    """A heading, as of two antennas, as a Function that appends θ_k + σ w to the n_z entries of z.

    `within_a_turn` takes its turns off.
    """

    @casadi_function("heading", z=(n_z, 1), pose=(3, 1), sigma=_ONE, noise=_ONE)
    def heading(z, pose, sigma, noise):
        return dict(z=ca.vertcat(z, pose[2] + sigma * noise))

    return heading


def within_a_turn(n_z, rows):
    """The measurement z (n_z,) with its yaws, which are at these rows, between -π and π.

    Faults come before: a late measurement lies between two others, not across a full turn.
    """

    @casadi_function("within_a_turn", z=(n_z, 1))
    def within_a_turn(z):
        entries = ca.vertsplit(z)
        for row in rows:
            turns = ca.floor(entries[row] / (2 * np.pi) + 0.5)
            entries[row] -= 2 * np.pi * turns
        return dict(z=ca.vertcat(*entries))

    return within_a_turn


# Which samples of a recorded gyro a replay leaves out: absurd ones, far beyond the yaw rate of the
# tracks, which are the gyro's fault and not the soil's; and the last one again, but for rounding,
# of a gyro that is stuck or dead, since a gyro has noise.
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


# The records

_BIAS = "gyro_bias_radps"
_SCALE = "gyro_scale"
_ERROR = "gyro_error_radps"
# It measures s θ̇ + β + e, with a scale s, a bias β, and an error e in proportion to the yaw rate
# of the tracks, which only those Models have whose noise grows with the motion.
GYRO = Sensor(
    name="gyro",
    output="gyro_radps",
    limit=100.0,
    measures=YAW_RATE,
    h=lambda of, slope: of[_SCALE] * slope[YAW] + of[_BIAS] + of.get(_ERROR, 0),
    unknowns=(
        Unknown(
            name=_BIAS,
            label="gyro bias",
            unit="rad/s",
            bounds=(-0.2, 0.2),
            guess=0.0,
            sigma=0.05,
            hat="gyro_bias_hat_radps",
            walk=2e-4,
        ),
        Unknown(
            name=_SCALE,
            label="gyro scale",
            unit="-",
            bounds=(0.8, 1.25),
            guess=1.0,
            sigma=0.03,
            hat="gyro_scale_hat",
        ),
    ),
    error=_ERROR,  # of its axis and its timing
    sigma="sigma_gyro",
    noise=(Noise(unit="rad/s", default=0.02), Noise(unit="-", default=0.05, label=", share of ω")),
    measure=measured_yaw_rate,
    settings=dict(
        sigma=Setting("gyro_sigma_radps", "gyro noise", 0.2),
        bias=Setting("gyro_bias_radps", "gyro bias", 0.2),
        scale=Setting("gyro_scale", "gyro scale", 1.2, 0.8),
    ),
    remembers=dict(last_yaw=lambda pose: pose[2]),
    stream=5,
    column="gyro_meas_radps",
    recorded_column="gyro_radps",
    is_mean=True,
    accepts=are_accepted,
)
# As of two GNSS antennas.
HEADING = Sensor(
    name="heading",
    output="heading_rad",
    limit=1e8,
    measures=YAW,
    h=lambda of, slope: of[YAW],
    sigma="sigma_heading",
    noise=(Noise("rad", 0.03),),
    measure=measured_yaw,
    settings=dict(sigma=Setting("heading_sigma_rad", "heading noise", 0.2)),
    stream=6,
    column="heading_meas_rad",
    recorded_column="heading_rad",
)
# {name: Sensor}, in the order in which their measurements follow (x, y, ν, ω).
SENSORS = {sensor.name: sensor for sensor in (GYRO, HEADING)}
# What is known of their unknowns before the first sample, by name.
UNKNOWNS = tuple(unknown for sensor in SENSORS.values() for unknown in sensor.unknowns)
GUESS = {unknown.name: unknown.guess for unknown in UNKNOWNS}
SIGMA_GUESS = {unknown.name: unknown.sigma for unknown in UNKNOWNS}


def in_order(sensors):
    """These names of sensors in the order of SENSORS, which is that of their measurements.

    Raises:
        ValueError: If a sensor is named twice: a robot has one of each.
    """
    if len(set(sensors)) < len(sensors):
        raise ValueError("it should name each sensor once")
    return tuple(name for name in SENSORS if name in sensors)


def records(sensors):
    """The records of these names of sensors."""
    return tuple(SENSORS[name] for name in sensors)


def sigma_of_sensors(scenario):
    """Standard deviations of the measurements of a Scenario's sensors, in their order in z."""
    return tuple(sensor.sigma_of(scenario)[0] for sensor in records(scenario.sensors))


def rows_of_yaws(sensors):
    """The rows of z at which these sensors measure the yaw; those of OUTPUTS come first."""
    measured = enumerate(records(sensors), len(OUTPUTS))
    return tuple(row for row, sensor in measured if sensor.measures == YAW)
