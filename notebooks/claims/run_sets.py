"""The simulated drives that the claims are judged on, and what is measured of them.

Seeds start at 0; those of the calibration are never used. Every id is run at the same seeds, under
whichever process noise, so that row k of any two tables is the same field and the same noise. RUNS
need their metrics alone and run as one campaign; LOGS need what only each sample shows.
"""

import dataclasses
import itertools
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pandas as pd

from notebooks.further.rivals import ltv_mpc
from notebooks.rivals import RIVALS, by_name
from notebooks.studies import parallel
from rhec import paper
from rhec.simulation.campaigns.store import scenario_key
from rhec.simulation.metrics import rms
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import tuning
from rhec.tracked_robot.terrain import Terrain

PROCESS_NOISES = ("printed", "prediction")
LOOK_AHEAD_M = 0.5
_SWING_M = 0.05  # an offset to one side and then to the other counts as a swing from here on
_SLIPPERY = dict(kappa_mean=0.5, kappa_deviation=0.2, mu_mean=0.7, mu_deviation=0.15, speed_mps=0.3)
_SLIPPERY |= dict(duration_s=120.0)
_UNSURE = dict(kappa_mean=0.6, kappa_deviation=0.16, mu_mean=0.8, mu_deviation=0.08, speed_mps=0.4)
_ON_ROW = dict(duration_s=60.0)  # at 0.5 m/s, less the slip, still on the first row of 30 m
_CONSTANT = dict(terrain=Terrain.uniform(Scenario.mu_mean, Scenario.kappa_mean))  # the means
_NOISES = "gnss_sigma_m encoder_sigma_mps speed_sigma_mps bump_sigma_radps slip_difference".split()
_UNDISTURBED = dict.fromkeys(_NOISES, 0.0)
_PATH_YAW_RATE = dict(estimator="ekf", input_reference="curvature")
_ORACLE = dict(estimator="oracle", process_noise="printed")  # it has no W


def _traction_noise_times(factor):
    """The RHE's W, a world's own if it has one, with the deviations of μ and κ times `factor`."""
    factors = (1, 1, 1, 1, factor, factor)

    def of(process_noise, world):
        sigma_w = world.get("sigma_w") or tuning.NOISES["rhe"][process_noise].sigma_w
        return tuple(np.multiply(factors, sigma_w).tolist())

    return of


def _dead_reckoning(process_noise, world):
    """An estimator (memory, z) -> (memory, estimate) that does not estimate the yaw.

    The yaw is the sum of the encoders' yaw rates since the start. Position and speed are as
    measured, and there is no slip. The estimate is the memory.
    """
    memory = ca.SX.sym("memory", 6)
    z = ca.SX.sym("z", 4)
    estimate = ca.vertcat(z[:2], memory[2] + paper.DT_S * z[3], z[2], 1, 1)
    options = {"allow_duplicate_io_names": True}
    return ca.Function("dead_reckoned", [memory, z], [estimate, estimate], options)


def _like_rhe(estimator):
    """Fields of an estimator whose W is by the same rule as the RHE's.

    Where that rule was not tuned for it, it has the RHE's own W and V, without those of what it
    does not estimate.
    """
    own = tuning.noises_of(by_name(estimator))
    of_rhe = tuning.NOISES["rhe"]
    entries = len(own["printed"].sigma_w)
    return dict(
        estimator=by_name(estimator),
        process_noise=lambda rule, world: rule if rule in own else None,
        sigma_w=lambda rule, world: None if rule in own else of_rhe[rule].sigma_w[:entries],
        sigma_v=lambda rule, world: None if rule in own else of_rhe[rule].sigma_v,
    )


_LEFT = dict(turns="left")
_FROM_THE_OTHER_SIDE = dict(start_offset_m=-paper.START_OFFSET_M)
_SMOOTHED = dict(arrival_mean="smoothed")

