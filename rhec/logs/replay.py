"""Replay: run an estimator on a recorded log.

The estimator's step is scanned over the samples of each segment. The encoder measurements of a
sample are means over the interval that ends there (`recording.resample`). A position measured
between two samples is moved to the second one by the motion predicted from the last estimate and
the encoders.

Each row of the log receives the estimate of the last sample before it, predicted to the time of the
row with the encoder measurements in between. By default the estimates are then smoothed, which
takes later measurements into account and gains more than any other choice. With `smooth=False` an
estimate is that of a robot on its way: later measurements do not change it, except by what the
whole log is asked for, the track width and the noise of the positions.
"""

import warnings
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper
from rhec.core import runner
from rhec.core._casadi import compiled
from rhec.core._casadi.build import casadi_function
from rhec.core._casadi.packing import pack_array
from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.core.estimator import ekf, rhe
from rhec.core.estimator.estimate import joint_guess
from rhec.core.model.limits import is_valid_measurement
from rhec.core.model.robot_model import Model, interval
from rhec.logs.checks import refuse
from rhec.logs.course import SIGMA_BY_COURSE, unknown_yaw, yaw_sigma_rad
from rhec.logs.position_noise import declared_m
from rhec.logs.reader import read_if_path
from rhec.logs.recording import POSITION_AGE, delayed, means_of, prepare, prepare_for, with_ages
from rhec.logs.smoother import smoothed
from rhec.simulation.columns import (
    ACCEPTED,
    ESTIMATE,
    FLAGS,
    GATE,
    HATS_OF_SENSORS,
    INNOVATION,
    LEVER_ARM,
    MEASUREMENTS,
    SENSORS,
    SIGMA,
    SIGMA_YAW_DRIFT,
    SIGMAS_OF_SENSORS,
    YAW_DRIFT_HAT,
    YAWS,
    measured_of,
)
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import sensors, slipping
from rhec.tracked_robot.estimators import NAMES, Choice, build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES, YAW_DRIFT
from rhec.tracked_robot.paper_rhe import sigma_start, window_of
from rhec.tracked_robot.speed_models import speed_model_of

ESTIMATOR_FIELDS = (
    "process_noise",
    "sigma_w",
    "sigma_v",
    "estimation_horizon",
    "speed_model",
    "slip",
    "arrival_mean",
    "yaw_drift",
    "sensors",
    *(sensor.sigma for sensor in sensors.SENSORS.values()),
)
N_HEADINGS = 8  # directions that are tried where the initial yaw is unknown
CLEARLY = 1e-6  # share by which the innovations of a worse one are larger
# Standard deviations of the initial guess. They equal the paper's W, except for the yaw and the
# position of the antenna.
_SIGMA_FIRST = dict(
    zip((*QUANTITIES, *slipping.LEVER_ARM), (10.0, 10.0, 0.3, 1.0, 0.25, 0.25, 0.1, 0.1))
)
_SIGMA_ARM_M = 0.005  # standard deviation of a lever arm that the user passes
# The columns of an estimate of the paper's robot and of its standard deviation.
_HATS = dict(zip((*_SIGMA_FIRST, YAW_DRIFT), (*ESTIMATE, *LEVER_ARM, YAW_DRIFT_HAT)))
_HATS |= HATS_OF_SENSORS
_SIGMAS = dict(zip((*_SIGMA_FIRST, YAW_DRIFT), (*SIGMA, SIGMA_YAW_DRIFT)))
_SIGMAS |= SIGMAS_OF_SENSORS
# Rows of z of the paper's robot, by the flag that says whether they were used.
POSITION_AND_ENCODERS = ((0, 1), (2, 3))
# Columns of what a scan records besides estimates.
_COLUMNS = dict(
    deviance=["deviance"], kkt=["kkt_rhe"], ok=["ok"], accepted=GATE[:2], restart=GATE[2:]
)


class InitialGuess(NamedTuple):
    """Prior knowledge of a recorded robot before the first sample; None means unknown."""

    yaw_rad: tuple | None = None  # initial yaw of each segment [rad]
    sigma_yaw_rad: float = _SIGMA_FIRST["theta_rad"]  # its standard deviation [rad]
    lever_arm_m: tuple | None = None  # position of the antenna ahead and left of the centre [m]


_UNKNOWN = InitialGuess()


