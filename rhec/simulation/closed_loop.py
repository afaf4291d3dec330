"""The closed loop: one sample as a pure Function, a run as that Function scanned over time.

    noise_k ─► robot ─ z_k ─► estimator ─ ξ̂, p̂ ─► path ─ ξ_r, ω_r ─► controller ─ ω ─► robot …

Every tuning is an argument of the Function, so that changing a weight compiles nothing; only what
changes its shape does.
"""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from rhec import paper
from rhec.core._casadi import build, compiled, scan
from rhec.core._casadi.validation import shown
from rhec.core.controller import rhc
from rhec.core.model.limits import is_valid_measurement
from rhec.extensions import cautious, faults
from rhec.simulation.columns import COLUMNS, FLAGS, LOG
from rhec.simulation.metrics import metrics
from rhec.simulation.scenario import Scenario
from rhec.tracked_robot import plant as robot
from rhec.tracked_robot import rhc as paper_rhc
from rhec.tracked_robot import terrain
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import build_step, estimator_of
from rhec.tracked_robot.kinematics import QUANTITIES, SPEED_MODELS
from rhec.tracked_robot.path import Path
from rhec.tracked_robot.references import build_references
from rhec.tracked_robot.terrain import Terrain

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Run",
    "Setup",
    "build_sample",
    "finish",
    "noise_and_faults",
    "set_up",
    "simulate",
    "simulate_setup",
]


class _LoopStructure(NamedTuple):
    """What decides the shape of the loop's Function, and so what is compiled."""

    estimator: Choice
    prediction_horizon: int
    qp: str
    input_reference: str
    n_segments: int
    terrain_shape: tuple[int, int]
    faulty: bool  # sensors with faults: what is not there costs nothing
    cautious: bool


def build_sample(*structure):
    """One sample of the closed loop, (memory, noise, settings …) -> (memory, row), as a scan."""
    structure = _LoopStructure(*structure)
    choice = Choice(*structure.estimator)
    traction_input = estimator_of(choice.estimator).traction_input
    measure = robot.measure(paper.DT_S)
    drive = robot.drive(paper.DT_S)
    estimate_step = build_step(choice)
    references = build_references(
        paper.DT_S, structure.prediction_horizon, structure.n_segments, structure.input_reference
    )["references"]
    horizon = paper_rhc.horizon_of(structure.prediction_horizon, structure.qp)
    control = rhc.build_phases(horizon)["step"]
    if structure.cautious:
        states = estimator_of(choice.estimator, choice.robust).states(choice)
        control = cautious.build_step(control, states, structure.n_segments, paper.DT_S)
    slip = terrain.lookup(structure.terrain_shape)
    deliver = faults.deliver()
    limits = SPEED_MODELS["parameter"].model.limits
    sensors = faults.MEMORY if structure.faulty else {}
    stream = robot.NOISE | (faults.STREAM if structure.faulty else {})

    one = (1, 1)
    three = (3, 1)
    own = dict(estimator=(estimate_step.numel_in(0), 1), s=one, command=one)
    own |= dict(controller=(control.numel_in(0), 1))
    memory = robot.MEMORY | own | sensors
    settings = (
        robot.SENSORS
        | robot.BODY
        | dict(
            segments=(5, structure.n_segments),
            period_m=one,
            look_ahead_m=one,
            backwards=one,
            Q=three,
            QN=three,
            R=one,
            lower=one,
            upper=one,
            caution=one,
            speed_mps=one,
            command_delay=one,
            origin_m=(2, 1),
            cell_m=one,
            slip=(slip.numel_in("slip"), 1),
            mean_traction=(2, 1),
        )
    )
    settings |= {
        name: estimate_step.size_in(name)
        for name in estimate_step.name_in()[2:]
        if name not in ("truth", "traction")
    }

    @build.with_packed_memory(
        "sample", memory, ca.MX, noise=(build.packed_size(stream), 1), **settings
    )
    def sample(pose, tracks, estimator, s, controller, command, noise, **settings):
        known = settings | build.unpack(noise, stream) | dict(pose=pose, tracks=tracks)
        traction = slip(pose[:2], settings["origin_m"], settings["cell_m"], settings["slip"])
        nu, omega = robot.body_speeds(tracks, settings["track_width_m"])
        truth = ca.vertcat(pose, nu, traction)

        measured = measure(**build.select_inputs(measure, known))
        if structure.faulty:
            measured |= deliver(**build.select_inputs(deliver, known | measured))
        z = measured["z"]
        valid = [is_valid_measurement(z[row], limit) for row, limit in enumerate(limits)]

        passed = traction_input.select_traction(settings["mean_traction"], traction)
        known |= dict(truth=truth, traction=passed)
        inputs = [estimator, z] + [known[name] for name in estimate_step.name_in()[2:]]
        names = ["memory", "estimate", *estimate_step.name_out()[2:]]
        outputs = dict(zip(names, estimate_step.call(inputs)))
        estimate = outputs["estimate"]

        accepted = outputs.get("accepted", ca.vertcat(*valid))
        target = references(
            **build.select_inputs(references, settings),
            s=s,
            estimate=estimate,
            omega_measured=ca.if_else(accepted[3], z[3], command),
        )
        planned = control(
            **build.select_inputs(control, settings | outputs | target | dict(memory=controller)),
            s_0=estimate,
            x_ref=target["xi_ref"],
            u_ref=target["omega_ref"],
        )
        newest = planned["command"]
        # Eq. (13): the first input is applied at once, or one sample later (interpretation R10).
        applied = ca.if_else(settings["command_delay"], command, newest)

        applied = dict(traction=traction, omega_radps=applied)
        driven = drive(**build.select_inputs(drive, known | planned | applied))
        nan = ca.DM.nan(1)
        row = dict(
            truth=truth,
            omega=omega,
            z=z,
            estimate=estimate,
            command=newest,
            s=target["s"],
            curvature=target["curvature"],
            kkt_rhe=outputs.get("kkt", nan),
            kkt_rhc=planned["kkt"],
            deviance=outputs.get("deviance", nan),
            ok=ca.fmin(outputs.get("ok", 1), planned["ok"]),
            accepted=ca.vertcat(accepted[0] * accepted[1], accepted[2] * accepted[3]),
            restart=outputs.get("restart", ca.DM(0)),
        )
        return dict(
            row=ca.vertcat(*(row[name] for name in LOG)),
            drift=measured["drift"],
            s=target["s"],
            covariance=outputs.get("covariance", nan),
            estimator=outputs["memory"],
            command=newest,
            controller=planned["memory"],
            **driven,
            **{name: measured[name] for name in sensors},
        )

    return scan.build_scan(sample)


