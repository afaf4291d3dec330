"""Estimation window and predicted trajectory at one sample of a run."""

from typing import NamedTuple

import numpy as np

from rhec import paper
from rhec.core._casadi import early, scan
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE, POSE


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


def snapshot_at(scenario, k):
    """The Snapshot at sample k ≥ 0 of a scenario's run, which is simulated until then."""
    setup = closed_loop.set_up(scenario)
    functions = early.load(closed_loop.build_sample, *setup.structure)
    options = closed_loop.options_of(scenario)
    inputs = closed_loop.noise_and_faults(scenario.seed, scenario.faults, k + 1, options)
    memory, rows = scan.scan(functions, setup.memory, inputs, setup.settings)
    row = dict(zip(COLUMNS, rows[-1]))
    truth, estimate = (np.array([row[name] for name in names]) for names in (POSE, ESTIMATE))

    parts = setup.unpack(memory)
    past = parts["estimator"]
    planned = parts["controller"]
    window = np.empty((0, 3))
    measured = np.empty((0, 2))
    if {"s", "z", "age"} <= past.keys():  # the memory of an RHE
        # Until the window is full, its oldest nodes are unused.
        nodes = int(past["age"].item()) + 1
        window = past["s"].T[-nodes:, :3]
        measured = past["z"].T[-nodes:, :2]
        measured = np.where(np.isfinite(measured), measured, np.nan)
    step_m = abs(row["mu_hat"] * row["nu_hat_mps"]) * paper.DT_S
    ahead_m = scenario.look_ahead_m + step_m * np.arange(scenario.prediction_horizon + 1)
    desired, _ = setup.path.poses(row["s_m"] + ahead_m)
    plan = planned["s"].T[:, :3]
    # A controller that cancels a disturbance remembers the plan with the disturbance in it.
    u = planned["u"].ravel()
    omega_radps = u + (row["omega_cmd_radps"] - u[0])
    return Snapshot(truth, estimate, window, measured, desired, plan, omega_radps)