class Replay(NamedTuple):
    """An estimator that runs over a log, and the columns that it reads and fills."""

    model: Model  # predicts between samples, and moves late measurements
    dt_s: float  # length of a sample
    quantities: tuple  # names of the estimates, in order
    hats: list  # their columns
    sigmas: list  # the columns of their standard deviations
    measured: list  # the columns of z
    structure: tuple  # the further arguments of `build_scan`
    settings: dict  # {name: array} of the estimator's step

    @property
    def window(self):
        """The Window of an RHE."""
        return self.structure[-1]

    def scanned(self, memory, stream):
        """What the scan records at a segment's samples, as a DataFrame.

        Args:
            memory: (n,) of the estimator before the first sample, then a number for each quantity.
            stream: (samples, 2 n_z), as of `recording.with_ages`.
        """
        functions = compiled.load(build_scan, self.quantities, *self.structure)
        arrays = runner.record(functions, memory, stream, self.settings)
        columns = _COLUMNS | dict(estimate=self.hats, sigma=self.sigmas)
        names = [column for name in arrays for column in columns[name]]
        return pd.DataFrame(np.column_stack([*arrays.values()]), columns=names)

    def predict(self, estimate, z, tau_s):
        """Estimates and outputs of many rows after tau_s (n,), by `motion_of`, given z (n, n_z)."""
        motion = motion_of(self.model, self.quantities).map(len(estimate))
        return [np.array(result).T for result in motion(estimate.T, z.T, tau_s[None, :])]


# The estimator's step as a scan


def build_scan(names, gates, kind, *structure):
    """The scan of an estimator over a log.

    Its memory is that of the estimator followed by the last estimate, by which late measurements
    are moved; before the first sample there is none. A row of its stream is that of
    `recording.with_ages`.

    Args:
        names: Of what is recorded as the estimate, NaN where the estimator does not estimate it.
        gates: Pairs of rows of z. Of each is recorded whether both were used.
        kind: "rhe" of a Window; "ekf" of a Model and the length of a sample [s]; or "named", an
            estimator of the paper's robot, of the fields of a Choice.
        structure: What `kind` says.
    """
    step, model, dt_s, estimated, covered = _estimator(kind, *structure)
    motion = motion_of(model, names)
    n = step.numel_in(0)
    n_z = len(model.outputs)
    shapes = dict(memory=(n + len(names), 1), z_and_ages=(2 * n_z, 1))
    shapes |= {name: step.sparsity_in(name) for name in step.name_in()[2:]}

    @casadi_function("replay", ca.MX, **shapes)
    def replay_step(memory, z_and_ages, **settings):
        z, ages_s = ca.vertsplit(z_and_ages, n_z)
        z = moved_to_sample(motion, memory[n:], z, ages_s, model, dt_s)
        results = step.call([memory[:n], z, *settings.values()])
        outputs = dict(zip(["memory", "estimate", *step.name_out()[2:]], results))
        nan = ca.DM.nan(1)
        value = dict(zip(estimated, ca.vertsplit(outputs["estimate"])))
        variance = {name: outputs["covariance"][i, i] for i, name in enumerate(covered)}
        recorded = dict(
            estimate=ca.vertcat(*(value.get(name, nan) for name in names)),
            sigma=ca.vertcat(*(ca.sqrt(variance.get(name, nan)) for name in names)),
            deviance=outputs.get("deviance", nan),
            kkt=outputs.get("kkt", nan),
            ok=outputs.get("ok", ca.MX(1)),
        )
        if gates:
            # An estimator without flags uses all valid measurements, and never restarts.
            valid = [is_valid_measurement(z[row], limit) for row, limit in enumerate(model.limits)]
            accepted = outputs.get("accepted", ca.vertcat(*valid))
            recorded["accepted"] = ca.vertcat(*(accepted[i] * accepted[j] for i, j in gates))
            recorded["restart"] = outputs.get("restart", ca.MX(0))
        return dict(memory=ca.vertcat(outputs["memory"], recorded["estimate"])) | recorded

    return runner.build_recorded(replay_step, replay_step.name_out()[1:])


