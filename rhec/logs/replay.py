"""Replay: a recorded log through an estimator, one segment after the other, each a fold of the
estimator's step over its samples.

The samples are DT_S apart, the encoder readings of each are means over the interval that ends there
(`recordings.samples`). Each row of the log then gets the estimate of the last sample, moved to the
row's own time by what the encoders read since.
"""

from typing import NamedTuple

import casadi as ca
import numpy as np
import pandas as pd

from rhec import paper
from rhec._casadi import compiled, scan
from rhec._casadi.build import unpack
from rhec._casadi.validation import Positive, Real, checked
from rhec.estimator import base as estimators
from rhec.estimator import rhe
from rhec.extensions.faults import corrupted
from rhec.logs import recording as recordings
from rhec.model import tracked_robot as model
from rhec.scenario import Scenario

ESTIMATE = ["x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"]
LEVER_ARM = ["arm_forward_hat_m", "arm_left_hat_m"]
SIGMA = [
    "sigma_x_m",
    "sigma_y_m",
    "sigma_theta_rad",
    "sigma_nu_mps",
    "sigma_mu",
    "sigma_kappa",
    "sigma_arm_forward_m",
    "sigma_arm_left_m",
]
OUTPUTS = [*ESTIMATE, *LEVER_ARM, *SIGMA, "deviance", "kkt_rhe", "ok"]
ESTIMATOR_FIELDS = (
    "process_noise",
    "sigma_w",
    "sigma_v",
    "estimation_horizon",
    "speed_model",
    "arrival_mean",
    "robust",
    "qp",
)  # of Scenario, those an estimator in a replay reads
N_HEADINGS = 8  # directions tried where the first yaw is not known
# Of the first guess of (x, y, θ, ν, μ, κ, l_f, l_l); of the first six as the paper's W, but for the
# yaw.
SIGMA_FIRST = (10.0, 10.0, 0.3, 1.0, 0.25, 0.25, 0.1, 0.1)
SIGMA_ARM_M = 0.005  # of an antenna's place that is told


class InitialGuess(NamedTuple):
    """What is known of a recorded robot before the first sample."""

    yaw_rad: tuple | None = None  # in each segment
    sigma_yaw_rad: float = SIGMA_FIRST[2]  # standard deviation of that
    lever_arm_m: tuple | None = None  # the antenna's place, ahead and left of the robot's centre


UNKNOWN = InitialGuess()


def build_replay(*structure):
    """The estimator's step with a row of OUTPUTS, ready to be folded; what an estimator does not
    tell is not a number.
    """
    identity, horizon, speed_model, arrival_mean, qp, robust = structure
    step = estimators.step(*structure)
    inputs = step.mx_in()
    outputs = dict(zip(["memory", "estimate", *step.name_out()[2:]], step.call(inputs)))
    states = {
        "rhe": model.interval(speed_model).states,
        "augmented_ekf": range(6),
        "ekf": range(4),
        "dual": range(4),
    }.get(identity, ())
    estimate, sigma = [*ca.vertsplit(outputs["estimate"]), *[ca.DM.nan(1)] * 2], [ca.DM.nan(1)] * 8
    for place, state in enumerate(states):
        sigma[state] = ca.sqrt(outputs["covariance"][place, place])
    if {6, 7} <= set(states):
        window = rhe.Window(
            model.interval(speed_model), horizon, paper.DT_S, arrival_mean, qp, robust
        )
        newest = unpack(outputs["memory"], window.memory)["s"][:, horizon]
        estimate[6:] = newest[states.index(6)], newest[states.index(7)]
    row = ca.vertcat(
        *estimate,
        *sigma,
        *(
            outputs.get(name, default)
            for name, default in (("deviance", ca.DM.nan(1)), ("kkt", ca.DM.nan(1)), ("ok", 1))
        ),
    )
    return scan.build_scan(
        ca.Function(
            "replay",
            inputs,
            [outputs["memory"], row],
            ["memory", "z", *step.name_in()[2:]],
            ["memory", "row"],
            {"allow_duplicate_io_names": True},
        )
    )


def run(steps, scenario, z, yaw_rad, first):
    """OUTPUTS, one row a reading of z (n, 4), of one segment from this yaw; place and speed begin
    at the first readings.
    """
    seen = np.isfinite(z)
    x, y, nu = (z[np.argmax(seen[:, row]), row] if seen[:, row].any() else 0.0 for row in range(3))
    guess, sigma = (
        np.array([x, y, yaw_rad, nu, 1.0, 1.0, *(first.lever_arm_m or (0.0, 0.0))]),
        np.array(SIGMA_FIRST),
    )
    sigma[2] = first.sigma_yaw_rad
    if first.lever_arm_m is not None:
        sigma[6:] = SIGMA_ARM_M
    settings = estimators.noise_settings(scenario) | dict(traction=np.ones(2))
    names = steps["step"].name_in()
    memory = estimators.first_memory(
        scenario, guess if scenario.estimator == "rhe" else guess[:6], sigma
    )
    return scan.scan(
        steps, memory, z, {name: value for name, value in settings.items() if name in names}
    )[1]


