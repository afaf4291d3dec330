"""Calibration: noise, side slip and lever arm of a recorded robot, from its log.

`calibrate` maximises the likelihood of the log's positions. A Kalman filter of the slipping robot
predicts each position from earlier positions and from the encoders. Predictions over 0.6 to 2 s in
addition gave no better values for four robots, and worse values for one of them.

Positions more than `filtering.OUTLIER` standard deviations away count less (Huber's loss).
"""

import itertools
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from rhec import paper
from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.core.model.robot_model import Model
from rhec.logs import filtering, minimum, terms
from rhec.logs.checks import facts, refuse
from rhec.logs.filtering import Loss
from rhec.logs.judge import HIDDEN_S, hidden_errors
from rhec.logs.likelihood import Z_95, Calibration, Likelihood, Unknown, normal_report
from rhec.logs.model_calibration import calibrate_model
from rhec.logs.path_checks import likeliest_delay
from rhec.logs.position_noise import declared_m
from rhec.logs.reader import read_if_path
from rhec.logs.recording import Recording, delayed, prepare, travelled, with_ages
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
_LEAST_TURNED_RAD = 6.0  # by the encoders; a log that turns less does not determine κ
_TURNING_S = 4.0  # turns are summed over such windows, in which the encoders' noise cancels
# Errors of positions that wander are taken for slip and noise of the encoders. Positions so far
# apart show the wander as noise; fewer than these do not determine the other noise. On four logs
# of robots and on simulated white noise (tests/logs/test_calibrate.py) the noise of positions apart
# is that of all, or of one robot, whose positions do wander, 8 times as large.
_APART_S = 4.0
_LEAST_APART = 40
_WANDERS = 1.5  # times the noise of all positions
_DELAYS_S = np.linspace(-0.6, 0.6, 13)  # of the positions, that are tried
_SMALL_DELAY_S = 0.1  # a smaller one changes no fit
_LATE_S = 0.1  # a larger one is worth a remark
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
    about_arm_m = log.attrs.get("lever_arm_m", (0.0, 0.0))
    result = calibrate_recorded(recording, about_arm_m, position_delay_s)
    result.update({name: value for name, value in of_robot.items() if value and name not in result})
    return result


def calibrate_recorded(
    recording: Recording, about_arm_m: tuple[float, float], position_delay_s: float
) -> Calibration:
    """The Calibration of a Recording, which has its position_delay_s if there is one.

    Args:
        recording: The Recording, with positions at their time stamps.
        about_arm_m: First guess of the antenna, ahead and left [m].
        position_delay_s: Delay of the positions [s]. Where they are clearly later than that, the
            log is calibrated again with the delay that was found.

    Raises:
        ValueError: For a log that does not determine a calibration.
    """
    robot = _Robot(
        width_m=recording.track_width_m,
        sensors=recording.sensors,
        about_arm_m=about_arm_m,
        least_m=declared_m(recording.rows) / _CORRELATED,  # widened, it is the declared one
    )
    at_stamps = _usable(recording)
    recording = delayed(at_stamps, position_delay_s)
    _refuse_straight(recording)
    fit, wanders = _search(recording, robot)
    delay_s, sigma_s = _delay(at_stamps, position_delay_s, fit, robot)
    later_s = delay_s - position_delay_s
    is_sure = abs(later_s) > max(_LATE_S, 2 * sigma_s)
    if is_sure and later_s > 0 and not position_delay_s:
        found_s = round(delay_s, 2)
        result = calibrate_recorded(at_stamps, about_arm_m, found_s)
        result.remarks.insert(
            0,
            f"The positions come {delay_s:.2f} ± {Z_95 * sigma_s:.2f} s after the encoder speeds: "
            f"all of this is with position_delay_s={found_s:g}.",
        )
        return result
    result = _calibration(fit, robot)
    if position_delay_s:
        result["position_delay_s"] = position_delay_s
    samples = _replayed(recording, result, fit.yaws, smooth=True)
    result.terms = _terms(result, recording, samples, (delay_s, sigma_s))
    rate_hz = facts(recording)["encoders_hz"]
    result.yaml = terms.as_yaml(result.terms, robot.width_m, terms.noise(samples), rate_hz)
    result.remarks = _remarks(result, wanders)
    if is_sure and later_s < 0:
        result.remarks.append(
            f"The encoder speeds seem to come {-later_s:.2f} ± {Z_95 * sigma_s:.2f} s after the "
            "positions: either they are late, or the robot was steered by its positions, so that "
            "its speeds answer them. Nothing is to be done."
        )
    _keep_better(result, recording, fit.yaws)
    return result


# The likelihood of a log of the robot


class _Robot(NamedTuple):
    """What is known of a robot beforehand."""

    width_m: float  # track width
    sensors: tuple  # names of its sensors besides GNSS and encoders
    about_arm_m: tuple = (0.0, 0.0)  # first guess of the antenna, ahead and left [m]
    least_m: float = 0.0  # smallest noise of the positions that the receiver leaves possible [m]


