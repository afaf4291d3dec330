"""Five parameters of a skid-steering robot: instantaneous centres of rotation (ICR) and slip.

Not in the paper; Martínez, Mandow, Morales, Pedraza and García-Cerezo (2005), and Pentzer, Brennan
and Reichard (2014), who estimate them with an EKF. Over ground the left track rolls about a centre
y_l to the left of the antenna, the right one about y_r (below 0), and the robot turns about a
centre x_v ahead; α_l and α_r are the shares of the tracks' speeds that reach the ground.
"""

import casadi as ca

from rhec.core.model.base import Model, MotionNoise

__all__ = ["ICR", "f"]


def f(xi, u, p):
    """ξ̇ = f(ξ, u, p) of the antenna's place and the yaw (x, y, θ).

    u are the mean of the tracks' speeds ν and half their difference δ = bω/2 [m/s], p the centres
    y_l, y_r, x_v [m] and shares α_l, α_r.
    """
    y_l = p[0]
    y_r = p[1]
    x_v = p[2]
    left = p[3] * (u[0] - u[1])
    right = p[4] * (u[0] + u[1])
    turning = (right - left) / (y_l - y_r)
    ahead = (right * y_l - left * y_r) / (y_l - y_r)
    side = -x_v * turning
    cos = ca.cos(xi[2])
    sin = ca.sin(xi[2])
    return ca.vertcat(ahead * cos - side * sin, ahead * sin + side * cos, turning)


ICR = Model(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("nu_mps", "delta_mps"),
    parameters=dict.fromkeys(("y_left_m", "y_right_m", "x_turning_m", "left", "right")),
    outputs=("x_m", "y_m", "nu_mps", "delta_mps"),
    f=f,
    max_measurement=(1e8, 1e8, 100.0, 100.0),
    motion_noise=MotionNoise(  # of the inputs, in proportion to them, too
        constants=dict(share_nu=0.1, share_delta=0.1),
        inputs=lambda v, R, c: (v, R + (c * v) ** 2),
        process=lambda v, W, dt_s, c: W,
    ),
)
