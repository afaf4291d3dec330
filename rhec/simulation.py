"""The closed loop as a fold: one sample is a pure Function from (memory, noise) to (memory, log
row), a run is that Function folded over time.

    noise_k ─► robot ─ z_k ─► estimator ─ ξ̂, p̂ ─► path ─ ξ_r, ω_r ─► controller ─ ω ─► robot …

Every tuning is an argument of the Function, so that changing a weight compiles nothing; only what
changes its shape does.
"""

import functools
from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec._casadi import compiled, scan
from rhec._casadi.build import pack_array, packed_size, select_inputs, unpack, with_packed_memory
from rhec._casadi.renamed import Renamed
from rhec._casadi.validation import shown
from rhec.controller import rhc
from rhec.estimator import base as estimators
from rhec.estimator.kalman import is_valid_measurement
from rhec.extensions import faults
from rhec.model import path, robot, terrain
from rhec.scenario import Scenario

# One row of the log, in order: what `sample` returns beside the memory.
LOG = dict(
    truth=("x_m", "y_m", "theta_rad", "nu_mps", "mu", "kappa"),
    omega=("omega_radps",),
    z=("x_meas_m", "y_meas_m", "nu_meas_mps", "omega_meas_radps"),
    estimate=("x_hat_m", "y_hat_m", "theta_hat_rad", "nu_hat_mps", "mu_hat", "kappa_hat"),
    command=("omega_cmd_radps",),
    s=("s_m",),
    curvature=("curvature_radpm",),
    kkt_rhe=("kkt_rhe",),
    kkt_rhc=("kkt_rhc",),
    deviance=("deviance",),
    ok=("ok",),
)
SETTLING_SAMPLES = round(
    5 / paper.DT_S
)  # samples: who stays within the tolerance so long has arrived
COLUMNS = [column for columns in LOG.values() for column in columns]


class LoopStructure(NamedTuple):
    """What decides the shape of the loop's Function, and so what is compiled."""

    estimator: str  # one of estimators.NAMES, or a serialized Function
    prediction_horizon: int
    estimation_horizon: int
    speed_model: str
    arrival_mean: str
    robust: bool
    input_reference: str
    qp: str
    n_segments: int
    terrain_shape: tuple
    faulty: bool  # sensors with faults: what is not there costs nothing