# id: fields of Scenario; a field may be a function of the process noise and the world, the
# controller is one of the Scenario
RUNS = {
    "rhe": dict(),
    "rhe_smoothed": _SMOOTHED,
    "rhe_constant_parameters": dict(sigma_w=_traction_noise_times(0.0)),
    "ekf": dict(estimator="ekf"),
    "oracle": _ORACLE,
    "no_slip": _like_rhe("rhe_no_slip"),
    "fixed_traction": _like_rhe("rhe_fixed_traction"),
    "bounded_ekf": _like_rhe("bounded_ekf"),
    "rhe_left": _LEFT,
    "ekf_left": _LEFT | dict(estimator="ekf"),
    "no_slip_left": _LEFT | _like_rhe("rhe_no_slip"),
    "fixed_traction_left": _LEFT | _like_rhe("rhe_fixed_traction"),
    "rhe_constant": _CONSTANT,
    "fixed_traction_constant": _CONSTANT | dict(estimator=RIVALS["rhe_fixed_traction"]),
    "rhe_uncertain": _UNSURE,
    "no_slip_uncertain": _UNSURE | dict(estimator=RIVALS["rhe_no_slip"]),
    "fixed_traction_uncertain": _UNSURE | dict(estimator=RIVALS["rhe_fixed_traction"]),
    "oracle_uncertain": _UNSURE | _ORACLE,
    "ltv_mpc": dict(controller=ltv_mpc.controller),
    "dead_reckoning": dict(estimator=_dead_reckoning, process_noise="printed"),  # it has no W
    "oracle_row": _ORACLE | _ON_ROW,
    "q1": dict(q=paper.Q1) | _ON_ROW,
    "q2": dict(q=paper.Q2) | _ON_ROW,
    "q2_look_ahead": dict(q=paper.Q2, look_ahead_m=LOOK_AHEAD_M) | _ON_ROW,
    "q2_other_side": dict(q=paper.Q2) | _ON_ROW | _FROM_THE_OTHER_SIDE,
    "q3": dict(q=paper.Q3) | _ON_ROW,
    "q3_other_side": dict(q=paper.Q3) | _ON_ROW | _FROM_THE_OTHER_SIDE,
    "q2_small_r": dict(q=paper.Q2, r=paper.R / 100) | _ON_ROW,
    "q3_small_r": dict(q=paper.Q3, r=paper.R / 100) | _ON_ROW,
    "q3_no_terminal_weight": dict(q=paper.Q3, qn_factor=0.0) | _ON_ROW,
    "augmented_ekf_slippery": _SLIPPERY | dict(estimator=RIVALS["augmented_ekf"]),
    "bounded_ekf_slippery": _SLIPPERY | dict(estimator="bounded_ekf"),
}
LOGS = {
    "rhe": dict(),
    "rhe_smoothed": _SMOOTHED,
    "no_slip": _like_rhe("rhe_no_slip"),
    "rhe_small_w": dict(sigma_w=_traction_noise_times(0.1)),
    "rhe_poor_start": dict(guess_yaw_rad=1.0),
    "rhe_undisturbed": _CONSTANT | _UNDISTURBED,
    "ekf": dict(estimator="ekf"),
    "ekf_path_yaw_rate": _PATH_YAW_RATE,
    "ekf_path_yaw_rate_undisturbed": _CONSTANT | _UNDISTURBED | _PATH_YAW_RATE,
    "ekf_undisturbed": _CONSTANT | _UNDISTURBED | dict(estimator="ekf"),
    "augmented_ekf": dict(estimator=RIVALS["augmented_ekf"]),
    "bounded_ekf": dict(estimator="bounded_ekf"),
    "q2": dict(q=paper.Q2) | _ON_ROW,
    "q2_other_side": dict(q=paper.Q2) | _ON_ROW | _FROM_THE_OTHER_SIDE,
    "q2_slow": dict(q=paper.Q2, speed_mps=0.3, duration_s=100.0),
    "q2_fast": dict(q=paper.Q2, speed_mps=0.7, duration_s=42.0),
}
# Drives along the first row alone; LOGS of another speed bring their own time.
ON_ROW = {id_ for id_ in RUNS if RUNS[id_].get("duration_s") == _ON_ROW["duration_s"]}
ON_ROW |= {"q2", "q2_other_side"}
_FIELDS = "duration_s mu_deviation kappa_deviation".split()  # of Scenario, columns of each table


# Runs


def fields_of(fields, process_noise, world):
    """Fields of RUNS or LOGS but for a controller, under a process noise in a world."""
    return {
        name: of(process_noise, world) if callable(of) else of
        for name, of in fields.items()
        if name != "controller"
    }


