"""Side slip that lasts, as on ice: whether a log shows it, and what it leaves unknown of the yaw.

The course of a robot is the sum of its yaw and its slip angle β. Positions show the course alone,
and encoders and gyro show how the yaw changes, but not the yaw. Slip that lasts longer than an
estimator's memory is therefore taken for yaw. A log tells two things nevertheless:

- *Whether there is such slip.* With a noise of β in the model the innovations are then likelier:
  their deviance falls in most parts of the log, and not only where a sensor has failed.
- *How large it is*, by the structure function of δ, the course minus the yaw by encoders or gyro.
  Slip with the standard deviation σ and the time constant τ (Gauss-Markov) has

      D(T) = E[(δ(t + T) - δ(t))²] = 2σ² (1 - e^{-T/τ}) + noise,

  so that the largest √(D/2) is about σ. A drift of the yaw between both times adds to it.

The yaw is then not known better than β, unless a heading measures it.
"""

import dataclasses

import numpy as np

from rhec import paper
from rhec.simulation.columns import MEASUREMENTS
from rhec.tracked_robot import tuning

CANDIDATES = (0.05, 0.1, 0.2)  # of the constant lasting_slip [rad√s]
# Fall of the deviance per sample, in the median of windows, above which there is lasting slip. On
# simulated ice with 0.3 rad it is 1 to 6; on four recorded robots it is below 0.
LEAST_GAIN = 0.3
_WINDOW_S = 20.0
_LEAST_WINDOWS = 4  # fewer tell no fault of a sensor from slip
LARGEST_RAD = 1.0  # a larger angle is not slip: positions or encoders are at fault
_AFTER_S = (1.0, 2.0, 4.0, 8.0, 16.0)  # T of the structure function
_HALF_CHORD = 2  # samples; a chord of the path has the course of the sample in its middle
_LEAST_CHORD_M = 0.3
_LEAST_CHORD_NOISES = 8.0  # shorter chords have no course
_LEAST_DIFFERENCES = 50
_MOVING_MPS = 0.05


def is_asked(scenario):
    """Whether the log is asked for lasting slip: where nobody has told it, of the RHE alone."""
    is_told = scenario.slip is not None and len(scenario.slip) > len(tuning.SLIP)
    is_rhe = isinstance(scenario.estimator, str) and scenario.estimator == "rhe"
    return is_rhe and scenario.speed_model == "slipping" and not is_told


def likeliest(samples, scenario, estimate):
    """The Scenario with the lasting slip that makes the innovations likeliest.

    Args:
        samples: DataFrame of a replay's samples without lasting slip.
        scenario: Their Scenario.
        estimate: Function Scenario -> samples of a replay.

    Returns:
        The Scenario, or None if the log shows no lasting slip.
    """
    constants = scenario.slip or tuple(tuning.SLIP.values())
    best = None
    least_gain = LEAST_GAIN
    for lasting in CANDIDATES:
        candidate = dataclasses.replace(scenario, slip=(*constants, lasting))
        gain = _gain(samples, estimate(candidate))
        if not gain > least_gain:
            break
        best = candidate
        least_gain = gain
    return best


def _gain(samples, others):
    """Fall of the deviance per sample from `samples` to `others`, the median of windows.

    It is 0 where there are too few windows.
    """
    fall = samples["deviance"] - others["deviance"]
    windows = fall.groupby([samples["segment"], samples["t_s"] // _WINDOW_S]).mean()
    return windows.median() if len(windows) >= _LEAST_WINDOWS else 0.0


def slip_angle_rad(samples, sigma_m):
    """Standard deviation σ of the slip angle [rad] by the structure function, 0 if not known.

    Args:
        samples: DataFrame of a replay's samples.
        sigma_m: Standard deviation of the positions' noise [m].
    """
    parts = [part for _, part in samples.groupby("segment")]
    angles = [_course_less_yaw(part, sigma_m) for part in parts]
    return max(_half_structure(angles, round(after_s / paper.DT_S)) for after_s in _AFTER_S) ** 0.5


def _half_structure(angles, n):
    """D/2 less the noise [rad²] after n samples, 0 where too few courses are known.

    angles: for each segment δ (n,) [rad], and the variance of its noise (n,).
    """
    squares = []
    for delta, noise in angles:
        change = (delta[n:] - delta[:-n] + np.pi) % (2 * np.pi) - np.pi
        squares.append(change**2 / 2 - (noise[n:] + noise[:-n]) / 2)
    squares = np.concatenate(squares)
    squares = squares[np.isfinite(squares)]
    return max(squares.mean(), 0.0) if len(squares) >= _LEAST_DIFFERENCES else 0.0


def _course_less_yaw(part, sigma_m):
    """δ [rad] at each sample of a segment and the variance of its noise, NaN without a course."""
    n = len(part)
    delta = np.full(n, np.nan)
    noise = np.full(n, np.nan)
    length = 2 * _HALF_CHORD
    if n <= length:
        return delta, noise
    positions = part[MEASUREMENTS[:2]].to_numpy()
    chord = positions[length:] - positions[:-length]
    chord_m = np.hypot(*chord.T)
    speeds = np.lib.stride_tricks.sliding_window_view(part[MEASUREMENTS[2]], length + 1)
    ahead = speeds.min(axis=1) > _MOVING_MPS
    back = speeds.max(axis=1) < -_MOVING_MPS
    is_long = chord_m > max(_LEAST_CHORD_M, _LEAST_CHORD_NOISES * sigma_m)
    course = np.arctan2(chord[:, 1], chord[:, 0]) + np.where(back, np.pi, 0.0)
    course[~(is_long & (ahead | back))] = np.nan
    delta[_HALF_CHORD:-_HALF_CHORD] = course
    noise[_HALF_CHORD:-_HALF_CHORD] = 2 * (sigma_m / np.maximum(chord_m, _LEAST_CHORD_M)) ** 2
    return delta - paper.DT_S * np.nancumsum(_yaw_rate(part)), noise


def _yaw_rate(part):
    """Yaw rate over ground [rad/s] by the gyro, or by the encoders without one."""
    by_encoders = part["kappa_hat"] * part[MEASUREMENTS[3]]
    if "gyro_bias_hat_radps" not in part:
        return by_encoders
    by_gyro = (part["gyro_meas_radps"] - part["gyro_bias_hat_radps"]) / part["gyro_scale_hat"]
    return by_gyro.fillna(by_encoders)


def remark(sigma_rad):
    """The sentence about slip of this standard deviation [rad]."""
    return (
        f"The course wanders off the yaw by {sigma_rad:.2g} rad, as on ice or where positions "
        "wander: sigma_theta_rad contains this. A heading in the log would measure the yaw."
    )