def propagate(scenario, estimate, readings, tau_s):
    """Estimates (n, 8) after tau_s (n,) of driving by the readings (n, 2) of the encoders, in the
    estimator's own model; missing readings are those before.
    """
    iv = model.interval(
        scenario.speed_model
        if scenario.estimator == "rhe"
        else "parameter"
        if scenario.estimator in estimators.NAMES
        else "input"
    )
    states, n = list(iv.states), len(estimate)
    held = pd.DataFrame(readings).ffill().fillna(0).to_numpy()
    v = np.zeros((n, iv.n_v))
    for place, row in iv.measured_inputs:
        v[:, place] = held[:, row - 2]
    moved = estimate.copy()
    moved[:, states] = np.array(iv.step.map(n)(estimate[:, states].T, v.T, tau_s[None, :])).T
    return moved


def innovations(scenario, estimate, z):
    """Measured position less the one predicted from the estimate (n, 8) before it and the encoder
    readings since; the first sample has none.
    """
    if len(z) < 2:
        return np.full((1, 2), np.nan)
    predicted = propagate(scenario, estimate[:-1], z[1:, 2:], np.full(len(z) - 1, paper.DT_S))
    return np.concatenate([np.full((1, 2), np.nan), z[1:, :2] - predicted[:, :2]])


def most_likely_heading(steps, scenario, z, first):
    """The run whose first yaw, of HEADINGS directions, makes the sum of squared innovations least."""
    unsure = first._replace(sigma_yaw_rad=np.pi / N_HEADINGS)
    runs = [
        run(steps, scenario, z, yaw, unsure)
        for yaw in 2 * np.pi / N_HEADINGS * np.arange(N_HEADINGS)
    ]
    return min(
        runs, key=lambda outputs: np.nansum(np.square(innovations(scenario, outputs[:, :8], z)))
    )


def estimate_samples(recording, scenario, first=UNKNOWN, faults=(), seed=0):
    """Estimates of a Recording, one row for each sample: segment, t_s, truth, READINGS, OUTPUTS,
    innovation_x_m, innovation_y_m.

    faults: (rhec.Fault, …) that the readings are given, at times as in the log; seed: of their
    random directions.
    """
    steps = compiled.load(
        build_replay,
        estimators.estimator_key(scenario.estimator),
        scenario.estimation_horizon,
        scenario.speed_model,
        scenario.arrival_mean,
        scenario.qp,
        scenario.robust,
    )
    parts = []
    for number, (segment, rows) in enumerate(recording.rows.groupby("segment")):
        part = recordings.samples(rows, paper.DT_S, recording.averaged)
        if faults:
            wrong = corrupted(
                part[recordings.MEASUREMENTS], faults, part["t_s"], recording.track_width_m, seed
            )
            part[recordings.MEASUREMENTS] = np.where(np.isfinite(wrong), wrong, np.nan)
        z = part[recordings.MEASUREMENTS].to_numpy()
        outputs = (
            most_likely_heading(steps, scenario, z, first)
            if first.yaw_rad is None
            else run(steps, scenario, z, first.yaw_rad[number], first)
        )
        part[OUTPUTS] = outputs
        part[["innovation_x_m", "innovation_y_m"]] = innovations(scenario, outputs[:, :8], z)
        part.insert(0, "segment", segment)
        parts.append(part)
    samples = pd.concat(parts, ignore_index=True)
    return samples.assign(ok=samples["ok"] == 1)


def at_rows(samples, recording, scenario):
    """The estimates at each usable row of the log: the last sample's, moved to the row's time by
    what the encoders read since.
    """
    parts = []
    for segment, rows in recording.rows.groupby("segment"):
        part = samples[samples["segment"] == segment].reset_index(drop=True)
        since = rows["t_s"].to_numpy() - part["t_s"][0]
        last = np.clip(
            np.floor(since / paper.DT_S + 0.25).astype(int), 0, len(part) - 1
        )  # a row just before a sample belongs to it
        tau = since - last * paper.DT_S
        tau[np.abs(tau) < 1e-6] = 0
        result = part.iloc[last].reset_index(drop=True)
        following = (
            part[recordings.MEASUREMENTS[2:]]
            .ffill()
            .iloc[np.minimum(last + (tau > 0), len(part) - 1)]
        )
        there = propagate(
            scenario, result[ESTIMATE + LEVER_ARM].to_numpy(), following.to_numpy(), tau
        )
        result.loc[tau != 0, ESTIMATE[:3]] = there[tau != 0, :3]
        result.loc[
            np.diff(last, prepend=-1) == 0, ["innovation_x_m", "innovation_y_m", "deviance"]
        ] = np.nan  # they belong to the sample's own row
        given = rows.columns.drop("segment")
        result[given] = rows[given].to_numpy()
        parts.append(result)
    return pd.concat(parts, ignore_index=True)