def scenarios(fields, process_noise, seeds, world=None):
    """The scenarios of an id under a process noise, one a seed.

    Args:
        fields: Of RUNS or LOGS; they take precedence over those of the world.
        process_noise: "printed" or "prediction".
        seeds: Seeds of the fields.
        world: Fields of Scenario.
    """
    world = world or {}
    every = world | dict(process_noise=process_noise) | fields_of(fields, process_noise, world)
    made = [Scenario(seed=seed, **every) for seed in seeds]
    if "controller" not in fields:
        return made
    controller = fields["controller"](made[0])
    return [dataclasses.replace(scenario, controller=controller) for scenario in made]


def measure(scenarios, folder=None):
    """The tables of RUNS and LOGS for the scenarios of each name.

    What is `measured` of logs contains the metrics, so runs whose logs are needed, too, are driven
    once.

    Args:
        scenarios: {kind: {name: scenarios}}; "runs" for metrics alone, "logs" for what is
            `measured` of the logs, too.
        folder: Where the campaign of "runs" keeps its rows.

    Returns:
        {name: DataFrame, one row a scenario, with the length and the soil's deviations}.
    """
    logs = scenarios.get("logs", {})
    runs = scenarios.get("runs", {})
    rows = iter(parallel.map_runs(measured, list(itertools.chain(*logs.values()))))
    tables = {
        name: pd.DataFrame([next(rows) for _ in part]).assign(**_columns_of(part))
        for name, part in logs.items()
    }
    keys = {name: _keys_of(part) for name, part in (logs | runs).items()}
    of_logs = {keys[name]: table for name, table in tables.items()}
    rest = {name: part for name, part in runs.items() if keys[name] not in of_logs}
    tables |= drive(rest, folder) if rest else {}
    return tables | {name: of_logs[keys[name]] for name in runs if name not in rest}


def _keys_of(scenarios):
    """What two equal lists of scenarios have in common."""
    return tuple(map(scenario_key, scenarios))


def _columns_of(scenarios):
    """{field: its value in each scenario} of the fields that rules need."""
    return {name: [getattr(scenario, name) for scenario in scenarios] for name in _FIELDS}


def drive(scenarios, folder=None):
    """Metrics of {name: scenarios}, made as one campaign: {name: DataFrame, one row a run}."""
    tables = parallel.drive(scenarios, folder)
    return {
        name: complete(table.assign(**_columns_of(scenarios[name])))
        for name, table in tables.items()
    }


def complete(table):
    """Metrics with nothing missing.

    A robot that never arrives has used up all its time; the column `arrived` says so.

    Raises:
        RuntimeError: If a run failed.
    """
    failed = table["error"][table["error"] != ""]
    settling = table["settling_time_s"]
    if len(failed):
        first = failed.iloc[0]
        raise RuntimeError(f"{len(failed)} of {len(table)} runs failed, the first with: {first}")
    used_up = settling.fillna(table["duration_s"])
    return table.assign(arrived=settling.notna(), settling_time_s=used_up)


# What is measured


def measured(run):
    """Metrics of a run and what only its log shows; SI units. "Late" is the run's second half."""
    c = SimpleNamespace(**run.columns)
    arrived = not np.isnan(run.metrics["settling_time_s"])
    settling_time_s = run.metrics["settling_time_s"] if arrived else run.scenario.duration_s
    late_s = c.t_s[-1] - c.s_m[-1] / run.scenario.speed_mps
    return (
        run.metrics
        | dict(late_s=late_s, arrived=arrived, settling_time_s=settling_time_s)
        | _traction(run, c)
        | _offsets(run, c, settling_time_s)
        | _speeds_and_commands(run, c)
        | _kkt(run, c, settling_time_s)
    )


def _traction(run, c):
    """Bounds, spread and lag of the traction estimates."""
    both = np.concatenate([c.mu_hat, c.kappa_hat])
    late = c.t_s >= run.scenario.duration_s / 2
    return dict(
        in_bounds=bool(np.all((both >= 0) & (both <= 1))),
        above_one=bool(np.any(both > 1)),
        near_bound=np.mean((c.mu_hat >= 0.9) & (c.kappa_hat >= 0.9)),
        deviation_kappa_late=c.kappa_hat[late].std(),
        step_kappa=rms(np.diff(c.kappa_hat)),
        lag_mu_s=lag_s(c.mu_hat, c.mu),
    )


