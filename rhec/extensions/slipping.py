"""Tracks that slip sideways, and an antenna off the centre: a Model for recorded robots.

Not in the paper. Every interval has a side slip speed η of its own, the position measured is that
of an antenna l_f ahead and l_l left of the robot's centre of turning, and the process noise grows
with how far the tracks ran.
"""

import casadi as ca

from rhec import paper
from rhec.model.base import Model, MotionNoise
from rhec.tracked_robot import tuning
from rhec.tracked_robot.kinematics import SPEED_MODELS as OF_THE_PAPER
from rhec.tracked_robot.kinematics import SpeedModel

__all__ = ["LEVER_ARM", "SPEED_MODELS", "f"]

SIDE_SLIP_S = 0.1  # of two recorded skid-steered robots, a wheeled and a tracked one, alike
LEVER_ARM = ("arm_forward_m", "arm_left_m")


def f(xi, v, p):
    """ξ̇ = f(ξ, v, p) where tracks slip sideways.

    The tracks slip by SIDE_SLIP_S times the lateral acceleration and by a speed η.

    Args:
        xi: (3,) place of the antenna and yaw (x, y, θ) [m, m, rad].
        v: (3,) speed ν [m/s] and yaw rate ω [rad/s] of the tracks, side slip speed η [m/s].
        p: (4,) place of the antenna l_f, l_l [m], traction coefficients μ and κ.

    Returns:
        (3,) dξ/dt.
    """
    nu, omega, eta = v[0], v[1], v[2]
    l_f, l_l, mu, kappa = p[0], p[1], p[2], p[3]
    ahead = mu * nu - kappa * omega * l_l
    left = eta + kappa * omega * (l_f - SIDE_SLIP_S * mu * nu)
    cos, sin = ca.cos(xi[2]), ca.sin(xi[2])
    return ca.vertcat(ahead * cos - left * sin, ahead * sin + left * cos, kappa * omega)


def _abs_track_speeds(nu, omega, b):
    """Speeds (left, right) [m/s], both positive, of the tracks of a robot of track width b [m]."""
    return ca.fabs(nu - b / 2 * omega), ca.fabs(nu + b / 2 * omega)


def _input_noise(v, R, c):
    """Slip in proportion to the motion; bumps turn the robot; η is unmeasured, its mean 0."""
    share2_nu, share2_omega, share2_side, sigma2_bumps, b, dt_s = ca.vertsplit(c)
    nu, omega = v[0], v[1]
    return ca.vertcat(nu, omega, 0), ca.vertcat(
        R[0] + share2_nu * nu**2,
        R[1] + (share2_omega * omega**2 + sigma2_bumps * ca.fabs(nu) / dt_s),
        share2_side * (b * omega) ** 2 + tuning.SIGMA_SIDE_SLIP_AT_REST**2,
    )


def _process_noise(v, W, dt_s, c):
    """W per metre that the tracks ran."""
    left, right = _abs_track_speeds(v[0], v[1], c[4])
    return W * (left + right) / 2 * dt_s


_SHARES = ("share2_nu", "share2_omega", "share2_side")
_MODEL = Model(
    states=OF_THE_PAPER["input"].model.states,
    inputs=(*OF_THE_PAPER["input"].model.inputs, "eta_mps"),
    parameters=dict.fromkeys(LEVER_ARM) | OF_THE_PAPER["input"].model.parameters,
    outputs=OF_THE_PAPER["input"].model.outputs,
    f=f,
    max_measurement=OF_THE_PAPER["input"].model.limits,
    motion_noise=MotionNoise(
        constants={name: share**2 for name, share in zip(_SHARES, tuning.SHARES_SLIPPING)}
        | dict(
            sigma2_bumps=tuning.SIGMA_BUMPS**2, track_width_m=paper.TRACK_WIDTH_M, dt_s=paper.DT_S
        ),
        inputs=_input_noise,
        process=_process_noise,
    ),
)
SPEED_MODELS = {"slipping": SpeedModel(_MODEL, 2, tuning.SIGMA_W_SLIPPING)}