def _estimator(kind, *structure):
    """Step, Model, length of a sample, names of its estimate and of what its covariance covers.

    The arguments are those of `build_scan`.
    """
    if kind == "rhe":
        (window,) = structure
        step = rhe.build_phases(window)["step"]
        return step, window.model, window.dt_s, window.estimated, window.model.joint_names
    if kind == "ekf":
        model, dt_s = structure
        return ekf.build(model, dt_s)["step"], model, dt_s, model.names, model.joint_names
    choice = Choice(*structure)
    covered = estimator_of(choice.estimator).states(choice)
    return build_step(choice), _model_of(choice), choice.dt_s, QUANTITIES, covered


def moved_to_sample(motion, last, z, ages_s, model, dt_s):
    """The measurements z (n_z,), moved by what their outputs changed since they were made.

    Args:
        motion: The Function of `motion_of`.
        last: The last estimate.
        z: (n_z,) measurements.
        ages_s: (n_z,) their ages at the sample [s].
        model: The Model. Its measured inputs are means until the sample, and are not moved.
        dt_s: Length of a sample [s].
    """
    moved = ca.vertsplit(z)
    _, now = motion(last, z, dt_s)
    for row in set(range(len(moved))) - {*model.input_outputs.values()}:
        _, then = motion(last, z, dt_s - ages_s[row])
        moved[row] += ca.if_else(ages_s[row] > 0, now[row] - then[row], 0)
    return ca.vertcat(*moved)


def motion_of(model, names):
    """Function (estimate, z, tau_s) -> (estimate, outputs) that predicts a Model over tau_s [s].

    The inputs are those measured in z, or the estimated inputs where z has no measurement. What is
    not estimated of a sensor is as its guess.
    """
    estimate = ca.SX.sym("estimate", len(names))
    z = ca.SX.sym("z", len(model.outputs))
    tau_s = ca.SX.sym("tau_s")
    values = dict(zip(names, ca.vertsplit(estimate)))
    inputs = [values.get(name, 0) for name in model.inputs]
    for place, row in model.input_outputs.items():
        valid = is_valid_measurement(z[row], model.limits[row])
        inputs[place] = ca.if_else(valid, z[row], inputs[place])
    u = ca.vertcat(*inputs)
    joint = (*model.states, *model.parameters)
    known = sensors.GUESS | values
    s = ca.vertcat(*(known[name] for name in joint))
    s = interval(model, measured=False).step(s, u, tau_s)
    x, p = ca.vertsplit(s, [0, len(model.states), len(joint)])
    values |= {name: value for name, value in zip(joint, ca.vertsplit(s)) if name in values}
    results = [ca.vertcat(*values.values()), model.measurement(x, u, p)]
    return ca.Function("motion", [estimate, z, tau_s], results)


# A segment


def estimated(how, stream, first_memory, yaw_rad, sigma_yaw_rad, hindsight=False):
    """What a Replay records of a segment, and its innovations; NaN before the first position.

    With an unknown initial yaw several are tried. A row is taken from the direction with the
    smallest sum of squared innovations until then, so that no row depends on later measurements;
    or, in hindsight, from that with the smallest sum in the end.

    Args:
        how: The Replay. The first two measurements are the position.
        stream: (n, 2 n_z), as of `recording.with_ages`.
        first_memory: Function (first position (2,) [m], yaw [rad], its standard deviation [rad]) ->
            memory, as for `Replay.scanned`.
        yaw_rad: Guess of the initial yaw [rad], or None.
        sigma_yaw_rad: Its standard deviation [rad].
        hindsight: Whether all rows are those of one direction, as a smoother has to begin with.
    """
    has_position = np.isfinite(stream[:, :2]).all(axis=1)
    begin = np.argmax(has_position) if has_position.any() else len(stream)
    place = stream[begin, :2] if has_position.any() else np.zeros(2)

    def run_from(yaw_rad, sigma_yaw_rad):
        run = how.scanned(first_memory(place, yaw_rad, sigma_yaw_rad), stream)
        run.iloc[:begin] = np.nan
        return run

    if yaw_rad is not None:
        found = run_from(yaw_rad, sigma_yaw_rad)
    else:
        yaws = 2 * np.pi / N_HEADINGS * np.arange(N_HEADINGS)
        runs = [run_from(each, np.pi / N_HEADINGS) for each in yaws]
        squares = [np.square(_innovations(how, run, stream)) for run in runs]
        best = _best(np.nancumsum(np.nansum(squares, axis=2), axis=1))
        best = np.full(len(stream), best[-1]) if hindsight else best
        chosen = np.stack([run.to_numpy() for run in runs])[best, np.arange(len(stream))]
        found = pd.DataFrame(chosen, columns=runs[0].columns)
    innovations = pd.DataFrame(_innovations(how, found, stream), columns=INNOVATION)
    return pd.concat([innovations, found], axis=1)