@checked
def replay(
    log,
    estimator="rhe",
    *,
    track_width_m: Positive | None = None,
    lever_arm_m: tuple[Real, Real] | None = None,
    first_yaw_rad: Real | tuple[Real, ...] | None = None,
    sigma_yaw_rad: Positive = SIGMA_FIRST[2],
    **fields,
):
    """A recorded log through an estimator: a DataFrame of estimates, one row for each row of the
    log, in its order and with its index.

    log               recorded (x_m, y_m measured, …) or of `rhec.simulate`; columns and faults:
                      `rhec.logs.recording`
    estimator         "rhe", "ekf", "augmented_ekf", "dual" or a CasADi Function of one's own, as in
                      Scenario
    track_width_m     take ν and ω from v_left_mps and v_right_mps, this far apart, instead of
                      speed_mps and yaw_rate_radps
    lever_arm_m       where the antenna is, (ahead, left) of the robot's centre of turning; unless
                      told it is estimated, within some decimetres. Only speed_model "slipping"
                      knows of it. The position estimated is the antenna's
    first_yaw_rad     first guess of the yaw, one number or one a segment. Unless told, several
                      directions are tried, and the one is taken whose innovations are least: an
                      estimate that knows the whole segment until the robot has driven some metres
    sigma_yaw_rad     how sure that guess is
    fields            of Scenario: process_noise, sigma_w, sigma_v, estimation_horizon, speed_model,
                      arrival_mean, robust, qp; speed_model is "slipping" unless told, which is
                      "input" (R13) with noise that scales with motion

    Columns: segment, t_s; the truth the log has; READINGS as measured; estimates x_hat_m …
    kappa_hat, arm_forward_hat_m, arm_left_hat_m, and their standard deviations sigma_x_m …
    sigma_arm_left_m; innovation_x_m, innovation_y_m, deviance; kkt_rhe; ok. A row that cannot be
    used has the estimate before it. `.attrs["faults"]` counts what could not be used. ValueError
    for a log without the columns or times that it takes.
    """
    recording = recordings.prepare(log, track_width_m)
    scenario = settings(estimator, recording, fields)
    if lever_arm_m is not None and (
        scenario.estimator != "rhe" or scenario.speed_model != "slipping"
    ):
        raise ValueError(
            f"lever_arm_m was {lever_arm_m!r}; only the estimator 'rhe' with speed_model 'slipping' takes one"
        )
    segments = recording.rows["segment"].nunique()
    if isinstance(first_yaw_rad, float):
        first_yaw_rad = (first_yaw_rad,) * segments
    if first_yaw_rad is not None and len(first_yaw_rad) != segments:
        raise ValueError(
            f"first_yaw_rad had {len(first_yaw_rad)} entries; it should be one number, or one for each of the log's {segments} segments"
        )
    samples = estimate_samples(
        recording, scenario, InitialGuess(first_yaw_rad, sigma_yaw_rad, lever_arm_m)
    )
    rows = at_rows(samples, recording, scenario)
    place = np.full(len(log), -1)
    place[recording.kept] = np.arange(len(rows))
    result = rows.iloc[np.maximum.accumulate(np.maximum(place, 0))].set_axis(log.index)
    result.loc[place < 0, recordings.MEASUREMENTS] = np.nan
    result.attrs["faults"] = recording.faults
    return result


def settings(estimator, recording, fields):
    """The Scenario whose estimator a replay runs."""
    unknown = [name for name in fields if name not in ESTIMATOR_FIELDS]
    if unknown:
        raise ValueError(
            f"replay has no parameter {unknown[0]!r}; of Scenario's fields it takes {', '.join(ESTIMATOR_FIELDS)}"
        )
    defaults = (
        dict(estimator=estimator, speed_model="slipping", track_width_m=recording.track_width_m)
        | fields
    )
    if defaults["speed_model"] == "slipping":
        defaults = (
            dict(arrival_mean="filtered") | defaults
        )  # nothing of the paper's to reproduce, so each measurement counts once
    scenario = Scenario(**defaults)
    if scenario.estimator in ("oracle", "traction_oracle", "fixed_traction"):
        raise ValueError(
            f"estimator was {estimator!r}; a replay takes 'rhe', 'ekf', 'augmented_ekf', 'dual' or a CasADi Function: a recording has no truth "
            "to rely on"
        )
    return scenario
