"""Dual estimation: one estimator for the soil, one for the pose. Not in the paper.

Wan and Nelson, "Dual Extended Kalman Filter Methods", 2001. The RHE needs a long memory to tell
traction from noise; a pose that steers should follow its measurements faster than that. Here the
RHE gives (μ, κ), as in the paper, and an EKF with that traction gives (x, y, θ, ν), each with the
process noise that suits it. The paper's Euler step would put the yaw of that filter half a
sample's turn ahead; a Runge-Kutta step does not.
"""

import casadi as ca
import numpy as np

from rhec.core._casadi.build import pack_array
from rhec.tracked_robot import ekf as paper_ekf
from rhec.tracked_robot import robust, tuning
from rhec.tracked_robot.choice import Estimator
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.rhe import ESTIMATORS, SIGMA_START

__all__ = ["DUAL"]


def _rhe_of(choice):
    return robust.ROBUST_RHE if choice.robust else ESTIMATORS["rhe"]


def _build_step(choice):
    """Both as one Function: memory is the RHE's, then the EKF's; so is W (10,)."""
    soil = _rhe_of(choice).build_step(choice)
    pose = paper_ekf.build_step(choice.dt_s, paper_ekf.runge_kutta)
    sizes = soil.numel_in("memory"), pose.numel_in("memory")
    memory = ca.MX.sym("memory", sum(sizes))
    z = ca.MX.sym("z_N", 4)
    V = ca.MX.sym("V", 4)
    W = ca.MX.sym("W", 10)
    P_0 = ca.MX.sym("P_0", 6)
    of_soil, of_pose = ca.vertsplit(memory, [0, sizes[0], sum(sizes)])
    first = soil(memory=of_soil, z_N=z, V=V, W=W[:6], P_0=P_0)
    traction = first["estimate"][4:]
    accepted = z
    if choice.robust:
        # The EKF sees what the RHE accepts, and restarts where the RHE does.
        accepted = ca.if_else(first["accepted"], z, ca.DM.nan(4))
        fresh = pack_array(paper_ekf.init(4, dict.fromkeys(QUANTITIES, 0.0)))[4:]
        fresh = ca.vertcat(first["estimate"][:4], fresh)
        of_pose = ca.if_else(first["restart"], fresh, of_pose)
    second = pose(memory=of_pose, z_N=accepted, V=V, W=W[6:], traction=traction)
    told = ("deviance", "kkt", "ok") + (("accepted", "restart") if choice.robust else ())
    outputs = dict(
        memory=ca.vertcat(first["memory"], second["memory"]),
        estimate=ca.vertcat(second["estimate"][:4], traction),
        covariance=ca.diagcat(second["covariance"], first["covariance"][4:, 4:]),
    ) | {name: first[name] for name in told}
    inputs = dict(memory=memory, z_N=z, V=V, W=W, P_0=P_0)
    names = [*inputs], [*outputs]
    options = {"allow_duplicate_io_names": True}
    return ca.Function("dual_step", [*inputs.values()], [*outputs.values()], *names, options)


def _init(choice, guess, sigma=SIGMA_START):
    soil = _rhe_of(choice).init(choice, guess, sigma)
    pose = paper_ekf.init(4, guess, sigma)
    return soil | {f"pose_{name}": piece for name, piece in pose.items()}


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