def _best(sums):
    """Which of the sums (m, n) is the smallest at each sample (n,).

    One that was the smallest remains it until another is clearly smaller: while a robot stands, all
    directions are as good, and rounding would decide.
    """
    best = np.zeros(sums.shape[1], dtype=int)
    now = 0
    about_least = sums <= (1 + CLEARLY) * sums.min(axis=0)
    for k, first in enumerate(about_least.argmax(axis=0)):
        if not about_least[now, k]:
            now = int(first)
        best[k] = now
    return best


def _innovations(how, estimates, stream):
    """Measured minus predicted position at each sample (n, 2) [m]; the first is NaN.

    The prediction starts at the previous estimate and uses the encoder measurements until the time
    at which the position was measured.
    """
    found = np.full((len(stream), 2), np.nan)
    if len(stream) > 1:
        z, ages_s = np.hsplit(stream, 2)
        held = pd.DataFrame(z).ffill().to_numpy()[1:]
        before = estimates[how.hats].to_numpy()[:-1]
        _, predicted = how.predict(before, held, how.dt_s - ages_s[1:, 0])
        found[1:] = z[1:, :2] - predicted[:, :2]
    return found


# The paper's robot


def _model_of(choice):
    """The Model by which an estimator of the paper's robot is predicted."""
    if choice.estimator in NAMES:
        return window_of(choice).model
    return speed_model_of("input", choice.sensors).model


def replay_of(scenario):
    """The Replay of a scenario's estimator."""
    choice = Choice.of(scenario)
    model = _model_of(choice)
    is_rhe = choice.estimator == "rhe"
    unknowns = [name for name in sensors.GUESS if is_rhe and name in model.parameters]
    quantities = (*_SIGMA_FIRST, *unknowns, *(YAW_DRIFT,) * scenario.yaw_drift)
    structure = ("named", *choice)
    if is_rhe:
        known = (*QUANTITIES, *(name for name in quantities[6:] if name in model.joint_names))
        structure = ("rhe", window_of(choice)._replace(quantities=known))
    # The estimators of a replay do not receive the traction, except for the one that assumes 1.
    settings = estimator_of(choice.estimator).settings(scenario)
    return Replay(
        model=model,
        dt_s=paper.DT_S,
        quantities=quantities,
        hats=[_HATS[name] for name in quantities],
        sigmas=[_SIGMAS[name] for name in quantities],
        measured=measured_of(scenario.sensors),
        structure=(POSITION_AND_ENCODERS, *structure),
        settings=settings,
    )


def first_guess(first, nu, place, yaw_rad, sigma_yaw_rad):
    """A guess of all quantities before the first sample and its standard deviations, by name.

    Args:
        first: The InitialGuess.
        nu: Guess of the speed [m/s].
        place, yaw_rad, sigma_yaw_rad: As in `estimated`.
    """
    arm_m = first.lever_arm_m or (0.0, 0.0)
    guess = dict(zip(_SIGMA_FIRST, (*place, yaw_rad, nu, 1.0, 1.0, *arm_m)))
    guess |= sensors.GUESS | {YAW_DRIFT: 0.0}
    return guess, _sigma_first(first) | dict(theta_rad=sigma_yaw_rad)


def first_memory_of(how, scenario, *of_guess):
    """The memory of a scenario's scan before the first sample.

    Args:
        how: The Replay of the scenario.
        scenario: The Scenario of the estimator.
        *of_guess: The arguments of `first_guess`.
    """
    guess, sigma = first_guess(*of_guess)
    choice = Choice.of(scenario)
    memory = pack_array(estimator_of(choice.estimator).init(choice, guess, sigma))
    return np.append(memory, np.zeros(len(how.quantities)))


def _sigma_first(first):
    """Standard deviations of an InitialGuess, by the names of _SIGMA_FIRST."""
    is_given = first.lever_arm_m is not None
    return _SIGMA_FIRST | dict.fromkeys(slipping.LEVER_ARM if is_given else (), _SIGMA_ARM_M)


