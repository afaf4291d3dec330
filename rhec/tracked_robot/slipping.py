"""Tracks that slip sideways, and an antenna off the centre: a Model for recorded robots.

Not in the paper. Each interval has its own slip: ahead, in turning, and to the side, where its mean
is proportional to the lateral acceleration. The measured position is that of an antenna l_f ahead
and l_l left of the robot's centre of turning. The process noise grows with the distance that the
tracks ran. `tuning.SLIP` has the default constants; `rhec.calibrate` identifies them from a log.
"""

import casadi as ca

from rhec import paper
from rhec.core.model.robot_model import Model, MotionNoise
from rhec.tracked_robot import tuning
from rhec.tracked_robot.kinematics import SPEED_MODELS, SpeedModel

_EXACT = 1e-12  # variance of the tracks' speeds: errors of the encoders count as slip
_WIDTH = len(tuning.SLIP)  # place of the track width among the constants
LEVER_ARM = ("arm_forward_m", "arm_left_m")


def f(xi, v, p):
    """ξ̇ = f(ξ, v, p) with slip in addition to that of μ and κ.

    ẋ = a cos θ - l sin θ, ẏ = a sin θ + l cos θ, with the antenna's speeds a = μν + η_a - θ̇ l_l
    ahead, l = η + θ̇ l_f to the left, and θ̇ = κω + η_θ. The slip (η_a, η, η_θ) adds to the motion
    over ground. As noise of ν and ω it would be multiplied by μ and κ, which a fit to noisy
    positions would then overestimate.

    Args:
        xi: (3,) place of the antenna and yaw (x, y, θ) [m, m, rad].
        v: (5,) speed ν [m/s] and yaw rate ω [rad/s] of the tracks; slip speed ahead and to the side
            η [m/s] and in turning [rad/s].
        p: (4,) place of the antenna l_f, l_l [m], traction coefficients μ and κ.

    Returns:
        (3,) dξ/dt.
    """
    nu, omega, slip_ahead, eta, slip_turning = (v[i] for i in range(5))
    l_f = p[0]
    l_l = p[1]
    mu = p[2]
    kappa = p[3]
    turning = kappa * omega + slip_turning
    ahead = mu * nu + slip_ahead - turning * l_l
    left = eta + turning * l_f
    cos = ca.cos(xi[2])
    sin = ca.sin(xi[2])
    return ca.vertcat(ahead * cos - left * sin, ahead * sin + left * cos, turning)


def _abs_track_speeds(nu, omega, b):
    """Speeds (left, right) [m/s], both positive, of the tracks of a robot of track width b [m]."""
    return ca.fabs(nu - b / 2 * omega), ca.fabs(nu + b / 2 * omega)


def _input_noise(v, R, c):
    """Mean and variances (5,) of the inputs: slip in proportion to the motion, turning by bumps.

    v (5,) has the measured ν and ω, and R their variances; slip is not measured. c (7,) are the
    constants of `tuning.SLIP`, then the track width [m] and the length of a sample [s].
    """
    share_nu, share_omega, share_side, sigma_bumps, side_slip_s, b, dt_s = ca.vertsplit(c)
    nu = v[0]
    omega = v[1]
    mean = ca.vertcat(nu, omega, 0, -side_slip_s * nu * omega, 0)
    side = (share_side * b * omega) ** 2
    # In the order of the inputs: ν, ω, slip ahead, to the side, in turning.
    variances = ca.vertcat(
        _EXACT,
        _EXACT,
        R[0] + (share_nu * nu) ** 2,
        side + tuning.SIGMA_SIDE_SLIP_AT_REST**2,
        R[1] + (share_omega * omega) ** 2 + sigma_bumps**2 * ca.fabs(nu) / dt_s,
    )
    return mean, variances


def _process_noise(v, W, dt_s, c):
    """Variances W per metre times the distance that the tracks ran in `dt_s`, in the mean."""
    # The speed of either track counts: a robot that turns in place moves its soil, too.
    left, right = _abs_track_speeds(v[0], v[1], c[_WIDTH])
    return W * (left + right) / 2 * dt_s


_WITH_SPEED = SPEED_MODELS["input"].model
_MODEL = Model(
    states=_WITH_SPEED.states,
    inputs=(*_WITH_SPEED.inputs, "slip_ahead_mps", "eta_mps", "slip_turning_radps"),
    parameters=dict.fromkeys(LEVER_ARM) | _WITH_SPEED.parameters,
    outputs=_WITH_SPEED.outputs,
    f=f,
    max_measurement=_WITH_SPEED.limits,
    sigma_held=_WITH_SPEED.sigma_held,
    motion_noise=MotionNoise(
        constants=tuning.SLIP | dict(track_width_m=paper.TRACK_WIDTH_M, dt_s=paper.DT_S),
        inputs=_input_noise,
        process=_process_noise,
    ),
)
SLIPPING = SpeedModel(_MODEL, tuning.SLIPPING_NOISE)
