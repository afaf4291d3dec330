"""Replay: a recorded log through an estimator, one segment after the other, each a fold of the estimator's step over its samples.

The samples are DT_S apart, the encoder readings of each are means over the interval that ends there (`recordings.samples`). Each row of the log then gets
the estimate of the last sample, moved to the row's own time by what the encoders read since.
"""

import casadi as ca
import numpy as np
import pandas as pd

from rhec import compiled, ekf, estimators, fold, model, paper, recordings, rhe
from rhec.function import vector
from rhec.scenario import Scenario
from rhec.validation import Positive, Real, checked

ESTIMATE = ["x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"]
SIGMA = ["sigma_x_m", "sigma_y_m", "sigma_theta_rad", "sigma_nu_mps", "sigma_mu", "sigma_kappa"]
OUTPUTS = [*ESTIMATE, *SIGMA, "deviance", "kkt_rhe", "ok"]
FIELDS = ("reading", "sigma_w", "sigma_v", "horizon_rhe", "speed_model", "arrival_mean", "robust", "qp")   # of Scenario, those an estimator in a replay reads
HEADINGS = 8             # directions tried where the first yaw is not known
SIGMA_FIRST = (10.0, 10.0, 0.3, 1.0, 0.25, 0.25, 0.1, 0.1)   # of the first guess of (x, y, θ, ν, μ, κ, l_f, l_l); of the first six as the paper's W, but for the yaw


def functions(*structure):
    """The estimator's step with a row of OUTPUTS, ready to be folded; what an estimator does not tell is not a number."""
    identity, _, speed_model, *_ = structure
    step = estimators.step(*structure)
    inputs = step.mx_in()
    outputs = dict(zip(["memory", "estimate", *step.name_out()[2:]], step.call(inputs)))
    states = {"rhe": model.interval(speed_model).states, "ekf": (0, 1, 2, 3), "dual": (0, 1, 2, 3)}.get(identity, ())
    sigma = [ca.DM.nan(1)] * 6
    for place, state in enumerate(states):
        if state < 6:
            sigma[state] = ca.sqrt(outputs["covariance"][place, place])
    row = ca.vertcat(outputs["estimate"], *sigma, *(outputs.get(name, default) for name, default in (
        ("deviance", ca.DM.nan(1)), ("kkt", ca.DM.nan(1)), ("ok", 1))))
    names = step.name_in() if identity in ("rhe", "ekf") else ["memory", "z", *step.name_in()[2:]]
    return fold.functions(ca.Function("replay", inputs, [outputs["memory"], row], names, ["memory", "row"], {"allow_duplicate_io_names": True}))


def run(steps, scenario, z, yaw_rad, sigma_yaw_rad):
    """OUTPUTS (n, 15) of one segment's readings z (n, 4) from a first yaw and its standard deviation; place and speed begin at the first readings."""
    seen = np.isfinite(z)
    x, y, nu = (z[np.argmax(seen[:, row]), row] if seen[:, row].any() else 0.0 for row in range(3))
    sigma = np.array(SIGMA_FIRST)
    sigma[2] = sigma_yaw_rad
    settings = estimators.variances(scenario) | dict(traction=np.ones(2))
    names = steps["step"].name_in()
    memory = estimators.first_memory(scenario, np.array([x, y, yaw_rad, nu, 1.0, 1.0]), sigma)
    return fold.fold(steps, memory, z, {name: value for name, value in settings.items() if name in names})[1]


def innovations(estimate, z, dt_s):
    """Measured position less the one predicted from the estimate (n, 6) before it and the readings since (n, 2); the first sample has none."""
    x, y, theta, _, mu, kappa = estimate[:-1].T
    nu, omega = np.nan_to_num(z[1:, 2:].T)
    predicted = np.stack(moved(x, y, theta, mu * nu * dt_s, kappa * omega * dt_s)[:2], axis=1)
    return np.concatenate([np.full((1, 2), np.nan), z[1:, :2] - predicted])


def moved(x, y, theta, ahead, turn):
    """A pose after going `ahead` [m] while turning by `turn` [rad]."""
    return x + ahead * np.cos(theta + turn / 2), y + ahead * np.sin(theta + turn / 2), theta + turn


def likeliest(steps, scenario, z):
    """The run whose first yaw, of HEADINGS directions, makes the sum of squared innovations least."""
    runs = [run(steps, scenario, z, yaw, np.pi / HEADINGS) for yaw in 2 * np.pi / HEADINGS * np.arange(HEADINGS)]
    return min(runs, key=lambda rows: np.nansum(np.square(innovations(rows[:, :6], z, paper.DT_S))))


def estimate_samples(recording, scenario, first_yaw_rad=None, sigma_yaw_rad=SIGMA_FIRST[2]):
    """Estimates of a Recording, one row for each sample: segment, t_s, truth, READINGS, OUTPUTS, innovation_x_m, innovation_y_m.

    first_yaw_rad: None, or the first guess of the yaw in each segment.
    """
    steps = compiled.load(functions, estimators.identity(scenario.estimator), scenario.horizon_rhe, scenario.speed_model, scenario.arrival_mean,
                          scenario.qp, scenario.robust)
    parts = []
    for number, (segment, rows) in enumerate(recording.rows.groupby("segment")):
        part = recordings.samples(rows, paper.DT_S, recording.averaged)
        z = part[recordings.READINGS].to_numpy()
        if first_yaw_rad is None:
            outputs = likeliest(steps, scenario, z)
        else:
            outputs = run(steps, scenario, z, first_yaw_rad[number], sigma_yaw_rad)
        part[OUTPUTS] = outputs
        part[["innovation_x_m", "innovation_y_m"]] = innovations(outputs[:, :6], z, paper.DT_S)
        part.insert(0, "segment", segment)
        parts.append(part)
    samples = pd.concat(parts, ignore_index=True)
    return samples.assign(ok=samples["ok"] == 1)