def _smooth(how, part, stream, first):
    """The samples of a segment with smoothed estimates of the joint state.

    Args:
        how: The Replay.
        part: DataFrame of the samples.
        stream: (n, 2 n_z) what the estimator received.
        first: The InitialGuess.
    """
    is_known = part[ESTIMATE[0]].notna().to_numpy()
    if is_known.sum() < 2:
        return part
    rows = part[is_known]
    stream = stream[is_known]
    stream[rows["position_accepted"] != 1, :2] = np.nan
    stream[rows["encoders_accepted"] != 1, 2:4] = np.nan
    columns = _HATS | dict(omega_radps=MEASUREMENTS[3])
    # Last inputs that no encoder measures begin at 0.
    trajectory = rows.reindex(columns=[columns.get(name, "") for name in how.model.joint_names])
    # The yaw is as unknown as before the estimator found it.
    sigma_yaw_rad = np.pi if first.yaw_rad is None else first.sigma_yaw_rad
    sigma = _sigma_first(first) | dict(theta_rad=sigma_yaw_rad)
    s, sigma = smoothed(
        how.model,
        how.dt_s,
        how.settings,
        sigma_start(how.model, sigma),
        trajectory.fillna(0.0).to_numpy(),
        stream,
    )
    part = part.copy()
    for place, name in enumerate(how.model.joint_names):
        if name in how.quantities:
            part.loc[is_known, _HATS[name]] = s[:, place]
            part.loc[is_known, _SIGMAS[name]] = sigma[:, place]
    part[ESTIMATE[4:]] = part[ESTIMATE[4:]].clip(0, 1)
    return part


def _first_yaw(first, number, samples):
    """The initial yaw [rad] of a segment, passed or measured at its first position; else None."""
    if first.yaw_rad is not None:
        return first.yaw_rad[number]
    with_position = samples[samples[MEASUREMENTS[:2]].notna().all(axis=1)]
    measured = with_position[samples.columns.intersection(YAWS)].head(1).to_numpy().ravel()
    known = measured[np.isfinite(measured)]
    return float(known[0]) if len(known) else None


def used_of(part, scenario):
    """The samples of a segment as a scenario's estimator uses them: of sensors what is accepted.

    Which are is told in columns of `part`.
    """
    used = part
    omega = part[MEASUREMENTS[3]].ffill().fillna(0.0)
    for sensor in sensors.records(scenario.sensors):
        if sensor.accepts:
            accepted = sensor.accepts(part[sensor.column], omega)
            part[ACCEPTED[sensor.name]] = accepted
            used = used.assign(**{sensor.column: part[sensor.column].where(accepted)})
    return used


def estimate_samples(recording, scenario, first=_UNKNOWN, smooth=False):
    """Estimates of a Recording by a scenario's estimator.

    Args:
        recording: The Recording.
        scenario: The Scenario of the estimator, as `replay_scenario` returns it.
        first: The InitialGuess.
        smooth: Whether later measurements count, too (`rhec.logs.smoother`).

    Returns:
        DataFrame, one row for each sample of the estimator.
    """
    how = replay_of(scenario)
    parts = []
    for number, part in enumerate(recording.samples()):
        stream = with_ages(used_of(part, scenario), how.measured)
        first_memory = partial(first_memory_of, how, scenario, first, np.nan_to_num(stream[0, 2]))
        yaw_rad = _first_yaw(first, number, part)
        estimates = estimated(
            how, stream, first_memory, yaw_rad, first.sigma_yaw_rad, hindsight=smooth
        )
        part = pd.concat([part, estimates], axis=1)
        # A measured yaw tells it whatever the course is.
        has_yaw = sensors.rows_of_yaws(scenario.sensors)
        by_course = 0.0 if has_yaw else yaw_sigma_rad(part, recording.noise_m)
        if smooth:
            part = _smooth(how, part, stream, first)
        part[SIGMA_BY_COURSE] = by_course
        part[SIGMA[2]] = np.hypot(part[SIGMA[2]], by_course)
        parts.append(part)
    samples = pd.concat(parts, ignore_index=True)
    return samples.assign(**{name: samples[name] == 1 for name in FLAGS})


