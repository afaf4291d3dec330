"""The runs that the claims are judged on, as data, and what is measured of them. Seeds start at 0;
those of the calibration are never used.

Every label is run under both readings of the process noise at the same seeds, so that row k of any
two tables of one length is the same field and the same noise. RUNS need their metrics alone and run
as one campaign; LOGS need what only each sample shows.
"""

from types import SimpleNamespace

import numpy as np
import pandas as pd

from rhec import paper
from rhec.campaigns.campaign import campaign
from rhec.estimator import ekf, rhe
from rhec.model.terrain import Terrain
from rhec.scenario import Scenario
from rhec.metrics import rms
from rhec.simulation import simulate
from rhec.studies.claims import estimators

READINGS = ("printed", "calibrated")
FIRST_ROW_S = 60.0  # at 0.5 m/s, less the slip, the robot is still on its first row of 30 m
LOOK_AHEAD_M = 0.5
MU, KAPPA = 0.9, 0.8  # the default soil's means, as constants
SLIPPERY = dict(kappa_mean=0.5, kappa_deviation=0.2, mu_mean=0.7, mu_deviation=0.15, speed_mps=0.3)
UNCERTAIN = dict(
    kappa_mean=0.6, kappa_deviation=0.16, mu_mean=0.8, mu_deviation=0.08, speed_mps=0.4
)


def a_row(**fields):
    return dict(duration_s=FIRST_ROW_S, **fields)


def on_constant_soil(**fields):
    return dict(terrain=Terrain.uniform(MU, KAPPA), **fields)


# label: (fields of the scenario, share of the seeds); a field may depend on the reading
RUNS = {
    "RHE": (dict(), 1.0),
    "EKF": (dict(estimator="ekf"), 0.4),
    "Q1": (a_row(q=paper.Q1), 0.1),
    "Q2": (a_row(q=paper.Q2), 0.1),
    "Q2, look-ahead": (a_row(q=paper.Q2, look_ahead_m=LOOK_AHEAD_M), 0.1),
    "Q3": (a_row(q=paper.Q3), 0.2),
    "Q2, small R": (a_row(q=paper.Q2, r=paper.R / 100), 0.2),
    "Q3, small R": (a_row(q=paper.Q3, r=paper.R / 100), 0.1),
    "Q3, no terminal penalty": (a_row(q=paper.Q3, qn_factor=0.0), 0.1),
    "traction told": (
        dict(estimator="traction_oracle", sigma_w=lambda process_noise: ekf.SIGMA_W[process_noise]),
        0.08,
    ),
    "traction hard-coded": (
        dict(estimator="fixed_traction", sigma_w=lambda process_noise: ekf.SIGMA_W[process_noise]),
        0.08,
    ),
    "RHE, constant soil": (on_constant_soil(), 0.2),
    "hard-coded, constant soil": (
        on_constant_soil(
            estimator="fixed_traction", sigma_w=lambda process_noise: ekf.SIGMA_W[process_noise]
        ),
        0.2,
    ),
    "RHE, uncertain soil": (UNCERTAIN, 0.08),
    "EKF, uncertain soil": (UNCERTAIN | dict(estimator="ekf"), 0.08),
    "yaw not estimated": (dict(estimator=lambda process_noise: estimators.dead_reckoned()), 0.2),
}


def scaled_traction_noise(factor):
    """The reading's W with the standard deviations of μ and κ times `factor`."""
    return lambda process_noise: (
        *rhe.SIGMA_W[process_noise][:4],
        *(factor * sigma for sigma in rhe.SIGMA_W[process_noise][4:]),
    )


LOGS = {
    "RHE": (dict(), 0.1),
    "RHE, small W": (dict(sigma_w=scaled_traction_noise(0.1)), 0.05),
    "RHE, constant parameters": (dict(sigma_w=scaled_traction_noise(0.0)), 0.05),
    "EKF": (dict(estimator="ekf"), 0.05),
    "EKF, path's yaw rate": (dict(estimator="ekf", input_reference="curvature"), 0.05),
    "augmented EKF, slippery soil": (
        SLIPPERY | dict(estimator="augmented_ekf", duration_s=120.0),
        0.4,
    ),
    "RHE, slippery soil": (SLIPPERY | dict(duration_s=120.0), 0.1),
    "augmented EKF": (dict(estimator="augmented_ekf"), 0.05),
    "RHE, nothing disturbs": (
        on_constant_soil(gnss_sigma_m=0.0, encoder_sigma_mps=0.0, bump_sigma_radps=0.0),
        0.01,
    ),
}


def scenarios(fields, process_noise, seeds):
    """The scenarios of a label: its fields under a reading, one a seed."""
    fields = {
        name: value(process_noise) if callable(value) and not hasattr(value, "serialize") else value
        for name, value in fields.items()
    }
    return [Scenario(process_noise=process_noise, seed=seed, **fields) for seed in range(seeds)]