def at_rows(samples, recording):
    """The estimates at each usable row of the log: the last sample's, moved to the row's time by what the encoders read since."""
    parts = []
    for segment, rows in recording.rows.groupby("segment"):
        part = samples[samples["segment"] == segment].reset_index(drop=True)
        since = rows["t_s"].to_numpy() - part["t_s"][0]
        last = np.clip(np.floor(since / paper.DT_S + 0.25).astype(int), 0, len(part) - 1)   # a row just before a sample belongs to it
        tau = since - last * paper.DT_S
        tau[np.abs(tau) < 1e-6] = 0
        result = part.iloc[last].reset_index(drop=True)
        following = part[recordings.READINGS[2:]].iloc[np.minimum(last + (tau > 0), len(part) - 1)].to_numpy()
        nu, omega = np.nan_to_num(following.T)
        pose = moved(*(result[name].to_numpy() for name in ESTIMATE[:3]), result["mu_hat"] * nu * tau, result["kappa_hat"] * omega * tau)
        for name, value in zip(ESTIMATE, pose):
            result[name] = np.where(tau == 0, result[name], value)
        once = tau == 0
        result.loc[~once, ["innovation_x_m", "innovation_y_m", "deviance"]] = np.nan
        given = rows.columns.drop("segment")
        result[given] = rows[given].to_numpy()
        parts.append(result)
    return pd.concat(parts, ignore_index=True)


@checked
def replay(log: pd.DataFrame, estimator="rhe", *, track_width_m: Positive | None = None, first_yaw_rad: Real | tuple[Real, ...] | None = None,
           sigma_yaw_rad: Positive = SIGMA_FIRST[2], **fields):
    """A recorded log through an estimator: a DataFrame of estimates, one row for each row of the log, in its order and with its index.

    log               recorded (x_m, y_m measured, …) or of `rhec.simulate`; columns and faults: `rhec.recordings`
    estimator         "rhe", "ekf", "dual" or a CasADi Function of one's own, as in Scenario
    track_width_m     take ν and ω from v_left_mps and v_right_mps, this far apart, instead of speed_mps and yaw_rate_radps
    first_yaw_rad     first guess of the yaw, one number or one a segment. Unless told, several directions are tried, and the one is taken whose
                      innovations are least: an estimate that knows the whole segment until the robot has driven some metres
    sigma_yaw_rad     how sure that guess is
    fields            of Scenario: reading, sigma_w, sigma_v, horizon_rhe, speed_model, arrival_mean, robust, qp; speed_model is "slipping" unless
                      told, which is "input" (R13) with noise that scales with motion

    Columns: segment, t_s; the truth the log has; READINGS as measured; estimates x_hat_m … kappa_hat and their standard deviations sigma_x_m …
    sigma_kappa; innovation_x_m, innovation_y_m, deviance; kkt_rhe; ok. A row that the estimator cannot use has the estimate before it.
    `.attrs["faults"]` counts what could not be used. ValueError for a log without the columns or times that it takes.
    """
    recording = recordings.prepare(log, track_width_m)
    scenario = settings(estimator, recording, fields)
    segments = recording.rows["segment"].nunique()
    if first_yaw_rad is not None:
        first_yaw_rad = np.broadcast_to(first_yaw_rad, segments) if np.ndim(first_yaw_rad) == 0 else np.array(first_yaw_rad)
        if len(first_yaw_rad) != segments:
            raise ValueError(f"first_yaw_rad had {len(first_yaw_rad)} entries; it should be one number, or one for each of the log's {segments} segments")
    rows = at_rows(estimate_samples(recording, scenario, first_yaw_rad, sigma_yaw_rad), recording)
    place = np.full(len(log), -1)
    place[recording.kept] = np.arange(len(rows))
    result = rows.iloc[np.maximum.accumulate(np.maximum(place, 0))].set_axis(log.index)
    result.loc[place < 0, recordings.READINGS] = np.nan
    result.attrs["faults"] = recording.faults
    return result


def settings(estimator, recording, fields):
    """The Scenario whose estimator a replay runs."""
    unknown = [name for name in fields if name not in FIELDS]
    if unknown:
        raise ValueError(f"replay has no parameter {unknown[0]!r}; of Scenario's fields it takes {', '.join(FIELDS)}")
    defaults = dict(estimator=estimator, speed_model="slipping", track_width_m=recording.track_width_m) | fields
    if defaults["speed_model"] == "slipping":
        defaults = dict(arrival_mean="filtered") | defaults   # nothing of the paper's to reproduce, so each measurement counts once
    scenario = Scenario(**defaults)
    if scenario.estimator in ("oracle", "traction_oracle", "fixed_traction"):
        raise ValueError(f"estimator was {estimator!r}; a replay takes 'rhe', 'ekf', 'dual' or a CasADi Function, for a recording has no truth to rely on")
    return scenario