def build_sample(*structure):
    """One sample of the closed loop, (memory, noise, settings …) -> (memory, row), ready to be
    folded.
    """
    structure = LoopStructure(*structure)
    measure, drive = robot.measure(paper.DT_S), robot.drive(paper.DT_S)
    estimate_step = estimators.step(
        structure.estimator,
        structure.estimation_horizon,
        structure.speed_model,
        structure.arrival_mean,
        structure.qp,
        structure.robust,
    )
    references = path.build_references(
        paper.DT_S, structure.prediction_horizon, structure.n_segments, structure.input_reference
    )["references"]
    control = rhc.build_phases(paper.DT_S, structure.prediction_horizon, structure.qp)["step"]
    slip = terrain.lookup(structure.terrain_shape)
    deliver = faults.deliver()
    sensors = faults.MEMORY if structure.faulty else {}
    stream = robot.NOISE | (faults.STREAM if structure.faulty else {})

    memory = (
        robot.MEMORY
        | dict(
            estimator=(estimate_step.numel_in(0), 1),
            s=(1, 1),
            controller=(control.numel_in(0), 1),
            command=(1, 1),
        )
        | sensors
    )
    settings = (
        robot.SENSORS
        | robot.BODY
        | dict(
            **{
                name: (
                    estimate_step.size1_in(name) if name in estimate_step.name_in() else unused,
                    1,
                )
                for name, unused in (("V", 4), ("W", 1))
            },
            segments=(5, structure.n_segments),
            period_m=(1, 1),
            look_ahead_m=(1, 1),
            backwards=(1, 1),
            Q=(3, 1),
            QN=(3, 1),
            R=(1, 1),
            omega_max=(1, 1),
            speed_mps=(1, 1),
            command_delay=(1, 1),
            origin_m=(2, 1),
            cell_m=(1, 1),
            slip=(slip.numel_in("slip"), 1),
            mean_traction=(2, 1),
        )
    )

    def sample(
        pose,
        tracks,
        integral,
        drift,
        encoders,
        estimator,
        s,
        controller,
        command,
        noise,
        **settings,
    ):
        noise = unpack(noise, stream)
        traction = slip(pose[:2], settings["origin_m"], settings["cell_m"], settings["slip"])
        nu, omega = robot.body_speeds(tracks, settings["track_width_m"])
        truth = ca.vertcat(pose, nu, traction)

        measured = measure(
            **select_inputs(measure, noise | settings), pose=pose, drift=drift, encoders=encoders
        )
        if structure.faulty:
            measured |= deliver(**select_inputs(deliver, measured | noise | settings))
        z = measured["z"]

        told = dict(traction_oracle=traction, fixed_traction=settings["mean_traction"]).get(
            structure.estimator, ca.DM.ones(2)
        )
        known = settings | dict(truth=truth, traction=told)
        inputs = [estimator, z] + [known[name] for name in estimate_step.name_in()[2:]]
        outputs = dict(
            zip(["memory", "estimate", *estimate_step.name_out()[2:]], estimate_step.call(inputs))
        )
        estimate = outputs["estimate"]

        believed = outputs.get("z_used", z)
        omega_measured = ca.if_else(is_valid_measurement(believed, 3), believed[3], command)
        target = references(
            **select_inputs(references, settings),
            s=s,
            estimate=estimate,
            omega_measured=omega_measured,
        )
        planned = control(
            **select_inputs(control, settings),
            memory=controller,
            s_0=estimate,
            xi_ref=target["xi_ref"],
            omega_ref=target["omega_ref"],
        )
        newest = planned["command"]
        applied = ca.if_else(settings["command_delay"], command, newest)

        driven = drive(
            **select_inputs(drive, noise | settings),
            pose=pose,
            tracks=tracks,
            integral=integral,
            traction=traction,
            omega_radps=applied,
        )
        row = dict(
            truth=truth,
            omega=omega,
            z=z,
            estimate=estimate,
            command=newest,
            s=target["s"],
            curvature=target["curvature"],
            kkt_rhe=outputs.get("kkt", ca.DM.nan(1)),
            kkt_rhc=planned["kkt"],
            deviance=outputs.get("deviance", ca.DM.nan(1)),
            ok=ca.fmin(outputs.get("ok", 1), planned["ok"]),
        )
        return dict(
            row=ca.vertcat(*(row[name] for name in LOG)),
            drift=measured["drift"],
            estimator=outputs["memory"],
            s=target["s"],
            controller=planned["memory"],
            command=newest,
            **driven,
            **{name: measured[name] for name in sensors},
        )

    sample = with_packed_memory(
        "sample", sample, memory, dict(noise=(packed_size(stream), 1)) | settings
    )
    return scan.build_scan(sample)


@dataclass(frozen=True)
class Setup:
    """What a scenario amounts to in numbers: the loop's structure, first memory and settings, and
    where its path and soil come from.
    """

    structure: LoopStructure
    memory: np.ndarray
    settings: dict
    path: path.Path
    terrain: terrain.Terrain
    guess: np.ndarray  # (x, y, θ, ν, μ, κ), the estimator's first