@dataclass(frozen=True)
class Setup:
    """A scenario turned into arrays: loop structure, first memory, settings, path and terrain.

    layout: shapes of the memory's pieces by name; of estimator and controller, of theirs. guess:
    (x, y, θ, ν, μ, κ), the estimator's first.
    """

    structure: _LoopStructure
    memory: np.ndarray
    layout: dict
    settings: dict
    path: Path
    terrain: Terrain
    guess: np.ndarray

    def unpack(self, memory):
        """A memory's arrays by name, those of estimator and controller in dicts of their own."""
        nested = {name: shape for name, shape in self.layout.items() if isinstance(shape, dict)}
        flat = self.layout | {name: (build.packed_size(inner), 1) for name, inner in nested.items()}
        pieces = build.unpack_array(memory, flat)
        return pieces | {name: build.unpack_array(pieces[name], of) for name, of in nested.items()}


_TAKEN_OVER = (
    "gnss_slow_time_s",
    "track_width_m",
    "encoder_sigma_mps",
    "speed_sigma_mps",
    "bump_sigma_radps",
    "look_ahead_m",
    "caution",
)


def set_up(scenario):
    """Path, soil, starting point and settings of a scenario."""
    target = scenario.path or Path.racetrack(scenario.row_length_m, scenario.headland_radius_m)
    soil = scenario.terrain or terrain.random_for(scenario, target)

    ((x, y, theta),), _ = target.poses([0.0])
    backwards = -1.0 if scenario.backwards else 1.0
    speed_mps = backwards * scenario.speed_mps
    x -= scenario.start_offset_m * np.sin(theta)
    y += scenario.start_offset_m * np.cos(theta)
    theta += scenario.start_yaw_rad + np.pi * scenario.backwards
    pose = np.array([x, y, theta])
    guess = np.array([*pose + (0, 0, scenario.guess_yaw_rad), speed_mps, 1.0, 1.0])

    choice = Choice.of(scenario)
    shape = terrain.common_shape(soil)
    estimator = estimator_of(choice.estimator, choice.robust)
    horizon = paper_rhc.horizon_of(scenario.prediction_horizon, scenario.qp)
    commanded = dict(speed=np.array([scenario.speed_mps])) if scenario.cautious else {}
    memory = robot.init(pose, speed_mps) | dict(
        estimator=estimator.init(choice, dict(zip(QUANTITIES, guess))),
        s=target.project(pose[None, :2])[1],
        command=0.0,
        controller=rhc.init(horizon, guess[:3], guess[3:]) | commanded,
    )
    slow = scenario.gnss_slow_share
    settings = {name: getattr(scenario, name) for name in _TAKEN_OVER} | dict(
        gnss_white_m=scenario.gnss_sigma_m * np.sqrt(1 - slow),
        gnss_slow_m=scenario.gnss_sigma_m * np.sqrt(slow),
        segments=target.segments.T,
        period_m=target.period_m,
        backwards=float(scenario.backwards),
        Q=np.array(scenario.q),
        QN=scenario.qn_factor * np.array(scenario.q),
        R=scenario.r,
        lower=-scenario.omega_max_radps,
        upper=scenario.omega_max_radps,
        speed_mps=speed_mps,
        command_delay=float(scenario.command_delay),
        **terrain.settings(soil, shape),
    )
    structure = _LoopStructure(
        choice,
        scenario.prediction_horizon,
        scenario.qp,
        scenario.input_reference,
        len(target.segments),
        shape,
        bool(scenario.faults),
        scenario.cautious,
    )
    memory |= faults.init() if scenario.faults else {}
    nested = {name: piece for name, piece in memory.items() if isinstance(piece, dict)}
    flat = memory | {name: build.pack_array(piece) for name, piece in nested.items()}
    layout = build.shapes_of(flat) | {name: build.shapes_of(of) for name, of in nested.items()}
    settings |= estimator.settings(scenario)
    return Setup(structure, build.pack_array(flat), layout, settings, target, soil, guess)


