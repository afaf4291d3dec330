"""Calibration: noise, side slip and lever arm of a recorded robot, from its log.

`calibrate` maximises the likelihood of the log's positions. A Kalman filter of the slipping robot
predicts each position from earlier positions and from the encoders. Predictions over 0.6 to 2 s in
addition gave no better values for four robots, and worse values for one of them.

Positions more than `filtering.OUTLIER` standard deviations away count less (Huber's loss).

What else may be true of a log is a table of hypotheses, tried one after the other:

| hypothesis | what changes | it holds if |
|---|---|---|
| the positions are late | position_delay_s | the likeliest delay is above 0.1 s and 2 σ |
| their errors wander | positions 4 s apart count | the noise of these is 1.5 times as large |
| the defaults predict better | the defaults are kept | hidden positions are 1.05 times as near |
"""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.core.model.robot_model import Model
from rhec.logs import filtering, minimum
from rhec.logs.causes import tried
from rhec.logs.checks import refuse
from rhec.logs.filtering import Loss
from rhec.logs.judge import HIDDEN_S, hidden_errors
from rhec.logs.likelihood import Z_95, Calibration, Likelihood, Unknown, normal_report
from rhec.logs.model_calibration import calibrate_model
from rhec.logs.motion import LEAST_TURNED_RAD, turned_rad
from rhec.logs.path_checks import likeliest_delay
from rhec.logs.position_noise import declared_m
from rhec.logs.reader import read_if_path
from rhec.logs.recording import Recording, delayed, prepare, with_ages
from rhec.logs.replay import InitialGuess, estimate_samples, refuse_with_model, replay_scenario
from rhec.simulation.columns import ESTIMATE, MEASUREMENTS, measured_of
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import sensors, tuning
from rhec.tracked_robot.estimators import estimator_of
from rhec.tracked_robot.slipping import LEVER_ARM
from rhec.tracked_robot.speed_models import speed_model_of

# Huber's loss sees less of a normal distribution's tails, so that the deviation of positions comes
# out too small, by this factor r: E[min(u², OUTLIER u)] = 2 with u = w/r and w² of chi-squared
# distribution with 2 degrees of freedom. Only the report is corrected, because the factors below
# were chosen with it.
_HUBER_SHRINKS = 0.8459
# A filter assumes independent errors. Errors of recorded positions are correlated, which a replay
# compensates by a standard deviation that is larger by this factor. So are slip and the errors of a
# gyro, which count where a gyro or a heading makes the yaw that accurate. There all standard
# deviations are larger by it, so that the gains remain those of the maximum of the likelihood.
_CORRELATED = 1.75
# First guess and standard deviations before the first sample, by name. What is not named is 0, and
# a last input, which is unknown.
_FIRST = dict(mu=1.0, kappa=1.0) | sensors.GUESS
_SIGMA_FIRST = dict(x_m=0.05, y_m=0.05, theta_rad=0.1, arm_forward_m=0.3, arm_left_m=0.3)
_SIGMA_FIRST |= dict(mu=0.25, kappa=0.25) | sensors.SIGMA_GUESS
_SIGMA_INPUT = 10.0
_SETTLED_M = 3.0  # positions count from this distance on, where the yaw has converged
_DETERMINED_ARM_M = 0.05  # largest standard deviation of a position of the antenna that is used
_LEAST_POSITIONS = 50
# Errors of positions that wander are taken for slip and noise of the encoders. Positions so far
# apart show the wander as noise; fewer than these do not determine the other noise. On four logs
# of robots and on simulated white noise (tests/logs/test_calibrate.py) the noise of positions apart
# is that of all, or of one robot, whose positions do wander, 8 times as large.
_APART_S = 4.0
_LEAST_APART = 40
_WANDERS = 1.5  # times the noise of all positions
_DELAYS_S = np.linspace(-0.6, 0.6, 13)  # of the positions, that are tried
_LATE_S = 0.1  # a smaller delay changes no fit, and is not made up for
_LOSS_OF_NOTHING = 1e6  # of a sample at which the filter diverged
# The arguments of `rhec.replay` that a calibration determines, besides the lever arm.
_OF_SENSORS = tuple(sensor.sigma for sensor in sensors.SENSORS.values())
_FIELDS = ("sigma_v", "sigma_w", "slip", *_OF_SENSORS)
# The arguments of a replay that say how a log is read, and where the antenna is.
LOG_ARGUMENTS = ("track_width_m", "position_delay_s", "trust_log", "lever_arm_m")
# Hidden positions compare a calibration with the defaults; fewer tell nothing.
_LEAST_OUTAGES = 6
_WORSE = 1.05
_LEAST_ERROR_M = 0.01  # smaller errors are those of the positions themselves
_ONE_SIDED = 1.645  # 95 % quantile of the normal distribution