def replay_scenario(estimator, recording, fields):
    """The Scenario with the estimator of a replay.

    Args:
        estimator: As in `replay`.
        recording: The Recording.
        fields: {name: value} of Scenario's parameters, among those that `replay` takes.

    Returns:
        Scenario, with a replay's defaults.

    Raises:
        ValueError: For a parameter that no replay takes, or an estimator that needs the truth.
    """
    unknown = [name for name in fields if name not in ESTIMATOR_FIELDS]
    if unknown:
        raise ValueError(
            f"replay has no parameter {unknown[0]!r}; of Scenario's parameters it takes "
            f"{', '.join(ESTIMATOR_FIELDS)}"
        )
    fields = dict(speed_model="slipping") | fields
    slips = fields["speed_model"] == "slipping"
    uses_all = slips and estimator == "rhe"
    used = recording.sensors if uses_all else getattr(estimator, "sensors", ())
    fields = dict(sensors=used) | fields
    if slips and fields.get("sigma_v") is None:
        sigma_m = max(recording.noise_m, declared_m(recording.rows))
        fields["sigma_v"] = (sigma_m, sigma_m, *paper.SIGMA_V[2:])
    for name in fields.get("sensors", ()):
        if name in SENSORS and name not in recording.sensors:
            raise ValueError(
                f"sensors was {fields['sensors']!r}; the log has no numbers in a column "
                f"{recording.columns[SENSORS[name]]}: sensors may have the names "
                f"{recording.sensors!r}"
            )
    scenario = Scenario(estimator=estimator, track_width_m=recording.track_width_m, **fields)
    if estimator_of(scenario.estimator).told:
        names = [repr(name) for name in NAMES if not estimator_of(name).told]
        raise ValueError(
            f"estimator was {estimator!r}; a replay takes {', '.join(names)} or a CasADi Function: "
            "the others need the truth"
        )
    return scenario


# Any Model


def _replay_model(log, model, estimator, delays_s, arguments):
    """Replay a log with the RHE or EKF of a Model, which restarts in each segment."""
    classes = {"rhe": rhe.RHE, "ekf": ekf.EKF}
    if estimator not in classes:
        raise ValueError(f"estimator was {estimator!r}; for a model it should be 'rhe' or 'ekf'")
    live = classes[estimator](model=model, **arguments)  # before the log is read
    dt_s = arguments["dt"]
    mean, sigma = joint_guess(model, arguments["guess"], arguments["sigma_guess"])
    structure = ("ekf", model, dt_s)
    if estimator == "rhe":
        structure = ("rhe", live.window)
        memory = pack_array(rhe.init(live.window, mean, sigma))
    else:
        memory = live.first_memory
    memory = np.append(memory, np.zeros(len(model.names)))
    recording = prepare_for(model, dt_s, log, delays_s)
    how = Replay(
        model=model,
        dt_s=dt_s,
        quantities=model.names,
        hats=[f"{name}_hat" for name in model.names],
        sigmas=[f"{name}_sigma" for name in model.names],
        measured=[*model.outputs],
        structure=((), *structure),
        settings=live.settings,
    )
    parts = [
        pd.concat([part, how.scanned(memory, with_ages(part, how.measured))], axis=1)
        for part in recording.samples()
    ]
    samples = pd.concat(parts, ignore_index=True)
    # The covariance is that of states and parameters.
    others = [f"{name}_sigma" for name in model.inputs]
    samples = samples.drop(columns=[*others, "deviance", "kkt_rhe"])
    return at_rows(samples.assign(ok=samples["ok"] == 1), recording, log, how)


# Rows of the log


def at_rows(samples, recording, log, how):
    """One row for each row of the log, in its order and with its index.

    A row has the estimate of the last sample, predicted to the time of the row. An unusable row has
    the estimate of the previous row.

    Args:
        samples: DataFrame of all samples.
        recording: The Recording of the log.
        log: DataFrame.
        how: The Replay.
    """
    parts = []
    for segment, rows in recording.rows.groupby("segment"):
        part = samples[samples["segment"] == segment].reset_index(drop=True)
        parts.append(_at_rows_of_segment(part, rows, recording, how))
    rows = pd.concat(parts, ignore_index=True)
    # The row of `rows` for each row of the log; -1 marks unusable rows.
    usable = np.full(len(log), -1)
    usable[recording.places] = np.arange(len(rows))
    result = rows.iloc[np.maximum.accumulate(np.maximum(usable, 0))].set_axis(log.index)
    result.loc[usable < 0, how.measured] = np.nan
    result.loc[usable < 0, result.columns.intersection([*GATE, *ACCEPTED.values()])] = False
    result.attrs["faults"] = recording.faults
    return result