class _Fit(NamedTuple):
    """The likeliest noise of a log, and the initial yaws of its segments."""

    likelihood: Likelihood
    x: np.ndarray
    yaws: list


def _fields(values, robot):
    """The parameters of a Scenario with these values of the unknowns."""
    values = iter(values)
    position, speed, yaw_rate = itertools.islice(values, 3)
    position = max(position, robot.least_m)
    fields = dict(
        sigma_v=(position, position, speed, yaw_rate),
        sigma_w=tuple(itertools.islice(values, 2)),
        slip=tuple(itertools.islice(values, len(tuning.SLIP))),
    )
    for sensor in sensors.records(robot.sensors):
        found = tuple(itertools.islice(values, len(sensor.noise)))
        fields[sensor.sigma] = found if len(found) > 1 else found[0]
    return fields


def _unknowns_of_sensors(names):
    """The Unknowns of the noise of these sensors."""
    return [
        Unknown(f"noise of the {sensor.name}{of.label}", of.unit, of.default, _BROAD)
        for sensor in sensors.records(names)
        for of in sensor.noise
    ]


def _likelihood(segments, yaws, robot):
    """The Likelihood of segments that begin with these yaws."""
    model = speed_model_of("slipping", robot.sensors).model
    sigma = np.array([_SIGMA_FIRST.get(name, _SIGMA_INPUT) for name in model.joint_names])
    firsts = []
    for z, yaw_rad in zip(segments, yaws):
        x_m, y_m = z[np.isfinite(z[:, :2]).all(axis=1)][0, :2]
        guess = _FIRST | dict(x_m=x_m, y_m=y_m, theta_rad=yaw_rad)
        guess |= dict(zip(LEVER_ARM, robot.about_arm_m))
        firsts.append((np.array([guess.get(name, 0.0) for name in model.joint_names]), sigma))

    def settings_of(values):
        scenario = Scenario(
            speed_model="slipping",
            track_width_m=robot.width_m,
            sensors=robot.sensors,
            **_fields(values, robot),
        )
        return estimator_of("rhe").settings(scenario)

    return Likelihood(
        model=model,
        dt_s=paper.DT_S,
        loss=Loss.HUBER,
        unknowns=(*_UNKNOWNS, *_unknowns_of_sensors(robot.sensors)),
        settings_of=settings_of,
        segments=segments,
        firsts=firsts,
        counts=[paper.DT_S * np.nancumsum(np.abs(z[:, 2])) > _SETTLED_M for z in segments],
    )


def _first_yaws(recording, robot):
    """The yaw at the beginning of each segment, by a smoothed replay with the defaults [rad]."""
    about = InitialGuess(about_arm_m=robot.about_arm_m)
    samples = estimate_samples(recording, replay_scenario("rhe", recording, {}), about, smooth=True)
    return samples.groupby("segment")[ESTIMATE[2]].first().tolist()


def _fitted(segments, yaws, robot):
    """The _Fit of segments that begin with these yaws."""
    likelihood = _likelihood(segments, yaws, robot)
    return _Fit(likelihood, likelihood.most_likely(), yaws)


def _search(recording, robot):
    """The _Fit of all positions or, where their errors wander, of some; and whether they wander.

    Errors that wander over seconds hardly show between successive positions, but as noise of
    positions that are _APART_S apart. Both fits of a log without wander find the same noise. The
    likelihood cannot tell which fit is right: each is likelier over the times that it was made for.
    """
    yaws = _first_yaws(recording, robot)
    segments = _streams(recording)
    fit = _fitted(segments, yaws, robot)
    every = round(_APART_S / paper.DT_S)
    some = [z.copy() for z in segments]
    for z in some:
        z[np.arange(len(z)) % every > 0, :2] = np.nan
    if sum(np.isfinite(z[:, 0]).sum() for z in some) < _LEAST_APART:
        return fit, False
    of_some = _fitted(some, yaws, robot)
    noise_m, noise_of_some_m = (_POSITION.at(each.x[0]) for each in (fit, of_some))
    wanders = noise_of_some_m > _WANDERS * noise_m
    return (of_some if wanders else fit), wanders


def _delay(at_stamps, about_s, fit, robot):
    """Delay of the positions [s] and its standard deviation, from the likelihood of the log.

    The filter estimates the lever arm beside it, because an antenna ahead of the centre turns
    earlier than the robot. A fit without the delay takes it for noise, which then hides it. So
    there is a second fit, with the delay by the path alone, and the likelier one counts.
    """

    def streams(delay_s):
        return _streams(delayed(at_stamps, delay_s))

    by_path_s = likeliest_delay(at_stamps)
    if abs(by_path_s - about_s) > _SMALL_DELAY_S:
        late = _fitted(streams(by_path_s), fit.yaws, robot)
        in_time = _likelihood(streams(about_s), fit.yaws, robot)
        if late.likelihood.objective(late.x) < in_time.objective(fit.x):
            about_s = by_path_s
            fit = late
    delays_s = about_s + _DELAYS_S
    losses = [
        np.concatenate(_likelihood(streams(delay_s), fit.yaws, robot).losses(fit.x))
        for delay_s in delays_s
    ]
    return minimum.least(delays_s, np.nan_to_num(losses, nan=_LOSS_OF_NOTHING))