_BROAD = np.log(3.0)
_NARROW = np.log(2.0)
_VERY_NARROW = np.log(1.3)  # a log hardly determines how μ and κ walk
# Smoothed or interpolated positions look more accurate than they are. Without a lower bound the
# filter would attribute their errors to slip.
_POSITION = Unknown("noise of the position", "m", 0.05, _BROAD, least=0.02)
_UNKNOWNS = (
    _POSITION,
    Unknown("noise of ν", "m/s", 0.03, _BROAD),
    Unknown("noise of ω", "rad/s", 0.012, _BROAD),
    Unknown("walk of μ", "1/√m", 0.004, _VERY_NARROW),
    Unknown("walk of κ", "1/√m", 0.007, _VERY_NARROW),
    Unknown("slip ahead, share of ν", "-", 0.1, _NARROW),
    Unknown("slip in turning, share of ω", "-", 0.06, _NARROW),
    Unknown("slip sideways, share of bω", "-", 0.06, _NARROW),
    Unknown("bumps", "rad/√m", 0.02, _NARROW),
    Unknown("side slip", "s", 0.05, 0.05, is_scale=False),
)


@checked
def calibrate(
    log: Any,
    *,
    model: Model | None = None,
    track_width_m: Positive | None = None,
    position_delay_s: Real = 0.0,
    delays_s: dict[str, Real] | None = None,
    trust_log: Flag = False,
    **arguments: Any,
) -> Calibration:
    """Estimate noise, side slip and lever arm of a recorded robot from its log, without truth.

    `rhec.replay(log, **rhec.calibrate(log))` replays a log with its calibration. The report lists
    the noise of positions and encoders, the random walks of μ and κ, the shares of slip, bumps,
    side slip, and the position of the antenna relative to the centre of turning. A log does not
    distinguish a longer lever arm from another centre of turning.

    Args:
        log: The path of a file, or DataFrame of a recording, as `rhec.replay` takes it. Its truth
            is not used.
        model: A rhec.Model, whose noise is calibrated instead (`rhec.logs.model_calibration`).
        track_width_m: Distance of the tracks [m], as in `rhec.replay`.
        position_delay_s: Delay of the time stamps of the positions relative to the encoders [s].
        delays_s: With a model, {output: delay of its time stamps [s]}.
        trust_log: Whether to skip the plausibility checks, as in `rhec.replay`.
        **arguments: With a model, those of `rhec.replay`: dt, sigma_v, sigma_w, guess, sigma_guess,
            horizon, arrival_mean. Each sigma_v and sigma_w is the middle of its prior, by a
            factor of 3; where it is 0 it remains 0.

    Returns:
        Calibration, a dict of arguments of `rhec.replay` with a `report`. It has those of
        the arguments above that differ from their defaults. With a model it has all of them, with
        the calibrated sigma_v and sigma_w, and the report also lists the model's parameters.

    Raises:
        ValueError: If `rhec.replay` refuses the log, or if no segment has 50 positions over a
            distance of 6 m.

    Warns:
        UserWarning: If the positions are late.
    """
    log = read_if_path(log)
    of_robot = dict(
        track_width_m=track_width_m,
        position_delay_s=position_delay_s or None,
        trust_log=trust_log or None,
    )
    if model is not None:
        refuse_with_model(**of_robot)
        return calibrate_model(log, model, delays_s, arguments)
    if delays_s or arguments:
        name = next(iter(arguments), "delays_s")
        raise ValueError(
            f"calibrate has no parameter {name!r} without a model; it takes {', '.join(of_robot)}"
        )
    recording = prepare(log, track_width_m)
    if not trust_log:
        refuse(delayed(recording, position_delay_s))
    result = calibrate_recorded(recording, position_delay_s)
    result.update({name: value for name, value in of_robot.items() if value and name not in result})
    return result


