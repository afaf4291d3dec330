"""Scores of a replay: errors if the log has the truth, and innovations.

Perturbed replays add noise, a wrong initial yaw and sensor faults to a log.
"""

import numpy as np
import pandas as pd

from rhec import paper, style
from rhec.logs.checks import refuse
from rhec.logs.course import UNSURE_YAW_RAD
from rhec.logs.recording import delayed, prepare
from rhec.logs.replay import InitialGuess, estimate_samples, replay_scenario
from rhec.simulation.columns import MEASUREMENTS, TRUE_SPEEDS, measured_of
from rhec.simulation.fault_signals import corrupted

# Distance driven in a segment from which scores count; before it the yaw has not yet converged.
FROM_M = 8.0
WINDOW_S = 5.0  # window of the sliding regressions
REGRESSIONS = tuple(zip(MEASUREMENTS[2:], TRUE_SPEEDS))  # of μ, of κ
_FAST_RADPS = 0.8  # yaw_rms_slow_rad leaves out faster spins
BAD_RAD = 0.5  # a larger error of the yaw is bad
GOOD_RAD = 0.2  # a smaller one is good
Z_95 = 1.96  # standard deviations
_MOVING = 0.05  # encoder speed of a moving robot [m/s, rad/s]
_STRAIGHT_RAD = 0.05  # most that the robot turns in a straight second
_STRAIGHT_M = 0.3  # least that it moves
_LEAST_RMS = 0.1  # smallest RMS [m/s, rad/s] of the measurements in a window with a regression


def regression(samples):
    """Apparent (μ, κ) of the whole log: Σ xy / Σ x², NaN for a robot that never moves.

    x: speed or yaw rate by the encoders; y: the true value over ground.
    """
    coefficients = []
    for measured, truth in REGRESSIONS:
        xy = samples[measured] * samples[truth]
        xx = samples[measured] ** 2
        total = xx[xy.notna()].sum()
        coefficients.append(xy.sum() / total if total > 0 else np.nan)
    return tuple(coefficients)


def sliding_regression(samples):
    """Apparent (μ, κ) over WINDOW_S around each sample, (n, 2); NaN at low speeds."""
    columns = []
    for measured, truth in REGRESSIONS:
        xy = samples[measured] * samples[truth]
        xx = samples[measured] ** 2
        windows = pd.DataFrame(dict(xy=xy, xx=xx)).groupby(samples["segment"])
        means = windows.rolling(round(WINDOW_S / paper.DT_S), center=True).mean()
        means = means.reset_index(drop=True)
        columns.append((means["xy"] / means["xx"]).where(means["xx"] >= _LEAST_RMS**2))
    return np.stack(columns, axis=1)


def yaw_error(samples):
    """Estimated minus true yaw [rad], between -π and π."""
    return (samples["theta_hat_rad"] - samples["theta_rad"] + np.pi) % (2 * np.pi) - np.pi


def straight_angles(log):
    """Angles from the true yaw to the true way in straight seconds (n,) [rad], and speeds (n,).

    The way is that of the robot ahead, so that reversing does not turn it.

    Args:
        log: DataFrame of a recording with its truth.
    """
    n = round(1.0 / paper.DT_S)
    angles, speeds = [], []
    for samples in prepare(log).samples():
        place = samples["x_m"].to_numpy() + 1j * samples["y_m"].to_numpy()
        yaw = samples["theta_rad"].to_numpy()
        speed = samples["nu_meas_mps"].to_numpy()[n:]
        way = (place[n:] - place[:-n]) * np.sign(speed)
        is_straight = (np.abs(yaw[n:] - yaw[:-n]) < _STRAIGHT_RAD) & (np.abs(way) > _STRAIGHT_M)
        angles.append(np.angle(way * np.exp(-0.5j * (yaw[n:] + yaw[:-n])))[is_straight])
        speeds.append(speed[is_straight])
    return np.concatenate(angles), np.concatenate(speeds)


def mounting_angle_rad(log):
    """By how much the true yaw of a log is off the direction in which its robot drives [rad].

    It is the median of `straight_angles`, and 0 without such seconds. A reference whose frame is
    mounted at an angle has it all the time. No sensor of the robot tells it, and no estimator can:
    their yaw is the direction in which the robot drives.

    Args:
        log: DataFrame of a recording with its truth.
    """
    angles, _ = straight_angles(log)
    return float(np.median(angles)) if len(angles) else 0.0


def _position_error(samples):
    """Estimated minus true position [m], (x, y)."""
    return samples["x_hat_m"] - samples["x_m"], samples["y_hat_m"] - samples["y_m"]


def distance_driven(samples):
    """Distance driven in the segment until each sample [m], by the encoders."""
    steps = paper.DT_S * samples["nu_meas_mps"].abs().fillna(0)
    return steps.groupby(samples["segment"]).cumsum()


def rms(*components):
    """Root mean square of the lengths of vectors, without those that lack a component."""
    squares = sum(np.square(component) for component in components)
    if np.isnan(squares).all():
        return np.nan
    return float(np.sqrt(np.nanmean(squares)))


