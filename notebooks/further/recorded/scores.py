"""Scores of a replay: errors if the log has the truth, and innovations.

Perturbed replays add noise and a wrong initial yaw to a log.
"""

import numpy as np

from rhec import paper, style
from rhec.logs.checks import refuse
from rhec.logs.course import UNSURE_YAW_RAD
from rhec.logs.recording import delayed, prepare
from rhec.logs.replay import InitialGuess, estimate_samples, replay_scenario
from rhec.simulation.columns import MEASUREMENTS, TRUE_SPEEDS

# Distance driven in a segment from which scores count; before it the yaw has not yet converged.
FROM_M = 8.0
_REGRESSIONS = tuple(zip(MEASUREMENTS[2:], TRUE_SPEEDS))  # of μ, of κ
_FAST_RADPS = 0.8  # yaw_rms_slow_rad leaves out faster spins
BAD_RAD = 0.5  # a larger error of the yaw is bad
GOOD_RAD = 0.2  # a smaller one is good
Z_95 = 1.96  # standard deviations
_STRAIGHT_RAD = 0.05  # most that the robot turns in a straight second
_STRAIGHT_M = 0.3  # least that it moves


def regression(samples):
    """Apparent (μ, κ) of the whole log: Σ xy / Σ x², NaN for a robot that never moves.

    x: speed or yaw rate by the encoders; y: the true value over ground.
    """
    coefficients = []
    for measured, truth in _REGRESSIONS:
        xy = samples[measured] * samples[truth]
        total = (samples[measured] ** 2)[xy.notna()].sum()
        coefficients.append(xy.sum() / total if total > 0 else np.nan)
    return tuple(coefficients)


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
        - not_good: share of the errors above GOOD_RAD;
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
            not_good=(error.abs() > GOOD_RAD)[error.notna()].mean(),
            nees_yaw=(error**2 / sigma**2).mean(),
            inside_95=(error.abs() <= Z_95 * sigma)[error.notna()].mean(),
            bad_unsure=is_unsure[error.abs() > BAD_RAD].mean(),
            good_unsure=is_unsure[error.abs() < GOOD_RAD].mean(),
        )
    if {"x_m", "y_m"} <= set(samples):
        off_m = (counted[f"{name}_hat_m"] - counted[f"{name}_m"] for name in "xy")
        values["position_rms_m"] = rms(*off_m)
    if set(TRUE_SPEEDS) <= set(samples):
        mu, kappa = regression(samples)
        values |= dict(
            mu_regression=mu,
            kappa_regression=kappa,
            mu_difference=values["mu_median"] - mu,
            kappa_difference=values["kappa_median"] - kappa,
        )
    return values


def perturbed_replay(
    log,
    seed,
    noise_m=0.02,
    yaw_error_rad=0.3,
    *,
    estimator="rhe",
    track_width_m=None,
    position_delay_s=0.0,
    trust_log=False,
    lever_arm_m=None,
    smooth=False,
    **fields,
):
    """Samples of a replay with noise and a wrong initial yaw added to the log.

    Args:
        log: DataFrame of a recording, as `rhec.replay` takes it.
        seed: Seed of the noise.
        noise_m: Standard deviation of the white noise on positions [m]. Its variance is added to
            that of a sigma_v, which describes the log.
        yaw_error_rad: Error of the initial yaw in each segment [rad]. Without the true yaw the
            initial yaw is estimated as in `rhec.replay`.
        estimator, track_width_m, position_delay_s, trust_log, lever_arm_m, smooth, **fields: As of
            `rhec.replay`.

    Returns:
        DataFrame, one row for each sample of the estimator.
    """
    recording = delayed(prepare(log, track_width_m), position_delay_s)
    if not trust_log:
        refuse(recording)
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
    return estimate_samples(recording, scenario, guess, smooth)


def save(name, table, caption, **about):
    """Write a table of docs/recorded_robots.md into figures/."""
    return style.save_table(table, f"table_recorded_{name}", caption, scenario=about or None)