def calibrate_recorded(recording: Recording, position_delay_s: float = 0.0) -> Calibration:
    """The Calibration of a Recording, which has its position_delay_s if there is one.

    The noise is fitted to all positions. Then each of _HYPOTHESES is tried.

    Args:
        recording: The Recording, with positions at their time stamps.
        position_delay_s: Delay of the positions [s], where it is known.

    Raises:
        ValueError: For a log that does not determine a calibration.
    """
    recording = _usable(recording)
    _refuse_straight(recording)
    yaws = _first_yaws(delayed(recording, position_delay_s))
    log = _Log(recording, yaws, position_delay_s, declared_m(recording.rows))
    fit = _fitted(log, position_delay_s)
    log = log._replace(delay=_delay(log, fit))
    remarks = []
    for better, remark in tried(_HYPOTHESES, log, fit):
        fit = better
        remarks.append(remark)
    result = Calibration(_arguments(log, fit), _report(log, fit))
    result.remarks = remarks
    return result


# The likelihood of a log of the robot


class _Log(NamedTuple):
    """What is to be explained."""

    recording: Recording  # with positions at their time stamps
    yaws: list  # at the beginning of each segment [rad]
    known_delay_s: float  # of the positions, 0 where it is not known
    declared_m: float  # noise of the positions by their receiver, 0 where it declares none
    delay: tuple = (0.0, np.inf)  # the likeliest one, and its standard deviation [s]


class _Fit(NamedTuple):
    """The likeliest noise of a log."""

    delay_s: float  # of the positions
    likelihood: Likelihood
    x: np.ndarray
    is_used: bool = True  # or the defaults of `rhec.replay` are


def _fields(values, log):
    """The parameters of a Scenario with these values of the unknowns."""
    values = iter(values)
    position, speed, yaw_rate = itertools.islice(values, 3)
    # Widened, the noise of the positions is at least that which the receiver declares.
    position = max(position, log.declared_m / _CORRELATED)
    fields = dict(
        sigma_v=(position, position, speed, yaw_rate),
        sigma_w=tuple(itertools.islice(values, 2)),
        slip=tuple(itertools.islice(values, len(tuning.SLIP))),
    )
    for sensor in sensors.records(log.recording.sensors):
        found = tuple(itertools.islice(values, len(sensor.noise)))
        fields[sensor.sigma] = found if len(found) > 1 else found[0]
    return fields


def _likelihood(log, delay_s, every=1):
    """The Likelihood of a log.

    Args:
        log: The _Log.
        delay_s: Delay of the positions [s].
        every: Every how many samples a position counts.
    """
    recording = log.recording
    model = speed_model_of("slipping", recording.sensors).model
    sigma = np.array([_SIGMA_FIRST.get(name, _SIGMA_INPUT) for name in model.joint_names])
    measured = measured_of(recording.sensors)
    segments = [with_ages(part, measured) for part in delayed(recording, delay_s).samples()]
    firsts = []
    for z, yaw_rad in zip(segments, log.yaws):
        x_m, y_m = z[np.isfinite(z[:, :2]).all(axis=1)][0, :2]
        guess = _FIRST | dict(x_m=x_m, y_m=y_m, theta_rad=yaw_rad)
        firsts.append((np.array([guess.get(name, 0.0) for name in model.joint_names]), sigma))
        z[np.arange(len(z)) % every > 0, :2] = np.nan

    of_sensors = [
        Unknown(f"noise of the {sensor.name}{of.label}", of.unit, of.default, _BROAD)
        for sensor in sensors.records(recording.sensors)
        for of in sensor.noise
    ]

    def settings_of(values):
        scenario = Scenario(
            speed_model="slipping",
            track_width_m=recording.track_width_m,
            sensors=recording.sensors,
            **_fields(values, log),
        )
        return estimator_of("rhe").settings(scenario)

    return Likelihood(
        model=model,
        dt_s=paper.DT_S,
        loss=Loss.HUBER,
        unknowns=(*_UNKNOWNS, *of_sensors),
        settings_of=settings_of,
        segments=segments,
        firsts=firsts,
        counts=[paper.DT_S * np.nancumsum(np.abs(z[:, 2])) > _SETTLED_M for z in segments],
    )