def set_up(scenario):
    """Path, soil, starting point and settings of a scenario."""
    target = scenario.path or path.Path.racetrack(scenario.row_length_m, scenario.headland_radius_m)
    soil = scenario.terrain or terrain.random_for(scenario, target)

    (pose,), _ = target.poses([0.0])
    x, y, theta = pose
    backwards = -1.0 if scenario.backwards else 1.0
    speed_mps = backwards * scenario.speed_mps
    pose = np.array(
        [
            x - scenario.start_offset_m * np.sin(theta),
            y + scenario.start_offset_m * np.cos(theta),
            theta + scenario.start_yaw_rad + np.pi * scenario.backwards,
        ]
    )
    guess = np.array([*pose + (0, 0, scenario.guess_yaw_rad), speed_mps, 1.0, 1.0])

    shape = terrain.common_shape(soil)
    structure = LoopStructure(
        estimators.estimator_key(scenario.estimator),
        scenario.prediction_horizon,
        scenario.estimation_horizon,
        scenario.speed_model,
        scenario.arrival_mean,
        scenario.robust,
        scenario.input_reference,
        scenario.qp,
        len(target.segments),
        shape,
        bool(scenario.faults),
    )
    memory = (
        robot.init(pose, speed_mps)
        | dict(
            estimator=estimators.first_memory(scenario, guess),
            s=target.project(pose[None, :2])[1],
            controller=pack_array(rhc.init(guess[:3], guess[3:], scenario.prediction_horizon)),
            command=0.0,
        )
        | (faults.init() if scenario.faults else {})
    )
    slow = scenario.gnss_slow_share
    settings = dict(
        gnss_white_m=scenario.gnss_sigma_m * np.sqrt(1 - slow),
        gnss_slow_m=scenario.gnss_sigma_m * np.sqrt(slow),
        gnss_slow_time_s=scenario.gnss_slow_time_s,
        track_width_m=scenario.track_width_m,
        encoder_sigma_mps=scenario.encoder_sigma_mps,
        bump_sigma_radps=scenario.bump_sigma_radps,
        **estimators.noise_settings(scenario),
        segments=target.segments.T,
        period_m=target.period_m,
        look_ahead_m=scenario.look_ahead_m,
        backwards=float(scenario.backwards),
        Q=np.array(scenario.q),
        QN=scenario.qn_factor * np.array(scenario.q),
        R=scenario.r,
        omega_max=scenario.omega_max_radps,
        speed_mps=speed_mps,
        command_delay=float(scenario.command_delay),
        origin_m=np.array(soil.origin_m),
        cell_m=soil.cell_m,
        slip=terrain.flat(soil, shape),
        mean_traction=soil.mean,
    )
    return Setup(structure, pack_array(memory), settings, target, soil, guess)


def draw_noise(seed, samples):
    """Standard normal noise (samples, n) of a seed; the first rows do not depend on how many are
    drawn.
    """
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, 1)))).standard_normal(
        (samples, packed_size(robot.NOISE))
    )


def noise_and_faults(scenario, samples):
    """The stream that a run is folded over: noise, and what the sensors' faults do, one row a
    sample.
    """
    noise = draw_noise(scenario.seed, samples)
    return (
        np.hstack([noise, faults.stream(scenario.faults, samples, paper.DT_S, scenario.seed)])
        if scenario.faults
        else noise
    )


@dataclass(frozen=True)
class Run:
    """A finished run: what it was, what is reported of it, where it drove."""

    scenario: Scenario
    metrics: dict
    path: path.Path
    terrain: terrain.Terrain
    columns: dict

    @functools.cached_property
    def log(self):
        """One row a sample, as a DataFrame; columns: README, "The log"."""
        # half of all the time it takes to import this package, and a campaign never looks at a log
        import pandas as pd

        return pd.DataFrame(self.columns)