def _at_rows_of_segment(samples, rows, recording, how):
    """`at_rows` of the samples and usable rows of one segment."""
    t = rows["t_s"].to_numpy()
    sampled = samples["t_s"].to_numpy()
    last = np.searchsorted(sampled, t, side="right") - 1
    tau = t - sampled[last]
    z = samples[how.measured].iloc[last].reset_index(drop=True)
    for name in z.columns.intersection(recording.means):
        z[name] = means_of(rows, name, sampled[last], t, recording)
    result = samples.iloc[last].reset_index(drop=True)
    held = z.ffill().to_numpy()
    predicted, _ = how.predict(result[how.hats].to_numpy(), held, tau)
    result.loc[tau != 0, how.hats] = predicted[tau != 0]
    # Events of a sample are reported only in the first row after it.
    is_between = np.diff(last, prepend=-1) == 0
    ages = [f"{name}_age_s" for name in how.measured]
    of_sample = result.columns.intersection([*INNOVATION, "deviance", *ages])
    result.loc[is_between, of_sample] = np.nan
    result.loc[is_between, result.columns.intersection([*GATE, *ACCEPTED.values()])] = False
    of_row = rows.columns.difference(["segment", POSITION_AGE], sort=False)
    result[of_row] = rows[of_row].to_numpy()
    return result


# The public function


@checked
def replay(
    log: Any,
    estimator: Any = "rhe",
    *,
    model: Model | None = None,
    track_width_m: Positive | None = None,
    lever_arm_m: tuple[Real, Real] | None = None,
    first_yaw_rad: Real | tuple[Real, ...] | None = None,
    sigma_yaw_rad: Positive | None = None,
    position_delay_s: Real = 0.0,
    delays_s: dict[str, Real] | None = None,
    trust_log: Flag = False,
    smooth: Flag | None = None,
    **fields: Any,
) -> pd.DataFrame:
    """Run an estimator on a recorded log of the paper's robot or of any Model.

    Args:
        log: The path of a file, as `rhec.logs.read` takes it; or DataFrame of a recording, in SI
            units, with a row at least every 0.2 s; missing measurements are NaN. Required columns:

            - `t_s`: time [s];
            - `x_m`, `y_m`: measured position of the antenna [m];
            - `speed_mps`, `yaw_rate_radps`: by the encoders, not corrected for slip; or the track
              speeds `v_left_mps`, `v_right_mps`, together with a track_width_m.

            Optional are `segment`, which changes where the robot was moved without driving,
            `gyro_radps` [rad/s] and `heading_rad` [rad], both counter-clockwise, and `pos_ok` and
            `encoders_ok`, false where that measurement is invalid. docs/log_columns.md lists the
            columns of the truth, which the estimators do not use. The log of a `rhec.simulate` run
            is accepted as well. With a model the log has `t_s`, a column for each of the model's
            outputs and optionally `segment`, with a row at least every dt. Outputs may be measured
            in different rows and at different rates; a measured input is the mean since its
            previous measurement. `rhec.logs.recording` describes the treatment of faults of real
            logs.
        estimator: "rhe", "ekf", "bounded_ekf", a rhec.Estimator or its CasADi Function, as in
            Scenario. With a model "rhe" or "ekf".
        model: A rhec.Model. The other arguments are then those of rhec.RHE or rhec.EKF: dt,
            sigma_v, sigma_w, guess (of each segment), sigma_guess, horizon, arrival_mean.
        track_width_m: Distance of the tracks [m]. With it, ν and ω are computed from v_left_mps
            and v_right_mps; speed_mps and yaw_rate_radps are not used.
        lever_arm_m: Position (ahead, left) of the antenna relative to the centre of turning [m]. By
            default it is estimated, within some decimetres of the centre. Only the estimator "rhe"
            with speed_model="slipping" accepts it. The estimated position is that of the antenna.
        first_yaw_rad: Initial guess of the yaw [rad], one number or one for each segment. By
            default several directions are tried. Each row then has the estimate with the smallest
            innovations until then, which may be wrong until the robot has driven some metres.
        sigma_yaw_rad: Standard deviation of that guess [rad]; 0.3 by default.
        position_delay_s: Delay of the time stamps of the positions relative to the encoders [s].
        delays_s: With a model, {output: delay of its time stamps [s]}.
        trust_log: Whether to skip the plausibility checks. By default a log with wrong units, signs
            or axes, or of a robot that never moves, is refused.
        smooth: Whether each estimate takes later measurements into account, too: by default that
            of the estimator "rhe" with speed_model="slipping". With speed_model="input" it can be
            smoothed as well.
        **fields: Parameters of Scenario: process_noise, sigma_w, sigma_v, estimation_horizon,
            speed_model, slip, arrival_mean, yaw_drift, sensors, sigma_gyro, sigma_heading. The
            default speed_model is "slipping": "input" (interpretation G13) with noise that grows
            with the motion. With it the estimator "rhe" uses the gyro and the heading of the log
            unless sensors says otherwise, and without a sigma_v the log is asked for the noise of
            the positions.

    Returns:
        DataFrame, one row for each row of the log, in its order and with its index;
        docs/log_columns.md documents the columns. With a model it has the measurements under
        the names of the outputs, `<name>_hat` for each state, input and parameter, `<name>_sigma`,
        the standard deviation, for states and parameters, and `ok`. An unusable row has the
        previous estimate. Estimates before the first position of a segment are NaN.
        `.attrs["faults"]` counts unusable rows and measurements.

    Raises:
        ValueError: If the log lacks columns or usable times, if it fails the plausibility checks,
            or if an argument is invalid.

    Warns:
        UserWarning: If the yaw is not known, or if the positions are late.
    """
    log = read_if_path(log)
    if model is not None:
        refuse_with_model(
            track_width_m=track_width_m,
            lever_arm_m=lever_arm_m,
            first_yaw_rad=first_yaw_rad,
            sigma_yaw_rad=sigma_yaw_rad,
            position_delay_s=position_delay_s or None,
            trust_log=trust_log or None,
            smooth=smooth or None,
        )
        return _replay_model(log, model, estimator, delays_s, fields)
    if delays_s is not None:
        raise ValueError(
            f"delays_s was {delays_s!r}; it is of a model's outputs, and this replay has no model: "
            "position_delay_s is that of the positions"
        )
    recording = delayed(prepare(log, track_width_m), position_delay_s)
    if not trust_log:
        refuse(recording)
    scenario = replay_scenario(estimator, recording, fields)
    smooth = _checked_smooth(smooth, lever_arm_m, scenario)
    yaws = _yaw_of_each_segment(first_yaw_rad, recording)
    sigma_yaw_rad = sigma_yaw_rad or _UNKNOWN.sigma_yaw_rad
    first = InitialGuess(yaws, sigma_yaw_rad, lever_arm_m)
    samples = estimate_samples(recording, scenario, first, smooth)
    result = at_rows(samples, recording, log, replay_of(scenario))
    if unknown := unknown_yaw(samples):
        warnings.warn(unknown, stacklevel=3)
    return result