def _first_yaws(recording):
    """The yaw at the beginning of each segment, by a smoothed replay with the defaults [rad]."""
    samples = estimate_samples(recording, replay_scenario("rhe", recording, {}), smooth=True)
    return samples.groupby("segment")[ESTIMATE[2]].first().tolist()


def _fitted(log, delay_s):
    """The _Fit of a log; the arguments are those of `_likelihood`."""
    likelihood = _likelihood(log, delay_s)
    return _Fit(delay_s, likelihood, likelihood.most_likely())


# Hypotheses: functions of (_Log, _Fit) to the _Fit and a remark if they hold, else to None


def _delay(log, fit):
    """Delay of the positions [s] and its standard deviation, from the likelihood of the log.

    The filter estimates the lever arm beside it, because an antenna ahead of the centre turns
    earlier than the robot. A fit without the delay takes it for noise, which then hides it. So
    there is a second fit, with the delay by the path alone, and the likelier one counts.
    """
    by_path_s = likeliest_delay(log.recording)
    if abs(by_path_s - fit.delay_s) > _LATE_S:
        late = _fitted(log, by_path_s)
        if late.likelihood.objective(late.x) < fit.likelihood.objective(fit.x):
            fit = late
    delays_s = fit.delay_s + _DELAYS_S
    losses = [np.concatenate(_likelihood(log, each).losses(fit.x)) for each in delays_s]
    return minimum.least(delays_s, np.nan_to_num(losses, nan=_LOSS_OF_NOTHING))


def _late(log, fit):
    """Positions that come later than the motion by the encoders."""
    delay_s, sigma_s = log.delay
    if log.known_delay_s or delay_s <= max(_LATE_S, 2 * sigma_s):
        return None
    fit = _fitted(log, round(delay_s, 2))
    return fit, (
        f"The positions come {delay_s:.2f} ± {Z_95 * sigma_s:.2f} s after the encoder speeds: all "
        f"of this is with position_delay_s={fit.delay_s:g}."
    )


def _wandering(log, fit):
    """Errors that wander over seconds hardly show between successive positions.

    They show as noise of positions that are _APART_S apart. Both fits of a log without wander find
    the same noise. The likelihood cannot tell which fit is right: each is likelier over the times
    that it was made for.
    """
    likelihood = _likelihood(log, fit.delay_s, round(_APART_S / paper.DT_S))
    if sum(np.isfinite(z[:, 0]).sum() for z in likelihood.segments) < _LEAST_APART:
        return None
    apart = _Fit(fit.delay_s, likelihood, likelihood.most_likely())
    if _POSITION.at(apart.x[0]) <= _WANDERS * _POSITION.at(fit.x[0]):
        return None
    return apart, (
        f"The errors of the positions wander: the calibration uses positions {_APART_S:g} s apart."
    )


def _defaults_predict_better(log, fit):
    """Whether the geometric mean of the ratios of both errors is significantly above _WORSE."""
    recording = delayed(log.recording, fit.delay_s)

    def errors_m(arguments):
        fields = {name: arguments[name] for name in _FIELDS if name in arguments}
        scenario = replay_scenario("rhe", recording, fields)
        first = InitialGuess(tuple(log.yaws), lever_arm_m=arguments.get("lever_arm_m"))
        hidden = hidden_errors(recording, lambda shown: estimate_samples(shown, scenario, first))
        return hidden["error_m"].to_numpy()

    errors = errors_m(_arguments(log, fit)), errors_m({})
    ratios = np.subtract(*(np.log(each + _LEAST_ERROR_M) for each in errors))
    if len(ratios) < _LEAST_OUTAGES:
        return None
    deviation = ratios.std(ddof=1) / np.sqrt(len(ratios))
    if ratios.mean() - _ONE_SIDED * deviation <= np.log(_WORSE):
        return None
    return fit._replace(is_used=False), (
        f"The defaults are kept: after {HIDDEN_S:g} s without positions the errors of the "
        f"calibrated replay are {np.exp(ratios.mean()):.2f} times as large as those of the "
        f"default one (geometric mean of {len(ratios)})."
    )


