"""Estimators that claims need beside the paper's own, as Functions (memory, z) -> (memory, estimate); the memory begins with the first guess."""

import casadi as ca
import numpy as np

from rhec import ekf, paper


def hard_coded(mu, kappa, sigma_w):
    """The EKF with traction coefficients identified once and for all: (μ, κ) everywhere; sigma_w as for the EKF."""
    step = ekf.functions(paper.DT_S)["step"]
    memory, z = ca.SX.sym("memory", 6 + step.numel_in(0)), ca.SX.sym("z", 4)
    guess, filtered = memory[:6], memory[6:]
    fresh = ca.vertcat(guess[:4], ca.vec(ca.diag(np.square(paper.SIGMA_W_EKF))), 0, 0)   # m, P, ω, started: see `ekf.start`
    filtered = ca.if_else(filtered[-1] == 0, fresh, filtered)
    filtered, estimate, *_ = step.call([filtered, z, np.square(paper.SIGMA_V), np.square(sigma_w), ca.DM([mu, kappa])])
    return ca.Function("hard_coded", [memory, z], [ca.vertcat(guess, filtered), estimate])


def dead_reckoned():
    """No estimate of the yaw: it is the encoders' yaw rate summed up from the start, position and speed are as measured, no slip."""
    memory, z = ca.SX.sym("memory", 6), ca.SX.sym("z", 4)
    estimate = ca.vertcat(z[:2], memory[2] + paper.DT_S * z[3], z[2], 1, 1)
    return ca.Function("dead_reckoned", [memory, z], [estimate, estimate], {"allow_duplicate_io_names": True})