def noise_and_faults(seed, given, samples):
    """The stream that a run is scanned over: noise and the given Faults, one row a sample."""
    noise = robot.draw_noise(seed, samples)
    return np.hstack([noise, faults.stream(given, samples, paper.DT_S, seed)]) if given else noise


@dataclass(frozen=True)
class Run:
    """A finished run: its scenario, metrics, path, terrain, and its log's columns as arrays."""

    scenario: Scenario
    metrics: dict[str, Any]
    path: Path
    terrain: Terrain
    columns: dict[str, np.ndarray]

    @functools.cached_property
    def log(self) -> "pd.DataFrame":
        """One row a sample; `rhec.simulation.columns` says what each column is."""
        # Half of the time it takes to import this package, and a campaign never looks at a log.
        import pandas as pd

        return pd.DataFrame(self.columns)


def simulate(scenario: Scenario) -> Run:
    """Run a scenario. A structure's first run compiles it for some seconds, once.

    Args:
        scenario: What to run.

    Returns:
        The Run.

    Raises:
        ValueError: For anything but a Scenario.
    """
    if not isinstance(scenario, Scenario):
        raise ValueError(f"scenario was {shown(scenario)}; it should be a rhec.Scenario")
    return simulate_setup(scenario, set_up(scenario))


def simulate_setup(scenario, setup):
    """The Run of a scenario that is set up."""
    functions = compiled.load(build_sample, *setup.structure)
    samples = round(scenario.duration_s / paper.DT_S)
    stream = noise_and_faults(scenario.seed, scenario.faults, samples)
    return finish(scenario, setup, scan.scan(functions, setup.memory, stream, setup.settings)[1])


def finish(scenario, setup, rows):
    """The Run whose loop gave these rows (n, LOG): its columns and metrics."""
    columns = {"t_s": np.arange(len(rows)) * paper.DT_S}
    columns |= dict(zip(COLUMNS, np.ascontiguousarray(rows.T)))
    columns |= {name: columns[name] == 1 for name in FLAGS}
    x, y = ([columns[f"{axis}_meas_m"], columns[f"{axis}_m"]] for axis in "xy")
    measured, true = xy = np.stack([x, y], axis=2)
    measured[~np.isfinite(measured).all(axis=1)] = np.nan
    distance, s = setup.path.project(xy.reshape(-1, 2))
    columns["error_m"], columns["error_true_m"] = np.split(distance, 2)
    poses, curvatures = setup.path.poses(s[len(true) :])
    columns["on_straight"] = curvatures == 0
    return Run(scenario, metrics(columns, poses), setup.path, setup.terrain, columns)
