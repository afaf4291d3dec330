"""Robots, the paper's among them, as plain data and plain functions: what `rhec.Model`, `rhec.RHE`
and `rhec.RHC` are given, and what the oracles work with independently.
"""

import dataclasses
from collections.abc import Callable

import casadi as ca

from rhec import paper
from rhec.tracked_robot.kinematics import QUANTITIES
from rhec.tracked_robot.paper_rhe import SIGMA_START

DT, N = 0.2, 15


@dataclasses.dataclass(frozen=True, eq=False)
class Robot:
    """A model, the settings of its estimator and controller, and where random instances come from.

    q weighs the states, r the inputs, in their order; commands have the order of `bounds`, which
    may be another. The ranges are (lowest, highest). True parameters are drawn from p_range, which
    is wider than the bounds where there are bounds.
    """

    states: tuple
    inputs: tuple
    parameters: dict
    outputs: tuple
    f: Callable
    sigma_v: tuple
    sigma_w: tuple
    sigma_guess: tuple
    x_range: tuple
    u_range: tuple
    p_range: tuple
    q: tuple
    r: tuple
    bounds: dict
    h: Callable | None = None
    qn_factor: float = 10.0

    @property
    def model(self):
        """The arguments of `rhec.Model`."""
        names = ("states", "inputs", "parameters", "outputs", "f", "h")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    @property
    def estimator(self):
        """The arguments of `rhec.RHE` and `rhec.EKF` that say how noisy the robot is."""
        return dict(sigma_v=self.sigma_v, sigma_w=self.sigma_w, sigma_guess=self.sigma_guess)

    @property
    def controller(self):
        """The arguments of `rhec.RHC` that say what it weighs and what it may command."""
        return dict(
            command=tuple(self.bounds),
            bounds=self.bounds,
            q=self.q,
            r=tuple(self.r[self.inputs.index(name)] for name in self.bounds),
            qn_factor=self.qn_factor,
        )


def _cart(x, u, p):
    return ca.vertcat(x[1], u[0] - p[0])


# A cart on a rail: its accelerometer has a bias, and (1 s, 1/2 s², ...) is all there is to it.
CART = Robot(
    states=("position_m", "velocity_mps"),
    inputs=("acceleration_mps2",),
    parameters={"bias_mps2": None},
    outputs=("position_m", "acceleration_mps2"),
    f=_cart,
    sigma_v=(0.05, 0.2),
    sigma_w=(0.002, 0.01, 0.003),
    sigma_guess=(0.5, 0.3, 0.4),
    x_range=((-2, -1), (2, 1)),
    u_range=((-0.8,), (0.8,)),
    p_range=((-0.5,), (0.5,)),
    q=(1.0, 0.2),
    r=(0.3,),
    bounds={"acceleration_mps2": (-0.4, 0.6)},
)

WHEELBASE_M = 1.3


def _bicycle(x, u, p):
    speed, steering = u[0], u[1] + p[0]
    return ca.vertcat(
        speed * ca.cos(x[2]), speed * ca.sin(x[2]), speed / WHEELBASE_M * ca.tan(steering)
    )


def _antenna(x, u, p):
    return ca.vertcat(x[0] + p[1] * ca.cos(x[2]), x[1] + p[1] * ca.sin(x[2]))


# A kinematic bicycle (x, y of the rear axle) whose steering sensor is a little off and whose
# antenna is ahead of the rear axle by an unknown length.
BICYCLE = Robot(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("speed_mps", "steering_rad"),
    parameters={"steering_offset_rad": (-0.08, 0.08), "lever_arm_m": None},
    outputs=("antenna_x_m", "antenna_y_m", "speed_mps", "steering_rad"),
    f=_bicycle,
    h=_antenna,
    sigma_v=(0.03, 0.03, 0.05, 0.02),
    sigma_w=(0.005, 0.005, 0.005, 0.002, 0.002),
    sigma_guess=(0.3, 0.3, 0.2, 0.08, 0.3),
    x_range=((-1, -1, -3), (1, 1, 3)),
    u_range=((0.6, -0.3), (1.4, 0.3)),
    p_range=((-0.2, 0.3), (0.2, 0.9)),
    q=(1.0, 1.0, 0.5),
    r=(2.0, 8.0),
    bounds={"speed_mps": (0.2, 1.3), "steering_rad": (-0.35, 0.35)},
)

TRACK_WIDTH_M = 0.6


def _skid_steered(x, u, p):
    left, right = (1 - p[0]) * u[0], (1 - p[1]) * u[1]
    speed = (left + right) / 2
    return ca.vertcat(speed * ca.cos(x[2]), speed * ca.sin(x[2]), (right - left) / TRACK_WIDTH_M)


# Two tracks, each with a slip of its own, both commanded.
SKID_STEERED = Robot(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("v_left_mps", "v_right_mps"),
    parameters={"slip_left": (0, 1), "slip_right": (0, 1)},
    outputs=("x_m", "y_m", "v_left_mps", "v_right_mps"),
    f=_skid_steered,
    sigma_v=(0.03, 0.03, 0.02, 0.02),
    sigma_w=(0.005, 0.005, 0.005, 0.005, 0.005),
    sigma_guess=(0.3, 0.3, 0.2, 0.15, 0.15),
    x_range=((-1, -1, -3), (1, 1, 3)),
    u_range=((0.3, 0.3), (0.8, 0.8)),
    p_range=((-0.2, -0.2), (0.35, 0.35)),
    q=(1.0, 1.0, 0.5),
    r=(0.5, 0.8),
    bounds={"v_left_mps": (-0.2, 0.75), "v_right_mps": (-0.2, 0.7)},
)