_HYPOTHESES = (_late, _wandering, _defaults_predict_better)


# What is made of it


def _antenna(fit):
    """{name: (mean, standard deviation)} of the antenna's place at the end of the log [m]."""
    last = filtering.last_estimates(fit.likelihood.model, fit.likelihood.filtered(fit.x))
    return dict(zip(("antenna ahead", "antenna left"), (last[name] for name in LEVER_ARM)))


def _arguments(log, fit):
    """The arguments of `rhec.replay` by a _Fit."""
    arguments = dict(position_delay_s=fit.delay_s) if fit.delay_s else {}
    if not fit.is_used:
        return arguments
    arguments |= _widened(_fields(fit.likelihood.values(fit.x), log), bool(log.recording.sensors))
    places = _antenna(fit).values()
    if all(sigma < _DETERMINED_ARM_M for _, sigma in places):
        arguments["lever_arm_m"] = tuple(float(place) for place, _ in places)
    return arguments


def _report(log, fit):
    """The report of a Calibration by a _Fit."""
    report = fit.likelihood.report(fit.x)
    noise = report.loc[_POSITION.name, ["value", "low", "high"]].astype(float)
    if noise["value"] > _POSITION.least:
        noise /= _HUBER_SHRINKS
    else:
        # Nothing was measured but that it is not larger.
        noise["low"] = 0.0
        report.loc[_POSITION.name, "determined"] = False
    # Errors that wander for minutes do not show in the positions, but the receiver declares them.
    report.loc[_POSITION.name, noise.index] = noise.clip(lower=log.declared_m)
    others = [
        normal_report(name, "m", mean, sigma, sigma < _DETERMINED_ARM_M)
        for name, (mean, sigma) in _antenna(fit).items()
    ]
    others.append(normal_report("delay of the positions", "s", *log.delay, log.delay[1] < _LATE_S))
    return pd.concat([report, *others])


def _widened(fields, has_sensors):
    """The fields with larger standard deviations of errors that are correlated."""

    def wider(values):
        return tuple(_CORRELATED * value for value in values)

    if not has_sensors:
        return fields | dict(sigma_v=(*wider(fields["sigma_v"][:2]), *fields["sigma_v"][2:]))
    result = {
        name: wider(values) if isinstance(values, tuple) else _CORRELATED * values
        for name, values in fields.items()
    }
    # The last constant of the slip is that of a mean.
    result["slip"] = (*result["slip"][:-1], fields["slip"][-1])
    return result


def _refuse_straight(recording):
    """Raise a ValueError for a log without turns, which determines no κ."""
    turned = turned_rad(recording.rows)
    if turned < LEAST_TURNED_RAD:
        column = recording.columns[MEASUREMENTS[3]]
        raise ValueError(
            f"the log had turns of {turned:.2g} rad in all, by {column}; a calibration needs at "
            f"least {LEAST_TURNED_RAD:.2g} rad: drive two figures of eight"
        )


def _usable(recording):
    """The Recording with only those segments that have enough positions and motion."""

    def is_usable(part):
        positions = part[MEASUREMENTS[:2]].notna().all(axis=1).sum()
        driven_m = paper.DT_S * part[MEASUREMENTS[2]].abs().sum()
        return positions >= _LEAST_POSITIONS and driven_m > 2 * _SETTLED_M

    usable = [part["segment"].iloc[0] for part in recording.samples() if is_usable(part)]
    if not usable:
        raise ValueError(
            f"the log had no segment with {_LEAST_POSITIONS} positions over {2 * _SETTLED_M:g} m; "
            "a robot that hardly moves cannot be calibrated"
        )
    rows = recording.rows
    return recording.with_rows(rows[rows["segment"].isin(usable)])
