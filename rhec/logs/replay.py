"""Replay: a recorded log through an estimator, which is scanned over each segment's samples.

Samples are DT_S apart; the encoder measurements of each are means over the interval that ends there
(`recording.resample`). A position read between two samples is carried on to the second by the
motion that the last estimate and the encoders predict. Each row of the log then gets the estimate
of the last sample, predicted to the row's own time by the encoder measurements since. Nothing read
after a row changes what it gets; only the track width is a median over the whole log.
"""

import warnings
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.core._casadi.build import pack_array, packed_size, select_inputs, unpack
from rhec.core._casadi.validation import Flag, Positive, Real, checked
from rhec.core.estimator.ekf import EKF
from rhec.core.estimator.rhe import RHE
from rhec.core.model.base import Model, interval
from rhec.core.model.limits import is_valid_measurement
from rhec.logs.lost import is_lost, remarks
from rhec.logs.nonsense import refuse_nonsense
from rhec.logs.recording import measured_since, prepare, prepare_for, resample
from rhec.simulation.columns import (
    AGE,
    ESTIMATE,
    FLAGS,
    GATE,
    INNOVATION,
    LEVER_ARM,
    MEASUREMENTS,
    SIGMA,
)
from rhec.simulation.faults import corrupted
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import slipping
from rhec.tracked_robot.choice import Choice, TractionInput
from rhec.tracked_robot.estimators import NAMES, build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS
from rhec.tracked_robot.rhe import window_of
from rhec.tracked_robot.tuning import sigma_v_of

__all__ = ["InitialGuess", "estimate_samples", "predictor", "replay", "replay_scenario"]

_QUANTITIES = (*QUANTITIES, *slipping.LEVER_ARM)  # with estimates in columns _HATS
_HATS = [*ESTIMATE, *LEVER_ARM]
_OUTPUTS = [*_HATS, *SIGMA, "deviance", "kkt_rhe", *FLAGS]
_ESTIMATOR_FIELDS = (
    "process_noise sigma_w sigma_v estimation_horizon speed_model slip arrival_mean robust".split()
)
_N_HEADINGS = 8  # directions tried where the first yaw is not known
# Of the first guess of (x, y, θ, ν, μ, κ, l_f, l_l); of the first six as the paper's W, but for the
# yaw.
_SIGMA_FIRST = (10.0, 10.0, 0.3, 1.0, 0.25, 0.25, 0.1, 0.1)
_SIGMA_ARM_M = 0.005  # of an antenna's place that is given


class InitialGuess(NamedTuple):
    """What is known of a recorded robot before the first sample: its yaw in each segment [rad] with
    the standard deviation of that, the antenna's place ahead and left of the robot's centre [m].
    """

    yaw_rad: tuple | None = None
    sigma_yaw_rad: float = _SIGMA_FIRST[2]
    lever_arm_m: tuple | None = None


_UNKNOWN = InitialGuess()


def _build_replay(*choice):
    """The estimator's step with a row of _OUTPUTS, ready to be scanned; what the estimator does not
    tell is NaN.
    """
    choice = Choice(*choice)
    nan = ca.DM.nan(1)
    step = build_step(choice)
    motion = _motion(_model_of(choice), _QUANTITIES)
    memory = ca.MX.sym("memory", step.size1_in(0) + len(_HATS))  # the step's, the last estimate
    own, last = ca.vertsplit(memory, [0, step.size1_in(0), memory.numel()])
    stream = ca.MX.sym("stream", len(MEASUREMENTS) + 1)
    settings = step.mx_in()[2:]
    z = stream[:-1]
    age_s = stream[-1]
    now, then = (motion(last, z, paper.DT_S - age)[1][:2] for age in (0, age_s))
    z = ca.vertcat(z[:2] + ca.if_else(age_s > 0, now - then, 0), z[2:])
    states = estimator_of(choice.estimator, choice.robust).states(choice)
    results = step.call([own, z, *settings])
    outputs = dict(zip(["memory", "estimate", *step.name_out()[2:]], results))
    hats = dict(zip(QUANTITIES, ca.vertsplit(outputs["estimate"])))
    sigma = {name: ca.sqrt(outputs["covariance"][i, i]) for i, name in enumerate(states)}
    if set(slipping.LEVER_ARM) <= set(states):
        window = window_of(choice)
        packed = outputs["memory"][: packed_size(window.memory)]  # what gating remembers is behind
        newest = dict(zip(states, ca.vertsplit(unpack(packed, window.memory)["s"][:, window.N])))
        hats |= {name: newest[name] for name in slipping.LEVER_ARM}
    limits = SPEED_MODELS["parameter"].model.limits
    valid = [is_valid_measurement(z[row], limit) for row, limit in enumerate(limits)]
    accepted = outputs.get("accepted", ca.vertcat(*valid))
    row = ca.vertcat(
        *(known.get(name, nan) for known in (hats, sigma) for name in _QUANTITIES),
        *(outputs.get(name, nan) for name in ("deviance", "kkt")),
        outputs.get("ok", 1),
        *(accepted[0] * accepted[1], accepted[2] * accepted[3]),
        outputs.get("restart", 0),
    )
    inputs = [memory, stream, *settings]
    results = [ca.vertcat(outputs["memory"], row[: len(_HATS)]), row]
    names = ["memory", "z", *step.name_in()[2:]], ["memory", "row"]
    options = {"allow_duplicate_io_names": True}
    return scan.build_scan(ca.Function("replay", inputs, results, *names, options))


