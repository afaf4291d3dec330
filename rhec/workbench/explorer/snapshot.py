"""Estimation window and predicted trajectory at one sample of a run, by scanning up to it."""

from typing import NamedTuple

import numpy as np

from rhec import paper
from rhec.core._casadi import compiled, scan
from rhec.simulation import closed_loop
from rhec.simulation.columns import COLUMNS, ESTIMATE, POSE


class Snapshot(NamedTuple):
    """Estimation window and plan at sample k.

    Poses are (x, y, θ) [m, m, rad] of the field; nodes run from the oldest to the newest.
    """

    truth: np.ndarray  # (3,) the robot's pose
    estimate: np.ndarray  # (6,) (x, y, θ, ν, μ, κ)
    window: np.ndarray  # (n, 3) poses of the RHE's trajectory; no rows for other estimators
    measured: np.ndarray  # (n, 2) the GNSS positions it is fitted to [m]
    desired: np.ndarray  # (N + 1, 3) poses of the path that the RHC was asked for; the first is now
    plan: np.ndarray  # (N + 1, 3) poses that the RHC predicts
    omega_radps: np.ndarray  # (N,) yaw rates that it plans


def snapshot_at(scenario, k):
    """The Snapshot of a scenario's run at sample k, from 0."""
    setup = closed_loop.set_up(scenario)
    functions = compiled.load(closed_loop.build_sample, *setup.structure)
    inputs = closed_loop.noise_and_faults(scenario.seed, scenario.faults, k + 1)
    memory, rows = scan.scan(functions, setup.memory, inputs, setup.settings)
    row = dict(zip(COLUMNS, rows[-1]))
    truth, estimate = (np.array([row[name] for name in names]) for names in (POSE, ESTIMATE))

    parts = setup.unpack(memory)
    past = parts["estimator"]
    planned = parts["controller"]
    window = np.empty((0, 3))
    measured = np.empty((0, 2))
    if {"s", "z", "age"} <= past.keys():  # an RHE's
        # a window that is not full yet has its oldest nodes at its first sample
        nodes = int(past["age"].item()) + 1
        window = past["s"].T[-nodes:, :3]
        measured = past["z"].T[-nodes:, :2]
        measured = np.where(np.isfinite(measured), measured, np.nan)
    step_m = abs(row["mu_hat"] * row["nu_hat_mps"]) * paper.DT_S
    ahead_m = scenario.look_ahead_m + step_m * np.arange(scenario.prediction_horizon + 1)
    desired, _ = setup.path.poses(row["s_m"] + ahead_m)
    plan = planned["s"].T[:, :3]
    omega_radps = planned["u"].ravel()
    return Snapshot(truth, estimate, window, measured, desired, plan, omega_radps)
