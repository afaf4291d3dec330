"""What the robot has in mind at one sample of a run: the window of its estimator and the plan of
its controller.

A run is a fold, so that the memory at sample k is the fold of the samples up to k: nothing needs to
have been kept.
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


class Horizons(NamedTuple):
    """At sample k. Poses are (x, y, θ) [m, m, rad] of the field; nodes run from the oldest to the
    newest.
    """

    truth: np.ndarray  # (3,) where the robot is
    estimate: np.ndarray  # (6,) (x, y, θ, ν, μ, κ)
    window: (
        np.ndarray
    )  # (n, 3) poses of the RHE's trajectory, the newest last; no rows for other estimators
    measured: np.ndarray  # (n, 2) the GNSS positions it is fitted to [m]
    desired: np.ndarray  # (N + 1, 3) poses of the path that the RHC was asked for; the first is now
    plan: np.ndarray  # (N + 1, 3) poses that the RHC predicts
    omega_radps: np.ndarray  # (N,) yaw rates that it plans


def horizons_at(scenario, k):
    """The Horizons of a scenario's run at sample k."""
    made = simulation.set_up(scenario)
    functions = compiled.load(simulation.build_sample, *made.structure)
    memory, rows = scan.scan(
        functions, made.memory, simulation.noise_and_faults(scenario, k + 1), made.settings
    )
    row = dict(zip(simulation.COLUMNS, rows[-1]))
    truth, estimate = rows[-1, :3], np.array([row[name] for name in simulation.LOG["estimate"]])

    controller = rhc.init(np.zeros(3), np.zeros(3), scenario.prediction_horizon)
    after = dict(s=(1, 1), controller=(pack_array(controller).size, 1), command=(1, 1)) | (
        faults.MEMORY if scenario.faults else {}
    )
    estimator = len(memory) - packed_size(robot.MEMORY | after)
    of = unpack_array(memory, robot.MEMORY | dict(estimator=(estimator, 1)) | after)
    planned = unpack_array(of["controller"], shapes_of(controller))
    window, measured = np.empty((0, 3)), np.empty((0, 2))
    if scenario.estimator in ("rhe", "dual"):  # the memory of both begins with the RHE's
        speed_model = scenario.speed_model if scenario.estimator == "rhe" else "parameter"
        of_rhe = shapes_of(
            rhe.init(np.zeros(6), rhe.SIGMA_START, scenario.estimation_horizon, speed_model)
        )
        past = unpack_array(of["estimator"][: packed_size(of_rhe)], of_rhe)
        nodes = (
            int(past["age"].item()) + 1
        )  # a window that is not full yet has its oldest nodes at its first sample
        window, measured = past["s"].T[-nodes:, :3], past["z"].T[-nodes:, :2]
        measured = np.where(np.isfinite(measured), measured, np.nan)
    pace = abs(row["mu_hat"] * row["nu_hat_mps"]) * paper.DT_S
    desired, _ = made.path.poses(
        row["s_m"] + scenario.look_ahead_m + pace * np.arange(scenario.prediction_horizon + 1)
    )
    return Horizons(
        truth, estimate, window, measured, desired, planned["s"].T[:, :3], planned["omega"].ravel()
    )