def score(samples):
    """Scores of a replay's samples.

    Args:
        samples: DataFrame, as `estimate_samples` returns it.

    Returns:
        {score: number}. All but outside and not_ok count from FROM_M driven in each segment.

        - samples: number of samples that count;
        - innovation_rms_m;
        - mu_median, kappa_median;
        - outside: samples with an estimate of μ or κ outside [0, 1];
        - not_ok: samples whose step failed.

        With the true yaw:

        - yaw_rms_rad, and yaw_rms_slow_rad without fast spins;
        - nees_yaw: mean of the squared error over its variance, 1 if the estimator is consistent;
        - inside_95: share of the errors within 1.96 standard deviations;
        - bad_unsure, good_unsure: shares of the bad and of the good yaws that are unsure: the
          standard deviation is above UNSURE_YAW_RAD, or the step failed. NaN without such yaws.

        With the true position, position_rms_m. With the true speeds, the regressions
        mu_regression and kappa_regression, and mu_difference and kappa_difference, the medians
        minus the regressions.
    """
    counted = samples[distance_driven(samples) >= FROM_M]
    estimated = samples[samples["theta_hat_rad"].notna()]
    traction = estimated[["mu_hat", "kappa_hat"]]
    is_inside = ((traction >= 0) & (traction <= 1)).all(axis=1)
    values = dict(
        samples=len(counted),
        innovation_rms_m=rms(counted["innovation_x_m"], counted["innovation_y_m"]),
        mu_median=counted["mu_hat"].median(),
        kappa_median=counted["kappa_hat"].median(),
        outside=int((~is_inside).sum()),
        not_ok=int((~estimated["ok"]).sum()),
    )
    if "theta_rad" in samples:
        error = yaw_error(counted)
        sigma = counted["sigma_theta_rad"]
        is_slow = counted["omega_meas_radps"].abs() <= _FAST_RADPS
        is_unsure = (sigma > UNSURE_YAW_RAD) | ~counted["ok"]
        values |= dict(
            yaw_rms_rad=rms(error),
            yaw_rms_slow_rad=rms(error[is_slow]),
            nees_yaw=(error**2 / sigma**2).mean(),
            inside_95=(error.abs() <= Z_95 * sigma)[error.notna()].mean(),
            bad_unsure=is_unsure[error.abs() > BAD_RAD].mean(),
            good_unsure=is_unsure[error.abs() < GOOD_RAD].mean(),
        )
    if {"x_m", "y_m"} <= set(samples):
        values["position_rms_m"] = rms(*_position_error(counted))
    if set(TRUE_SPEEDS) <= set(samples):
        mu, kappa = regression(samples)
        values |= dict(
            mu_regression=mu,
            kappa_regression=kappa,
            mu_difference=values["mu_median"] - mu,
            kappa_difference=values["kappa_median"] - kappa,
        )
    return values


def perturbed_replay(log, seed, **arguments):
    """Samples of a replay with noise, a wrong initial yaw and faults added to the log.

    Args:
        log: DataFrame of a recording, as `rhec.replay` takes it.
        seed: Seed of the noise and the faults.
        **arguments: Those of `rhec.replay`, and

            - noise_m: standard deviation of the white noise on positions [m], by default 0.02. Its
              variance is added to that of a sigma_v, which describes the log;
            - yaw_error_rad: error of the initial yaw in each segment [rad], by default 0.3. Without
              the true yaw the initial yaw is estimated as in `rhec.replay`;
            - faults: (rhec.Fault, …).

    Returns:
        DataFrame, one row for each sample of the estimator.
    """
    recording, others = _prepared(log, **arguments)
    return _perturbed(recording, seed, **others)


def _prepared(log, track_width_m=None, position_delay_s=0.0, trust_log=False, **others):
    """The Recording of a log, refused if it is implausible, and the other arguments."""
    recording = delayed(prepare(log, track_width_m), position_delay_s)
    if not trust_log:
        refuse(recording)
    return recording, others


def _perturbed(
    recording,
    seed,
    noise_m=0.02,
    yaw_error_rad=0.3,
    estimator="rhe",
    *,
    lever_arm_m=None,
    faults=(),
    smooth=False,
    **fields,
):
    """`perturbed_replay` of a Recording."""
    rows = recording.rows.copy()
    noise = np.random.default_rng(seed).standard_normal((len(rows), 2))
    rows[MEASUREMENTS[:2]] += noise_m * noise
    # The variances of independent errors add up.
    if fields.get("sigma_v"):
        sigma_x, sigma_y, *encoders = fields["sigma_v"]
        fields["sigma_v"] = (np.hypot(sigma_x, noise_m), np.hypot(sigma_y, noise_m), *encoders)
    yaws = None
    if "theta_rad" in rows:
        first = rows.groupby("segment")["theta_rad"].first()
        yaws = tuple(first + yaw_error_rad) if first.notna().all() else None
    guess = InitialGuess(yaws, lever_arm_m=lever_arm_m)
    recording = recording.with_rows(rows)
    scenario = replay_scenario(estimator, recording, fields)
    samples = recording.samples()
    for part in samples:
        _corrupt(part, faults, recording.track_width_m, scenario.sensors, seed)
    return estimate_samples(recording, scenario, guess, smooth, samples)


def _corrupt(part, faults, track_width_m, sensors, seed):
    """Put faults into the samples of a segment, for a robot with these sensors."""
    if faults:
        measured = measured_of(sensors)
        z = part[measured].to_numpy()
        z = corrupted(z, faults, part["t_s"], track_width_m, seed, sensors)
        # Infinite measurements count as missing, as in a log.
        part[measured] = np.where(np.isfinite(z), z, np.nan)


def perturbed_scores(log, seeds, **arguments):
    """Scores of perturbed replays, a DataFrame with one row for each seed.

    Args:
        log, **arguments: As in `perturbed_replay`.
        seeds: Seeds of the noise.
    """
    recording, others = _prepared(log, **arguments)
    replays = (_perturbed(recording, seed, **others) for seed in seeds)
    return pd.DataFrame([dict(seed=seed) | score(samples) for seed, samples in zip(seeds, replays)])


def save(name, table, caption, **about):
    """Write a table of docs/recorded_robots.md into figures/."""
    return style.save_table(table, f"table_recorded_{name}", caption, scenario=about or None)