def runs(seeds):
    """{reading: {label: one row a seed with the run's metrics}} of RUNS, as one campaign; `seeds`
    is the largest number of fields.
    """
    asked = {
        (process_noise, label): scenarios(fields, process_noise, max(2, round(share * seeds)))
        for process_noise in READINGS
        for label, (fields, share) in RUNS.items()
    }
    table = campaign([scenario for each in asked.values() for scenario in each])
    found, begin = {process_noise: {} for process_noise in READINGS}, 0
    for (process_noise, label), each in asked.items():
        found[process_noise][label] = complete(
            table.iloc[begin : begin + len(each)].reset_index(drop=True)
        )
        begin += len(each)
    return found


def complete(table):
    """Metrics with nothing missing: a robot that never arrives has used up all its time, and
    `arrived` says so. RuntimeError if a run failed.
    """
    failed = table["error"][table["error"] != ""]
    if len(failed):
        raise RuntimeError(
            f"{len(failed)} of {len(table)} runs failed, the first with: {failed.iloc[0]}"
        )
    return table.assign(
        arrived=table["settling_time_s"].notna(),
        settling_time_s=table["settling_time_s"].fillna(table["duration_s"]),
    )


def logs(seeds):
    """The same of LOGS, one row a seed with `measured` beside the metrics."""
    return {
        process_noise: {
            label: pd.DataFrame(
                [
                    measured(simulate(scenario))
                    for scenario in scenarios(fields, process_noise, max(2, round(share * seeds)))
                ]
            )
            for label, (fields, share) in LOGS.items()
        }
        for process_noise in READINGS
    }


def measured(run):
    """What only the log of a run shows, beside its metrics; SI units. "Late" is the second half of
    the run.
    """
    c, scenario = SimpleNamespace(**run.columns), run.scenario
    settling_time_s = (
        scenario.duration_s
        if np.isnan(run.metrics["settling_time_s"])
        else run.metrics["settling_time_s"]
    )
    driving, late = (
        c.t_s >= 5.0,
        c.t_s >= scenario.duration_s / 2,
    )  # the first 5 s are the speed loops' start
    before, after = c.t_s <= settling_time_s, c.t_s >= settling_time_s
    both = np.concatenate([c.mu_hat, c.kappa_hat])
    _, s = run.path.project(np.column_stack([c.x_m, c.y_m]))
    poses, curvature = run.path.poses(s)
    left_m = (c.y_m - poses[:, 1]) * np.cos(poses[:, 2]) - (c.x_m - poses[:, 0]) * np.sin(
        poses[:, 2]
    )
    curved = (curvature > 0) & (c.t_s >= settling_time_s + 5)
    return run.metrics | dict(
        late_s=c.t_s[-1] - c.s_m[-1] / scenario.speed_mps,
        arrived=not np.isnan(run.metrics["settling_time_s"]),
        settling_time_s=settling_time_s,
        in_bounds=bool(np.all((both >= 0) & (both <= 1))),
        below_zero=bool(np.any(both < 0)),
        above_one=bool(np.any(both > 1)),
        near_bound=np.mean((c.mu_hat >= 0.9) & (c.kappa_hat >= 0.9)),
        deviation_mu_late=c.mu_hat[late].std(),
        deviation_kappa_late=c.kappa_hat[late].std(),
        step_kappa=rms(np.diff(c.kappa_hat)),
        lag_mu_s=lag_s(c.mu_hat, c.mu),
        yaw_bias_rad=np.mean((c.theta_hat_rad - c.theta_rad)[curved]) if curved.any() else 0.0,
        offset_curves_m=left_m[curved].mean() if curved.any() else 0.0,
        speed_variation=c.nu_mps[driving].std() / abs(c.nu_mps[driving].mean()),
        rms_nu_hat_mps=rms((c.nu_hat_mps - c.nu_mps)[driving]),
        rms_nu_meas_mps=rms((c.nu_meas_mps - c.nu_mps)[driving]),
        rms_yaw_rate_radps=rms(c.omega_radps[1:] - c.omega_cmd_radps[:-1]),
        reaches_bound=bool(
            np.abs(c.omega_cmd_radps).max() >= scenario.omega_max_radps * (1 - 1e-9)
        ),
        within_bound=bool(np.all(np.abs(c.omega_cmd_radps) <= scenario.omega_max_radps)),
        kkt_rhc_largest_first=bool(c.t_s[np.argmax(c.kkt_rhc)] <= settling_time_s),
        kkt_rhc_before=np.median(c.kkt_rhc[before]),
        kkt_rhc_after=np.median(c.kkt_rhc[after]) if after.any() else np.median(c.kkt_rhc),
        kkt_rhc_late=np.median(c.kkt_rhc[late]),
        kkt_rhe_first=np.median(c.kkt_rhe[1:16]),
        kkt_rhe_late=np.median(c.kkt_rhe[late]),
    )


def lag_s(estimate, truth, most_s=10.0):
    """How far an estimate trails the truth: the shift that leaves the least RMS difference [s], up
    to most_s.
    """
    shifts = range(round(most_s / paper.DT_S) + 1)
    return paper.DT_S * int(
        np.argmin([rms(estimate[shift:] - truth[: len(truth) - shift]) for shift in shifts])
    )