def _run(steps, scenario, z, age_s, yaw_rad, first):
    """_OUTPUTS, one row a measurement of z (n, 4) whose position is age_s (n,) old, of one segment
    that begins with this yaw, at the first position; NaN before that.
    """
    heard = np.isfinite(z[:, :2]).all(axis=1)
    choice = Choice.of(scenario)
    begin = np.argmax(heard) if heard.any() else len(z)
    x, y = z[begin, :2] if heard.any() else (0.0, 0.0)
    nu = np.nan_to_num(z[0, 2])
    guess = (x, y, yaw_rad, nu, 1.0, 1.0, *(first.lever_arm_m or (0.0, 0.0)))
    sigma = dict(zip(_QUANTITIES, _SIGMA_FIRST)) | dict(theta_rad=first.sigma_yaw_rad)
    if first.lever_arm_m is not None:
        sigma |= dict.fromkeys(slipping.LEVER_ARM, _SIGMA_ARM_M)
    estimator = estimator_of(choice.estimator, choice.robust)
    memory = pack_array(estimator.init(choice, dict(zip(_QUANTITIES, guess)), sigma))
    settings = estimator.settings(scenario) | dict(
        traction=estimator.traction_input.select_traction(None, None)
    )
    stream = np.column_stack([z, age_s])
    inputs = select_inputs(steps["step"], settings)
    rows = scan.scan(steps, np.append(memory, guess), stream, inputs)[1]
    rows[:begin] = np.nan
    return rows


def _motion(model, names):
    """(estimate, z, tau_s) -> (estimate, outputs) of a Model after tau_s [s] of driving by the
    inputs measured in z, or estimated where z has none.
    """
    estimate = ca.SX.sym("estimate", len(names))
    z = ca.SX.sym("z", len(model.outputs))
    known = dict(zip(names, ca.vertsplit(estimate)))
    tau_s = ca.SX.sym("tau_s")
    u = [known.get(name, 0) for name in model.inputs]
    for place, row in model.input_outputs.items():
        valid = is_valid_measurement(z[row], model.limits[row])
        u[place] = ca.if_else(valid, z[row], u[place])
    joint = (*model.states, *model.parameters)
    u = ca.vertcat(*u)
    s = ca.vertcat(*(known[name] for name in joint))
    s = interval(model, measured=False).step(s, u, tau_s)
    x, p = ca.vertsplit(s, [0, len(model.states), len(joint)])
    known |= dict(zip(joint, ca.vertsplit(s)))
    results = [ca.vertcat(*known.values()), model.measurement(x, u, p)]
    return ca.Function("motion", [estimate, z, tau_s], results)


def predictor(model, names=_QUANTITIES):
    """`_motion` of estimates (n, names), measurements (n, n_z) and times (n,); one that is missing
    is the one before it.
    """

    def predict(estimate, z, tau_s):
        held = pd.DataFrame(z).ffill().to_numpy()
        motion = _motion(model, names).map(len(estimate))
        return [np.array(result).T for result in motion(estimate.T, held.T, tau_s[None, :])]

    return predict


def _model_of(choice):
    """The Model by which a Choice's estimator predicts."""
    return window_of(choice).model if choice.estimator in NAMES else SPEED_MODELS["input"].model