def _with_track_width(x, u, p):
    left, right = (1 - p[0]) * u[1], (1 - p[2]) * u[0]
    speed = (left + right) / 2
    return ca.vertcat((right - left) / p[1], speed * ca.cos(x[0]), speed * ca.sin(x[0]))


# More bounded parameters than two, one of them measured, and nothing in the usual order.
WITH_TRACK_WIDTH = dataclasses.replace(
    SKID_STEERED,
    states=("theta_rad", "x_m", "y_m"),
    inputs=("v_right_mps", "v_left_mps"),
    parameters={"slip_left": (0, 1), "track_width_m": (0.5, 0.7), "slip_right": (0, 1)},
    outputs=("v_left_mps", "y_m", "track_width_m", "v_right_mps", "x_m"),
    f=_with_track_width,
    sigma_v=(0.02, 0.03, 0.05, 0.03, 0.04),
    sigma_w=(0.005, 0.005, 0.005, 0.005, 0.001, 0.005),
    sigma_guess=(0.2, 0.3, 0.3, 0.15, 0.05, 0.15),
    x_range=((-3, -1, -1), (3, 1, 1)),
    p_range=((-0.2, 0.45, -0.2), (0.35, 0.75, 0.35)),
    q=(0.5, 1.0, 1.0),
    r=(0.8, 0.5),
)


def _unicycle(x, u, p):
    return ca.vertcat(u[0] * ca.cos(x[2]), u[0] * ca.sin(x[2]), u[1])


# Nothing but a pose: no parameters.
UNICYCLE = dataclasses.replace(
    SKID_STEERED,
    inputs=("speed_mps", "yaw_rate_radps"),
    parameters={},
    outputs=("x_m", "y_m", "speed_mps", "yaw_rate_radps"),
    f=_unicycle,
    sigma_w=(0.005, 0.005, 0.005),
    sigma_guess=(0.3, 0.3, 0.2),
    u_range=((0.3, -0.5), (0.8, 0.5)),
    p_range=((), ()),
    bounds={"speed_mps": (-0.2, 0.75), "yaw_rate_radps": (-0.4, 0.4)},
)


def _gyro(x, u, p):
    return ca.vertcat(u[1] + p[0])


# The yaw rate is measured through a bias alone: an output that mixes an input with a parameter.
WITH_GYRO = dataclasses.replace(
    UNICYCLE,
    parameters={"gyro_bias_radps": (-0.05, 0.05)},
    outputs=("gyro_radps", "x_m", "y_m", "speed_mps"),
    h=_gyro,
    sigma_v=(0.02, 0.03, 0.03, 0.02),
    sigma_w=(0.005, 0.005, 0.005, 0.001),
    sigma_guess=(0.3, 0.3, 0.2, 0.1),
    p_range=((-0.15,), (0.15,)),
)


def _crawl(x, u, p):
    nu, mu, kappa = ca.vertsplit(p)
    return ca.vertcat(mu * nu * ca.cos(x[2]), mu * nu * ca.sin(x[2]), kappa * u[-1])


# The paper's robot, eq. (2).
CRAWLER = Robot(
    states=("x_m", "y_m", "theta_rad"),
    inputs=("omega_radps",),
    parameters={"nu_mps": None, "mu": (0.0, 1.0), "kappa": (0.0, 1.0)},
    outputs=("x_m", "y_m", "nu_mps", "omega_radps"),
    f=_crawl,
    sigma_v=paper.SIGMA_V,
    sigma_w=paper.SIGMA_W_RHE,
    sigma_guess=tuple(SIGMA_START[name] for name in QUANTITIES),
    x_range=((-1, -1, -3), (1, 1, 3)),
    u_range=((-0.3,), (0.3,)),
    p_range=((0.45, 0.7, 0.7), (0.55, 1.3, 1.3)),
    q=(1.0, 1.0, 0.5),
    r=(5.0,),
    bounds={"omega_radps": (-0.1, 0.1)},
)


def _cart_pole(x, u, p):
    pole, half_m, g = 0.1, 2.0, 9.81
    sine, cosine = ca.sin(x[2]), ca.cos(x[2])
    force = u[0] + pole * sine * (half_m * x[3] ** 2 - g * cosine)
    acceleration = force / (p[0] + pole * sine**2)
    return ca.vertcat(x[1], acceleration, x[3], (g * sine - acceleration * cosine) / half_m)


# A cart of unknown mass that balances a pole.
CART_POLE = Robot(
    states=("position_m", "velocity_mps", "pole_rad", "pole_radps"),
    inputs=("force_n",),
    parameters={"mass_kg": (0.5, 2.0)},
    outputs=("position_m", "pole_rad", "force_n"),
    f=_cart_pole,
    sigma_v=(0.01, 0.01, 0.05),
    sigma_w=(0.002, 0.005, 0.002, 0.005, 0.002),
    sigma_guess=(0.1, 0.1, 0.1, 0.1, 0.2),
    x_range=((-0.2, -0.2, -0.1, -0.1), (0.2, 0.2, 0.1, 0.1)),
    u_range=((-0.5,), (0.5,)),
    p_range=((0.7,), (1.5,)),
    q=(1.0, 0.1, 10.0, 0.1),
    r=(0.01,),
    bounds={"force_n": (-12.0, 12.0)},
)


ROBOTS = {"cart": CART, "bicycle": BICYCLE, "skid_steered": SKID_STEERED}
VARIANTS = {
    "with_track_width": WITH_TRACK_WIDTH,
    "unicycle": UNICYCLE,
    "with_gyro": WITH_GYRO,
    "crawler": CRAWLER,
}
