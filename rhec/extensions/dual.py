"""Dual estimation (Wan, Nelson, "Dual Extended Kalman Filter Methods", 2001): one estimator for the
soil, one for the pose. Not in the paper.

The RHE needs a long memory to tell traction from noise; a pose that steers should follow its
measurements faster than that. Here the RHE gives (μ, κ), as in the paper, and an EKF with that
traction gives (x, y, θ, ν), each with the process noise that suits it. The paper's Euler step would
put the yaw of that filter half a sample's turn ahead; a Runge-Kutta step does not.
"""

import casadi as ca
import numpy as np

from rhec._casadi.build import pack_array
from rhec.estimator import ekf, rhe
from rhec.model import tracked_robot as model

# Of the RHE's (x, y, θ, ν, μ, κ), then of the EKF's (x, y, θ, ν), per sample: least true error on
# the training seeds (`rhec.studies.calibration`).
SIGMA_W = (0.001, 0.001, 0.001, 0.001, 0.0053, 0.025, 0.0058, 0.0058, 0.028, 0.0054)


def f(m, omega, traction, dt_s):
    """Eq. (systemmodel) over `dt_s` [s] by one Runge-Kutta step from (x, y, θ, ν)."""
    return ca.vertcat(model.rk4(model.f, m[:3], omega, ca.vertcat(m[3], traction), dt_s), m[3])


def build_step(dt_s, horizon, arrival_mean="smoothed", qp="structured", robust=False):
    """Both as one CasADi Function {step}: memory is the RHE's, then the EKF's; V (4,) and W (10,)
    are variances, W the RHE's, then the EKF's.
    """
    soil, pose = (
        rhe.build_phases(dt_s, horizon, "parameter", arrival_mean, qp, robust)["step"],
        ekf.build_step(dt_s, f)["step"],
    )
    memory, z = (
        ca.MX.sym("memory", soil.numel_in("memory") + pose.numel_in("memory")),
        ca.MX.sym("z", 4),
    )
    V, W = ca.MX.sym("V", 4), ca.MX.sym("W", 10)
    of_soil, of_pose = ca.vertsplit(memory, [0, soil.numel_in("memory"), memory.numel()])
    first = soil(memory=of_soil, z_N=z, V=V, W=W[:6])
    traction = first["estimate"][4:]
    believed = (
        first["z_used"] if robust else z
    )  # what the RHE does not believe the EKF does not see
    if robust:  # where the RHE begins again, so does the EKF
        fresh = ca.vertcat(
            first["estimate"][:4], pack_array(ekf.init(np.zeros(6), rhe.SIGMA_START))[4:]
        )
        of_pose = ca.if_else(first["again"], fresh, of_pose)
    second = pose(memory=of_pose, z=believed, V=V, W=W[6:], traction=traction)
    outputs = dict(
        memory=ca.vertcat(first["memory"], second["memory"]),
        estimate=ca.vertcat(second["estimate"][:4], traction),
        covariance=second["covariance"],
        deviance=first["deviance"],
        kkt=first["kkt"],
        ok=first["ok"],
    )
    if robust:
        outputs["z_used"] = believed
    return dict(
        step=ca.Function(
            "dual_step",
            [memory, z, V, W],
            [*outputs.values()],
            ["memory", "z", "V", "W"],
            [*outputs],
            {"allow_duplicate_io_names": True},
        )
    )