def _innovations(scenario, estimate, z, age_s):
    """Measured position less the one predicted from the estimate (n, 8) before it and the encoder
    measurements since, when it was read; the first sample has none.
    """
    innovations = np.full((len(z), 2), np.nan)
    model = _model_of(Choice.of(scenario))
    if len(z) > 1:
        tau_s = paper.DT_S - np.nan_to_num(age_s[1:])
        _, predicted = predictor(model)(estimate[:-1], z[1:], tau_s)
        innovations[1:] = z[1:, :2] - predicted[:, :2]
    return innovations


def _most_likely_heading(steps, scenario, z, age_s, first):
    """At each sample the row of the run whose first yaw, of several directions, has the least sum
    of squared innovations so far.
    """
    unsure = first._replace(sigma_yaw_rad=np.pi / _N_HEADINGS)
    yaws = 2 * np.pi / _N_HEADINGS * np.arange(_N_HEADINGS)
    runs = np.stack([_run(steps, scenario, z, age_s, yaw, unsure) for yaw in yaws])
    squares = [np.square(_innovations(scenario, run[:, :8], z, age_s)) for run in runs]
    best = np.argmin(np.nancumsum(np.nansum(squares, axis=2), axis=1), axis=0)
    return runs[best, np.arange(len(z))]


def estimate_samples(recording, scenario, first=_UNKNOWN, faults=(), seed=0):
    """Estimates of a Recording by the scenario's estimator, one row for each sample.

    faults: (rhec.Fault, …) that the measurements are given, at times as in the log; seed: of their
    random directions.
    """
    steps = compiled.load(_build_replay, *Choice.of(scenario))
    parts = []
    for number, (segment, rows) in enumerate(recording.rows.groupby("segment")):
        part = resample(rows, paper.DT_S, recording.averaged)
        z = part[MEASUREMENTS].to_numpy()
        age_s = part[AGE[0]].to_numpy()
        if faults:
            z = corrupted(z, faults, part["t_s"], recording.track_width_m, seed)
            part[MEASUREMENTS] = z = np.where(np.isfinite(z), z, np.nan)
        if first.yaw_rad is None:
            outputs = _most_likely_heading(steps, scenario, z, age_s, first)
        else:
            outputs = _run(steps, scenario, z, age_s, first.yaw_rad[number], first)
        part[_OUTPUTS] = outputs
        part[INNOVATION] = _innovations(scenario, outputs[:, :8], z, age_s)
        part["lost"] = is_lost(part, sigma_v_of(scenario))
        part.insert(0, "segment", segment)
        parts.append(part)
    samples = pd.concat(parts, ignore_index=True)
    return samples.assign(**{name: samples[name] == 1 for name in FLAGS})


def _at_rows(samples, recording, log, dt_s, measured, means, estimated, predict):
    """One row for each row of the log, in its order and with its index: the last sample's estimate,
    predicted to the row's time; where the row cannot be used, the estimate before it.

    measured, estimated: names of these columns; means: of the measured ones that are means;
    predict(estimate, z, tau_s): a `predictor`.
    """
    parts = []
    for segment, rows in recording.rows.groupby("segment"):
        part = samples[samples["segment"] == segment].reset_index(drop=True)
        t = rows["t_s"].to_numpy()
        sampled = part["t_s"].to_numpy()
        last = np.searchsorted(sampled, t, side="right") - 1
        tau = t - sampled[last]
        z = part[measured].iloc[last].reset_index(drop=True)
        z[means] = measured_since(rows, sampled[last], dt_s, recording.averaged, means)
        result = part.iloc[last].reset_index(drop=True)
        moved, _ = predict(result[estimated].to_numpy(), z.to_numpy(), tau)
        result.loc[tau != 0, estimated] = moved[tau != 0]
        between = np.diff(last, prepend=-1) == 0  # no sample's own row
        of_sample = [*INNOVATION, "deviance", *(f"{name}_age_s" for name in measured)]
        result.loc[between, result.columns.intersection(of_sample)] = np.nan
        result.loc[between, result.columns.intersection(GATE)] = False
        given = rows.columns.drop("segment")
        result[given] = rows[given].to_numpy()
        parts.append(result)
    rows = pd.concat(parts, ignore_index=True)
    place = np.full(len(log), -1)
    place[recording.kept] = np.arange(len(rows))
    result = rows.iloc[np.maximum.accumulate(np.maximum(place, 0))].set_axis(log.index)
    result.loc[place < 0, measured] = np.nan
    result.loc[place < 0, result.columns.intersection(GATE)] = False
    result.attrs["faults"] = recording.faults
    return result


