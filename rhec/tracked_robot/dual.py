"""Dual estimation: one estimator for the soil, one for the pose. Not in the paper.

Wan and Nelson, "Dual Extended Kalman Filter Methods", 2001. The RHE needs a long memory to
distinguish traction from noise, while a pose for steering should follow its measurements faster.
Here the RHE estimates (μ, κ), as in the paper, and an EKF with that traction estimates
(x, y, θ, ν), each with its own process noise. The EKF takes a Runge-Kutta step: the paper's Euler
step would put its yaw half a sample's turn ahead.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.packing import pack_array
from rhec.tracked_robot import ekf as paper_ekf
from rhec.tracked_robot import robust, tuning
from rhec.tracked_robot.choice import Estimator
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.rhe import ESTIMATORS, SIGMA_START


def _rhe_of(choice):
    return robust.ROBUST_RHE if choice.robust else ESTIMATORS["rhe"]


def _build_step(choice):
    """Both as one Function. The memory and W (10,) are the RHE's, followed by the EKF's."""
    soil = _rhe_of(choice).build_step(choice)
    pose = paper_ekf.build_step(choice.dt_s, paper_ekf.runge_kutta)
    sizes = soil.numel_in("memory"), pose.numel_in("memory")
    memory = ca.MX.sym("memory", sum(sizes))
    z = ca.MX.sym("z_N", 4)
    V = ca.MX.sym("V", 4)
    W = ca.MX.sym("W", 10)
    P_0 = ca.MX.sym("P_0", 6)
    soil_memory, pose_memory = ca.vertsplit(memory, [0, sizes[0], sum(sizes)])
    soil_result = soil(memory=soil_memory, z_N=z, V=V, W=W[:6], P_0=P_0)
    traction = soil_result["estimate"][4:]
    accepted = z
    if choice.robust:
        # The EKF uses the measurements that the RHE accepts, and restarts with the RHE.
        accepted = ca.if_else(soil_result["accepted"], z, ca.DM.nan(4))
        fresh = pack_array(paper_ekf.init(QUANTITIES[:4], dict.fromkeys(QUANTITIES, 0.0)))[4:]
        fresh = ca.vertcat(soil_result["estimate"][:4], fresh)
        pose_memory = ca.if_else(soil_result["restart"], fresh, pose_memory)
    pose_result = pose(memory=pose_memory, z_N=accepted, V=V, W=W[6:], traction=traction)
    # Of the two filters the RHE has the diagnostics that logs show.
    passed_on = ["deviance", "kkt", "ok"] + (["accepted", "restart"] if choice.robust else [])
    inputs = dict(memory=memory, z_N=z, V=V, W=W, P_0=P_0)
    outputs = dict(
        memory=ca.vertcat(soil_result["memory"], pose_result["memory"]),
        estimate=ca.vertcat(pose_result["estimate"][:4], traction),
        covariance=ca.diagcat(pose_result["covariance"], soil_result["covariance"][4:, 4:]),
    )
    # Errors of pose and traction count as independent: no filter estimates their correlation.
    outputs |= {name: soil_result[name] for name in passed_on}
    options = {"allow_duplicate_io_names": True}
    names = [*inputs], [*outputs]
    return ca.Function("dual_step", [*inputs.values()], [*outputs.values()], *names, options)


def _init(choice, guess, sigma=SIGMA_START):
    memory = _rhe_of(choice).init(choice, guess, sigma)
    pose = paper_ekf.init(QUANTITIES[:4], guess, sigma)
    return memory | {f"pose_{name}": piece for name, piece in pose.items()}


def _settings(scenario):
    sigma_w = tuning.SIGMA_W_TRACKING["dual"] if scenario.sigma_w is None else scenario.sigma_w
    return dict(
        V=np.square(tuning.sigma_v_of(scenario)),
        W=np.square(sigma_w),
        P_0=np.square([*SIGMA_START.values()]),
    )


DUAL = Estimator(
    build_step=_build_step,
    init=_init,
    settings=_settings,
    states=lambda choice: QUANTITIES,
    n_sigma_w=lambda choice: 10,
)
