"""Estimation window and predicted trajectory at one sample of a run."""

from typing import NamedTuple

import numpy as np

from rhec import paper
from rhec.core._casadi import build, compiled, early, scan
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE, POSE
from rhec.tracked_robot.choice import Choice
from rhec.tracked_robot.estimators import estimator_of


class Snapshot(NamedTuple):
    """Estimation window and plan at a sample.

    Poses are (x, y, θ) [m, m, rad] in the plane; nodes are ordered from the oldest to the newest.
    """

    truth: np.ndarray  # (3,) pose of the robot
    estimate: np.ndarray  # (6,) (x, y, θ, ν, μ, κ)
    window: np.ndarray  # (n, 3) poses in the window of an RHE; otherwise (0, 3)
    measured: np.ndarray  # (n, 2) GNSS positions in the window [m]
    desired: np.ndarray  # (N + 1, 3) reference poses of the RHC, starting now
    plan: np.ndarray  # (N + 1, 3) poses predicted by the RHC
    omega_radps: np.ndarray  # (N,) planned yaw rates
    commanded_mps: np.ndarray  # (2,) speeds that the left and the right track were told
    ground_mps: np.ndarray  # (2,) their speeds over ground
    covariance: np.ndarray  # (4,) of the estimate: of xx, xy, yy and θθ
    kappa_variance: np.ndarray  # (n,) of the estimated κ at the last samples; NaN: not estimated
    kappa_growth: float  # by so much the variance grows a sample where nothing tells of κ


class _Recent(NamedTuple):
    """The last samples of a run, one by one."""

    memories: list  # the first one is that before the first sample
    rows: list
    covariances: list


_RECENT = 75  # samples, of which a picture shows how the variance of κ changed
_TO_TRACKS = np.array([-1, 1]) * paper.TRACK_WIDTH_M / 2  # of a yaw rate, to left and right


def snapshot_at(scenario, k):
    """The Snapshot at sample k ≥ 0 of a scenario's run, which is simulated until then."""
    setup = closed_loop.set_up(scenario)
    functions = early.load(closed_loop.build_sample, *setup.structure)
    options = closed_loop.options_of(scenario)
    inputs = closed_loop.noise_and_faults(scenario.seed, scenario.faults, k + 1, options)
    first = max(0, k + 1 - _RECENT)
    memory, _ = scan.scan(functions, setup.memory, inputs[:first], setup.settings)
    recent = _recent(functions["step"], memory, inputs[first:], setup.settings)
    row = dict(zip(COLUMNS, recent.rows[-1]))
    truth, estimate = (np.array([row[name] for name in names]) for names in (POSE, ESTIMATE))

    parts = setup.unpack(recent.memories[-1])
    planned = parts["controller"]
    window, measured = _window(parts["estimator"])
    step_m = abs(row["mu_hat"] * row["nu_hat_mps"]) * paper.DT_S
    ahead_m = scenario.look_ahead_m + step_m * np.arange(scenario.prediction_horizon + 1)
    desired, _ = setup.path.poses(row["s_m"] + ahead_m)
    plan = planned["s"].T[:, :3]
    # A controller that cancels a disturbance remembers the plan with the disturbance in it.
    u = planned["u"].ravel()
    omega_radps = u + (row["omega_cmd_radps"] - u[0])
    before = setup.unpack(recent.memories[-2])
    commanded_mps, ground_mps = _speeds_of_tracks(scenario, row, before)
    covariance, kappa_variance, growth = _uncertainty(scenario, recent.covariances, setup)
    return Snapshot(
        truth=truth,
        estimate=estimate,
        window=window,
        measured=measured,
        desired=desired,
        plan=plan,
        omega_radps=omega_radps,
        commanded_mps=commanded_mps,
        ground_mps=ground_mps,
        covariance=covariance,
        kappa_variance=kappa_variance,
        kappa_growth=growth,
    )


def _recent(step, memory, inputs, settings):
    """Samples one by one: memories, that before the first one included, rows, covariances."""
    call = compiled.BufferedFunction(step)
    call.set(**build.select_inputs(step, settings))
    memories, rows, covariances = [memory.copy()], [], []
    memory_in, stream_in, *_ = step.name_in()
    memory_out, row_out, *_ = step.name_out()
    for sample in np.ascontiguousarray(inputs, dtype=float):
        call.read_from(memory_in, memories[-1])
        call.read_from(stream_in, sample)
        call.call()
        memories.append(call.results[memory_out].copy())
        rows.append(call.results[row_out].copy())
        covariances.append(call.results["covariance"].copy())
    return _Recent(memories, rows, covariances)


def _window(past):
    """Poses and GNSS positions of the window in an estimator's memory; empty where it has none."""
    if not {"s", "z", "age"} <= past.keys():  # not the memory of an RHE
        return np.empty((0, 3)), np.empty((0, 2))
    # Until the window is full, its oldest nodes are unused.
    nodes = int(past["age"].item()) + 1
    measured = past["z"].T[-nodes:, :2]
    return past["s"].T[-nodes:, :3], np.where(np.isfinite(measured), measured, np.nan)


def _speeds_of_tracks(scenario, row, before):
    """Commanded speeds of both tracks, from the memory before the sample, and those over ground."""
    nu = np.squeeze(before["controller"].get("speed", scenario.speed_mps))
    speed = row["mu"] * row["nu_mps"]
    turning = row["kappa"] * row["omega_radps"] + speed * row["yaw_drift_radpm"]
    return nu + _TO_TRACKS * np.squeeze(before["command"]), speed + _TO_TRACKS * turning


def _uncertainty(scenario, covariances, setup):
    """Covariance of the pose, variances of κ and their growth a sample, of recent samples."""
    choice = Choice.of(scenario)
    states = [*estimator_of(choice.estimator, choice.robust).states(choice)]
    full = np.array(covariances).reshape(len(covariances), len(states), len(states))
    x, y, theta = (states.index(name) for name in POSE)
    pose = full[-1][[x, x, y, theta], [x, y, y, theta]]
    if "kappa" not in states:
        return pose, np.full(len(full), np.nan), 0.0
    kappa = states.index("kappa")
    return pose, full[:, kappa, kappa], float(np.ravel(setup.settings["W"])[kappa])