def _offsets(run, c, settling_time_s):
    """Yaw bias and offset to the left in curves to either hand, swings, and metres of row.

    Soil that slips on one side turns the robot to one hand, so that what a curve to the left shows
    one to the right need not: `yaw_bias_rad` and `offset_curves_m` are means of the absolute values
    over both hands. A hand without a curve that counts is left out; without any they are zero.
    """
    poses, curvature = _along_path(run, c)
    x_m, y_m, theta_rad = poses.T
    left_m = (c.y_m - y_m) * np.cos(theta_rad) - (c.x_m - x_m) * np.sin(theta_rad)
    counted = c.t_s >= settling_time_s + 5
    hands = dict(left=(curvature > 0) & counted, right=(curvature < 0) & counted)
    hands = {hand: curved for hand, curved in hands.items() if curved.any()}
    yaw_error_rad = c.theta_hat_rad - c.theta_rad
    bias_rad = {hand: yaw_error_rad[curved].mean() for hand, curved in hands.items()}
    offset_m = {hand: left_m[curved].mean() for hand, curved in hands.items()}
    side = np.sign(left_m[np.abs(left_m) > _SWING_M])
    row_m = paper.DT_S * np.sum((c.mu * np.abs(c.nu_mps))[counted & c.on_straight])
    return dict(
        yaw_bias_rad=_mean_size(bias_rad),
        yaw_bias_left_rad=bias_rad.get("left", 0.0),
        yaw_bias_right_rad=bias_rad.get("right", 0.0),
        offset_curves_m=_mean_size(offset_m),
        swings=np.sum(np.diff(side) != 0),
        row_m=row_m,
    )


def _along_path(run, c):
    """Poses (n, 3) and curvatures (n,) of the path at its points closest to the robot."""
    _, s = run.path.project(np.column_stack([c.x_m, c.y_m]))
    return run.path.poses(s)


def _mean_size(by_hand):
    """The mean absolute value of a dict's numbers; zero of none."""
    return float(np.mean(np.abs([*by_hand.values()]))) if by_hand else 0.0


def _speeds_and_commands(run, c):
    """Speed, its estimate, and the commanded yaw rate relative to its bound."""
    driving = c.t_s >= 5.0  # until then the speed loops start
    peak_radps = np.abs(c.omega_cmd_radps).max()
    bound_radps = run.scenario.omega_max_radps
    return dict(
        speed_variation=c.nu_mps[driving].std() / abs(c.nu_mps[driving].mean()),
        rms_nu_hat_mps=rms((c.nu_hat_mps - c.nu_mps)[driving]),
        rms_nu_meas_mps=rms((c.nu_meas_mps - c.nu_mps)[driving]),
        rms_yaw_rate_radps=rms(c.omega_radps[1:] - c.omega_cmd_radps[:-1]),
        reaches_bound=bool(peak_radps >= bound_radps * (1 - 1e-9)),
        within_bound=bool(peak_radps <= bound_radps),
    )


def _kkt(run, c, settling_time_s):
    """KKT tolerances: medians before and after arrival, at the start and late.

    A step that was rejected has none.
    """
    late = c.t_s >= run.scenario.duration_s / 2
    before = c.t_s <= settling_time_s
    after = c.t_s >= settling_time_s
    return dict(
        kkt_rhc_largest_first=bool(c.t_s[np.nanargmax(c.kkt_rhc)] <= settling_time_s),
        kkt_rhc_before=_median(c.kkt_rhc[before]),
        kkt_rhc_after=_median(c.kkt_rhc[after]) if after.any() else _median(c.kkt_rhc),
        kkt_rhc_late=_median(c.kkt_rhc[late]),
        kkt_rhe_first=_median(c.kkt_rhe[1:16]),  # 3 s; the first sample has no problem yet
        kkt_rhe_late=_median(c.kkt_rhe[late]),
    )


def _median(values):
    """Median of what is not NaN; NaN of nothing, as other estimators than the RHE have it."""
    finite = values[~np.isnan(values)]
    return np.median(finite) if len(finite) else np.nan


def lag_s(estimate, truth, most_s=10.0):
    """How far an estimate trails the truth [s]: the shift, up to most_s, of least RMS error."""
    shifts = range(round(most_s / paper.DT_S) + 1)
    differences = (estimate[shift:] - truth[: len(truth) - shift] for shift in shifts)
    mean_squares = [difference @ difference / len(difference) for difference in differences]
    return paper.DT_S * int(np.argmin(mean_squares))