# What is made of it


def _calibration(fit, robot):
    """The Calibration of a _Fit, with its report."""
    report = fit.likelihood.report(fit.x)
    position = _POSITION.name
    if report.loc[position, "value"] > _POSITION.least:
        report.loc[position, ["value", "low", "high"]] /= _HUBER_SHRINKS
    else:
        # Nothing was measured but that it is not larger.
        report.loc[position, ["low", "determined"]] = 0.0, False
    last = filtering.last_estimates(fit.likelihood.model, fit.likelihood.filtered(fit.x))
    arm = [last[name] for name in LEVER_ARM]
    is_known = [sigma < _DETERMINED_ARM_M for _, sigma in arm]
    antenna = [
        normal_report(name, "m", *place, is_determined)
        for name, place, is_determined in zip(("antenna ahead", "antenna left"), arm, is_known)
    ]
    fields = _fields(fit.likelihood.values(fit.x), robot)
    result = Calibration(_widened(fields, bool(robot.sensors)), pd.concat([report, *antenna]))
    if all(is_known):
        result["lever_arm_m"] = tuple(float(place) for place, _ in arm)
    return result


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
    turned = travelled(recording.rows, MEASUREMENTS[3], _TURNING_S)
    if turned < _LEAST_TURNED_RAD:
        column = recording.columns[MEASUREMENTS[3]]
        raise ValueError(
            f"the log had turns of {turned:.2g} rad in all, by {column}; a calibration needs at "
            f"least {_LEAST_TURNED_RAD:.2g} rad: drive two figures of eight"
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
    return recording._replace(rows=rows[rows["segment"].isin(usable)].reset_index(drop=True))


def _streams(recording):
    """Measurements and their ages of each segment, as of `with_ages`."""
    return [with_ages(part, measured_of(recording.sensors)) for part in recording.samples()]


def _replayed(recording, arguments, yaws, smooth=False):
    """Samples of a replay of a Recording with arguments of `rhec.replay`."""
    fields = {name: arguments[name] for name in _FIELDS if name in arguments}
    scenario = replay_scenario("rhe", recording, fields)
    first = InitialGuess(tuple(yaws), lever_arm_m=arguments.get("lever_arm_m"))
    return estimate_samples(recording, scenario, first, smooth)


def _terms(result, recording, samples, delay):
    """The terms of a Calibration, from its smoothed samples."""
    # Errors that wander for minutes do not show in the positions, but the receiver declares them.
    noise = result.report.loc[_POSITION.name, ["value", "low", "high"]]
    noise = noise.astype(float).clip(lower=declared_m(recording.rows))
    found = {"GNSS noise": (*noise, "m"), "delay of the positions": terms.row(*delay, "s")}
    return terms.of_log(terms.slopes(samples), samples, recording.track_width_m, found)


def _remarks(result, wanders):
    """Sentences on how the positions were used, and how good they are."""
    remarks = []
    if wanders:
        remarks.append(
            f"The errors of the positions wander: the calibration uses positions {_APART_S:g} s "
            "apart."
        )
    if not result.report.loc[_POSITION.name, "low"]:
        remarks.append(
            f"The noise of the positions is at most {_POSITION.least} m, the least that is assumed."
        )
    return remarks


def _keep_better(result, recording, yaws):
    """Keep the defaults of `rhec.replay` where the calibrated values predict worse than they do.

    They do if the geometric mean of the ratios of both errors is significantly above _WORSE.
    """

    def errors_m(arguments):
        hidden = hidden_errors(recording, lambda shown: _replayed(shown, arguments, yaws))
        return hidden["error_m"].to_numpy()

    ratios = np.log((errors_m(result) + _LEAST_ERROR_M) / (errors_m({}) + _LEAST_ERROR_M))
    if len(ratios) < _LEAST_OUTAGES:
        return
    deviation = ratios.std(ddof=1) / np.sqrt(len(ratios))
    if ratios.mean() - _ONE_SIDED * deviation > np.log(_WORSE):
        for name in (*_FIELDS, "lever_arm_m"):
            result.pop(name, None)
        result.remarks.append(
            f"The defaults are kept: after {HIDDEN_S:g} s without positions the errors of the "
            f"calibrated replay are {np.exp(ratios.mean()):.2f} times as large as those of the "
            f"default one (geometric mean of {len(ratios)})."
        )