def simulate(scenario):
    """Run a scenario: rhec.Run. A structure's first run compiles it for some seconds; it is cached
    from then on.
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario was {shown(scenario)}; it should be a rhec.Scenario")
    return simulate_setup(scenario, set_up(scenario))


def simulate_setup(scenario, made):
    """The run of a scenario whose World is made."""
    samples = round(scenario.duration_s / paper.DT_S)
    _, rows = scan.scan(
        compiled.load(build_sample, *made.structure),
        made.memory,
        noise_and_faults(scenario, samples),
        made.settings,
    )
    columns = {"t_s": np.arange(samples) * paper.DT_S} | dict(zip(COLUMNS, rows.T))
    columns["ok"] = columns["ok"] == 1
    measured = rows[:, [COLUMNS.index("x_meas_m"), COLUMNS.index("y_meas_m")]]
    columns["error_m"], _ = made.path.project(
        np.where(np.isfinite(measured).all(axis=1, keepdims=True), measured, np.nan)
    )
    columns["error_true_m"], s = made.path.project(
        rows[:, [COLUMNS.index("x_m"), COLUMNS.index("y_m")]]
    )
    poses, curvatures = made.path.poses(s)
    columns["on_straight"] = curvatures == 0
    return Run(scenario, metrics(columns, poses), made.path, made.terrain, columns)


def metrics(columns, poses):
    """What is reported of a run with these log columns whose closest path points are `poses` (n,
    3); errors in m, times in s.

    The robot has arrived when its true error stays within the tolerance for 5 s; errors and
    violations count from the end of these 5 s, and on the whole run of a robot that never arrives.
    `mean_error_m` is the paper's: raw GNSS to the path (reading R11), over the samples that have a
    position. Overshoot: how far beyond the path, seen from the start, the robot gets on the first
    row.
    """
    c = SimpleNamespace(**columns)
    stays = settled_samples(c.error_true_m)
    arrived = len(stays) > 0
    after = slice(
        stays[0] + SETTLING_SAMPLES if arrived and stays[0] + SETTLING_SAMPLES < len(c.t_s) else 0,
        None,
    )
    straight = c.on_straight[after]
    left = (c.y_m - poses[:, 1]) * np.cos(poses[:, 2]) - (c.x_m - poses[:, 0]) * np.sin(poses[:, 2])
    first_row = left[: np.argmin(c.on_straight) or None]
    omega = np.abs(c.omega_cmd_radps)
    values = dict(
        settling_time_s=c.t_s[stays[0]] if arrived else np.float64(np.nan),
        mean_error_m=mean_of_known(c.error_m[after]),
        mean_error_true_m=c.error_true_m[after].mean(),
        max_error_true_m=c.error_true_m[after].max(),
        mean_error_from_start_m=mean_of_known(c.error_m),
        violations=np.sum(c.error_m[after][straight] > paper.TOLERANCE_M),
        violations_true=np.sum(c.error_true_m[after][straight] > paper.TOLERANCE_M),
        overshoot_m=np.maximum((-np.sign(left[0]) * first_row).max(), 0.0),
        rms_mu=rms((c.mu_hat - c.mu)[after]),
        rms_kappa=rms((c.kappa_hat - c.kappa)[after]),
        rms_yaw_rad=rms((c.theta_hat_rad - c.theta_rad)[after]),
        omega_peak_radps=omega.max(),
        kkt_rhe_median=np.median(c.kkt_rhe[after]),
        kkt_rhc_median=np.median(c.kkt_rhc[after]),
        all_ok=c.ok.all(),
    )
    # plain numbers, whatever NumPy made of them
    return Renamed({name: value.item() for name, value in values.items()})


def settled_samples(error, within=paper.TOLERANCE_M):
    """The samples from which on the error (n,) stays within so much, unless told the tolerance [m],
    for 5 s.
    """
    inside = error < within
    return (
        np.flatnonzero(np.convolve(inside, np.ones(SETTLING_SAMPLES), "valid") == SETTLING_SAMPLES)
        if len(inside) > SETTLING_SAMPLES
        else np.array([], dtype=int)
    )


def mean_of_known(values):
    """Their mean without those that are NaN; NaN of none."""
    known = values[~np.isnan(values)]
    return known.mean() if len(known) else np.float64(np.nan)


def rms(values):
    return np.sqrt(np.mean(np.square(values)))
