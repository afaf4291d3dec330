"""The estimation window and the predicted trajectory at one sample of a run.

A run is a scan, so that the memory at sample k comes from scanning the samples up to k: nothing
needs to have been kept.
"""

from typing import NamedTuple

import numpy as np

from rhec import paper, simulation
from rhec._casadi import compiled, scan
from rhec._casadi.build import pack_array, packed_size, shapes_of, unpack_array
from rhec.controller import rhc
from rhec.estimator import rhe
from rhec.extensions import faults
from rhec.model import robot

__all__ = ["Snapshot", "snapshot_at"]


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
    """Estimation window and plan of a scenario's run at sample k.

    Args:
        scenario: a rhec.Scenario.
        k: number of the sample, from 0.

    Returns:
        A Snapshot.
    """
    setup = simulation.set_up(scenario)
    functions = compiled.load(simulation.build_sample, *setup.structure)
    inputs = simulation.noise_and_faults(scenario, k + 1)
    memory, rows = scan.scan(functions, setup.memory, inputs, setup.settings)
    row = dict(zip(simulation.COLUMNS, rows[-1]))
    truth, estimate = rows[-1, :3], np.array([row[name] for name in simulation.LOG["estimate"]])

    controller = rhc.init(np.zeros(3), np.zeros(3), scenario.prediction_horizon)
    after = dict(s=(1, 1), controller=(pack_array(controller).size, 1), command=(1, 1))
    after |= faults.MEMORY if scenario.faults else {}
    estimator_size = len(memory) - packed_size(robot.MEMORY | after)
    parts = unpack_array(memory, robot.MEMORY | dict(estimator=(estimator_size, 1)) | after)
    planned = unpack_array(parts["controller"], shapes_of(controller))
    window, measured = np.empty((0, 3)), np.empty((0, 2))
    if scenario.estimator in ("rhe", "dual"):  # the memory of both begins with the RHE's
        speed_model = scenario.speed_model if scenario.estimator == "rhe" else "parameter"
        empty = rhe.init(np.zeros(6), rhe.SIGMA_START, scenario.estimation_horizon, speed_model)
        shapes = shapes_of(empty)
        past = unpack_array(parts["estimator"][: packed_size(shapes)], shapes)
        # a window that is not full yet has its oldest nodes at its first sample
        nodes = int(past["age"].item()) + 1
        window, measured = past["s"].T[-nodes:, :3], past["z"].T[-nodes:, :2]
        measured = np.where(np.isfinite(measured), measured, np.nan)
    step_m = abs(row["mu_hat"] * row["nu_hat_mps"]) * paper.DT_S
    ahead_m = scenario.look_ahead_m + step_m * np.arange(scenario.prediction_horizon + 1)
    desired, _ = setup.path.poses(row["s_m"] + ahead_m)
    plan, omega_radps = planned["s"].T[:, :3], planned["omega"].ravel()
    return Snapshot(truth, estimate, window, measured, desired, plan, omega_radps)