def refuse_with_model(**arguments: Any) -> None:
    """Raise a ValueError for the first argument that is not None."""
    for name, value in arguments.items():
        if value is not None:
            raise ValueError(f"{name} was {value!r}; a replay with a model does not take it")


def _checked_smooth(smooth, lever_arm_m, scenario):
    """Whether to smooth; a ValueError where the scenario's estimator takes no such argument."""
    is_rhe = scenario.estimator == "rhe"
    slips = is_rhe and scenario.speed_model == "slipping"
    if lever_arm_m is not None and not slips:
        raise ValueError(
            f"lever_arm_m was {lever_arm_m!r}; only the estimator 'rhe' with speed_model "
            "'slipping' takes one"
        )
    if smooth and not (is_rhe and scenario.speed_model != "parameter"):
        raise ValueError(
            "smooth was True; only the estimator 'rhe' with speed_model 'slipping' or 'input' can "
            "be smoothed"
        )
    return slips if smooth is None else smooth


def _yaw_of_each_segment(first_yaw_rad, recording):
    """The initial yaw of each segment as a tuple [rad]; None if it is unknown."""
    segments = recording.rows["segment"].nunique()
    if first_yaw_rad is None:
        return None
    if isinstance(first_yaw_rad, float):
        return (first_yaw_rad,) * segments
    if len(first_yaw_rad) != segments:
        raise ValueError(
            f"first_yaw_rad had {len(first_yaw_rad)} entries; it should be one number, or one for "
            f"each of the log's {segments} segments"
        )
    return first_yaw_rad