def _replay_model(log, model, estimator, arguments):
    """A log through the RHE or EKF of a Model, one made anew for each segment."""
    made = {"rhe": RHE, "ekf": EKF}.get(estimator)
    if made is None:
        raise ValueError(f"estimator was {estimator!r}; for a model it should be 'rhe' or 'ekf'")
    made(model=model, **arguments)  # refuses bad arguments before it looks at the log
    dt_s = arguments["dt"]
    names = model.names
    recording = prepare_for(model, dt_s, log)
    parts = []
    means = [model.outputs[row] for row in model.input_outputs.values()]
    hats = [f"{name}_hat" for name in names]
    motion = _motion(model, names)
    columns = [*hats, *(f"{name}_sigma" for name in (*model.states, *model.parameters)), "ok"]
    for segment, rows in recording.rows.groupby("segment"):
        part = resample(rows, dt_s, True, model.outputs, means)
        told = []
        ages = part.reindex(columns=[f"{name}_age_s" for name in model.outputs]).to_numpy()
        live = made(model=model, **arguments)
        last = None
        for z, age_s in zip(part[[*model.outputs]].to_numpy(copy=True), ages):
            for row in np.flatnonzero(age_s > 0):
                now, then = (motion(last, z, dt_s - age)[1] for age in (0, age_s[row]))
                z[row] += float(now[row] - then[row])
            live.prepare()
            x, u, p, covariance = live.feedback(z)
            last = [*x, *u, *p]
            sigma = np.sqrt(np.diag(covariance))
            told.append([*last, *sigma, getattr(live, "ok", True)])
        part[columns] = np.array(told, dtype=float)
        part.insert(0, "segment", segment)
        parts.append(part)
    samples = pd.concat(parts, ignore_index=True)
    samples["ok"] = samples["ok"] == 1
    predict = predictor(model, names)
    return _at_rows(samples, recording, log, dt_s, [*model.outputs], means, hats, predict)


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
    trust_log: Flag = False,
    **fields: Any,
) -> pd.DataFrame:
    """Estimates from a recorded log: of the paper's robot, or of any Model.

    Args:
        log: DataFrame of a recording, at 5 Hz or faster, SI units, a missing measurement NaN:
            `t_s`; `x_m, y_m` (the antenna's measured position); by the encoders, not corrected for
            slip, `speed_mps, yaw_rate_radps` or, of the tracks, `v_left_mps, v_right_mps`.
            Optional: `segment`, never driven through where it changes; `pos_ok, encoders_ok`, false
            where a measurement is to be ignored; the truth `x_true_m, y_true_m, yaw_true_rad,
            v_true_mps, yaw_rate_true_radps`, which no estimator sees. Other columns are ignored.
            Or the log of a `rhec.simulate` run, known by `x_meas_m`. With a model: `t_s`, a column
            for each of its outputs (a measured input: its mean since the row before) and,
            optionally, `segment`, a row at least every dt. How faults of real logs are treated:
            `rhec.logs.recording`.
        estimator: "rhe", "rhe_no_slip", "ekf", "augmented_ekf", "bounded_ekf", "dual" or a CasADi
            Function of one's own, as in Scenario. With a model "rhe" or "ekf".
        model: A rhec.Model; all that follows is then what rhec.RHE (or rhec.EKF) takes with it: dt,
            sigma_v, sigma_w, guess (of each segment), sigma_guess, horizon, arrival_mean.
        track_width_m: Take ν and ω from v_left_mps and v_right_mps, this far apart [m], instead of
            speed_mps and yaw_rate_radps.
        lever_arm_m: Place of the antenna, (ahead, left) of the robot's centre of turning [m]; by
            default it is estimated, within some decimetres. Only the estimator "rhe" with
            speed_model="slipping" knows of it. The position estimated is the antenna's.
        first_yaw_rad: First guess of the yaw [rad], one number or one for each segment. By default
            several directions are tried, and each row has the estimate of the one with the least
            innovations so far: until the robot has driven some metres that may be a wrong one.
        sigma_yaw_rad: Standard deviation of that guess [rad], by default 0.3.
        position_delay_s: How much later than the encoders' measurements the positions were stamped
            [s].
        trust_log: Whether to take a log as it is in which something is surely wrong: its units,
            signs, axes, or a robot that never moves.
        **fields: Of Scenario: process_noise, sigma_w, sigma_v, estimation_horizon, speed_model,
            slip, arrival_mean, robust. speed_model is "slipping" by default: "input" (R13) with
            noise that scales with motion; with it the estimator "rhe" is robust unless robust is
            False.

    Returns:
        DataFrame, one row for each row of the log, in its order and with its index; `rhec.simulation.columns`
        documents its columns. With a model: measurements under the outputs' names, for each state,
        input and parameter `<name>_hat`, for states and parameters the standard deviation
        `<name>_sigma`, and `ok`. A row that cannot be used has the estimate before it. Nothing
        is said, NaN, before a segment's first position.
        `.attrs["faults"]` counts rows and measurements that could not be used;
        `.attrs["remarks"]`, without a model, says in sentences whether the estimate is `lost` and
        what the log cannot tell. A lost estimate also warns.

    Raises:
        ValueError: For a log without these columns or usable times, one that cannot be what its
            columns say, or a bad argument. Positions half a second late are a UserWarning.
    """
    if model is not None:
        own = dict(track_width_m=track_width_m, lever_arm_m=lever_arm_m)
        own |= dict(first_yaw_rad=first_yaw_rad, sigma_yaw_rad=sigma_yaw_rad)
        own |= dict(position_delay_s=position_delay_s or None, trust_log=trust_log or None)
        for name in (name for name, value in own.items() if value is not None):
            raise ValueError(f"{name} was {own[name]!r}; a replay with a model does not take it")
        return _replay_model(log, model, estimator, fields)
    recording = prepare(log, track_width_m, position_delay_s)
    if not trust_log:
        refuse_nonsense(recording)
    scenario = replay_scenario(estimator, recording, fields)
    if lever_arm_m is not None and (
        scenario.estimator != "rhe" or scenario.speed_model != "slipping"
    ):
        raise ValueError(
            f"lever_arm_m was {lever_arm_m!r}; only the estimator 'rhe' with speed_model "
            "'slipping' takes one"
        )
    segments = recording.rows["segment"].nunique()
    if isinstance(first_yaw_rad, float):
        first_yaw_rad = (first_yaw_rad,) * segments
    if first_yaw_rad is not None and len(first_yaw_rad) != segments:
        raise ValueError(
            f"first_yaw_rad had {len(first_yaw_rad)} entries; it should be one number, or one for "
            f"each of the log's {segments} segments"
        )
    first = InitialGuess(first_yaw_rad, sigma_yaw_rad or _SIGMA_FIRST[2], lever_arm_m)
    samples = estimate_samples(recording, scenario, first)
    predict = predictor(_model_of(Choice.of(scenario)))
    measured = MEASUREMENTS, MEASUREMENTS[2:]
    result = _at_rows(samples, recording, log, paper.DT_S, *measured, _HATS, predict)
    arm_estimated = scenario.speed_model == "slipping" and lever_arm_m is None
    result.attrs["remarks"] = remarks(samples, arm_estimated)
    if samples["lost"].any():
        warnings.warn(result.attrs["remarks"][0], stacklevel=3)
    return result


def replay_scenario(estimator, recording, fields):
    """The Scenario whose estimator a replay runs."""
    unknown = [name for name in fields if name not in _ESTIMATOR_FIELDS]
    if unknown:
        raise ValueError(
            f"replay has no parameter {unknown[0]!r}; of Scenario's fields it takes "
            f"{', '.join(_ESTIMATOR_FIELDS)}"
        )
    fields = dict(speed_model="slipping") | fields
    if fields["speed_model"] == "slipping":  # not the paper's, so each measurement counts once
        fields = dict(arrival_mean="filtered", robust=estimator == "rhe") | fields
    scenario = Scenario(estimator=estimator, track_width_m=recording.track_width_m, **fields)
    if estimator_of(scenario.estimator, scenario.robust).traction_input is not TractionInput.NONE:
        names = [
            repr(name) for name in NAMES if estimator_of(name).traction_input is TractionInput.NONE
        ]
        raise ValueError(
            f"estimator was {estimator!r}; a replay takes {', '.join(names)} or a CasADi Function: "
            "a recording has no truth to rely on"
        )
    return scenario
